"""``--albedo`` from the outside: renders and builds with a map of brightness, what they say, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers.commands import refusal
from helpers.products import DEGREE_M, cylinder, geotiff
from lcp_cli.main import run

from lcp_catalog.geometry.frames import EnuFrame, mcmf_to_lonlat

AREA = ["--center", "30.5", "10.5", "--size", "24"]
SUN = ["--sun-azimuth", "100", "--sun-elevation", "20"]


def waves(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    return 0.2 + 0.1 * np.sin(7.0 * lon_deg) * np.cos(9.0 * lat_deg)


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Hills 200 m high in cells of 1/100 deg, 29..32 E, 9..12 N."""
    path = tmp_path_factory.mktemp("dem") / "hills.tif"

    def hills(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        return 100.0 * np.sin(40.0 * lon) * np.sin(43.0 * lat)

    return str(cylinder(path, 29.0, 12.0, (300, 300), 100.0, hills))


@pytest.fixture(scope="module")
def albedo(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("map") / "waves.tif"
    return str(cylinder(path, 29.0, 12.0, (240, 240), 80.0, waves))


def rendered(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str], rasterio.Affine]:
    with rasterio.open(path) as file:
        bands = dict(zip(file.descriptions, file.read(), strict=True))
        return bands, file.tags(), file.transform


@pytest.mark.slow
def test_a_render_is_the_one_without_times_the_factor(
    dem: str, albedo: str, tmp_path: Path
) -> None:
    """At every node: the closed form at its longitude and latitude over the stated reference. Nothing else changes."""
    plain, bright, rule = tmp_path / "a.tif", tmp_path / "b.tif", tmp_path / "rule.d"
    common = ["render", dem, *AREA, *SUN, "--gsd", "300"]
    assert run([*common, "-o", str(plain)]) == 0
    given = ["--albedo", albedo, "--albedo-reference", "0.25"]
    assert run([*common, "-o", str(bright), *given, "--depfile", str(rule)]) == 0
    without, _, _ = rendered(plain)
    found, tags, affine = rendered(bright)
    rows, cols = np.indices(found["height"].shape)
    x, y = affine * (cols + 0.5, rows + 0.5)
    place = EnuFrame(30.5, 10.5).to_mcmf(np.stack([x, y, found["height"]], axis=-1))
    want = waves(*mcmf_to_lonlat(place)[:2]) / 0.25
    lit = without["radiance"] > 0
    assert lit.mean() > 0.3
    ratio = found["radiance"][lit] / without["radiance"][lit]
    np.testing.assert_allclose(ratio, want[lit], atol=1e-4)
    for name in set(found) - {"radiance"}:
        np.testing.assert_array_equal(found[name], without[name])
    assert json.loads(tags["albedo"]) == {
        "name": "waves.tif",
        "encoding": "linear",
        "reference": 0.25,
        "reference_is": "stated",
    }
    assert rule.read_text() == f"{bright}: {dem} {albedo}\n"


def test_in_the_cameras_plane_it_is_that_of_the_place_seen(
    dem: str, albedo: str, tmp_path: Path
) -> None:
    plain, bright = tmp_path / "a.tif", tmp_path / "b.tif"
    view = ["--off-nadir", "30", "--view-azimuth", "200", "--altitude", "80", "--frame", "camera"]
    common = ["render", dem, *AREA, *SUN, *view, "--gsd", "300"]
    assert run([*common, "-o", str(plain)]) == 0
    assert run([*common, "-o", str(bright), "--albedo", albedo, "--albedo-reference", "0.25"]) == 0
    without, _, _ = rendered(plain)
    found, _, _ = rendered(bright)
    lon, lat, _ = mcmf_to_lonlat(np.stack([found["x"], found["y"], found["z"]], axis=-1))
    lit = without["radiance"] > 0
    assert lit.sum() > 1000
    ratio = found["radiance"][lit] / without["radiance"][lit]
    np.testing.assert_allclose(ratio, waves(lon[lit], lat[lit]) / 0.25, atol=1e-4)
    assert np.ptp(ratio) > 0.5


def test_without_a_map_nothing_is_said_of_one(dem: str, tmp_path: Path) -> None:
    assert run(["render", dem, *AREA, *SUN, "--gsd", "2000", "-o", str(tmp_path / "a.tif")]) == 0
    _, tags, _ = rendered(tmp_path / "a.tif")
    assert "albedo" not in tags
    decision = json.loads(tags["scene_plan"])["decisions"]
    assert [d["modelled"] for d in decision if d["effect"] == "albedo"] == [False]


def test_the_plan_says_what_leaving_it_out_would_cost(
    dem: str, albedo: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["render", dem, *AREA, *SUN, "--explain", "--albedo", albedo]) == 0
    found = json.loads(capsys.readouterr().out)["decisions"]
    albedos = [d for d in found if d["effect"] == "albedo"]
    assert len(albedos) == 1
    decision = albedos[0]
    assert decision["modelled"] is True
    assert decision["reason"].startswith("waves.tif, linear, over 0.2")
    x = np.linspace(-12e3, 12e3, 400)
    flat = np.stack([*np.meshgrid(x, -x), np.zeros((400, 400))], axis=-1)
    lon, lat, _ = mcmf_to_lonlat(EnuFrame(30.5, 10.5).to_mcmf(flat))
    values = waves(lon, lat)
    stated = float(decision["reason"].split("over the area, ")[1].split(" ")[0])
    assert stated == pytest.approx(values.std() / values.mean(), rel=0.03)


def test_a_map_of_a_part_is_said_and_leaves_the_rest(
    dem: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    """West of the area's middle only."""
    part = cylinder(tmp_path / "part.tif", 29.0, 12.0, (240, 120), 80.0, waves)
    out = [tmp_path / "a.tif", tmp_path / "b.tif"]
    common = ["render", dem, *AREA, *SUN, "--gsd", "300", "--explain"]
    assert run([*common, "-o", str(out[0])]) == 0
    capsys.readouterr()
    assert run([*common, "-o", str(out[1]), "--albedo", str(part), "--albedo-reference", "2"]) == 0
    text = next(d for d in json.loads(capsys.readouterr().out)["decisions"] if d["effect"] == "albedo")  # fmt: skip
    assert "of the area lies outside the map and has the factor 1" in text["reason"]
    assert "of the area; the factor is 1 there" in caplog.text
    (without, _, _), (found, _, _) = rendered(out[0]), rendered(out[1])
    east = slice(without["radiance"].shape[1] // 2 + 2, None)
    np.testing.assert_array_equal(found["radiance"][:, east], without["radiance"][:, east])
    west = slice(0, without["radiance"].shape[1] // 2 - 2)
    assert np.nanmax(found["radiance"][:, west] / without["radiance"][:, west]) < 0.2


def test_a_display_image_is_decoded(dem: str, tmp_path: Path) -> None:
    """One code everywhere: 188 of 255 is 0.5028865 of white (IEC 61966-2-1)."""
    codes = np.full((60, 60), 188, np.uint8)
    path = geotiff(tmp_path / "codes.tif", codes, 29 * DEGREE_M, 12 * DEGREE_M, DEGREE_M / 20)
    out = [tmp_path / "a.tif", tmp_path / "b.tif"]
    common = ["render", dem, *AREA, *SUN, "--gsd", "1000"]
    assert run([*common, "-o", str(out[0])]) == 0
    how = ["--albedo", str(path), "--albedo-encoding", "srgb", "--albedo-reference", "1"]
    assert run([*common, "-o", str(out[1]), *how]) == 0
    (without, _, _), (found, tags, _) = rendered(out[0]), rendered(out[1])
    lit = without["radiance"] > 0
    ratio = found["radiance"][lit] / without["radiance"][lit]
    np.testing.assert_allclose(ratio, 0.5028865, rtol=1e-6)
    assert json.loads(tags["albedo"])["encoding"] == "srgb"


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--albedo", "nowhere.tif"], 1, "nowhere.tif: there is no such file"),
        (["--albedo", "DEM"], 1, "this is a DEM"),
        (["--albedo", "FAR"], 1, "does not cover the area"),
        (["--albedo-encoding", "srgb"], 2, "--albedo-encoding needs --albedo"),
        (["--albedo-reference", "1"], 2, "--albedo-reference needs --albedo"),
        (["--albedo", "FAR", "--albedo-reference", "0"], 2, "--albedo-reference"),
        (["--albedo", "FAR", "--albedo-encoding", "gamma"], 2, "gamma"),
    ],
)
@pytest.mark.parametrize("command", ["render", "build-catalog"])
def test_mistakes_are_one_line_and_leave_nothing(
    command: str,
    arguments: list[str],
    code: int,
    says: str,
    dem: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    far = tmp_path / "far.tif"
    cylinder(far, 100.0, 12.0, (8, 8), 8.0, waves)
    named = {"DEM": dem, "FAR": str(far)}
    given = [named.get(word, word) for word in arguments]
    light = SUN if command == "render" else ["--sun-azimuths", "80,90", "--sun-elevations", "20,30"]
    out = str(tmp_path / ("out.tif" if command == "render" else "out.h5"))
    flags = ["-o", out, *AREA, "--gsd", "600", *light, *given]
    assert says in refusal([command, dem, *flags], code, capsys)
    assert [p.name for p in tmp_path.iterdir()] == ["far.tif"]


class TestBuild:
    CONFIG = """
[area]
center_deg = [30.5, 10.5]
size_km = 24.0
gsd_m = 600.0
[sun]
azimuths_deg = [80.0, 90.0]
elevations_deg = [20.0, 30.0]
[view]
off_nadir_deg = [0.0]
azimuth_deg = [0.0]
altitude_km = [inf]
[points]
patch_nodes = 9
search_m = 4000.0
[model]
direction_tolerance_deg = 1.0
ring_max_km = 5.0
"""

    @pytest.mark.slow
    def test_a_catalogue_with_albedo(
        self, dem: str, albedo: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        config, output, rule = tmp_path / "b.toml", str(tmp_path / "x.h5"), tmp_path / "rule.d"
        config.write_text(self.CONFIG)
        arguments = ["build-catalog", dem, "-o", output, "--config", str(config), "--jobs", "1"]
        assert run([*arguments, "--albedo", albedo, "--depfile", str(rule)]) == 0
        assert rule.read_text() == f"{output}: {dem} {albedo}\n"
        capsys.readouterr()
        assert run(["inspect", output, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["schema_version"] == "3.0"
        assert found["albedo"]["name"] == "waves.tif"
        assert found["albedo"]["reference_is"] == "mean of the map"
        assert [s["name"] for s in found["sources"]] == ["hills.tif"]
        assert run(["inspect", output]) == 0
        text = capsys.readouterr().out
        assert "albedo         waves.tif, linear, over 0.2" in text
        assert "source         waves.tif, " in text

    def test_a_flag_replaces_the_files_map_and_how_it_is_read(
        self, dem: str, albedo: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        config = tmp_path / "b.toml"
        config.write_text(
            self.CONFIG + 'albedo = "own.tif"\nalbedo_encoding = "srgb"\nalbedo_reference = 0.5\n'
        )
        cylinder(tmp_path / "own.tif", 29.0, 12.0, (240, 240), 80.0, waves)
        plan = ["build-catalog", dem, "--config", str(config), "--plan", "--json"]
        said = []
        for flags in ([], ["--albedo", albedo], ["--albedo-reference", "0.3"]):
            assert run([*plan, *flags]) == 0
            document = json.loads(capsys.readouterr().out)
            said += [d["reason"] for d in document["decisions"] if d["effect"] == "albedo"]
        assert said[0].startswith("own.tif, srgb, over 0.5: ")
        assert said[1].startswith("waves.tif, linear, over 0.2")
        assert said[2].startswith("own.tif, srgb, over 0.3: ")
