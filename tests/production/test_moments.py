"""What is served at a place holds at every moment: against random true directions of the Sun, whose angles at
each point are computed by spherical astronomy.
"""

from __future__ import annotations

import numpy as np
import pytest

from lcp_catalog.arrays import Array, Bytes, Index, Mask
from lcp_catalog.catalog.sun_cells import SunCells
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.ephemeris.solar_position import reachable_suns
from lcp_catalog.landmarks.selection import Cover, Nearby, Places
from lcp_catalog.production import promise
from lcp_catalog.production.promise import Near, moment_cover

GRID = SunCells.of((0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 15.0), np.arange(0.0, 360.0, 30.0))
CELLS = (GRID.shape[0] - 1) * GRID.shape[1]


def angles(lon: Array, lat: Array, sun_lon: Array, sun_lat: Array) -> tuple[Array, Array]:
    """Elevation and azimuth of the Sun, degrees."""
    turn, lat, sun_lat = np.radians(sun_lon - lon), np.radians(lat), np.radians(sun_lat)
    sine = np.sin(lat) * np.sin(sun_lat) + np.cos(lat) * np.cos(sun_lat) * np.cos(turn)
    north = np.cos(lat) * np.tan(sun_lat) - np.sin(lat) * np.cos(turn)
    return np.degrees(np.arcsin(sine)), np.degrees(np.arctan2(np.sin(turn), north)) % 360.0


def cells(elevation: Array, azimuth: Array) -> Index:
    """The cell of each Sun; -1 outside the grid."""
    row = np.searchsorted(GRID.elevation, elevation, side="right") - 1
    inside = (row >= 0) & (elevation < GRID.elevation[-1])
    return np.where(inside, row * GRID.shape[1] + (azimuth // 30.0).astype(np.int64), -1)


def arcs_m(lon: Array, lat: Array, lons: Array, lats: Array) -> Array:
    lon, lat, lons, lats = (np.radians(a) for a in (lon, lat, lons, lats))
    half = (
        np.sin((lats - lat) / 2) ** 2 + np.cos(lat) * np.cos(lats) * np.sin((lons - lon) / 2) ** 2
    )
    return np.asarray(2.0 * MOON_RADIUS_M * np.arcsin(np.sqrt(half)))


class Made:
    """Made candidates and places around 84 N, or across the pole, and what they are worth in the cells."""

    def __init__(
        self, lat_deg: float, radius_m: float, share: float, count: int = 60, units: int = 1
    ) -> None:
        rng = np.random.default_rng(5)
        x, y = rng.uniform(-3.0, 3.0, (2, count + 12))
        start = np.radians(lat_deg)
        away, towards = np.radians(np.hypot(x, y)), np.arctan2(x, y)
        sine = np.sin(start) * np.cos(away) + np.cos(start) * np.sin(away) * np.cos(towards)
        turn = np.arctan2(
            np.sin(towards) * np.sin(away) * np.cos(start), np.cos(away) - np.sin(start) * sine
        )
        lon, lat = 20.0 + np.degrees(turn), np.degrees(np.arcsin(sine))
        self.sites, self.places = Places(lon[12:], lat[12:]), Places(lon[:12], lat[:12])
        serves = rng.random((count, CELLS)) < share
        self.worth: Bytes = (serves * rng.integers(1, units + 1, serves.shape)).astype(np.uint8)
        self.radius_m = radius_m

    def cover(self) -> tuple[Cover, Mask]:
        first, place = Nearby(self.places).around(self.sites, self.radius_m)
        near = Near(self.sites, self.places, self.radius_m, first, place)
        return moment_cover(near, self.worth, GRID, np.arange(CELLS))

    def least(self, suns: int = 20000) -> tuple[Index, Index, Index]:
        """Places, the cell of a random Sun there, and what the candidates near are worth under that Sun by their
        own angles.
        """
        rng = np.random.default_rng(6)
        place = rng.integers(0, 12, suns)
        sun = rng.uniform(0.0, 360.0, suns), rng.uniform(-1.54, 1.54, suns)
        at = cells(*angles(self.places[0][place], self.places[1][place], *sun))
        place, at, sun = place[at >= 0], at[at >= 0], (sun[0][at >= 0], sun[1][at >= 0])
        elevation, azimuth = angles(*self.sites, sun[0][:, None], sun[1][:, None])
        own = cells(elevation, azimuth)
        worth = np.where(own >= 0, self.worth[np.arange(len(self.worth)), own], 0)
        # a share of 0.005 of a step into the next cell counts as the cell before
        low, count = GRID.elevation, np.arange(len(self.worth))
        for up in (-0.005, 0.0, 0.005):
            for on in (-0.15, 0.0, 0.15):
                row = np.clip(np.searchsorted(low, elevation) - 1, 0, len(low) - 2)
                near = cells(elevation + up * np.diff(low)[row], (azimuth + on) % 360.0)
                both = (own >= 0) & (near >= 0)
                worth = np.maximum(worth, np.where(both, self.worth[count, near], 0))
        here = self.places[0][place], self.places[1][place]
        close = arcs_m(here[0][:, None], here[1][:, None], *self.sites) <= self.radius_m
        return place, at, (worth * close).sum(axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("lat_deg", [-88.5, 84.0, 88.5])
@pytest.mark.parametrize(("share", "units"), [(0.8, 1), (1.0, 1), (1.0, 15)])
def test_a_place_has_what_it_is_told_at_every_moment(
    lat_deg: float, share: float, units: int
) -> None:
    """Not so if each candidate is asked about the place's own angles, as the Sun's angles differ by degrees."""
    made = Made(lat_deg, 80e3, share, units=units)
    cover, happens = made.cover()
    told = cover.counts(np.arange(len(cover)))
    place, cell, seen = made.least()
    assert len(place) > 5000
    assert happens[place, cell].all()
    assert (seen >= told[place, cell]).all()
    close = arcs_m(made.places[0][:, None], made.places[1][:, None], *made.sites) <= made.radius_m
    naive = close.astype(np.int64) @ made.worth.astype(np.int64)
    assert np.count_nonzero(seen < naive[place, cell]) > 0.05 * len(place)
    assert (
        told[happens].sum()
        > ({1: 0.3, 15: 0.1}[units] if share == 1.0 else 0.03) * naive[happens].sum()
    )


def test_what_is_taken_together_is_less_and_still_true(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Made(84.0, 80e3, 1.0)
    fine = made.cover()[0]
    monkeypatch.setattr(promise, "_ROWS", 100)
    monkeypatch.setattr(promise, "_PARTS", 3)
    coarse, happens = made.cover()
    assert len(coarse.worth) == 60 * 9
    everyone = np.arange(60)
    told = coarse.counts(everyone)
    assert (told[happens] <= fine.counts(everyone)[happens]).mean() > 0.99
    place, cell, seen = made.least()
    assert (seen >= told[place, cell]).all()


def test_at_the_place_itself_all_that_is_usable_serves() -> None:
    """Footprints so small that angles are the same in all of them: nothing is lost."""
    made = Made(84.0, 80e3, 0.5)
    made.sites = Places(made.places[0] + 1e-4, made.places[1])
    made.worth = made.worth[:12]
    made.radius_m = 1e3
    cover, happens = made.cover()
    told = cover.counts(np.arange(12))
    for place, lat in enumerate(made.places[1]):
        known = reachable_suns(round(4.0 * lat) / 4.0, GRID.azimuth, GRID.elevation)
        whole = (
            known[GRID.corners()].all(axis=0)[1:-1].ravel()
        )  # below the lowest row no claim is made
        some = GRID.shape[1] + np.flatnonzero(whole & happens[place, GRID.shape[1] :])
        assert len(some) > 5
        np.testing.assert_array_equal(told[place, some], made.worth[place, some])


@pytest.mark.parametrize("lat_deg", [-40.0, 0.0, 20.0, 60.0])
def test_beside_directions_that_never_occur_what_is_usable_serves(lat_deg: float) -> None:
    """The Sun reaches such a cell beside its evaluated corners, which have at least half of the weight at
    each of 300 000 Suns that can stand there.
    """
    grid = SunCells.of((4.0, 5.0, 10.0, 15.0, 20.0, 30.0), np.arange(0.0, 360.0, 15.0))
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
    cover, happens = moment_cover(near, np.ones((1, len(cells)), np.uint8), grid, cells)
    told = cover.counts(np.arange(1))[0]
    assert happens[0, np.flatnonzero(stands.ravel()[: len(cells)])].all()
    np.testing.assert_array_equal(told[np.flatnonzero(claimed.ravel()[: len(cells)])], 1)
