"""One catalogue over products that meet: across 75 N (a cylinder and a polar map) and around the pole (two polar maps)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers import transplanted
from lcp_cli.main import run

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.schema import PACKED
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import lonlat_to_mcmf
from lcp_catalog.production.areas import AreaGrid
from lcp_catalog.production.merging import merge_catalogs
from lcp_catalog.production.model_config import ModelConfig

pytestmark = pytest.mark.slow  # products of 60 to 150 MB and five builds: four minutes

GSD_M = 120.0
VIEWS = ["--view", "0", "--view", "30:90", "--view", "30:270"]
AT_75 = ["--sun-azimuths", "90:270:30", "--sun-elevations", "5,10,15"]
AT_90 = ["--sun-azimuths", "0:330:30", "--sun-elevations", "0.6,1.2,1.8"]


def build(out: Path, labels: list[Path], *area: object, suns: list[str]) -> Catalog:
    """By one command, as a user would. Both products get the error that is published for one of them (LDEM_512: 10 m):
    which of two products serves a place is asked here, not what the error of the other is.
    """
    config = out.with_suffix(".toml")
    config.write_text("[errors]\nheight_sigma_m = 10.0\n")
    words = [
        "build-catalog",
        *labels,
        "-o",
        out,
        "--config",
        config,
        *area,
        "--gsd",
        GSD_M,
        "--jobs",
        2,
        *VIEWS,
        *suns,
        "--per-view",
        0,
    ]
    assert run([str(word) for word in words]) == 0
    return open_catalog(out)


@pytest.fixture(scope="module")
def at_75(tmp_path_factory) -> list[Path]:
    return transplanted.across_75n(tmp_path_factory.mktemp("across"))


@pytest.fixture(scope="module")
def straddling(at_75, tmp_path_factory) -> Catalog:
    out = tmp_path_factory.mktemp("straddling") / "c.h5"
    return build(out, at_75, "--center", 40, 75, "--size", 80, suns=AT_75)


@pytest.fixture(scope="module")
def polar(tmp_path_factory) -> Catalog:
    folder = tmp_path_factory.mktemp("pole")
    labels = transplanted.at_the_pole(folder, inner_m=14e3, outer_m=60e3)
    return build(folder / "c.h5", labels, "--center", 0, 90, "--size", 48, suns=AT_90)


def served(catalog: Catalog, here: np.ndarray) -> float:
    """Share of the spacing cells ``here`` that have a point within a spacing."""
    assert here.sum() >= 4
    return float((catalog.coverage.status[here] == 0).mean())


def apart_m(one: Catalog, other: Catalog) -> np.ndarray:
    """Distances on the sphere (n, m) between the points of two catalogues."""
    a, b = (lonlat_to_mcmf(c.longitude, c.latitude) / MOON_RADIUS_M for c in (one, other))
    return MOON_RADIUS_M * np.linalg.norm(a[:, None] - b[None], axis=-1)


def test_points_are_as_dense_at_75_n_as_elsewhere(straddling) -> None:
    lat = straddling.coverage.latitude
    at_seam = np.abs(lat - 75.0) < 0.25
    assert served(straddling, at_seam) > 0.85
    assert served(straddling, ~at_seam) > 0.85
    counts = np.histogram(straddling.latitude, np.arange(73.8, 76.3, 0.4))[0]
    assert counts.min() > 0.5 * counts.mean()
    products = straddling.dem_product
    assert set(products) == {"LDEM_512", "LDEM_75N_30M"}
    assert (straddling.latitude[products == "LDEM_512"] < 75.05).all()
    assert (straddling.latitude[products == "LDEM_75N_30M"] > 74.95).all()


def test_no_point_stands_twice(straddling, polar) -> None:
    for catalog in (straddling, polar):
        apart = apart_m(catalog, catalog)
        np.fill_diagonal(apart, np.inf)
        assert apart.min() > 0.9 * catalog.coverage.spacing_m
        assert len(set(catalog.point_id)) == len(catalog)


SOUTH, NORTH = (35.0, 74.2, 45.0, 75.2), (35.0, 74.45, 45.0, 75.8)
"""Regions (west, south, east, north) that share the row of areas around the seam: 74.47 to 75.18 N."""
SHARED = (35.1, 74.45, 44.9, 75.2)
"""Within both of them and the square of `straddling`."""


def in_whole_areas(catalog: Catalog) -> np.ndarray:
    """True (n,) for points in areas that no border of the three regions cuts."""
    grid = AreaGrid.for_cell(GSD_M, ModelConfig())
    west, south, east, north = SHARED
    areas = np.transpose(grid.owner(catalog.longitude, catalog.latitude)).tolist()
    boxes = [grid.box(*area) for area in areas]
    return np.array(
        [west < b.west and south < b.south and b.east < east and b.north < north for b in boxes]
    )


def test_the_same_point_from_either_side_has_the_same_id(at_75, straddling, tmp_path) -> None:
    """Catalogues of the regions south and north of the seam, and of both. Corners are measured by the strongest ones of
    an area's part of the region. In an area that a border cuts one may be found a cell or two away, whatever is claimed
    (5 of 348 candidates farther than 2 km from the borders, found for regions 5 km smaller): it has another id. Points in
    whole areas have the same claims, although one product has the larger part of the south and the other of the north.
    """
    south, north = (
        build(tmp_path / f"{k}.h5", at_75, "--bounds", *b, suns=AT_75)
        for k, b in (("s", SOUTH), ("n", NORTH))
    )
    for one, other in ((south, north), (south, straddling), (north, straddling)):
        row, column = np.nonzero(apart_m(one, other) < 2 * GSD_M)
        same = apart_m(one, other)[row, column] < 1.0
        whole = in_whole_areas(one)[row]
        assert whole.sum() >= 10
        assert same[whole].all()
        np.testing.assert_array_equal(one.point_id[row] == other.point_id[column], same)
        assert set(one.dem_product[row[whole]]) == {"LDEM_512", "LDEM_75N_30M"}
        row, column = row[whole & same], column[whole & same]
        for name in PACKED:
            mine, theirs = (np.asarray(getattr(c, name)) for c in (one, other))
            np.testing.assert_array_equal(mine[row], theirs[column])
        np.testing.assert_array_equal(one.place_sigma_m(row), other.place_sigma_m(column))
    # the regions' medians differ, and do not keep the catalogues apart
    assert south.errors["position_sigma_m"] != north.errors["position_sigma_m"]
    assert merge_catalogs([tmp_path / "s.h5", tmp_path / "n.h5"], tmp_path / "m.h5").doubles > 0
    assert set(open_catalog(tmp_path / "m.h5").errors["by_place"]) == {
        "height_length_m",
        "position_sigma_m",
    }


def test_the_seam_is_not_seen(at_75, tmp_path) -> None:
    """3 m of height between the products, across 0.03 deg of latitude: at most a tenth of the contrast of the terrain."""
    radiance = {}
    for name, labels in (("set", at_75), ("one", at_75[1:])):
        out = tmp_path / f"{name}.tif"
        flags = [
            "--center",
            "40",
            "75",
            "--size",
            "24",
            "--gsd",
            "60",
            "--sun-azimuth",
            "170",
            "--sun-elevation",
            "6",
        ]
        assert run(["render", *map(str, labels), "-o", str(out), *flags]) == 0
        with rasterio.open(out) as dataset:
            radiance[name] = np.where(dataset.read(2) > 0, dataset.read(1), np.nan)
    change = radiance["set"] - radiance["one"]
    rows = np.sqrt(np.nanmean(change**2, axis=1)) / np.nanstd(radiance["one"], axis=1)
    assert 0.0 < rows.max() < 0.15
    assert np.nanmax(rows[:150]) < 1e-6  # the polar product alone


def test_the_pole_is_covered(polar) -> None:
    """Cells around the pole, beside and across the inner product's edge, 14 km away, have points alike."""
    away_m = np.radians(90.0 - polar.coverage.latitude) * MOON_RADIUS_M
    assert served(polar, away_m < 9e3) > 0.6
    assert served(polar, (away_m > 9e3) & (away_m < 19e3)) > 0.6
    assert served(polar, away_m > 19e3) > 0.6
    products = polar.dem_product
    assert set(products) == {"LDEM_80N_20M", "LDEM_85N_10M"}
    lon = polar.longitude[np.radians(90.0 - polar.latitude) * MOON_RADIUS_M < 24e3]
    assert np.histogram(lon, 4, (0.0, 360.0))[0].min() >= 1  # on all sides
