"""The patches of a catalogue as terrain for frames: islands with nothing between them.

Each patch is rendered in its own frame from its own nodes alone, as a navigator does: terrain
around it, which the catalogue does not hold, neither shadows nor hides it. Where patches overlap,
the surface nearest to the camera is seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..accuracy import TIERS, Accuracy
from ..arrays import Array
from ..cameras.frame_camera import Camera
from ..cameras.scanners import Scanner
from ..cameras.view import finest_pixel_m
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..catalog.patch_terrain import patch_terrain
from ..errors import CatalogError
from ..geometry.frames import EnuFrame
from ..light.environment import Environment
from ..light.solar_disc import SolarDisc, radius_at
from ..light.sources import Lighting
from ..light.sun_choice import SunChoice
from ..photometry.laws import DEFAULT_MODEL, Reflectance
from ..rendering.renderer import Method, render_camera
from ..terrain.heightfield import Heightfield
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .frame import source_position, sun_position, windowed

Window = tuple[int, int, int, int]

_HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True, eq=False)
class PatchAlbedo:
    """The albedo factors of a patch, linear on the surface's triangles."""

    factors: Heightfield

    def at_nodes(self, terrain: Terrain) -> NDArray[np.float32]:
        """At the patch's nodes, (rows, cols)."""
        return self.factors.z_m

    def at_points(self, terrain: Terrain, points: Array) -> Array:
        """At ENU points (n, 3)."""
        return self.factors.heights_at(points[:, 0], points[:, 1])


@dataclass(frozen=True, eq=False)
class PatchTerrain:
    """The patch of one point as a terrain; its core is the whole patch."""

    terrain: Terrain
    albedo: PatchAlbedo | None

    @classmethod
    def of(cls, catalog: Catalog, row: int) -> PatchTerrain:
        """The patch of the point in a row of the catalogue."""
        terrain = patch_terrain(catalog, row)
        if catalog.albedo is None:
            return cls(terrain, None)
        return cls(terrain, PatchAlbedo(replace(terrain.field, z_m=catalog.albedo[row])))

    def window(self, camera: Camera | Scanner) -> Window | None:
        """Rows and columns of a camera's image in which the patch may be seen (half open: first
        row, row after the last, first column, column after the last); None if it is outside.
        """
        whole = self.terrain.core
        nodes = self.terrain.frame.to_mcmf(nodes_enu(self.terrain.field, whole)).reshape(-1, 3)
        pixels = camera.project(nodes)
        pixels = pixels[np.isfinite(pixels).all(axis=-1)]
        if not len(pixels):
            return None
        (col0, row0), (col1, row1) = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0)) + 1
        rows, cols = camera.shape
        row0, row1 = max(int(row0), 0), min(int(row1), rows)
        col0, col1 = max(int(col0), 0), min(int(col1), cols)
        return (row0, row1, col0, col1) if row0 < row1 and col0 < col1 else None


@dataclass(frozen=True, eq=False)
class PatchSurface:
    """A catalogue's patches under the Sun at a position, (3,) MCMF metres; ``model`` None:
    `DEFAULT_MODEL`; ``path``: the catalogue's file, if it was read from one; ``environment``: an environment map in place of
    the Sun, in each patch's own frame.
    """

    catalog: Catalog
    path: Path | None
    sun_position_mcmf_m: Array
    model: Reflectance | None = None
    accuracy: Accuracy = TIERS["reference"]
    disc: bool | None = None
    environment: Environment | None = None

    @classmethod
    def lit(
        cls,
        source: CatalogOrPath,
        choice: SunChoice,
        camera: Camera | Scanner,
        environment: Environment | None = None,
        model: Reflectance | None = None,
        accuracy: Accuracy = TIERS["reference"],
        disc: bool | None = None,
    ) -> PatchSurface:
        """A catalogue, or its file, under a chosen Sun, whose angles are those at the middle of the
        catalogue's map, or under an environment map. CatalogError for a catalogue without points.
        """
        catalog = opened_catalog(source)
        if not len(catalog):
            raise CatalogError("the catalogue has no points")
        path = None if isinstance(source, Catalog) else Path(source)
        middle = EnuFrame(catalog.overview.center_lon, catalog.overview.center_lat)
        place = (
            sun_position(choice, middle, camera)
            if environment is None
            else source_position(environment, middle)
        )
        return cls(catalog, path, place, model, accuracy, disc, environment)

    @property
    def sources(self) -> tuple[Path, ...]:
        own = () if self.path is None else (self.path,)
        return (*own, *(self.environment.files if self.environment else ()))

    @cached_property
    def patches(self) -> list[PatchTerrain]:
        """All patches, in the catalogue's order."""
        return [PatchTerrain.of(self.catalog, row) for row in range(len(self.catalog))]

    def cells_per_pixel(self, camera: Camera | Scanner) -> float:
        if isinstance(camera, Scanner):
            return finest_pixel_m(camera) / float(np.median(self.catalog.gsd))
        away_m = np.linalg.norm(self.catalog.position_mcmf - camera.position_mcmf_m, axis=1)
        return float(np.median(away_m / camera.focal_length_px / self.catalog.gsd))

    def radiance(self, camera: Camera | Scanner) -> Array:
        out = np.full(camera.shape, np.nan)
        nearest_m = np.full(camera.shape, np.inf)
        for patch in self.patches:
            window = patch.window(camera)
            if window is None:
                continue
            row0, row1, col0, col1 = window
            part = np.s_[row0:row1, col0:col1]
            light, range_m = self._rendered(patch, windowed(camera, window))
            nearer = range_m < nearest_m[part]
            out[part][nearer], nearest_m[part][nearer] = light[nearer], range_m[nearer]
        return out

    def _rendered(self, patch: PatchTerrain, camera: Camera | Scanner) -> tuple[Array, Array]:
        """Radiance factor and range of one patch; NaN and inf where it is not seen."""
        terrain = patch.terrain
        how = Method(model=self._law, accuracy=self.accuracy, albedo=patch.albedo)
        shot = render_camera(terrain, camera, self._light(terrain.frame), how)
        assert shot.position_mcmf_m is not None
        origin, _ = camera.rays_enu(terrain.frame)
        from_m = origin if isinstance(camera, Camera) else origin[:, None]
        away_m = np.linalg.norm(terrain.frame.from_mcmf(shot.position_mcmf_m) - from_m, axis=-1)
        seen = np.isfinite(shot.radiance)
        return np.asarray(shot.radiance), np.where(seen, away_m, np.inf)

    def _light(self, frame: EnuFrame) -> Lighting:
        """The light in a patch's frame."""
        if self.environment is not None:
            return self.environment.lighting
        towards = self.sun_position_mcmf_m - frame.origin_mcmf_m
        away_m = float(np.linalg.norm(towards))
        disc = self.accuracy.disc if self.disc is None else self.disc
        sun = frame.direction_from_mcmf(towards / away_m)
        return Lighting.of_sun(sun, SolarDisc(radius_at(away_m)) if disc else False)

    @cached_property
    def _law(self) -> Reflectance:
        return DEFAULT_MODEL if self.model is None else self.model


def is_catalog(path: Path | str) -> bool:
    """True if a file begins as HDF5 does; False if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return file.read(len(_HDF5)) == _HDF5
    except OSError:
        return False
