"""The real pair of the pit in Mare Tranquillitatis: a NAC orthoimage of half a metre, and a NAC DTM
of 2 m in 256 steps of the same ground. What tests and benchmarks share.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rasterio

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.images.image import Image
from lcp_catalog.images.image_file import open_image
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.pipeline import HeightfieldScene, prepare_terrain
from lcp_catalog.rendering.public import geotiff
from lcp_catalog.rendering.request import Request
from lcp_catalog.validation.orthoimage import orthorectify, terrain_nodes

PAIR = Path("images") / "nac-tranqpit1-pair"
STEP_M = 119.0 / 255.0
GSD_M = 2.0
PIT_MARGIN_M = 20.0
"""Distance around the hole that is excluded from the registration: both files contain the hole,
which would dominate.
"""

REACH_M = 12.0
BUILD = """
[area]
gsd_m = 2.0
[sun]
azimuths_deg = [260.0, 275.0]
elevations_deg = [45.0, 53.0, 60.0]
[view]
off_nadir_deg = [0.0]
azimuth_deg = [0.0]
altitude_km = [inf]
[points]
spacing_m = 30.0
search_m = 32.0  # half a patch
[errors]
sensor_noise = 0.005
height_sigma_m = 0.0
height_length_m = 3.0
albedo_sigma = 0.0
position_sigma_m = 0.0
spread = 0.0
"""


@dataclass(frozen=True, eq=False)
class Ground:
    """Render of the DTM, original or smoothed: radiance (rows, cols) and positions of its nodes."""

    scene: HeightfieldScene
    radiance: np.ndarray
    nodes: np.ndarray

    @classmethod
    def of(cls, dem: Path, sun: SunChoice, model: str = "lunar-lambert") -> Ground:
        request = Request(DemSet.open([dem]), sun=sun, gsd_m=GSD_M, model=reflectance_model(model))
        scene = prepare_terrain(request)
        return cls(scene, scene.expose().radiance, terrain_nodes(scene.terrain))


def dtm(folder: Path) -> tuple[np.ndarray, rasterio.CRS, rasterio.Affine]:
    """Original heights, metres, NaN in the hole."""
    with rasterio.open(folder / "tranqpit1_dtm_2m.tif") as file:
        heights = file.read(1).astype(np.float64)
        heights[heights == file.nodata] = np.nan
        return heights, file.crs, file.transform


def write_dem(path: Path, heights: np.ndarray, like: tuple[rasterio.CRS, rasterio.Affine]) -> Path:
    path.write_bytes(geotiff({"height": heights}, "float32", {}, *like))
    return path


def pit_sun(folder: Path) -> SunChoice:
    given = json.loads((folder / "sun_geometry_computed.json").read_text())
    return SunChoice(subsolar_deg=(given["subsolar_lon"], given["subsolar_lat"]))


def on_ground(photo: Image, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The image at the nodes, and its weight."""
    found = orthorectify(photo, nodes)
    return found.signal, found.weight


def far_from_hole(ground: Ground, weight: np.ndarray) -> np.ndarray:
    """Nodes valid in both, not beside the hole or the edge."""
    there = (np.isfinite(ground.radiance) & (weight > 0.9)).astype(np.uint8)
    side = 2 * round(PIT_MARGIN_M / GSD_M) + 1
    return cv2.erode(there, np.ones((side, side), np.uint8), borderValue=0) > 0


def orthoimage(folder: Path, sun: SunChoice) -> Image:
    return open_image(folder / "tranqpit1_ortho_M152662021_0p5m.tif", None, sun)


def build_catalog(dem: Path, path: Path) -> Path:
    """`lcp build-catalog` of the DTM for Suns near that of the image, and for images nearly equal
    to their renders.
    """
    config = path.with_suffix(".toml")
    config.write_text(BUILD)
    lcp = [str(Path(sys.executable).with_name("lcp")), "build-catalog", str(dem), "-o", str(path)]
    subprocess.run([*lcp, "--config", str(config), "--overwrite"], check=True, capture_output=True)
    return path


def highest(scores: np.ndarray, step_m: float) -> np.ndarray:
    """Column and row of a peak, metres from the centre, by a paraboloid through 3 x 3 values; NaN
    at the edge.
    """
    rows, cols = scores.shape
    i, j = np.unravel_index(int(np.argmax(scores)), scores.shape)
    if not (0 < i < rows - 1 and 0 < j < cols - 1):
        return np.full(2, np.nan)
    row, col = np.mgrid[-1:2, -1:2].reshape(2, -1).astype(float)
    design = np.stack([np.ones(9), col, row, col**2, row**2, col * row], axis=1)
    c = np.linalg.lstsq(design, scores[i - 1 : i + 2, j - 1 : j + 2].ravel(), rcond=None)[0]
    at = np.linalg.solve([[2 * c[3], c[5]], [c[5], 2 * c[4]]], -c[1:3])
    middle = np.array([j - cols // 2, i - rows // 2])
    return (np.clip(at, -1, 1) + middle) * step_m


def window_scores(image: np.ndarray, ground: Ground, keep: np.ndarray, side: int) -> np.ndarray:
    """Correlations (n, shifts, shifts) of windows of the render with the image around them, for
    windows without gaps.
    """
    found = []
    reach = round(REACH_M / GSD_M)
    rows, cols = image.shape
    image = np.where(np.isfinite(image), image, np.nanmean(image)).astype(np.float32)
    render = np.nan_to_num(ground.radiance).astype(np.float32)
    for row in range(reach, rows - side - reach, side // 2):
        for col in range(reach, cols - side - reach, side // 2):
            if keep[row : row + side, col : col + side].all():
                around = image[row - reach : row + side + reach, col - reach : col + side + reach]
                window = render[row : row + side, col : col + side]
                found.append(cv2.matchTemplate(around, window, cv2.TM_CCOEFF_NORMED))
    return np.array(found)


def offset_of(scores: np.ndarray) -> np.ndarray:
    """Offset (east, north) in metres of the image's terrain from its place on the map: the maximum
    of the windows' mean correlation. An offset to the right and down in the image is one to the
    west and north of the map.
    """
    right, down = highest(scores.mean(axis=0), GSD_M)
    return np.array([-right, down])


def at_scale(values: np.ndarray, there: np.ndarray, factor: int) -> np.ndarray:
    """Means of blocks of factor x factor, NaN where less than 0.7 of a block is valid."""
    rows, cols = (n // factor for n in values.shape)
    cut = np.s_[: rows * factor, : cols * factor]
    blocks = (rows, factor, cols, factor)
    count = there[cut].reshape(blocks).sum(axis=(1, 3))
    total = np.where(there, np.nan_to_num(values), 0.0)[cut].reshape(blocks).sum(axis=(1, 3))
    return np.where(count >= 0.7 * factor**2, total / np.maximum(count, 1), np.nan)
