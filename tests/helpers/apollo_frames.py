"""Apollo Metric images beside renders of the same terrain, on one grid and at one resolution.

Two kinds of files, in ``shared/data/images``: original frames with a camera file (Apollo 15), and
the Apollo 16 series, whose frames are map-projected to about 1280 m per pixel, with tables of the
positions of the Sun and the spacecraft. Nothing is fitted to an image except one shift for the
whole series (`SERIES_SHIFT_PX`); a correlation is independent of gain and offset.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import rasterio

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.view import looking_camera
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import EnuFrame, lonlat_to_mcmf, mcmf_to_lonlat
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.pipeline import HeightfieldScene, prepare_terrain
from lcp_catalog.rendering.renderer import Rendering
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.terrain.area import Area
from lcp_catalog.terrain.relief_bounds import nodes_enu

GSD_M = 474.0
"""Cells of the renders: those of GLD100 at 64 pixels a degree."""

SERIES = "apollo16-metric-series"
SERIES_PIXEL_M = 1280.0
SERIES_SHIFT_PX = (0.7, 0.1)
"""Columns and rows by which terrain in GLD100 is right of and below the same terrain in a frame of
the series, whose control net is older. One value for all frames, the median of their own;
`photographs.py` of c896266 measured it."""

FWHM = 2.0
"""Full width at half maximum of the Gaussian that smooths images and, if their cells are finer,
renders, in cells of the grid of the comparison: the shortest wavelength that cells represent."""

WINDOW = 16
MARGIN_PX = 8
_SIGMA = 1.0 / np.sqrt(8.0 * np.log(2.0))
_BORDER_DEG = 0.1
_NADIR_WIDTH_M = 600e3


Law = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Radiance factor of the cosines of incidence and emission and the phase in degrees."""


def _mcewen_alone(mu0: np.ndarray, mu: np.ndarray, g: np.ndarray) -> np.ndarray:
    """The lunar-Lambert mixture (McEwen 1996) without a phase function."""
    share = np.clip(1.0 - 0.019 * g + 0.242e-3 * g**2 - 1.46e-6 * g**3, 0.0, 1.0)
    return 2.0 * share * mu0 / (mu0 + mu) + (1.0 - share) * mu0


def _lroc_empirical(mu0: np.ndarray, mu: np.ndarray, g: np.ndarray) -> np.ndarray:
    """LROC_Empirical of 2019, NAC at 600 nm, as printed in the documentation of ISIS's lronacpho."""
    phase = -0.000083528 * g**2 + 0.012964707 * g - 0.237774774 * np.sqrt(g)
    facet = 0.556075496 * mu + 0.663671460 * mu0 - 0.439918609 * mu0**2
    return mu0 / (mu0 + mu) * np.exp(-1.479654495 + phase + facet)


YARDSTICKS: dict[str, Law] = {
    "lunar-lambert, no phase function": _mcewen_alone,
    "LROC empirical": _lroc_empirical,
}
"""Models that the product does not have, computed from its bands."""


@dataclass(eq=False)
class Frame:
    """An image on a grid, and the scene for a render of it."""

    name: str
    scene: HeightfieldScene
    image: np.ndarray  # (rows, cols), smoothed
    compared: np.ndarray  # (rows, cols) bool
    places: np.ndarray | None  # (2, rows, cols) column and row among the nodes; None: at the nodes
    fwhm: float

    def render(self, model: str, factor: np.ndarray | None = None) -> np.ndarray:
        """Radiance factor under a model (or one of `YARDSTICKS`), times a factor at the core's
        nodes, on the image's grid.
        """
        radiance = self.radiance(model)
        return self.on_grid(radiance if factor is None else radiance * factor)

    def radiance(self, model: str) -> np.ndarray:
        """Radiance factor at the core's nodes, 0 for nodes that are not visible."""
        if model in YARDSTICKS:
            return self._yardstick(YARDSTICKS[model])
        shot = replace(self.scene, model=reflectance_model(model)).expose()
        return np.nan_to_num(shot.radiance).astype(np.float64)

    def _yardstick(self, law: Law) -> np.ndarray:
        shot = self.shot
        bands = (shot.incidence_deg, shot.emission_deg, shot.phase_deg)
        i, e, g = (np.nan_to_num(band.astype(np.float64), nan=90.0) for band in bands)
        lit = (shot.sunlit > 0.0) & shot.visible & (i < 90.0) & (e < 90.0)
        mu0, mu = (np.cos(np.radians(np.where(lit, a, 0.0))) for a in (i, e))
        return np.where(lit, law(mu0, mu, g) * shot.sunlit, 0.0)

    @functools.cached_property
    def shot(self) -> Rendering:
        """The scene rendered with the product's own choices."""
        return self.scene.expose()

    def on_grid(self, nodes: np.ndarray) -> np.ndarray:
        """Values of the core's nodes on the image's grid, smoothed like the image."""
        if self.places is None:
            return nodes
        pixel = _blur(nodes, SERIES_PIXEL_M / GSD_M)
        return smooth(self.sampled(pixel), self.compared, self.fwhm)

    def sampled(self, nodes: np.ndarray) -> np.ndarray:
        """Values of the core's nodes on the image's grid, not smoothed."""
        if self.places is None:
            return nodes
        column, row = self.places.astype(np.float32)
        return cv2.remap(nodes.astype(np.float32), column, row, cv2.INTER_LINEAR).astype(float)

    @functools.cached_property
    def phase_deg(self) -> np.ndarray:
        """Phase on the grid, (rows, cols)."""
        return self.sampled(np.nan_to_num(self.shot.phase_deg))

    @functools.cached_property
    def off_axis(self) -> np.ndarray:
        """Tangent of the angle to the camera's axis on the grid, (rows, cols); for the series,
        whose camera attitudes are unknown, to the vertical.
        """
        camera, terrain = self.scene.camera, self.scene.terrain
        pixels = camera.project(terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.core)))
        away = np.linalg.norm(pixels - np.array(camera.principal_point_px), axis=-1)
        return self.sampled(np.nan_to_num(away / camera.focal_length_px))

    @property
    def sun_elevation_deg(self) -> float:
        """Elevation at the centre of the area."""
        return self.scene.sun.elevation_deg

    @property
    def phase_at_centre_deg(self) -> float:
        rows, cols = self.phase_deg.shape
        return float(self.phase_deg[rows // 2, cols // 2])

    def windows(self, share: float = 0.9) -> list[tuple[slice, slice]]:
        """Adjacent windows with at least a given share of compared cells."""
        rows, cols = self.image.shape
        corners = (
            np.s_[row : row + WINDOW, col : col + WINDOW]
            for row in range(0, rows - WINDOW + 1, WINDOW)
            for col in range(0, cols - WINDOW + 1, WINDOW)
        )
        return [window for window in corners if self.compared[window].mean() >= share]

    def correlation(self, render: np.ndarray, where: tuple[slice, slice] = np.s_[:, :]) -> float:
        """Centred normalised correlation of photograph and render over what is compared."""
        valid = self.compared[where]
        return correlation(self.image[where][valid], render[where][valid])


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Centred normalised correlation; 0 if one of the two is constant."""
    a, b = a - a.mean(), b - b.mean()
    scale = np.sqrt((a * a).sum() * (b * b).sum())
    return float((a * b).sum() / scale) if scale > 0.0 else 0.0


def smooth(values: np.ndarray, valid: np.ndarray, fwhm: float) -> np.ndarray:
    """Gaussian means over the valid cells."""
    if not fwhm > 0.0:
        return np.where(valid, values, 0.0)
    weight = _blur(valid.astype(np.float64), fwhm, cv2.BORDER_CONSTANT)
    total = _blur(np.where(valid, values, 0.0), fwhm, cv2.BORDER_CONSTANT)
    return total / np.maximum(weight, 1e-9)


def _blur(values: np.ndarray, fwhm: float, border: int = cv2.BORDER_REFLECT) -> np.ndarray:
    return cv2.GaussianBlur(values, (0, 0), fwhm * _SIGMA, borderType=border)


# -- the Apollo 16 series


def series_keys(shared: Path) -> list[str]:
    """Names of the frames within the DEM beside them."""
    folder = shared / "images" / SERIES / "DIM_input_1280mpp_masked"
    return sorted(path.stem for path in folder.glob("AS16-M-*.tif"))


def series_dem(shared: Path) -> Path:
    return shared / "images" / SERIES / "gld100_064ppd_lat-16_-02_lon-01_020.tif"


def series_frame(
    shared: Path,
    key: str,
    shift_px: tuple[float, float] = SERIES_SHIFT_PX,
    fwhm: float = FWHM,
    dem: Path | None = None,
) -> Frame:
    """A frame of the series. Values of 0 are excluded: shadows, saturated terrain and everything
    outside are masked in the files.
    """
    folder = shared / "images" / SERIES
    dem = dem or series_dem(shared)
    with rasterio.open(folder / "DIM_input_1280mpp_masked" / f"{key}.tif") as file:
        image, transform, box = file.read(1), file.transform, file.bounds
    col, row = np.meshgrid(np.arange(image.shape[1]) + 0.5, np.arange(image.shape[0]) + 0.5)
    lon, lat = transform @ (col + shift_px[0], row + shift_px[1])
    border = np.array([-1, -1, 1, 1]) * _BORDER_DEG
    camera = series_camera(folder / "meta", key)
    area = Area.from_bounds(*(np.array(box) + border))
    scene = prepare_terrain(
        Request(DemSet.open([dem]), area=area, gsd_m=GSD_M, view=ViewChoice(camera))
    )
    compared = image > 0
    return Frame(
        key,
        scene,
        smooth(image.astype(float), compared, fwhm),
        compared,
        _places(scene, dem, lon, lat),
        fwhm,
    )


def series_camera(meta: Path, key: str) -> Camera:
    """A nadir-looking camera at the frame's position, wide enough for the whole frame."""
    position = _table(meta / "spacecraftpos.txt")[key]
    lon, lat, _ = (float(value) for value in mcmf_to_lonlat(position))
    frame = EnuFrame(lon, lat)
    size_m = (_NADIR_WIDTH_M, _NADIR_WIDTH_M)
    camera = looking_camera(frame, frame.from_mcmf(position), SERIES_PIXEL_M, size_m)
    return replace(camera, sun_position_mcmf_m=_table(meta / "sunpos.txt")[key], name=key)


@functools.cache
def _table(path: Path) -> dict[str, np.ndarray]:
    """Body-fixed positions, metres; the file has kilometres."""
    rows = (line.split() for line in path.read_text(encoding="utf-8").splitlines())
    return {row[0]: 1e3 * np.array(row[1:], dtype=float) for row in rows if len(row) == 4}


def _places(
    scene: HeightfieldScene, dem: Path, lon_deg: np.ndarray, lat_deg: np.ndarray
) -> np.ndarray:
    """Column and row among the core's nodes of places by longitude and latitude."""
    height = np.asarray(DemSet.open([dem]).heights(lon_deg, lat_deg, GSD_M)[0], dtype=float)
    height = np.nan_to_num(height)[..., None]
    ground = lonlat_to_mcmf(lon_deg, lat_deg) * (1.0 + height / MOON_RADIUS_M)
    x, y, _ = np.moveaxis(scene.terrain.frame.from_mcmf(ground), -1, 0)
    field, (row0, _, col0, _) = scene.terrain.field, scene.terrain.core
    return np.stack([(x - field.x0_m) / field.gsd_m - col0, (field.y0_m - y) / field.gsd_m - row0])


# -- frames with a camera


HADLEY = "apollo15-metric-hadley"
FARSIDE = "apollo15-metric-farside"
FRAMED = {
    "AS15-M-0414": (HADLEY, "gld100_256ppd_lat20-30_lon000-010.tif"),
    "AS15-M-1134": (HADLEY, "gld100_256ppd_lat20-30_lon000-010.tif"),
    "AS15-M-0295": (FARSIDE, "gld100_064ppd_lat-28_-13_lon132-155.tif"),
    "AS15-M-0299": (FARSIDE, "gld100_064ppd_lat-28_-13_lon132-155.tif"),
    "AS15-M-0300": (FARSIDE, "gld100_064ppd_lat-28_-13_lon132-155.tif"),
}
"""Folder and DEM of each frame."""


def framed(shared: Path, key: str, fwhm: float = FWHM) -> Frame:
    """A frame with its camera, at the render's nodes, 474 m apart: the image is smoothed and
    sampled at the projected nodes; nodes within 8 pixels of its border are left out.
    """
    name, dem = FRAMED[key]
    folder = shared / "images" / name
    camera = read_camera(folder / f"{key}_camera.json")
    scene = prepare_terrain(
        Request(DemSet.open([folder / dem]), gsd_m=GSD_M, view=ViewChoice(camera))
    )
    photo = _photo(folder, key)
    if fwhm > 0.0:
        pixel_m = np.linalg.norm(camera.position_mcmf_m) - MOON_RADIUS_M
        photo = _blur(photo, fwhm * GSD_M / (pixel_m / camera.focal_length_px))
    nodes = scene.terrain.frame.to_mcmf(nodes_enu(scene.terrain.field, scene.terrain.core))
    column, row = np.moveaxis(camera.project(nodes).astype(np.float32), -1, 0)
    image = cv2.remap(photo, column, row, cv2.INTER_CUBIC).astype(np.float64)
    width, height = camera.image_size_px
    inside = (column >= MARGIN_PX) & (column <= width - 1 - MARGIN_PX)
    inside &= (row >= MARGIN_PX) & (row <= height - 1 - MARGIN_PX)
    return Frame(key, scene, image, inside & scene.expose().visible, None, fwhm)


def _photo(folder: Path, key: str) -> np.ndarray:
    names = [folder / f"{key}.png", folder / f"{key}_SML.png"]
    with rasterio.open(next(name for name in names if name.is_file())) as file:
        return file.read(1).astype(np.float32)
