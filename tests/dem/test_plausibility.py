"""Heights that are hardly those of the Moon in metres: said by the check, and by a build."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers.products import geotiff
from helpers.small_build import CONFIG, DEM
from lcp_cli.main import run
from rasterio.windows import Window

from lcp_catalog.dem.file_check import check_dem
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.plausibility import warn_of_doubts
from lcp_catalog.production.run import Build

KILOMETRES, FLAT, STEEP = "look like kilometres", "are flatter than", "are steeper than"
ZEROS = "lie in blocks of zeros"


@pytest.fixture(scope="module")
def hadley() -> np.ndarray:
    """Real heights (rows, cols) of 95 km, metres, from -3.2 to 1.2 km."""
    with rasterio.open(DEM) as file:
        heights: np.ndarray = file.read(1, window=Window(1500, 1300, 800, 800))
    return heights


def written(path: Path, heights: np.ndarray, pixel_m: float = 118.45, **how: float) -> Path:
    return geotiff(path, heights, 100_000.0, 800_000.0, pixel_m, **how)


def said(path: Path) -> tuple[str, ...]:
    """Warnings of the check, which are those of a build, too."""
    found = check_dem(path)
    assert found.sound, found
    logged: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: logged.append(record.getMessage())  # type: ignore[method-assign]  # a list is enough
    log = logging.getLogger("lcp_catalog.dem.plausibility")
    log.addHandler(handler)
    try:
        dems = DemSet.open([path])
        warn_of_doubts(dems, dems.bounds)
    finally:
        log.removeHandler(handler)
    assert logged == [f"{path}: {text}" for text in found.warnings]
    return found.warnings


def test_real_heights_are_not_doubted(hadley: np.ndarray, ldem_4: Path, tmp_path: Path) -> None:
    assert said(DEM) == ()
    assert said(ldem_4 / "LDEM_4.LBL") == ()
    for side in (800, 80, 8):
        assert said(written(tmp_path / f"{side}.tif", hadley[:side, :side])) == ()


def test_kilometres_are_told_from_metres_until_they_are_declared(
    hadley: np.ndarray, tmp_path: Path
) -> None:
    km = (hadley / 1000.0).astype(np.float32)
    (text,) = said(written(tmp_path / "km.tif", km))
    assert KILOMETRES in text
    assert "over 90.3 km" in text
    assert "\n" not in text
    assert said(written(tmp_path / "declared.tif", km, scale=1000.0)) == ()


@pytest.mark.parametrize(
    ("factor", "pixel_m", "says"),
    [(1e-3, 1184.5, KILOMETRES), (5e-3, 1184.5, FLAT), (5e-3, 118.45, None), (1.0, 2.0, STEEP)],
)
def test_relief_against_what_the_moon_has(
    factor: float, pixel_m: float, says: str | None, hadley: np.ndarray, tmp_path: Path
) -> None:
    heights = (2000.0 * (factor == 5e-3) + hadley * factor).astype(np.float32)
    found = said(written(tmp_path / "x.tif", heights, pixel_m))
    assert len(found) == (says is not None)
    assert all(says in text for text in found if says)


def test_missing_pixels_that_are_written_as_zeros(hadley: np.ndarray, tmp_path: Path) -> None:
    holed = hadley.copy()
    holed[101:127, 203:241] = 0
    (text,) = said(written(tmp_path / "holed.tif", holed))
    assert ZEROS in text
    assert said(written(tmp_path / "declared.tif", holed, nodata=0)) == ()
    line = hadley.copy()
    line[101:108, :] = 0  # lower than a block
    assert said(written(tmp_path / "line.tif", line)) == ()


def test_the_commands_say_it(
    hadley: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "km.tif", (hadley / 1000.0).astype(np.float32))
    assert run(["dem", "check", str(path)]) == 0
    out = capsys.readouterr().out
    assert f"{path}: DOUBTFUL, km\n  warning: heights from" in out
    assert run(["dem", "check", "--json", str(path)]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found["sound"]
    assert KILOMETRES in found["warnings"][0]


def test_a_build_says_it(
    hadley: np.ndarray, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = geotiff(tmp_path / "km.tif", (hadley / 1000.0).astype(np.float32), 70e3, 840e3, 118.45)
    Build.plan((path,), CONFIG)
    assert KILOMETRES in caplog.text
