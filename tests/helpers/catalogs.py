"""Synthetic catalogues for tests: real relief of Hadley, places on a grid, conditions by simple
rules.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
import rasterio

from lcp_catalog.catalog import integrity
from lcp_catalog.catalog.catalogue import Catalog, values
from lcp_catalog.catalog.maps import overview_levels, usable_nearby
from lcp_catalog.catalog.model import Coverage, Overview, Promise
from lcp_catalog.catalog.schema import COVERAGE_STATUS, NO_CELL, Cause, summarise_usable
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import (
    EnuFrame,
    direction_enu,
    enu_rotation,
    lonlat_to_mcmf,
    mcmf_to_lonlat,
)
from lcp_catalog.geometry.map_plane import EQUIRECTANGULAR
from lcp_catalog.landmarks.selection import Places
from lcp_catalog.production.region_maps import coverage_cells
from lcp_catalog.terrain.area import Area

from .verified import verify

HADLEY = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"
CENTER = (3.5, 26.0)
GSD_M = 118.0

ALBEDO_MAP = {
    "name": "made up",
    "encoding": "linear",
    "reference": 1.0,
    "reference_is": "given",
    "files": [{"name": "made_up.tif", "size": 1, "sha256": "0" * 64}],
}


def _points(count: int, patch: int, seed: int, step_km: float) -> dict[str, Any]:
    """Everything `Catalog` wants but the claims, as keyword arguments."""
    rng = np.random.default_rng(seed)
    frame = EnuFrame(*CENTER)
    raster, to_pixel = _hadley()
    radius = MOON_RADIUS_M

    def height(lon, lat):
        x, y = np.radians(lon) * radius, np.radians(lat) * radius
        col, row = to_pixel @ (x, y)
        return raster[
            np.clip(np.asarray(row).astype(int), 0, raster.shape[0] - 1),
            np.clip(np.asarray(col).astype(int), 0, raster.shape[1] - 1),
        ]

    side = max(1, int(np.ceil(np.sqrt(count))))
    axis = (np.arange(side) - (side - 1) / 2) * step_km * 1e3
    east, north = (a.ravel()[:count] for a in np.meshgrid(axis, -axis))
    east, north = (
        east + rng.normal(0, step_km * 120, count),
        north + rng.normal(0, step_km * 120, count),
    )
    flat = np.stack([east, north, np.zeros(count)], axis=-1)
    lon, lat, _ = mcmf_to_lonlat(frame.to_mcmf(flat))
    elevation = height(lon, lat) if count else np.zeros(0)
    dem = np.zeros((count, patch, patch), dtype=np.float32)
    offsets = (np.arange(patch) - patch // 2) * GSD_M
    for i in range(count):
        own = EnuFrame(lon[i], lat[i], elevation[i])
        px, py = np.meshgrid(offsets, -offsets)
        plon, plat, _ = mcmf_to_lonlat(own.to_mcmf(np.stack([px, py, np.zeros_like(px)], axis=-1)))
        dem[i] = own.from_mcmf(lonlat_to_mcmf(plon, plat, height(plon, plat)))[..., 2]
        dem[i] -= dem[i][patch // 2, patch // 2]
    suns = np.array([5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 75.0])
    azimuths = np.arange(0.0, 360.0, 15.0)
    condition = _conditions(rng, lat, suns, azimuths)
    lowest, highest = summarise_usable(condition, suns)
    sigma = np.sort(rng.gamma(4.0, 1.0, (count, 2)), axis=1)[:, ::-1]
    return {
        "sun_elevation": suns,
        "sun_azimuth": azimuths,
        "view_off_nadir": np.array([0.0, 30.0, 30.0]),
        "view_azimuth": np.array([0.0, 90.0, 270.0]),
        "view_altitude": np.array([np.inf, 100.0, 100.0]),
        "point_id": 110_000 * 2**20 + np.arange(count) * 37,
        "longitude": lon,
        "latitude": lat,
        "elevation": elevation,
        "position_mcmf": lonlat_to_mcmf(lon, lat, elevation),
        "rotation_mcmf_to_enu": np.array(
            [enu_rotation(o, a) for o, a in zip(lon, lat, strict=True)]
        ).reshape(-1, 3, 3),
        "gsd": np.full(count, GSD_M),
        "level": np.zeros(count, np.int32),
        "dem_product": np.array(["WAC GLD100"] * count, dtype=object),
        "elevation_sigma": np.where(np.arange(count) % 3 == 0, np.nan, 20.0),
        "dem_resolution": np.full(count, 300.0),
        "dem": dem,
        "condition": condition,
        "sun_elevation_min": lowest,
        "sun_elevation_max": highest,
        "harris_response": rng.gamma(2.0, 0.01, count),
        "localization_sigma": sigma,
        "second_peak": rng.uniform(0.3, 0.8, count),
        "false_match_probability": 10.0 ** rng.uniform(-9, -2, count),
        "gsd_min": np.full(count, GSD_M / 16),
        "gsd_max": GSD_M * rng.choice([1.0, 2.0**0.5, 2.0, 4.0], count),
        "shadow_dependence": rng.uniform(0, 0.02, count),
        "occlusion_dependence": rng.uniform(0, 0.02, count),
        "config": "[points]\npatch_nodes = 9\n",
        "sources": [{"name": HADLEY.name, "size": HADLEY.stat().st_size, "sha256": "0" * 64}],
        "scene_plan": {"decisions": []},
        "overview": _overview(frame, height, side * step_km * 500.0),
        "coverage": _coverage(rng, frame, side, step_km * 1e3, lon),
    }


@cache
def _hadley() -> tuple[np.ndarray, Any]:
    """Heights and the affine from projected metres to pixels."""
    with rasterio.open(HADLEY) as source:
        return source.read(1).astype(np.float64), ~source.transform


ERRORS = {
    "sensor_noise": 0.02,
    "height_sigma_m": 20.0,
    "height_length_m": 600.0,
    "albedo_sigma": 0.05,
    "albedo_length_m": 500.0,
    "position_sigma_m": 0.0,
    "min_detection": 0.9,
}


def arrays(count: int = 12, patch: int = 9, seed: int = 1, step_km: float = 9.0) -> dict[str, Any]:
    """Everything `Catalog` wants, as keyword arguments, so that a test can spoil one of them.

    Probabilities at scale 1 agree with the conditions, and fall with the scale; sigmas
    are some hundredths of a cell.
    """
    found, rng = _points(count, patch, seed, step_km), np.random.default_rng(seed + 100)
    condition = found["condition"]
    scales = np.array([1.0, 2.0, 4.0])
    works = condition == 31
    low = rng.uniform(0.0, 0.895, condition.shape)
    first = np.where(works, rng.uniform(0.9, 1.0, condition.shape), low)
    free = (condition & 25) == 25
    first = np.where(~free, rng.uniform(0.0, 1.0, condition.shape), first)
    detection = np.stack([first, first * 0.98, first * 0.6], axis=1)
    major = rng.uniform(0.02, 0.2, detection.shape) * GSD_M * scales[:, None, None, None]
    for array in (detection, major):
        array[np.broadcast_to((condition == 0)[:, None], array.shape)] = np.nan
    cells = found["coverage"]
    nearby = usable_nearby(
        Places(cells.longitude, cells.latitude),
        Places(found["longitude"], found["latitude"]),
        condition,
        cells.spacing_m,
    )
    return found | {
        "image_scale": scales,
        "detection_probability": detection,
        "sigma_major": major,
        "sigma_minor": major * rng.uniform(0.3, 1.0, detection.shape),
        "sigma_angle": np.where(np.isnan(major), np.nan, rng.uniform(0.0, 180.0, detection.shape)),
        "errors": dict(ERRORS),
        "coverage": replace(cells, usable=nearby),
    }


def catalog(count: int = 12, patch: int = 9, **spoilt: Any) -> Catalog:
    """A sound catalogue of ``count`` points, but for what is given by name."""
    return Catalog(**{**arrays(count, patch), **spoilt})


@cache
def content(count: int = 12) -> bytes:
    """The bytes of a catalogue's file, which is written once in a process."""
    with TemporaryDirectory() as folder:
        write_catalog(catalog(count), path := Path(folder, "c.h5"))
        return path.read_bytes()


def cells(count: int = 12) -> Coverage:
    """The spacing cells of `arrays`, of which nothing is known by condition."""
    return replace(arrays(count)["coverage"], usable=None)


def unevaluated(count: int) -> dict[str, Any]:
    """Fields of `arrays` for points of which no condition was evaluated, so that nothing is claimed."""
    shape = np.shape(arrays(count)["detection_probability"])
    nothing = np.full(shape, np.nan)
    summary = np.full((*shape[:1], shape[2], shape[4]), np.nan)
    return {
        "condition": np.zeros((shape[0], *shape[2:]), np.uint8),
        **dict.fromkeys(("sun_elevation_min", "sun_elevation_max"), summary),
        **dict.fromkeys(("detection_probability", "sigma_major", "sigma_minor"), nothing),
        "sigma_angle": nothing,
    }


def _conditions(rng, lat, suns, azimuths):
    """Evaluated where the Sun comes, usable but for low Suns from each point's own bad side, and
    some noise.
    """
    count = len(lat)
    condition = np.zeros((count, 3, len(suns), len(azimuths)), dtype=np.uint8)
    for i in range(count):
        north = direction_enu(*np.meshgrid(azimuths, suns)) @ np.array(
            [0.0, np.cos(np.radians(lat[i])), np.sin(np.radians(lat[i]))]
        )
        reachable = np.abs(np.degrees(np.arcsin(np.clip(north, -1, 1)))) < 6.0
        bad = rng.uniform(0, 360)
        away = np.abs((azimuths - bad + 180) % 360 - 180)
        for view in range(3):
            dark = (away[None, :] < rng.uniform(10, 90)) & (suns[:, None] < rng.uniform(5, 40))
            flags = np.full(reachable.shape, 31, dtype=np.uint8)
            flags[dark] &= 31 - 8
            flags[rng.random(reachable.shape) < 0.1] &= 31 - 4
            flags[suns > 70] &= 31 - 2
            if view == 1 and i % 5 == 0:
                flags &= 31 - 16
            if view == 0:
                flags[3, :] = 31  # every point works somewhere
            condition[i, view] = np.where(reachable, flags, 0)
    return condition


def _overview(frame, height, half_m):
    x = np.arange(-half_m, half_m + 1.0, 450.0)
    y = x[::-1]
    xx, yy = np.meshgrid(x, y)
    lon, lat, _ = mcmf_to_lonlat(frame.to_mcmf(np.stack([xx, yy, np.zeros_like(xx)], axis=-1)))
    z = height(lon, lat).astype(np.float32)
    z[:6, -9:] = np.nan
    return Overview(height=z, x=x, y=y, center_lon=frame.lon_deg, center_lat=frame.lat_deg)


def _coverage(rng, frame, side, step_m, lon):
    axis = (np.arange(side + 2) - (side + 1) / 2) * step_m * side / (side + 2)
    xx, yy = (a.ravel() for a in np.meshgrid(axis, -axis))
    cell_lon, cell_lat, _ = mcmf_to_lonlat(
        frame.to_mcmf(np.stack([xx, yy, np.zeros_like(xx)], axis=-1))
    )
    status = rng.choice(list(COVERAGE_STATUS), len(xx), p=[0.6, *[0.1] * 4, 0.0]).astype(np.uint8)
    return Coverage(longitude=cell_lon, latitude=cell_lat, status=status, spacing_m=step_m)


LOCATED = np.linspace(0.0, 1.0, 255)[None]
"""Probabilities by units of a made promise."""


def promised(plain: Catalog) -> Promise:
    """Random counts at 7 places; in the first view the second elevation is the worst, as it is dark."""
    rng = np.random.default_rng(1)
    shape = (7, *np.shape(plain.condition)[1:])
    points = rng.integers(0, 6, shape).astype(np.uint8)
    cause = np.where(points >= 2, Cause.MET, Cause.FEW).astype(np.uint8)
    points[:, 0, 1, 2], cause[:, 0, 1, 2] = 0, Cause.DARK
    points[rng.random(shape) < 0.2] = NO_CELL
    cause[points == NO_CELL] = NO_CELL
    return Promise(
        longitude=np.linspace(1.0, 2.0, 7),
        latitude=np.linspace(10.0, 11.0, 7),
        demand=np.full(7, 2, np.uint8),
        points=points,
        cause=cause,
        size=np.array([1, 2, 3], np.int32),
        met=np.array([0.25, 0.75, 1.0]),
        served=np.array([0.5, 0.75, 1.0]),
        places=np.array([7]),
        gsd=np.array([GSD_M]),
        per_view=np.array([2]),
        located_probability=np.zeros(1),
        units=np.ones(1, np.int64),
        located=LOCATED,
        footprint=np.array([40_000.0]),
        radius=np.array([17_000.0]),
        lower_bound=np.array([2.5]),
    )


def full(count: int = 12) -> Catalog:
    """A catalogue with levels of its maps and two promises: all groups that a file can have."""
    plain = catalog(count)
    rng, shape = np.random.default_rng(7), np.shape(plain.condition)[1:]
    lon, lat, step_m = coverage_cells(Area.from_bounds(-180.0, -90.0, 180.0, 90.0), 4e5, 400)
    cells = Coverage(
        longitude=lon,
        latitude=lat,
        status=rng.integers(0, 6, len(lon)).astype(np.uint8),
        spacing_m=plain.coverage.spacing_m,
        usable=rng.choice(np.array([0, 1, 255], np.uint8), (len(lon), *shape)),
        step_m=step_m,
    )
    x, y = np.arange(-32.0, 32.0) * 1.7e5, np.arange(16.0, -16.0, -1.0) * 1.7e5
    height = rng.normal(0.0, 2e3, (len(y), len(x))).astype(np.float32)
    overview = Overview(height, x, y, 0.0, 0.0, EQUIRECTANGULAR)
    nothing = np.zeros(0)
    told = replace(
        promised(plain),
        size=nothing.astype(np.int32),
        met=nothing,
        served=nothing,
        places=np.array([3, 4]),
        gsd=np.array([GSD_M, 2.0 * GSD_M]),
        per_view=np.array([2, 2]),
        located_probability=np.zeros(2),
        units=np.ones(2, np.int64),
        located=np.repeat(LOCATED, 2, axis=0),
        footprint=np.array([20_000.0, 40_000.0]),
        radius=np.array([8_000.0, 17_000.0]),
        lower_bound=np.array([1.0, 1.5]),
    )
    return replace(
        plain,
        overview=overview,
        overview_levels=overview_levels(overview),
        coverage=cells,
        promise=told,
    )


def noticed_damage(
    whole: Path, sound: dict[str, Any], turned: Path, seed: int, count: int = 60
) -> int:
    """Of so many files with one byte turned each: how many `verify` finds fault with. Where it finds none,
    AssertionError unless what is read is ``sound`` all the same.
    """
    content, noticed = whole.read_bytes(), 0
    for offset in np.random.default_rng(seed).integers(0, len(content), count):
        damaged = bytearray(content)
        damaged[offset] ^= 0xFF
        turned.write_bytes(damaged)
        if verify(turned):
            noticed += 1
            continue
        for name, array in values(open_catalog(turned)).items():
            np.testing.assert_array_equal(array, sound[name], err_msg=name)
    return noticed


def sign(file: h5py.File) -> None:
    """Give an open file the digests of its content, as if it had been written so."""
    table = file[f"{integrity.INTEGRITY}/{integrity.TABLE}"]
    digests = [
        integrity.chunk_digest(stored, mask)
        for path, grid in integrity._grids(integrity._members(file)).items()
        for number in range(grid.first, grid.first + len(grid))
        for mask, stored in [file[path].id.read_direct_chunk(grid.offset(number))]
    ]
    if table.shape == (len(digests), integrity.DIGEST_BYTES):
        table[...] = np.frombuffer(b"".join(digests), np.uint8).reshape(table.shape)
    file.attrs[integrity.CONTENT] = integrity.content_digest(file, table[()])
