"""Synthetic catalogues that overlap, for tests of their merge."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.schema import summarise_usable, usable
from lcp_catalog.catalog.stored import StoredFile, stored_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import enu_rotation, lonlat_to_mcmf
from lcp_catalog.landmarks.selection import stable_id

from . import catalogs

SPACING_M = 6000.0
SOUTH, NORTH = 24.9, 27.1
BOX = "[area]\nbounds_deg = [{}, {}, {}, {}]\ngsd_m = {}\n"
POINTS = "[points]\npatch_nodes = 9\nspacing_m = {}\nsearch_m = {}\n"


def config(
    west: float, east: float, gsd_m: float = catalogs.GSD_M, spacing_m: float = SPACING_M
) -> str:
    """What a build stores of its region and its lengths."""
    area = BOX.format(west, SOUTH, east, NORTH, gsd_m)
    return area + POINTS.format(spacing_m, 64.0 * gsd_m)


def moved(catalog: Catalog, lon: np.ndarray, lat: np.ndarray) -> Catalog:
    """The points at other places."""
    return replace(
        catalog,
        point_id=stable_id(lon, lat),
        longitude=lon,
        latitude=lat,
        position_mcmf=lonlat_to_mcmf(lon, lat, catalog.elevation),
        rotation_mcmf_to_enu=enu_rotation(lon, lat),
    )


@cache
def whole(count: int = 64) -> Catalog:
    """A catalogue of the region, its points under the ids of their places; made once."""
    found = catalogs.catalog(count)
    return moved(found, found.longitude, found.latitude)


def part(catalog: Catalog, west: float, east: float) -> Catalog:
    """The catalogue of a part of the region, as if it had been built alone."""
    found = catalog.within(west, SOUTH, east, NORTH)
    cells = replace(found.coverage, spacing_m=SPACING_M)
    return replace(found, coverage=cells, config=config(west, east))


def disturbed(catalog: Catalog, seed: int) -> Catalog:
    """Half of the points some km away, some others in fewer usable conditions."""
    dice = np.random.default_rng(seed)
    count = len(catalog)
    away = dice.normal(0.0, 0.08, (2, count)) * (dice.random(count) < 0.5)
    found = moved(catalog, catalog.longitude + away[0], catalog.latitude + away[1])
    flags = found.condition.copy()
    worse = (dice.random(count) < 0.5)[:, None, None] & (flags[:, 2] == 31)
    flags[:, 2][worse] = 31 - 16
    lowest, highest = summarise_usable(flags, found.sun_elevation)
    return replace(found, condition=flags, sun_elevation_min=lowest, sun_elevation_max=highest)


def distances_m(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Distances (n, m) between places (n, 2) and (m, 2), degrees, by the haversine formula."""
    lon, lat = np.radians(here.T)[:, :, None]
    lon2, lat2 = np.radians(there.T)[:, None, :]
    half = np.sin((lat2 - lat) / 2.0) ** 2
    half = half + np.cos(lat) * np.cos(lat2) * np.sin((lon2 - lon) / 2.0) ** 2
    return 2.0 * MOON_RADIUS_M * np.arcsin(np.sqrt(half))


def places(catalog: Catalog) -> np.ndarray:
    """Longitude and latitude, (n, 2)."""
    return np.stack([catalog.longitude, catalog.latitude], axis=1)


def chosen_by_search(inputs: list[Catalog], spacing_m: float) -> dict[int, tuple[int, int]]:
    """By id the input and row of the points that a greedy choice keeps: most usable conditions first,
    then the smallest sigma, then the lowest id.
    """
    ranked = sorted(
        (
            (
                -int(usable(one.condition[row]).sum()),
                float(one.localization_sigma[row, 0]),
                int(one.point_id[row]),
                number,
                row,
            )
            for number, one in enumerate(inputs)
            for row in range(len(one))
        )
    )
    every = [places(one) for one in inputs]
    found: dict[int, tuple[int, int]] = {}
    for _, _, own, number, row in ranked:
        there = np.array([every[k][r] for k, r in found.values()]).reshape(-1, 2)
        near = distances_m(every[number][[row]], there)[0]
        if own not in found and all(away >= spacing_m for away in near):
            found[own] = (number, row)
    return found


def read(path: Path | str) -> Catalog:
    """A file that a test wrote, unchecked: a check takes a process, and has tests of its own."""
    return stored_catalog(StoredFile.of(path))


def written(folder: Path, inputs: list[Catalog], first: str = "a") -> list[Path]:
    paths = [folder / f"{chr(ord(first) + k)}.h5" for k in range(len(inputs))]
    for path, catalog in zip(paths, inputs, strict=True):
        write_catalog(catalog, path)
    return paths


def neighbours() -> list[Catalog]:
    """Two neighbours that overlap by a third, with other points and flags in the second."""
    every = whole()
    east = disturbed(part(every, 3.2, 4.9), seed=5)
    cells = replace(east.coverage, status=np.roll(east.coverage.status, 3))
    return [part(every, 2.1, 3.9), replace(east, coverage=cells)]
