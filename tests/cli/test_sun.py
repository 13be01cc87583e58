"""``lcp sun`` from the outside, and ``lcp render``'s Sun against it."""

import csv
import io
import json
import os

import numpy as np
import pytest
import rasterio
from helpers import products
from lcp_cli import sun as command
from lcp_cli.main import run

from lcp_catalog.ephemeris.solar_position import FIGURES as EVERY_FIGURE

HADLEY = ["sun", "--lon", "3.63", "--lat", "26.13"]
DAY = ["--range", "2024-01-20", "2024-01-21", "6h"]
# The Moon's centre instead of the place: R / 0.98 au
PARALLAX_DEG = 0.00068


FIGURES = EVERY_FIGURE[:-2]  # the last two want a DEM


def answer(capsys, *arguments):
    assert run(list(arguments)) == 0
    return capsys.readouterr().out


def suns(capsys, *arguments):
    document = json.loads(answer(capsys, *arguments, "--json"))
    return document, document["suns"]


def test_the_subsolar_point_of_nasas_table(capsys):
    # NASA SVS, Moon Phase and Libration 2024: 2024-01-01 00:00 UT, -55.867, -1.554
    document, (sun,) = suns(capsys, *HADLEY, "--time", "2024-01-01T00:00:00")
    assert sun["subsolar_lon"] - 360.0 == pytest.approx(-55.867, abs=0.005)
    assert sun["subsolar_lat"] == pytest.approx(-1.554, abs=0.005)
    assert document["frame"] == "MOON_ME"
    assert document["direction_error_deg"] == 0.005
    assert (document["lon"], document["lat"], document["height_m"]) == (3.63, 26.13, 0.0)
    assert document["azimuth_zero_lon"] is None


def test_one_figure_three_ways(tmp_path, capsys):
    """Text, JSON and CSV say the same, and each names the frame."""
    target = tmp_path / "OUT.csv"
    document, records = suns(capsys, *HADLEY, *DAY, "-o", str(target))
    assert [sun["time_utc"] for sun in records] == [
        "2024-01-20T00:00:00Z",
        "2024-01-20T06:00:00Z",
        "2024-01-20T12:00:00Z",
        "2024-01-20T18:00:00Z",
        "2024-01-21T00:00:00Z",
    ]
    assert list(records[0]) == ["time_utc", *FIGURES]
    lines = target.read_text(encoding="utf-8").splitlines()
    comments = [line for line in lines if line.startswith("# ")]
    assert any(
        line.startswith("# frame MOON_ME, approximated by the IAU series") for line in comments
    )
    rows = list(csv.DictReader(io.StringIO("\n".join(lines[len(comments) :]))))
    assert [
        {k: v if k == "time_utc" else float(v) for k, v in row.items()} for row in rows
    ] == records
    text = answer(capsys, *HADLEY, *DAY).splitlines()
    assert [line[2:] for line in comments] == [line[2:] for line in text if line.startswith("# ")]
    assert document["remarks"] == [line[2:] for line in comments[1:]]
    head, *table = [line for line in text if not line.startswith("#")]
    assert len({len(line) for line in (head, *table)}) == 1
    for line, sun in zip(table, records, strict=True):
        time, *figures = line.split()
        assert time == sun["time_utc"]
        assert [float(f) for f in figures] == pytest.approx([sun[k] for k in FIGURES], abs=5.1e-5)


def test_nothing_is_printed_beside_a_file(tmp_path, capsys):
    assert answer(capsys, *HADLEY, *DAY, "-o", str(tmp_path / "OUT.csv")) == ""
    assert os.listdir(tmp_path) == ["OUT.csv"]


def test_blocks_of_lines_do_not_show(tmp_path, capsys, monkeypatch):
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    out = [answer(capsys, *HADLEY, *DAY, "--json", "-o", str(paths[0]))]
    monkeypatch.setattr(command, "LINES_AT_ONCE", 3)
    out.append(answer(capsys, *HADLEY, *DAY, "--json", "-o", str(paths[1])))
    assert out[0] == out[1]
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "--time UTC or --range"),
        (["--time", "2024-01-01", *DAY], "--time UTC or --range"),
        (["--time", "2024"], "invalid time: '2024'"),
        (["--time", "2024-01-01T00:00:60"], "no leap second"),
        (["--time", "1899-12-31"], "1900-2099"),
        (["--time", "0001-01-01T00:00:00+14:00"], "1900-2099"),
        (["--range", "2024-01-02", "2024-01-01", "1h"], "before it starts"),
        (["--range", "2024-01-01", "2024-01-02", "1x"], "invalid step: '1x'"),
        (["--range", "2024-01-01", "2024-01-02", "-1h"], "invalid step"),
        (["--range", "2024-01-01", "2024-01-02", "0s"], "invalid step"),
        (["--range", "2000-01-01", "2024-01-01", "1s"], "take a longer step"),
        (["--time", "2024-01-01", "--lat", "91"], "91"),
        (["--time", "2024-01-01", "--lon", "400"], "400"),
        (["--time", "2024-01-01", "--height", "nan"], "nan"),
        (["--time", "2024-01-01", "--height", "-1737400"], "-1737400"),
    ],
)
def test_usage_that_is_refused(arguments, says, capsys):
    assert run([*HADLEY, *arguments]) == 2
    error = capsys.readouterr().err
    assert says in error.splitlines()[-1]


def test_a_file_in_the_way(tmp_path, capsys):
    target = tmp_path / "OUT.csv"
    target.write_text("mine")
    arguments = [*HADLEY, "--time", "2024-01-01", "-o", str(target)]
    assert run(arguments) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert target.read_text() == "mine"
    assert run([*arguments, "--overwrite"]) == 0
    assert target.read_text().startswith("# the Sun over longitude 3.63")


@pytest.mark.parametrize(
    ("time", "same"),
    [
        ("2024-01-20T09:00:00+03:00", "2024-01-20T06:00:00Z"),
        ("20240120T060000", "2024-01-20T06:00:00"),
        ("2024-01-20T06:00:00.250", "2024-01-20T06:00:00.250000Z"),
        ("2017-01-01T02:59:60+03:00", "2016-12-31T23:59:60"),
    ],
)
def test_ways_to_say_a_time(time, same, capsys):
    assert answer(capsys, *HADLEY, "--time", time) == answer(capsys, *HADLEY, "--time", same)


def test_the_pole_is_said(capsys):
    text = answer(capsys, "sun", "--lon", "45", "--lat", "90", "--time", "2024-07-01")
    assert "# at the pole azimuth 0 points along the meridian 225 deg east" in text
    document, _ = suns(capsys, "sun", "--lon", "45", "--lat", "-90", "--time", "2024-01-01")
    assert document["azimuth_zero_lon"] == 45.0


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """The sphere at both poles, and across the prime meridian."""
    folder = tmp_path_factory.mktemp("bare")
    flat = np.zeros((128, 128), np.float32)
    files = {}
    for name, lat in (("north", 90), ("south", -90)):
        crs = f"+proj=stere +lat_0={lat} +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs"
        files[name] = products.geotiff(folder / f"{name}.tif", flat, -6400, 6400, 100.0, crs)
    files["equator"] = products.geotiff(folder / "equator.tif", flat, -6400, 6400, 100.0)
    return files


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "lon", "lat", "time"),
    [
        ("north", 77.0, 89.9, "2022-09-10T12:00:00"),
        ("north", 77.0, 90.0, "2022-09-10T12:00:00"),
        ("north", -160.0, 90.0, "2022-09-10T15:00:00+03:00"),
        ("south", 300.0, -89.9, "2024-01-01"),
        ("south", 300.0, -90.0, "2024-01-01T00:00:00.5"),
        ("equator", 359.99, 0.01, "2020-12-24T00:00:00"),
        ("equator", -0.01, 0.01, "2020-12-24T00:00:00"),
        ("equator", 0.0, 0.0, "1969-07-27T20:17:40"),
        ("equator", 0.0, 0.0, "2060-01-20T08:00:00"),
        ("equator", 0.0, 0.0, "2015-06-30T23:59:60"),
    ],
)
def test_the_sun_of_a_render_is_that_of_lcp_sun(where, lon, lat, time, bare, tmp_path, capsys):
    """Its tags hold the Sun of the Moon's centre: up to the parallax away."""
    _, (sun,) = suns(capsys, "sun", "--lon", str(lon), "--lat", str(lat), "--time", time)
    area = ["--center", str(lon), str(lat), "--size", "1"]
    target = str(tmp_path / "OUT.tif")
    arguments = ["render", str(bare[where]), *area, "--time", time, "--accuracy", "draft"]
    assert sun["elevation_deg"] > 0.5  # else nothing is rendered
    assert run([*arguments, "-o", target]) == 0
    with rasterio.open(target) as file:
        tags = file.tags()
    assert tags["frame"] == "MOON_ME"
    assert float(tags["sun_elevation"]) == pytest.approx(sun["elevation_deg"], abs=PARALLAX_DEG)
    apart = (float(tags["sun_azimuth"]) - sun["azimuth_deg"] + 180.0) % 360.0 - 180.0
    assert abs(apart) < 2e-6  # parallax moves nothing sideways; six decimals are printed
    subsolar = [str(sun["subsolar_lon"]), str(sun["subsolar_lat"])]
    again = str(tmp_path / "AGAIN.tif")
    assert run([*arguments[:-4], "--accuracy", "draft", "--subsolar", *subsolar, "-o", again]) == 0
    with rasterio.open(again) as file:
        assert float(file.tags()["sun_elevation"]) == pytest.approx(
            float(tags["sun_elevation"]), abs=2e-6
        )


@pytest.mark.parametrize("time", ["0001-01-01", "2100-01-01", "2016-12-30T23:59:60", "2024"])
def test_a_render_refuses_the_same_times_in_one_line(time, bare, tmp_path, capsys):
    target = tmp_path / "OUT.tif"
    arguments = ["render", str(bare["equator"]), "--time", time, "-o", str(target)]
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert error.splitlines()[-1].startswith("Error: Invalid value for '--time':")
    assert not target.exists()
