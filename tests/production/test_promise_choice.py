"""The promise of a catalogue: kept for cameras anywhere in the region under every Sun, by a count of its own."""

from __future__ import annotations

import dataclasses
import functools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.small_build import CONFIG, DEM
from helpers.verified import verify
from scipy.spatial import KDTree

from lcp_catalog.arrays import Bytes
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.prediction import predict
from lcp_catalog.catalog.schema import NO_CELL, Cause
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.errors import ConfigError
from lcp_catalog.geometry.frames import lonlat_to_mcmf
from lcp_catalog.kernels.sun_moments import UNKNOWN
from lcp_catalog.landmarks.located import Units, chance_of, needed
from lcp_catalog.landmarks.selection import stable_id
from lcp_catalog.matching.joint_detection import at_least_found
from lcp_catalog.production import estimate
from lcp_catalog.production import promise as promises
from lcp_catalog.production.area_job import AreaResult, run_area
from lcp_catalog.production.areas import AreaTask
from lcp_catalog.production.config import AreaConfig, SunConfig, ViewConfig
from lcp_catalog.production.finished_area import FinishedArea, finished_area
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.promise import PromiseChoice, PromisedPlaces
from lcp_catalog.production.run import Build, BuildRun
from lcp_catalog.terrain.area import Area, NodeWindow

PROMISED = dataclasses.replace(
    CONFIG,
    area=AreaConfig(center_deg=(3.5, 26.0), size_km=40.0, gsd_m=474.0),
    sun=SunConfig((75.0, 90.0, 105.0, 255.0, 270.0, 285.0), (5.0, 10.0, 20.0)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
    points=dataclasses.replace(
        CONFIG.points, per_view=3, footprint_km=26.0, candidates_per_cell=12, search_m=4000.0
    ),
)


@pytest.fixture(scope="module")
def plan() -> Build:
    return Build.plan((DEM,), PROMISED)


@pytest.fixture(scope="module")
def areas(plan: Build) -> dict[str, FinishedArea]:
    return {job.task.name: finished_area(run_area(job), plan.recipe.config) for job in plan.jobs}


@pytest.fixture(scope="module")
def built(
    plan: Build, areas: dict[str, FinishedArea], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    output = tmp_path_factory.mktemp("promise") / "promise.h5"
    run = BuildRun(plan, output)
    run.checkpoints.folder.mkdir()
    for name, area in areas.items():
        run.checkpoints.write(name, area)
    run.finish({})
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


def farthest_corner_m(catalog: Catalog, lon_deg, lat_deg) -> np.ndarray:
    """Distances from places (n, 1) to the farthest corner of each patch, metres."""
    north = np.degrees((catalog.patch_nodes - 1) / 2.0 * catalog.gsd / MOON_RADIUS_M)
    east = north / np.cos(np.radians(catalog.latitude))
    corners = [
        arcs_m(lon_deg, lat_deg, catalog.longitude + a, catalog.latitude + b)
        for a in (-east, east)
        for b in (-north, north)
    ]
    return np.max(corners, axis=0)


def suns_that_happen(rng: np.random.Generator, lat_deg: np.ndarray) -> np.ndarray:
    """Elevations and azimuths (n, 2), degrees, of the grid's ranges; those that never occur at the
    latitude are NaN.
    """
    sun = rng.uniform((5.0, 75.0), (20.0, 285.0), (len(lat_deg), 2))
    (elevation, azimuth), lat = np.radians(sun.T), np.radians(lat_deg)
    sine = np.sin(lat) * np.sin(elevation) + np.cos(lat) * np.cos(elevation) * np.cos(azimuth)
    return np.where(np.abs(sine)[:, None] <= np.sin(np.radians(1.54)), sun, np.nan)


def stated(
    plan: Build, areas: dict[str, FinishedArea], some: list[int], monkeypatch: pytest.MonkeyPatch
) -> tuple[float, float]:
    """Points that a plan expects when it has computed some of the areas, and the share of the promise that they keep."""
    monkeypatch.setattr(estimate, "table_of", lambda area, _: area.table)
    monkeypatch.setattr(estimate, "cell_stages", lambda area, _: area.stages)
    made = [AreaResult(areas[job.task.name], None) for job in plan.jobs]
    number = sum(len(area.table) for area in areas.values())
    return estimate._promised(plan.levels[0], {k: made[k] for k in some}, number)


def test_a_plan_expects_the_points_that_the_promise_takes(
    plan: Build,
    areas: dict[str, FinishedArea],
    catalog: Catalog,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With all areas as many as the build takes, which keep as much; with one in the place of the other about as many; of a part
    of the region what is promised in the whole.
    """
    points, kept = stated(plan, areas, [0, 1], monkeypatch)
    assert points == len(catalog) > 20
    cause = np.asarray(catalog.promise.cause)
    assert kept == pytest.approx((cause == Cause.MET).sum() / (cause != NO_CELL).sum())
    assert 0.1 < kept < 0.99
    for k in (0, 1):
        assert stated(plan, areas, [k], monkeypatch)[0] == pytest.approx(len(catalog), rel=0.25)
    monkeypatch.setattr(estimate, "CHOICE_CANDIDATES", 1)
    monkeypatch.setattr(estimate, "_PART_FOOTPRINTS", 1.25)
    part, _ = stated(plan, areas, [0, 1], monkeypatch)
    assert len(catalog) != part == pytest.approx(len(catalog), rel=0.4)


def test_candidates_stand_at_the_same_parts_of_another_window() -> None:
    """By the azimuthal projection: X east and Y north of the area's middle, on a sphere."""
    own = AreaTask(0, 0, 10.0, 20.0, NodeWindow(-40, 41, -30, 31))
    new = AreaTask(0, 1, 50.0, -70.0, NodeWindow(-40, 41, 0, 31))
    x, y = np.array([-30.0, 0.0, 15.0, 30.0]) * 500.0, np.array([40.0, -20.0, 10.0, -40.0]) * 500.0
    table = np.zeros(4, [("lon_deg", "<f8"), ("lat_deg", "<f8"), ("name", "<i4")])
    table["name"] = np.arange(4)

    def at(task: AreaTask, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
        up = np.sqrt(MOON_RADIUS_M**2 - x**2 - y**2)
        lat = np.radians(task.lat_deg)
        sine = (y * np.cos(lat) + up * np.sin(lat)) / MOON_RADIUS_M
        lon = np.arctan2(x, up * np.cos(lat) - y * np.sin(lat))
        return task.lon_deg + np.degrees(lon), np.degrees(np.arcsin(sine))

    table["lon_deg"], table["lat_deg"] = at(own, x, y)
    rows, whole = estimate._moved(table, own, own, 500.0)
    assert rows.tolist() == whole["name"].tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose([*whole.tolist()], [*table.tolist()], atol=2e-6)
    rows, half = estimate._moved(table, own, new, 500.0)
    assert rows.tolist() == half["name"].tolist() == [0, 2]
    there = at(new, (x + 15e3)[rows] * 31 / 61, y[rows])
    np.testing.assert_allclose([half["lon_deg"], half["lat_deg"]], there, atol=2e-6)


@pytest.mark.slow
def test_every_camera_sees_what_its_place_is_promised(plan: Build, catalog: Catalog) -> None:
    """400 cameras anywhere in the region under any Sun that can happen there: the footprint shows at
    least as many patches whole, of points usable by `predict`, as are stored for the nearest place, and where the
    cause is MET as many as are promised.
    """
    rng, told = np.random.default_rng(7), catalog.promise
    assert told is not None
    lon, lat = (np.tile(part, 2) for part in plan.recipe.region.lattice(101))
    sun = suns_that_happen(rng, lat)
    row, column = (
        np.searchsorted(grid, np.nan_to_num(part), side="right") - 1
        for grid, part in ((catalog.sun_elevation, sun[:, 0]), (catalog.sun_azimuth, sun[:, 1]))
    )
    place = arcs_m(lon[:, None], lat[:, None], told.longitude, told.latitude).argmin(axis=1)
    stored, cause = (a[place, 0, row, column] for a in (told.points, told.cause))
    some = np.flatnonzero(np.isfinite(sun[:, 0]) & (stored != NO_CELL))
    corner = farthest_corner_m(catalog, lon[some, None], lat[some, None])
    camera, point = np.nonzero(corner <= told.footprint[0] / 2.0)
    elevation, azimuth = np.radians(sun[some[camera]].T)
    towards = np.stack([np.sin(azimuth), np.cos(azimuth), np.tan(elevation)], axis=1)
    down = np.broadcast_to([0.0, 0.0, 1.0], towards.shape)
    found = predict(catalog, point, towards, down, np.full(len(point), 474.0))
    claimed = np.bincount(camera, np.isfinite(found.detection_probability), len(some)) > 0
    usable = np.bincount(camera, found.usable, len(some))[claimed]
    asked = some[claimed]
    assert len(asked) >= 400
    assert np.count_nonzero(cause[asked] == Cause.MET) > 40
    assert (usable >= stored[asked]).all()
    enough = usable >= told.demand[place[asked]]
    assert enough[cause[asked] == Cause.MET].all()


@pytest.mark.slow
def test_frames_are_located_as_promised(tmp_path: Path) -> None:
    """Cameras anywhere in the region under any Sun that can happen there: the points in their footprints, with the
    probabilities of `predict`, are found together in such numbers that the frame is located as probably as is stored for the
    nearest place; points that are not usable are among them.
    """
    points = dataclasses.replace(
        PROMISED.points, per_view=None, located_probability=0.5, footprint_km=60.0
    )
    area = dataclasses.replace(PROMISED.area, size_km=70.0)
    plan = Build.plan((DEM,), dataclasses.replace(PROMISED, area=area, points=points))
    run = BuildRun(plan, tmp_path / "located.h5")
    run.checkpoints.folder.mkdir()
    for job in plan.jobs:
        run.checkpoints.write(job.task.name, finished_area(run_area(job), plan.recipe.config))
    run.finish({})
    catalog = open_catalog(tmp_path / "located.h5")
    told, units = catalog.promise, Units.of_located(0.5, 474.0)
    assert told is not None
    assert told.demand.max() == units.demand
    rng = np.random.default_rng(7)
    lon, lat = plan.recipe.region.lattice(60)
    sun = suns_that_happen(rng, lat)
    row, column = (
        np.searchsorted(grid, np.nan_to_num(part), side="right") - 1
        for grid, part in ((catalog.sun_elevation, sun[:, 0]), (catalog.sun_azimuth, sun[:, 1]))
    )
    place = arcs_m(lon[:, None], lat[:, None], told.longitude, told.latitude).argmin(axis=1)
    stored, kept, hopeless = told.points[place, 0, row, column], 0, 0
    for k in np.flatnonzero(np.isfinite(sun[:, 0]) & (stored != NO_CELL)).tolist():
        near = np.flatnonzero(farthest_corner_m(catalog, lon[k], lat[k]) <= 30e3)
        elevation, azimuth = np.radians(sun[k])
        towards = [np.sin(azimuth), np.cos(azimuth), np.tan(elevation)]
        towards, down = (np.tile(one, (len(near), 1)) for one in (towards, [0.0, 0.0, 1.0]))
        found = predict(catalog, near, towards, down, np.full(len(near), 474.0))
        claims = found.detection_probability[np.isfinite(found.detection_probability)]
        least = needed(len(claims), float(claims.mean()), chance_of(474.0))
        located = at_least_found(claims)[least] if least <= len(claims) else 0.0
        assert located >= told.located[0][stored[k]] - 0.005
        if stored[k] >= units.demand:
            assert located >= 0.5
            kept += 1
            hopeless += np.count_nonzero(~found.usable)
    assert kept > 20
    assert hopeless > 20


def test_what_is_not_kept_has_a_cause(catalog: Catalog, built: Path) -> None:
    told = catalog.promise
    assert told is not None
    assert verify(built) == []
    short = (told.points < told.demand[:, None, None, None]) & (told.points != NO_CELL)
    assert (told.cause[short] != Cause.MET).all()
    assert (told.cause[~short & (told.points != NO_CELL)] == Cause.MET).all()
    assert len(catalog) <= 1.5 * told.least_points
    assert told.met[-1] == told.served[-1] == 1.0


def chosen(
    plan: Build, areas: list[FinishedArea], most: int | None = None
) -> tuple[list[int], Any]:
    """Ids of the points chosen among areas in this order, and the promise."""
    promise = PromiseChoice.of(plan.recipe.region, plan.recipe.config)
    assert promise is not None
    for area in areas:
        promise.see(area.table, area.stages)
    table = np.concatenate([area.table for area in areas])
    rows, told = promise.choose(table, np.ones(len(promise.best), bool), most)
    return stable_id(table["lon_deg"][rows], table["lat_deg"][rows]).tolist(), told


def shuffled(area: FinishedArea) -> FinishedArea:
    order = np.random.default_rng(3).permutation(len(area.table))
    assert area.stages is not None
    return dataclasses.replace(area, table=area.table[order], stages=area.stages[order])


def test_the_order_of_areas_and_candidates_does_not_matter(
    plan: Build, areas: dict[str, FinishedArea], catalog: Catalog
) -> None:
    ids, told = chosen(plan, [shuffled(area) for area in reversed(areas.values())])
    assert ids == catalog.point_id.tolist()
    np.testing.assert_array_equal(told.points, catalog.promise.points)
    np.testing.assert_array_equal(told.cause, catalog.promise.cause)


def test_a_limited_size_is_the_start_of_the_curve(
    plan: Build, areas: dict[str, FinishedArea], catalog: Catalog
) -> None:
    """And what the limit leaves out has that cause."""
    ids, told = chosen(plan, list(areas.values()), 5)
    assert len(ids) == told.size[-1] == 5
    np.testing.assert_array_equal(told.met, catalog.promise.met[:5])
    assert (told.cause == Cause.SIZE).any()
    assert not (catalog.promise.cause == Cause.SIZE).any()
    assert told.least_points == 0.0


def without_use(stages: Bytes | None, stage: Cause) -> Bytes:
    """Of candidates that one cause stops in all cells."""
    assert stages is not None
    causes, claims = np.hsplit(stages, 2)
    stopped = np.where(causes > 0, np.uint8(stage), np.uint8(0))
    return np.concatenate([stopped, np.where(claims < UNKNOWN, np.uint8(0), claims)], axis=1)


def test_candidates_without_use_give_the_cause(plan: Build, areas: dict[str, FinishedArea]) -> None:
    """The furthest stage of the candidates near; nothing near is featureless, or off the DEM."""
    for stage in (Cause.DARK, Cause.AMBIGUOUS, Cause.DEPENDENT, Cause.MARGINAL):
        poor = [
            dataclasses.replace(area, stages=without_use(area.stages, stage))
            for area in areas.values()
        ]
        ids, told = chosen(plan, poor)
        assert ids == []
        assert stage in np.unique(told.cause)
        assert set(np.unique(told.cause)) <= {stage, Cause.FEATURELESS, NO_CELL}
    promise = PromiseChoice.of(plan.recipe.region, plan.recipe.config)
    assert promise is not None
    none = areas[plan.jobs[0].task.name].table[:0]
    promise.see(none, areas[plan.jobs[0].task.name].stages[:0])
    rows, told = promise.choose(none, np.arange(len(promise.best)) % 2 > 0, None)
    known = told.demand > 0
    assert not len(rows)
    assert set(np.unique(told.cause[0::2][known[0::2]])) == {Cause.NODATA, NO_CELL}
    assert set(np.unique(told.cause[1::2][known[1::2]])) == {Cause.FEATURELESS, NO_CELL}


def test_demand_is_the_share_of_the_footprint_in_the_region() -> None:
    """8 in the middle, half of it at an edge, a quarter in a corner; the step and half a patch's diagonal are added to the
    radius.
    """
    region = Area(10.0, 0.0, 100.0)
    places = PromisedPlaces.of(region, PointConfig(footprint_km=20.0), 100.0, 1, 8)
    x = (places.at.lon_deg - 10.0) * 30.3234
    y = places.at.lat_deg * 30.3234
    middle = np.hypot(x, y) < 30.0
    assert (places.demand[middle] == 8).all()
    corner, edge = np.hypot(abs(x) - 50.0, abs(y) - 50.0).argmin(), np.hypot(x - 50.0, y).argmin()
    assert 2 <= places.demand[corner] <= 3
    assert 4 <= places.demand[edge] <= 5
    nearest = [
        arcs_m(a, b, places.at.lon_deg, places.at.lat_deg).min()
        for a, b in zip(*region.lattice(40), strict=True)
    ]
    reach_m = places.footprint_m / 2.0 - np.hypot(1600.0, 1600.0) - places.radius_m
    assert max(nearest) <= reach_m < 1.3 * max(nearest)


@pytest.mark.parametrize(
    ("bounds", "footprint_km", "gsd_m"),
    [((0.0, 60.0, 300.0, 61.0), 20.0, 20.0), ((-180.0, -90.0, 180.0, 90.0), 800.0, 474.0), ((0.0, 60.0, 5.0, 63.0), None, 59.0)],
)  # fmt: skip
def test_every_location_has_a_place_within_the_reach(
    bounds: tuple[float, float, float, float], footprint_km: float | None, gsd_m: float
) -> None:
    """100 000 random places of boxes, in a tangent plane and not, by a tree of all places."""
    region, points = Area.from_bounds(*bounds), PointConfig(footprint_km=footprint_km)
    places = PromisedPlaces.of(region, points, gsd_m, 1320, 165)
    rng, (west, south, east, north) = np.random.default_rng(3), np.radians(bounds)
    lat = np.degrees(np.arcsin(rng.uniform(np.sin(south), np.sin(north), 100_000)))
    lon = np.degrees(rng.uniform(west, east, 100_000))
    chord, _ = KDTree(lonlat_to_mcmf(places.at.lon_deg, places.at.lat_deg, 0.0)).query(
        lonlat_to_mcmf(lon, lat, 0.0)
    )
    away_m = 2.0 * MOON_RADIUS_M * np.arcsin(chord / 2.0 / MOON_RADIUS_M)
    half_m = np.hypot(16.0, 16.0) * gsd_m
    assert away_m.max() <= places.footprint_m / 2.0 - half_m - places.radius_m < 1.5 * away_m.max()


@pytest.mark.parametrize(
    ("size_km", "conditions"),
    [(30.0, 1320), (80.0, 26_400), pytest.param(150.0, 26_400, marks=pytest.mark.slow)],
)
def test_a_small_footprint_is_refused_with_the_least_that_works(
    size_km: float, conditions: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where places are as dense as is wanted, and where so many conditions leave room for few; of 80 km 27 km was named, and
    26 km worked. Places of a width are laid once, also for the second refusal.
    """
    region, placed = Area(3.5, 26.0, size_km), promises._placed
    known = functools.cache(lambda *width: placed(region, PointConfig(), 474.0, *width))
    monkeypatch.setattr(promises, "_placed", lambda *given: known(*given[3:]))
    with pytest.raises(ConfigError, match=r"give \d+ km or more") as refused:
        PromisedPlaces.of(region, PointConfig(footprint_km=10.0), 474.0, conditions, 165)
    named = re.search(r"give (\d+) km", str(refused.value))
    assert named is not None
    least = PointConfig(footprint_km=float(named[1]))
    assert PromisedPlaces.of(region, least, 474.0, conditions, 165).radius_m > 0.0
    with pytest.raises(ConfigError, match="too small"):
        PromisedPlaces.of(
            region, PointConfig(footprint_km=float(named[1]) - 1.0), 474.0, conditions, 165
        )


def test_patches_that_no_footprint_of_a_region_shows_are_named() -> None:
    """Eight points in a footprint that is larger than the region are less than one point of it."""
    region = Area(3.5, 26.0, 5.0)
    with pytest.raises(ConfigError, match="no width helps"):
        PromisedPlaces.of(region, PointConfig(footprint_km=10.0, per_view=8), 474.0, 1320, 8)
    with pytest.raises(ConfigError, match=r"too large .* or smaller cells"):
        PromisedPlaces.of(region, PointConfig(per_view=8), 474.0, 1320, 8)


@pytest.mark.slow
def test_what_cannot_be_promised_is_refused() -> None:
    with pytest.raises(
        ConfigError,
        match=r"sees, 0\.5 km wide \(`points.footprint_km`\), is too small .* give \d+ km or more",
    ):
        PromisedPlaces.of(Area(10.0, 0.0, 1000.0), PointConfig(footprint_km=0.5), 100.0, 960, 8)
    for wrong in ({"per_view": -1}, {"footprint_km": 0.0}, {"max_points": 0}, {"max_bytes": 0}):
        with pytest.raises(ConfigError, match=f"points.{next(iter(wrong))}"):
            PointConfig(**wrong)
    for given in ({"per_view": 0}, {"spacing_m": 5000.0}):
        assert not PointConfig(**given).promised
        with pytest.raises(ConfigError, match=r"or `points\.per_view` above 0"):
            PointConfig(**given, max_points=10)
    assert PointConfig().located == 0.99
    assert PointConfig(per_view=3).located is None
    assert PointConfig(spacing_m=5000.0, per_view=3).promised
    with pytest.raises(ConfigError, match="exclude each other"):
        PointConfig(per_view=3, located_probability=0.9)
