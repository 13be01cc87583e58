"""``lcp render`` at the edges of the Moon, of its options and of reason: a picture lit from the right
side, or one line that says what is wrong.
"""

from __future__ import annotations

import math
import os

import numpy as np
import pytest
from helpers.products import cylinder
from helpers.renders import read, write_dem
from lcp_cli.main import run

from lcp_catalog.accuracy import TIERS

R = 1_737_400.0


def cone(lon, lat):
    """Hills that are the same seen along every meridian; 1 km high, at the poles and the crossings."""
    across, along = ((lon + 90.0) % 180.0 - 90.0) / 0.6, lat / 0.6
    poles = np.exp(-(((90.0 - np.abs(lat)) / 0.6) ** 2))
    return 1000.0 * (np.exp(-(across**2)) * np.exp(-(along**2)) + poles)


@pytest.fixture(scope="module")
def moon(tmp_path_factory):
    """The whole Moon, 8 pixels a degree: four hills, around (0, 0), (180, 0) and both poles."""
    path = tmp_path_factory.mktemp("moon") / "moon.tif"
    return str(cylinder(path, -180.0, 90.0, (1440, 2880), 8.0, cone))


@pytest.fixture
def out(tmp_path):
    return tmp_path / "OUT.tif"


def render(moon, out, *arguments):
    assert run(["render", moon, "-o", str(out), *map(str, arguments)]) == 0
    bands, _, _ = read(out)
    return bands


HILLS = [(0, 0), (360, 0), (180, 0), (-180, 0), (0, 90), (123, 90), (180, 90), (0, -90), (270, -90)]
CASES = [(centre, "standard") for centre in HILLS] + [
    pytest.param(centre, tier, marks=pytest.mark.slow) if number % 3 else (centre, tier)
    for number, (tier, centre) in enumerate(
        (tier, centre)
        for tier in TIERS
        if tier != "standard"
        for centre in ((0, 0), (-180, 0), (123, 90), (270, -90))
    )
]
"""Where a hill is, is the terrain's affair, and its shadows the tier's: every hill, and every tier at four."""


@pytest.mark.slow
@pytest.mark.parametrize(("centre", "tier"), CASES)
def test_a_hill_is_lit_on_the_side_of_the_sun(moon, out, centre, tier):
    """East Sun: the east flank is bright; north Sun: the upper one. Also over the poles and seams."""
    for azimuth, bright in ((0, np.s_[3:9, 10]), (90, np.s_[10, 12:18])):
        sun = ["--sun-azimuth", azimuth, "--sun-elevation", 5, "--accuracy", tier]
        bands = render(
            moon, out, "--center", *centre, "--size", 40, "--gsd", 2000, *sun, "--overwrite"
        )
        radiance = bands["radiance"]
        assert radiance.shape == (21, 21)
        assert np.isfinite(radiance).all()
        opposite = radiance[::-1, ::-1][bright]
        assert (radiance[bright] > opposite).all()
        assert radiance[bright].min() > np.median(radiance) * 0.9


def test_the_same_place_by_another_name_is_the_same_picture(moon, tmp_path):
    """0 and 360, 180 and -180; and bounds across the antimeridian are bounds."""
    sun = ["--sun-azimuth", "100", "--sun-elevation", "3"]

    def picture(name, *area):
        bands = render(moon, tmp_path / f"{name}.tif", *area, "--gsd", "2500", *sun)
        return np.stack(list(bands.values()))

    area = ["--size", "50", "--center"]
    np.testing.assert_array_equal(picture("a", *area, 0, 3), picture("b", *area, 360, 3))
    np.testing.assert_array_equal(picture("c", *area, 180, 3), picture("d", *area, -180, 3))
    over = picture("e", "--bounds", 179, -1, -179, 1)
    np.testing.assert_array_equal(over, picture("f", "--bounds", 179, -1, 181, 1))
    # the Moon of these hills is the same on both sides
    np.testing.assert_allclose(
        over, picture("g", "--bounds", -1, -1, 1, 1), atol=2e-3, equal_nan=True
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("elevation", "gsd", "size"),
    [(90, 0.5, 0.01), *[(e, *s) for e in (90, 0, -0.4) for s in ((10_000, 2000), (2000, 0.001))]],
)
def test_suns_and_sizes_at_the_ends(moon, out, elevation, gsd, size):
    area = ["--center", 0, 90, "--size", size, "--gsd", gsd]
    sun = ["--sun-azimuth", 45, "--sun-elevation", elevation]
    bands = render(moon, out, *area, *sun)
    seen = bands["visible"] > 0
    assert seen.all()
    assert np.isfinite(bands["radiance"]).all()
    assert ((bands["sunlit"] >= 0) & (bands["sunlit"] <= 1)).all()
    if elevation == 90:
        # ROLO's disc at phase 0 (Kieffer and Stone 2005, eq. 10), which level ground seen from above has under this law
        log_a = -1.88914 + 0.37141 - 0.13514 + 0.01248 * math.cos(30.5858 / 16.7498)
        assert np.allclose(bands["radiance"], math.exp(log_a))
    if gsd == 10_000 and elevation == 0:
        row, col = np.indices(seen.shape)
        assert (bands["sunlit"][col - row > 40] > 0).mean() > 0.4
        assert not bands["sunlit"][row - col > 40].any()  # the far side of the pole


def test_a_small_fine_area_under_a_low_sun(moon, out):
    """50 m of ground at half a metre: a hill 12 km away may shadow it, 100 x 100 nodes may not."""
    area = ["--center", 0.4, 0, "--size", 0.05, "--gsd", 0.5]
    render(moon, out, *area, "--sun-azimuth", 270, "--sun-elevation", 1)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--altitude", "0.001"], "998 m below the surface (1 m above the reference sphere)"),
        (["--altitude", "1e9"], "leave it out for a camera at infinity"),
        (["--altitude", "1e300"], "leave it out for a camera at infinity"),
        (["--altitude", "1e9", "--frame", "camera"], "leave it out for a camera at infinity"),
        (["--gsd", "0.1"], "too many for one area"),
        (["--gsd", "1e-300"], "too many for one area"),
        (["--sun-elevation", "-20"], "below the horizon"),
        (["--sun-elevation", "-90"], "below the horizon"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(moon, out, capfd, arguments, says):
    stated = {"--size": "4", "--gsd": "1000", "--sun-elevation": "30"}
    stated |= dict(zip(arguments[::2], arguments[1::2], strict=True))
    flags = [word for pair in stated.items() for word in pair]
    assert (
        run(["render", moon, "-o", str(out), "--center", "0", "0", "--sun-azimuth", "9", *flags])
        == 1
    )
    error = capfd.readouterr().err
    assert error.startswith("lcp: ")
    assert error.count("\n") == 1
    assert says in error
    assert os.listdir(out.parent) == []


def test_a_dem_wider_than_a_plane_is_a_wrong_use(moon, out, capfd):
    area = ["--center", "0", "0", "--size", "2000.1", "--sun-azimuth", "9", "--sun-elevation", "30"]
    assert run(["render", moon, "-o", str(out), *area]) == 2
    assert "2000 km wide; for wider areas: --surface sphere" in capfd.readouterr().err
    assert os.listdir(out.parent) == []


def test_from_just_above_the_summit(moon, out):
    """The camera 1 m over the hill's top: it sees the top from above and the flanks edge-on."""
    area = ["--center", 0, 0, "--size", 20, "--gsd", 1000, "--altitude", "1.001"]
    bands = render(moon, out, *area, "--sun-azimuth", 90, "--sun-elevation", 60)
    assert bands["visible"][10, 10] == 1
    assert bands["emission"][10, 10] < 5
    assert np.isfinite(bands["emission"]).all()
    assert (np.isfinite(bands["radiance"]) == (bands["visible"] > 0)).all()


@pytest.mark.slow
def test_from_a_million_kilometres_it_is_the_view_from_infinity(moon, tmp_path):
    area = [
        "--center",
        180,
        0,
        "--size",
        60,
        "--gsd",
        2000,
        "--sun-azimuth",
        10,
        "--sun-elevation",
        9,
    ]
    view = ["--off-nadir", 70, "--view-azimuth", 200]
    near = render(moon, tmp_path / "a.tif", *area, *view, "--altitude", 1e6)
    far = render(moon, tmp_path / "b.tif", *area, *view)
    for band in ("visible", "sunlit", "height"):
        np.testing.assert_array_equal(near[band], far[band])
    angle = math.degrees(42.5e3 / 1e9)  # that the area subtends
    for band in ("emission", "phase"):
        np.testing.assert_allclose(near[band], far[band], atol=angle)


@pytest.mark.parametrize("elevation", [80, 5])
def test_an_areas_border_looks_like_its_inside(moon, tmp_path, elevation):
    _same_in_a_larger_area(moon, tmp_path, elevation)


def test_an_areas_border_looks_like_its_inside_under_the_zenith(moon, tmp_path):
    _same_in_a_larger_area(moon, tmp_path, 90)


def _same_in_a_larger_area(moon, folder, elevation):
    sun = ["--sun-azimuth", 30, "--sun-elevation", elevation, "--center", 0, 0.2, "--gsd", 1000]
    small = render(moon, folder / "small.tif", "--size", 10, *sun)
    large = render(moon, folder / "large.tif", "--size", 20, *sun)
    for band, values in small.items():
        np.testing.assert_array_equal(values, large[band][5:-5, 5:-5], band)


def test_ground_without_light_is_warned_of(tmp_path, caplog):
    """A wall hides the Sun from the whole area: the image is written, and one line says that it is black."""
    heights = np.random.default_rng(0).normal(0.0, 0.1, (128, 128)).astype(np.float32)
    heights[:, 100:] += 300.0
    dem = write_dem(tmp_path / "wall.tif", heights, 30.0, 11.0)
    area = ["--center", "30.3", "10.75", "--size", "4", "--sun-azimuth", "90"]
    out = tmp_path / "o.tif"
    assert run(["render", dem, *area, "--sun-elevation", "45", "-o", str(out)]) == 0
    assert not caplog.messages
    assert run(["render", dem, *area, "--sun-elevation", "3", "-o", str(out), "--overwrite"]) == 0
    assert (read(out)[0]["sunlit"] == 0.0).all()
    (said,) = caplog.messages
    assert "terrain hides the Sun, which is at an elevation of 3.00 deg" in said
    caplog.clear()
    assert (
        run(["render", dem, *area, "--sun-elevation", "-0.3", "-o", str(out), "--overwrite"]) == 0
    )
    (said,) = caplog.messages
    assert "lit: the Sun is below the horizon, at an elevation of -0.30 deg at the area's" in said
    assert "hides" not in said
