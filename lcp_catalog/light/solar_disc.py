"""The finite Sun: visible share of the limb-darkened solar disc above the terrain's horizon.

The disc is divided into vertical strips of equal width. For each strip, one exact horizon is
computed at the azimuth of its centre (the centroid of its flux); the flux of the strip above that
height is exact. A horizon that is level across the disc needs one strip and has no error. Only
nodes that may lie in a penumbra need horizons. Directions are unit ENU vectors, angles are radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..accuracy import Accuracy
from ..arrays import Array
from ..constants import ASTRONOMICAL_UNIT_M, SOLAR_RADIUS_RAD
from ..ephemeris.limb_darkening import VISIBLE, LimbDarkening, Strips, strips
from ..geometry.frames import Direction
from ..kernels.rays import bundles, horizon
from ..terrain import occlusion
from ..terrain.far_terrain import FarTerrain, HorizonPoints, Nodes, on_rim
from ..terrain.heightfield import Heightfield, Window

TRACE = 1e-5
"""Shares below this are set to 0 (and above 1 - TRACE to 1): three times the error of a share of 0
from the tables' steps."""

FIRST_STRIPS, MOST_STRIPS, CONVERGED = 16, 256, 1e-4
"""Without a number of strips in the tier: strips are doubled from the first number until no share changes by
``CONVERGED``, up to the second number.
"""

STEEP_RAD = math.radians(88.0)
"""Above this elevation, vertical planes fan out over the disc; it is sampled by directions instead.
"""

LEAN_MAX = 0.4
"""A large disc is sampled by directions, too, if the planes of its limbs lean more than this (the
Earth's disc: above 87.5 deg)."""

CHUNK = 1 << 16


@dataclass(frozen=True)
class SolarDisc:
    """Disc of the Sun or the Earth: angular radius ``radius_rad`` and limb darkening. ValueError
    for a radius of 0 or less, or of 2 deg or more.
    """

    radius_rad: float = SOLAR_RADIUS_RAD
    limb_darkening: LimbDarkening = VISIBLE

    def __post_init__(self) -> None:
        if not 0.0 < self.radius_rad < math.radians(2.0):
            raise ValueError(
                f"the radius of a disc must be between 0 and 2 deg, not {self.radius_rad} rad"
            )


MEAN_SUN = SolarDisc()


def radius_at(distance_m: float) -> float:
    """Angular radius of the solar disc at a distance in metres: asin(R / d), where R gives
    `SOLAR_RADIUS_RAD` at one astronomical unit. ValueError inside the Sun.
    """
    ratio = math.sin(SOLAR_RADIUS_RAD) * ASTRONOMICAL_UNIT_M / distance_m
    if not 0.0 < ratio < 1.0:
        raise ValueError(f"invalid distance to the Sun: {distance_m} m")
    return math.asin(ratio)


def penumbra_m(distance_m: ArrayLike, elevation_rad: float) -> Array:
    """Horizontal width of the penumbra of an edge on level terrain, metres, at one astronomical unit (r: `SOLAR_RADIUS_RAD`).

    The edge is at the height H = d tan(e) above the terrain, at the distance d from the shadow of
    the disc's centre. The shadows of its upper and lower limb end at H cot(e + r) and H cot(e - r):
    w = d tan(e) sin(2 r) / (sin(e - r) sin(e + r)), approximately 2 r d / (sin(e) cos(e)). Infinite
    if the disc touches the horizontal plane or is below it. For relief of height H, d = H / tan(e).
    """
    distance = np.asarray(distance_m, dtype=np.float64)
    r = SOLAR_RADIUS_RAD
    if elevation_rad <= r:
        return np.full(distance.shape, np.inf)
    low, high = math.sin(elevation_rad - r), math.sin(elevation_rad + r)
    return distance * (math.tan(elevation_rad) * math.sin(2.0 * r) / (low * high))


@dataclass(frozen=True)
class _Sun:
    """A disc in the sky over cells of ``gsd_m``."""

    disc: SolarDisc
    azimuth: float
    elevation: float
    gsd_m: float

    @property
    def radius(self) -> float:
        return math.tan(self.disc.radius_rad)

    @property
    def steep(self) -> bool:
        lean = self.radius * math.tan(min(abs(self.elevation), STEEP_RAD))
        return abs(self.elevation) > STEEP_RAD or lean > LEAN_MAX

    def directions(self, points: Array) -> Array:
        """Unit vectors (n, 3) to points (n, 2) of the tangent plane: right and up, in disc radii."""
        sa, ca = math.sin(self.azimuth), math.cos(self.azimuth)
        se, ce = math.sin(self.elevation), math.cos(self.elevation)
        middle, right = np.array([sa * ce, ca * ce, se]), np.array([ca, -sa, 0.0])
        up = np.array([-sa * se, -ca * se, ce])
        ahead = middle + self.radius * (points[:, :1] * right + points[:, 1:] * up)
        return np.asarray(ahead / np.linalg.norm(ahead, axis=1, keepdims=True))

    def planes(self, cut: Strips) -> tuple[Array, Array]:
        """Vertical planes (k, 4) of the strips for `horizon.node_horizons`, and each strip's
        tangent of a unit slope in the central plane (k,).

        A vertical plane at the angle t from the disc's centre meets the tangent plane at height y
        at the elevation tan(h) = cos(t) tan(e + atan(y tan r)).
        """
        turn = np.arctan(self.radius * cut.middle / math.cos(self.elevation))
        out, tangents = np.empty((turn.size, 4)), np.empty(turn.size)
        for k, t in enumerate(turn):
            azimuth = self.azimuth + t
            du, dv, _, _ = bundles.scaled(math.sin(azimuth), -math.cos(azimuth), 0.0)
            tangents[k] = 1.0 / (self.gsd_m * math.hypot(du, dv) * math.cos(t))
            low, high = (
                math.tan(self.elevation + math.atan(y * self.radius)) / tangents[k]
                for y in (cut.low[k], cut.high[k])
            )
            out[k] = du, dv, low, high
        return out, tangents

    def limits(self, gradient: float) -> tuple[float, float]:
        """Two elevations at the azimuth of the disc's centre: a horizon below the first hides
        nothing of the disc, a horizon above the second hides all of it, for skylines that are not
        steeper than ``gradient``.

        The tangent of a skyline's elevation changes with azimuth by at most the steepest gradient
        of the surface: at a fixed distance s, d(h / s) / d(azimuth) is the slope across. So the
        disc is clear of a horizon T if T + gradient |t| is below its limb at every angle t.
        """
        around = np.linspace(0.0, 2.0 * math.pi, 1441)
        ahead = self.directions(np.stack([np.cos(around), np.sin(around)], axis=-1) * (1.0 + 1e-4))
        tangent = ahead[:, 2] / np.hypot(ahead[:, 0], ahead[:, 1])
        turn = np.arctan2(ahead[:, 0], ahead[:, 1]) - self.azimuth
        slack = gradient * abs((turn + math.pi) % (2.0 * math.pi) - math.pi)
        most = math.radians(89.9)
        low, high = math.atan(np.min(tangent - slack)), math.atan(np.max(tangent + slack))
        return max(low, -most), min(high, most)


def _share(observers: Nodes | HorizonPoints, sun: _Sun, count: int) -> Array:
    """Visible share by ``count`` strips."""
    lean = sun.radius * math.tan(sun.elevation)
    if count < FIRST_STRIPS:
        lean = round(lean, 2)  # changes a share by less than 5e-4, and most Suns share their tables
    cut = strips(sun.disc.limb_darkening, count, lean)
    planes, tangents = sun.planes(cut)
    out = np.empty(len(observers))
    horizon.flux_above(
        observers.horizons(planes),
        tangents,
        math.sin(sun.elevation),
        math.cos(sun.elevation),
        sun.radius,
        cut.flux,
        out,
    )
    return out


def _converged(observers: Nodes | HorizonPoints, sun: _Sun) -> Array:
    """Visible share by as many strips as convergence needs."""
    out = _share(observers, sun, FIRST_STRIPS)
    open_, count = np.arange(len(observers)), FIRST_STRIPS
    while open_.size and count < MOST_STRIPS:
        count *= 2
        finer = _share(observers[open_], sun, count)
        moved = abs(finer - out[open_]) > CONVERGED
        out[open_] = finer
        open_ = open_[moved]
    return out


def _sampled(observers: Nodes | HorizonPoints, sun: _Sun, count: int) -> Array:
    """Visible share by directions of equal flux."""
    out = np.zeros(len(observers))
    for direction in sun.directions(sun.disc.limb_darkening.samples(count)):
        out += ~observers.occluded(direction)
    return out / count


def _rule(sun: _Sun, accuracy: Accuracy) -> Callable[[Nodes | HorizonPoints], Array]:
    if sun.steep:
        return lambda seen: _sampled(seen, sun, accuracy.disc_directions)
    if (count := accuracy.disc_strips) is None:
        return lambda seen: _converged(seen, sun)
    return lambda seen: _share(seen, sun, count)


def _shares(observers: Nodes | HorizonPoints, sun: _Sun, accuracy: Accuracy) -> Array:
    out, rule = np.empty(len(observers)), _rule(sun, accuracy)
    for first in range(0, len(observers), CHUNK):
        part = slice(first, first + CHUNK)
        out[part] = rule(observers[part])
    # rounding of the tables must not light a dark node
    out[out < TRACE] = 0.0
    out[out > 1.0 - TRACE] = 1.0
    return out


def disc_directions(direction: ArrayLike, disc: SolarDisc, accuracy: Accuracy) -> Array:
    """Unit ENU vectors (n, 3) of equal flux over a disc around a direction; n is a setting of the
    tier.
    """
    points = disc.limb_darkening.samples(accuracy.disc_directions)
    return _sun(direction, disc, 1.0).directions(points)


def _sun(direction: ArrayLike, disc: SolarDisc, gsd_m: float) -> _Sun:
    towards = Direction.of(direction)
    return _Sun(disc, towards.azimuth_rad, towards.elevation_rad, gsd_m)


def sunlit_share(
    field: Heightfield,
    sun: ArrayLike,
    accuracy: Accuracy,
    window: Window | None = None,
    disc: SolarDisc = MEAN_SUN,
    far: FarTerrain | None = None,
) -> NDArray[np.float32]:
    """Visible share of the disc's flux above the terrain's horizon at each node of the window,
    float32 (rows, cols), 0..1; ``sun`` (3,): direction to the disc's centre.

    Cast shadow only, as in `Heightfield.occluded_nodes`; 1 for nodata. Rms error relative to
    ``reference``: `Accuracy.disc_rms`. ``far``: terrain beyond the field. ValueError for an invalid
    direction or a window outside the field.
    """
    row0, row1, col0, col1 = field.checked_window(window)
    source = _sun(sun, disc, field.gsd_m)
    out = np.ones((row1 - row0, col1 - col0), dtype=np.float32)
    if not field.is_surface or out.size == 0:
        return out
    gradient = field.steepest_tangent
    lowest = source.elevation - disc.radius_rad
    if far is not None:
        # at the inner edge of a level the distance of the skyline changes with azimuth, too
        gradient = max(gradient, far.steepest_tangent) + math.tan(max(lowest, 0.0))
    elif not field.has_holes and lowest > 0.0 and gradient < math.tan(lowest):
        return out  # no horizon of an area without holes is steeper than its steepest facet
    if accuracy.shadows == "rays" or source.steep:
        undecided = np.isfinite(field.z_m[row0:row1, col0:col1])
    else:
        limits = source.limits(gradient)
        touched, dark = occlusion.occluded_sweep(
            field, source.azimuth, limits, accuracy, (row0, row1, col0, col1), far
        ).view(np.bool_)
        out[dark] = 0.0
        undecided = (touched & ~dark) | on_rim(field, (row0, row1, col0, col1))
    rows, cols = np.nonzero(undecided)
    out[rows, cols] = _shares(Nodes(field, rows + row0, cols + col0, far), source, accuracy)
    return out


def share_at_points(
    field: Heightfield,
    points_m: ArrayLike,
    sun: ArrayLike,
    accuracy: Accuracy,
    disc: SolarDisc = MEAN_SUN,
    far: FarTerrain | None = None,
) -> Array:
    """Visible share at points (n, 3) of the surface, such as the hits of a camera's rays, float64
    (n,).

    Points within 1 mm of the surface are moved onto it (`Heightfield.occluded_points`). The share
    is 0 for points further below, and 1 for NaN and for points outside the raster.
    """
    points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
    source = _sun(sun, disc, field.gsd_m)
    if not field.is_surface or len(points) == 0:
        return np.ones(len(points))
    return _shares(HorizonPoints(field, points, far), source, accuracy)
