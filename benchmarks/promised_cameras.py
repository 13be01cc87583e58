"""Random cameras over built regions: each sees at least the points that its place is promised, level by level.

    python benchmarks/promised_cameras.py CATALOG.h5 ...

For each level 1000 random places at which something is promised, each under a random Sun of a random cell of the grid that can
happen there and for which any point near makes a claim; the Sun has the same angles at all points. Points within half a footprint
(haversine formula) are counted that `predict` calls usable straight down.
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

COUNT, TRIED = 1000, 12000
DECLINATION_DEG = 1.54
"""Greatest latitude of the subsolar point that counts as one that happens."""


def arcs_m(lon: np.ndarray, lat: np.ndarray, lons: np.ndarray, lats: np.ndarray) -> np.ndarray:
    """Distances on the sphere by the haversine formula."""
    lon, lat, lons, lats = (np.radians(a) for a in (lon, lat, lons, lats))
    half = (
        np.sin((lats - lat) / 2) ** 2 + np.cos(lat) * np.cos(lats) * np.sin((lons - lon) / 2) ** 2
    )
    return np.asarray(2.0 * MOON_RADIUS_M * np.arcsin(np.sqrt(half)))


def main() -> None:
    print("| catalogue | cells, m | cameras | promise kept there | fewer points than stated |")
    print("| --- | ---: | ---: | ---: | ---: |")
    for path in sys.argv[1:]:
        catalog = open_catalog(path)
        found = single_promises(catalog)
        if found is None:
            raise SystemExit(f"{path}: promises nothing")
        told, own = found
        grid, rng = (
            SunCells.of(catalog.sun_elevation, catalog.sun_azimuth),
            np.random.default_rng(7),
        )
        high = np.asarray(catalog.sun_elevation)[np.asarray(grid.above)]
        for part, gsd, footprint, radius in zip(
            own.parts(), own.gsd, own.footprint, own.radius, strict=True
        ):
            stored, cause = told.points[part][:, 0], told.cause[part][:, 0]
            cells = np.argwhere(stored != NO_CELL)
            place, row, column = cells[rng.integers(0, len(cells), TRIED)].T
            elevation = rng.uniform(np.asarray(catalog.sun_elevation)[row], high[row])
            start = np.asarray(catalog.sun_azimuth)[column]
            step = (np.asarray(catalog.sun_azimuth)[np.asarray(grid.after)[column]] - start) % 360.0
            azimuth = np.radians(start + rng.uniform(0.0, 1.0, TRIED) * step)
            # the camera is anywhere from which its footprint holds the circle of the place
            slack = np.degrees((footprint / 2.0 - radius) / MOON_RADIUS_M)
            lat = told.latitude[part][place] + rng.uniform(-0.7, 0.7, TRIED) * slack
            lon = told.longitude[part][place] + rng.uniform(-0.7, 0.7, TRIED) * slack / np.cos(
                np.radians(lat)
            )
            sine = np.sin(np.radians(lat)) * np.sin(np.radians(elevation)) + np.cos(
                np.radians(lat)
            ) * np.cos(np.radians(elevation)) * np.cos(azimuth)
            happens = np.flatnonzero(np.abs(sine) <= np.sin(np.radians(DECLINATION_DEG)))
            lon, lat, elevation, azimuth, place, row, column = (
                values[happens] for values in (lon, lat, elevation, azimuth, place, row, column)
            )
            rows = np.flatnonzero(catalog.gsd == gsd)
            seen = arcs_m(
                lon[:, None], lat[:, None], catalog.longitude[rows], catalog.latitude[rows]
            )
            camera, point = np.nonzero(seen <= footprint / 2.0)
            e, a = np.radians(elevation)[camera], azimuth[camera]
            towards = np.stack([np.sin(a), np.cos(a), np.tan(e)], axis=1)
            towards /= np.linalg.norm(towards, axis=1, keepdims=True)
            down = np.broadcast_to([0.0, 0.0, 1.0], towards.shape)
            found_there = predict(catalog, rows[point], towards, down, np.full(len(point), gsd))
            claims = np.isfinite(found_there.detection_probability)
            claimed = np.flatnonzero(np.bincount(camera, claims, len(place)) > 0)[:COUNT]
            count = np.bincount(camera, found_there.usable, len(place))[claimed]
            place, row, column = place[claimed], row[claimed], column[claimed]
            met = cause[place, row, column] == Cause.MET
            short = count < stored[place, row, column]
            print(
                f"| {path} | {gsd:.0f} | {len(claimed)} | {met.sum()} | {short.sum()} |", flush=True
            )


if __name__ == "__main__":
    main()
