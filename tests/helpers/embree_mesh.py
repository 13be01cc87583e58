"""A DEM's own nodes as triangles in MCMF, traced by Embree: shadows that no code of ours computed.

Nothing here uses the library. Pixels and map come from rasterio, places from closed forms of the sphere that pyproj judges
(tests/test_embree_mesh.py), hits from Embree 4. Embree counts in float32, so the mesh is moved, in float64 and without turning
it, to an origin near the area before it is handed over: at 160 km from there a coordinate's step is 0.016 m.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import ArrayLike, NDArray
from rasterio.io import MemoryFile

pytest.importorskip("embreex", reason="Embree has wheels for Linux and Windows on x86-64 only")

from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from lcp_catalog.arrays import Array, Mask

RADIUS_M = 1_737_400.0
LIFT_M = 0.2
"""A ray to the Sun starts so far above the mesh: ten times the rounding of its float32 start."""
DROP_M = 8000.0
"""A node is looked for on the mesh from so far above its own height; ground is met once only."""


def mcmf(lon_deg: ArrayLike, lat_deg: ArrayLike, height_m: ArrayLike = 0.0) -> Array:
    """Metres (..., 3): x to longitude 0, y to 90 degrees east, z to the north pole."""
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    from_centre = RADIUS_M + np.asarray(height_m)
    unit = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.stack([from_centre * axis for axis in unit], axis=-1)


def enu_axes(lon_deg: float, lat_deg: float) -> Array:
    """East, north and up at a place, rows of (3, 3), in MCMF axes: the derivatives of `mcmf`."""
    lon = np.radians(lon_deg)
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    up = mcmf(lon_deg, lat_deg) / RADIUS_M
    return np.stack([east, np.cross(up, east), up])


def sun_direction(
    lon_deg: float, lat_deg: float, azimuth_deg: float, elevation_deg: float
) -> Array:
    """Unit MCMF direction to a Sun seen from a place; azimuth clockwise from north."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    level = np.cos(elevation)
    enu = [level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)]
    return enu @ enu_axes(lon_deg, lat_deg)


def map_to_lonlat(crs: rasterio.CRS, x_m: Array, y_m: Array) -> tuple[Array, Array]:
    """Degrees of places on an equirectangular or a polar stereographic map of the Moon's sphere.

    Snyder (1987), Map Projections: equations 12-4 to 12-6 and 20-14 to 20-18, the latter with the scale 1 at the pole.
    """
    given = crs.to_dict()
    assert given["R"] == RADIUS_M
    assert given.get("x_0", 0) == 0
    assert given.get("y_0", 0) == 0
    lon_0 = given.get("lon_0", 0.0)
    if given["proj"] == "eqc":
        assert given.get("lat_0", 0) == 0
        along = RADIUS_M * np.cos(np.radians(given.get("lat_ts", 0.0)))
        return lon_0 + np.degrees(x_m / along), np.degrees(y_m / RADIUS_M)
    assert given["proj"] == "stere"
    assert abs(given["lat_0"]) == 90
    assert given.get("k", 1) == 1
    sign = np.sign(given["lat_0"])
    polar_distance = np.degrees(2.0 * np.arctan(np.hypot(x_m, y_m) / (2.0 * RADIUS_M)))
    return lon_0 + np.degrees(np.arctan2(x_m, -sign * y_m)), sign * (90.0 - polar_distance)


@dataclass(frozen=True, eq=False)
class Nodes:
    """A DEM's pixel centres: degrees and metres, each (rows, cols), NaN without a height."""

    lon_deg: Array
    lat_deg: Array
    height_m: Array
    is_ring: bool  # the last column's neighbour is the first
    pole: int  # 1 or -1: the first or last row goes around that pole at half a pixel; 0: none does


def read_nodes(path: Path, lon_deg: float, lat_deg: float, reach_m: float) -> Nodes:
    """The nodes of a raster within ``reach_m`` of a place (the rest is NaN or left out)."""
    with rasterio.open(path) as dataset:
        crs, to_map, shape = dataset.crs, dataset.transform, dataset.shape
        x = to_map.c + to_map.a * (np.arange(shape[1]) + 0.5)
        y = to_map.f + to_map.e * (np.arange(shape[0]) + 0.5)
        rows, cols, ring, pole = slice(None), np.arange(shape[1]), False, 0
        if crs.to_dict()["proj"] == "eqc":
            lon, lat = map_to_lonlat(crs, x, y)
            ring = bool(np.isclose(abs(lon[1] - lon[0]) * len(lon), 360.0))
            reach = np.degrees(reach_m / RADIUS_M)
            kept = np.flatnonzero(np.abs(lat - lat_deg) <= reach)
            rows = slice(kept[0], kept[-1] + 1)
            for sign, row in ((1, 0), (-1, shape[0] - 1)):
                touches = np.isclose(abs(lat[row]) + abs(lat[1] - lat[0]) / 2, 90.0)
                pole = sign if ring and touches and row in kept and sign * lat[row] > 0 else pole
            if abs(lat_deg) + reach < 90.0:
                away = (lon - lon_deg + 180.0) % 360.0 - 180.0
                half = np.degrees(
                    np.arcsin(np.sin(np.radians(reach)) / np.cos(np.radians(lat_deg)))
                )
                cols = np.argsort(away, kind="stable")
                cols, ring = cols[np.abs(away[cols]) <= half], False
        values = dataset.read(1)[rows][:, cols].astype(np.float64)
        nodata = dataset.nodata
    values[~np.isfinite(values)] = np.nan
    if nodata is not None:
        values[values == nodata] = np.nan
    lon, lat = map_to_lonlat(crs, *np.meshgrid(x[cols], y[rows]))
    return Nodes(lon, lat, values, ring, pole)


def triangles(nodes: Nodes) -> tuple[NDArray[np.int32], Array]:
    """Corners (n, 3) of both triangles of every quadrilateral of nodes, the last column joined to the first around a ring,
    a fan over the pole; and the fan's own height, or NaN. Triangles with a missing node are left out.
    """
    rows, cols = nodes.height_m.shape
    number = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    if nodes.is_ring:
        number = np.concatenate([number, number[:, :1]], axis=1)
    nw, ne, sw, se = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    corners = [np.stack([nw, sw, se], -1).reshape(-1, 3), np.stack([nw, se, ne], -1).reshape(-1, 3)]
    missing = np.append(np.isnan(nodes.height_m.ravel()), False)
    top = np.nan
    if nodes.pole:
        rim = number[0 if nodes.pole > 0 else -1]
        top = np.nanmean(nodes.height_m[0 if nodes.pole > 0 else -1])
        fan = np.stack([np.full(len(rim) - 1, rows * cols, np.int32), rim[:-1], rim[1:]], -1)
        corners.append(fan)
    corners = [part[~missing[part].any(axis=1)] for part in corners]
    return np.concatenate(corners), np.asarray(top)


class Mesh:
    """A DEM's surface in MCMF axes around an origin (MCMF metres, float64), as Embree holds it."""

    def __init__(self, nodes: Nodes, origin_m: Array) -> None:
        corners, top = triangles(nodes)
        places = mcmf(nodes.lon_deg, nodes.lat_deg, nodes.height_m).reshape(-1, 3)
        pole = mcmf(0.0, 90.0 * (nodes.pole or 1), np.nan_to_num(top))
        local = np.nan_to_num(np.append(places, pole[None], axis=0) - origin_m)
        self.origin_m, self.count = origin_m, len(corners)
        self.scene = EmbreeScene(robust=True)
        TriangleMesh(self.scene, local.astype(np.float32), corners)

    @classmethod
    def of(cls, path: Path, lon_deg: float, lat_deg: float, reach_m: float) -> Mesh:
        """The DEM within ``reach_m`` of a place."""
        return cls(read_nodes(path, lon_deg, lat_deg, reach_m), mcmf(lon_deg, lat_deg))

    def below(self, points_m: Array) -> tuple[Array, Array, Mask]:
        """Where the plumb lines of MCMF points (n, 3) meet the mesh: points, unit normals outwards, whether they do."""
        up = points_m / np.linalg.norm(points_m, axis=-1, keepdims=True)
        start = points_m - self.origin_m + DROP_M * up
        hit = self.scene.run(start.astype(np.float32), -up.astype(np.float32), output=True)
        found = hit["primID"] >= 0
        normal = hit["Ng"].astype(np.float64)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
        normal *= np.sign(np.sum(normal * up, axis=-1, keepdims=True))
        meets = points_m + (DROP_M - hit["tfar"].astype(np.float64))[:, None] * up
        return np.where(found[:, None], meets, np.nan), normal, found

    def lit(self, points_m: Array, sun: Array) -> tuple[Mask, Mask, Array]:
        """Whether the ground at points (n, 3) sees a point Sun in a direction, and faces it; which points have ground;
        how much higher than the mesh they lie, metres.
        """
        on_mesh, normal, found = self.below(points_m)
        up = points_m / np.linalg.norm(points_m, axis=-1, keepdims=True)
        start = np.nan_to_num(on_mesh - self.origin_m + LIFT_M * up).astype(np.float32)
        toward = np.broadcast_to(sun, start.shape).astype(np.float32)
        free = self.scene.run(start, toward, query="OCCLUDED") < 0
        above = np.sum((points_m - on_mesh) * up, axis=-1)
        return free & (normal @ sun > 0.0) & found, found, above


@dataclass(frozen=True, eq=False)
class Product:
    """What a user finds in the file of ``lcp render``: bands (rows, cols) and the nodes' places, MCMF metres (rows, cols, 3)."""

    sunlit: Array
    height_m: Array
    places_m: Array
    sun_mcmf: Array

    @classmethod
    def read(cls, encoded: bytes) -> Product:
        """From the GeoTIFF's bytes: its bands by name, its transform, its tags."""
        with MemoryFile(encoded) as file, file.open() as dataset:
            bands = dict(zip(dataset.descriptions, dataset.read().astype(np.float64), strict=True))
            tags, to_map = dataset.tags(), dataset.transform
        lon, lat = float(tags["center_lon"]), float(tags["center_lat"])
        rows, cols = bands["height"].shape
        x = to_map.c + to_map.a * (np.arange(cols) + 0.5)
        y = to_map.f + to_map.e * (np.arange(rows) + 0.5)
        enu = np.stack([*np.meshgrid(x, y), bands["height"]], axis=-1)
        places = enu @ enu_axes(lon, lat) + mcmf(lon, lat)
        sun = np.array([float(v) for v in tags["sun_direction_mcmf"].strip("[]").split(",")])
        return cls(bands["sunlit"], bands["height"], places, sun)


@dataclass(frozen=True)
class Agreement:
    """Two masks of lit nodes compared, shares of 0..1."""

    nodes: int
    dark: float  # in the judge's mask
    near_edge: float  # within one node of a lit or dark edge of either mask, and so left out
    away: float  # agreement of the others
    away_from_judges: float  # agreement of those away from the edges of the judge's mask alone
    total: float  # agreement of all
    height_rms_m: float  # the product's nodes against the mesh


def beside_edge(lit: Mask) -> Mask:
    """Nodes that have one of the other kind among their eight neighbours."""
    padded = np.pad(lit, 1, mode="edge")
    rows, cols = lit.shape
    around = [padded[i : i + rows, j : j + cols] for i in range(3) for j in range(3)]
    return np.any(around, axis=0) & ~np.all(around, axis=0)


def agreement(product: Product, mesh: Mesh, sun: Array) -> Agreement:
    """The file of a render against the mesh under a Sun in an MCMF direction."""
    shape = product.sunlit.shape
    given = np.isfinite(product.height_m).ravel()
    points = np.where(given[:, None], product.places_m.reshape(-1, 3), mesh.origin_m)
    lit, found, above = (values.reshape(shape) for values in mesh.lit(points, sun))
    ours, judged = product.sunlit > 0.5, found & given.reshape(shape)
    unclear = beside_edge(lit)
    left_out = beside_edge(ours) | unclear
    same = ours == lit
    return Agreement(
        nodes=int(judged.sum()),
        dark=float(np.mean(~lit[judged])),
        near_edge=float(np.mean(left_out[judged])),
        away=float(np.mean(same[judged & ~left_out])),
        away_from_judges=float(np.mean(same[judged & ~unclear])),
        total=float(np.mean(same[judged])),
        height_rms_m=float(np.sqrt(np.mean(above[judged] ** 2))),
    )
