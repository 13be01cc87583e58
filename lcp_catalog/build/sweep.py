"""Every Sun and view of a site over one area: directions, shadows from one scan an azimuth, and the images.

Angles belong to the area's centre; ``turn_rad`` rotates all azimuths, for points whose meridian converges with the centre's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..accuracy import Accuracy
from ..arrays import Array, Mask
from ..geometry.frames import direction_enu
from ..kernels.photometry.images import shade_nodes
from ..photometry.albedo_map import neutral
from ..photometry.law_choice import Choice, choose, named
from ..photometry.laws import Reflectance
from ..sun.reachable import reachable_suns
from ..terrain.far_terrain import FarTerrain
from ..terrain.heightfield import Heightfield, Window
from ..terrain.occlusion import occluded, occluded_sweep
from .config import BuildConfig


@dataclass(frozen=True)
class Conditions:
    """The catalogue's grid of views and Suns at a latitude, and which Sun cells can happen there at all."""

    off_nadir_deg: Array
    view_azimuth_deg: Array
    sun_elevation_deg: Array
    sun_azimuth_deg: Array
    reachable: Mask  # (elevation, azimuth)

    @classmethod
    def at(cls, lat_deg: float, config: BuildConfig) -> Conditions:
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
        """Conditions that can happen."""
        return len(self.off_nadir_deg) * int(self.reachable.sum())

    def sun_direction(self, elevation: int, azimuth: int, turn_rad: float) -> Array:
        """Unit ENU vector to the Sun of a cell of the grid."""
        turned = self.sun_azimuth_deg[azimuth] + np.degrees(turn_rad)
        return direction_enu(turned, self.sun_elevation_deg[elevation])

    def view_direction(self, view: int, turn_rad: float) -> Array:
        """Unit ENU vector to the camera of a view."""
        turned = self.view_azimuth_deg[view] + np.degrees(turn_rad)
        return direction_enu(turned, 90.0 - self.off_nadir_deg[view])


def law_of_build(config: BuildConfig, lat_deg: float) -> Choice:
    """The law of reflection for all images of a build around a latitude: the one configured, or the
    one that the worst of its Suns and views wants. ConfigError for a name that is none.
    """
    conditions = Conditions.at(lat_deg, config)
    suns = [
        conditions.sun_direction(int(e), int(a), 0.0) for e, a in np.argwhere(conditions.reachable)
    ] or [np.array([0.0, 0.0, 1.0])]
    views = [conditions.view_direction(v, 0.0) for v in range(len(conditions.off_nadir_deg))]
    pairs = np.array([(sun, view) for sun in suns for view in views])[:, :, None]
    asked = named(config.model.reflectance)
    return choose(config.model.precision, pairs[:, 0], pairs[:, 1], asked=asked)


@dataclass(frozen=True)
class RenderedImage:
    """One condition's picture of the window: radiance factor, 0 in shadow, NaN where nothing is seen."""

    view: int
    elevation: int
    azimuth: int
    radiance: NDArray[np.float32]


@dataclass(frozen=True)
class Sweep:
    """All images of a window of a heightfield under the conditions, one after the other."""

    field: Heightfield
    window: Window
    conditions: Conditions
    reflectance: Reflectance
    accuracy: Accuracy
    turn_rad: float = 0.0
    far: FarTerrain | None = None  # terrain beyond the field, for its shadows
    brightness: NDArray[np.float32] | None = None
    """Relative albedo of the window's nodes, NaN where it is not known; None: all ground alike."""

    @cached_property
    def normals(self) -> NDArray[np.float32]:
        return self.field.normals(self.window)

    @cached_property
    def planes(self) -> NDArray[np.float32]:
        """The normals' components, each a raster, (3, rows, cols)."""
        return np.ascontiguousarray(np.moveaxis(self.normals, -1, 0))

    @cached_property
    def unseen(self) -> list[Mask]:
        """For each view the nodes that terrain hides (nodata is NaN in the normals)."""
        views = range(len(self.conditions.off_nadir_deg))
        return [
            self._occluded(self.conditions.view_direction(view, self.turn_rad)) for view in views
        ]

    def _occluded(self, direction: Array) -> Mask:
        if direction[2] >= 1.0 - 1e-15:  # straight above: a heightfield hides nothing of itself
            return np.zeros(self.normals.shape[:2], dtype=np.bool_)
        return occluded(self.field, direction, self.accuracy, self.window)

    def images(self, views: tuple[int, ...] | None = None) -> Iterator[RenderedImage]:
        """Azimuth by azimuth, elevation by elevation, view by view (all views, or those named)."""
        wanted = range(len(self.conditions.off_nadir_deg)) if views is None else views
        law = (self.reflectance.code, self.reflectance.numbers)
        factors = None if self.brightness is None else neutral(self.brightness)
        for azimuth in range(len(self.conditions.sun_azimuth_deg)):
            elevations = np.flatnonzero(self.conditions.reachable[:, azimuth])
            if not len(elevations):
                continue
            azimuth_rad = np.radians(self.conditions.sun_azimuth_deg[azimuth]) + self.turn_rad
            elevations_rad = np.radians(self.conditions.sun_elevation_deg[elevations])
            dark = occluded_sweep(
                self.field, float(azimuth_rad), elevations_rad, self.accuracy, self.window, self.far
            )
            for slot, elevation in enumerate(elevations):
                sun = self.conditions.sun_direction(int(elevation), azimuth, self.turn_rad)
                for view in wanted:
                    camera = self.conditions.view_direction(view, self.turn_rad)
                    radiance = shade_nodes(
                        self.planes, sun, camera, dark[slot], self.unseen[view], *law
                    )
                    if factors is not None:
                        radiance *= factors
                    yield RenderedImage(view, int(elevation), azimuth, radiance)
