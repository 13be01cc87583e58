"""``lcp render`` from the outside: what it writes, and what it says of it."""

import json
import os

import numpy as np
import pyproj
import pytest
import rasterio
from helpers.renders import AREA, BANDS, DEGREE_M, SUN, camera_file, read, rolling, write_dem
from helpers.subsolar import subsolar_point
from lcp_cli.main import run

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import (
    EnuFrame,
    azimuth_elevation,
    central_angle_deg,
    mcmf_to_lonlat,
)


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    """One degree square at 30..31 E, 10..11 N, rolling hills."""
    return write_dem(tmp_path_factory.mktemp("dem") / "hills.tif", rolling(256, 256), 30.0, 11.0)


@pytest.fixture(scope="module")
def smooth_moon(tmp_path_factory):
    """Two degrees of the bare sphere around 30.5 E, 10.5 S."""
    path = tmp_path_factory.mktemp("dem") / "sphere.tif"
    return write_dem(path, np.zeros((512, 512)), 29.5, -9.5)


@pytest.fixture
def out(tmp_path):
    return tmp_path / "OUT.tif"


def test_the_output_of_the_contract(dem, out):
    assert run(["render", dem, "-o", str(out), *AREA, *SUN]) == 0
    bands, profile, tags = read(out)
    assert tuple(bands) == (*BANDS, "height")
    assert profile["dtype"] == "float32"
    assert profile["tiled"]
    assert profile["compress"] == "deflate"
    assert np.isnan(profile["nodata"])
    assert float(tags["center_lon"]) == 30.5
    assert float(tags["center_lat"]) == 10.5
    assert float(tags["sun_azimuth"]) == pytest.approx(100.0)
    assert float(tags["sun_elevation"]) == pytest.approx(20.0)
    back = EnuFrame(30.5, 10.5).direction_from_mcmf(json.loads(tags["sun_direction_mcmf"]))
    assert azimuth_elevation(back) == (pytest.approx(100.0), pytest.approx(20.0))
    assert json.loads(tags["camera"])["direction_enu"] == [0, 0, 1]
    assert {d["effect"] for d in json.loads(tags["scene_plan"])["decisions"]} >= {
        "cast shadows",
        "occlusion",
        "curvature",
    }
    assert "/" not in tags["dem"]
    assert os.listdir(out.parent) == ["OUT.tif"]


def test_a_pixels_map_position_is_its_nodes_place(smooth_moon, out):
    """PROJ's longitude and latitude of pixel centres against the frame's own, on the sphere itself:
    a millimetre.
    """
    area = ["--center", "30.5", "-10.5", "--size", "40", "--gsd", "500"]
    assert run(["render", smooth_moon, "-o", str(out), *area, *SUN]) == 0
    with rasterio.open(out) as file:
        crs = pyproj.CRS.from_wkt(file.crs.to_wkt())
        height, transform = file.read(7), file.transform
    row, col = np.mgrid[0 : height.shape[0], 0 : height.shape[1]]
    x, y = transform @ (col + 0.5, row + 0.5)
    assert x[0, 0] == pytest.approx(-20e3)
    assert y[0, 0] == pytest.approx(20e3)
    unproject = pyproj.Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
    lon, lat = unproject.transform(x, y)
    ours = mcmf_to_lonlat(EnuFrame(30.5, -10.5).to_mcmf(np.stack([x, y, height], -1)))
    off_m = np.radians(central_angle_deg(lon, lat, ours[0], ours[1])) * MOON_RADIUS_M
    assert off_m.max() < 1e-3
    assert np.abs(ours[2]).max() < 0.01  # float32 heights


def test_the_bare_sphere_in_the_light_of_a_subsolar_point(smooth_moon, out):
    """On the sphere the incidence is the angle to the subsolar point, seen from the centre."""
    area = ["--center", "30.5", "-10.5", "--size", "40", "--gsd", "500"]
    assert run(["render", smooth_moon, "-o", str(out), *area, "--subsolar", "-40", "1"]) == 0
    bands, _, _ = read(out)
    frame = EnuFrame(30.5, -10.5)
    row, col = np.mgrid[0:81, 0:81]
    enu = np.stack([(col - 40) * 500.0, (40 - row) * 500.0, bands["height"]], -1)
    lon, lat, _ = mcmf_to_lonlat(frame.to_mcmf(enu))
    angle = central_angle_deg(lon, lat, -40.0, 1.0)
    inner = np.s_[1:-1, 1:-1]  # one-sided differences at the border are half a cell off
    assert bands["incidence"][inner] == pytest.approx(angle[inner], abs=2e-3)
    assert (bands["sunlit"] == 1).all()
    assert bands["incidence"].std() > 0.1


def test_south_of_the_equator_nothing_is_upside_down(tmp_path):
    """A hill in the south-east of the area is in the raster's lower right, lit from the east."""
    z = np.zeros((256, 256))
    y, x = np.mgrid[0:256, 0:256]
    z += 400 * np.exp(-((x - 160) ** 2 + (y - 170) ** 2) / 30.0)
    path = write_dem(tmp_path / "south.tif", z, 300.0, -40.0)
    args = ["--center", "-59.5", "-40.5", "--size", "25", "--sun-azimuth", "90"]
    assert run(["render", path, "-o", str(tmp_path / "o.tif"), *args, "--sun-elevation", "30"]) == 0
    bands, profile, _ = read(tmp_path / "o.tif")
    row, col = np.unravel_index(np.nanargmax(bands["height"]), bands["height"].shape)
    middle = bands["height"].shape[0] // 2
    east, south = (col - middle) * profile["transform"].a, (row - middle) * profile["transform"].a
    # pixel centres 160.5 and 170.5 of 256, the area's centre at 128
    assert south == pytest.approx(42.5 / 256 * DEGREE_M, abs=120)
    assert east == pytest.approx(32.5 / 256 * DEGREE_M * np.cos(np.radians(40.67)), abs=120)
    assert bands["radiance"][row, col + 4] > bands["radiance"][row, col - 4]


def test_terrain_outside_the_area_casts_its_shadow_into_it(tmp_path):
    z = np.zeros((256, 256))
    z[:, 200:] = 3000.0  # a plateau 8.5 km east of the area's centre
    path = write_dem(tmp_path / "wall.tif", z, 30.0, 0.5)
    args = ["--center", "30.5", "0", "--size", "2", "--sun-azimuth", "90", "--sun-elevation"]
    for elevation, lit in (("15", 0), ("25", 1)):  # atan(3 / 8.5) = 19.4 deg
        target = tmp_path / f"{elevation}.tif"
        assert run(["render", path, "-o", str(target), *args, elevation]) == 0
        assert (read(target)[0]["sunlit"] == lit).all()


def test_the_cameras_plane(dem, tmp_path, out):
    camera = camera_file(tmp_path / "CAMERA.json")
    assert run(["render", dem, "-o", str(out), "--camera", camera, "--frame", "camera"]) == 0
    bands, profile, tags = read(out)
    assert tuple(bands) == (*BANDS, "x", "y", "z")
    assert (profile["width"], profile["height"]) == (100, 80)
    assert profile["dtype"] == "float64"
    assert profile["crs"] is None
    assert bands["visible"].all()
    pixels = read_camera(camera).project(np.stack([bands[axis] for axis in "xyz"], -1))
    row, col = np.mgrid[0:80, 0:100]
    assert np.abs(pixels - np.stack([col, row], -1)).max() < 1e-6
    lon, lat, height = mcmf_to_lonlat(np.stack([bands[axis] for axis in "xyz"], -1))
    assert lat[0, 50] > lat[79, 50]
    assert np.abs(height).max() < 200
    assert json.loads(tags["camera"])["focal_length_px"] == 400.0
    assert lon[40, 99] > lon[40, 0]


def test_what_the_camera_sees_is_the_default_area(dem, tmp_path, out):
    camera = camera_file(tmp_path / "CAMERA.json")
    assert run(["render", dem, "-o", str(out), "--camera", camera]) == 0
    bands, _, _ = read(out)
    seen = bands["visible"] == 1
    assert seen.any(axis=0).sum() * seen.any(axis=1).sum() > 0.8 * seen.size
    # 100 x 80 pixels of 125 m on 118 m cells
    assert seen.sum() * (DEGREE_M / 256) ** 2 == pytest.approx(12.5e3 * 10e3, rel=0.03)


def test_low_ground_at_the_images_edge_is_not_missed(tmp_path, out):
    """Rays meet ground 3 km below the sphere outside of what they would see of the sphere."""
    path = write_dem(tmp_path / "low.tif", np.full((256, 256), -3000.0), 30.0, 11.0)
    camera = camera_file(tmp_path / "CAMERA.json")
    assert run(["render", path, "-o", str(out), "--camera", camera, "--frame", "camera"]) == 0
    assert read(out)[0]["visible"].all()


def test_a_view_by_angles_in_both_frames(dem, tmp_path):
    view = ["--off-nadir", "30", "--view-azimuth", "200", "--altitude", "40"]
    for frame in ("enu", "camera"):
        target = str(tmp_path / f"{frame}.tif")
        arguments = ["render", dem, "-o", target, *AREA, *SUN, *view, "--frame", frame]
        assert run(arguments) == 0
    nodes, plane = read(tmp_path / "enu.tif")[0], read(tmp_path / "camera.tif")[0]
    middle = tuple(s // 2 for s in nodes["emission"].shape)
    slope = nodes["incidence"]
    assert np.isfinite(slope[middle])
    for bands in (nodes, plane):
        row, col = (s // 2 for s in bands["phase"].shape)
        # the angle between directions 100 deg apart in azimuth, 70 and 30 deg off the vertical
        i, e, da = np.radians([70, 30, 100])
        phase = np.arccos(np.cos(i) * np.cos(e) + np.sin(i) * np.sin(e) * np.cos(da))
        assert bands["phase"][row, col] == pytest.approx(np.degrees(phase), abs=0.5)


def test_the_sun_of_a_time(dem, tmp_path, out):
    arguments = ["render", dem, "-o", str(out), *AREA, "--time", "2024-01-20T00:00:00"]
    assert run(arguments) == 0
    _, _, tags = read(out)
    direction = json.loads(tags["sun_direction_mcmf"])
    assert mcmf_to_lonlat(np.array(direction))[:2] == pytest.approx(
        subsolar_point("2024-01-20"), abs=1e-9
    )


def test_same_input_same_bytes(dem, tmp_path):
    for name in ("a.tif", "b.tif"):
        preview = str(tmp_path / f"{name}.png")
        assert (
            run(["render", dem, "-o", str(tmp_path / name), *AREA, *SUN, "--preview", preview]) == 0
        )
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()
    assert (tmp_path / "a.tif.png").read_bytes() == (tmp_path / "b.tif.png").read_bytes()


def test_the_preview_is_a_grey_picture(dem, tmp_path, out):
    preview = tmp_path / "p.png"
    low = ["--sun-azimuth", "90", "--sun-elevation", "8"]
    assert run(["render", dem, "-o", str(out), *AREA, *low, "--preview", str(preview)]) == 0
    bands, _, _ = read(out)
    with rasterio.open(preview) as file:
        assert (file.driver, file.count, file.dtypes[0]) == ("PNG", 1, "uint8")
        grey = file.read(1)
    assert grey.shape == bands["radiance"].shape
    assert (grey[bands["sunlit"] == 0] == 0).all()
    assert np.corrcoef(grey.ravel(), np.nan_to_num(bands["radiance"]).ravel())[0, 1] > 0.95
    assert grey.max() == 255


def test_explain_alone_says_only_json(dem, capsys):
    assert (
        run(["render", dem, "--explain", *AREA, "--sun-azimuth", "10", "--sun-elevation", "80"])
        == 0
    )
    captured = capsys.readouterr()
    decisions = {d["effect"]: d for d in json.loads(captured.out)["decisions"]}
    assert all(
        set(d)
        == {"effect", "modelled", "reason", "error_bound", "unit", "switch", "cost", "cost_reason"}
        for d in decisions.values()
    )
    told = {(d["cost"], d["cost_reason"]) for d in decisions.values()}
    assert told == {(None, "not measured: no image was computed")}
    assert decisions["cast shadows"]["modelled"] is False
    assert decisions["cast shadows"]["error_bound"] == 0.0
    assert decisions["curvature"]["modelled"] is True


@pytest.mark.parametrize(
    ("flags", "sun"),
    [
        ([], "point"),
        (["--accuracy", "high"], "disc"),
        (["--accuracy", "high", "--sun", "point"], "point"),
        (["--sun", "disc"], "disc"),
    ],
)
def test_the_suns_shape(dem, out, flags, sun):
    """A point in the default tier, a disc in the exact ones, and what is asked for in any."""
    low = ["--sun-azimuth", "90", "--sun-elevation", "4"]
    assert run(["render", dem, "-o", str(out), *AREA, *low, *flags]) == 0
    bands, _, tags = read(out)
    assert tags["sun_model"] == sun
    share = bands["sunlit"]
    assert bool(((share > 0) & (share < 1)).any()) == (sun == "disc")
    plan = {d["effect"]: d for d in json.loads(tags["scene_plan"])["decisions"]}
    assert plan["solar disc"]["modelled"] == (sun == "disc")


def test_explain_beside_an_output(dem, out, capsys):
    assert run(["render", dem, "-o", str(out), "--explain", *AREA, *SUN]) == 0
    printed = json.loads(capsys.readouterr().out)
    tags = read(out)[2]
    costs = {d["effect"]: d.pop("cost") for d in printed["decisions"]}
    switches = {d["effect"]: d.pop("switch") for d in printed["decisions"]}
    reasons = {
        d["effect"]: d.pop("cost_reason") for d in printed["decisions"] if "cost_reason" in d
    }
    assert printed == json.loads(tags["scene_plan"]) | {"light": json.loads(tags["light"])}
    assert switches["cast shadows"] == switches["float width"] == "--accuracy"
    assert (switches["solar disc"], switches["perspective"]) == ("--sun", "--altitude")
    assert (switches["scattered light"], switches["relief"]) == ("--bounce", "--surface")
    assert switches["curvature"] is switches["terrain beyond the area"] is None
    known = [cost for cost in costs.values() if cost is not None]
    own = "cast shadows", "reflectance", "relief", "terrain beyond the area"
    assert all(costs[effect] > 0.0 for effect in own)
    assert costs["solar disc"] == costs["parallax of the Sun"] == 0.0  # not modelled
    assert 0.5 < sum(known) <= 1.0
    assert {effect for effect, cost in costs.items() if cost is None} == set(reasons)
    assert reasons == {
        "curvature": "no time of its own: in the heights, which relief counts",
        "float width": "no time of its own: the width of all numbers",
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "how", [["--sun", "disc"], ["--surface", "sphere"], ["--bounce", "on"], ["--frame", "camera"]]
)
def test_every_cost_is_a_share_or_has_a_reason(dem, out, capsys, how):
    """Whatever is modelled: the shares are at most the whole, and where none is stated it says where the time counts."""
    low = ["--sun-azimuth", "90", "--sun-elevation", "8"]
    view = ["--off-nadir", "10", "--view-azimuth", "90", "--altitude", "100"]
    assert run(["render", dem, "-o", str(out), "--explain", *AREA, *low, *view, *how]) == 0
    decisions = json.loads(capsys.readouterr().out)["decisions"]
    assert all((d["cost"] is None) == ("cost_reason" in d) for d in decisions)
    assert all(d["modelled"] for d in decisions if d["cost"] is None)
    assert sum(d["cost"] or 0.0 for d in decisions) <= 1.0


def test_what_was_read_for_make(dem, tmp_path, out):
    camera, rule = camera_file(tmp_path / "CAMERA.json"), tmp_path / "OUT.d"
    rule.write_text("old")
    arguments = ["render", dem, "-o", str(out), "--camera", camera, "--depfile", str(rule)]
    assert run(arguments) == 0
    assert rule.read_text() == f"{out}: {dem} {camera}\n"


def flat_dem(path, rows, cols):
    """A DEM of few heights, all zero."""
    where = {
        "crs": "+proj=longlat +R=1737400",
        "transform": rasterio.transform.from_origin(3, 26, 0.004, 0.004),
    }
    with rasterio.open(
        path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype="float32", **where
    ) as file:
        file.write(np.ones((1, rows, cols), np.float32))
    return path


@pytest.mark.parametrize(("rows", "cols"), [(1, 200), (200, 1), (1, 1)])
@pytest.mark.parametrize("command", ["render", "build-catalog"])
def test_a_line_of_heights_is_no_ground(tmp_path, capsys, command, rows, cols):
    path = flat_dem(tmp_path / "line.tif", rows, cols)
    out = tmp_path / ("out.tif" if command == "render" else "out.h5")
    sun = SUN if command == "render" else []
    assert run([command, str(path), "-o", str(out), *sun]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"line.tif: has {rows} x {cols} heights (rows x columns)" in said
    assert "at least 3 x 3" in said
    assert not out.exists()


@pytest.mark.parametrize(
    ("command", "side", "said"),
    [
        ("build-catalog", 3, "line.tif: has 3 x 3 heights (rows x columns) of"),
        ("build-catalog", 20, "a patch takes 33 x 33 cells of"),
    ],
)
def test_a_dem_that_is_too_small_is_named(tmp_path, capsys, command, side, said):
    path = flat_dem(tmp_path / "line.tif", side, side)
    out = tmp_path / ("out.tif" if command == "render" else "out.h5")
    assert run([command, str(path), "-o", str(out), *(SUN if command == "render" else [])]) == 1
    assert said in capsys.readouterr().err.splitlines()[-1]
    assert not out.exists()
