"""Albedo maps: comparison with closed forms, GDAL's warper and plain sums: positions of values,
means, reference and coverage.
"""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import rasterio
import rasterio.warp
from helpers.products import DEGREE_M, EQC, cylinder, geotiff
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.enums import Resampling

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.dem import raster
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import AlbedoError
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.photometry.albedo_map import PATCH_STEP, AlbedoCover, AlbedoMap
from lcp_catalog.terrain.area import Area
from lcp_catalog.terrain.terrain import Terrain, terrain_from_area

SOUTH = "+proj=stere +lat_0=-90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs"
SPHERE = "+proj=longlat +R=1737400 +no_defs"


def waves(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    """1 + 0.3 y + 0.1 z of the unit sphere: no seam and no pole, different in east and west, north
    and south; its mean is 1.
    """
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    return 1.0 + 0.3 * np.sin(lon) * np.cos(lat) + 0.1 * np.sin(lat)


@pytest.fixture(scope="module")
def moon(tmp_path_factory: pytest.TempPathFactory) -> AlbedoMap:
    """The whole Moon at 2 pixels per degree, -180..180."""
    path = tmp_path_factory.mktemp("albedo") / "waves.tif"
    return AlbedoMap.open(cylinder(path, -180.0, 90.0, (360, 720), 2.0, waves))


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A DEM of the whole Moon, 300 m above the sphere."""
    path = tmp_path_factory.mktemp("dem") / "ball.tif"
    return cylinder(path, 0.0, 90.0, (180, 360), 1.0, lambda lon, lat: np.full(lon.shape, 300.0))


def test_positions_of_values(moon: AlbedoMap) -> None:
    """A shift by half a pixel would be an error of 1.3e-3, a mirrored map one of 0.6."""
    rng = np.random.default_rng(3)
    lon, lat = rng.uniform(-180.0, 360.0, 4000), np.degrees(np.arcsin(rng.uniform(-1, 1, 4000)))
    for gsd_m in (50.0, 2e4):
        away = np.abs(lat) < 89.0  # a row of the last degree is a ring of a few cells
        error = moon.at(lon, lat, gsd_m) - waves(lon, lat) / moon.reference
        assert np.abs(error[away]).max() < 1e-4
    assert moon.reference == pytest.approx(1.0, abs=1e-6)


def test_it_is_continuous_over_the_antimeridian_and_the_poles(moon: AlbedoMap) -> None:
    lat = np.linspace(-80.0, 80.0, 33)
    for lon in (-180.0, 179.9, 180.0, 180.1, 539.9):
        np.testing.assert_allclose(moon.at(lon, lat, 10.0), waves(lon, lat), atol=1e-4)
    lon = np.arange(0.0, 360.0, 7.0)
    for lat_deg in (90.0, 89.9, -89.9, -90.0):
        assert np.isfinite(moon.at(lon, lat_deg, 10.0)).all()
        np.testing.assert_allclose(moon.at(lon, lat_deg, 10.0), waves(lon, lat_deg), atol=3e-4)


@settings(max_examples=50, deadline=None)
@given(st.floats(-180, 180), st.floats(-90, 90), st.floats(10, 3e5), st.integers(-1, 1), st.data())
def test_a_value_does_not_depend_on_the_other_places(
    moon: AlbedoMap, lon: float, lat: float, gsd_m: float, turns: int, data: st.DataObject
) -> None:
    others = data.draw(st.lists(st.tuples(st.floats(-180, 180), st.floats(-90, 90)), max_size=5))
    alone = float(moon.at(lon, lat, gsd_m))
    among = moon.at(
        np.array([o for o, _ in others] + [lon]), np.array([a for _, a in others] + [lat]), gsd_m
    )
    assert among[-1] == alone
    assert moon.at(lon + 360.0 * turns, lat, gsd_m) == pytest.approx(alone, abs=1e-6)
    assert pickle.loads(pickle.dumps(moon)).at(lon, lat, gsd_m) == alone


@pytest.mark.parametrize(("lon", "lat"), [(0.0, 0.0), (180.0, 60.0), (-77.0, -85.0)])
def test_nodes_and_hits_of_a_terrain(moon: AlbedoMap, ball: Path, lon: float, lat: float) -> None:
    """Compared with PROJ's orthographic plane on the raised sphere, which exposes an exchange of
    directions.
    """
    terrain = terrain_from_area(DemSet.open([ball]), Area(lon, lat, 120.0), 5000.0)
    x, y = _nodes(terrain)
    ortho = f"+proj=ortho +lat_0={lat} +lon_0={lon} +R={MOON_RADIUS_M + 300.0} +units=m"
    at = pyproj.Transformer.from_crs(ortho, f"+proj=longlat +R={MOON_RADIUS_M + 300.0}", always_xy=True)  # fmt: skip
    want = waves(*at.transform(x, y))
    np.testing.assert_allclose(moon.at_nodes(terrain), want, atol=1e-4)
    assert np.ptp(want) > 5e-3  # not constant
    row0, row1, col0, col1 = terrain.core
    z = terrain.field.z_m[row0:row1, col0:col1]
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    np.testing.assert_allclose(moon.at_points(terrain, points), want.ravel(), atol=1e-4)
    flat = np.zeros((2, 5, 5), np.float32)
    near, patch = moon.patches([EnuFrame(lon, 10.0), EnuFrame(lon, lat, 300.0)], flat, 20e3)
    assert (near != patch).any()
    step = np.arange(-2, 3) * 20e3
    mcmf = EnuFrame(lon, lat, 300.0).to_mcmf(np.stack([*np.meshgrid(step, -step), np.zeros((5, 5))], axis=-1))  # fmt: skip
    unit = mcmf / np.linalg.norm(mcmf, axis=-1, keepdims=True)
    want = 1.0 + 0.3 * unit[..., 1] + 0.1 * unit[..., 2]
    np.testing.assert_allclose(patch, want, atol=1e-4 + PATCH_STEP / 2.0)
    assert np.all(patch % PATCH_STEP == 0.0)


def _nodes(terrain: Terrain) -> tuple[np.ndarray, np.ndarray]:
    row0, row1, col0, col1 = terrain.core
    field = terrain.field
    x = field.x0_m + np.arange(col0, col1) * field.gsd_m
    y = field.y0_m - np.arange(row0, row1) * field.gsd_m
    east, north = np.meshgrid(x, y)
    return east, north


def test_between_pixels_it_is_what_gdal_makes(tmp_path: Path) -> None:
    """A polar map of noise, warped by GDAL (cubic) to a cylinder with half its pixel size; GDAL's
    positions are within 1e-4 pixel.
    """
    rng = np.random.default_rng(5)
    values = rng.uniform(0.5, 1.5, (120, 120))
    path = geotiff(tmp_path / "south.tif", values, -60e3, 60e3, 1000.0, crs=SOUTH)
    found = AlbedoMap.open(path, reference=1.0)
    warped, where = np.full((40, 60), np.nan), rasterio.transform.from_origin(40.0, -88.8, 0.005, 0.005)  # fmt: skip
    rasterio.warp.reproject(
        values,
        warped,
        src_transform=rasterio.transform.from_origin(-60e3, 60e3, 1000.0, 1000.0),
        src_crs=SOUTH,
        dst_transform=where,
        dst_crs=SPHERE,
        resampling=Resampling.cubic,
        tolerance=0.0,
    )
    lon, lat = np.meshgrid(40.0 + 0.005 * (np.arange(60) + 0.5), -88.8 - 0.005 * (np.arange(40) + 0.5))  # fmt: skip
    np.testing.assert_allclose(found.at(lon, lat, 100.0), warped, atol=2e-4)


def test_a_coarser_cell_is_the_mean_over_its_ground(tmp_path: Path) -> None:
    """Noise in pixels of half a degree: at the centre of a block of 3 x 3 the factor is the block's
    mean by area.
    """
    values = np.random.default_rng(7).uniform(0.2, 2.0, (360, 720))
    path = geotiff(tmp_path / "noise.tif", values, -180 * DEGREE_M, 90 * DEGREE_M, DEGREE_M / 2)
    found = AlbedoMap.open(path, reference=2.0)
    rows, cols = np.arange(40, 80) * 3, np.arange(0, 240) * 3  # 30 N .. 30 S
    weight = np.cos(np.radians(90.0 - (np.arange(360) + 0.5) / 2))[:, None]
    total = (weight * values).reshape(120, 3, 240, 3).sum(axis=(1, 3))
    mean = total / (3 * weight.reshape(120, 3).sum(axis=1)[:, None])
    lat, lon = 90.0 - (rows + 1.5) / 2, -180.0 + (cols + 1.5) / 2
    got = found.at(*np.meshgrid(lon, lat), 3 * DEGREE_M / 2)
    np.testing.assert_allclose(got, mean[40:80] / 2.0, rtol=3e-7)


def test_small_factors_are_not_rounded_away_near_a_pole(tmp_path: Path) -> None:
    """Near a pole, pixels are averaged along their rows in integer steps, which must be fine
    compared with any factor.
    """
    path = geotiff(tmp_path / "one.tif", np.full((360, 720), 1.0), -180 * DEGREE_M, 90 * DEGREE_M, DEGREE_M / 2)  # fmt: skip
    found = AlbedoMap.open(path, reference=3.0)
    got = found.at(np.arange(0.0, 360.0, 11.0), 86.0, DEGREE_M)
    np.testing.assert_allclose(got, 1.0 / 3.0, rtol=1e-6)


class TestReference:
    def test_it_is_the_mean_over_the_ground(self, tmp_path: Path) -> None:
        """sin^2 of the latitude has the mean 1/3 over the sphere, and 1/2 over the pixels of a
        cylinder.
        """
        path = cylinder(
            tmp_path / "m.tif", 0, 90, (360, 720), 2, lambda lon, lat: np.sin(np.radians(lat)) ** 2
        )
        found = AlbedoMap.open(path)
        assert found.reference == pytest.approx(1.0 / 3.0, rel=1e-4)
        assert found.at(10.0, 45.0, 1.0) == pytest.approx(1.5, rel=1e-3)
        assert found.describe()["reference_is"] == "mean of the map"

    def test_on_a_polar_map_too(self, tmp_path: Path) -> None:
        """Mean of the colatitude over a square of a stereographic map, compared with a fine sum
        over the sphere.
        """
        size, pixel = 60, 40e3
        edge = size * pixel / 2
        centre = (np.arange(size) + 0.5) * pixel - edge
        x, y = np.meshgrid(centre, -centre)
        _, lat = pyproj.Transformer.from_crs(SOUTH, SPHERE, always_xy=True).transform(x, y)
        path = geotiff(tmp_path / "s.tif", np.asarray(90.0 + lat), -edge, edge, pixel, crs=SOUTH)
        z = np.linspace(-1.0, -0.5, 1200)
        lons, z = np.meshgrid(np.linspace(-180, 180, 900, endpoint=False), 0.5 * (z[1:] + z[:-1]))
        lats = np.degrees(np.arcsin(z))
        px, py = pyproj.Transformer.from_crs(SPHERE, SOUTH, always_xy=True).transform(lons, lats)
        inside = (np.abs(px) < edge) & (np.abs(py) < edge)
        want = (90.0 + lats[inside]).mean()
        assert AlbedoMap.open(path).reference == pytest.approx(want, rel=1e-3)
        flat = float(np.asarray(90.0 + lat).mean())
        assert abs(flat / want - 1.0) > 0.02  # an unweighted mean fails

    @pytest.mark.parametrize("pixels", [1, 700, 10**9])
    def test_it_does_not_depend_on_the_strips(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pixels: int
    ) -> None:
        """Blocks of 16 x 16 of a map that does not fill them and covers more than one turn; a
        repeated column counts once.
        """
        monkeypatch.setattr(raster, "_WINDOW_PIXELS", pixels)
        values = np.random.default_rng(1).uniform(0.0, 1.0, (37, 53))
        values[3, 4:9] = np.nan
        weight = np.cos(np.radians(20.0 - (np.arange(37) + 0.5)))[:, None] * np.isfinite(values)
        path = _tiled(tmp_path / "part.tif", values, 1.0, 10.0, 20.0)
        want = np.nansum(weight * values) / weight.sum()
        assert AlbedoMap.open(path).reference == pytest.approx(want, rel=1e-12)
        around = np.ones((36, 74))
        around[:, 0] = around[:, 72] = 5.0
        around[:, 1] = around[:, 73] = 3.0
        path = _tiled(tmp_path / "more.tif", around, 5.0, 0.0, 90.0)
        assert AlbedoMap.open(path).reference == pytest.approx((70 + 5 + 3) / 72.0, rel=1e-12)

    def test_a_stated_one_is_taken(self, tmp_path: Path) -> None:
        path = cylinder(tmp_path / "m.tif", 0, 10, (20, 20), 2, lambda lon, lat: 0.0 * lon + 0.5)
        found = AlbedoMap.open(path, reference=0.25)
        assert found.at(5.0, 5.0, 100.0) == 2.0
        assert found.describe()["reference_is"] == "stated"
        assert AlbedoMap.open(path).at(5.0, 5.0, 100.0) == 1.0


def _tiled(path: Path, values: np.ndarray, pixel_deg: float, west: float, north: float) -> Path:
    corner = west * DEGREE_M, north * DEGREE_M
    where = rasterio.transform.from_origin(*corner, *[pixel_deg * DEGREE_M] * 2)
    kind: dict[str, Any] = {"driver": "GTiff", "count": 1, "dtype": "float64", "crs": EQC}
    kind |= {"tiled": True, "blockxsize": 16, "blockysize": 16, "transform": where}
    with rasterio.open(path, "w", height=values.shape[0], width=values.shape[1], **kind) as file:
        file.write(values, 1)
    return path


class TestCover:
    @pytest.fixture
    def half(self, tmp_path: Path) -> AlbedoMap:
        """East of 30 E only: 1 north of the equator, 3 south of it."""

        def value(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
            return np.where(lat > 0, 1.0, 3.0)

        path = cylinder(tmp_path / "half.tif", 30.0, 10.0, (200, 100), 10.0, value)
        return AlbedoMap.open(path, reference=1.0)

    def test_share_and_contrast_of_an_area(
        self, half: AlbedoMap, ball: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        terrain = terrain_from_area(DemSet.open([ball]), Area(30.0, 0.0, 200.0), 1000.0)
        for cover in (half.cover(terrain), half.cover_of(Area(30.0, 0.0, 200.0), 1000.0)):
            assert cover.share == pytest.approx(0.5, abs=0.01)
            assert (cover.lowest, cover.highest) == pytest.approx((1.0, 3.0), abs=0.3)
            assert cover.contrast == pytest.approx(0.5, abs=0.01)  # 1 and 3: mean 2, spread 1
        half.check_cover(half.cover(terrain), "here")
        assert "does not cover 50 % of the area; the factor is 1 there" in caplog.text
        assert (half.at_nodes(terrain)[:, :95] == 1.0).all()
        assert np.isnan(half.known_nodes(terrain)[:, :95]).all()

    def test_nothing_covered_is_refused(self, half: AlbedoMap, ball: Path) -> None:
        terrain = terrain_from_area(DemSet.open([ball]), Area(20.0, 0.0, 200.0), 5000.0)
        with pytest.raises(AlbedoError, match=r"does not cover the area \(here\); it covers longitude 30\.\.40"):  # fmt: skip
            half.check_cover(half.cover(terrain), "here")
        with pytest.raises(AlbedoError, match="is 0 everywhere"):
            half.check_cover(AlbedoCover(1.0, 0.0, 0.0, 0.0), "here")

    def test_full_coverage_gives_no_warning(
        self, moon: AlbedoMap, caplog: pytest.LogCaptureFixture
    ) -> None:
        for area in (Area(180.0, 10.0, 500.0), Area(0.0, -90.0, 500.0), Area.from_bounds(170, 60, -170, 80)):  # fmt: skip
            assert moon.check_cover(moon.cover_of(area, 1e4), area.bounds).share == 1.0
        assert caplog.text == ""


def test_a_virtual_raster_names_what_it_reads(tmp_path: Path) -> None:
    """A VRT of two tiles is one map, and its files include the tiles."""
    for name, west in (("a", 0.0), ("b", 4.0)):
        cylinder(tmp_path / f"{name}.tif", west, 10.0, (8, 8), 2.0, waves)
    source = "".join(
        f"<SimpleSource><SourceFilename relativeToVRT='1'>{name}.tif</SourceFilename><SourceBand>1</SourceBand>"
        f"<SrcRect xOff='0' yOff='0' xSize='8' ySize='8'/><DstRect xOff='{at}' yOff='0' xSize='8' ySize='8'/></SimpleSource>"
        for name, at in (("a", 0), ("b", 8))
    )
    size = float(DEGREE_M / 2)
    path = tmp_path / "both.vrt"
    path.write_text(
        f"<VRTDataset rasterXSize='16' rasterYSize='8'><SRS>{EQC}</SRS>"
        f"<GeoTransform>0,{size!r},0,{20 * size!r},0,{-size!r}</GeoTransform>"
        f"<VRTRasterBand dataType='Float64' band='1'>{source}</VRTRasterBand></VRTDataset>"
    )
    found = AlbedoMap.open(path, reference=1.0)
    assert [file.name for file in found.files] == ["both.vrt", "a.tif", "b.tif"]
    assert {file["name"] for file in found.provenance()["files"]} == {"both.vrt", "a.tif", "b.tif"}
    lon = np.linspace(1.0, 7.0, 60)
    np.testing.assert_allclose(found.at(lon, 8.0, 10.0), waves(lon, 8.0), atol=1e-4)


def test_a_map_in_degrees(tmp_path: Path) -> None:
    """The same pixels with a geographic CRS."""
    lon, lat = np.meshgrid(-180 + (np.arange(720) + 0.5) / 2, 90 - (np.arange(360) + 0.5) / 2)
    path = geotiff(tmp_path / "deg.tif", waves(lon, lat), -180.0, 90.0, 0.5, crs=SPHERE)
    places = np.array([-179.99, -33.3, 12.3, 179.9])
    np.testing.assert_allclose(AlbedoMap.open(path).at(places, 51.2, 10.0), waves(places, 51.2), atol=1e-4)  # fmt: skip


def test_maria_are_dark_and_highlands_bright(shared_data: Path) -> None:
    """A real map of unverified licence, for development only. Boxes well inside each region."""
    path = shared_data / "albedo" / "relative_albedo_11ppd.tif"
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the shared data")
    found = AlbedoMap.open(path)

    def mean(west: float, east: float, south: float, north: float) -> float:
        lon, lat = np.meshgrid(np.linspace(west, east, 40), np.linspace(south, north, 40))
        return float(found.at(lon, lat, 3000.0).mean())

    imbrium, serenitatis = mean(-25, -10, 30, 42), mean(14, 22, 23, 32)
    procellarum = mean(-60, -50, 10, 20)
    central, far = mean(0, 15, -30, -15), mean(150, 180, 0, 20)
    assert max(imbrium, serenitatis, procellarum) < 0.65
    assert min(central, far) > 0.9
    assert float(found.at(-47.49, 23.73, 3000.0)) > 1.5  # Aristarchus, in the middle of Procellarum
    assert float(found.at(47.49, 23.73, 3000.0)) < 1.3  # its mirror image


def test_its_pickle_is_small(moon: AlbedoMap) -> None:
    moon.at(0.0, 0.0, 1e5)
    assert len(pickle.dumps(moon)) < 20_000
    assert pickle.loads(pickle.dumps(moon)) == moon
    assert dataclasses.replace(moon, reference=2.0) != moon


def test_its_bounds_are_the_maps(moon: AlbedoMap) -> None:
    assert tuple(moon.bounds) == pytest.approx((-180.0, -90.0, 180.0, 90.0))
