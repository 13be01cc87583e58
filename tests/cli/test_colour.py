"""``lcp render --albedo`` with a map in colour: three radiance bands, equal to those of three grey maps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers.commands import refusal
from helpers.products import DEGREE_M, cylinder
from helpers.scan_files import scan
from lcp_cli.main import run
from rasterio.enums import ColorInterp

COLOURS = ("red", "green", "blue")
SUN = ["--subsolar", "75", "0"]
WEIGHTS = (0.2126, 0.7152, 0.0722)
PER_DEGREE, ROWS, WEST, NORTH = 50, 150, 29.0, 12.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Hills, a scanner over them, a map in colour of two thirds of them, and its bands as three files."""
    made = tmp_path_factory.mktemp("colour")

    def hills(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        return 100.0 * np.sin(40.0 * lon) * np.sin(43.0 * lat)

    cylinder(made / "dem.tif", WEST, NORTH, (300, 300), 100.0, hills)
    scan(made / "scan.json", "PUSH_FRAME")
    x, y = np.meshgrid(np.arange(100) / PER_DEGREE, np.arange(ROWS) / PER_DEGREE)
    red = 0.2 + 0.1 * np.sin(7 * x)
    bands = np.stack([red, 0.15 + 0.1 * np.cos(5 * y), 0.1 + 0.05 * np.sin(3 * x + 4 * y)])
    write(made / "rgb.tif", bands.astype(np.float32))
    for colour, band in zip(COLOURS, bands.astype(np.float32), strict=True):
        write(made / f"{colour}.tif", band[None])
    return made


def write(path: Path, bands: np.ndarray, kinds: tuple[str, ...] = ()) -> None:
    pixel_m = DEGREE_M / PER_DEGREE
    where = rasterio.Affine(pixel_m, 0, WEST * DEGREE_M, 0, -pixel_m, NORTH * DEGREE_M)
    shape = dict(zip(("count", "height", "width"), bands.shape, strict=True))
    crs = rasterio.CRS.from_proj4("+proj=eqc +R=1737400 +units=m")
    how = {"driver": "GTiff", "dtype": bands.dtype, "crs": crs, "transform": where}
    how["photometric"] = "minisblack"
    with rasterio.open(path, "w", **how, **shape) as file:
        file.write(bands)
        if kinds:
            file.colorinterp = [ColorInterp[kind] for kind in kinds]


OVER = ["--center", "30.5", "10.5"]
CAMERA = [*OVER, "--image-size", "40", "30"]
SPHERE = ["--surface", "sphere"]
NEAR = [*CAMERA, "--fov", "30", "--altitude", "60", "--look", "60", "-70"]
WITH_LIMB = [*CAMERA, "--fov", "120", "--altitude", "200", "--look", "60", "-85"]
SCENES = {
    "nodes": [*OVER, "--size", "24", "--gsd", "600"],
    "camera": NEAR,
    "push-frame camera": ["--camera", "scan.json", "--frame", "camera"],
    "nodes of the sphere": [*SPHERE, *OVER, "--size", "90", "--gsd", "2000"],
    "camera on the sphere": [*SPHERE, *WITH_LIMB],
}


def shot(folder: Path, out: Path, scene: str, albedo: str, *more: str) -> dict[str, np.ndarray]:
    view = [str(folder / word) if word == "scan.json" else word for word in SCENES[scene]]
    where = [str(folder / "dem.tif"), *view, *SUN, "--albedo", str(folder / albedo)]
    assert run(["render", *where, *more, "-o", str(out), "--overwrite"]) == 0
    with rasterio.open(out) as file:
        return dict(zip(file.descriptions, file.read(), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_each_colour_is_the_render_with_its_band(folder: Path, tmp_path: Path, scene: str) -> None:
    """Bit by bit; the radiance is their luminance, and no other band is touched."""
    over = ["--albedo-reference", "0.16"]
    found = shot(folder, tmp_path / "rgb.tif", scene, "rgb.tif", *over)
    names = [f"radiance_{colour}" for colour in COLOURS]
    assert list(found)[-3:] == names
    for name, colour in zip(names, COLOURS, strict=True):
        grey = shot(folder, tmp_path / "grey.tif", scene, f"{colour}.tif", *over)
        np.testing.assert_array_equal(found[name], grey["radiance"])
        assert (grey["radiance"] > 0).mean() > 0.3
        assert list(found)[:-3] == list(grey)
        for other in set(grey) - {"radiance"}:
            np.testing.assert_array_equal(found[other], grey[other])
    assert np.nanmax(np.abs(found[names[0]] - found[names[1]])) > 0.005
    want = sum(w * found[name] for w, name in zip(WEIGHTS, names, strict=True))
    np.testing.assert_allclose(found["radiance"], want, rtol=1e-6)


def test_colours_and_units_of_the_file_and_the_preview(folder: Path, tmp_path: Path) -> None:
    out, preview = tmp_path / "a.tif", tmp_path / "a.png"
    found = shot(folder, out, "nodes", "rgb.tif", "--preview", str(preview))
    with rasterio.open(out) as file:
        assert [kind.name for kind in file.colorinterp[-3:]] == list(COLOURS)
        assert not set(COLOURS) & {kind.name for kind in file.colorinterp[:-3]}
        assert file.units[-3:] == ("1", "1", "1")
        assert file.nodata is not None
    with rasterio.open(preview) as file:
        assert [kind.name for kind in file.colorinterp] == list(COLOURS)
        picture = file.read().astype(float)
    values = np.nan_to_num(np.stack([found[f"radiance_{colour}"] for colour in COLOURS]))
    white = np.percentile(values[values > 0], 99.5)
    want = 255.0 * np.clip(values / white, 0.0, 1.0) ** (1 / 1.2)
    assert np.abs(picture - want).max() <= 0.5001
    assert np.abs(picture[0] - picture[2]).max() > 20


def test_the_reference_is_the_mean_luminance(folder: Path, tmp_path: Path) -> None:
    """By area: a row's pixels are as wide as the cosine of its latitude."""
    shot(folder, tmp_path / "a.tif", "nodes", "rgb.tif")
    with rasterio.open(tmp_path / "a.tif") as file:
        said = json.loads(file.tags()["albedo"])
        plan = json.loads(file.tags()["scene_plan"])["decisions"]
    with rasterio.open(folder / "rgb.tif") as file:
        light = np.tensordot(WEIGHTS, file.read().astype(float), 1)
    lat = np.radians(NORTH - (np.arange(ROWS) + 0.5) / PER_DEGREE)
    mean = np.average(light.mean(axis=1), weights=np.cos(lat))
    assert said.pop("reference") == pytest.approx(mean, rel=1e-6)
    assert said == {
        "name": "rgb.tif",
        "encoding": "linear",
        "reference_is": "mean luminance of the map",
        "bands": [1, 2, 3],
    }
    reason = next(d["reason"] for d in plan if d["effect"] == "albedo")
    assert reason.startswith("rgb.tif, red, green and blue, linear, over 0.1")
    assert "its mean luminance: factors of luminance of 0." in reason


def test_the_files_own_colours_decide_the_order(folder: Path, tmp_path: Path) -> None:
    """Codes of a display image in the order blue, red, green; a transparent part has the
    factor 1 in all three.
    """
    codes = np.stack([np.full((ROWS, 100), code, np.uint8) for code in (60, 200, 120, 255)])
    codes[3, :, :65] = 0
    write(folder / "codes.tif", codes, ("blue", "red", "green", "alpha"))
    how = ["--albedo-encoding", "srgb", "--albedo-reference", "1"]
    found = shot(folder, tmp_path / "a.tif", "nodes", "codes.tif", *how)
    where = [str(folder / "dem.tif"), *SCENES["nodes"], *SUN, "-o", str(tmp_path / "plain.tif")]
    assert run(["render", *where]) == 0
    with rasterio.open(tmp_path / "plain.tif") as file:
        plain = file.read(1)
    east = np.s_[:, plain.shape[1] // 2 :]
    lit = plain > 0
    for colour, code in zip(COLOURS, (200, 120, 60), strict=True):
        linear = ((code / 255 + 0.055) / 1.055) ** 2.4
        ratio = np.where(lit, found[f"radiance_{colour}"] / np.where(lit, plain, 1.0), np.nan)
        assert ratio[east][lit[east]] == pytest.approx(linear, rel=2e-3)
        assert ratio[:, :5][lit[:, :5]] == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("kinds", [(), COLOURS])
def test_simulate_refuses_colours(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    kinds: tuple[str, ...],
) -> None:
    codes = np.full((3, ROWS, 100), 90, np.uint8)
    write(folder / "display.tif", codes, kinds)
    view = ["--fov", "10", "--altitude", "60", "--center", "30.5", "10.5", *SUN]
    arguments = ["simulate", str(folder / "dem.tif"), *view, "-o", str(tmp_path / "f.png")]
    error = refusal([*arguments, "--albedo", str(folder / "display.tif")], 1, capsys)
    assert "three bands, which lcp render takes as red, green and blue; a frame has one" in error
    assert not list(tmp_path.iterdir())
