"""Heights that are hardly those of the Moon in metres: said by the check, and by a build."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers.bare_files import NORTH
from helpers.products import DEGREE_M, geotiff
from helpers.range_server import range_server
from helpers.small_build import CONFIG, DEM
from lcp_cli.main import run
from rasterio.windows import Window

from lcp_catalog.dem import plausibility
from lcp_catalog.dem.file_check import check_dem
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.plausibility import refuse_zeros, warn_of_doubts
from lcp_catalog.errors import DemError
from lcp_catalog.geometry.bounds import Bounds
from lcp_catalog.production.run import Build
from lcp_catalog.terrain.area import Area

KILOMETRES, FLAT, STEEP = "look like kilometres", "are flatter than", "are steeper than"
ZEROS, EQUAL = "lie in lines or blocks of zeros", "lie in lines of equal heights"


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
        warn_of_doubts(dems, dems.bounds, 1024)
    finally:
        log.removeHandler(handler)
    assert logged == [f"{path}: {text}" for text in found.warnings]
    return found.warnings


@pytest.mark.slow
def test_real_products_are_not_doubted(shared_data: Path) -> None:
    for dem in sorted((shared_data / "dem").glob("*/[gl]*.tif")):
        assert said(dem) == (), dem


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


@pytest.mark.parametrize("side", [800, 16])
def test_radii_in_kilometres_are_named_until_they_are_declared(
    side: int, hadley: np.ndarray, tmp_path: Path
) -> None:
    """Of 90 km, and of 2 km, where 12 m of relief are possible."""
    km = ((1_737_400.0 + hadley[:side, :side].astype(float)) / 1000.0).astype(np.float32)
    (text,) = said(written(tmp_path / "radii.tif", km))
    assert "look like radii in kilometres; declare the unit and the offset" in text
    assert "gdal_translate -a_scale 1000 -a_offset -1737400 for" in text
    assert said(written(tmp_path / "both.tif", km, scale=1e3, offset=-1_737_400.0)) == ()


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


@pytest.mark.parametrize(("side", "seen"), [(4, 1024), (800, 1024), (800, 64)])
def test_zeros_alone_are_one_line_in_the_words_of_the_check(
    side: int, seen: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path / "zero.tif", np.zeros((side, side), np.float32))
    (problem,) = check_dem(path).problems
    assert "every pixel is zero: an incomplete download" in problem
    if seen < side:
        problem = problem.replace("pixel", "pixel that was looked at")
    dems = DemSet.open([path])
    warn_of_doubts(dems, dems.bounds, seen)
    assert [record.getMessage() for record in caplog.records] == [problem]


@pytest.mark.parametrize("height", [0.0, 5.0, np.nan])
def test_a_build_refuses_zeros_alone_when_it_has_read_them_all(
    height: float, tmp_path: Path
) -> None:
    """The windows show zeros; one pixel between them may be another."""
    zeros = np.zeros((800, 800), np.float32)
    zeros[130, 130] = height
    dems = DemSet.open([written(tmp_path / "zero.tif", zeros)])
    if height:
        refuse_zeros(dems, dems.bounds, 64)
        return
    with pytest.raises(DemError, match=r"zero\.tif: every pixel is zero: an incomplete download"):
        refuse_zeros(dems, dems.bounds, 64)


@pytest.mark.parametrize(
    ("place", "size_km", "refused"),
    [(None, 0.1, True), ((130, 130), 10.0, False), ((130, 130), 0.1, True)],
)
def test_zeros_on_a_server_are_refused_by_windows_and_the_region(
    place: tuple[int, int] | None, size_km: float, refused: bool, tmp_path: Path
) -> None:
    """800 x 800 pixels, no tile of which is asked for but those of windows of 64 and of a region around their middle; a height
    between the windows counts in a region that holds it.
    """
    zeros = np.zeros((800, 800), np.float32)
    if place:
        zeros[place] = 5.0
    path = written(tmp_path / "zero.tif", zeros)
    dem = DemSet.open([path]).dems[0]
    lon, lat = dem.grid.lonlat(*(place or (400, 400)))
    aside = 0.0 if size_km > 1.0 else 0.1
    region = Area(float(lon) + aside, float(lat), size_km).bounds
    with range_server(tmp_path) as served:
        dems = DemSet.open([Path(f"{served.url}/zero.tif")])
        if not refused:
            refuse_zeros(dems, region, 64)
            return
        with pytest.raises(
            DemError, match=r"zero\.tif: every pixel that was looked at is zero: an in"
        ):
            refuse_zeros(dems, region, 64)
        assert sum(count for *_, count in served.asked) < 0.6 * path.stat().st_size


@pytest.mark.parametrize("crs", [None, NORTH.format(lon=0)])
def test_all_pixels_in_a_box_are_looked_at(crs: str | None, tmp_path: Path) -> None:
    """And hardly others, for boxes of all sizes, also beyond the file; by the places of all pixels."""
    how = {} if crs is None else {"crs": crs}
    path = geotiff(tmp_path / "zero.tif", np.zeros((800, 800), np.float32), 1e5, 8e5, 118.0, **how)
    dem = DemSet.open([path]).dems[0]
    lon, lat = dem.grid.lonlat(*np.indices((800, 800))[::-1])
    size, rng = dem.grid.bounds, np.random.default_rng(5)
    for _ in range(40):
        west, east = np.sort(rng.uniform(size.west - 0.1, size.east + 0.1, 2))
        south, north = np.sort(rng.uniform(size.south - 0.1, size.north + 0.1, 2))
        row, col = np.nonzero((lon >= west) & (lon <= east) & (lat >= south) & (lat <= north))
        row0, row1, col0, col1 = plausibility._in_box(dem, Bounds(west, south, east, north))
        assert 0 <= row0 <= row1 <= 800
        assert 0 <= col0 <= col1 <= 800
        if len(row):
            assert row0 <= row.min()
            assert row.max() < row1 <= row.max() + 60
            assert col0 <= col.min()
            assert col.max() < col1 <= col.max() + 60


@pytest.mark.parametrize("filled", [None, (100, 190), (790, 800)])
def test_a_whole_file_on_a_server_is_read_to_its_edges(
    filled: tuple[int, int] | None, tmp_path: Path
) -> None:
    """The region is the file, whose first and last rows lie beside the lattice of places; the line names its URL."""
    zeros = np.zeros((800, 800), np.float32)
    if filled:
        zeros[slice(*filled)] = 5.0
    written(tmp_path / "zero.tif", zeros)
    with range_server(tmp_path) as served:
        dems = DemSet.open([Path(f"{served.url}/zero.tif")])
        if filled:
            refuse_zeros(dems, dems.bounds, 8)
            return
        with pytest.raises(DemError, match=re.escape(f"{served.url}/zero.tif: every pixel that")):
            refuse_zeros(dems, dems.bounds, 8)


@pytest.mark.parametrize("more", [[], ["--plan"]])
def test_an_incomplete_download_fails_before_the_build(
    more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = geotiff(tmp_path / "zero.tif", np.zeros((800, 800)), 70e3, 840e3, 118.45)
    args = ["build-catalog", str(path), "-o", str(tmp_path / "out.h5"), *PLACE, "--size", "20"]
    assert run([*args, *ONE_SUN, *more]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"lcp: {path}: every pixel is zero: an incomplete download; fetch the file again"
    assert list(tmp_path.iterdir()) == [path]


def test_missing_pixels_that_are_written_as_zeros(hadley: np.ndarray, tmp_path: Path) -> None:
    holed = hadley.copy()
    holed[101:127, 203:241] = 0
    (text,) = said(written(tmp_path / "holed.tif", holed))
    assert ZEROS in text
    assert said(written(tmp_path / "declared.tif", holed, nodata=0)) == ()


@pytest.mark.parametrize(
    ("where", "value", "says"),
    [
        ((slice(101, 800, 50), slice(None)), 0.0, f"1.8 % of the pixels {ZEROS}"),
        ((slice(None), slice(77, 78)), 0.0, ZEROS),
        ((slice(300, 301), slice(100, 120)), 0.0, ZEROS),
        ((slice(296, 304), slice(104, 112)), 0.0, ZEROS),
        ((slice(300, 301), slice(100, 113)), 0.0, None),  # the ground has such lines nearly
        ((slice(101, 800, 50), slice(None)), -1234.5, f"1.8 % of the pixels {EQUAL}"),
        ((slice(300, 301), slice(100, 170)), -1234.5, EQUAL),
        ((slice(300, 350), slice(100, 150)), -1234.5, None),
    ],
)
def test_lines_of_one_height(
    where: tuple[slice, slice], value: float, says: str | None, hadley: np.ndarray, tmp_path: Path
) -> None:
    lines = hadley.astype(np.float32)
    lines[where] = value
    found = said(written(tmp_path / "lines.tif", lines))
    assert len(found) == (says is not None)
    assert all(says in text for text in found if says)


def test_narrow_pixels_near_a_pole_may_be_equal(tmp_path: Path) -> None:
    """The first row of a cylinder is 10 km around: 3600 pixels of 3 m, where pixels are 3 km high."""
    lon, lat = np.meshgrid(
        np.radians(np.arange(0.05, 360.0, 0.1)), np.radians(np.arange(89.95, 85.0, -0.1))
    )
    x, y = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon)
    ground = np.rint(900.0 * np.sin(20.0 * x + 0.7) * np.cos(30.0 * y)).astype(np.float32)
    assert np.count_nonzero(np.diff(ground[0])) < 100
    path = geotiff(tmp_path / "polar.tif", ground, 0.0, 90.0 * DEGREE_M, DEGREE_M / 10.0)
    assert said(path) == ()


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


SUN = ["--sun-azimuth", "90", "--sun-elevation", "30"]
PLACE = ["--center", "3.8", "26.2"]
ONE_SUN = ["--gsd", "474", "--sun-azimuths", "105", "--sun-elevations", "30"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        ["dem", "info", "DEM"],
        ["dem", "info", "DEM", "--json"],
        ["render", "DEM", "-o", "OUT.tif", *PLACE, "--size", "3", *SUN],
        ["sun", *PLACE, "--time", "2026-11-27T12:00:00", "--dem", "DEM"],
        ["build-catalog", "DEM", "-o", "OUT.h5", "--plan", *PLACE, "--size", "20", *ONE_SUN],
    ],
)
def test_each_command_says_once_that_heights_are_kilometres(
    command: list[str], hadley: np.ndarray, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = geotiff(tmp_path / "km.tif", (hadley / 1000.0).astype(np.float32), 70e3, 840e3, 118.45)
    args = [one.replace("DEM", str(path)).replace("OUT", str(tmp_path / "out")) for one in command]
    assert run(args) == 0
    assert len({one.getMessage() for one in caplog.records if KILOMETRES in one.getMessage()}) == 1


def test_shares_are_plain_numbers(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    zeros = np.zeros((40, 40), np.float32)
    zeros[0, 0] = 9.0
    path = written(tmp_path / "zero.tif", zeros)
    assert run(["dem", "info", str(path)]) == 0
    assert "100 % of the pixels lie in" in caplog.text


@pytest.mark.parametrize("command", ["info", "check"])
def test_complex_samples_are_no_heights(
    command: str, hadley: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "radar.tif", hadley[:40, :40].astype(np.complex64))
    assert run(["dem", command, str(path)]) != 0
    said = capsys.readouterr()
    assert "radar.tif: complex samples are not heights" in said.out + said.err


@pytest.mark.parametrize(("rows", "cols"), [(1, 40), (2, 2), (1, 1), (2, 40)])
def test_each_command_says_that_a_dem_is_too_small(
    rows: int,
    cols: int,
    hadley: np.ndarray,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    path = written(tmp_path / "cut.tif", hadley[:rows, :cols])
    says = (
        f"cut.tif: has {rows} x {cols} heights (rows x columns); a node of ground has heights on all sides, "
        "which takes at least 3 x 3"
    )
    out = str(tmp_path / "out")
    for args, code in (
        (["dem", "check", str(path)], 4),
        (["dem", "info", str(path)], 0),
        (["dem", "info", "--quick", "--json", str(path)], 0),
        (["render", str(path), "-o", f"{out}.tif", *SUN], 1),
        (["build-catalog", str(path), "-o", f"{out}.h5"], 1),
        (
            [
                "camera",
                "info",
                str(DEM.parent / "AS15-M-0414_camera.json"),
                "--dem",
                str(path),
            ],
            1,
        ),
    ):
        assert run(args) == code
        said = capsys.readouterr()
        problem = says.partition(": ")[2] if args[1] == "check" else says
        assert problem in said.out + said.err + caplog.text
        caplog.clear()
    assert list(tmp_path.iterdir()) == [path]
