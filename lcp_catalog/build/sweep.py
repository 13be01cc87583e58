"""All images of an area: its Suns and views, the scene plan that holds for all of them, and the images.

Angles belong to the area's centre; ``turn_rad`` rotates all azimuths, for points whose meridian
converges with the centre's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..accuracy import Accuracy
from ..arrays import Array, Mask
from ..cameras.view import View, slant_range_m
from ..geometry.frames import direction_enu
from ..photometry.albedo_map import neutral
from ..photometry.law_choice import Choice, choose, named
from ..photometry.laws import SLOPE_STEP, Reflectance, planes_of, radiance_of_nodes, steeper
from ..rendering import decisions
from ..rendering.decisions import Decision
from ..rendering.plan import ScenePlan, is_vertical, plan_scene
from ..sun.reachable import reachable_suns
from ..terrain.far_terrain import FarTerrain
from ..terrain.heightfield import Heightfield, Window
from ..terrain.occlusion import occluded, occluded_sweep
from ..terrain.terrain import Terrain
from .config import BuildConfig


@dataclass(frozen=True)
class Conditions:
    """The views and Sun directions of the catalogue, and which Sun directions can occur at a latitude."""

    off_nadir_deg: Array
    view_azimuth_deg: Array
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
            sun_elevation_deg=elevations,
            sun_azimuth_deg=azimuths,
            reachable=reachable_suns(lat_deg, azimuths, elevations),
        )

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


def law_of_build(config: BuildConfig, lat_deg: float) -> Choice:
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
    """The image of one condition: radiance factor, 0 in shadow, NaN where not visible. ``slopes``: its
    derivatives with respect to the terrain's slopes towards east and south, if they were asked for.
    """

    view: int
    elevation: int
    azimuth: int
    radiance: NDArray[np.float32]
    slopes: tuple[NDArray[np.float32], ...] = ()

    @property
    def sun(self) -> tuple[int, int]:
        """Indices of the Sun's elevation and azimuth."""
        return self.elevation, self.azimuth

    @property
    def condition(self) -> tuple[int, int, int]:
        """Indices of view, elevation and azimuth."""
        return self.view, self.elevation, self.azimuth


def plan_area(
    terrain: Terrain,
    conditions: Conditions,
    config: BuildConfig,
    choice: Choice,
    surroundings: Decision,
    albedo: Decision | None,
) -> ScenePlan:
    """The decisions for all images of an area: those of a render under its lowest Sun and from its
    lowest view, which hold for all others, and what is particular to a build.
    """
    lowest_deg = conditions.sun_elevation_deg[conditions.reachable.any(axis=1)]
    sun = direction_enu(0.0, min(lowest_deg, default=conditions.sun_elevation_deg[0]))
    view = View(direction=conditions.view_directions()[conditions.off_nadir_deg.argmax()])
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
    )
    own = decisions.of_a_build(config.model.direction_tolerance_deg)
    patch_rad = _patch_angle_rad(config, terrain.field.gsd_m)
    return replace(
        plan,
        perspective=decisions.perspective_of_patches(patch_rad),
        others=(*plan.others, *own),
    )


def _patch_angle_rad(config: BuildConfig, gsd_m: float) -> float:
    """Greatest angle between the directions to a camera from a patch's nodes and from its point,
    slopes not considered; 0 where all views are at infinity.
    """
    views = zip(config.view.off_nadir_deg, config.view.altitude_km, strict=True)
    near = [slant_range_m(off, 1e3 * km) for off, km in views if math.isfinite(km)]
    half_m = config.points.half * gsd_m * math.sqrt(2.0)
    return max((math.asin(min(1.0, half_m / away_m)) for away_m in near), default=0.0)


PART_STEP = 16
"""Nodes between possible first rows and columns of a part of a sweep: a multiple of every image scale
up to 16, so that the pixels of coarser images are those of the whole."""


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

    def __post_init__(self) -> None:
        if self.plan.solar_disc.modelled or self.plan.perspective.modelled:
            raise ValueError("a sweep has a point Sun and parallel views")

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
            masks = ((azimuth, mask[:, *part]) for azimuth, mask in self._masks.items())
            sweep._masks.update((azimuth, np.ascontiguousarray(mask)) for azimuth, mask in masks)
        return sweep, row0, col0

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

    @cached_property
    def unseen(self) -> list[Mask]:
        """For each view the nodes that terrain hides."""
        return [self._hidden(direction) for direction in self.view_directions]

    def _hidden(self, direction: Array) -> Mask:
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
        if azimuth not in self._masks:
            elevations = np.flatnonzero(self.conditions.reachable[:, azimuth])
            self._masks[azimuth] = self._shadows(azimuth, elevations)
        return self._masks[azimuth]

    @cached_property
    def _masks(self) -> dict[int, NDArray[np.uint8]]:
        return {}

    def _shadows(self, azimuth: int, elevations: NDArray[np.intp]) -> NDArray[np.uint8]:
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

    @cached_property
    def steeper_planes(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """`planes` of the same terrain with larger slopes (`photometry.laws.steeper`)."""
        return steeper(self.planes)

    def shaded(
        self,
        planes: NDArray[np.float32],
        condition: tuple[int, int, int],
        dark: NDArray[np.uint8],
        unseen: Mask,
    ) -> NDArray[np.float32]:
        """Radiance factor of nodes in a condition (view, elevation, azimuth); the other arguments as
        in `photometry.laws.radiance_of_nodes`.
        """
        view, elevation, azimuth = condition
        sun, camera = self.sun_directions[elevation, azimuth], self.view_directions[view]
        return radiance_of_nodes(planes, sun, camera, dark, unseen, self.model)

    def unshadowed(self, condition: tuple[int, int, int]) -> NDArray[np.float32]:
        """The image of a condition without cast shadows."""
        none = np.zeros(self.planes.shape[1:], np.uint8)
        radiance = self.shaded(self.planes, condition, none, self.unseen[condition[0]])
        return radiance if self.factors is None else radiance * self.factors

    def images(
        self, views: tuple[int, ...] | None = None, sensitivity: bool = False
    ) -> Iterator[RenderedImage]:
        """Azimuth by azimuth, elevation by elevation, view by view (all views, or those given).
        ``sensitivity``: with the derivatives of the radiance (forward differences).
        """
        wanted = range(len(self.conditions.off_nadir_deg)) if views is None else views
        factors = self.factors
        for azimuth, elevations in self.suns:
            dark = self.dark(azimuth)
            for slot, elevation in enumerate(elevations):
                for view in wanted:
                    condition = (view, int(elevation), azimuth)
                    hidden = (dark[slot], self.unseen[view])
                    bands = [self.shaded(self.planes, condition, *hidden)]
                    for planes in self.steeper_planes if sensitivity else ():
                        change = self.shaded(planes, condition, *hidden) - bands[0]
                        bands.append(change * np.float32(1.0 / SLOPE_STEP))
                    if factors is not None:
                        bands = [band * factors for band in bands]
                    yield RenderedImage(*condition, bands[0], tuple(bands[1:]))
