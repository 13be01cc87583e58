"""The Sun over a place within its terrain: comparison with a closed form on the sphere and with the
disc cut by a level horizon.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.products import cylinder
from lcp_cli.main import run
from terrain.test_surroundings import horizon_deg, ridge

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.ephemeris.limb_darkening import VISIBLE
from lcp_catalog.ephemeris.solar_position import sun_table
from lcp_catalog.errors import AreaError
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.light.sun_visibility import among_terrain, sun_over_ground
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.surroundings import SunRays, build_surrounded, surroundings
from lcp_catalog.terrain.terrain import Ground


@pytest.fixture(scope="module")
def range_dem(tmp_path_factory):
    """A plain, and a range of mountains 161 km east of longitude 0."""
    path = tmp_path_factory.mktemp("range") / "range.tif"
    return cylinder(path, -6.0, 6.0, (192, 352), 16.0, ridge)


@pytest.mark.parametrize("above_m", [0.0, 2000.0])
def test_a_far_range_cuts_the_disc(range_dem, above_m) -> None:
    """Suns due east, from below the range to above it; the range's height is constant across the
    disc to 0.001 deg.
    """
    dems = DemSet.open([range_dem])
    ground = Ground(dems, EnuFrame(0.0, 0.0), NodeWindow(0, 1, 0, 1), 100.0)
    terrain = build_surrounded(
        ground, surroundings(ground, SunRays.all_around(math.tan(math.radians(-2.0))))
    )
    height = horizon_deg(0.0)
    if above_m:
        a = np.radians(np.linspace(0.1, 12.0, 200_001))
        r = 1_737_400.0 + ridge(np.degrees(a), 0.0)
        height = np.degrees(np.arctan2(r * np.cos(a) - 1_737_400.0 - above_m, r * np.sin(a))).max()
    times = [f"2024-01-01T0{k}:00" for k in range(9)]
    suns = height + np.linspace(-0.4, 0.4, 9)
    table = replace(
        sun_table(EnuFrame(0.0, 0.0), times),
        azimuth_deg=np.full(9, 90.0), elevation_deg=suns, disc_radius_deg=np.full(9, 0.267),
    )  # fmt: skip
    seen = among_terrain(table, terrain, above_m)
    np.testing.assert_allclose(seen.horizon_deg, height, atol=0.003)
    want = VISIBLE.share_above((height - suns) / 0.267)
    np.testing.assert_allclose(seen.terrain_share, np.clip(want, 0.0, 1.0), atol=0.012)
    assert seen.terrain_share[0] == 0.0
    assert seen.terrain_share[-1] == 1.0


def test_the_height_of_the_place(range_dem) -> None:
    dems = DemSet.open([range_dem])
    found = sun_over_ground(dems, 4.9, 0.0, "2024-01-01", 10.0, gsd_m=400.0)
    assert found.place.height_m == pytest.approx(float(ridge(np.array(4.9), 0.0)) + 10.0, abs=5.0)
    with pytest.raises(AreaError, match="no DEM has a height at longitude 30"):
        sun_over_ground(dems, 30.0, 0.0, "2024-01-01", gsd_m=400.0)
    with pytest.raises(AreaError, match="invalid height"):
        sun_over_ground(dems, 0.0, 0.0, "2024-01-01", -1.0)


def test_the_command_prints_both_shares(range_dem, capsys) -> None:
    """A lunar day on the plain: both shares are 1 under a high Sun and 0 at night; behind the range
    only the share above the plane is above 0.
    """
    flags = ["--lon", "0", "--lat", "0", "--range", "2024-01-18T04:00", "2024-01-19T16:00", "3h"]
    assert run(["sun", *flags, "--json", "--dem", str(range_dem), "--gsd", "400"]) == 0
    document = json.loads(capsys.readouterr().out)
    suns = document["suns"]
    assert any("above the terrain" in line for line in document["remarks"])
    hidden = [s for s in suns if s["disc_share"] == 1.0 and s["terrain_share"] == 0.0]
    low = [s for s in suns if 0.3 < s["elevation_deg"] < s["horizon_deg"] - 0.27]
    assert hidden == low
    assert all(s["terrain_share"] == 1.0 for s in suns if s["elevation_deg"] > 3.0)
    assert all(s["terrain_share"] == 0.0 for s in suns if s["elevation_deg"] < -1.0)
    assert run(["sun", *flags, "--dem", str(range_dem), "--gsd", "400"]) == 0
    assert capsys.readouterr().out.splitlines()[5].split()[-2:] == ["horizon", "lit"]


@pytest.mark.parametrize(
    ("flags", "code", "says"),
    [
        (["--gsd", "10"], 2, "--gsd needs --dem"),
        (["--dem", "DEM", "--height", "-5"], 2, "--height must not be negative with --dem"),
        (["--dem", "missing.tif"], 1, "there is no such file"),
        (["--dem", "DEM", "--lon", "90"], 1, "has no height in the DEM, which covers"),
    ],
)
def test_errors_are_one_line(range_dem, capsys, flags, code, says) -> None:
    words = [str(range_dem) if flag == "DEM" else flag for flag in flags]
    where = [] if "--lon" in words else ["--lon", "0"]
    assert run(["sun", *where, "--lat", "0", "--time", "2024-01-01", *words]) == code
    error = capsys.readouterr().err
    assert says in error
    assert "Traceback" not in error
