"""GeoPackage and GeoJSON, read by GDAL."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from pathlib import Path

import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from helpers import catalogs

from lcp_catalog.exports.frames import frame_named
from lcp_catalog.exports.points import ExportedPoints
from lcp_catalog.exports.vectors import outline, write_geojson, write_geopackage

GEOCENTRIC = pyproj.Transformer.from_crs(
    {"proj": "geocent", "R": 1737400}, {"proj": "longlat", "R": 1737400}, always_xy=True
)


@pytest.fixture(scope="module")
def catalog():
    return catalogs.catalog(12)


@pytest.fixture(scope="module", params=["MOON_ME", "MOON_PA"])
def written(request, catalog, tmp_path_factory) -> tuple[ExportedPoints, Path]:
    points = ExportedPoints.chosen(catalog, frame_named(request.param))
    path = tmp_path_factory.mktemp("vectors") / "c.gpkg"
    write_geopackage(points, path)
    write_geojson(points, path.with_suffix(".geojson"))
    return points, path


def read(path: Path, layer: str | None = None) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    about, _, shapes, values = pyogrio.raw.read(path, layer=layer)
    return shapely.from_wkb(shapes), dict(zip(about["fields"], values, strict=True))


def test_layers_crs_and_frame(written) -> None:
    points, path = written
    assert pyogrio.list_layers(path)[:, 0].tolist() == ["points", "footprints", "coverage"]
    counts = {"points": 12, "footprints": 12, "coverage": len(points.catalog.coverage.status)}
    for layer, count in counts.items():
        info = pyogrio.read_info(path, layer=layer)
        crs = pyproj.CRS.from_wkt(info["crs"])
        assert crs.ellipsoid.semi_major_metre == crs.ellipsoid.semi_minor_metre == 1737400.0
        assert ("principal axes" in crs.name) == (points.frame.name == "MOON_PA")
        assert info["features"] == count
        assert info["layer_metadata"]["frame"] == points.frame.name


def test_points_lie_where_the_catalogue_has_them(written) -> None:
    points, path = written
    for shapes, fields in (read(path, "points"), _part(path.with_suffix(".geojson"), "points")):
        lon, lat, up = GEOCENTRIC.transform(*points.position_m.T)
        np.testing.assert_allclose(
            shapely.get_coordinates(shapes, include_z=True),
            np.stack([lon, lat, up], axis=-1),
            rtol=0,
            atol=1e-6,
        )
        assert fields["point_id"].tolist() == points.catalog.point_id.tolist()
        assert set(fields["frame"]) == {points.frame.name}


def test_footprints_reach_to_the_corner_nodes(written) -> None:
    """The corners by the formula of the format's page, and the area of the patch."""
    points, path = written
    shapes, _ = read(path, "footprints")
    catalog, half = points.catalog, points.half
    for k, shape in enumerate(shapes):
        ring = shapely.get_coordinates(shape)
        for row, col in ((-half, -half), (-half, half), (half, -half), (half, half)):
            up = catalog.dem[k, row + half, col + half]
            own = np.array([col * catalogs.GSD_M, -row * catalogs.GSD_M, up])
            place = catalog.position_mcmf[k] + catalog.rotation_mcmf_to_enu[k].T @ own
            lon, lat, _ = GEOCENTRIC.transform(*(points.frame.from_me @ place))
            assert np.abs(ring - [lon, lat]).sum(axis=1).min() < 1e-9
        lon, lat = points.lonlat_deg[0][k], points.lonlat_deg[1][k]
        metre = np.radians(1.0) * 1737400.0
        area = shape.area * metre**2 * np.cos(np.radians(lat))
        assert area == pytest.approx((2 * half * catalogs.GSD_M) ** 2, rel=5e-3)
        assert shape.contains(shapely.Point(lon, lat))
        assert shapely.is_ccw(shape.geoms[0].exterior)


def test_coverage_has_its_reasons(written) -> None:
    points, path = written
    shapes, fields = read(path, "coverage")
    names = np.array(["point", "featureless", "ambiguous", "dependent", "nodata"])
    coverage = points.catalog.coverage
    assert fields["status"].tolist() == names[coverage.status].tolist()
    away = shapely.get_coordinates(shapes) - np.stack([coverage.longitude, coverage.latitude], -1)
    assert np.abs(away).max() < (1e-12 if points.frame.name == "MOON_ME" else 0.04)


def test_equal_catalogues_give_equal_bytes(written, tmp_path: Path) -> None:
    points, path = written
    write_geopackage(points, tmp_path / "again.gpkg")
    assert (tmp_path / "again.gpkg").read_bytes() == path.read_bytes()


def test_a_package_names_the_authority_that_proj_knows(written) -> None:
    """Of the definition, too, which QGIS takes; GDAL writes IAU there, of which PROJ knows no code."""
    points, path = written
    with contextlib.closing(sqlite3.connect(path)) as tables:
        ((organization, definition),) = tables.execute(
            "SELECT organization, definition FROM gpkg_spatial_ref_sys WHERE definition LIKE '%Moon%'"
        )
    if points.frame.name == "MOON_ME":
        assert organization == "IAU_2015"
        assert pyproj.CRS.from_wkt(definition).to_authority() == ("IAU_2015", "30100")
    assert 'AUTHORITY["IAU",' not in definition


def _part(path: Path, layer: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    shapes, fields = read(path)
    own = fields["layer"] == layer
    return shapes[own], {name: values[own] for name, values in fields.items()}


def test_geojson_says_that_it_is_lunar(written) -> None:
    points, path = written
    path = path.with_suffix(".geojson")
    assert json.loads(path.read_text())["frame"].startswith(points.frame.name)
    crs = pyproj.CRS.from_wkt(pyogrio.read_info(path)["crs"])
    assert crs.ellipsoid.semi_major_metre == 1737400.0
    assert ("principal axes" in crs.name) == (points.frame.name == "MOON_PA")
    shapes, _ = _part(path, "footprints")
    assert shapely.equals(shapes, read(path.with_suffix(".gpkg"), "footprints")[0]).all()


def test_a_footprint_across_the_antimeridian_is_cut_there() -> None:
    lon, lat = np.array([179.0, 179.0, 181.0, 181.0]), np.array([1.0, -1.0, -1.0, 1.0])
    shape = shapely.MultiPolygon([shapely.Polygon(ring) for ring in outline(lon, lat)])
    assert shape.area == pytest.approx(4.0)
    assert [part.bounds for part in shape.geoms] == [
        (179.0, -1.0, 180.0, 1.0),
        (-180.0, -1.0, -179.0, 1.0),
    ]


def test_a_cut_footprint_is_that_of_shapely() -> None:
    """Convex rings of any place and size across the antimeridian, against GEOS' intersection with the map."""
    dice = np.random.default_rng(5)
    for _ in range(200):
        turn = np.sort(dice.uniform(0.0, 2.0 * np.pi, 12))
        ring = np.stack([180.0 + dice.uniform(0.1, 30.0) * np.cos(turn), 40.0 * np.sin(turn)], -1)
        ring[:, 0] += dice.uniform(-30.0, 30.0)
        whole = shapely.Polygon(ring)
        found = [shapely.Polygon(one) for one in outline(*ring[:: dice.choice([1, -1])].T)]
        assert all(shapely.is_ccw(one.exterior) for one in found)
        parts = [
            whole.intersection(shapely.box(x, -90.0, x + 360.0, 90.0)) for x in (-180.0, 180.0)
        ]
        moved = [shapely.transform(parts[1], lambda xy: xy - [360.0, 0.0]), parts[0]]
        other = shapely.union_all([one for one in moved if not one.is_empty])
        assert shapely.union_all(found).symmetric_difference(other).area < 1e-9


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_footprint_around_a_pole_reaches_the_pole(sign: float) -> None:
    lon = np.arange(10.0, 370.0, 45.0)[:: int(sign)]
    [ring] = outline(lon, np.full(8, sign * 89.0))
    shape = shapely.Polygon(ring)
    assert shape.area == pytest.approx(360.0)
    assert shape.bounds == (-180.0, min(sign * 89.0, sign * 90.0), 180.0, max(sign * 89.0, sign * 90.0))  # fmt: skip


@pytest.mark.parametrize("center", [(180.0, 5.0), (0.0, -90.0)])
def test_patches_at_the_edges_of_the_map(center, tmp_path: Path, monkeypatch) -> None:
    """Footprints across the antimeridian and around the pole have the area of their patches, and stay on
    the map.
    """
    monkeypatch.setattr(catalogs, "CENTER", center)
    catalog = catalogs.catalog(9, 33)
    points = ExportedPoints.chosen(catalog, frame_named("MOON_ME"))
    write_geopackage(points, tmp_path / "c.gpkg")
    write_geojson(points, tmp_path / "c.geojson")
    shapes, _ = read(tmp_path / "c.gpkg", "footprints")
    assert shapely.equals(shapes, _part(tmp_path / "c.geojson", "footprints")[0]).all()
    assert (np.abs(shapely.bounds(shapes)) <= 180.0).all()
    assert shapely.is_valid(shapes).all()
    cut = shapely.get_num_geometries(shapes) > 1
    crossing = np.ptp(shapely.bounds(shapes)[:, [0, 2]], axis=1) > 300.0
    assert crossing.any()
    assert (cut == crossing).all() or center[1] == -90.0
    plane = pyproj.Transformer.from_crs(
        {"proj": "longlat", "R": 1737400},
        {"proj": "laea", "R": 1737400, "lat_0": center[1], "lon_0": center[0]},
        always_xy=True,
    )
    side = 32 * catalogs.GSD_M
    for shape in shapely.segmentize(shapes, 1.0):
        flat = shapely.transform(shape, lambda xy: np.stack(plane.transform(*xy.T), axis=-1))
        assert abs(flat.area) == pytest.approx(side**2, rel=2e-2)
