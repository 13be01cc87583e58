"""Random cameras over built regions: each sees at least the points that its place is promised, level by level.

    python -m benchmarks.evidence promise CATALOG.h5 ...

For each level 1000 random cameras near places at which something is promised, each at a moment: the Sun stands over a
random place within 1.54 degrees of the equator, far away, and has at each point the elevation and azimuth of that point.
Moments count if something is promised for the Sun's angles at the camera's place and any point near makes a claim.
Points within half a footprint (haversine formula) are counted that `predict` calls usable straight down.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.markdown import table
from lcp_catalog import Catalog, open_catalog
from lcp_catalog.arrays import AnyArray, Array
from lcp_catalog.catalog.prediction import predict
from lcp_catalog.catalog.schema import NO_CELL, Cause
from lcp_catalog.catalog.sun_cells import SunCells
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import direction_enu

COUNT, TRIED = 1000, 40000
DECLINATION_DEG = 1.54
"""Greatest latitude of the subsolar point that counts as one that happens."""


def arcs_m(lon: Array, lat: Array, lons: Array, lats: Array) -> Array:
    """Distances on the sphere by the haversine formula."""
    lon, lat, lons, lats = (np.radians(a) for a in (lon, lat, lons, lats))
    half = (
        np.sin((lats - lat) / 2) ** 2 + np.cos(lat) * np.cos(lats) * np.sin((lons - lon) / 2) ** 2
    )
    return np.asarray(2.0 * MOON_RADIUS_M * np.arcsin(np.sqrt(half)))


def local_angles(lon: Array, lat: Array, sun: Array) -> tuple[Array, Array]:
    """Elevation and azimuth, degrees, of Suns over the places ``sun`` (2, n), by the formulas of spherical astronomy."""
    turn, declination, lat = np.radians(sun[0] - lon), np.radians(sun[1]), np.radians(lat)
    sine = np.sin(lat) * np.sin(declination) + np.cos(lat) * np.cos(declination) * np.cos(turn)
    north = np.cos(lat) * np.tan(declination) - np.sin(lat) * np.cos(turn)
    azimuth = np.degrees(np.arctan2(np.sin(turn), north)) % 360.0
    return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0))), azimuth


def displaced(lon: Array, lat: Array, away: Array, towards: Array) -> tuple[Array, Array]:
    """Places at an angle from others, in a direction from north, both in radians."""
    first = np.radians(lat)
    sine = np.sin(first) * np.cos(away) + np.cos(first) * np.sin(away) * np.cos(towards)
    turn = np.arctan2(
        np.sin(towards) * np.sin(away) * np.cos(first), np.cos(away) - np.sin(first) * sine
    )
    return lon + np.degrees(turn), np.degrees(np.arcsin(sine))


def cell_of(values: Array, start: Array, after: Array) -> Array:
    """The number of the interval of a circle in which each value lies; -1 for none."""
    wide = (start[after] - start) % 360.0
    inside = (values[:, None] - start) % 360.0 < wide
    return np.where(inside.any(axis=1), inside.argmax(axis=1), -1)


@dataclass(frozen=True)
class Level:
    """What a catalogue promises at one cell size: numbers of points and causes by place and Sun, and the footprint."""

    gsd_m: float
    footprint_m: float
    radius_m: float
    lon_deg: Array
    lat_deg: Array
    points: AnyArray  # (places, elevations, azimuths)
    cause: AnyArray


def levels(catalog: Catalog) -> Iterator[Level]:
    """SystemExit for a catalogue that promises nothing."""
    told = catalog.promise
    if told is None:
        raise SystemExit("the catalogue promises nothing")
    for k, part in enumerate(told.parts()):
        yield Level(
            told.gsd[k], told.footprint[k], told.radius[k], told.longitude[part], told.latitude[part],
            told.points[part][:, 0], told.cause[part][:, 0],
        )  # fmt: skip


def tried(catalog: Catalog, level: Level, rng: np.random.Generator) -> list[int]:
    """Of random cameras: how many there are, over places whose promise is kept, and with fewer points than stated."""
    low, start = np.asarray(catalog.sun_elevation), np.asarray(catalog.sun_azimuth)
    place = rng.integers(0, len(level.points), TRIED)
    lon, lat = level.lon_deg[place], level.lat_deg[place]
    greatest = DECLINATION_DEG
    sun = np.stack([rng.uniform(0.0, 360.0, TRIED), rng.uniform(-greatest, greatest, TRIED)])
    elevation, azimuth = local_angles(lon, lat, sun)
    row = np.searchsorted(low, elevation, side="right") - 1
    column = cell_of(azimuth, start, np.maximum(SunCells.of(low, start).after, 0))
    asked = (row >= 0) & (elevation <= low[-1]) & (column >= 0)
    asked &= level.points[place, row, column] != NO_CELL
    some = np.flatnonzero(asked)
    place, row, column, sun = place[some], row[some], column[some], sun[:, some]
    # the camera is anywhere from which its footprint holds the circle of the place
    half_m = level.footprint_m / 2.0
    away = (half_m - level.radius_m) / MOON_RADIUS_M * np.sqrt(rng.uniform(0, 1, len(some)))
    lon, lat = displaced(lon[some], lat[some], away, rng.uniform(0, 2 * np.pi, len(some)))
    rows = np.flatnonzero(catalog.gsd == level.gsd_m)
    points = catalog.longitude[rows], catalog.latitude[rows]
    camera, point = np.nonzero(arcs_m(lon[:, None], lat[:, None], *points) <= half_m)
    own_elevation, own_azimuth = local_angles(points[0][point], points[1][point], sun[:, camera])
    towards = direction_enu(own_azimuth, own_elevation)
    down = np.broadcast_to([0.0, 0.0, 1.0], towards.shape)
    answer = predict(catalog, rows[point], towards, down, np.full(len(point), level.gsd_m))
    claims = np.isfinite(answer.detection_probability)
    claimed = np.flatnonzero(np.bincount(camera, claims, len(place)) > 0)[:COUNT]
    count = np.bincount(camera, answer.usable, len(place))[claimed]
    at = place[claimed], row[claimed], column[claimed]
    met, short = level.cause[at] == Cause.MET, count < level.points[at]
    return [len(claimed), int(met.sum()), int(short.sum())]


def main(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser("python -m benchmarks.evidence promise", description=__doc__)
    parser.add_argument("catalogues", nargs="+", metavar="CATALOG.h5")
    rows: list[list[object]] = []
    for path in parser.parse_args(words).catalogues:
        catalog, rng = open_catalog(path), np.random.default_rng(7)
        for level in levels(catalog):
            rows.append([path, f"{level.gsd_m:.0f}", *tried(catalog, level, rng)])
    head = ["catalogue", "cells, m", "cameras", "promise kept there", "fewer points than stated"]
    print(table(head, rows))
    return 0
