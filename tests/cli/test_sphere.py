"""``lcp render --surface`` from the outside."""

import json
import math
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from helpers.renders import read
from lcp_cli.main import run

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import EnuFrame, lonlat_to_mcmf, mcmf_to_lonlat

R = MOON_RADIUS_M
BANDS = ("radiance", "sunlit", "visible", "incidence", "emission", "phase")
SUN = ["--subsolar", "40", "1"]
SPHERE = ["render", "--surface", "sphere"]


@pytest.fixture
def out(tmp_path):
    return tmp_path / "OUT.tif"


def write_camera(path, distance=6e6, pixels=48, **more):
    """A camera over (30 E, 20 N) that looks at the Moon's centre, north up."""
    place = lonlat_to_mcmf(30.0, 20.0)
    up, east = place / R, np.array([-0.5, math.sqrt(0.75), 0.0])
    document = {
        "position_mcmf_m": (up * distance).tolist(),
        "rotation_mcmf_to_camera": [east.tolist(), np.cross(-up, east).tolist(), (-up).tolist()],
        "focal_length_px": 1.25 * pixels,
        "principal_point_px": [(pixels - 1) / 2] * 2,
        "image_size_px": [pixels, pixels],
    }
    path.write_text(json.dumps(document | more))
    return str(path)


def write_dem(path, heights, west=29.0, north=21.0, per_degree=32):
    gsd = math.radians(1.0) * R / per_degree
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=heights.shape[1],
        height=heights.shape[0],
        count=1,
        dtype="float32",
        crs=pyproj.CRS.from_proj4(f"+proj=eqc +R={R} +units=m").to_wkt(),
        transform=rasterio.Affine(
            gsd, 0, west * gsd * per_degree, 0, -gsd, north * gsd * per_degree
        ),
    ) as file:
        file.write(heights.astype(np.float32), 1)
    return str(path)


@pytest.fixture(scope="module")
def level(tmp_path_factory):
    """Two degrees of ground at height 0."""
    return write_dem(tmp_path_factory.mktemp("dem") / "level.tif", np.zeros((64, 64)))


@pytest.fixture(scope="module")
def rough(tmp_path_factory):
    y, x = np.mgrid[0:64, 0:64]
    heights = 300.0 * np.sin(x / 3.0) * np.cos(y / 4.0)
    return write_dem(tmp_path_factory.mktemp("dem") / "rough.tif", heights)


def test_a_whole_moon_without_a_dem(out):
    preview = out.with_suffix(".png")
    camera = write_camera(out.with_name("CAMERA.json"))
    files = ["--preview", str(preview), "--depfile", str(out.with_suffix(".d"))]
    where = ["--camera", camera, "--frame", "camera"]
    assert run([*SPHERE, "-o", str(out), *where, *SUN, *files]) == 0
    bands, profile, tags = read(out)
    assert tuple(bands) == (*BANDS, "x", "y", "z")
    assert profile["dtype"] == "float64"
    assert profile["crs"] is None
    lon, lat, height = mcmf_to_lonlat(np.stack([bands[k] for k in "xyz"], -1))
    whole = bands["visible"] == 1.0
    assert np.abs(height[whole]).max() < 1e-6
    assert (np.isfinite(bands["radiance"]) == (bands["visible"] > 0)).all()
    pixels = read_camera(camera).project(lonlat_to_mcmf(lon, lat)[whole])
    row, col = np.nonzero(whole)
    assert pixels == pytest.approx(np.stack([col, row], -1), abs=1e-8)
    radius_px = 60 * math.tan(math.asin(R / 6e6))
    assert bands["visible"].sum() == pytest.approx(math.pi * radius_px**2, rel=1e-3)
    assert lat[24, 24] == pytest.approx(20.0, abs=2)
    assert lat[14, 24] > lat[34, 24] + 20
    assert float(tags["center_lon"]) == pytest.approx(30.0)
    assert float(tags["center_lat"]) == pytest.approx(20.0)
    assert tags["surface"] == "sphere"
    assert tags["dem"] == "[]"
    assert "gsd_m" not in tags
    plan = {d["effect"]: d for d in json.loads(tags["scene_plan"])["decisions"]}
    assert plan["relief"]["modelled"] is False
    assert "as asked" in plan["relief"]["reason"]
    assert preview.read_bytes()[:4] == b"\x89PNG"
    assert out.with_suffix(".d").read_text().split() == [f"{out}:", camera]


def test_a_cap_at_nodes(out):
    area = ["--center", "-120", "70", "--size", "3600", "--gsd", "40000"]
    assert run([*SPHERE, "-o", str(out), *area, "--subsolar", "-120", "1"]) == 0
    bands, profile, tags = read(out)
    assert tuple(bands) == (*BANDS, "height")
    assert bands["height"].shape == (91, 91)
    assert float(tags["gsd_m"]) == 40000.0
    with rasterio.open(out) as file:
        crs, transform = pyproj.CRS.from_wkt(file.crs.to_wkt()), file.transform
    row, col = np.mgrid[0:91, 0:91]
    x, y = transform @ (col + 0.5, row + 0.5)
    inside = np.hypot(x, y) < 0.97 * R
    lon, lat = pyproj.Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True).transform(
        x[inside], y[inside]
    )
    places = EnuFrame(240.0, 70.0).to_mcmf(np.stack([x, y, bands["height"]], -1)[inside])
    assert np.abs(places - lonlat_to_mcmf(lon, lat)).max() < 1.0
    assert (bands["visible"][inside] == 1).all()
    assert (bands["visible"][np.hypot(x, y) > R] == 0).all()
    assert profile["dtype"] == "float32"


def test_a_view_from_angles(out):
    where = ["--center", "10", "20", "--size", "60", "--gsd", "1000", "--frame", "camera"]
    view = ["--off-nadir", "40", "--view-azimuth", "90", "--altitude", "100"]
    assert run([*SPHERE, "-o", str(out), *where, *view, *SUN]) == 0
    bands, _, tags = read(out)
    assert bands["radiance"].shape == (60, 60)
    middle = bands["emission"][29:31, 29:31].mean()
    assert middle == pytest.approx(40.0, abs=0.5)
    assert float(tags["gsd_m"]) == 1000.0


def test_the_centre_is_what_the_image_looks_at(out, capsys):
    """A camera over (30 E, 20 N) turned 10 deg to the east, then past the Moon. Of a Sun stated by
    angles they are those at the centre; and the plan says what relief would shift there.
    """
    path = out.with_name("CAMERA.json")
    document = json.loads(Path(write_camera(path)).read_text())
    for turn_deg, under in ((10.0, None), (60.0, (30.0, 20.0))):
        turn = math.radians(turn_deg)
        turned = np.array(
            [[math.cos(turn), 0, -math.sin(turn)], [0, 1, 0], [math.sin(turn), 0, math.cos(turn)]]
        )
        rotation = turned @ document["rotation_mcmf_to_camera"]
        path.write_text(
            json.dumps(
                document
                | {
                    "rotation_mcmf_to_camera": rotation.tolist(),
                    "image_size_px": [200, 48],
                    "principal_point_px": [99.5, 23.5],
                }
            )
        )
        arguments = [
            "--camera",
            str(path),
            "--frame",
            "camera",
            "--sun-azimuth",
            "90",
            "--sun-elevation",
            "70",
        ]
        assert run([*SPHERE, "-o", str(out), *arguments, "--overwrite"]) == 0
        bands, _, tags = read(out)
        centre = under
        if centre is None:
            middle = np.mean(
                [[bands[k][r, c] for k in "xyz"] for r in (23, 24) for c in (99, 100)], axis=0
            )
            lon, lat, _ = mcmf_to_lonlat(middle)
            centre = float(lon), float(lat)
            assert centre[0] > 50.0
        assert float(tags["center_lon"]) == pytest.approx(centre[0], abs=0.05)
        assert float(tags["center_lat"]) == pytest.approx(centre[1], abs=0.05)


def test_the_plan_says_what_relief_would_shift(capsys):
    """Seen 40 deg off the vertical on nodes of 2 km, ground 11 km high lies 11 sin(40) km across the
    line of sight from its place.
    """
    area = [
        "--center",
        "10",
        "20",
        "--size",
        "10",
        "--gsd",
        "2000",
        "--off-nadir",
        "40",
        "--view-azimuth",
        "0",
    ]
    assert run([*SPHERE, *area, "--explain", "--subsolar", "10", "0"]) == 0
    plan = {d["effect"]: d for d in json.loads(capsys.readouterr().out)["decisions"]}
    assert plan["relief"]["unit"] == "pixels"
    assert plan["relief"]["error_bound"] == pytest.approx(
        5.5 * math.sin(math.radians(40.0)), rel=5e-3
    )


def test_the_same_bytes_again(out):
    where = ["--center", "10", "20", "--size", "600", "--gsd", "9000", *SUN]
    assert run([*SPHERE, "-o", str(out), *where, "--sun", "disc"]) == 0
    first = out.read_bytes()
    assert run([*SPHERE, "-o", str(out), *where, "--sun", "disc", "--overwrite"]) == 0
    assert out.read_bytes() == first


# ---- beside a heightfield


@pytest.mark.parametrize(
    "frame",
    [[], ["--frame", "camera", "--altitude", "300", "--off-nadir", "20", "--view-azimuth", "200"]],
)
def test_the_plan_takes_the_sphere_for_level_ground(level, out, frame):
    """In draft it does, in reference not; what is written differs by less than it says."""
    area = ["--center", "30", "20", "--size", "40", "--gsd", "2000", *frame]
    sun = ["--sun-azimuth", "120", "--sun-elevation", "35", "--accuracy", "draft"]
    sun += ["--reflectance", "lommel-seeliger"]
    results = {}
    for surface in ("auto", "heightfield", "sphere"):
        path = out.with_name(f"{surface}.tif")
        assert run(["render", level, "-o", str(path), *area, *sun, "--surface", surface]) == 0
        results[surface] = read(path)
    used = {name: result[2]["surface"] for name, result in results.items()}
    assert used == {"auto": "sphere", "heightfield": "heightfield", "sphere": "sphere"}
    plan = {d["effect"]: d for d in json.loads(results["auto"][2]["scene_plan"])["decisions"]}
    bound = plan["relief"]["error_bound"]
    assert bound <= 5e-3
    auto, full = results["auto"][0], results["heightfield"][0]
    both = (auto["visible"] > 0) & (full["visible"] > 0)
    assert both.mean() > 0.8
    assert both.sum() >= full["visible"].sum() - 2
    assert auto["radiance"][both] == pytest.approx(full["radiance"][both], rel=bound)
    for name in ("incidence", "emission", "phase"):
        assert np.abs(auto[name] - full[name])[both].max() < math.degrees(bound)
    asked = results["sphere"][0]["radiance"]
    assert asked[both] == pytest.approx(auto["radiance"][both], rel=1e-6)


def test_the_plan_keeps_rough_ground(rough, out, capsys):
    area = ["--center", "30", "20", "--size", "40", "--gsd", "2000"]
    sun = ["--sun-azimuth", "120", "--sun-elevation", "35", "--accuracy", "draft"]
    assert run(["render", rough, *area, *sun, "--explain"]) == 0
    plan = {d["effect"]: d for d in json.loads(capsys.readouterr().out)["decisions"]}
    assert plan["relief"]["modelled"] is True
    assert "the plain sphere would turn normals by up to" in plan["relief"]["reason"]
    assert run(["render", rough, "-o", str(out), *area, *sun]) == 0
    assert read(out)[2]["surface"] == "heightfield"


def test_a_dem_gives_the_sphere_its_area(rough, out):
    assert run([*SPHERE, rough, "-o", str(out), *SUN]) == 0
    bands, _, tags = read(out)
    assert float(tags["center_lon"]) == pytest.approx(30.0)
    assert float(tags["gsd_m"]) == pytest.approx(math.radians(1.0) * R / 32)
    x = np.arange(bands["height"].shape[1])
    assert np.nanmax(np.abs(np.diff(bands["height"][32], 2))) < 2.0  # no hills of 300 m
    assert x.size > 50


# ---- what is refused


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["render", *SUN, "--center", "0", "0", "--size", "9"], 2, "no DEM: give one or more, or --surface sphere"),
        (["render", "--surface", "heightfield", *SUN], 2, "no DEM"),
        ([*SPHERE, *SUN], 1, "no area: state --center and --size, or --bounds, or a --camera"),
        ([*SPHERE, *SUN, "--center", "0", "0", "--size", "9"], 1, "no cell size: state --gsd"),
        ([*SPHERE, *SUN, "--center", "0", "0", "--size", "9000", "--gsd", "1e4"], 1, "at most 6950 km"),
        ([*SPHERE, "--center", "0", "0", "--size", "9", "--gsd", "1e3"], 2, "no Sun"),
        ([*SPHERE, "--subsolar", "180", "0", "--center", "0", "0", "--size", "90", "--gsd", "1e3"], 1, "below the horizon"),
        ([*SPHERE, *SUN, "--center", "0", "0", "--size", "9", "--gsd", "1e-9"], 1, "nodes"),
    ],
)  # fmt: skip
def test_refusals(arguments, code, words, out, capsys):
    assert run([*arguments, "-o", str(out)]) == code
    message = capsys.readouterr().err
    assert words in message
    assert "Traceback" not in message
    assert not out.exists()


def test_cameras_that_see_no_ground(out, capsys):
    away = json.loads(Path(write_camera(out.with_name("A.json"))).read_text())
    away["rotation_mcmf_to_camera"] = (
        np.diag([1, -1, -1]) @ away["rotation_mcmf_to_camera"]
    ).tolist()
    (out.with_name("AWAY.json")).write_text(json.dumps(away))
    low = write_camera(out.with_name("LOW.json"), R - 3000.0)
    for camera, words in (
        (
            out.with_name("AWAY.json"),
            "(then it looks at longitude 30.00, latitude 20.00, 0 deg off nadir)",
        ),
        (low, "3000 m below the reference sphere"),
    ):
        assert (
            run([*SPHERE, "-o", str(out), "--camera", str(camera), "--frame", "camera", *SUN]) == 1
        )
        assert words in capsys.readouterr().err
        assert not out.exists()
    camera = write_camera(out.with_name("B.json"))
    assert run([*SPHERE, "-o", str(out), "--camera", camera, "--gsd", "1e4", *SUN]) == 1
    assert "--frame camera for all that the camera sees" in capsys.readouterr().err


def test_wide_areas_of_a_dem_name_the_sphere(level, out, capsys):
    wide = ["--center", "30", "20", "--size", "2500", *SUN]
    assert run(["render", level, "-o", str(out), *wide]) == 2
    assert "--surface sphere" in capsys.readouterr().err
    assert run(["render", level, "-o", str(out), "--bounds", "-40", "-10", "60", "30", *SUN]) == 1
    assert "--surface sphere" in capsys.readouterr().err


def test_a_camera_too_far_for_a_dem_names_the_sphere(out, capsys, tmp_path):
    """The whole disc over a global DEM; and over the same DEM on the sphere it is drawn."""
    dem = write_dem(tmp_path / "global.tif", np.zeros((180, 360)), -180.0, 90.0, 1)
    camera = ["--camera", write_camera(tmp_path / "CAMERA.json"), "--frame", "camera", *SUN]
    assert run(["render", dem, "-o", str(out), *camera]) == 1
    assert "or render the plain sphere: --surface sphere" in capsys.readouterr().err
    assert run([*SPHERE, dem, "-o", str(out), *camera]) == 0
    assert json.loads(read(out)[2]["dem"]) == ["global.tif"]
    assert run([*SPHERE, dem, "-o", str(out), *SUN, "--overwrite"]) == 1
    assert (
        "does not fit into one plane: state --center and --size, or --bounds\n"
        in capsys.readouterr().err
    )
