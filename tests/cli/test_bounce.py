"""``lcp render --bounce`` from the outside."""

import json

import numpy as np
import pytest
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
