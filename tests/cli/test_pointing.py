"""``--fov``, ``--altitude``, ``--look``: a camera without a file, against rays computed here from angles."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import refusal
from helpers.products import cylinder
from helpers.renders import read
from lcp_cli.main import run

R = 1737400.0
PLACE, ALTITUDE_M, SIZE = (30.5, 10.5), 40e3, (60, 40)
AT = ["--center", "30.5", "10.5", "--altitude", "40"]
SUN = ["--subsolar", "60", "0"]
SPHERE = ["render", "--surface", "sphere"]


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Four degrees around the place, 1000 m above the sphere everywhere."""
    path = tmp_path_factory.mktemp("dem") / "level.tif"

    def level(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        return np.full(lon.shape, 1000.0)

    return str(cylinder(path, 28.5, 12.5, (400, 400), 100.0, level))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "OUT.tif"


def pointed(fov: float, look: tuple[float, float], *more: str) -> list[str]:
    size = [str(n) for n in SIZE]
    return [*AT, "--fov", str(fov), "--look", *map(str, look), "--image-size", *size, *SUN, *more]


def hit(
    fov: float, look: tuple[float, float], pixel: tuple[float, float], radius: float
) -> tuple[float, float]:
    """Longitude and latitude, degrees, where the ray of a pixel meets a sphere, by plane and spherical
    trigonometry: the angles of the ray at the camera, the central angle, the great circle.
    """
    across = math.tan(math.radians(fov / 2)) / (SIZE[0] / 2)
    u, v = (across * (pixel[k] - (SIZE[k] - 1) / 2) for k in (0, 1))  # right, down
    elevation = math.radians(look[1])
    ahead = math.cos(elevation) + v * math.sin(elevation)  # level, along the look's azimuth
    up = math.sin(elevation) - v * math.cos(elevation)
    azimuth = math.radians(look[0]) + math.atan2(u, ahead)
    nadir = math.atan2(math.hypot(u, ahead), -up)
    centre = math.asin((R + ALTITUDE_M) / radius * math.sin(nadir)) - nadir
    lat0 = math.radians(PLACE[1])
    lat = math.asin(
        math.sin(lat0) * math.cos(centre) + math.cos(lat0) * math.sin(centre) * math.cos(azimuth)
    )
    turn = math.atan2(
        math.sin(azimuth) * math.sin(centre) * math.cos(lat0),
        math.cos(centre) - math.sin(lat0) * math.sin(lat),
    )
    return PLACE[0] + math.degrees(turn), math.degrees(lat)


def off_m(bands: dict[str, np.ndarray], fov: float, look: tuple[float, float], r: float) -> float:
    """Greatest distance of the rendered positions in the four corners and the middle from `hit`."""
    off = []
    for col in (0, SIZE[0] // 2, SIZE[0] - 1):
        for row in (0, SIZE[1] // 2, SIZE[1] - 1):
            lon, lat = (math.radians(angle) for angle in hit(fov, look, (col, row), r))
            level = math.cos(lat)
            want = [level * math.cos(lon), level * math.sin(lon), math.sin(lat)]
            found = np.array([bands[axis][row, col] for axis in "xyz"])
            off.append(float(np.linalg.norm(found - r * np.array(want))))
    return max(off)


LOOKS = [(40.0, (0.0, -90.0)), (40.0, (90.0, -90.0)), (25.0, (200.0, -50.0)), (70.0, (310.0, -70))]


@pytest.mark.parametrize(("fov", "look"), LOOKS)
def test_the_rays_meet_the_sphere_where_trigonometry_says(
    out: Path, fov: float, look: tuple[float, float]
) -> None:
    assert run([*SPHERE, "-o", str(out), *pointed(fov, look)]) == 0
    bands, profile, tags = read(out)
    assert (profile["width"], profile["height"]) == SIZE
    plan = {d["effect"]: d["reason"] for d in json.loads(tags["scene_plan"])["decisions"]}
    assert plan["perspective"] == "every pixel has its own ray"
    assert off_m(bands, fov, look, R) < 1e-6


@pytest.mark.parametrize(("fov", "look"), LOOKS[1:3])
def test_the_rays_meet_a_dem_where_trigonometry_says(
    dem: str, out: Path, fov: float, look: tuple[float, float]
) -> None:
    """The facets of cells of 303 m lie up to 303^2 / 4 R = 0.013 m below their sphere."""
    surface = ["--surface", "heightfield", "--sun", "point"]
    assert run(["render", dem, "-o", str(out), *pointed(fov, look, *surface)]) == 0
    bands, _, _ = read(out)
    assert bands["visible"].all()
    assert off_m(bands, fov, look, R + 1000.0) < 0.05


def test_without_a_look_it_is_straight_down_with_north_up(out: Path) -> None:
    size = ["--image-size", "5", "4"]
    assert run([*SPHERE, "-o", str(out), *AT, "--fov", "20", *size, *SUN]) == 0
    first = out.read_bytes()
    look = ["--look", "0", "-90", "--overwrite"]
    assert run([*SPHERE, "-o", str(out), *AT, "--fov", "20", *size, *SUN, *look]) == 0
    assert out.read_bytes() == first
    z = read(out)[0]["z"]
    assert (z[0] > z[-1]).all()


@pytest.mark.parametrize("frame", [[], ["--frame", "enu", "--gsd", "2000"]])
def test_the_tag_is_a_camera_file_that_renders_the_same(
    dem: str, out: Path, frame: list[str]
) -> None:
    """Bit by bit; ``--camera`` has the nodes as its default."""
    assert run(["render", dem, "-o", str(out), *pointed(25.0, (200.0, -50.0)), *frame]) == 0
    file, again = out.with_name("CAMERA.json"), out.with_name("again.tif")
    file.write_text(read(out)[2]["camera"])
    given = ["--camera", str(file), *(frame or ["--frame", "camera"])]
    assert run(["render", dem, "-o", str(again), *given, *SUN]) == 0
    assert again.read_bytes() == out.read_bytes()


def test_an_area_around_the_optical_axis(dem: str, out: Path) -> None:
    """``--size`` beside ``--fov`` is that of an area where the axis meets the terrain."""
    fov, look = 25.0, (200.0, -40.0)
    around = ["--around", "axis", "--size", "8", "--frame", "enu", "--gsd", "500"]
    assert run(["render", dem, "-o", str(out), *pointed(fov, look, *around)]) == 0
    bands, _, tags = read(out)
    lon, lat = hit(fov, look, (29.5, 19.5), R + 1000.0)
    assert float(tags["center_lon"]) == pytest.approx(lon, abs=1e-4)  # 3 m
    assert float(tags["center_lat"]) == pytest.approx(lat, abs=1e-4)
    assert bands["visible"].mean() > 0.5


def test_simulate_takes_the_same_camera(dem: str, tmp_path: Path) -> None:
    """The camera file beside the frame is the tag of the render, and takes the same frame."""
    common = ["simulate", dem, "--sun", "point", "--bits", "12"]
    first, second, shot = tmp_path / "a.png", tmp_path / "b.png", tmp_path / "c.tif"
    assert run([*common, "-o", str(first), *pointed(25.0, (200.0, -50.0))]) == 0
    beside = tmp_path / "a_camera.json"
    assert run([*common, "-o", str(second), "--camera", str(beside)]) == 0
    assert second.read_bytes() == first.read_bytes()
    assert run(["render", dem, "-o", str(shot), *pointed(25.0, (200.0, -50.0))]) == 0
    tag = json.loads(read(shot)[2]["camera"])
    assert tag.items() <= json.loads(beside.read_text()).items()


@pytest.mark.slow
def test_looking_above_the_horizon(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From 40 km the limb is acos(R / (R + h)) = 12.2 deg below the horizontal: in a field of view
    of 60 deg the axis may be 5 deg above it, not 20.
    """
    size = ["--image-size", "60", "60", "--fov", "60", *SUN]
    assert run([*SPHERE, "-o", str(out), *AT, *size, "--look", "80", "5"]) == 0
    seen = read(out)[0]["visible"] > 0
    dip = math.acos(R / (R + ALTITUDE_M))
    row = 29.5 + 30 * math.tan(math.radians(5.0) + dip) / math.tan(math.radians(30.0))
    assert abs(np.flatnonzero(seen[:, 30])[0] - row) < 1.0
    assert not seen[: int(row)].any()
    out.unlink()
    error = refusal([*SPHERE, "-o", str(out), *AT, *size, "--look", "80", "20"], 1, capsys)
    assert "the camera does not see the Moon" in error
    assert f"limb is {math.degrees(dip):.4g} deg below the horizontal" in error
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--look", "0", "-90"], "--look needs --fov DEG"),
        (["--image-size", "9", "9"], "--image-size needs --fov DEG"),
        (["--fov", "20"], "--fov needs --center LON LAT (under the camera) and --altitude KM"),
        (["--fov", "20", "--center", "30.5", "10.5"], "and --altitude KM"),
        ([*AT, "--fov", "20", "--camera", "c.json"], "--fov and --camera exclude each other"),
        ([*AT, "--fov", "20", "--off-nadir", "5", "--view-azimuth", "0"], "--look AZ EL gives"),
        ([*AT, "--fov", "20", "--bounds", "30", "10", "31", "11", "--size", "5"], "--size needs"),
        ([*AT, "--fov", "180"], "--fov"),
        ([*AT, "--fov", "20", "--look", "0", "-91"], "--look"),
        ([*AT, "--fov", "20", "--image-size", "0", "9"], "--image-size"),
    ],
)
def test_refused_combinations_of_render(
    dem: str, out: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], says: str
) -> None:
    assert run(["render", dem, "-o", str(out), *arguments, *SUN]) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "no camera: give --camera CAMERA.json, or --fov DEG"),
        (["--camera", "c.json", "--altitude", "40"], "--center and --altitude need --fov DEG"),
        ([*AT], "no camera"),
    ],
)
def test_refused_combinations_of_simulate(
    dem: str, out: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], says: str
) -> None:
    assert run(["simulate", dem, "-o", str(out), *arguments, *SUN]) == 2
    assert says in capsys.readouterr().err
