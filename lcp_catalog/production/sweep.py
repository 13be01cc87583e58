"""All images of an area: its Suns and views, the scene plan that holds for all of them, and the images.

Angles belong to the area's centre; ``turn_rad`` rotates all azimuths, for points whose meridian
converges with the centre's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..accuracy import Accuracy
from ..arrays import Array, Float32, Index, Mask
from ..cameras.view import CameraView, ParallelView, slant_range_m
from ..choices import BOUNCES, SUN_SHAPES
from ..ephemeris.solar_position import reachable_suns
from ..geometry.frames import direction_enu
from ..landmarks.corners import WHOLE, Part
from ..light.bounced_light import (
    BOUNCE_RMS,
    SHOWS,
    bounced_at_points,
    bounced_bound,
    bounced_sample,
)
from ..light.solar_disc import sunlit_share
from ..light.sources import Lighting, SurfacePoints
from ..photometry.albedo_map import AlbedoMap, neutral
from ..photometry.law_choice import LawChoice, choose, named
from ..photometry.laws import (
    SLOPE_STEP,
    NearLight,
    Reflectance,
    differences,
    planes_of,
    radiance_of_nodes,
    steeper,
)
from ..rendering import decisions
from ..rendering.decisions import Decision
from ..rendering.plan import ScenePlan, is_vertical, plan_scene
from ..stages import timed
from ..terrain.far_terrain import FarTerrain
from ..terrain.heightfield import Heightfield, Window
from ..terrain.occlusion import occluded, occluded_sweep
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .build_decisions import of_a_build, scattered_of_matches
from .config import BuildConfig

BANDS_DEG = (12.5, 37.5)
"""Elevations between low, middle and high Suns."""

SECTORS = 4
"""Sectors of the Sun's azimuth, the first around north."""


@dataclass(frozen=True)
class Conditions:
    """The views and Sun directions of the catalogue, and which Sun directions can occur at a latitude."""

    off_nadir_deg: Array
    view_azimuth_deg: Array
    view_altitude_km: Array  # inf: parallel rays
    sun_elevation_deg: Array
    sun_azimuth_deg: Array
    reachable: Mask  # (elevation, azimuth)

    @classmethod
    def at(cls, lat_deg: float, config: BuildConfig) -> Conditions:
        """The conditions of a configuration at a latitude."""
        azimuths = np.array(config.sun.azimuths_deg)
        elevations = np.array(config.sun.elevations_deg)
        return cls(
            off_nadir_deg=np.array(config.view.off_nadir_deg),
            view_azimuth_deg=np.array(config.view.azimuth_deg),
            view_altitude_km=np.array(config.view.altitude_km),
            sun_elevation_deg=elevations,
            sun_azimuth_deg=azimuths,
            reachable=reachable_suns(lat_deg, azimuths, elevations),
        )

    @property
    def sun_groups(self) -> Index:
        """Number of the group of each Sun, (elevation, azimuth): `SECTORS` for each of the `BANDS_DEG`."""
        band = np.digitize(self.sun_elevation_deg, BANDS_DEG)
        sector = np.floor(self.sun_azimuth_deg / 360.0 * SECTORS + 0.5).astype(np.int64) % SECTORS
        return np.asarray(SECTORS * band[:, None] + sector)

    @property
    def view_ranges_m(self) -> Array:
        """Distances from a point to the cameras of the views, (view,); inf for parallel rays."""
        views = zip(self.off_nadir_deg, self.view_altitude_km, strict=True)
        return np.array([view_range_m(off, km) for off, km in views])

    @property
    def shape(self) -> tuple[int, int, int]:
        """Views, Sun elevations, Sun azimuths."""
        return (len(self.off_nadir_deg), *self.reachable.shape)

    @property
    def count(self) -> int:
        """Number of conditions that can occur."""
        return len(self.off_nadir_deg) * int(self.reachable.sum())

    def sun_directions(self, turn_rad: float = 0.0) -> Array:
        """Unit ENU vectors to the Suns of the grid, (elevation, azimuth, 3), turned in azimuth."""
        azimuths = self.sun_azimuth_deg + np.degrees(turn_rad)
        return direction_enu(azimuths, self.sun_elevation_deg[:, None])

    def view_directions(self, turn_rad: float = 0.0) -> Array:
        """Unit ENU vectors to the cameras of the views, (view, 3), turned in azimuth."""
        azimuths = self.view_azimuth_deg + np.degrees(turn_rad)
        return direction_enu(azimuths, 90.0 - self.off_nadir_deg)


def law_of_build(config: BuildConfig, lat_deg: float) -> LawChoice:
    """The reflectance model for all images of a build around a latitude: the configured one, or the choice
    for the most demanding of its Suns and views. ConfigError for an unknown name.
    """
    conditions = Conditions.at(lat_deg, config)
    suns = conditions.sun_directions()[conditions.reachable]
    if not len(suns):
        suns = np.array([[0.0, 0.0, 1.0]])
    views = conditions.view_directions()
    pairs = np.array([(sun, view) for sun in suns for view in views])[:, :, None]
    asked = named(config.model.reflectance)
    return choose(config.model.precision, pairs[:, 0], pairs[:, 1], requested=asked)


@dataclass(frozen=True)
class RenderedImage:
    """The image of one condition: radiance factor, 0 in shadow, NaN where not visible."""

    view: int
    elevation: int
    azimuth: int
    radiance: NDArray[np.float32]

    @property
    def sun(self) -> tuple[int, int]:
        """Indices of the Sun's elevation and azimuth."""
        return self.elevation, self.azimuth


@dataclass(frozen=True)
class RenderedImages:
    """The images of k conditions. ``conditions`` (k, 3): indices of view, elevation and azimuth;
    ``radiance`` (k, rows, cols) as in `RenderedImage`; ``slopes`` (2, k, some rows, some cols): its derivatives
    with respect to the terrain's slopes towards east and south in a part of the images, 0 where not visible; ``complete``:
    True if all nodes are visible.
    """

    conditions: Index
    radiance: Float32
    slopes: Float32
    complete: bool


def _cut(raster: Any, part: Part) -> Any:
    """A part of a raster (..., rows, cols), contiguous."""
    return np.ascontiguousarray(raster[..., *part])


def plan_area(
    terrain: Terrain,
    conditions: Conditions,
    config: BuildConfig,
    choice: LawChoice,
    surroundings: Decision,
    albedo: Decision | None,
) -> ScenePlan:
    """The decisions for all images of an area: those of a render under its lowest Sun and from its
    lowest view, which hold for all others, and what is particular to a build.
    """
    lowest_deg = conditions.sun_elevation_deg[conditions.reachable.any(axis=1)]
    lowest_sun_deg = float(min(lowest_deg, default=conditions.sun_elevation_deg[0]))
    sun = direction_enu(0.0, lowest_sun_deg)
    off_nadir_deg = lowest_off_nadir_deg(config)
    view = ParallelView(direction_enu(0.0, 90.0 - off_nadir_deg))
    plan = plan_scene(
        terrain,
        sun,
        view,
        ring=surroundings,
        accuracy=config.model.precision,
        model=choice.model,
        choice=choice,
        albedo=albedo,
        lowest=True,
        scattered=_scattered(terrain, sun, view, config, choice),
        disc=config.model.sun == SUN_SHAPES[1],
    )
    own = of_a_build(
        config.model.direction_tolerance_deg,
        config.model.precision.own_sun_deg,
        config.sun.elevations_deg,
    )
    angle_rad = max(view_angles_rad(config))
    return replace(
        plan,
        solar_disc=decisions.disc_of_matches(plan.solar_disc, lowest_sun_deg),
        perspective=decisions.perspective_of_patches(angle_rad, _tolerance_rad(config)),
        others=(*plan.others, *own),
    )


def _scattered(
    terrain: Terrain, sun: Array, view: ParallelView, config: BuildConfig, choice: LawChoice
) -> Decision:
    """The decision about light by way of other ground."""
    tier, model, asked = (
        config.model.precision.tier,
        choice.model,
        config.model.bounce or BOUNCES[2],
    )
    sample = None
    if asked == BOUNCES[1]:
        sample = bounced_sample(terrain, Lighting.of_sun(sun), view.direction, model)
    bound = bounced_bound(terrain.field, model)
    node = decisions.bounced_light(
        asked, decisions.SUN_ALONE, bound, sample, BOUNCE_RMS[tier], SHOWS[tier]
    )
    return scattered_of_matches(node)


def view_range_m(off_nadir_deg: float, altitude_km: float) -> float:
    """Distance from a point to a camera ``altitude_km`` above it; inf for parallel rays."""
    if math.isinf(altitude_km):
        return math.inf
    return slant_range_m(off_nadir_deg, 1e3 * altitude_km)


def view_angles_rad(config: BuildConfig) -> list[float]:
    """For each view the greatest angle between the directions to its camera from a point and from a
    node of its patch or search region, heights not considered; 0 for parallel rays.
    """
    points, gsd_m = config.points, config.gsd_m
    reach_m = (points.half + points.search_nodes(gsd_m)) * gsd_m * math.sqrt(2.0)
    views = zip(config.view.off_nadir_deg, config.view.altitude_km, strict=True)
    return [math.asin(min(1.0, reach_m / view_range_m(off, km))) for off, km in views]


_LOWEST_VIEW_DEG = 89.0
"""Greatest angle from the vertical of rays to near cameras for which terrain around an area is read."""


def lowest_off_nadir_deg(config: BuildConfig) -> float:
    """Greatest angle from the vertical, degrees, of a direction from a node to the camera of a view."""
    pairs = zip(config.view.off_nadir_deg, view_angles_rad(config), strict=True)
    tolerance = _tolerance_rad(config)
    return max(
        off if angle <= tolerance else max(off, min(off + math.degrees(angle), _LOWEST_VIEW_DEG))
        for off, angle in pairs
    )


def _tolerance_rad(config: BuildConfig) -> float:
    return math.radians(config.model.direction_tolerance_deg)


Shading = Callable[[NDArray[np.float32], NDArray[np.uint8], Mask], NDArray[np.float32]]

PART_STEP = 16
"""Nodes between possible first rows and columns of a part of a sweep: a multiple of every image scale
up to 16, so that the pixels of coarser images are those of the whole."""


_disc_share = timed("solar disc", is_stage=False)(sunlit_share)


@dataclass(frozen=True)
class Sweep:
    """All images of a terrain's core under the conditions, one after the other, as the scene plan
    says. The radiance of nodes is that of a render (`photometry.laws.radiance_of_nodes`).
    """

    terrain: Terrain
    conditions: Conditions
    plan: ScenePlan
    model: Reflectance
    accuracy: Accuracy
    turn_rad: float = 0.0
    brightness: NDArray[np.float32] | None = None
    """Relative albedo of the core's nodes, NaN where it is not known; None without a map."""
    albedo: AlbedoMap | None = None
    """The map of `brightness`, for the ground that light reaches a node from."""
    point_m: Array | None = None
    """ENU position (3,) of the point over which the cameras of near views are; None: all views have
    parallel rays."""

    @property
    def field(self) -> Heightfield:
        """The heightfield."""
        return self.terrain.field

    @property
    def window(self) -> Window:
        """The core: the part of the heightfield that is rendered."""
        return self.terrain.core

    @property
    def far(self) -> FarTerrain | None:
        """The terrain beyond the heightfield."""
        return self.terrain.far

    def around(
        self, rows: NDArray[np.int64], cols: NDArray[np.int64], margin: int, turn_rad: float
    ) -> tuple[Sweep, int, int]:
        """The sweep of the part of the core within ``margin`` nodes of the given nodes, with a turn;
        and the part's first row and column in the core, which are multiples of `PART_STEP`.
        """
        height, width = self.planes.shape[1:]
        row0, col0 = (
            max(0, int(at.min()) - margin) // PART_STEP * PART_STEP for at in (rows, cols)
        )
        row1, col1 = (
            min(size, int(at.max()) + margin + 1) for size, at in ((height, rows), (width, cols))
        )
        top, _, left, _ = self.window
        core = (top + row0, top + row1, left + col0, left + col1)
        part = np.s_[row0:row1, col0:col1]
        sweep = replace(
            self,
            terrain=replace(self.terrain, core=core),
            turn_rad=turn_rad,
            brightness=None if self.brightness is None else self.brightness[part],
        )
        if turn_rad == self.turn_rad:  # these shadows are known
            masks = ((azimuth, mask[:, *part]) for azimuth, mask in self.shadows.items())
            sweep.shadows.update((azimuth, np.ascontiguousarray(mask)) for azimuth, mask in masks)
        return sweep, row0, col0

    def some(self, view: int, suns: Mask) -> Sweep:
        """The sweep of one view and of some of the Suns that can occur, (elevation, azimuth)."""
        own = self.conditions
        views = {
            name: getattr(own, name)[view : view + 1]
            for name in ("off_nadir_deg", "view_azimuth_deg", "view_altitude_km")
        }
        sweep = replace(self, conditions=replace(own, **views, reachable=suns))
        for azimuth, mask in self.shadows.items():
            sweep.shadows[azimuth] = mask[suns[own.reachable[:, azimuth], azimuth]]
        return sweep

    def over(self, row: int, col: int, margin: int) -> tuple[Sweep, int, int]:
        """`around` one node of the core, with the cameras of near views over that node."""
        rows, cols = np.array([row]), np.array([col])
        sweep, row0, col0 = self.around(rows, cols, margin, self.turn_rad)
        top, left = self.window[0] + row, self.window[2] + col
        point = nodes_enu(self.field, (top, top + 1, left, left + 1))[0, 0]
        own = replace(sweep, point_m=point)
        own.shadows.update(sweep.shadows)
        return own, row0, col0

    @cached_property
    def near_views(self) -> Mask:
        """True for views whose rays are not parallel, (view,)."""
        finite = np.isfinite(self.conditions.view_altitude_km)
        return finite & self.plan.perspective.modelled

    def camera_m(self, view: int) -> Array | None:
        """ENU position (3,) of the camera of a near view; None for parallel rays."""
        if self.point_m is None or not self.near_views[view]:
            return None
        away_m = self.conditions.view_ranges_m[view]
        return np.asarray(self.point_m + away_m * self.view_directions[view])

    def towards_camera(self, view: int) -> NDArray[np.float32] | None:
        """Components (3, rows, cols) of the core's nodes' directions to the camera of a near view;
        None for parallel rays. Computed once and kept.
        """
        camera = self.camera_m(view)
        if camera is not None and view not in self._towards:
            nodes = nodes_enu(self.field, self.window)
            towards = CameraView(camera).directions(nodes).astype(np.float32)
            self._towards[view] = planes_of(towards)
        return self._towards.get(view)

    @cached_property
    def _towards(self) -> dict[int, NDArray[np.float32]]:
        return {}

    @cached_property
    def normals(self) -> NDArray[np.float32]:
        """Unit normals of the core's nodes, (rows, cols, 3)."""
        return self.field.normals(self.window)

    @cached_property
    def planes(self) -> NDArray[np.float32]:
        """The normals' components, each a raster, (3, rows, cols)."""
        return planes_of(self.normals)

    @cached_property
    def sun_directions(self) -> Array:
        """Unit ENU vectors to the Suns, (elevation, azimuth, 3)."""
        return self.conditions.sun_directions(self.turn_rad)

    @cached_property
    def view_directions(self) -> Array:
        """Unit ENU vectors to the cameras, (view, 3)."""
        return self.conditions.view_directions(self.turn_rad)

    def unseen(self, view: int) -> Mask:
        """The nodes that terrain hides in a view. Computed once and kept."""
        if view not in self._unseen:
            self._unseen[view] = self._hidden(view)
        return self._unseen[view]

    @cached_property
    def _unseen(self) -> dict[int, Mask]:
        return {}

    @timed("occlusion", is_stage=False)
    def _hidden(self, view: int) -> Mask:
        direction, camera = self.view_directions[view], self.camera_m(view)
        if camera is not None and self.plan.occlusion.modelled:
            return self.field.occluded_nodes_from(camera, self.window)
        if not self.plan.occlusion.modelled or is_vertical(direction):
            return np.zeros(self.normals.shape[:2], dtype=np.bool_)
        return occluded(self.field, direction, self.accuracy, self.window)

    @property
    def suns(self) -> list[tuple[int, NDArray[np.intp]]]:
        """The Sun azimuths with the elevations that can occur there, by their indices."""
        columns = [np.flatnonzero(column) for column in self.conditions.reachable.T]
        return [(azimuth, found) for azimuth, found in enumerate(columns) if len(found)]

    def dark(self, azimuth: int) -> NDArray[np.uint8]:
        """1 where terrain keeps the Sun from a node, uint8 (elevations, rows, cols), for the azimuth's
        elevations in `suns`. Computed once and kept.
        """
        if azimuth not in self.shadows:
            elevations = np.flatnonzero(self.conditions.reachable[:, azimuth])
            self.shadows[azimuth] = self._cast(azimuth, elevations)
        return self.shadows[azimuth]

    @cached_property
    def shadows(self) -> dict[int, NDArray[np.uint8]]:
        """What `dark` has computed, by azimuth."""
        return {}

    @timed("cast shadows", is_stage=False)
    def _cast(self, azimuth: int, elevations: NDArray[np.intp]) -> NDArray[np.uint8]:
        if not self.plan.cast_shadows.modelled:
            return np.zeros((len(elevations), *self.normals.shape[:2]), dtype=np.uint8)
        azimuth_rad = np.radians(self.conditions.sun_azimuth_deg[azimuth]) + self.turn_rad
        elevations_rad = np.radians(self.conditions.sun_elevation_deg[elevations])
        return occluded_sweep(
            self.field, float(azimuth_rad), elevations_rad, self.accuracy, self.window, self.far
        )

    @cached_property
    def factors(self) -> NDArray[np.float32] | None:
        """Albedo factors of the core's nodes, 1 where the map has none; None if albedo is not
        modelled.
        """
        if not self.plan.albedo.modelled or self.brightness is None:
            return None
        return neutral(self.brightness)

    def shading(self, condition: tuple[int, int, int], part: Part = WHOLE) -> Shading:
        """The function of normals and masks that gives the radiance factor of nodes of a part of the core in a condition
        (view, elevation, azimuth); arguments as in `photometry.laws.NearLight.radiance`.
        """
        view, elevation, azimuth = condition
        sun, towards = self.sun_directions[elevation, azimuth], self.towards_camera(view)
        if towards is not None:
            return NearLight(sun, _cut(towards, part), self.model).radiance
        camera, model = self.view_directions[view], self.model
        return lambda planes, dark, unseen: radiance_of_nodes(
            planes, sun, camera, dark, unseen, model
        )

    def unshadowed(
        self, condition: tuple[int, int, int], part: Part = WHOLE
    ) -> NDArray[np.float32]:
        """A part of the image of a condition without cast shadows."""
        planes, hidden = (_cut(values, part) for values in (self.planes, self.unseen(condition[0])))
        dark = np.zeros(hidden.shape, np.uint8)
        radiance = self.shading(condition, part)(planes, dark, hidden)
        return radiance if self.factors is None else radiance * self.factors[part]

    @timed("reflectance", is_stage=False)
    def _image(
        self, condition: tuple[int, int, int], dark: NDArray[np.uint8], factors: Float32 | None
    ) -> Float32:
        radiance = self.shading(condition)(self.planes, dark, self.unseen(condition[0]))
        return radiance if factors is None else radiance * factors

    @timed("scattered light", is_stage=False)
    def _add_bounced(self, condition: tuple[int, int, int], image: Float32) -> None:
        """Add the light of other ground to the nodes of an image (rows, cols) that the Sun does not reach."""
        dark = image == 0.0  # NaN where not visible
        if not (self.plan.bounces and dark.any()):
            return
        view, elevation, azimuth = condition
        towards = self.towards_camera(view)
        seen = self.view_directions[view] if towards is None else towards[:, dark].T
        points = nodes_enu(self.field, self.window)[dark]
        normals, albedo = self.normals[dark].astype(np.float64), self.albedo
        added = bounced_at_points(
            self.terrain,
            Lighting.of_sun(self.sun_directions[elevation, azimuth]),
            SurfacePoints(points, normals, np.asarray(seen, np.float64)),
            self.model,
            self.accuracy,
            None
            if albedo is None
            else lambda at: np.asarray(albedo.at_points(self.terrain, at), np.float64),
        )
        image[dark] = added.astype(np.float32) * (
            1.0 if self.factors is None else self.factors[dark]
        )

    def images(self, views: tuple[int, ...] | None = None) -> Iterator[RenderedImage]:
        """Azimuth by azimuth, elevation by elevation, view by view (all views, or those given)."""
        for condition, dark, factors in self._lit(views):
            view, elevation, azimuth = condition
            radiance = self._image(condition, dark, factors)
            self._add_bounced(condition, radiance)
            yield RenderedImage(view, elevation, azimuth, radiance)

    def stacks(
        self, most: int, views: tuple[int, ...] | None = None, part: Part = WHOLE
    ) -> Iterator[RenderedImages]:
        """The `images`, at most ``most`` at a time, with their derivatives (forward differences) in a part of them."""
        wanted, planes = self._lit(views), _cut(self.planes, part)
        steep, size = steeper(planes), planes.shape[1:]
        while some := list(islice(wanted, most)):
            radiance = np.empty((len(some), *self.planes.shape[1:]), np.float32)
            bands = np.empty((3, len(some), *size), np.float32)
            for k, (condition, dark, factors) in enumerate(some):
                self._derived(condition, (dark, factors), part, steep, radiance[k], bands[:, k])
                self._add_bounced(condition, radiance[k])
            complete = bool(np.isfinite(radiance.sum()))
            conditions = np.array([condition for condition, *_ in some])
            yield RenderedImages(conditions, radiance, bands[1:], complete)

    @timed("reflectance", is_stage=False)
    def _derived(
        self,
        condition: tuple[int, int, int],
        lit: tuple[NDArray[np.uint8], Float32 | None],
        part: Part,
        steep: tuple[Float32, Float32],
        image: Float32,
        out: Float32,
    ) -> None:
        """Write the image of a condition (rows, cols) with the shadows and factors of ``lit``, and to ``out`` (3, some rows,
        some cols) a part of it with its derivatives, by the ``steeper`` normals of the part.
        """
        (dark, factors), hidden = lit, self.unseen(condition[0])
        base = self.shading(condition)(self.planes, dark, hidden)
        image[:] = base if factors is None else base * factors
        masks = [_cut(mask, part) for mask in (dark, hidden)]
        east, south = (self.shading(condition, part)(planes, *masks) for planes in steep)
        own = None if factors is None else _cut(factors, part)
        differences(_cut(base, part), east, south, SLOPE_STEP, own, out)

    def _lit(
        self, views: tuple[int, ...] | None
    ) -> Iterator[tuple[tuple[int, int, int], NDArray[np.uint8], Float32 | None]]:
        """Conditions with the shadows of their Suns and the `factors`, times the visible share of a Sun
        that is a disc, in the order of `images`.
        """
        wanted = range(len(self.conditions.off_nadir_deg)) if views is None else views
        for azimuth, elevations in self.suns:
            dark = None if self.plan.solar_disc.modelled else self.dark(azimuth)
            for slot, elevation in enumerate(elevations.tolist()):
                lit = self.factors
                if dark is None:
                    sun = self.sun_directions[elevation, azimuth]
                    share = _disc_share(self.field, sun, self.accuracy, self.window, far=self.far)
                    own = (share == 0.0).view(np.uint8)
                    lit = share if lit is None else share * lit
                else:
                    own = dark[slot]
                for view in wanted:
                    yield (view, elevation, azimuth), own, lit
