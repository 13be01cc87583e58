"""Time to read and resample 4096 x 4096 nodes from each kind of file, compared with a plain read of the same pixels."""

from __future__ import annotations

import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.windows import Window

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from helpers.archive_files import cylinder_frame, jp2_product
from helpers.products import DEGREE_M, LABELS, hills, ldem_80s, sldem_512

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.threads import limit_threads

NODES = 4096
SIDE = NODES + 64
BLOCK_ROWS = 488  # what terrain asks for at once: 2 million nodes

Plain = Callable[[], np.ndarray]


def float_img(folder: Path) -> tuple[Path, Plain]:
    label = sldem_512(folder, 0, 20, SIDE, SIDE)
    return label, lambda: np.fromfile(label.with_suffix(".IMG"), "<f4")


def polar_img(folder: Path) -> tuple[Path, Plain]:
    label = ldem_80s(folder, SIDE)
    return label, lambda: np.fromfile(label.with_suffix(".IMG"), "<i2")


def _read(path: Path) -> np.ndarray:
    with rasterio.open(path) as dataset:
        return dataset.read(1, window=Window(0, 0, SIDE, SIDE))


def tiled_tiff(folder: Path) -> tuple[Path, Plain]:
    path = folder / "tiled.tif"
    lon, lat = np.meshgrid((np.arange(SIDE) + 0.5) / 512, 20.0 - (np.arange(SIDE) + 0.5) / 512)
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "width": SIDE, "height": SIDE}
    profile |= {"tiled": True, "blockxsize": 512, "blockysize": 512, "compress": "deflate"}
    profile["crs"] = "+proj=eqc +lat_ts=0 +lon_0=0 +R=1737400 +units=m +no_defs"
    step = DEGREE_M / 512
    profile["transform"] = rasterio.transform.from_origin(0.0, 20.0 * DEGREE_M, step, step)
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(hills(lon, lat).astype(np.float32), 1)
    return path, lambda: _read(path)


def jp2(folder: Path) -> tuple[Path, Plain]:
    text = (
        (LABELS.parent / "ldem_4" / "LDEM_4_JP2.LBL")
        .read_bytes()
        .decode("latin-1")
        .replace("LDEM_4", "LDEM_512")
    )
    frame = cylinder_frame(0.0, 20.0, SIDE, SIDE, 512.0, 0.0)
    scale = {"MAP_RESOLUTION": 512, "MAP_SCALE": f"{frame.pixel_m / 1e3:.10f}"}
    product = jp2_product(folder, "LDEM_512", "LDEM_512", text, frame, hills, **scale)
    return product.label, lambda: _read(product.image)


KINDS = {"float .IMG": float_img, "int16 polar .IMG": polar_img, "tiled GeoTIFF": tiled_tiff, "JP2": jp2}  # fmt: skip


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("kind", KINDS)
def test_reading_and_resampling(benchmark, tmp_path, kind):
    """One node per pixel, half a pixel aside, in blocks as the terrain module requests them; one thread."""
    path, plain = KINDS[kind](tmp_path)
    dems = DemSet.open([path])
    grid, gsd_m = dems.dems[0].grid, dems.dems[0].gsd_m
    columns = np.arange(NODES) + 32.5

    def resampled() -> float:
        total = 0.0
        for row in range(0, NODES, BLOCK_ROWS):
            rows = np.arange(row, min(row + BLOCK_ROWS, NODES)) + 32.5
            height, _ = dems.heights(*grid.lonlat(columns, rows[:, None]), gsd_m)
            total += float(height[0, 0])
        return total

    with limit_threads(1):
        benchmark.pedantic(resampled, rounds=2, warmup_rounds=1)
        reads = [_seconds(plain) for _ in range(3)]
    tracemalloc.start()
    resampled()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    if benchmark.stats:
        seconds = benchmark.stats.stats.min
        benchmark.extra_info["Mnode/s"] = round(NODES**2 / seconds / 1e6, 2)
        benchmark.extra_info["times a plain read"] = round(seconds / min(reads), 1)
        benchmark.extra_info["plain read, Mpixel/s"] = round(SIDE**2 / min(reads) / 1e6, 1)
        benchmark.extra_info["peak MB"] = round(peak / 1e6, 1)


def _seconds(call: Plain) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start
