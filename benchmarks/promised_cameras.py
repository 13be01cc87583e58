"""Random cameras over built regions: each sees at least the points that its place is promised, level by level.

    python benchmarks/promised_cameras.py CATALOG.h5 ...

For each level 1000 random cameras near places at which something is promised, each at a moment: the Sun stands over a
random place within 1.54 degrees of the equator, far away, and has at each point the elevation and azimuth of that point.
Moments count if something is promised for the Sun's angles at the camera's place and any point near makes a claim.
Points within half a footprint (haversine formula) are counted that `predict` calls usable straight down.
"""

from __future__ import annotations

import sys

import numpy as np

from lcp_catalog import open_catalog
from lcp_catalog.catalog.prediction import predict
from lcp_catalog.catalog.promise import single_promises
from lcp_catalog.catalog.schema import NO_CELL, Cause
from lcp_catalog.catalog.sun_cells import SunCells
from lcp_catalog.constants import MOON_RADIUS_M

COUNT, TRIED = 1000, 40000
DECLINATION_DEG = 1.54
"""Greatest latitude of the subsolar point that counts as one that happens."""


def arcs_m(lon: np.ndarray, lat: np.ndarray, lons: np.ndarray, lats: np.ndarray) -> np.ndarray:
    """Distances on the sphere by the haversine formula."""
    lon, lat, lons, lats = (np.radians(a) for a in (lon, lat, lons, lats))
    half = (
        np.sin((lats - lat) / 2) ** 2 + np.cos(lat) * np.cos(lats) * np.sin((lons - lon) / 2) ** 2
    )
    return np.asarray(2.0 * MOON_RADIUS_M * np.arcsin(np.sqrt(half)))


def local_angles(
    lon: np.ndarray, lat: np.ndarray, sun: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Elevation and azimuth, degrees, of Suns over the places ``sun`` (2, n), by the formulas of spherical astronomy."""
    turn, declination, lat = np.radians(sun[0] - lon), np.radians(sun[1]), np.radians(lat)
    sine = np.sin(lat) * np.sin(declination) + np.cos(lat) * np.cos(declination) * np.cos(turn)
    north = np.cos(lat) * np.tan(declination) - np.sin(lat) * np.cos(turn)
    azimuth = np.degrees(np.arctan2(np.sin(turn), north)) % 360.0
    return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0))), azimuth


def displaced(
    lon: np.ndarray, lat: np.ndarray, away: np.ndarray, towards: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places at an angle from others, in a direction from north, both in radians."""
    first = np.radians(lat)
    sine = np.sin(first) * np.cos(away) + np.cos(first) * np.sin(away) * np.cos(towards)
    turn = np.arctan2(
        np.sin(towards) * np.sin(away) * np.cos(first), np.cos(away) - np.sin(first) * sine
    )
    return lon + np.degrees(turn), np.degrees(np.arcsin(sine))


def cell_of(values: np.ndarray, start: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The number of the interval of a circle in which each value lies; -1 for none."""
    wide = (start[after] - start) % 360.0
    inside = (values[:, None] - start) % 360.0 < wide
    return np.where(inside.any(axis=1), inside.argmax(axis=1), -1)


def main() -> None:
    print("| catalogue | cells, m | cameras | promise kept there | fewer points than stated |")
    print("| --- | ---: | ---: | ---: | ---: |")
    for path in sys.argv[1:]:
        catalog = open_catalog(path)
        found = single_promises(catalog)
        if found is None:
            raise SystemExit(f"{path}: promises nothing")
        told, own = found
        rng = np.random.default_rng(7)
        low, start = np.asarray(catalog.sun_elevation), np.asarray(catalog.sun_azimuth)
        grid = SunCells.of(low, start)
        for part, gsd, footprint, radius in zip(
            own.parts(), own.gsd, own.footprint, own.radius, strict=True
        ):
            stored, cause = told.points[part][:, 0], told.cause[part][:, 0]
            place = rng.integers(0, len(stored), TRIED)
            lon, lat = told.longitude[part][place], told.latitude[part][place]
            sun = np.stack(
                [
                    rng.uniform(0.0, 360.0, TRIED),
                    rng.uniform(-DECLINATION_DEG, DECLINATION_DEG, TRIED),
                ]
            )
            elevation, azimuth = local_angles(lon, lat, sun)
            row = np.searchsorted(low, elevation, side="right") - 1
            column = cell_of(azimuth, start, np.maximum(grid.after, 0))
            asked = (row >= 0) & (elevation <= low[-1]) & (column >= 0)
            asked &= stored[place, row, column] != NO_CELL
            some = np.flatnonzero(asked)
            place, row, column, sun = place[some], row[some], column[some], sun[:, some]
            # the camera is anywhere from which its footprint holds the circle of the place
            away = (
                (footprint / 2.0 - radius) / MOON_RADIUS_M * np.sqrt(rng.uniform(0, 1, len(some)))
            )
            lon, lat = displaced(lon[some], lat[some], away, rng.uniform(0, 2 * np.pi, len(some)))
            rows = np.flatnonzero(catalog.gsd == gsd)
            points = catalog.longitude[rows], catalog.latitude[rows]
            camera, point = np.nonzero(
                arcs_m(lon[:, None], lat[:, None], *points) <= footprint / 2.0
            )
            own_elevation, own_azimuth = local_angles(
                points[0][point], points[1][point], sun[:, camera]
            )
            e, a = np.radians(own_elevation), np.radians(own_azimuth)
            towards = np.stack([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)], axis=1)
            down = np.broadcast_to([0.0, 0.0, 1.0], towards.shape)
            pixel = np.full(len(point), gsd)
            answer = predict(catalog, rows[point], towards, down, pixel)
            claims = np.isfinite(answer.detection_probability)
            claimed = np.flatnonzero(np.bincount(camera, claims, len(place)) > 0)[:COUNT]
            count = np.bincount(camera, answer.usable, len(place))[claimed]
            place, row, column = place[claimed], row[claimed], column[claimed]
            met = cause[place, row, column] == Cause.MET
            short = count < stored[place, row, column]
            print(
                f"| {path} | {gsd:.0f} | {len(claimed)} | {met.sum()} | {short.sum()} |", flush=True
            )


if __name__ == "__main__":
    main()
