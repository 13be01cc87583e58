"""``lcp dem info`` as a user meets it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.catalogs import HADLEY
from helpers.products import DEGREE_M, geotiff, ldem_80s, sldem_512
from lcp_cli.main import run

from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.raster import Raster

CONTRACT = (
    *("path", "product", "projection", "width", "height", "gsd_m", "bounds", "radius_m"),
    *("min_m", "max_m", "nodata_share", "abs_latitude_use", "samples"),
)


def test_json_has_the_contracts_fields(ldem_4: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [str(ldem_4 / "LDEM_4.IMG"), str(ldem_4 / "LDEM_4_JP2.LBL")]
    assert (
        run(
            [
                "dem",
                "info",
                *paths,
                "--json",
                "--at",
                "0.125",
                "0.125",
                "--at",
                "-44.875",
                "-45.125",
            ]
        )
        == 0
    )
    out, err = capsys.readouterr()
    assert err == ""
    first, second = json.loads(out)
    assert {key: first[key] for key in CONTRACT} == {
        "path": paths[0],
        "product": "LDEM_4",
        "projection": "equirectangular",
        "width": 1440,
        "height": 720,
        "gsd_m": pytest.approx(7580.8376),
        "bounds": {"west": 0.0, "south": -90.0, "east": 360.0, "north": 90.0},
        "radius_m": 1737400.0,
        "min_m": -8878.5,
        "max_m": 10504.0,
        "nodata_share": 0.0,
        "abs_latitude_use": None,
        "samples": [
            {"lon": 0.125, "lat": 0.125, "height_m": -796.0},
            {"lon": -44.875, "lat": -45.125, "height_m": -301.0},
        ],
    }
    assert first["effective_resolution_m"] is None  # too coarse for an estimate
    assert (first["vertical_uncertainty_m"], first["true_resolution_m"]) == (10.0, None)
    assert first["area_km2"] == pytest.approx(4 * math.pi * 1737.4**2)
    assert (first["used_share"], first["moon_share"], second["used_share"]) == (1.0, 1.0, 0.0)
    assert first["holes"] == {"area_km2": 0.0, "share": 0.0, "largest": []}
    assert second["path"] == paths[1]
    assert second["bounds"]["west"] == -180.0
    assert second["samples"][0]["height_m"] == pytest.approx(-796.0, abs=0.5)


def test_the_resolution_of_the_heights_stands_beside_the_published_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """GLD100's published formal figure is 300 m; its heights say about 1 km (a second account, by
    the ground it renders: tests/validation).
    """
    sample = str(HADLEY)
    assert run(["dem", "info", sample, "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)
    assert one["resolution_m"] == one["true_resolution_m"] == 300.0
    found = Dem.open(HADLEY).effective_resolution
    assert one["effective_resolution_m"] == found.resolution_m == pytest.approx(1000.0, rel=0.25)
    assert one["effective_resolution_low_m"] == found.low_m
    assert one["effective_resolution_high_m"] == found.high_m
    assert run(["dem", "info", sample]) == 0
    text = capsys.readouterr().out
    assert f"  resolves     {found.resolution_m:.0f} m on the surface by its heights" in text
    assert "               300 m as published" in text
    assert run(["dem", "info", sample, "--json", "--quick"]) == 0
    (one,) = json.loads(capsys.readouterr().out)
    assert one["effective_resolution_m"] is one["effective_resolution_low_m"] is None
    assert run(["dem", "info", sample, "--quick"]) == 0
    assert "by its heights" not in capsys.readouterr().out


def test_polar_product(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dem", "info", str(ldem_80s(tmp_path, 60)), "--json", "--at", "0", "0"]) == 0
    (one,) = json.loads(capsys.readouterr().out)
    assert (one["projection"], one["gsd_m"], one["abs_latitude_use"]) == (
        "polar-stereographic",
        20.0,
        [80.0, 85.0],
    )
    assert (one["bounds"]["south"], one["bounds"]["west"], one["bounds"]["east"]) == (
        -90.0,
        0.0,
        360.0,
    )
    assert one["samples"] == [{"lon": 0.0, "lat": 0.0, "height_m": None}]


def test_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        run(
            [
                "dem",
                "info",
                str(sldem_512(tmp_path, 10, 20, 64, 48)),
                "--at",
                "10.05",
                "19.95",
                "--at",
                "50",
                "0",
            ]
        )
        == 0
    )
    out = capsys.readouterr().out
    assert "SLDEM2015_512" in out
    assert "64 x 48 pixels of 59.2252938 m" in out
    assert "longitude 10 .. 10.125, latitude 19.9062 .. 20" in out
    assert "latitudes 0 .. 60 north and south" in out
    file, ground, table = out.split("\n\n")
    assert file.splitlines()[-1].split() == ["at", "50", "0", "outside", "the", "file"]
    share = (
        math.radians(0.125)
        / (4 * math.pi)
        * (math.sin(math.radians(20)) - math.sin(math.radians(19.90625)))
    )
    assert ground.splitlines()[1].split() == [
        "covered",
        f"{4 * math.pi * 1737.4**2 * share:.3g}",
        "km2,",
        "<0.01",
        "%",
        "of",
        "the",
        "Moon",
    ]
    assert [line.split() for line in table.splitlines()] == [
        ["latitude", "covered"],
        ["0", "..", "60", "N", "<0.01", "%"],
    ]


@pytest.mark.parametrize("name", ["missing.tif", "text.tif", "bare.IMG", "."])
def test_one_line_says_what_failed(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "text.tif").write_text("hello")
    (tmp_path / "bare.IMG").write_bytes(bytes(100))
    assert run(["dem", "info", str(tmp_path / name)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("lcp: ")
    assert str(tmp_path) in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "arguments", [[], ["x.tif", "--at", "0"], ["x.tif", "--at", "0", "91"], ["x.tif", "--nope"]]
)
def test_wrong_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dem", "info", *arguments]) == 2
    assert "Error: " in capsys.readouterr().err


def tile(
    path: Path,
    west: float,
    north: float,
    shape: tuple[int, int],
    height_m: float = 0.0,
    ppd: int = 4,
) -> str:
    heights = np.full(shape, height_m, np.float32)
    heights[: shape[0] // 4, : shape[1] // 4] = -32768.0  # the north-west sixteenth is missing
    return str(
        geotiff(path, heights, west * DEGREE_M, north * DEGREE_M, DEGREE_M / ppd, nodata=-32768.0)
    )


@pytest.fixture
def pair(tmp_path: Path) -> list[str]:
    """GLD100_4 on 0..20 E, 0..20 N and GLD100_8 on 10..20 E, 0..10 N: all of it on the first; they differ by 500 m."""
    coarse = tile(tmp_path / "GLD100_E000N0000_004P.tif", 0, 20, (80, 80))
    return [coarse, tile(tmp_path / "GLD100_E010N0000_008P.tif", 10, 10, (80, 80), 500.0, 8)]


def area(west: float, south: float, east: float, north: float) -> float:
    return (
        1737.4**2
        * math.radians(east - west)
        * (math.sin(math.radians(north)) - math.sin(math.radians(south)))
    )


def test_a_set_as_json(pair: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dem", "info", "--set", "--json", *pair]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert err == ""
    assert found["bounds"] == {"west": 0.0, "south": 0.0, "east": 20.0, "north": 20.0}
    assert found["covered_km2"] == pytest.approx(area(0, 0, 20, 20))
    (band,) = found["bands"]
    whole = area(0, 0, 360, 60)
    assert (band["south"], band["north"], band["gap_km2"]) == (0.0, 60.0, 0.0)
    assert band["overlap_share"] == pytest.approx(area(10, 0, 20, 10) / whole)
    assert band["used_share"] == {
        "GLD100_8": pytest.approx(area(10, 0, 20, 10) / whole),
        "GLD100_4": pytest.approx((area(0, 0, 20, 20) - area(10, 0, 20, 10)) / whole),
    }
    (overlap,) = found["overlaps"]
    assert overlap["files"] == pair
    assert overlap["bounds"] == {"west": 10.0, "south": 0.0, "east": 20.0, "north": 10.0}
    first, second = found["holes"]
    assert first["largest"][0]["bounds"] == {"west": 0.0, "south": 15.0, "east": 5.0, "north": 20.0}
    assert second["largest"][0]["bounds"] == {
        "west": 10.0,
        "south": 7.5,
        "east": 12.5,
        "north": 10.0,
    }
    assert second["area_km2"] == pytest.approx(area(10, 7.5, 12.5, 10), rel=1e-4)
    (differing,) = found["disagreements"]
    assert sorted(differing["products"]) == ["GLD100_4", "GLD100_8"]
    assert differing["median_m"] == pytest.approx(500.0)


def test_an_order_of_products_says_what_is_used(
    pair: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["dem", "info", "--quick", "--json", "--product-order", "GLD100_4", *pair]) == 0
    first, second = json.loads(capsys.readouterr().out)
    assert (first["used_share"], second["used_share"]) == (1.0, 0.0)


def test_a_set_in_words(pair: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dem", "info", *pair]) == 0
    first, second, together, table = capsys.readouterr().out.split("\n\n")
    names = [Path(path).name for path in pair]
    assert first.splitlines()[0] == pair[0]
    assert second.splitlines()[0] == pair[1]
    lines = [line.split(maxsplit=1) for line in together.splitlines()]
    words = {line[0]: line[1] for line in lines}
    left = 1.0 - area(10, 0, 20, 10) / area(0, 0, 20, 20)
    assert words["used"] == f"{names[0]}: {100 * left:.2f} % of its area"
    assert words[
        "overlaps"
    ] == f"{names[0]} and {names[1]}: {area(10, 0, 20, 10):,.0f} km2".replace(",", " ")
    assert words["gaps"] == "none"
    assert "differ by 500.0 m" in words["warning"]
    assert [line.split()[0] for line in table.splitlines()] == ["latitude", "0"]


def test_a_warning_beside_the_list_goes_to_stderr(
    pair: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["dem", "info", "--json", *pair]) == 0
    out, err = capsys.readouterr()
    assert [one["path"] for one in json.loads(out)] == pair
    assert err.startswith("lcp: warning: ")
    assert "differ by 500.0 m" in err
    assert err.count("\n") == 1


def test_every_pixel_is_read_twice(pair: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for the heights, once for the resolution of so small a file: its 20 degrees of latitude
    in two windows of 48 rows.
    """
    seen: list[int] = []
    read = Raster.read

    def counted(self: Raster, row0: int, row1: int, col0: int, col1: int) -> np.ndarray:
        seen.append((row1 - row0) * (col1 - col0))
        return read(self, row0, row1, col0, col1)

    monkeypatch.setattr(Raster, "read", counted)
    assert run(["dem", "info", pair[0]]) == 0
    assert sum(seen) == 80 * 80 + 2 * 48 * 80
    seen.clear()
    assert run(["dem", "info", "--quick", *pair, "--map", str(Path(pair[0]).parent / "q.png")]) == 0
    assert seen == []


def test_quick_says_what_it_did_not_read(
    pair: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["dem", "info", "--quick", "--json", *pair]) == 0
    for one in json.loads(capsys.readouterr().out):
        assert [one[key] for key in ("min_m", "max_m", "nodata_share", "holes")] == [None] * 4
    assert run(["dem", "info", "--quick", "--set", "--json", *pair]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["holes"], found["disagreements"]) == (None, None)
    assert run(["dem", "info", "--quick", pair[0]]) == 0
    out = capsys.readouterr().out
    assert out.count("not read (--quick)") == 3  # heights, missing pixels, holes


def test_a_map_is_written_once(
    pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "map.png"
    assert run(["dem", "info", *pair, "--map", str(out)]) == 0
    first = out.read_bytes()
    assert first.startswith(b"\x89PNG")
    capsys.readouterr()
    assert run(["dem", "info", pair[0], "--map", str(out)]) == 1
    assert capsys.readouterr().err == f"lcp: {out} exists; use --overwrite to replace it\n"
    assert out.read_bytes() == first
    assert run(["dem", "info", pair[0], "--map", str(out), "--overwrite"]) == 0
    assert out.read_bytes() != first


def test_a_map_that_exists_is_said_before_anything_is_read(
    pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "map.png"
    out.write_bytes(b"mine")
    assert run(["dem", "info", *pair, str(tmp_path / "missing.tif"), "--map", str(out)]) == 1
    assert "map.png exists" in capsys.readouterr().err
    assert out.read_bytes() == b"mine"


def test_nothing_is_written_when_a_file_is_broken(pair: list[str], tmp_path: Path) -> None:
    Path(pair[1]).write_bytes(Path(pair[1]).read_bytes()[:1500])
    assert run(["dem", "info", *pair, "--map", str(tmp_path / "map.png")]) == 1
    assert not list(tmp_path.glob("*.png"))
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    "arguments",
    [["--at", "0", "0", "--quick"], ["--at", "0", "0", "--set"], ["--overwrite"], ["--map"]],
)
def test_flags_that_do_not_go_together(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["dem", "info", "x.tif", *arguments]) == 2
    assert "Error: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("south", "says"),
    [
        (69, "any latitude"),
        (75, "latitudes up to 79 north and south; beyond, the file is filled with heights of LOLA"),
    ],
)
def test_gld100_says_where_its_heights_are_not_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], south: int, says: str
) -> None:
    heights = np.zeros((40, 40), np.float32)
    path = tmp_path / "WAC_GLD100_E000N1800_004P.tif"
    geotiff(path, heights, 0.0, (south + 10) * DEGREE_M, DEGREE_M / 4)
    assert run(["dem", "info", str(path), "--quick"]) == 0
    assert f"  use          {says}" in capsys.readouterr().out
    assert run(["dem", "info", str(path), "--quick", "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)
    assert (one["filled_beyond_deg"], one["filled_with"]) == (79.0, "LOLA")
