"""Where the optical axis of a camera meets the surface, and areas around it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.renders import camera_file, read, rolling, write_dem
from helpers.scan_files import scan
from lcp_cli.main import run

from lcp_catalog.cameras.camera_file import read_sensor
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.view import center_of, looking_camera
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import CameraError
from lcp_catalog.geometry.frames import EnuFrame, central_angle_deg
from lcp_catalog.rendering.placement import axis_place

PLACE = EnuFrame(30.5, 10.5)
M_PER_DEG = np.radians(1.0) * MOON_RADIUS_M


def oblique(east_m: float = -40e3, up_m: float = 40e3) -> Camera:
    """A camera that looks at the place from the west; its axis is far from the image's middle."""
    made = looking_camera(PLACE, [east_m, 0.0, up_m], 120.0, (12e3, 12e3))
    return replace(made, principal_point_px=(20.0, 80.0))


def away_m(place, east_m: float) -> float:
    """Distance of a place from one east of the area's centre."""
    lon, lat = place
    there = np.degrees(east_m / MOON_RADIUS_M / np.cos(np.radians(10.5))) + 30.5
    return central_angle_deg(lon, lat, there, 10.5) * M_PER_DEG


def dem(folder, heights) -> DemSet:
    return DemSet.open([write_dem(folder / "dem.tif", heights, 30.0, 11.0)])


def test_the_axis_meets_the_sphere_at_the_place_it_looks_at():
    assert away_m(axis_place(oblique(), None), 0.0) < 1e-3


@pytest.mark.parametrize("height_m", [-3000.0, 0.0, 4000.0])
def test_the_axis_meets_ground_at_its_height(tmp_path, height_m):
    """At 45 deg, ground above the sphere is met as far west of the place as it is high."""
    found = axis_place(oblique(), dem(tmp_path, np.full((256, 256), height_m)))
    assert away_m(found, -height_m) < 0.004 * abs(height_m) + 1.0


def test_the_first_of_several_crossings_counts(tmp_path):
    z = np.zeros((256, 256))
    z[:, 90:100] = 6000.0  # a wall, 3.3 to 4.5 km west of the place
    found = axis_place(oblique(), dem(tmp_path, z))
    wall_m = (90 - 128) / 256 * M_PER_DEG * np.cos(np.radians(10.5))
    assert away_m(found, wall_m) < 30.0


def test_beside_the_dem_the_sphere_counts(tmp_path):
    east = write_dem(tmp_path / "e.tif", np.full((64, 64), 900.0), 33.0, 11.0)
    assert away_m(axis_place(oblique(), DemSet.open([east])), 0.0) < 1e-3


def test_an_axis_into_the_sky_is_refused():
    up = replace(
        oblique(),
        rotation_mcmf_to_camera=np.diag([1.0, -1.0, -1.0]) @ oblique().rotation_mcmf_to_camera,
    )
    with pytest.raises(CameraError, match="`around` footprint"):
        axis_place(up, None)


def test_the_axis_of_a_scanner_is_the_ray_of_its_middle(tmp_path):
    scanner = read_sensor(scan(tmp_path / "scan.json"))
    np.testing.assert_allclose(axis_place(scanner, None), center_of(scanner), atol=1e-9)


@pytest.mark.slow
def test_areas_around_the_axis_and_the_footprint(tmp_path, capsys):
    """The principal point in the upper left: the axis lies north-west of the footprint's middle."""
    ground = write_dem(tmp_path / "hills.tif", rolling(256, 256), 30.0, 11.0)
    camera = camera_file(tmp_path / "CAMERA.json", principal_point_px=[20.0, 10.0])
    given = ["render", ground, "--camera", camera, "--size", "2"]
    centres = {}
    for around in ("axis", "footprint", None):
        option = ["--around", around] if around else []
        out = str(tmp_path / f"{around}.tif")
        assert run([*given, "-o", out, *option]) == 0
        bands, _, tags = read(out)
        centres[around] = float(tags["center_lon"]), float(tags["center_lat"])
        assert bands["radiance"].shape == (19, 19)
    assert centres["axis"] == pytest.approx((30.5, 10.5), abs=0.004)
    assert centres[None] == centres["footprint"]
    # 50 km up, 400 pixels of focal length: 125 m a pixel
    east = 29.5 * 125.0 / M_PER_DEG / np.cos(np.radians(10.5))
    south = 29.5 * 125.0 / M_PER_DEG
    assert centres["footprint"] == pytest.approx((30.5 + east, 10.5 - south), abs=0.002)
    sphere = ["--surface", "sphere", "--gsd", "100", "-o", str(tmp_path / "s.tif")]
    assert run(["render", "--camera", camera, "--size", "2", "--around", "axis", *sphere]) == 0
    assert float(read(tmp_path / "s.tif")[2]["center_lat"]) == pytest.approx(10.5, abs=1e-9)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--around", "axis"], "needs --camera (or --fov) and --size"),
        (["--around", "axis", "--size", "3"], "needs --camera (or --fov) and --size"),
        (
            ["--camera", "C", "--around", "axis", "--size", "3", "--center", "30", "10"],
            "excludes --center",
        ),
        (["--size", "3"], "--size needs --center"),
    ],
)
def test_around_needs_a_camera_and_a_size(tmp_path, capsys, options, words):
    ground = write_dem(tmp_path / "hills.tif", rolling(64, 64), 30.0, 11.0)
    camera = camera_file(tmp_path / "CAMERA.json")
    options = [camera if option == "C" else option for option in options]
    assert run(["render", ground, "-o", str(tmp_path / "o.tif"), *options]) == 2
    assert words in capsys.readouterr().err
