"""What is served at a place holds at every moment: against random true directions of the Sun, whose angles at each
candidate are computed by spherical astronomy, and its claims there by SciPy's interpolation.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.twins_relief import height
from scipy.interpolate import RegularGridInterpolator

from lcp_catalog.arrays import Array, Bytes, Index, Mask
from lcp_catalog.catalog.sun_cells import SunCells
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.ephemeris.solar_position import reachable_suns
from lcp_catalog.kernels.sun_moments import UNKNOWN
from lcp_catalog.landmarks.selection import Cover, Nearby, Places
from lcp_catalog.production import moments
from lcp_catalog.production.moments import Claimed, Near, moment_cover

POLAR = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 15.0), np.arange(0.0, 360.0, 30.0)
LEVEL = (4.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0), np.arange(0.0, 360.0, 15.0)
STEP = 0.004
PERCENTS = tuple((np.arange(1, 100) / 100.0).tolist())
"""Units that are percents of probability."""
ALBEDO = 0.05
NADIR, OBLIQUE = (0.0, 0.0, 1.0), (np.sin(np.radians(50.0)), 0.0, np.cos(np.radians(50.0)))
PLACES, CANDIDATES = 8, 30


def angles(lon: Array, lat: Array, sun_lon: Array, sun_lat: Array) -> tuple[Array, Array]:
    """Elevation and azimuth of the Sun, degrees."""
    turn, lat, sun_lat = np.radians(sun_lon - lon), np.radians(lat), np.radians(sun_lat)
    sine = np.sin(lat) * np.sin(sun_lat) + np.cos(lat) * np.cos(sun_lat) * np.cos(turn)
    north = np.cos(lat) * np.tan(sun_lat) - np.sin(lat) * np.cos(turn)
    return np.degrees(np.arcsin(sine)), np.degrees(np.arctan2(np.sin(turn), north)) % 360.0


def arcs_m(lon: Array, lat: Array, lons: Array, lats: Array) -> Array:
    lon, lat, lons, lats = (np.radians(a) for a in (lon, lat, lons, lats))
    half = (
        np.sin((lats - lat) / 2) ** 2 + np.cos(lat) * np.cos(lats) * np.sin((lons - lon) / 2) ** 2
    )
    return np.asarray(2.0 * MOON_RADIUS_M * np.arcsin(np.sqrt(half)))


def signal(elevation_deg: Array, azimuth_deg: Array, view: Array, slope: float) -> Array:
    """How clearly relief shows in Lommel-Seeliger light: the slopes of log(mu0 / (mu0 + mu)) over all noise."""
    e, a = np.radians(elevation_deg), np.radians(azimuth_deg)
    east, north, mu0 = np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.maximum(np.sin(e), 0.02)
    both = mu0 + view[2]
    shown = np.maximum(
        np.hypot((east + view[0]) / both - east / mu0, (north + view[1]) / both - north / mu0),
        0.03,
    )
    return np.asarray(shown / np.hypot(ALBEDO, slope * shown))


class Made:
    """Made candidates and places around a latitude, or across the pole, and smooth claims in two views."""

    def __init__(self, lat_deg: float, radius_m: float = 80e3) -> None:
        self.grid, self.radius_m = SunCells.of(*(POLAR if abs(lat_deg) > 80.0 else LEVEL)), radius_m
        self.elevations, self.azimuths = self.grid.elevation, self.grid.azimuth
        rng = np.random.default_rng(5)
        x, y = rng.uniform(-3.0, 3.0, (2, CANDIDATES + PLACES))
        start, away, towards = np.radians(lat_deg), np.radians(np.hypot(x, y)), np.arctan2(x, y)
        sine = np.sin(start) * np.cos(away) + np.cos(start) * np.sin(away) * np.cos(towards)
        turn = np.arctan2(
            np.sin(towards) * np.sin(away) * np.cos(start), np.cos(away) - np.sin(start) * sine
        )
        lon, lat = 20.0 + np.degrees(turn), np.degrees(np.arcsin(sine))
        self.sites = Places(lon[PLACES:], lat[PLACES:])
        self.places = Places(lon[:PLACES], lat[:PLACES])
        phase = rng.uniform(0.0, 360.0, (CANDIDATES, 2, 1, 1))
        wave = np.sin(np.radians(self.azimuths + phase)) * np.cos(0.1 * self.elevations[:, None])
        p = 0.55 + 0.35 * wave + rng.uniform(-0.08, 0.08, wave.shape)
        self.codes: Bytes = np.rint(p / STEP).astype(np.uint8)
        self.slope = rng.choice([0.02, 0.046, 0.1], CANDIDATES)
        self.views = np.array([NADIR, OBLIQUE])

    def claims(self) -> Claimed:
        return Claimed(self.grid, self.codes, self.slope, self.views, ALBEDO, PERCENTS, (0.0, 0.0))

    @property
    def columns(self) -> Index:
        """All cells of both views."""
        one = np.arange((self.grid.shape[0] - 1) * self.grid.shape[1])
        return np.concatenate([one, one + self.grid.shape[0] * self.grid.shape[1]])

    def cover(self) -> tuple[Cover, Mask]:
        first, place = Nearby(self.places).around(self.sites, self.radius_m)
        near = Near(self.sites, self.places, self.radius_m, first, place)
        return moment_cover(near, self.claims(), self.columns)

    def least(self, suns: int, conditions: Index | None = None) -> tuple[Bytes, Mask]:
        """(candidate, place, condition): the least percents at random Suns that stand in a cell at the place, 255 where none
        does, farther apart than the radius, and beside the ``conditions`` that are asked for; and whether they are far from
        the ends of the claims at the candidate.
        """
        rng = np.random.default_rng(6)
        high, wide = self.grid.shape[0] - 1, self.grid.shape[1]
        found = np.full((CANDIDATES, PLACES, 2, high * wide), 255, np.uint8)
        inner = np.ones(found.shape, np.bool_)
        asked = np.ones((2, high * wide), np.bool_)
        if conditions is not None:
            asked = np.isin(np.arange(asked.size), conditions).reshape(asked.shape)
        probabilities = np.linspace(1e-3, 1.0 - 1e-3, 4000)
        heights = height(probabilities)
        stated = [[self._interpolated(i, v) for v in range(2)] for i in range(CANDIDATES)]
        for p in range(PLACES):
            sun = rng.uniform(0.0, 360.0, suns), rng.uniform(-1.54, 1.54, suns)
            elevation, azimuth = angles(self.places[0][p], self.places[1][p], *sun)
            some = (elevation >= self.elevations[0]) & (elevation < self.elevations[-1])
            row = np.searchsorted(self.elevations, elevation[some], "right") - 1
            cell = row * wide + (azimuth[some] / (360.0 / wide)).astype(np.int64)
            some = np.flatnonzero(some)[asked[:, cell].any(axis=0)]
            cell = cell[asked[:, cell].any(axis=0)]
            away = arcs_m(self.places[0][p], self.places[1][p], *self.sites)
            for i in np.flatnonzero(away <= self.radius_m):
                at = angles(self.sites[0][i], self.sites[1][i], sun[0][some], sun[1][some])
                # half a step beyond them, 2.5 deg at most, those of the end hold
                low, high = self.elevations[[0, -1]]
                first, last = np.minimum(np.diff(self.elevations)[[0, -1]] / 2.0, 2.5)
                outside = (at[0] < low - first) | (at[0] > high + last)
                kept = np.stack([np.clip(at[0], low, high), at[1]], axis=1)
                for v in np.flatnonzero(asked.any(axis=1)):
                    view = self.views[v]
                    shown = stated[i][v](kept)
                    shown = shown * signal(*at, view, self.slope[i])
                    percents = 100.0 * np.interp(shown, heights, probabilities)
                    value = np.where(outside, 0, np.floor(np.clip(percents, 0.0, 99.0)))
                    np.minimum.at(found[i, p, v], cell, value.astype(np.uint8))
                    edge = np.abs(at[0] - low + first) < 0.6
                    edge |= np.abs(at[0] - high - last) < 0.6
                    np.logical_and.at(inner[i, p, v], cell, ~edge)
        return found.reshape(CANDIDATES, PLACES, -1), inner.reshape(found.shape[0], PLACES, -1)

    def _interpolated(self, i: int, v: int) -> RegularGridInterpolator:
        suns = np.meshgrid(self.elevations, self.azimuths, indexing="ij")
        over = height(self.codes[i, v] * STEP) / signal(*suns, self.views[v], self.slope[i])
        wrapped = np.concatenate([over, over[:, :1]], axis=1)
        axes = self.elevations, np.append(self.azimuths, 360.0)
        return RegularGridInterpolator(axes, wrapped, bounds_error=False, fill_value=None)


def of_pairs(made: Made, cover: Cover, everywhere: Bytes) -> tuple[Bytes, Bytes]:
    """What the cover says of pairs of candidates and places, and the same of `everywhere` (candidate, place, condition)."""
    candidate = np.repeat(np.arange(CANDIDATES), np.diff(cover.first))
    return cover.worth[cover.row], everywhere[candidate, cover.place]


@pytest.mark.parametrize("lat_deg", [-88.5, 84.0, 26.0])
def test_a_place_is_told_the_least_at_all_moments(lat_deg: float) -> None:
    """To 3 % of probability, in few cases 7 % between moments 2 deg of elevation and 5 of azimuth apart; never where it leaves
    the claims. Not so if each candidate is asked about the place's own angles, which differ by degrees.
    """
    made = Made(lat_deg)
    cover, happens = made.cover()
    least, inner = made.least(12_000)
    told, seen = of_pairs(made, cover, least)
    _, far = of_pairs(made, cover, inner)
    stands = (seen < 255) & (told < 255)
    assert happens[cover.place][seen < 255].all()
    assert np.count_nonzero(stands & far) > 2000
    over = told[stands].astype(int) - seen[stands]
    assert (over > 3).mean() < 0.01
    assert over[seen[stands] > 0].max() <= 7
    assert (told[stands][seen[stands] == 0] == 0).all()
    gap = seen[stands & far].astype(int) - told[stands & far]
    assert np.median(gap) <= 2
    assert np.quantile(gap, 0.9) <= 12  # few of the random Suns are near the worst
    own = np.floor(made.codes * STEP * 100.0).astype(np.uint8).reshape(CANDIDATES, -1)
    candidate = np.repeat(np.arange(CANDIDATES), np.diff(cover.first))
    naive = own[:, made.columns][candidate]
    assert (naive[stands].astype(int) > seen[stands].astype(int) + 3).mean() > 0.05
    for place in range(PLACES):
        close = arcs_m(made.places[0][place], made.places[1][place], *made.sites) <= made.radius_m
        assert set(candidate[cover.place == place]) == set(np.flatnonzero(close))


@pytest.mark.parametrize(
    ("elevation_deg", "azimuth_deg", "few"),
    [(40.0, 90.0, 0.0), (28.0, 95.0, 0.05), (20.0, 97.0, 0.06)],
)
def test_a_place_is_told_how_little_shows_under_a_sun_near_the_views_direction(
    elevation_deg: float, azimuth_deg: float, few: float
) -> None:
    """To 3 % of probability within 15 deg of the oblique view's direction, where that changes steeply; of views 62 and 70 deg
    off the nadir beside the grid's azimuths in few cases 10 %.
    """
    made = Made(0.0)
    made.views = made.views.copy()
    up, on = np.radians([elevation_deg, azimuth_deg])
    made.views[1] = np.cos(up) * np.sin(on), np.cos(up) * np.cos(on), np.sin(up)
    middle = (made.elevations[:-1] + made.elevations[1:]) / 2.0
    e, a = np.radians(np.meshgrid(middle, made.azimuths + 7.5, indexing="ij"))
    sun = np.stack([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)], axis=-1)
    away = np.degrees(np.arccos(sun @ made.views[1]))
    near = np.flatnonzero(away < 15.0) + away.size  # of the second view
    least, _ = made.least(60_000, near)
    told, seen = (units[:, near] for units in of_pairs(made, made.cover()[0], least))
    stands = (seen < 255) & (told < 255)
    assert np.count_nonzero(stands) > 300
    over = told[stands].astype(int) - seen[stands]
    assert (over > 3).mean() <= few
    assert over.max() <= 10


def test_what_is_taken_together_is_worth_what_the_worst_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Places in one of 2 x 2 parts of the circle around a candidate."""
    made = Made(84.0)
    fine = made.cover()[0]
    monkeypatch.setattr(moments, "_ROWS", 60)
    monkeypatch.setattr(moments, "_PARTS", 2)
    coarse = made.cover()[0]
    assert len(coarse.worth) == CANDIDATES * 4
    assert (np.bincount(coarse.row) > 1).sum() > 10
    worst = np.full_like(coarse.worth, 255)
    np.minimum.at(worst, coarse.row, fine.worth[fine.row])
    used = np.unique(coarse.row)
    np.testing.assert_array_equal(coarse.worth[used], worst[used])
    candidate = np.repeat(np.arange(CANDIDATES), np.diff(coarse.first))
    lon, lat = made.places
    for row in used:
        pairs = coarse.row == row
        assert len(set(candidate[pairs])) == 1
        spot = coarse.place[pairs]
        apart = arcs_m(lon[spot][:, None], lat[spot][:, None], lon[spot], lat[spot])
        assert apart.max() < 1.01 * np.sqrt(2.0) * 2.0 * made.radius_m / 2.0


def test_margins_lower_what_is_sure() -> None:
    """Everywhere by that in the middle of four directions, 0.5 (1 - 4 / 16) logits."""
    made = Made(26.0)
    plain = made.cover()[0]
    claims = dataclasses.replace(made.claims(), margins=(0.375, 1.5))
    first, place = Nearby(made.places).around(made.sites, made.radius_m)
    near = Near(made.sites, made.places, made.radius_m, first, place)
    cover, happens = moment_cover(near, claims, made.columns)
    there = happens[place]
    p, lower = (np.clip(c.worth[c.row][there] / 100.0, 0.01, 0.99) for c in (plain, cover))
    lost = np.log(p / (1.0 - p)) - np.log(lower / (1.0 - lower))
    some = (p > 0.2) & (p < 0.8)
    assert (lost[some] > 0.375 - 0.07).all()
    assert np.median(lost[some]) == pytest.approx(0.375, abs=0.03)


@pytest.mark.parametrize("lat_deg", [-40.0, 0.0, 20.0, 60.0])
def test_beside_directions_that_never_occur_claims_of_the_others_serve(lat_deg: float) -> None:
    """The Sun reaches such a cell beside its evaluated corners, which have at least half of the weight at
    each of 300 000 Suns that can stand there.
    """
    grid = SunCells.of(LEVEL[0][:6], LEVEL[1])
    rng = np.random.default_rng(7)
    sun = rng.uniform(0.0, 360.0, 300_000), rng.uniform(-1.59, 1.59, 300_000)
    elevation, azimuth = angles(np.zeros(1), np.full(1, lat_deg), *sun)
    row = np.searchsorted(grid.elevation, elevation) - 1
    inside = (row >= 0) & (elevation < grid.elevation[-1])
    row, column = row[inside], (azimuth[inside] // 15.0).astype(np.int64)
    up = (elevation[inside] - grid.elevation[row]) / np.diff(grid.elevation)[row]
    on = azimuth[inside] % 15.0 / 15.0
    known = reachable_suns(lat_deg, grid.azimuth, grid.elevation)
    after = (column + 1) % 24
    weight = sum(
        known[r, c] * a * b
        for r, a in ((row, 1.0 - up), (row + 1, up))
        for c, b in ((column, 1.0 - on), (after, on))
    )
    least = np.ones(grid.shape)
    np.minimum.at(least, (row, column), weight)
    stands = np.zeros(grid.shape, np.bool_)
    stands[row, column] = True
    claimed = stands & (least > 0.52)
    claimed[[0, -2, -1]] = False  # at the lowest and the highest cells the grid ends
    assert (claimed & ~known[grid.corners()].all(axis=0)).sum() >= 4
    place = Places(np.zeros(1), np.full(1, lat_deg))
    near = Near(
        Places(np.full(1, 1e-4), place[1]), place, 1e3, np.array([0, 1]), np.zeros(1, np.int64)
    )
    cells = np.arange((grid.shape[0] - 1) * grid.shape[1])
    codes = np.where(known, np.uint8(240), np.uint8(UNKNOWN))[None, None]
    claims = Claimed(grid, codes, np.zeros(1), np.array([NADIR]), 0.0, (0.95,), (0.0, 0.0))
    cover, happens = moment_cover(near, claims, cells)
    told = cover.counts(np.arange(1))[0]
    assert happens[0, np.flatnonzero(stands.ravel()[: len(cells)])].all()
    np.testing.assert_array_equal(told[np.flatnonzero(claimed.ravel()[: len(cells)])], 1)


@pytest.mark.parametrize("margins", [(0.0, 0.0), (0.375, 1.5)])
def test_a_single_elevation_counts_with_the_worse_of_two_azimuths(
    margins: tuple[float, float],
) -> None:
    """As a mean of both is nowhere less; where one is not evaluated with the other alone, and with none where neither is."""
    grid = SunCells.of((20.0,), LEVEL[1])
    codes = np.random.default_rng(3).integers(60, 240, (1, 1, 1, 24)).astype(np.uint8)
    codes[..., 5:7] = UNKNOWN
    claims = Claimed(grid, codes, np.zeros(1), np.array([NADIR]), 0.0, PERCENTS, margins)
    place = Places(np.zeros(1), np.full(1, 40.0))
    near = Near(place, place, 1e3, np.array([0, 1]), np.zeros(1, np.int64))
    cover, happens = moment_cover(near, claims, np.arange(24))
    told, p = cover.counts(np.arange(1))[0], codes[0, 0, 0] * STEP
    assert happens.all()
    for k in range(24):
        known = [p[i] for i in (k, (k + 1) % 24) if i not in (5, 6)]
        if not known:
            assert told[k] == 0
            continue
        lower = 1.0 / (1.0 + np.exp(margins[0] - np.log(min(known) / (1.0 - min(known)))))
        assert told[k] == pytest.approx(100.0 * lower, abs=1.1)


def test_a_single_direction_needs_no_margin() -> None:
    grid = SunCells.of((20.0,), (90.0, 270.0))
    codes = np.full((1, 1, 1, 2), 225, np.uint8)
    claims = Claimed(grid, codes, np.zeros(1), np.array([NADIR]), 0.0, (0.9,), (0.375, 1.5))
    place = Places(np.zeros(1), np.full(1, 40.0))
    near = Near(place, place, 1e3, np.array([0, 1]), np.zeros(1, np.int64))
    cover, _ = moment_cover(near, claims, np.arange(2))
    assert cover.counts(np.arange(1))[0].tolist() == [1, 1]


def test_points_count_beyond_two_elevations_by_claims_but_not_as_usable() -> None:
    """60 km away the Sun stands up to 2 deg higher or lower: there the claims of 10 and 20 deg hold, as far as 5 and 25 deg."""
    grid = SunCells.of((10.0, 20.0), LEVEL[1])
    codes = np.full((1, 1, 2, 24), 200, np.uint8)
    place = Places(np.zeros(1), np.full(1, 40.0))
    near = Near(
        Places(np.full(1, 2.5), place[1]), place, 1e5, np.array([0, 1]), np.zeros(1, np.int64)
    )
    for margins, lost in (((0.0, 0.0), 0.0), ((0.375, 1.5), 0.6)):
        claims = Claimed(grid, codes, np.zeros(1), np.array([NADIR]), 0.0, PERCENTS, margins)
        cover, happens = moment_cover(near, claims, np.arange(24))
        assert happens.any()
        worth = cover.counts(np.arange(1))[happens]
        assert (worth == 80).all() or lost > 0.0
        assert (worth == 0).mean() >= lost
