"""``lcp dem info`` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from lcp_cli.main import run
from products import ldem_80s, sldem_512


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
    assert first == {
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
    assert second["path"] == paths[1]
    assert second["bounds"]["west"] == -180.0
    assert second["samples"][0]["height_m"] == pytest.approx(-796.0, abs=0.5)


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
    assert out.splitlines()[-1].split() == ["at", "50", "0", "no", "data"]


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
