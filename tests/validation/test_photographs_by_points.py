"""Correlation of the sample catalogue's usable points with the photograph, compared with that of
other places.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio

from lcp_catalog.build.config import BuildConfig
from lcp_catalog.build.run import build_catalog
from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.catalog.schema import USABLE
from lcp_catalog.rendering.pipeline import prepare_terrain
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.terrain.area import Area
from lcp_catalog.terrain.relief_bounds import nodes_enu

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
DEM = SAMPLE / "hadley_gld100_256ppd.tif"
HALF = 16
PIXEL_NODES = 3.3
"""A pixel of the photograph (390 m) in nodes of 118 m."""


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Centred normalised correlation of two windows; 0 where one of them is flat (all in shadow)."""
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / power if power > 0.0 else 0.0


@pytest.mark.slow
def test_usable_points_look_like_the_photograph(tmp_path: Path) -> None:
    """Sun of AS15-M-0414 at the centre: azimuth 96.5, elevation 13.7; the nearest cells are 90 and
    105 at 15 deg.

    Render and photograph are smoothed to the photograph's pixel. Nothing is fitted here; the camera
    was fitted to this DEM.
    """
    config = BuildConfig.from_toml(SAMPLE / "hadley.toml")
    build_catalog([DEM], config, tmp_path / "c.h5", jobs=2)
    catalog = open_catalog(tmp_path / "c.h5")
    assert len(catalog.point_id) >= 100
    camera = read_camera(SAMPLE / "AS15-M-0414_camera.json")
    scene = prepare_terrain(
        Request([DEM], area=Area(3.5, 26.0, 158.0), view=ViewChoice(camera=camera))
    )
    shot = scene.expose()
    field, (row0, _, col0, _) = scene.terrain.field, scene.terrain.core
    pixels = camera.project(scene.terrain.frame.to_mcmf(nodes_enu(field, scene.terrain.core)))
    with rasterio.open(SAMPLE / "AS15-M-0414.png") as file:
        photo = file.read(1).astype(np.float32)
    at = [pixels[..., axis].astype(np.float32) for axis in (0, 1)]
    image = cv2.GaussianBlur(cv2.remap(photo, *at, cv2.INTER_CUBIC), (0, 0), 0.4 * PIXEL_NODES)
    render = np.nan_to_num(shot.radiance).astype(np.float32)
    render = cv2.GaussianBlur(render, (0, 0), 0.6 * PIXEL_NODES)

    def judged(row: int, col: int) -> float:
        window = np.s_[row - HALF : row + HALF + 1, col - HALF : col + HALF + 1]
        if min(row, col) < HALF or (shot.visible[window] > 0).sum() < (2 * HALF + 1) ** 2:
            return np.nan
        return correlation(render[window], image[window])

    enu = scene.terrain.frame.from_mcmf(catalog.position_mcmf)
    rows = np.round((field.y0_m - enu[:, 1]) / field.gsd_m - row0).astype(int)
    cols = np.round((enu[:, 0] - field.x0_m) / field.gsd_m - col0).astype(int)
    found = np.array([judged(r, c) for r, c in zip(rows, cols, strict=True)])
    elevation = list(catalog.sun_elevation).index(15.0)
    azimuths = [list(catalog.sun_azimuth).index(a) for a in (90.0, 105.0)]
    usable = (catalog.condition[:, 0, elevation][:, azimuths] == USABLE).any(axis=1)
    works, rest = found[usable & np.isfinite(found)], found[~usable & np.isfinite(found)]
    rng = np.random.default_rng(0)
    places = rng.integers(40, np.array(render.shape) - 40, (500, 2))
    anywhere = np.array([judged(r, c) for r, c in places])
    anywhere = anywhere[np.isfinite(anywhere)]
    assert len(works) >= 30
    assert (works > 0.8).mean() >= 0.9  # 96 % when this was written
    assert (anywhere > 0.8).mean() <= 0.75  # 65 %: what a random place gives
    assert (rest > 0.8).mean() <= 0.8  # 66 %: what the catalogue calls unusable at this Sun
