"""What a camera sees: places, pixels and directions against plane geometry, and mistakes that are made on purpose."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers import catalogs, navigable, posed, scan_files

import lcp_catalog as lcp
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.view import footprint
from lcp_catalog.geometry.frames import EnuFrame, direction_enu

RADIUS_M = 1737400.0
PLACE = EnuFrame(3.0, 26.0)


def above(altitude_m: float = 100e3, turn_deg: float = 0.0, **changes: object) -> Camera:
    """A camera straight above `PLACE`, the image's upper edge at an azimuth."""
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    axes = np.array([[c, -s, 0.0], [-s, -c, 0.0], [0.0, 0.0, -1.0]])
    given = {
        "position_mcmf_m": PLACE.to_mcmf([0.0, 0.0, altitude_m]),
        "rotation_mcmf_to_camera": axes @ PLACE.rotation,
        "focal_length_px": 500.0,
        "principal_point_px": (199.5, 149.5),
        "image_size_px": (400, 300),
    }
    return Camera(**given | changes)  # type: ignore[arg-type]  # a dict of values of several types


def test_place_view_and_pixel() -> None:
    """By hand: a pixel of 100 km / 500, a width of 2 atan(200 / 500), a footprint of about 80 x 60 km."""
    found = lcp.camera_info(above()).document
    position, centre = found["position"], found["centre"]
    assert [position["longitude"], position["latitude"]] == pytest.approx([3.0, 26.0], abs=1e-9)
    assert position["height_km"] == pytest.approx(100.0, rel=1e-9)
    assert position["off_nadir_deg"] == pytest.approx(0.0, abs=1e-5)
    wide, high = (2.0 * math.degrees(math.atan(n / 1000.0)) for n in (400, 300))
    assert position["field_of_view_deg"] == pytest.approx([wide, high], rel=1e-9)
    assert position["ground_share"] == 1.0
    north_south = math.radians(position["bounds"]["north"] - position["bounds"]["south"]) * RADIUS_M
    assert north_south == pytest.approx(60e3, rel=0.03)
    assert centre["pixel_m"] == pytest.approx(200.0, rel=1e-6)
    assert found["problems"] == []
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize(
    ("turn_deg", "side"),
    [(0.0, "right"), (90.0, "upper edge"), (180.0, "left"), (-90.0, "lower edge"), (45.0, "upper right")],
)  # fmt: skip
def test_a_turned_image_has_the_sun_on_another_side(turn_deg: float, side: str) -> None:
    """A Sun in the east."""
    sun = 1.5e11 * PLACE.direction_to_mcmf(direction_enu(90.0, 10.0))
    found = lcp.camera_info(above(turn_deg=turn_deg, sun_position_mcmf_m=sun)).document
    assert found["sun"]["from_image_side"] == side
    assert found["sun"]["elevation_deg"] == pytest.approx(10.0, abs=1e-3)
    apart = (found["centre"]["up_azimuth_deg"] - turn_deg + 180.0) % 360.0 - 180.0
    assert apart == pytest.approx(0.0, abs=1e-6)


def test_a_sun_below_the_horizon_is_said() -> None:
    sun = 1.5e11 * PLACE.direction_to_mcmf(direction_enu(90.0, -5.0))
    (problem,) = lcp.camera_info(above(sun_position_mcmf_m=sun)).problems
    assert problem.startswith("the Sun of the file is 5.0 deg below the horizon at longitude 3.00")


def test_heights_over_a_dem() -> None:
    """By the DEM's own value at the place."""
    (height,) = lcp.dem_info(catalogs.HADLEY, at_deg=[(3.0, 26.0)]).files[0]["samples"]
    dem = lcp.camera_info(above(), dem=catalogs.HADLEY).document["dem"]
    assert dem["covered_share"] == 1.0
    assert 1e3 * dem["height_above_ground_km"] == pytest.approx(
        100e3 - height["height_m"], abs=50.0
    )
    elsewhere = posed.camera(EnuFrame(40.0, 0.0))
    (problem,) = lcp.camera_info(elsewhere, dem=catalogs.HADLEY).problems
    assert "holds nothing of what the camera sees" in problem


def test_axes_that_see_the_catalogue_are_named_with_what_they_give() -> None:
    catalog = navigable.everywhere_usable(20)
    good = posed.camera(EnuFrame(3.0, 26.0))
    seen = lcp.camera_info(good, catalog=catalog)
    assert seen.document["catalog"]["in_view"] > 0
    assert seen.problems == []
    other = good.rotation_mcmf_to_camera
    for rows, name in (
        ([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], "ahead, left, up"),
        ([[0, 0, 1], [1, 0, 0], [0, 1, 0]], "ahead, right, down"),
        ([[1, 0, 0], [0, -1, 0], [0, 0, -1]], "right, up, backwards"),
    ):
        body = Camera(
            good.position_mcmf_m, np.array(rows, float) @ other, 268.0, (201.5, 201.5), (404, 404)
        )
        (problem,) = lcp.camera_info(body, catalog=catalog).problems
        assert f"({name})" in problem
        assert "longitude 3.00, latitude 26.00, 0 deg off nadir" in problem
    away = posed.camera(EnuFrame(40.0, -50.0))
    (problem,) = lcp.camera_info(away, catalog=catalog).problems
    assert problem.endswith("km from the nearest point; " + problem.rpartition("; ")[2])
    assert "seems" not in problem


def quarter_turn(axis: int, sign: int) -> np.ndarray:
    """A turn of 90 deg about an axis of the camera, by hand."""
    turn, (j, k) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
    turn[[j, k], [j, k]] = 0.0
    turn[j, k], turn[k, j] = -sign, sign
    return turn


def test_a_camera_that_looks_at_the_horizon_gets_no_axes_that_look_elsewhere() -> None:
    """Turned by 90 deg about x or y. The transpose of one sees points at its image's edge, 68 deg off nadir; only a
    body's axes, whose turn is about y, look at the catalogue.
    """
    catalog = navigable.everywhere_usable(200)
    good = posed.camera(EnuFrame(3.4, 25.9))
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        turned = quarter_turn(axis, sign) @ good.rotation_mcmf_to_camera
        camera = replace(good, rotation_mcmf_to_camera=turned)
        (problem,) = lcp.camera_info(camera, catalog=catalog).problems
        assert ("seems" in problem) == ((axis, sign) == (1, 1)), problem
        for place in problem.split("then it looks at ")[1:]:
            assert place.startswith("longitude 3.40, latitude 25.90, 0 deg off nadir")


def test_an_oblique_camera_with_other_axes_is_told_so() -> None:
    """40 deg off nadir: its own axis meets the catalogue, that of no other candidate does."""
    catalog = navigable.everywhere_usable(200)
    good = posed.camera(EnuFrame(3.4, 25.2), tilt=(math.radians(-40.0), 0.0, 0.0))
    assert lcp.camera_info(good, catalog=catalog).document["catalog"]["in_view"] > 0
    opengl = np.diag([1.0, -1.0, -1.0]) @ good.rotation_mcmf_to_camera
    wrong = replace(good, rotation_mcmf_to_camera=opengl)
    (problem,) = lcp.camera_info(wrong, catalog=catalog).problems
    assert problem.count("seems to have") == 1
    assert "OpenGL or Blender" in problem
    assert "40 deg off nadir" in problem


def test_a_camera_below_the_sphere_sees_what_terrain_says() -> None:
    found = lcp.camera_info(above(-2e3)).document
    assert found["position"]["ground_share"] is None
    assert found["centre"] is None
    assert found["problems"] == []
    (problem,) = lcp.camera_info(above(-300e3)).problems
    assert "300.0 km below the reference sphere" in problem


@pytest.mark.parametrize("kind", ["LINE_SCANNER", "PUSH_FRAME"])
def test_a_scanner_is_described(kind: str, tmp_path: Path) -> None:
    """80 pixels of 100 m from 50 km: 2 atan(0.08)."""
    info = lcp.camera_info(scan_files.scan(tmp_path / "scan.json", kind))
    position, centre = info.document["position"], info.document["centre"]
    assert position["height_km"] == pytest.approx(50.0, abs=0.01)
    wide = position["field_of_view_deg"][0]
    assert wide == pytest.approx(2.0 * math.degrees(math.atan(0.08)), rel=1e-3)
    assert centre["pixel_m"] == pytest.approx(100.0, rel=1e-3)
    assert "azimuth 0 deg" in " ".join(info.lines())
    assert info.problems == []
    ElementTree.fromstring(info.picture())


def test_the_picture_has_the_image_and_the_points() -> None:
    catalog = navigable.everywhere_usable(20)
    info = lcp.camera_info(posed.camera(EnuFrame(3.0, 26.0)), catalog=catalog)
    circles = [one.get("class") for one in ElementTree.fromstring(info.picture()).iter() if one.tag.endswith("circle")]  # fmt: skip
    seen = info.document["catalog"]["in_view"]
    assert (circles.count("in"), circles.count("out")) == (seen, len(catalog) - seen)
    assert circles.count("nadir") == 1
    for blind in (above(-300e3), posed.camera(tilt=(math.pi, 0.0, 0.0))):
        ElementTree.fromstring(lcp.camera_info(blind).picture())


def test_a_camera_between_the_ground_and_the_sphere(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The mare below `PLACE` lies at about -2 km: from 0.4 km above it the DEM covers all that is seen. A query and a
    position fix say why no point is in view.
    """
    camera, ground = above(-1500.0), catalogs.catalog()
    info = lcp.camera_info(camera, dem=catalogs.HADLEY, catalog=ground)
    dem = lcp.dem_set(catalogs.HADLEY)
    height_m = float(dem.heights(np.array([3.0]), np.array([26.0]), dem.dems[0].gsd_m)[0][0])
    assert height_m < -1500.0
    above_km = info.document["dem"]["height_above_ground_km"]
    assert above_km == pytest.approx(1e-3 * (-1500.0 - height_m), abs=1e-3)
    assert info.document["dem"]["covered_share"] == 1.0
    below = "the camera is 1.50 km below the reference sphere (radius 1737.4 km), over longitude 3.00, latitude 26.00"
    (problem,) = info.problems
    assert below in problem
    assert ground.query(camera, "1971-07-31T01:25:52").counts["in_view"] == 0
    assert below in caplog.text
    under = lcp.camera_info(above(height_m - 100.0), dem=catalogs.HADLEY).problems
    assert under == ["the camera is below the DEM's ground: check position_mcmf_m"]
    with pytest.raises(
        lcp.LcpError, match=r"km below the reference sphere .* give `bounds`, or `center`"
    ):
        footprint(camera)
    tiny = lcp.Image(
        "tiny", np.ones((300, 400), np.float32), np.ones((300, 400), np.float32), camera,
        sun_direction_mcmf=PLACE.direction_to_mcmf(direction_enu(90.0, 10.0)),
    )  # fmt: skip
    fix = ground.locate(tiny)
    assert (fix.verdict, fix.reason[:39]) == (
        "cannot say",
        "the image is smaller than a pixel of th",
    )
