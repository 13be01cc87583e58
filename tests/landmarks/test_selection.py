"""The choice of points against brute force and its bounds anywhere on the Moon, ids, and the status
of cells.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import central_angle_deg
from lcp_catalog.landmarks import selection
from lcp_catalog.landmarks.selection import (
    Nearby,
    Places,
    Status,
    coverage,
    nearest,
    select,
    stable_id,
    within,
)

KM = 1000.0
DEG_M = np.pi / 180.0 * MOON_RADIUS_M


def at(lon_deg, lat_deg):
    return Places(np.array(lon_deg), np.array(lat_deg))


def distance_m(lon1, lat1, lon2, lat2):
    return central_angle_deg(lon1, lat1, lon2, lat2) * DEG_M


def scattered(seed, count, centre):
    """Candidates within about 60 km of any place: made at the north pole and rotated to it."""
    rng = np.random.default_rng(seed)
    away, turn = (
        60.0 * KM / MOON_RADIUS_M * np.sqrt(rng.random(count)),
        rng.uniform(0, 2 * np.pi, count),
    )
    local = np.stack([np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), np.cos(away)])
    lon, lat = np.radians(centre)
    tilt = np.pi / 2 - lat
    y = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    z = np.array([[np.cos(lon), -np.sin(lon), 0], [np.sin(lon), np.cos(lon), 0], [0, 0, 1]])
    v = z @ y @ local
    return (
        np.degrees(np.arctan2(v[1], v[0])) % 360.0,
        np.degrees(np.arcsin(np.clip(v[2], -1, 1))),
        rng,
    )


def brute_select(lon, lat, usable, quality, spacing):
    ids = stable_id(lon, lat)
    order = sorted(range(len(lon)), key=lambda i: (-usable[i], -quality[i], ids[i], lon[i], lat[i]))
    close = distance_m(lon[:, None], lat[:, None], lon, lat) < spacing
    chosen = []
    for i in order:
        near = [c for c in chosen if close[i, c] or ids[i] == ids[c]]
        if usable[i] > 0 and not near:
            chosen.append(i)
    return sorted(chosen, key=lambda i: ids[i])


PLACES = [(123.0, 10.0), (0.0, -30.0), (77.0, 90.0), (200.0, -90.0), (359.9, 88.5)]


@pytest.mark.parametrize("centre", PLACES)
def test_the_choice_is_that_of_brute_force(centre):
    lon, lat, rng = scattered(1, 150, centre)
    usable, quality = rng.integers(0, 6, 150), rng.integers(0, 3, 150).astype(float)
    assert select(Places(lon, lat), usable, quality, 8 * KM).tolist() == brute_select(
        lon, lat, usable, quality, 8 * KM
    )


@given(
    st.integers(0, 10_000),
    st.sampled_from(PLACES),
    st.floats(0.3, 40.0),
    st.sampled_from([1.0, 0.75, 0.5]),
)
def test_no_two_points_are_close_and_no_candidate_is_far(seed, centre, spacing_km, fill):
    lon, lat, rng = scattered(seed, 120, centre)
    usable, quality = rng.integers(0, 4, 120), rng.random(120)
    chosen = select(Places(lon, lat), usable, quality, spacing_km * KM, fill)
    assert (usable[chosen] > 0).all()
    apart = distance_m(lon[chosen][:, None], lat[chosen][:, None], lon[chosen], lat[chosen])
    limit = fill * spacing_km * KM
    assert (apart[~np.eye(len(chosen), dtype=bool)] >= limit - 1e-3).all()
    live = usable > 0
    away = distance_m(lon[live][:, None], lat[live][:, None], lon[chosen], lat[chosen]).min(
        axis=1, initial=np.inf
    )
    assert (away < limit).all()


def test_a_second_pass_only_adds():
    lon, lat, rng = scattered(3, 500, (45.0, 45.0))
    usable, quality = rng.integers(1, 4, 500), rng.random(500)
    first, both = (
        set(select(Places(lon, lat), usable, quality, 10 * KM, f).tolist()) for f in (1.0, 0.75)
    )
    assert first < both


def test_the_order_of_the_input_does_not_matter():
    lon, lat, rng = scattered(2, 300, (0.0, 0.0))
    usable, quality = rng.integers(0, 3, 300), rng.integers(0, 2, 300).astype(float)
    turn = rng.permutation(300)
    one = select(Places(lon, lat), usable, quality, 5 * KM)
    other = turn[select(Places(lon[turn], lat[turn]), usable[turn], quality[turn], 5 * KM)]
    assert one.tolist() == other.tolist()
    assert (np.diff(stable_id(lon[one], lat[one])) > 0).all()


def test_more_conditions_win_then_quality():
    lon, lat = np.array([10.0, 10.01, 10.02]), np.zeros(3)
    assert select(Places(lon, lat), [2, 3, 1], [9.0, 0.0, 9.0], 5 * KM).tolist() == [1]
    assert select(Places(lon, lat), [2, 2, 2], [0.1, 0.0, 0.9], 5 * KM).tolist() == [2]
    assert select(Places(lon, lat), [2, 2, 2], [0.0, 0.0, 0.0], 5 * KM).tolist() == [0]


def test_candidates_that_are_never_chosen():
    assert select(at([], []), [], [], 1.0).size == 0
    assert select(at([1.0, 2.0], [0.0, 0.0]), [0, 3], [1.0, np.nan], 1.0).size == 0
    assert (
        select(at([1.0, 1.0 + 1e-6], [0.0005, 0.0005]), [1, 1], [0.0, 0.0], 1e-3).size == 1
    )  # one id, one point
    assert (
        select(at([0.0, 180.0], [0.0, 0.0]), [1, 1], [0.0, 0.0], 6e6).size == 1
    )  # wider than the Moon
    for spacing, fill in ((0.0, 1.0), (-1.0, 1.0), (np.nan, 1.0), (1.0, 0.0), (1.0, 1.1)):
        with pytest.raises(ValueError, match="spacing"):
            select(at([1.0], [0.0]), [1], [0.0], spacing, fill)


def test_a_spacing_of_more_than_a_third_of_the_circumference():
    places = at([0.0, 140.0], [0.0, 0.0])
    for spacing_deg, count in ((135.0, 2), (145.0, 1)):
        assert select(places, [1, 1], [0.0, 0.0], spacing_deg * DEG_M).size == count


@pytest.mark.parametrize(("lon", "chosen"), [([370.0001, 10.0002], 0), ([370.0002, 10.0001], 1)])
def test_of_equals_with_one_id_the_western_one_is_chosen(lon, chosen):
    assert len(set(stable_id(lon, [0.0005, 0.0005]))) == 1
    assert select(at(lon, [0.0005, 0.0005]), [1, 1], [0.0, 0.0], 1.0).tolist() == [chosen]


def id_to_lonlat(number):
    """The middle of an id's cell: row (from 1) * 2^20 + column; a pole for the cell around it."""
    row, column = divmod(int(number), 2**20)
    lat = (row - 0.5) / 1000.0 - 90.0
    if row in (1, 180_000):
        return 0.0, float(np.copysign(90.0, lat))
    return (column + 0.5) * 360.0 / round(360_000 * np.cos(np.radians(lat))), lat


lons, lats = st.floats(-720.0, 720.0), st.floats(-90.0, 90.0)


@given(lons, lats)
def test_an_id_belongs_to_a_place(lon, lat):
    number = stable_id(lon, lat)
    back_lon, back_lat = id_to_lonlat(number)
    assert number > 0
    assert stable_id(back_lon, back_lat) == number
    assert abs(back_lat - lat) <= 0.00100001
    assert distance_m(lon, lat, back_lon, back_lat) < 31.0


@given(st.integers(0, 359_000), lats)
def test_a_turn_more_is_the_same_place(thousandth, lat):
    lon = (
        thousandth / 1000.0 + 0.0005
    )  # the middle of a cell at the equator; elsewhere away from most edges
    assert stable_id(lon, lat) in (stable_id(lon + 360.0, lat), stable_id(lon + 360.0 - 1e-9, lat))
    assert stable_id(0.0, lat) == stable_id(360.0, lat) == stable_id(-1e-20, lat)


def test_ids_at_the_poles():
    lon = np.linspace(0, 360, 50)
    for pole in (90.0, -90.0):
        assert len(set(stable_id(lon, np.full(50, pole)).tolist())) == 1
        assert id_to_lonlat(stable_id(12.0, pole))[1] == pole
    assert stable_id(0.0, 90.0) != stable_id(0.0, 89.998)


def test_neighbouring_cells_have_different_ids():
    lon, lat = np.meshgrid(np.arange(20) * 0.001 + 0.0005, np.arange(-10, 10) * 0.001 + 0.0005)
    assert len(np.unique(stable_id(lon, lat))) == 400
    # row 89999 + 1, column 1: (lat 0.0005 S is row 89999, counted from 1) * 2^20 + 1
    assert stable_id(0.0015, -0.0005) == 90_000 * 2**20 + 1


def test_an_invalid_place_has_no_id():
    for lon, lat in ((np.nan, 0.0), (np.inf, 0.0), (0.0, 90.1), (0.0, np.nan)):
        with pytest.raises(ValueError, match="degrees"):
            stable_id(lon, lat)


def test_nearest_is_that_of_brute_force():
    lon, lat, _ = scattered(4, 80, (359.9, 88.5))
    to_lon, to_lat, _ = scattered(5, 60, (0.5, 88.5))
    index, away = nearest(Places(lon, lat), Places(to_lon, to_lat))
    every = distance_m(lon[:, None], lat[:, None], to_lon, to_lat)
    np.testing.assert_allclose(away, every.min(axis=1), atol=1e-3)
    assert index.tolist() == every.argmin(axis=1).tolist()
    index, away = nearest(Places(lon, lat), at([], []))
    assert (index.tolist(), away.tolist()) == ([-1] * 80, [np.inf] * 80)


def test_a_thread_without_memory_ends_the_search_for_the_nearest(monkeypatch: pytest.MonkeyPatch):
    """Its places would be infinitely far from all others."""

    class Tree:
        def query(self, here, workers=1):
            if workers == 1:
                raise MemoryError
            return np.full(len(here), np.inf), np.zeros(len(here), int)  # as SciPy's threads do

    monkeypatch.setattr(selection, "_tree", lambda unit: Tree())
    monkeypatch.setattr(selection, "thread_count", lambda: 2)
    places = Places(*scattered(4, 80, (359.9, 88.5))[:2])
    with pytest.raises(MemoryError):
        nearest(places, places)


def test_pairs_within_a_distance_are_those_of_brute_force():
    lon, lat, rng = scattered(5, 150, (130.0, 80.0))
    points = at(lon[:60], lat[:60])
    others = at(lon[60:] + rng.integers(-1, 2, 90) * 360.0, lat[60:])
    away = distance_m(
        others.lon_deg[:, None], others.lat_deg[:, None], points.lon_deg, points.lat_deg
    )
    near = away <= 12.0 * KM  # (other, point)
    cell, point = within(others, points, 12.0 * KM)
    assert (np.diff(point) >= 0).all()
    assert sorted(zip(cell, point, strict=True)) == sorted(zip(*np.nonzero(near), strict=True))
    first, found = Nearby(points).around(others, 12.0 * KM)
    np.testing.assert_array_equal(first, [0, *np.cumsum(near.sum(axis=1))])
    np.testing.assert_array_equal(found, np.nonzero(near)[1])
    assert 0 < near.sum() < near.size
    assert near.any(axis=0).min() < near.sum(axis=0).max()


def test_without_places_nothing_is_near():
    none, some = at([], []), at([10.0, 10.01], [5.0, 5.0])
    for cells, points in ((none, some), (some, none), (none, none)):
        assert [len(found) for found in within(cells, points, KM)] == [0, 0]
    for others, starts in ((none, [0]), (at([50.0], [5.0]), [0, 0])):
        first, found = Nearby(some).around(others, KM)
        assert (first.tolist(), found.tolist()) == (starts, [])
        assert np.issubdtype(found.dtype, np.integer)


def test_the_status_of_a_cell_gives_the_reason_why_it_is_empty():
    spacing = 10 * KM
    step = spacing / DEG_M
    cells = Places(np.arange(8) * step, np.zeros(8))
    ground = np.array([True, True, True, True, True, False, True, False])
    lon = np.array([0.0, 1.1, 2.1, 2.2, 3.0, 7.4]) * step
    stage = np.array([0, 0, 0, 1, 2, 3])
    points = Places(np.array([7.4 * step]), np.zeros(1))
    status = coverage(cells, ground, Places(lon, np.zeros(6)), stage, points, spacing)
    names = [Status(s).name for s in status]
    assert names[:4] == ["FEATURELESS", "FEATURELESS", "AMBIGUOUS", "DEPENDENT"]
    assert names[4:] == ["FEATURELESS", "NODATA", "FEATURELESS", "POINT"]
    far = coverage(cells, ground, at([50.0], [50.0]), np.array([3]), at([], []), spacing)
    assert (far == np.where(ground, Status.FEATURELESS, Status.NODATA)).all()


def test_a_usable_candidate_counts_though_its_neighbour_was_chosen():
    spacing = 10 * KM
    step = spacing / DEG_M
    cells = Places(np.array([0.0, step]), np.zeros(2))
    lon = np.array([-0.4, 0.55]) * step
    status = coverage(
        cells,
        np.ones(2, bool),
        Places(lon, np.zeros(2)),
        np.array([3, 3]),
        Places(lon[:1], np.zeros(1)),
        spacing,
    )
    assert status.tolist() == [Status.POINT, Status.POINT]


def test_the_numbers_are_those_of_the_catalogue():
    schema = pytest.importorskip("lcp_catalog.catalog.schema")
    assert {int(s): s.name.lower() for s in Status} == schema.COVERAGE_STATUS


def test_a_cell_is_served_by_a_point_within_a_spacing_of_its_centre():
    spacing = 10 * KM
    step = spacing / DEG_M
    cells, point = (
        Places(np.array([0.0, 1.0, 2.0]) * step, np.zeros(3)),
        Places(np.array([-0.05 * step]), np.zeros(1)),
    )
    near = Places(np.array([0.1 * step]), np.zeros(1))
    ground = np.ones(3, dtype=bool)
    assert coverage(cells, ground, near, [3], near, spacing)[:2].tolist() == [Status.POINT] * 2
    assert coverage(cells, ground, point, [3], point, spacing)[1] == Status.FEATURELESS
