"""``--bounce`` of ``lcp render`` and ``lcp simulate`` from the outside."""

import json

import numpy as np
import pytest
import rasterio
from helpers.renders import read, rolling, write_dem
from lcp_cli.main import run

AREA = ["--center", "30.5", "10.5", "--size", "5", "--accuracy", "draft"]
SUN = ["--sun-azimuth", "100", "--sun-elevation", "20"]
LAW = ["--reflectance", "lambert"]
CAMERA = ["--frame", "camera", "--off-nadir", "20", "--view-azimuth", "250", "--altitude", "20"]


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    hills = 6.0 * rolling(256, 256)
    return write_dem(tmp_path_factory.mktemp("dem") / "hills.tif", hills, 30.0, 11.0)


@pytest.mark.parametrize("view", [[], CAMERA])
def test_shadows_have_light_from_other_ground(dem, tmp_path, capsys, view):
    radiance, said = {}, {}
    for choice in ("on", "off"):
        out = tmp_path / f"{choice}.tif"
        how = [*AREA, *SUN, *LAW, *view, "--bounce", choice, "--explain"]
        assert run(["render", dem, "-o", str(out), *how]) == 0
        bands, _, tags = read(out)
        radiance[choice] = bands["radiance"]
        decided = json.loads(capsys.readouterr().out)["decisions"]
        (said[choice],) = (one for one in decided if one["effect"] == "scattered light")
        assert json.dumps(said[choice]["reason"]) in tags["scene_plan"]
    dark = (bands["visible"] > 0) & (bands["sunlit"] == 0)
    assert dark.sum() > 50
    assert said["on"]["modelled"]
    assert not said["off"]["modelled"]
    assert "light by way of other ground is left out" in said["off"]["reason"]
    assert (radiance["off"][dark] == 0.0).all()
    gained = radiance["on"][dark]
    assert 0.0 < gained.max() < said["off"]["error_bound"]
    assert (gained > 0.0).mean() > 0.5
    same = radiance["on"] == radiance["off"]
    assert (same | np.isnan(radiance["off"]))[~dark].all()


def pixels(path):
    with rasterio.open(path) as file:
        return file.read(1)


def test_a_simulated_frame_has_it_as_a_render_does(dem, tmp_path):
    """One ray a pixel: the frame's radiance is the render's in the camera's plane."""
    seen = [
        "--center",
        "30.5",
        "10.5",
        "--fov",
        "15",
        "--altitude",
        "20",
        "--image-size",
        "48",
        "48",
    ]
    how = [*seen, *SUN, *LAW, "--sun", "point", "--accuracy", "draft", "--gsd", "60"]
    radiance = {}
    for choice in ("on", "off"):
        rendered, frame = tmp_path / f"r_{choice}.tif", tmp_path / f"s_{choice}.tif"
        assert run(["render", dem, *how, "--bounce", choice, "-o", str(rendered)]) == 0
        detector = ["--samples", "1", "--bits", "16", "--exposure", "0.2"]
        assert run(["simulate", dem, *how, *detector, "--bounce", choice, "-o", str(frame)]) == 0
        radiance[choice] = pixels(frame)
        np.testing.assert_allclose(radiance[choice], pixels(rendered), atol=0.5001 * 0.2 / 65535)
    dark = radiance["off"] == 0.0
    assert dark.sum() > 20
    assert (radiance["on"][dark] > 0.0).mean() > 0.5
    np.testing.assert_array_equal(radiance["on"][~dark], radiance["off"][~dark])
