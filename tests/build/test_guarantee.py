"""The promise of a catalogue: kept for cameras anywhere in the region under every Sun, by a count of its own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from helpers.small_build import CONFIG, DEM

from lcp_catalog.build.config import AreaConfig, SunConfig, ViewConfig
from lcp_catalog.build.run import Build, run_build
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.hdf5 import open_catalog, verify
from lcp_catalog.catalog.prediction import predict
from lcp_catalog.catalog.schema import NO_CELL, Cause
from lcp_catalog.constants import MOON_RADIUS_M

PROMISED = dataclasses.replace(
    CONFIG,
    area=AreaConfig(center_deg=(3.5, 26.0), size_km=40.0, gsd_m=474.0),
    sun=SunConfig((75.0, 90.0, 105.0, 255.0, 270.0, 285.0), (5.0, 10.0, 20.0)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
    points=dataclasses.replace(
        CONFIG.points, per_view=3, footprint_km=16.0, candidates_per_cell=12, search_m=4000.0
    ),
)


@pytest.fixture(scope="module")
def plan() -> Build:
    return Build.plan((DEM,), PROMISED)


@pytest.fixture(scope="module")
def built(plan: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("promise") / "promise.h5"
    run_build(plan, output)
    return output


@pytest.fixture(scope="module")
def catalog(built: Path) -> Catalog:
    return open_catalog(built)


def arcs_m(lon_deg: float, lat_deg: float, lons, lats) -> np.ndarray:
    """Distances on the sphere by the haversine formula."""
    lon, lat, lons, lats = (np.radians(a) for a in (lon_deg, lat_deg, lons, lats))
    half = (
        np.sin((lats - lat) / 2) ** 2 + np.cos(lat) * np.cos(lats) * np.sin((lons - lon) / 2) ** 2
    )
    return 2.0 * MOON_RADIUS_M * np.arcsin(np.sqrt(half))


def suns_that_happen(rng: np.random.Generator, lat_deg: np.ndarray) -> np.ndarray:
    """Elevations and azimuths (n, 2), degrees, of the grid's ranges; those that never occur at the
    latitude are NaN.
    """
    sun = rng.uniform((5.0, 75.0), (20.0, 285.0), (len(lat_deg), 2))
    (elevation, azimuth), lat = np.radians(sun.T), np.radians(lat_deg)
    sine = np.sin(lat) * np.sin(elevation) + np.cos(lat) * np.cos(elevation) * np.cos(azimuth)
    return np.where(np.abs(sine)[:, None] <= np.sin(np.radians(1.54)), sun, np.nan)


def test_every_camera_sees_what_its_place_is_promised(plan: Build, catalog: Catalog) -> None:
    """1000 cameras anywhere in the region under any Sun that can happen there: in the footprint lie at
    least as many points, usable by `predict`, as are stored for the nearest place, and where the
    cause is MET as many as are promised.
    """
    rng, told = np.random.default_rng(7), catalog.guarantee
    assert told is not None
    lon, lat = (np.tile(part, 4) for part in plan.region.lattice(101))
    sun = suns_that_happen(rng, lat)
    row, column = (
        np.searchsorted(grid, np.nan_to_num(part), side="right") - 1
        for grid, part in ((catalog.sun_elevation, sun[:, 0]), (catalog.sun_azimuth, sun[:, 1]))
    )
    place = arcs_m(lon[:, None], lat[:, None], told.longitude, told.latitude).argmin(axis=1)
    stored, cause = (a[place, 0, row, column] for a in (told.points, told.cause))
    some = np.flatnonzero(np.isfinite(sun[:, 0]) & (stored != NO_CELL))
    seen = arcs_m(lon[some, None], lat[some, None], catalog.longitude, catalog.latitude)
    camera, point = np.nonzero(seen <= told.footprint_m / 2.0)
    elevation, azimuth = np.radians(sun[some[camera]].T)
    towards = np.stack([np.sin(azimuth), np.cos(azimuth), np.tan(elevation)], axis=1)
    down = np.broadcast_to([0.0, 0.0, 1.0], towards.shape)
    found = predict(catalog, point, towards, down, np.full(len(point), 474.0))
    claimed = np.bincount(camera, np.isfinite(found.detection_probability), len(some)) > 0
    usable = np.bincount(camera, found.usable, len(some))[claimed]
    asked = some[claimed]
    assert len(asked) >= 1000
    assert np.count_nonzero(cause[asked] == Cause.MET) > 300
    assert (usable >= stored[asked]).all()
    enough = usable >= told.demand[place[asked]]
    assert enough[cause[asked] == Cause.MET].all()


def test_what_is_not_kept_has_a_cause(catalog: Catalog, built: Path) -> None:
    told = catalog.guarantee
    assert told is not None
    assert verify(built) == []
    short = (told.points < told.demand[:, None, None, None]) & (told.points != NO_CELL)
    assert (told.cause[short] != Cause.MET).all()
    assert (told.cause[~short & (told.points != NO_CELL)] == Cause.MET).all()
    assert len(catalog) <= 1.5 * told.lower_bound
    assert told.met[-1] == told.served[-1] == 1.0
