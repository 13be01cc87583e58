"""An albedo map: time of its mean by area, and of its factors at an area's nodes relative to the
area's terrain.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.albedo_raster import mean_value, open_pixels
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.terrain import build_terrain
from lcp_catalog.threads import limit_threads

DEM = Path(__file__).resolve().parents[1] / "sample_data" / "hadley_gld100_256ppd.tif"
GSD_M, NODES = 118.45, 1024
COLUMNS = 8192


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole Moon in 8192 x 4096 float32 pixels, uncompressed, in tiles."""
    values = np.random.default_rng(1).uniform(0.5, 1.5, (COLUMNS // 2, COLUMNS))
    pixel = 2.0 * np.pi * 1_737_400.0 / COLUMNS
    where = rasterio.Affine(pixel, 0, -COLUMNS / 2 * pixel, 0, -pixel, COLUMNS / 4 * pixel)
    kind = {"driver": "GTiff", "count": 1, "dtype": "float32", "tiled": True, "transform": where}
    path = tmp_path_factory.mktemp("albedo") / "map.tif"
    size = {"height": COLUMNS // 2, "width": COLUMNS, "crs": "+proj=eqc +R=1737400 +units=m"}
    with rasterio.open(path, "w", **kind, **size) as file:
        file.write(values.astype(np.float32), 1)
    return path


def test_mean(benchmark, path: Path):
    """Every pixel once."""
    with limit_threads(1):
        benchmark.pedantic(mean_value, (open_pixels(path, "linear"),), rounds=3, warmup_rounds=1)
    if benchmark.stats:
        rate = COLUMNS * COLUMNS / 2 / benchmark.stats.stats.min
        benchmark.extra_info["million pixels a second"] = round(rate / 1e6)


def test_nodes(benchmark, path: Path):
    """Factors of 1024 x 1024 nodes as a share of the time of their heights."""
    brightness, dems = AlbedoMap.open(path, reference=1.0), DemSet.open([DEM])
    window = NodeWindow(-NODES // 2, NODES // 2, -NODES // 2, NODES // 2)
    place = (dems, EnuFrame(5.0, 25.0), window, GSD_M)
    shares = []
    with limit_threads(1):
        terrain = build_terrain(*place)
        benchmark.pedantic(brightness.at_nodes, (terrain,), rounds=5, warmup_rounds=1)
        for _ in range(5):  # in turn, in the process's own time
            heights, factors = (
                _seconds(build_terrain, *place),
                _seconds(brightness.at_nodes, terrain),
            )
            shares.append(factors / heights)
    benchmark.extra_info["of the time of the heights"] = round(float(np.median(shares)), 2)


def _seconds(work: Callable[..., object], *given: object) -> float:
    start = time.process_time()
    work(*given)
    return time.process_time() - start
