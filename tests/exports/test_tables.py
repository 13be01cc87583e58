"""Tables of points, read by the csv module, pyarrow and pandas, and ASP's ground control."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import geopandas
import numpy as np
import pandas
import pyarrow.parquet
import pyproj
import pytest
from helpers import catalogs

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.exports.frames import frame_named
from lcp_catalog.exports.points import ExportedPoints
from lcp_catalog.exports.tables import write_csv, write_gcp, write_parquet
from lcp_catalog.geometry.bounds import Bounds

SPHERE = pyproj.Transformer.from_crs(
    {"proj": "longlat", "R": 1737400}, {"proj": "geocent", "R": 1737400}, always_xy=True
)


@pytest.fixture(scope="module")
def catalog():
    return catalogs.catalog(12)


def points_of(catalog, frame: str = "MOON_ME", **choice) -> ExportedPoints:
    return ExportedPoints.chosen(catalog, frame_named(frame), **choice)


@pytest.mark.parametrize("frame", ["MOON_ME", "MOON_PA"])
def test_csv_holds_the_points(catalog, frame: str, tmp_path: Path) -> None:
    write_csv(points_of(catalog, frame), tmp_path / "p.csv")
    with (tmp_path / "p.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["point_id"]) for row in rows] == catalog.point_id.tolist()
    assert {row["frame"] for row in rows} == {frame}
    assert [row["elevation_sigma_m"] for row in rows[:4]] == ["", "20.0", "20.0", ""]  # NaN: empty
    place = np.array([[float(row[name]) for name in ("x_m", "y_m", "z_m")] for row in rows])
    moved = np.linalg.norm(place - catalog.position_mcmf, axis=1)
    assert (moved == 0.0).all() if frame == "MOON_ME" else (moved > 300.0).all()
    lon, lat, up = (
        [float(row[name]) for row in rows]
        for name in ("longitude_deg", "latitude_deg", "elevation_m")
    )
    expected = np.stack(SPHERE.transform(lon, lat, up), axis=-1)
    np.testing.assert_allclose(place, expected, atol=1e-6)


def test_usable_share_is_counted_over_evaluated_conditions(catalog, tmp_path: Path) -> None:
    write_csv(points_of(catalog), tmp_path / "p.csv")
    with (tmp_path / "p.csv").open(newline="") as file:
        shares = [float(row["usable_share"]) for row in csv.DictReader(file)]
    flags = catalog.condition.reshape(12, -1)
    expected = [(own == 31).sum() / (own & 1).sum() for own in flags]
    np.testing.assert_allclose(shares, expected)


def test_parquet_has_units_and_the_frame(catalog, tmp_path: Path) -> None:
    write_parquet(points_of(catalog, "MOON_PA"), tmp_path / "p.parquet")
    table = pyarrow.parquet.read_table(tmp_path / "p.parquet")
    assert table.schema.metadata[b"frame"] == b"MOON_PA"
    units = {f.name: f.metadata[b"units"].decode() for f in table.schema if f.metadata}
    assert units["longitude_deg"] == "degree"
    assert units["gsd_min_m"] == units["x_m"] == "m"
    assert units["usable_share"] == "1"
    assert table.schema.field("point_id").type == "int64"
    frame = pandas.read_parquet(tmp_path / "p.parquet")
    assert frame.shape == (12, len(units) + 1)
    np.testing.assert_array_equal(frame["elevation_sigma_m"].isna(), np.arange(12) % 3 == 0)
    np.testing.assert_array_equal(frame["harris_response"], catalog.harris_response)


def test_parquet_is_a_map(catalog, tmp_path: Path) -> None:
    """GeoPandas and GDAL read GeoParquet: places, heights, and the Moon's CRS."""
    write_parquet(points_of(catalog), tmp_path / "p.parquet")
    found = geopandas.read_parquet(tmp_path / "p.parquet")
    places = found.geometry.get_coordinates(include_z=True)
    np.testing.assert_array_equal(places["x"], found["longitude_deg"])
    np.testing.assert_array_equal(places["y"], found["latitude_deg"])
    np.testing.assert_array_equal(places["z"], found["elevation_m"])
    assert found.crs.to_authority() == ("IAU_2015", "30100")
    assert found.crs.ellipsoid.semi_major_metre == MOON_RADIUS_M
    west, south, east, north = found.total_bounds
    geo = json.loads(pyarrow.parquet.read_schema(tmp_path / "p.parquet").metadata[b"geo"])
    bbox = geo["columns"]["geometry"]["bbox"]
    assert [bbox[k] for k in (0, 1, 3, 4)] == [west, south, east, north]


def test_a_box_and_a_level_choose_points(catalog, tmp_path: Path) -> None:
    lon, lat = catalog.longitude[3], catalog.latitude[3]
    box = Bounds(lon - 0.01, lat - 0.01, lon + 0.01, lat + 0.01)
    assert points_of(catalog, box=box).point_id.tolist() == [catalog.point_id[3]]
    assert len(points_of(catalog, level=0)) == 12
    with pytest.raises(ValueError, match="no points of level 1"):
        points_of(catalog, level=1)
    with pytest.raises(ValueError, match=r"no points within longitude 90\.\.91"):
        points_of(catalog, box=Bounds(90.0, 0.0, 91.0, 1.0))


@pytest.mark.parametrize("frame", ["MOON_ME", "MOON_PA"])
def test_ground_control_as_asp_reads_it(catalog, frame: str, tmp_path: Path) -> None:
    """Fields by `add_ground_control_points` of the Vision Workbench: a 32-bit number, latitude, longitude,
    height, three positive sigmas; a first comment with the datum.
    """
    points = points_of(catalog, frame)
    write_gcp(points, tmp_path / "p.gcp")
    first, *lines = (tmp_path / "p.gcp").read_text().splitlines()
    datum = pyproj.CRS.from_wkt(first.removeprefix("# WKT: "))
    assert datum.ellipsoid.semi_major_metre == datum.ellipsoid.semi_minor_metre == 1737400.0
    assert frame in datum.name
    rows = [line.split() for line in lines if not line.startswith("#")]
    named = [line.split()[-1] for line in lines if "point_id" in line]
    assert named == [str(one) for one in catalog.point_id]
    assert [int(row[0]) for row in rows] == list(range(1, 13))
    lat, lon, up, *sigmas = np.array([[float(word) for word in row[1:]] for row in rows]).T
    place = np.stack(SPHERE.transform(lon, lat, up), axis=-1)
    np.testing.assert_allclose(place, points.position_m, atol=1e-3)
    np.testing.assert_array_equal(sigmas[0], catalogs.GSD_M)  # the errors state no place
    expected = np.where(np.arange(12) % 3 == 0, catalogs.GSD_M, 20.0)
    np.testing.assert_array_equal(sigmas[2], expected)


@pytest.mark.parametrize(
    "place", [{"position_sigma_m": 25.0}, {"position_sigma_cells": 25.0 / catalogs.GSD_M}]
)
def test_the_place_error_of_the_claims_is_the_horizontal_sigma(
    place: dict[str, float], tmp_path: Path
) -> None:
    stated = catalogs.ERRORS | place
    write_gcp(points_of(catalogs.catalog(4, errors=stated)), tmp_path / "p.gcp")
    text = (tmp_path / "p.gcp").read_text().splitlines()
    rows = [line.split() for line in text if not line.startswith("#")]
    assert {(row[4], row[5]) for row in rows} == {("25.000", "25.000")}
