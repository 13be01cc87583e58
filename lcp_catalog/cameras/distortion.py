"""Lens distortion: from ideal to distorted coordinates of the focal plane, and back.

Every lens has its own unit of the focal plane: the focal length (`OpenCV`), or millimetres as in
sensor models. ``distort`` goes from ideal to distorted coordinates, ``undistort`` back; input and
output are arrays of one shape. One of the two is the formula that defines the lens, the other its
inverse, solved to the last bits. Points without an inverse return NaN, or a value that the formula
does not take back: callers check ``within`` and compare (`distortion`).

Directions in camera axes to pixels through a lens, and back.

Camera axes are those of OpenCV: X right along rows, Y down along columns, Z ahead. A lens works in
coordinates of the focal plane divided by the focal length: X / Z and Y / Z.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from .json_fields import LARGEST
from .json_fields import numbers as checked_numbers

Pair = tuple[Array, Array]
Map = Callable[[Any, Any], tuple[Any, Any]]
Slopes = tuple[Array, Array, Array, Array]
"""du/dx, du/dy, dv/dx, dv/dy."""

_MOST_STEPS = 50
_NO_TERM = 1e-290  # a coefficient without effect, by which no number can be divided
_CONVERGED = 1e-9  # Newton doubles the digits: the next step is below the last bit
_COMPLEX_STEP = 1e-30


class Lens(Protocol):
    """A lens: frozen; `lens_from_json` reads what ``to_json`` writes."""

    def distort(self, x: Array, y: Array) -> Pair:
        """Distorted coordinates of ideal coordinates."""

    def undistort(self, u: Array, v: Array) -> Pair:
        """Ideal coordinates of distorted coordinates (u, v)."""

    def within(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """True for ideal coordinates inside the fold of the lens."""

    def to_json(self) -> dict[str, Any]:
        """Name of the ``model`` and its parameters."""


@dataclass(frozen=True)
class _LensBase:
    """Base of the lenses: their JSON form, and no fold by default."""

    def within(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """True for finite coordinates."""
        return np.isfinite(x) & np.isfinite(y)

    def to_json(self) -> dict[str, Any]:
        """Name of the ``model`` and its parameters."""
        return {"model": _NAME[type(self)]} | {
            field.name: _plain(getattr(self, field.name)) for field in fields(self)
        }


@dataclass(frozen=True)
class _InverseFormula(_LensBase, ABC):
    """A lens whose formula goes from distorted to ideal coordinates; the other way is solved."""

    @abstractmethod
    def undistort(self, u: Array, v: Array) -> Pair:
        """The defining formula."""

    def distort(self, x: Array, y: Array) -> Pair:
        return _inverse_map(self.undistort, x, y)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    return value.to_json() if isinstance(value, _LensBase) else value


@dataclass(frozen=True)
class NoLens(_LensBase):
    """A pinhole: no distortion."""

    def distort(self, x: Array, y: Array) -> Pair:
        return x, y

    def undistort(self, u: Array, v: Array) -> Pair:
        return u, v


@dataclass(frozen=True)
class OpenCV(_LensBase):
    """Radial and tangential distortion of OpenCV. Also the TSAI lens of the Ames Stereo Pipeline
    (since 3.3.0, by its manual), and RADTAN of usgscsm, there in millimetres.

    u = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2); v likewise with p1 and p2
    exchanged.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def distort(self, x: Array, y: Array) -> Pair:
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return (
            x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
            y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y,
        )

    def undistort(self, u: Array, v: Array) -> Pair:
        if not any((self.k1, self.k2, self.p1, self.p2, self.k3)):
            return u, v
        return _inverse_map(self.distort, u, v, self._slopes)

    def _slopes(self, x: Array, y: Array) -> Slopes:
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = 2 * (self.k1 + r2 * (2 * self.k2 + r2 * 3 * self.k3))
        across = slope * x * y + 2 * self.p1 * x + 2 * self.p2 * y
        return (
            radial + slope * x * x + 2 * self.p1 * y + 6 * self.p2 * x,
            across,
            across,
            radial + slope * y * y + 6 * self.p1 * y + 2 * self.p2 * x,
        )

    def within(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """True up to the maximum of the radial polynomial r + k1 r^3 + k2 r^5 + k3 r^7."""
        turn2 = _first_root(1.0, 3 * self.k1, 5 * self.k2, 7 * self.k3)
        return np.asarray(x * x + y * y <= turn2)


@dataclass(frozen=True)
class UsgsRadial(_LensBase):
    """'radial' of an ISD, millimetres; defined from distorted to ideal: x = u (1 - k0 - k1 r^2 - k2
    r^4), r of (u, v).
    """

    k0: float = 0.0
    k1: float = 0.0
    k2: float = 0.0

    def undistort(self, u: Array, v: Array) -> Pair:
        r2 = u * u + v * v
        kept = 1 - (self.k0 + r2 * (self.k1 + r2 * self.k2))
        return u * kept, v * kept

    def distort(self, x: Array, y: Array) -> Pair:
        """Newton's method on the radius: the polynomial is monotone with curvature of one sign up
        to its maximum.
        """
        ideal = np.hypot(x, y)
        distorted = ideal
        with np.errstate(all="ignore"):
            for _ in range(_MOST_STEPS):
                r2 = distorted * distorted
                there = distorted * (1 - (self.k0 + r2 * (self.k1 + r2 * self.k2)))
                slope = 1 - (self.k0 + r2 * (3 * self.k1 + r2 * 5 * self.k2))
                step = (there - ideal) / slope
                distorted = distorted - step
                if _settled(step, distorted):
                    break
            scale = np.where(ideal > 0.0, distorted / ideal, 1.0)
        return x * scale, y * scale

    def within(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """True up to the ideal radius of the maximum of the polynomial."""
        return np.asarray(x * x + y * y <= _ideal_turn2(1 - self.k0, -self.k1, -self.k2))


def _ideal_turn2(*k: float) -> float:
    """Squared ideal radius r (k0 + k1 r^2 + k2 r^4 ...) at its first maximum over the distorted
    radius r; infinite without a maximum.
    """
    turn2 = _first_root(*((2 * i + 1) * number for i, number in enumerate(k)))
    if math.isinf(turn2):
        return turn2
    return turn2 * sum(number * turn2**i for i, number in enumerate(k)) ** 2


@dataclass(frozen=True)
class LroNac(_LensBase):
    """'lrolrocnac' of an ISD, millimetres; along the detector only: y = v / (1 + k v^2)."""

    k: float

    def undistort(self, u: Array, v: Array) -> Pair:
        return u, v / (1 + self.k * v * v)

    def distort(self, x: Array, y: Array) -> Pair:
        """The root of k y v^2 - v + y that approaches y for small k."""
        with np.errstate(invalid="ignore"):
            return x, 2 * y / (1 + np.sqrt(1 - 4 * self.k * y * y))

    def within(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """True up to |y| = 1 / (2 sqrt k): 117.5 mm for the LRO NAC, whose last pixel is at 17.7
        mm.
        """
        return np.asarray(4 * self.k * y * y <= 1.0)


@dataclass(frozen=True)
class KaguyaLism(_InverseFormula):
    """'kaguyalism' of an ISD, millimetres: x = u + boresight_x + a0 + a1 r + a2 r^2 + a3 r^3, r of
    (u, v); y likewise with b.
    """

    a: tuple[float, float, float, float]
    b: tuple[float, float, float, float]
    boresight_x: float
    boresight_y: float

    def undistort(self, u: Array, v: Array) -> Pair:
        r = np.sqrt(u * u + v * v)
        (a0, a1, a2, a3), (b0, b1, b2, b3) = self.a, self.b
        return (
            u + self.boresight_x + a0 + r * (a1 + r * (a2 + r * a3)),
            v + self.boresight_y + b0 + r * (b1 + r * (b2 + r * b3)),
        )


@dataclass(frozen=True)
class _RadialTangential(_InverseFormula):
    """Base of Photometrix and BrownConrady: an offset, a radial and a tangential part."""

    xp: float
    yp: float
    k1: float
    k2: float
    k3: float
    p1: float
    p2: float

    def within(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """True up to the maximum of the radial part."""
        return np.asarray(x * x + y * y <= _ideal_turn2(1.0, self.k1, self.k2, self.k3))


@dataclass(frozen=True)
class Photometrix(_RadialTangential):
    """Photometrix (Australis) of ASP, in the unit of the file's focal length; defined from
    distorted to ideal.

    With x = u - xp, y = v - yp and r^2 = x^2 + y^2: ideal = u + x (k1 r^2 + k2 r^4 + k3 r^6) + p1
    (r^2 + 2 x^2) + 2 p2 x y; v likewise with p1 and p2 exchanged. The program of ASP starts from u,
    as here; its manual has x. The manual states that the program is the reference.
    """

    def undistort(self, u: Array, v: Array) -> Pair:
        x, y = u - self.xp, v - self.yp
        r2 = x * x + y * y
        radial = r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return (
            u + x * radial + self.p1 * (r2 + 2 * x * x) + 2 * self.p2 * x * y,
            v + y * radial + self.p2 * (r2 + 2 * y * y) + 2 * self.p1 * x * y,
        )


@dataclass(frozen=True)
class BrownConrady(_RadialTangential):
    """BrownConrady of ASP, in the unit of the file's focal length; defined from distorted to ideal.

    With x, y, r as in `Photometrix`: ideal = x (1 + k1 r^2 + k2 r^4 + k3 r^6) - (p1 r^2 + p2 r^4)
    sin(phi), phi in radians; y likewise, with plus the cosine. The offset is not added again.
    """

    phi: float

    def undistort(self, u: Array, v: Array) -> Pair:
        x, y = u - self.xp, v - self.yp
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        tangential = r2 * (self.p1 + r2 * self.p2)
        return (
            x * radial - tangential * math.sin(self.phi),
            y * radial + tangential * math.cos(self.phi),
        )


Matrix = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class OnPlane(_LensBase):
    """A lens in other units or axes.

    ``into`` takes the focal plane of a camera (units of its focal length) to that of the lens,
    ``out`` takes the lens back to the detector. Both also express a detector that is skewed,
    mirrored or has oblong pixels.
    """

    into: Matrix
    lens: Lens
    out: Matrix

    def distort(self, x: Array, y: Array) -> Pair:
        x, y = _times(self.into, (x, y))
        return _times(self.out, self.lens.distort(x, y))

    def undistort(self, u: Array, v: Array) -> Pair:
        u, v = _times(_inverse(self.out), (u, v))
        return _times(_inverse(self.into), self.lens.undistort(u, v))

    def within(self, x: Array, y: Array) -> NDArray[np.bool_]:
        x, y = _times(self.into, (x, y))
        return self.lens.within(x, y)


def _times(square: Matrix, place: Pair) -> Pair:
    ((a, b), (c, d)), (x, y) = square, place
    return a * x + b * y, c * x + d * y


def _inverse(square: Matrix) -> Matrix:
    (a, b), (c, d) = square
    determinant = a * d - b * c
    return (d / determinant, -b / determinant), (-c / determinant, a / determinant)


_KINDS: dict[str, type[Any]] = {
    "none": NoLens,
    "opencv": OpenCV,
    "usgs-radial": UsgsRadial,
    "lro-nac": LroNac,
    "kaguya-lism": KaguyaLism,
    "photometrix": Photometrix,
    "brown-conrady": BrownConrady,
    "plane": OnPlane,
}
_NAME = {kind: name for name, kind in _KINDS.items()}


def lens_from_json(document: Any) -> Lens:
    """The lens of a document that ``to_json`` wrote; ValueError for any other document."""
    model = document.get("model") if isinstance(document, Mapping) else None
    if not isinstance(model, str) or model not in _KINDS:
        raise ValueError(f"has no model of {', '.join(_KINDS)}")
    kind = _KINDS[model]
    names = [field.name for field in fields(kind)]
    missing = [name for name in names if name not in document]
    if missing:
        raise ValueError(f"lacks {', '.join(missing)}")
    lens: Lens = kind(**{name: _parsed(kind, name, document[name]) for name in names})
    return lens


def _parsed(kind: type, name: str, value: Any) -> Any:
    """Finite value of a field: one number or as many as the field holds."""
    if name == "lens":
        return lens_from_json(value)
    shape = {"into": (2, 2), "out": (2, 2), "a": (4,), "b": (4,)}.get(name, ())
    try:
        numbers = checked_numbers(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} does not consist of numbers") from error
    if numbers.shape != shape or not (np.abs(numbers) <= LARGEST).all():
        raise ValueError(f"{name} must hold finite numbers of shape {shape}")
    if kind is OnPlane and abs(np.linalg.det(numbers)) < 1e-12:
        raise ValueError(f"{name} has no inverse")
    return tuple(map(tuple, numbers.tolist())) if shape == (2, 2) else _tuple(numbers.tolist())


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _first_root(*rising: float) -> float:
    """Least positive root of a polynomial, lowest power first; infinity without one."""
    terms = [term if abs(term) > _NO_TERM else 0.0 for term in rising[::-1]]
    turns = np.roots(terms)  # divides by the first of them
    real = turns[(np.abs(turns.imag) < 1e-12) & (turns.real > 0)].real if turns.size else turns
    return float(real.min()) if real.size else math.inf


def _settled(step: Array, value: Array) -> bool:
    """True if all finite steps are negligible."""
    largest = np.fmax.reduce(np.abs(step), axis=None, initial=0.0)
    scale = np.fmax.reduce(np.abs(value), axis=None, initial=1.0)
    return bool(largest <= _CONVERGED * scale)


def _inverse_map(
    forward: Map, u: Array, v: Array, slopes: Callable[[Array, Array], Slopes] | None = None
) -> Pair:
    """The (x, y) that ``forward`` takes to (u, v), by Newton's method from (u, v).

    Without ``slopes`` the derivatives come from complex steps, which are exact for analytic
    formulas.
    """
    x, y = np.array(u, dtype=np.float64), np.array(v, dtype=np.float64)
    slopes = slopes or _complex_slopes(forward)
    with np.errstate(all="ignore"):  # divergence ends as NaN, which the caller checks
        for _ in range(_MOST_STEPS):
            at_u, at_v = forward(x, y)
            uu, uv, vu, vv = slopes(x, y)
            du, dv, determinant = at_u - u, at_v - v, uu * vv - uv * vu
            step_x, step_y = (vv * du - uv * dv) / determinant, (uu * dv - vu * du) / determinant
            x, y = x - step_x, y - step_y
            if _settled(np.hypot(step_x, step_y), np.hypot(x, y)):
                break
    return x, y


def _complex_slopes(forward: Map) -> Callable[[Array, Array], Slopes]:
    """Derivatives du/dx, du/dy, dv/dx, dv/dy by complex steps (Squire & Trapp 1998)."""

    def slopes(x: Array, y: Array) -> Slopes:
        step = 1j * _COMPLEX_STEP
        by_x, by_y = forward(x + step, y + 0j), forward(x + 0j, y + step)
        parts = (by_x[0], by_y[0], by_x[1], by_y[1])
        uu, uv, vu, vv = (np.asarray(part.imag / _COMPLEX_STEP) for part in parts)
        return uu, uv, vu, vv

    return slopes


INVERSE_TOLERANCE_PX = 1e-6
"""Largest error of a lens's inverse: a pixel's direction projects to the pixel within this
distance.
"""

_SAME = 1e-14


@dataclass(frozen=True)
class FocalPlane:
    """Projection of directions to the image. ``lens`` is in units of the focal length."""

    focal_length_px: float
    principal_point_px: tuple[float, float]
    lens: Lens

    def part(self, column: int, row: int, count: int = 1) -> FocalPlane:
        """The plane with its pixels counted from another column and row, each divided into
        ``count`` x ``count`` equal parts.
        """
        cx, cy = self.principal_point_px
        middle = (cx - column + 0.5) * count - 0.5, (cy - row + 0.5) * count - 0.5
        return FocalPlane(self.focal_length_px * count, middle, self.lens)

    def pixels(self, directions: Array) -> Array:
        """Pixels (..., 2), column and row, of directions (..., 3) of any length; NaN for directions
        that are not ahead, or beyond the fold of the lens.
        """
        x, y, depth = np.moveaxis(directions, -1, 0)
        seen = depth > 0
        safe = np.where(seen, depth, 1.0)
        x, y = x / safe, y / safe
        seen &= self.lens.within(x, y)
        u, v = self.lens.distort(np.where(seen, x, 0.0), np.where(seen, y, 0.0))
        cx, cy = self.principal_point_px
        pixels = np.stack([cx + self.focal_length_px * u, cy + self.focal_length_px * v], axis=-1)
        return np.where(seen[..., None], pixels, np.nan)

    def directions(self, pixels: Array) -> Array:
        """Unit directions (..., 3) of pixels (..., 2); NaN where the lens has no inverse."""
        column, row = np.moveaxis(pixels, -1, 0)
        cx, cy = self.principal_point_px
        u, v = (column - cx) / self.focal_length_px, (row - cy) / self.focal_length_px
        x, y = self.lens.undistort(u, v)
        with np.errstate(all="ignore"):
            looking = np.stack([x, y, np.ones_like(x)], axis=-1)
            looking /= np.sqrt(1.0 + x * x + y * y)[..., None]
            if isinstance(self.lens, NoLens):
                return looking
            back = self.lens.distort(x, y)
            off_px = np.hypot(back[0] - u, back[1] - v) * self.focal_length_px
            solved = (off_px < INVERSE_TOLERANCE_PX) & self.lens.within(x, y)
        return np.where(solved[..., None], looking, np.nan)


def plane_of(
    lens: Lens,
    focal_length: float,
    pixels_per_unit: Array,
    origin_px: tuple[float, float],
    *,
    flipped: bool = False,
) -> tuple[FocalPlane, Array]:
    """The focal plane of a camera whose lens has other units and whose axes x, y, z are different,
    and the rotation (3, 3) about z from those axes to camera axes.

    An ideal point of that lens's plane is ``focal_length`` times (x / z, y / z), or (x / z, -y / z)
    if ``flipped``. A distorted point (u, v) falls on the pixel ``origin_px`` + ``pixels_per_unit``
    (u, v); rows of the matrix: column, row. The rotation brings X as close as possible to the
    direction of columns; in a mirrored image Y points up instead of down.
    """
    matrix = np.asarray(pixels_per_unit, dtype=np.float64)
    flip = np.diag([1.0, -1.0 if flipped else 1.0])
    left, sizes, right = np.linalg.svd(matrix @ flip)
    turn = left @ right  # the polar factor: matrix = (symmetric) @ turn
    if np.linalg.det(turn) < 0:
        turn = np.diag([1.0, -1.0]) @ turn
    turn = np.where(np.abs(turn) < 1e-15, 0.0, turn)
    density = float(np.sqrt(sizes[0] * sizes[1]))
    into, out = focal_length * flip @ turn.T, matrix / (density * focal_length)
    axes = np.eye(3)
    axes[:2, :2] = turn
    through = out @ into if isinstance(lens, NoLens) else np.concatenate([into, out])
    if np.abs(through - np.tile(np.eye(2), (len(through) // 2, 1))).max() > _SAME:
        lens = OnPlane(_square(into), lens, _square(out))
    return FocalPlane(density * focal_length, origin_px, lens), axes


def _square(matrix: Array) -> Matrix:
    (a, b), (c, d) = matrix.tolist()
    return (a, b), (c, d)
