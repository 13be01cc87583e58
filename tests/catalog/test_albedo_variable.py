"""Albedo in a catalogue: points from brightness alone, the stored values, and detection of damage."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import rasterio
import xarray
from helpers import catalogs
from helpers.products import DEGREE_M, geotiff
from helpers.verified import verify

from lcp_catalog.catalog import catalogue, summary
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.report import render_report
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import (
    AlbedoError,
    AreaFailedError,
    CatalogError,
    ConfigError,
    OutputExistsError,
)
from lcp_catalog.geometry.frames import mcmf_to_lonlat
from lcp_catalog.production import run
from lcp_catalog.production.area_job import area_sweep, run_area
from lcp_catalog.production.checkpoints import Checkpoints, fingerprint
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build, BuildRun

GSD_M = 500.0
CONFIG = BuildConfig(
    area=AreaConfig(center_deg=(179.9, 10.0), size_km=34.0, gsd_m=GSD_M),
    sun=SunConfig((90.0, 270.0), (30.0, 50.0)),
    view=ViewConfig((0.0, 20.0), (0.0, 90.0), (float("inf"), float("inf"))),
    points=PointConfig(patch_nodes=17, search_m=5000.0, spacing_m=6000.0),
    model=ModelConfig(direction_tolerance_deg=1.0, ring_max_km=5.0),
)


def spots(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    """Bright and dark spots of some 5 km on no lattice, different at every place; 0.05 to 0.95."""
    x, y = np.asarray(lon_deg) % 360.0, np.asarray(lat_deg)
    a = np.sin(31.0 * x + 2.0 * np.sin(9.0 * y)) * np.sin(27.0 * y + 1.5 * np.sin(10.0 * x))
    b = np.sin(13.0 * x + 19.0 * y) * np.sin(21.0 * x - 15.0 * y + 1.0)
    return 0.5 + 0.3 * a + 0.15 * b


def brightness_map(path: Path, west: float = 178.5, columns: int = 560) -> Path:
    """Pixels of 1/200 deg (152 m) over 8.5..11.5 N, across the antimeridian."""
    lon, lat = west + (np.arange(columns) + 0.5) / 200, 11.5 - (np.arange(600) + 0.5) / 200
    values = spots(*np.meshgrid(lon, lat)).astype(np.float32)
    return geotiff(path, values, west * DEGREE_M, 11.5 * DEGREE_M, DEGREE_M / 200)


def state(file: h5py.File, **facts: Any) -> None:
    """Write other facts about the map into a file."""
    file.attrs["albedo_map"] = json.dumps(json.loads(file.attrs["albedo_map"]) | facts)


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Terrain without relief, from which no point can be made."""
    path = tmp_path_factory.mktemp("dem") / "ball.tif"
    return geotiff(path, np.ones((400, 600), np.float32), 178 * DEGREE_M, 12 * DEGREE_M, DEGREE_M / 100)  # fmt: skip


@pytest.fixture(scope="module")
def spotted(tmp_path_factory: pytest.TempPathFactory) -> BuildConfig:
    """The build with the whole region on a map."""
    path = brightness_map(tmp_path_factory.mktemp("map") / "spots.tif")
    return with_map(path, albedo_reference=0.5)


def with_map(path: Path, **how: Any) -> BuildConfig:
    model = dataclasses.replace(CONFIG.model, albedo=str(path), **how)
    return dataclasses.replace(CONFIG, model=model)


@pytest.fixture(scope="module")
def built(
    ball: Path, spotted: BuildConfig, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Build, Path]:
    plan = Build.plan((ball,), spotted)
    output = tmp_path_factory.mktemp("build") / "spots.h5"
    BuildRun(plan, output).whole()
    return plan, output


@pytest.fixture(scope="module")
def catalog(built: tuple[Build, Path]) -> Catalog:
    return open_catalog(built[1])


@pytest.mark.slow
def test_brightness_alone_makes_points(ball: Path, catalog: Catalog, tmp_path: Path) -> None:
    """Corners, localisation and uniqueness are those of the images with albedo; level terrain has
    none of its own.
    """
    assert len(catalog) >= 4
    plan = Build.plan((ball,), CONFIG)
    BuildRun(plan, tmp_path / "bare.h5").whole()
    assert len(open_catalog(tmp_path / "bare.h5")) == 0
    assert (catalog.shadow_dependence == 0.0).all()
    assert (catalog.occlusion_dependence == 0.0).all()


def test_the_images_are_those_without_times_the_factor(built: tuple[Build, Path]) -> None:
    """At every node: the closed form at the node's own longitude and latitude, divided by the
    reference.
    """
    job = built[0].jobs[0]
    lit = area_sweep(job)
    bare = area_sweep(dataclasses.replace(job, recipe=dataclasses.replace(job.recipe, albedo=None)))
    terrain = lit.terrain
    row0, row1, col0, col1 = terrain.core
    field = terrain.field
    x = field.x0_m + np.arange(col0, col1) * GSD_M
    y = field.y0_m - np.arange(row0, row1) * GSD_M
    flat = np.stack([*np.meshgrid(x, y), field.z_m[row0:row1, col0:col1]], axis=-1)
    lon, lat, _ = mcmf_to_lonlat(terrain.frame.to_mcmf(flat))
    want = _smoothed(lon, lat) / 0.5
    for one, other in zip(lit.images(), bare.images(), strict=True):
        ratio = one.radiance / other.radiance
        assert np.isfinite(ratio).all()
        assert np.abs(ratio - want).max() < 0.005  # of up to 2: between blocks of pixels


def _smoothed(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """Mean of the closed form over 3 x 3 pixels, as cells of 3.3 pixels average them."""
    steps = (np.arange(9) - 4) / 9 * 3 / 200
    return np.mean([[spots(lon + dx, lat + dy) for dx in steps] for dy in steps], axis=(0, 1))


def test_what_is_stored_is_the_brightness_of_the_patchs_own_nodes(catalog: Catalog) -> None:
    """Every node of a patch converted back to longitude and latitude by the point's variables in
    the file.
    """
    assert catalog.albedo is not None
    half = catalog.patch_nodes // 2
    step = np.arange(-half, half + 1) * GSD_M
    x, y = np.meshgrid(step, -step)
    for i in range(len(catalog)):
        enu = np.stack([x, y, catalog.dem[i].astype(np.float64)], axis=-1)
        lon, lat, _ = mcmf_to_lonlat(
            enu @ catalog.rotation_mcmf_to_enu[i] + catalog.position_mcmf[i]
        )
        want = _smoothed(lon, lat) / 0.5
        assert np.abs(catalog.albedo[i] - want).max() < 0.005
        for wrong in (want[::-1], want[:, ::-1], want.T, np.roll(want, 1, 0), np.roll(want, 1, 1)):
            assert np.abs(catalog.albedo[i] - wrong).max() > 0.1


def test_the_file_says_where_it_comes_from(built: tuple[Build, Path], catalog: Catalog) -> None:
    path = built[1]
    assert verify(path) == []
    with xarray.open_dataset(path, engine="h5netcdf") as found:
        assert found["albedo"].dims == ("point", "patch_row", "patch_col")
        assert (found["albedo"].dtype, found["albedo"].units) == (np.float32, "1")
        source = json.loads(found.attrs["albedo_map"])
        config, plan = found.attrs["config"], found.attrs["scene_plan"]
    mapped = Path(str(built[0].jobs[0].recipe.config.model.albedo))
    assert source["name"] == source["files"][0]["name"] == "spots.tif"
    assert source["files"][0]["size"] == mapped.stat().st_size
    assert len(source["files"][0]["sha256"]) == 64
    assert (source["encoding"], source["reference"]) == ("linear", 0.5)
    assert source["pixel_m"] == pytest.approx(DEGREE_M / 200)
    assert 'albedo = "spots.tif"' in config  # no folder
    assert str(mapped.parent) not in config + plan
    decision = next(d for d in json.loads(plan)["decisions"] if d["effect"] == "albedo")
    assert decision["modelled"] is True
    assert "spots.tif, linear, over 0.5" in decision["reason"]
    found = summary.summary(catalog)
    assert found["albedo"]["range"] == [catalog.albedo.min(), catalog.albedo.max()]
    assert found["albedo"]["points_off_the_map"] == 0
    text = dict(summary.summary_rows(found))["albedo"]
    assert text.startswith("spots.tif, linear, over 0.5 (stated); factors ")
    page = render_report(catalog, "spots.h5")
    assert text in page
    assert source["files"][0]["sha256"] in page


@pytest.mark.slow  # starts processes; test_build has one without a map in the fast suite
def test_two_processes_give_the_same_bytes(built: tuple[Build, Path], tmp_path: Path) -> None:
    plan, path = built
    BuildRun(plan, tmp_path / "two.h5", jobs=2).whole()
    assert (tmp_path / "two.h5").read_bytes() == path.read_bytes()


def test_a_broken_run_gives_the_same_bytes(
    built: tuple[Build, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, path = built
    assert len(plan.jobs) > 1

    def fails(job: Any) -> object:
        if job.task.name == plan.jobs[-1].task.name:
            raise RuntimeError("a bit fell over")
        return run_area(job)

    monkeypatch.setattr(run, "run_area", fails)
    with pytest.raises(AreaFailedError):
        BuildRun(plan, tmp_path / "again.h5").whole()
    monkeypatch.undo()
    BuildRun(plan, tmp_path / "again.h5", resume=True).whole()
    assert (tmp_path / "again.h5").read_bytes() == path.read_bytes()


def test_areas_of_another_map_are_not_mixed_in(
    ball: Path, spotted: BuildConfig, tmp_path: Path
) -> None:
    """The run's fingerprint contains the map's bytes and encoding, not its folder."""
    mapped = Path(str(spotted.model.albedo))
    same, other = tmp_path / "a" / "spots.tif", tmp_path / "b" / "spots.tif"
    for copy in (same, other):
        copy.parent.mkdir()
        copy.write_bytes(mapped.read_bytes())
    with rasterio.open(other, "r+") as file:
        values = file.read(1)
        values[300, 280] *= 1.001
        file.write(values, 1)
    prints = [
        Build.plan((ball,), with_map(path, **how)).facts()
        for path, how in (
            (mapped, {"albedo_reference": 0.5}),
            (same, {"albedo_reference": 0.5}),
            (other, {"albedo_reference": 0.5}),
            (mapped, {"albedo_reference": 0.25}),
            (mapped, {}),
        )
    ]
    assert prints[0] == prints[1]
    assert len({fingerprint(one) for one in prints}) == 4
    checkpoints = Checkpoints.beside(tmp_path / "x.h5", prints[0])
    with checkpoints.locked():
        checkpoints.begin(resume=False)
        with pytest.raises(OutputExistsError, match="another content of the files; go on"):
            Checkpoints.beside(tmp_path / "x.h5", prints[2]).begin(resume=True)


def test_where_the_map_ends_inside_a_patch_is_no_point(
    ball: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A map of the western half: its edge is the strongest line of every image, but not on the
    surface.
    """
    edge_lon = 179.9
    path = brightness_map(tmp_path / "west.tif", 178.5, 280)
    plan = Build.plan((ball,), with_map(path, albedo_reference=0.1))
    assert "of the area; the factor is 1 there" in caplog.text
    results = [run_area(job).candidates for job in plan.jobs]
    lon = np.concatenate([found.lon_deg for found in results])
    albedo = np.concatenate([found.albedo for found in results])
    known = np.isfinite(albedo)
    assert (known.all(axis=(1, 2)) | ~known.any(axis=(1, 2))).all()
    reach = 8 * GSD_M / (DEGREE_M * np.cos(np.radians(10.0)))
    assert np.abs(lon - edge_lon).min() > reach
    assert (known[:, 0, 0] == (lon < edge_lon)).all()
    assert known.any()


def test_a_region_off_the_map_is_refused(ball: Path, tmp_path: Path) -> None:
    path = brightness_map(tmp_path / "far.tif", 170.0, 100)
    with pytest.raises(AlbedoError, match="does not cover the area"):
        Build.plan((ball,), with_map(path))


class TestTheFile:
    """Synthetic catalogues: reading, writing and damage."""

    @staticmethod
    def made(**spoilt: Any) -> Catalog:
        values = np.random.default_rng(2).uniform(0.5, 1.5, (6, 9, 9)).astype(np.float32)
        values[4] = np.nan  # off the map
        given = {"albedo": values, "albedo_map": catalogs.ALBEDO_MAP}
        return catalogs.catalog(6, **{**given, **spoilt})

    @pytest.fixture
    def path(self, tmp_path: Path) -> Path:
        write_catalog(self.made(), tmp_path / "albedo.h5")
        return tmp_path / "albedo.h5"

    def test_what_was_written_is_read(self, path: Path) -> None:
        before, after = self.made(), open_catalog(path)
        np.testing.assert_array_equal(after.albedo, before.albedo)
        assert after.albedo_map == before.albedo_map
        assert verify(path) == []

    def test_without_a_map_there_is_none(self, tmp_path: Path) -> None:
        write_catalog(catalogs.catalog(6), tmp_path / "bare.h5")
        found = open_catalog(tmp_path / "bare.h5")
        assert found.albedo is found.albedo_map is None
        with h5py.File(tmp_path / "bare.h5") as file:
            assert "albedo" not in file
            assert "albedo_map" not in file.attrs

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("damage", "says"),
        [
            (
                lambda file: file["albedo"].__setitem__((0, 0, 0), 0.7),
                "albedo: 1 of 1 chunks are not",
            ),
            (lambda file: file.attrs.__setitem__("albedo_map", '{"name": "x"}'), "content_sha256"),
            (lambda file: file.attrs.__delitem__("albedo_map"), "albedo_map is missing"),
            (lambda file: file.__delitem__("albedo"), "albedo: the variable is missing"),
            (lambda file: file.attrs.__setitem__("albedo_map", "{"), "albedo_map: is not JSON"),
            *(
                (lambda file, pixel=pixel: state(file, pixel_m=pixel), "a pixel's side")
                for pixel in (0.0, -5.0, "5")
            ),
            (lambda file: file["albedo"].attrs.__setitem__("units", "m"), "albedo: units is m"),
        ],
    )
    def test_damage_is_noticed(self, path: Path, damage: Any, says: str) -> None:
        with h5py.File(path, "r+") as file:
            damage(file)
        assert any(says in line for line in verify(path))

    @pytest.mark.slow
    def test_no_damage_raises_or_passes(self, path: Path, tmp_path: Path) -> None:
        """One byte changed at 60 places: the change is detected, or the values read are equal all
        the same.
        """
        sound = catalogue.values(open_catalog(path))
        assert catalogs.noticed_damage(path, sound, tmp_path / "turned.h5", seed=5) > 15

    @pytest.mark.parametrize(
        ("spoilt", "says"),
        [
            ({"albedo": np.full((6, 9, 9), -0.1)}, "albedo: not 0 or above"),
            ({"albedo": np.full((6, 9, 9), np.inf)}, "albedo: not 0 or above"),
            ({"albedo": np.where(np.eye(9), np.nan, np.ones((6, 9, 9)))}, "a part of the patch"),
            ({"albedo": np.ones((6, 9, 7))}, "7 along patch_col"),
            ({"albedo_map": None}, "albedo and albedo_map go together"),
            ({"albedo": None}, "albedo and albedo_map go together"),
        ],
    )
    def test_what_cannot_be_is_refused(self, spoilt: dict[str, Any], says: str) -> None:
        with pytest.raises(CatalogError, match=says):
            self.made(**spoilt)

    def test_points_off_the_map_are_counted(self) -> None:
        found = summary.summary(self.made())["albedo"]
        assert found["points_off_the_map"] == 1
        assert 0.5 <= found["range"][0] < found["range"][1] <= 1.5


class TestConfiguration:
    def test_a_map_is_sought_from_the_files_folder(self, tmp_path: Path) -> None:
        path = tmp_path / "build.toml"
        path.write_text('[model]\nalbedo = "maps/m.tif"\nalbedo_encoding = "srgb"\n')
        model = BuildConfig.from_toml(path).model
        assert model.albedo == str(tmp_path / "maps" / "m.tif")
        assert model.portable.albedo == "m.tif"
        path.write_text('[model]\nalbedo = "/maps/m.tif"\n')
        assert BuildConfig.from_toml(path).model.albedo == "/maps/m.tif"
        again = dataclasses.replace(CONFIG, model=model)
        assert BuildConfig.from_dict({"model": {"albedo": "x"}}).model.albedo == "x"
        assert 'albedo_encoding = "srgb"' in again.to_toml()

    @pytest.mark.parametrize(
        ("how", "says"),
        [
            (
                {"albedo": "m.tif", "albedo_encoding": "gamma"},
                "`model.albedo_encoding` must be linear or",
            ),
            (
                {"albedo": "m.tif", "albedo_reference": 0.0},
                "`model.albedo_reference` must be above 0",
            ),
            ({"albedo_reference": 0.5}, "needs `model.albedo`"),
            ({"albedo_encoding": "srgb"}, "needs `model.albedo`"),
        ],
    )
    def test_what_cannot_be_is_refused(self, how: dict[str, Any], says: str) -> None:
        with pytest.raises(ConfigError, match=says):
            ModelConfig(**how)
