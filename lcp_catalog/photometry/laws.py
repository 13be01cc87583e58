"""Reflectance models by name, as radiance factor I/F: radiance relative to that of a perfect white
Lambert surface under normal illumination.

mu0 and mu are the cosines of incidence and emission. The phase g is the angle between the
directions to the source and to the camera.

``lommel-seeliger``: w/4 mu0 / (mu0 + mu), isotropic scattering, single-scattering albedo w = 0.21
(Hapke 2012, *Theory of Reflectance and Emittance Spectroscopy*, ch. 8 and 10). Without a phase
function it is valid for relative values within an image of nearly constant phase, not between
images. ``lommel-seeliger:rolo`` has the phase function of the Moon's disc. ``lambert``: A mu0, A =
0.12. ``lunar-lambert``: McEwen (1996), f(g) (2 L mu0 / (mu0 + mu) + (1 - L) mu0), L a cubic in g; f
of Yokota et al. (2011). ``minnaert``: A mu0 (mu0 mu)^(k-1), Minnaert (1941), k = 0.5 or the value
after the colon; cosines below sin 2 deg are raised to that. ``hapke``: Hapke (2012),
`hapke_sets`. ``facet``: a measured surface as two lobes, Labunets et al. (2019),
`facet_model`; a table of the paper or a MODEL.toml.

Published phase functions of the Moon for the models of Lommel-Seeliger and lunar-Lambert, as
numbers of these models.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..choices import ANCHOR_SET, DEFAULT_LAW, REFLECTANCE_MODELS
from ..errors import ConfigError
from ..kernels.photometry import images
from ..kernels.photometry import laws as kernel
from .facet_model import facet_model, law_file
from .hapke_sets import DEFAULT_SET, hapke_set

_even_sphere, _mixture, _two_lobes = (
    cast(Callable[..., float], compiled.py_func)
    for compiled in (kernel.even_sphere, kernel.mixture, kernel.two_lobes)
)
"""The kernels' functions, not compiled."""


@dataclass(frozen=True)
class SurfacePhase:
    """Yokota et al. (2011): reflectance ``r30`` at incidence and phase 30 deg, emission 0, and the
    phase function (1 + B0 / (1 + tan(g/2)/h)) times a double Henyey-Greenstein function of ``c``
    and ``asymmetry``, in which the lobe (1 - c)/2 is backward.
    """

    r30: float
    b0: float
    h: float
    c: float
    asymmetry: float


SURFACES = {
    "sp-low": SurfacePhase(0.045, 1.657, 0.0735, -0.053, 0.208),
    "sp-mid": SurfacePhase(0.064, 1.347, 0.0565, -0.053, 0.227),
    "sp-high": SurfacePhase(0.094, 1.087, 0.0850, -0.183, 0.210),
}
"""For the lunar-Lambert model with McEwen's L(g), with which they were fitted; phase 5 to 85 deg. Low, middle and high albedo
group of the Spectral Profiler of SELENE at 644.6 nm: Y. Yokota et al., Icarus 215 (2011) 639, supporting information, as
distributed with the code of T. Kouyama et al. (2016), TKouyama/SP_LunarCal_example.
"""

DEFAULT_SURFACE = "sp-mid"


@dataclass(frozen=True)
class DiscPhase:
    """Kieffer and Stone (2005), eq. 10, without libration and with the Sun's longitude 0: the
    logarithm of the disc's reflectance is sum a_i g^i (radians) + d1 exp(-g/p1) + d2 exp(-g/p2) +
    d3 cos((g - p3)/p4) (degrees).
    """

    a: tuple[float, float, float, float]
    d: tuple[float, float, float]
    p: tuple[float, float, float, float]
    last_deg: float


DISCS = {
    "rolo": DiscPhase(
        a=(-1.88914, -1.58096, 0.30477, -0.17908),
        d=(0.37141, -0.13514, 0.01248),
        p=(4.06054, 12.8802, -30.5858, 16.7498),
        last_deg=97.0,
    )
}
"""For Lommel-Seeliger's model: a sphere has the measured brightness of the Moon's disc, up to the
last measured phase. H. H. Kieffer, T. C. Stone, AJ 129 (2005) 2887, table 4, 665.1 nm; coefficients from a plot by J. Hollan,
who has them from T. Stone. Measured from 1.55 to 97 deg of phase."""


def surface_law(name: str) -> tuple[float, ...]:
    """Numbers of the lunar-Lambert model: scale, B0, h, c, asymmetry. ConfigError for an unknown
    name.
    """
    if name not in SURFACES:
        raise ConfigError(
            f"no lunar-Lambert phase function {name!r}; valid names: {', '.join(SURFACES)}"
        )
    found = SURFACES[name]
    shape = (found.b0, found.h, found.c, found.asymmetry)
    cosine = math.cos(math.radians(30.0))
    share = _mixture(cosine)
    bright = cosine * (2.0 * share / (1.0 + cosine) + 1.0 - share)
    return (found.r30 / (bright * _two_lobes((1.0, *shape), cosine)), *shape)


def disc_law(name: str) -> tuple[float, ...]:
    """Numbers of Lommel-Seeliger's model with the phase function of a disc, in the order of
    `kernels.photometry.laws.even_sphere`. ConfigError for an unknown name.

    Beyond the last measured phase the logarithm of the factor is extrapolated linearly.
    """
    if name not in DISCS:
        raise ConfigError(
            f"no Lommel-Seeliger phase function {name!r}; valid names: {', '.join(DISCS)}"
        )
    found = DISCS[name]
    last, step = math.radians(found.last_deg), 1e-5
    measured = (*found.a, *found.d, *found.p, math.pi, 0.0, 0.0)
    before, at = (math.log(_even_sphere(measured, math.cos(g))) for g in (last - step, last))
    return (*measured[:-3], last, at, (at - before) / step)


SINGLE_SCATTERING_ALBEDO = 0.21
LAMBERT_ALBEDO = 0.12
MINNAERT_ALBEDO = 0.12
MINNAERT_K = 0.5
"""Exponent for which the disc has uniform brightness at opposition, as the Moon's disc has."""
MINNAERT_FLOOR = math.sin(math.radians(2.0))
"""Lower bound of the cosines: mu^(k-1) has a pole at grazing angles. With this bound the reflected
light does not exceed the incident light for any k."""


@dataclass(frozen=True)
class Reflectance:
    """A reflectance model: its name as requested, without folders; its code and its numbers; the file of the numbers, if
    any; and whether it has the brightness of a measured surface, or only ratios within an image are meant.
    """

    name: str
    code: int
    law: tuple[float, ...]
    file: Path | None = None
    is_absolute: bool = True

    @cached_property
    def numbers(self) -> Array:
        """Numbers of the model for the kernels, (n,)."""
        return np.array(self.law, dtype=np.float64)

    @cached_property
    def level(self) -> str:
        """What the values are: relative, or I/F; where published sets are not at the anchor, with the factor between."""
        if not self.is_absolute:
            return "relative"
        times = f"{1.0 / _to_anchor(self.code, self.law):.2f}"
        apart = f", {times} times lommel-seeliger:{ANCHOR_SET} at 30 deg" if times != "1.00" else ""
        return f"radiance factor I/F{apart}"


def _to_anchor(code: int, law: tuple[float, ...]) -> float:
    """Factor that gives a model the radiance factor of ``lommel-seeliger:rolo`` at incidence and phase 30 deg, emission 0."""
    cosine = np.array([math.cos(math.radians(30.0))])
    anchor, own = (
        float(kernel.factors(cosine, np.ones(1), cosine, which, np.array(numbers))[0])
        for which, numbers in ((kernel.LOMMEL_SEELIGER, disc_law(ANCHOR_SET)), (code, law))
    )
    return anchor / own


_Law = tuple[int, tuple[float, ...], bool]
"""Code and numbers of a model, and whether they have a measured brightness."""


def _lommel_seeliger(which: str) -> _Law:
    law = disc_law(which) if which else (SINGLE_SCATTERING_ALBEDO,)
    return kernel.LOMMEL_SEELIGER, law, bool(which)


def _lambert(which: str) -> _Law:
    if which:
        raise ConfigError(f"lambert has no parameters, not {which!r}")
    return kernel.LAMBERT, (LAMBERT_ALBEDO,), False


def _lunar_lambert(which: str) -> _Law:
    if which == ANCHOR_SET:
        law = surface_law(DEFAULT_SURFACE)
        times = _to_anchor(kernel.LUNAR_LAMBERT, law)
        return kernel.LUNAR_LAMBERT, (law[0] * times, *law[1:]), True
    return kernel.LUNAR_LAMBERT, surface_law(which or DEFAULT_SURFACE), True


def _minnaert(which: str) -> _Law:
    try:
        k = float(which) if which else MINNAERT_K
    except ValueError:
        k = math.nan
    if not 0.0 <= k <= 1.0:
        raise ConfigError(f"minnaert:K needs an exponent from 0 to 1, not {which!r}")
    return kernel.MINNAERT, (MINNAERT_ALBEDO, k, MINNAERT_FLOOR), False


def _hapke(which: str) -> _Law:
    if which == ANCHOR_SET:
        law = hapke_set(DEFAULT_SET).law
        return kernel.HAPKE, (*law[:-1], _to_anchor(kernel.HAPKE, law)), True
    return kernel.HAPKE, hapke_set(which or DEFAULT_SET).law, True


def _facet(which: str) -> _Law:
    model = facet_model(which)
    return kernel.FACET, tuple(model.law.tolist()), model.levels is not None


_Reader = Callable[[str], _Law]
_READERS: tuple[_Reader, ...] = (
    _lommel_seeliger,
    _lambert,
    _lunar_lambert,
    _minnaert,
    _hapke,
    _facet,
)
_LAWS = dict(zip(REFLECTANCE_MODELS, _READERS, strict=True))


def reflectance_model(spec: str) -> Reflectance:
    """Model of a name with an optional parameter set after a colon: ``hapke:wac-643-mare``,
    ``minnaert:0.7``. ConfigError for an unknown name.
    """
    name, colon, which = spec.partition(":")
    if name not in _LAWS:
        raise ConfigError(
            f"no reflectance model {name!r}; valid names: {', '.join(REFLECTANCE_MODELS)}"
        )
    if colon and not which:
        raise ConfigError(f"{spec}: no parameter set after the colon")
    file = law_file(spec)
    code, law, measured = _LAWS[name](which)
    return Reflectance(f"{name}:{file.name}" if file else spec, code, law, file, measured)


DEFAULT_MODEL = reflectance_model(DEFAULT_LAW)


def radiance_factor(
    model: Reflectance, incidence: ArrayLike, emission: ArrayLike, phase: ArrayLike
) -> Array:
    """I/F of a lit and visible facet by its angles in radians, broadcast against each other; 0 for
    an incidence of 90 deg or more.

    For models that depend on the azimuth, a phase that is impossible (below |i - e| or above i + e)
    is replaced by the nearest possible one.
    """
    angles = np.broadcast_arrays(*(np.asarray(a, np.float64) for a in (incidence, emission, phase)))
    mu0, mu, cos_g = (np.cos(np.ascontiguousarray(a).ravel()) for a in angles)
    values = kernel.factors(mu0, mu, cos_g, model.code, model.numbers)
    return np.asarray(values.reshape(angles[0].shape))


class Photometry(NamedTuple):
    """Radiance factor and photometric angles (radians), arrays of one shape."""

    radiance: Array
    incidence: Array
    emission: Array
    phase: Array


def photometry(
    normals: NDArray[np.floating],
    sun: Array,
    cameras: Array,
    lit: NDArray[np.bool_],
    seen: NDArray[np.bool_],
    model: Reflectance = DEFAULT_MODEL,
) -> Photometry:
    """Radiance factor and angles of points: normals (..., 3), directions to the Sun (3,) and to the
    camera (3,) or (..., 3).

    Radiance is 0 for points that are visible but not lit, and NaN for points that are not visible.
    All values are NaN without a normal.
    """
    bands = kernel.shade_points(
        _flat(normals),
        np.ascontiguousarray(sun, dtype=np.float64),
        _flat(cameras),
        np.ravel(lit),
        np.ravel(seen),
        model.code,
        model.numbers,
    )
    return Photometry(*(band.reshape(normals.shape[:-1]) for band in bands))


def radiance_under(
    normals: NDArray[np.floating],
    sun: Array,
    cameras: Array,
    lit: NDArray[np.bool_],
    model: Reflectance = DEFAULT_MODEL,
) -> Array:
    """Radiance factor (...) of visible points; shapes as in `photometry`. 0 for points that are not
    lit.
    """
    towards_sun = np.ascontiguousarray(sun, dtype=np.float64)
    values = kernel.radiance_of_points(
        _flat(normals), towards_sun, _flat(cameras), np.ravel(lit), model.code, model.numbers
    )
    return np.asarray(values.reshape(normals.shape[:-1]))


class NodeBands(NamedTuple):
    """Bands of nodes (rows, cols), float32, angles in degrees. ``lit_side``, ``near_side``: True
    for nodes that face the first light and the camera.
    """

    radiance: NDArray[np.float32]
    incidence_deg: NDArray[np.float32]
    emission_deg: NDArray[np.float32]
    phase_deg: NDArray[np.float32]
    lit_side: NDArray[np.bool_]
    near_side: NDArray[np.bool_]


def bands_of_nodes(
    normals: NDArray[np.float32],
    lights: Sequence[tuple[Array, NDArray[np.floating] | NDArray[np.bool_]]],
    camera: Array,
    model: Reflectance = DEFAULT_MODEL,
) -> NodeBands:
    """`photometry` of nodes under parallel lights and one parallel view, in single precision and
    ten times as fast.

    normals (rows, cols, 3); lights: direction (3,) and weight (rows, cols), the irradiance times
    the share that arrives; camera (3,). The angles refer to the first light. The radiance of nodes
    that face away from the camera is 0, not NaN.
    """
    planes = planes_of(normals)
    shape = normals.shape[:2]
    incidence, emission = np.empty(shape, np.float32), np.empty(shape, np.float32)
    lit_side, near_side = np.empty(shape, np.bool_), np.empty(shape, np.bool_)
    sun = np.asarray(lights[0][0], np.float64)
    images.angles_deg(planes, sun, incidence, lit_side)
    images.angles_deg(planes, camera, emission, near_side)
    across = float(np.linalg.norm(np.cross(sun, camera)))
    phase = np.full(shape, math.degrees(math.atan2(across, float(sun @ camera))), np.float32)
    phase[np.isnan(incidence)] = np.nan
    if len(lights) == 1 and lights[0][1].dtype == np.bool_:
        dark = np.logical_not(lights[0][1]).view(np.uint8)
        radiance = radiance_of_nodes(planes, sun, camera, dark, np.zeros(shape, np.bool_), model)
        return NodeBands(radiance, incidence, emission, phase, lit_side, near_side)
    radiance = np.zeros(shape, np.float32)
    for direction, weight in lights:
        towards, share = np.asarray(direction, np.float64), np.asarray(weight, np.float32)
        images.add_light(radiance, planes, towards, camera, share, model.code, model.numbers)
    return NodeBands(radiance, incidence, emission, phase, lit_side, near_side)


def planes_of(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """The components of normals (rows, cols, 3), each a raster: (3, rows, cols)."""
    return np.ascontiguousarray(np.moveaxis(normals, -1, 0))


SLOPE_STEP = 0.01
"""Difference of slope at which derivatives of the radiance with respect to the slopes are taken."""


def steeper(planes: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """`planes_of` the normals of the same terrain with slopes larger by `SLOPE_STEP`, towards east
    and towards south.
    """
    east, south = planes.copy(), planes.copy()
    east[0] -= np.float32(SLOPE_STEP) * planes[2]
    south[1] += np.float32(SLOPE_STEP) * planes[2]
    lengths = (np.sqrt((turned * turned).sum(axis=0)) for turned in (east, south))
    first, second = (turned / length for turned, length in zip((east, south), lengths, strict=True))
    return first, second


def differences(
    radiance: NDArray[np.float32],
    east: NDArray[np.float32],
    south: NDArray[np.float32],
    step: float,
    factors: NDArray[np.float32] | None,
    out: NDArray[np.float32],
) -> bool:
    """Write the radiance of nodes (rows, cols), and the derivatives that follow from that of the
    `steeper` nodes, all times the albedo's factors, into out (3, rows, cols); derivatives are 0 where a
    radiance is missing. Return True if none is.
    """
    own = np.ones((1, 1), np.float32) if factors is None else factors
    return bool(images.differences(radiance, east, south, np.float32(1.0 / step), own, out))


def radiance_of_nodes(
    planes: NDArray[np.float32],
    sun: Array,
    camera: Array,
    dark: NDArray[np.uint8],
    unseen: NDArray[np.bool_],
    model: Reflectance = DEFAULT_MODEL,
) -> NDArray[np.float32]:
    """Radiance factor (rows, cols) of nodes under one distant point source and one parallel view, in
    single precision; for renders and for the images of a build.

    planes: `planes_of` the normals; sun, camera (3,): unit vectors; dark, unseen (rows, cols): nodes
    that terrain keeps from the Sun or from the camera. 0 where seen but not lit; NaN where hidden, on
    the far side, or without a normal.
    """
    return np.asarray(
        images.shade_nodes(planes, sun, camera, dark, unseen, model.code, model.numbers)
    )


@dataclass(frozen=True, eq=False)
class NearLight:
    """Nodes under one distant point source, seen by a camera so near that every node has its own
    direction to it.

    sun (3,): unit vector; cameras (3, rows, cols), float32: components of the nodes' unit vectors.
    """

    sun: Array
    cameras: NDArray[np.float32]
    model: Reflectance = DEFAULT_MODEL

    @cached_property
    def _terms(self) -> NDArray[np.float32]:
        return np.asarray(
            images.terms_of_nodes(self.sun, self.cameras, self.model.code, self.model.numbers)
        )

    def radiance(
        self,
        planes: NDArray[np.float32],
        dark: NDArray[np.uint8],
        unseen: NDArray[np.bool_],
    ) -> NDArray[np.float32]:
        """Radiance factor (rows, cols); arguments and result as in `radiance_of_nodes`."""
        if self.model.code <= kernel.LUNAR_LAMBERT:
            values = images.shade_nodes_from(
                planes, self.sun, self.cameras, dark, unseen, self._terms
            )
            return np.asarray(values)
        normals, cameras = (np.moveaxis(v, 0, -1) for v in (planes, self.cameras))
        cameras = cameras / np.linalg.norm(cameras.astype(np.float64), axis=-1, keepdims=True)
        values = radiance_under(normals, self.sun, cameras, dark == 0, self.model)
        hidden = unseen | ~(np.sum(normals * cameras, axis=-1) > 0.0)
        return np.where(hidden, np.nan, values).astype(np.float32)


def _flat(vectors: NDArray[np.floating]) -> Array:
    return np.ascontiguousarray(vectors, dtype=np.float64).reshape(-1, 3)
