"""Apollo 15 frames in windows: the image on the DEM's cells, renders, and other models for
comparison. Nothing is fitted to a frame except its camera (in advance, see the provenance of the
data) and the gain and offset of each window. The images are scans of film for display; `SRGB`
decodes them by the standard's curve, without a fit.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rasterio

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.effective_resolution import Resolution, of_file
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.images.image import Image
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.photometry.srgb import decode_srgb
from lcp_catalog.rendering.pipeline import HeightfieldScene, prepare_terrain
from lcp_catalog.rendering.renderer import Method, Rendering, render_enu
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.validation.ground_comparison import WindowComparison, compare, rendered_cell_m
from lcp_catalog.validation.orthoimage import Ortho, Pair, orthorectify, paired, terrain_nodes

from .apollo_frames import FRAMED, MARGIN_PX, YARDSTICKS

LINEAR, SRGB = "linear", "srgb"
LAW = "lunar-lambert"


def photograph(image: Path, camera: Path, encoding: str = SRGB) -> Image:
    """A frame; its border of `MARGIN_PX` pixels, with the notches of the film, has weight 0."""
    with rasterio.open(image) as file:
        codes = file.read(1).astype(np.float64)
    values = decode_srgb(codes / 255.0) if encoding == SRGB else codes
    weight = np.zeros(codes.shape, np.float32)
    weight[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] = 1.0
    sensor = read_camera(camera)
    sun = sensor.sun_position_mcmf_m
    return Image(image.name, values.astype(np.float32), weight, sensor, sun_position_mcmf_m=sun)


@dataclass(eq=False)
class Ground:
    """One frame and its terrain on cells of ``gsd_m`` (None: those of the DEM)."""

    image: Path
    camera: Path
    dem: Path
    albedo: Path | None = None
    gsd_m: float | None = None
    resolves: Resolution | None = None  # what the DEM's own cells say, for a ground on others

    @classmethod
    def of(cls, shared: Path, key: str, gsd_m: float | None = None) -> Ground:
        folder, dem = shared / "images" / FRAMED[key][0], FRAMED[key][1]
        names = [folder / f"{key}.png", folder / f"{key}_SML.png"]
        image = next(name for name in names if name.is_file())
        albedo = shared / "albedo" / "relative_albedo_11ppd.tif"
        return cls(image, folder / f"{key}_camera.json", folder / dem, albedo, gsd_m)

    def rendered_for(self, target_m: float) -> Ground:
        """The same terrain on the cells that `lcp validate` renders for windows on cells of
        ``target_m``.
        """
        cell_m = rendered_cell_m(self.scene.gsd_m, target_m)
        if cell_m == self.scene.gsd_m:
            return self
        return replace(self, gsd_m=cell_m, resolves=self.resolution)

    @functools.cached_property
    def scene(self) -> HeightfieldScene:
        view = ViewChoice(read_camera(self.camera))
        model = reflectance_model(LAW)
        scene = prepare_terrain(
            Request(DemSet.open([self.dem]), gsd_m=self.gsd_m, view=view, model=model)
        )
        return scene

    @functools.cached_property
    def resolution(self) -> Resolution:
        return self.resolves or of_file(Dem.open(self.dem))

    @functools.cached_property
    def factor(self) -> np.ndarray:
        assert self.albedo is not None
        return AlbedoMap.open(self.albedo, "linear").at_nodes(self.scene.terrain)

    @functools.cached_property
    def shot(self) -> Rendering:
        return self.scene.expose()

    def ortho(self, encoding: str) -> Ortho:
        if encoding not in self._seen:
            photo = photograph(self.image, self.camera, encoding)
            nodes = terrain_nodes(self.scene.terrain)
            self._seen[encoding] = orthorectify(photo, nodes, self.shot.visible)
        return self._seen[encoding]

    @functools.cached_property
    def _seen(self) -> dict[str, Ortho]:
        return {}

    def radiance(self, law: str = LAW, albedo: bool = True, shadows: bool = True) -> np.ndarray:
        """Image of the core's nodes under a reflectance model or one of `YARDSTICKS`."""
        if law in YARDSTICKS:
            values = self._yardstick(law)
        elif not shadows:
            scene = self.scene
            how = {"model": reflectance_model(law), "shadows": False}
            values = render_enu(scene.terrain, scene.light, scene.view, Method(**how)).radiance
        else:
            values = replace(self.scene, model=reflectance_model(law)).expose().radiance
        return values * self.factor if albedo else np.asarray(values)

    def _yardstick(self, law: str) -> np.ndarray:
        shot = self.shot
        lit = shot.visible & (shot.incidence_deg < 90.0) & (shot.emission_deg < 90.0)
        i, e = (np.where(lit, band, 0.0) for band in (shot.incidence_deg, shot.emission_deg))
        mu0, mu = np.cos(np.radians(i)), np.cos(np.radians(e))
        factor = YARDSTICKS[law](mu0, mu, np.where(lit, shot.phase_deg, 0.0))
        return np.where(lit, factor * shot.sunlit, np.where(shot.visible, 0.0, np.nan))

    def pair(self, target_m: float, render: np.ndarray, encoding: str = SRGB, **how: float) -> Pair:
        """Image and render on cells, the image with the DEM's point spread."""
        seen = self.ortho(encoding)
        spread = {"dem_fwhm_m": self.resolution.point_spread_m} | how
        gsd_m = self.scene.gsd_m
        return paired(
            seen.signal, render, seen.weight, gsd_m=gsd_m, target_m=max(target_m, gsd_m), **spread
        )

    def windows(
        self, target_m: float, render: np.ndarray, encoding: str = SRGB, **how: float
    ) -> WindowComparison:
        pair = self.pair(target_m, render, encoding, **how)
        return compare(pair.image, pair.render, pair.weight, gsd_m=pair.gsd_m)
