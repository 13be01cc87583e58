"""``lcp render`` under panoramas, earthshine and in front of a background, from the outside."""

import json

import cv2
import numpy as np
import pytest
import rasterio
from helpers.environment_maps import Lamp, cie_sky, recorded, room, uniform, with_lamps
from helpers.renders import read, rolling, write_dem
from lcp_cli.main import run

AREA = ["--center", "30.5", "10.5", "--size", "5", "--accuracy", "draft"]
CAMERA = ["--frame", "camera", "--off-nadir", "30", "--view-azimuth", "200", "--altitude", "20"]
SUN = ["--sun-azimuth", "100", "--sun-elevation", "20"]


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    return write_dem(tmp_path_factory.mktemp("dem") / "hills.tif", rolling(256, 256), 30.0, 11.0)


@pytest.fixture(scope="module")
def skies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sky")
    sky = cie_sky(64, 100.0, 30.0)
    panoramas = {
        "clear": with_lamps(sky, [Lamp(100.0, 30.0, 3.0, 1.0)]),
        "overcast": uniform(32),
        "sun": room(180, [Lamp(101.0, 21.0, 1.0)], ambient=1e-6),
    }
    for name, panorama in panoramas.items():
        image = np.repeat(panorama.luminance.astype(np.float32)[:, :, None], 3, axis=2)
        cv2.imwrite(str(folder / f"{name}.hdr"), image)
    cv2.imwrite(str(folder / "square.hdr"), np.ones((8, 8, 3), np.float32))
    cv2.imwrite(str(folder / "grey.png"), np.full((60, 60), 128, np.uint8))
    return folder


def render(dem, out, *how):
    assert run(["render", dem, "-o", str(out), *AREA, *map(str, how)]) == 0
    bands, _, tags = read(out)
    return bands, tags


def test_a_panorama_lights_and_is_reported(dem, skies, tmp_path, capsys):
    how = ["--environment", skies / "clear.hdr", "--environment-azimuth", "40", "--explain"]
    bands, tags = render(dem, tmp_path / "a.tif", *how)
    said = json.loads(capsys.readouterr().out)
    assert np.isfinite(bands["radiance"]).all()
    assert (bands["radiance"] > 0).all()  # a sky leaves nothing black
    report = json.loads(tags["environment"])
    assert report == said["light"]["environment"]
    costs = {d["effect"]: d["cost"] for d in said["decisions"]}
    assert 0.0 < costs["sky light"] <= 1.0 - costs["relief"]
    assert all((d["cost"] is None) == ("cost_reason" in d) for d in said["decisions"])
    assert report["panorama"] == "clear.hdr"
    assert [one["azimuth_deg"] for one in report["sources"]] == pytest.approx([140], abs=2)
    assert report["sources"][0]["elevation_deg"] == pytest.approx(30, abs=2)
    assert float(tags["sun_azimuth"]) == pytest.approx(140, abs=2)
    light = json.loads(tags["light"])
    total = sum(one["irradiance"] for one in light["sources"]) + light["sky_irradiance"]
    assert total == pytest.approx(1.0)
    effects = {one["effect"]: one for one in said["decisions"]}
    assert effects["sky light"]["modelled"]
    assert effects["sky light"]["error_bound"] > 0
    assert tags["sun_model"] == "point"


def test_the_sun_of_a_panorama_is_that_sun(dem, skies, tmp_path):
    one, _ = render(dem, tmp_path / "a.tif", "--environment", skies / "sun.hdr")
    report = json.loads(read(tmp_path / "a.tif")[2]["environment"])["sources"][0]
    sun = ["--sun-azimuth", report["azimuth_deg"], "--sun-elevation", report["elevation_deg"]]
    other, _ = render(dem, tmp_path / "b.tif", *sun)
    off = one["radiance"] - other["radiance"]
    assert np.sqrt(np.mean(off**2)) < 0.01 * other["radiance"].mean()
    assert (one["sunlit"] == other["sunlit"]).mean() > 0.999


def test_the_suns_share_and_the_coefficients(dem, skies, tmp_path):
    how = ["--environment", skies / "clear.hdr"]
    _, plain = render(dem, tmp_path / "a.tif", *how)
    _, scaled = render(dem, tmp_path / "b.tif", *how, "--sun-sky-ratio", "4")
    before, after = (json.loads(tags["environment"]) for tags in (plain, scaled))
    assert before["sun_sky_ratio"] == after["sun_sky_ratio_found"] < 2.0
    assert after["sun_sky_ratio"] == pytest.approx(4.0)
    _, none = render(dem, tmp_path / "c.tif", *how, "--environment-sources", "1000", "5", "2")
    assert json.loads(none["environment"])["sources"] == []


def test_earthshine(dem, tmp_path):
    night = ["--time", "2024-01-13T00:00"]  # two days after the new Moon: the near side is dark
    bands, tags = render(dem, tmp_path / "a.tif", *night, "--earthshine")
    sun, earth = json.loads(tags["light"])["sources"]
    assert (sun["name"], earth["name"]) == ("Sun", "Earth")
    assert earth["irradiance"] == pytest.approx(1.1e-4, rel=0.15)
    assert earth["elevation_deg"] > 50
    assert (bands["sunlit"] == 0).all()
    assert 1e-6 < np.median(bands["radiance"]) < 1e-4
    assert run(["render", dem, "-o", str(tmp_path / "b.tif"), *AREA, *night]) == 1
    low = ["--sun-azimuth", "100", "--sun-elevation", "5"]
    mean, _ = render(dem, tmp_path / "c.tif", *low, "--earthshine")
    without, _ = render(dem, tmp_path / "d.tif", *low)
    gained = (mean["radiance"] - without["radiance"])[without["sunlit"] == 0]
    assert gained.size
    assert (gained > 0).all()


def test_earthshine_on_the_plain_sphere(tmp_path):
    out = tmp_path / "a.tif"
    area = ["--center", "0", "0", "--size", "1000", "--gsd", "10000"]
    how = ["--surface", "sphere", *area, "--time", "2024-01-11T12:00", "--earthshine"]
    assert run(["render", "-o", str(out), *how]) == 0
    bands, _, _ = read(out)
    assert (bands["sunlit"] == 0).all()
    assert np.nanmedian(bands["radiance"]) > 1e-6


def test_a_shadow_on_a_background(dem, skies, tmp_path):
    how = [*CAMERA, *SUN, "--background", skies / "grey.png", "--shadow-catcher", "300"]
    preview = tmp_path / "a.png"
    bands, _ = render(dem, tmp_path / "a.tif", *how, "--preview", preview)
    missed = bands["visible"] == 0
    assert list(bands)[6:] == ["x", "y", "z", "composite"]
    assert (bands["composite"][~missed] == bands["radiance"][~missed]).all()
    assert np.isfinite(bands["composite"]).all()
    assert missed.any()
    shown = cv2.imread(str(preview), cv2.IMREAD_UNCHANGED)
    grey = np.median(bands["composite"][missed])
    assert (shown[missed & (bands["composite"] == grey)] > 60).all()  # it is in the picture
    white = [*CAMERA, *SUN, "--background", skies / "grey.png", "--background-white", "2"]
    bands, _ = render(dem, tmp_path / "b.tif", *white)
    assert bands["composite"][missed] == pytest.approx(2 * 0.21586, rel=1e-4)  # sRGB 128


def test_a_panorama_behind_the_terrain(dem, skies, tmp_path):
    how = [*CAMERA, "--environment", skies / "overcast.hdr", "--shadow-catcher", "-3000"]
    bands, _ = render(dem, tmp_path / "a.tif", *how)
    missed = bands["visible"] == 0
    assert (bands["composite"][missed] == 0).all()  # looking down: the panorama's dark ground
    bands, _ = render(dem, tmp_path / "b.tif", *how[:-2])
    assert "composite" not in bands
    # a plane over all ground is not shaded: pi L / E of the ground of the clear sky's panorama, 0.1
    how = [*CAMERA, "--environment", skies / "clear.hdr", "--shadow-catcher", "300"]
    bands, _ = render(dem, tmp_path / "c.tif", *how)
    clear = with_lamps(cie_sky(64, 100.0, 30.0), [Lamp(100.0, 30.0, 3.0, 1.0)])
    expected = np.pi * 0.1 / clear.power_above
    assert bands["composite"][missed] == pytest.approx(expected, rel=0.01)  # 8 bits of mantissa


def test_depfile_names_what_was_read(dem, skies, tmp_path):
    deps, sky, grey = tmp_path / "a.d", skies / "overcast.hdr", skies / "grey.png"
    how = [*CAMERA, "--environment", sky, "--background", grey, "--depfile", deps]
    render(dem, tmp_path / "a.tif", *how)
    text = deps.read_text()
    assert str(sky) in text
    assert str(grey) in text


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ([*SUN, "--environment", "clear.hdr"], "--environment replaces the Sun"),
        (["--time", "2024-01-01", "--environment", "clear.hdr"], "--environment replaces the Sun"),
        (["--sun", "disc", "--environment", "clear.hdr"], "--environment replaces the Sun"),
        (["--earthshine", "--environment", "clear.hdr"], "--environment excludes --earthshine"),
        ([*SUN, "--sun-sky-ratio", "4"], "needs --environment"),
        ([*SUN, "--environment-azimuth", "4"], "needs --environment"),
        ([*SUN, "--environment-sources", "6", "5", "2"], "needs --environment"),
        ([*SUN, "--background", "grey.png"], "--frame camera"),
        ([*SUN, "--shadow-catcher", "0"], "--frame camera"),
        ([*SUN, *CAMERA, "--shadow-catcher", "0"], "needs --background"),
        ([*SUN, *CAMERA, "--background-white", "1"], "needs --background"),
        (["--environment-sources", "6", "5", "--environment", "clear.hdr"], "--environment"),
        ([], "--environment"),
    ],
)
def test_usage_errors(dem, skies, tmp_path, capsys, how, says):
    out = tmp_path / "a.tif"
    named = [str(skies / one) if one.endswith((".hdr", ".png")) else one for one in how]
    assert run(["render", dem, "-o", str(out), *AREA, *named]) == 2
    assert says in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ("how", "says"),
    [
        (["--environment", "square.hdr"], "twice as wide as high"),
        (["--environment", "none.hdr"], "No such file"),
        (["--environment", "overcast.hdr", "--sun-sky-ratio", "4"], "no bright source"),
        (["--environment", "clear.hdr", "--environment-sources", "1", "5", "2"], "T R M"),
        (["--environment", "clear.hdr", "--surface", "sphere"], "give a DEM"),
        ([*SUN, *CAMERA, "--background", "none.png"], "No such file"),
        ([*SUN, *CAMERA, "--background", "clear.hdr"], "the aspect ratio of"),
        ([*SUN, *CAMERA, "--background", "grey.png", "--shadow-catcher", "1e6"], "shadow catcher"),
    ],
)
def test_errors_are_one_line(dem, skies, tmp_path, capsys, how, says):
    out = tmp_path / "a.tif"
    named = [str(skies / one) if one.endswith((".hdr", ".png")) else one for one in how]
    assert run(["render", dem, "-o", str(out), *AREA, *named]) == 1
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_a_mock_up_of_centimetres(skies, tmp_path):
    """A block of a metre on nothing: its shadow lies west of it, from a lamp 30 deg high in the east."""
    path, out, step = tmp_path / "block.tif", tmp_path / "a.tif", 0.05
    z = np.full((21, 21), 0.5, np.float32)
    crs = "+proj=eqc +R=1737400 +units=m"
    corner = rasterio.Affine(step, 0, -10.5 * step, 0, -step, 10.5 * step)
    shape = {"height": 21, "width": 21, "count": 1, "dtype": "float32", "nodata": -9999.0}
    with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=corner, **shape) as file:
        file.write(z, 1)
    lamp = room(60, [Lamp(91.5, 31.5, 1.0)], ambient=1e-4).luminance.astype(np.float32)
    cv2.imwrite(str(tmp_path / "lamp.hdr"), np.repeat(lamp[:, :, None], 3, axis=2))
    cv2.imwrite(str(tmp_path / "white.tif"), np.ones((60, 60), np.float32))
    view = ["--center", "0", "0", "--size", "0.003", "--gsd", "0.05", "--frame", "camera"]
    view += ["--off-nadir", "0", "--view-azimuth", "0", "--altitude", "0.05"]
    light = ["--environment", tmp_path / "lamp.hdr", "--shadow-catcher", "0"]
    how = [*view, *light, "--background", tmp_path / "white.tif", "--accuracy", "draft"]
    assert run(["render", str(path), "-o", str(out), *map(str, how)]) == 0
    bands, _, _ = read(out)
    row = bands["composite"][30]
    dark = np.flatnonzero((row < 0.1) & (bands["visible"][30] == 0))
    # half a metre wide to each side and 0.5 / tan(31.5 deg) = 0.82 m of shadow, 5 cm a pixel
    assert dark.size * step == pytest.approx(0.5 / np.tan(np.radians(31.5)), abs=0.1)
    assert dark.max() < 30
    assert bands["visible"][30].sum() * step == pytest.approx(1.0, abs=0.1)
    # seen aslant, terrain beyond the area could hide it: none is looked for where the DEM has ended
    aslant = [*how, "--off-nadir", "35", "--overwrite"]
    assert run(["render", str(path), "-o", str(out), *map(str, aslant)]) == 0


def test_the_plan_says_what_lights_and_what_was_made_of_the_sun(
    dem, skies, tmp_path, capsys, caplog
):
    """The line about the Sun over the sky, words without a Sun, and a Sun that is cut off."""
    image = recorded(cut_at=200.0).luminance.astype(np.float32)
    path = tmp_path / "weak.hdr"
    cv2.imwrite(str(path), np.repeat(image[:, :, None], 3, axis=2))

    def said(panorama, *how):
        assert run(["render", dem, *AREA, "--environment", str(panorama), "--explain", *how]) == 0
        found = json.loads(capsys.readouterr().out)["decisions"]
        return {one["effect"]: one for one in found}

    effects = said(path)
    assert effects["Sun over sky"]["modelled"]
    assert "scaled to 4" in effects["Sun over sky"]["reason"]
    assert "one luminance" in caplog.text
    caplog.clear()
    for effect in ("cast shadows", "solar disc"):
        assert "source 1" in effects[effect]["reason"]
    assert "source 1 does not reach have the sky's" in effects["scattered light"]["reason"]
    assert effects["parallax of the Sun"]["error_bound"] == 0.0
    assert not any("sunlight" in one["reason"] for one in effects.values())
    effects = said(path, "--sun-sky-ratio", "found")
    assert not effects["Sun over sky"]["modelled"]
    assert not caplog.text
    effects = said(skies / "overcast.hdr")
    assert effects["scattered light"]["reason"].startswith("all light is the sky's")


def test_a_background_coarser_than_the_camera(dem, skies, tmp_path, caplog, capsys):
    how = [*CAMERA, "--environment", skies / "overcast.hdr", "--shadow-catcher", "300", "--explain"]
    render(dem, tmp_path / "a.tif", *how)
    said = {one["effect"]: one for one in json.loads(capsys.readouterr().out)["decisions"]}
    camera = json.loads(read(tmp_path / "a.tif")[2]["camera"])
    expected = np.pi / 32 * camera["focal_length_px"]
    assert said["background"]["error_bound"] == pytest.approx(expected)
    assert expected > 2.0
    assert "the background is blurred: a pixel of overcast.hdr is" in caplog.text
    caplog.clear()
    rows, cols = camera["image_size_px"][::-1]
    cv2.imwrite(str(tmp_path / "fine.png"), np.full((rows, cols), 128, np.uint8))
    render(dem, tmp_path / "b.tif", *how[:-1], "--background", tmp_path / "fine.png")
    assert "blurred" not in caplog.text
