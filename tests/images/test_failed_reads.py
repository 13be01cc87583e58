"""A read of an image or a DEM that fails is never another image: every read of small files, each in turn.

GDAL 3.10 goes on after some failed reads: with the compressed bytes of an 8-bit PNG as samples, with wrong
places of a TIFF's strips.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers import failed_reads
from rasterio.transform import from_origin

from benchmarks.faults.failing import built


def written(path: Path, samples: np.ndarray, **options: object) -> None:
    rows, cols = samples.shape
    with rasterio.open(
        path, "w", width=cols, height=rows, count=1, dtype=samples.dtype.name, **options
    ) as file:
        file.write(samples, 1)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
@pytest.mark.skipif(shutil.which("cc") is None, reason="the library of failing calls is compiled")
def test_a_failed_read_is_no_other_image(tmp_path: Path) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    noise = np.random.default_rng(4).integers(0, 255, failed_reads.SIDES).astype(np.uint8)
    written(folder / "a.png", noise, driver="PNG")
    written(folder / "b.png", noise.astype(np.uint16) * 200, driver="PNG")
    written(folder / "c.jpg", noise, driver="JPEG")
    written(folder / "d.tif", noise, driver="GTiff")
    written(folder / "e.cub", noise, driver="ISIS3")
    grid = {"crs": "IAU_2015:30110", "transform": from_origin(0.0, 0.0, 100.0, 100.0)}
    heights = noise.astype(np.float32)
    written(folder / "heights.tif", heights, driver="GTiff", **grid)
    tiles = {"tiled": True, "blockxsize": 64, "blockysize": 64, "compress": "deflate"}
    written(folder / "heights_tiled.tif", heights, driver="GTiff", **grid, **tiles)
    names = sorted(path.name for path in folder.iterdir())
    state = tmp_path / "state"
    state.write_bytes(bytes(failed_reads.STATE.size))
    environment = os.environ | {
        "LD_PRELOAD": str(built(tmp_path)),
        "FAILING_CALLS_STATE": str(state),
    }
    words = [sys.executable, failed_reads.__file__, str(folder), str(state), *names]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert set(found) == set(names)
    for name, (good, others) in found.items():
        assert good != "refused", name
        assert others.count("refused") >= 3, name
        assert set(others) <= {good, "refused"}, name
