"""The flight file (``.lcpf``): points, patches and claims in one fixed little-endian layout that a program on board reads
by offsets alone. Byte by byte: docs/reference/flight-file.md.

Header, tables, index of tiles, points. A tile is a run of points that lie together, so that those of a footprint are
found in the index and read as a block; every part has a CRC-32 of its own.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import AnyArray, Array, Bytes, Index, Mask
from ..catalog.catalogue import Catalog
from ..catalog.point_errors import slope_sigma
from ..catalog.prediction import ViewMesh, view_plane
from ..catalog.schema import (
    DETECTION_STEP,
    EVALUATED,
    PACKED,
    UNOCCLUDED,
    UNSHADOWED,
    reaches,
)
from ..catalog.stored import content_sha256
from ..catalog.summary import Statistics, bounds, percent
from ..choices import FRAMES
from ..constants import MOON_RADIUS_M
from ..errors import AreaError, CatalogError
from ..geometry.frames import mcmf_to_lonlat
from .points import ExportedPoints

MAGIC = b"LCPF\r\n\x1a\n"
VERSION = 1
TILE_POINTS = 64
"""Most points of a tile."""
STEPS = {"heights": 32767, "albedo": 127}
"""Most steps from the middle of a patch's values."""
ANGLE_STEPS = 128
"""Directions of an ellipse's major axis in 180 deg; `DEPENDENT` is added to their number."""
DEPENDENT = 128
"""The condition is shadowed or occluded by terrain outside the patch."""
NONE = 255
"""Value of a byte of a claim that is not made."""
NO_SUN = 65535

HEADER = np.dtype(
    [
        ("magic", "S8"), ("version", "<u4"), ("header_bytes", "<u4"), ("file_bytes", "<u8"),
        ("points", "<u4"), ("tiles", "<u4"), ("point_bytes", "<u4"), ("nodes", "<u2"),
        ("scales", "<u2"), ("suns", "<u2"), ("views", "<u2"), ("elevations", "<u2"),
        ("azimuths", "<u2"), ("frame", "<u2"), ("albedo", "<u2"), ("tables_crc", "<u4"),
        ("index_crc", "<u4"), ("worst_height_m", "<f4"), ("min_detection", "<f4"),
        ("probability_step", "<f4"), ("sigma_log_least", "<f8"), ("sigma_log_step", "<f8"),
        ("radius_m", "<f8"), ("position_sigma_m", "<f4"), ("catalog_sha256", "V32"),
        ("triangles", "<u2"), ("zero", "<u2"), ("albedo_sigma", "<f4"), ("slope_sigma", "<f4"),
        ("spare", "V44"), ("crc", "<u4"),
    ]
)  # fmt: skip
TILE = np.dtype("3<f8, <f4, <u4, <u4, <u4")
TILE.names = ("centre_m", "radius_m", "first", "count", "crc")
_HEAD = [
    ("point_id", "<i8"), ("position_m", "<f8", 3), ("rotation", "<f4", (3, 3)), ("gsd_m", "<f4"),
    ("heights_middle", "<f4"), ("heights_step", "<f4"), ("albedo_middle", "<f4"), ("albedo_step", "<f4"),
    ("elevation_sigma_m", "<f4"), ("level", "<u2"), ("spare", "<u2"),
]  # fmt: skip


def tables_type(header: Any) -> np.dtype[Any]:
    """The tables, with bytes up to a multiple of 8."""
    e, a, v, s = (int(header[name]) for name in ("elevations", "azimuths", "views", "scales"))
    return _padded(8, [
        ("sun_elevation_deg", "<f4", e), ("sun_azimuth_deg", "<f4", a),
        ("view_off_nadir_deg", "<f4", v), ("view_azimuth_deg", "<f4", v),
        ("view_altitude_km", "<f4", v), ("image_scale", "<f4", s), ("sun_number", "<u2", (e, a)),
        ("triangles", "u1", (int(header["triangles"]), 3)),
    ])  # fmt: skip


def point_type(header: Any) -> np.dtype[Any]:
    """A point: its numbers, heights, albedo if there is any, claims, and bytes up to a multiple of 4."""
    square = (int(header["nodes"]),) * 2
    claims = (*(int(header[name]) for name in ("scales", "suns", "views")), 4)
    albedo: list[Any] = [("albedo", "i1", square)] if header["albedo"] else []
    return _padded(4, [*_HEAD, ("heights", "<i2", square), *albedo, ("claims", "u1", claims)])


def _padded(multiple: int, fields: list[Any]) -> np.dtype[Any]:
    missing = -np.dtype(fields).itemsize % multiple
    return np.dtype([*fields, ("pad", f"V{missing}")] if missing else fields)


@dataclass(frozen=True, eq=False)
class KeptConditions:
    """The part of a catalogue that is written: rows of its points, True for the views (v,) and Suns (e, a)."""

    rows: Index
    views: Mask
    suns: Mask


def write_flight(
    points: ExportedPoints, path: Path, kept: KeptConditions | None = None, scale: int | None = None
) -> None:
    """Points in tiles, with claims of the Suns for which any of them has one. ``scale``: index of the only
    image scale; None: all. AreaError for points without any claim.
    """
    catalog = points.catalog
    tiles = _tiled(points.position_m)
    views = np.flatnonzero(
        np.ones(len(catalog.view_off_nadir), bool) if kept is None else kept.views
    )
    scales = np.arange(len(catalog.image_scale)) if scale is None else np.array([scale])
    suns, least, largest = _extent(points, views, scales)
    suns = suns if kept is None else suns & kept.suns
    if not suns.any() or not len(views):
        raise AreaError("no point has a claim under any Sun and view")
    triangles, errors = _triangles(catalog, views), catalog.errors
    number = np.full(suns.shape, NO_SUN, np.uint16)
    number[suns] = np.arange(suns.sum())
    header = np.zeros((), HEADER)
    for name, value in {
        "magic": MAGIC, "version": VERSION, "header_bytes": HEADER.itemsize, "points": len(points),
        "tiles": len(tiles), "nodes": catalog.patch_nodes, "scales": len(scales),
        "suns": suns.sum(), "views": len(views), "elevations": suns.shape[0],
        "azimuths": suns.shape[1], "frame": FRAMES.index(points.frame.name),
        "albedo": catalog.albedo_map is not None, "min_detection": catalog.min_detection,
        "probability_step": DETECTION_STEP, "sigma_log_least": np.log(least),
        "sigma_log_step": np.log(largest / least) / (NONE - 1), "radius_m": MOON_RADIUS_M,
        "position_sigma_m": float(points.sigma_m[0].max()),
        "triangles": len(triangles), "albedo_sigma": float(errors.get("albedo_sigma", 0.0)),
        "slope_sigma": float(np.median(slope_sigma(catalog, points.rows))),
        "catalog_sha256": bytes.fromhex(content_sha256(catalog) if catalog.path else "00" * 32),
    }.items():  # fmt: skip
        header[name] = value
    tables = np.zeros((), tables_type(header))
    for name, values in {
        "sun_elevation_deg": catalog.sun_elevation, "sun_azimuth_deg": catalog.sun_azimuth,
        "view_off_nadir_deg": catalog.view_off_nadir[views],
        "view_azimuth_deg": catalog.view_azimuth[views],
        "view_altitude_km": catalog.view_altitude[views],
        "image_scale": catalog.image_scale[scales], "sun_number": number, "triangles": triangles,
    }.items():  # fmt: skip
        tables[name] = values
    index = np.zeros(len(tiles), TILE)
    start = HEADER.itemsize + tables.nbytes + index.nbytes
    layout = point_type(header)
    header["point_bytes"] = layout.itemsize
    header["file_bytes"] = start + len(points) * layout.itemsize
    first, worst = 0, 0.0
    with path.open("wb") as file:
        file.seek(start)
        for k, which in enumerate(tiles):
            block, rounding = _packed(points, which, layout, header, (views, scales, suns))
            centre = block["position_m"].mean(axis=0)
            radius = (
                np.linalg.norm(block["position_m"] - centre, axis=1).max() * (1.0 + 1e-6) + 1e-3
            )
            index[k] = (centre, radius, first, len(which), zlib.crc32(block.tobytes()))
            file.write(block.tobytes())
            first, worst = first + len(which), max(worst, rounding)
        header["worst_height_m"] = worst
        header["tables_crc"] = zlib.crc32(tables.tobytes())
        header["index_crc"] = zlib.crc32(index.tobytes())
        header["crc"] = zlib.crc32(header.tobytes()[:-4])
        file.seek(0)
        file.write(header.tobytes() + tables.tobytes() + index.tobytes())


def _triangles(catalog: Catalog, views: Index) -> Index:
    """Corners (m, 3) of the meshes of the views at each altitude, from the highest (`prediction.ViewMesh`), numbers in ``views``;
    those of which all corners are kept.
    """
    found = []
    for altitude in np.unique(catalog.view_altitude)[::-1]:
        which = np.flatnonzero(catalog.view_altitude == altitude)
        places = view_plane(catalog.view_off_nadir[which], catalog.view_azimuth[which])
        found.append(which[ViewMesh.of(places).simplices])
    every = np.concatenate(found)
    return np.searchsorted(views, every[np.isin(every, views).all(axis=1)])


def whole_bytes(catalog: Catalog, scales: int) -> int:
    """About the bytes of the flight file of all points and conditions, with that many image scales."""
    sizes = {
        "nodes": catalog.patch_nodes, "scales": scales, "views": len(catalog.view_off_nadir),
        "suns": int(Statistics.of(catalog).suns.sum()), "elevations": len(catalog.sun_elevation),
        "azimuths": len(catalog.sun_azimuth), "albedo": catalog.albedo_map is not None,
        "triangles": len(_triangles(catalog, np.arange(len(catalog.view_off_nadir)))),
    }  # fmt: skip
    start = HEADER.itemsize + tables_type(sizes).itemsize
    return (
        start
        + len(catalog) * point_type(sizes).itemsize
        + len(catalog) * TILE.itemsize // TILE_POINTS
    )


def _tiled(position_m: Array) -> list[Index]:
    """Rows of each tile: halves along the longest extent, until at most `TILE_POINTS` are left."""
    todo, found = [np.arange(len(position_m))], []
    while todo:
        rows = todo.pop()
        if len(rows) <= TILE_POINTS:
            found.append(np.sort(rows))
            continue
        axis = int(np.argmax(np.ptp(position_m[rows], axis=0)))
        order = rows[np.argsort(position_m[rows, axis], kind="stable")]
        todo += [order[len(rows) // 2 :], order[: len(rows) // 2]]
    return found


def _extent(points: ExportedPoints, views: Index, scales: Index) -> tuple[Mask, float, float]:
    """True for the Suns (e, a) with a claim, and the least and the largest sigma of a claim."""
    shape = (len(points.catalog.sun_elevation), len(points.catalog.sun_azimuth))
    suns, least, largest = np.zeros(shape, bool), np.inf, 0.0
    for _, probability in points.blocks("detection_probability"):
        suns |= np.isfinite(probability[:, scales][:, :, views]).any(axis=(0, 1, 2))
    for name in ("sigma_major", "sigma_minor"):
        for _, sigma in points.blocks(name):
            known = sigma[sigma > 0.0]
            least = min(least, float(known.min(initial=np.inf)))
            largest = max(largest, float(known.max(initial=0.0)))
    return (suns, least, largest) if least < largest else (suns, 1.0, np.e)


def _packed(
    points: ExportedPoints,
    which: Index,
    layout: np.dtype[Any],
    header: Any,
    kept: tuple[Index, Index, Mask],
) -> tuple[AnyArray, float]:
    """The points of a tile, and the worst rounding of their heights."""
    catalog, rows = points.catalog, points.rows[which]
    block = np.zeros(len(which), layout)
    block["point_id"], block["position_m"] = points.point_id[which], points.position_m[which]
    block["rotation"], block["gsd_m"] = points.rotation[which], points.gsd_m[which]
    block["elevation_sigma_m"] = points.sigma_m[1][which]
    block["level"] = catalog.part("level", rows)
    dem = catalog.part("dem", rows).astype(np.float64)
    _store(block, "heights", dem)
    if header["albedo"]:
        _store(
            block, "albedo", np.nan_to_num(catalog.part("albedo", rows).astype(np.float64), nan=1.0)
        )
    block["claims"] = _claims(catalog, rows, header, kept)
    return block, float(np.abs(stored(block, "heights") - dem).max())


def _store(points: AnyArray, name: str, values: Array) -> None:
    """Write values (n, p, p) as steps from the middle of each patch."""
    low, high = values.min(axis=(1, 2)), values.max(axis=(1, 2))
    middle = (0.5 * (low + high)).astype(np.float32).astype(np.float64)
    reach = np.maximum(high - middle, middle - low)
    step = np.nextafter((reach / STEPS[name]).astype(np.float32), np.float32(np.inf))
    points[f"{name}_middle"], points[f"{name}_step"] = middle, step
    points[name] = np.rint(
        (values - middle[:, None, None]) / step.astype(np.float64)[:, None, None]
    )


def stored(points: AnyArray, name: str) -> Array:
    """The values (n, p, p) of stored points: ``heights`` in metres, or ``albedo``."""
    middle, step = (
        points[f"{name}_{part}"].astype(np.float64)[:, None, None] for part in ("middle", "step")
    )
    return np.asarray(middle + step * points[name])


def _claims(catalog: Catalog, rows: Index, header: Any, kept: tuple[Index, Index, Mask]) -> Bytes:
    """Four bytes for each scale, Sun and view (n, s, u, v, 4)."""
    views, scales, suns = kept
    given = [catalog.part(name, rows)[:, scales][:, :, views][..., suns] for name in PACKED]
    flags = catalog.part("condition", rows)[:, views][..., suns][:, None]
    probability, major, minor, angle = (np.asarray(a, np.float64) for a in given)
    out = np.full((*probability.shape, 4), NONE, np.uint8)
    known = np.isfinite(probability) & ((flags & EVALUATED) > 0)
    free = (flags & UNSHADOWED > 0) & (flags & UNOCCLUDED > 0) & np.ones(known.shape, bool)
    out[known, 0] = np.rint(probability[known] / DETECTION_STEP)
    for k, sigma in enumerate((major, minor), 1):
        with np.errstate(divide="ignore"):
            number = (np.log(sigma[known]) - header["sigma_log_least"]) / header["sigma_log_step"]
        out[known, k] = np.where(np.isnan(number), NONE, np.clip(np.rint(number), 0, NONE - 1))
    turn = np.rint(np.nan_to_num(angle[known]) * ANGLE_STEPS / 180.0) % ANGLE_STEPS
    out[known, 3] = turn + np.where(free[known], 0, DEPENDENT)
    return np.ascontiguousarray(np.swapaxes(out, 2, 3))


@dataclass(frozen=True, eq=False)
class FlightFile:
    """A flight file as it is stored: ``header``, ``tables``, ``tiles`` and ``points`` with the fields of their
    types; claims (n, scale, sun, view, 4).
    """

    header: Any
    tables: Any
    tiles: AnyArray
    points: AnyArray

    @classmethod
    def of(cls, path: Path | str) -> FlightFile:
        """Read a file and check all of it; CatalogError for one that is damaged or of another kind."""
        found = cls._parts(path)
        for problem in found._problems():
            raise _damaged(path, problem)
        return found

    @classmethod
    def _parts(cls, path: Path | str) -> FlightFile:
        """The parts of a file whose header is whole."""
        try:
            content = Path(path).read_bytes()
        except OSError as error:
            raise CatalogError(f"{path}: cannot be read: {error.strerror}") from error
        size = HEADER.itemsize
        if content[: len(MAGIC)] != MAGIC:
            raise _damaged(path, "not a flight file (.lcpf)")
        if len(content) < size:
            raise _damaged(path, "cut in its header")
        header = np.frombuffer(content, HEADER, 1)[0]
        if header["version"] != VERSION:
            raise _damaged(path, f"version {header['version']}, not {VERSION}")
        if zlib.crc32(content[: size - 4]) != header["crc"]:
            raise _damaged(path, "the header's checksum is wrong")
        types = [
            (tables_type(header), 1),
            (TILE, int(header["tiles"])),
            (point_type(header), int(header["points"])),
        ]
        if size + sum(kind.itemsize * count for kind, count in types) != len(content):
            raise _damaged(path, f"{len(content)} bytes instead of {header['file_bytes']}")
        parts = []
        for kind, count in types:
            parts.append(np.frombuffer(content, kind, count, size))
            size += kind.itemsize * count
        return cls(header, parts[0][0], parts[1], parts[2])

    def _problems(self) -> Iterator[str]:
        """What is wrong behind the header."""
        if zlib.crc32(self.tables.tobytes()) != self.header["tables_crc"]:
            yield "the checksum of the tables is wrong"
        if zlib.crc32(self.tiles.tobytes()) != self.header["index_crc"]:
            yield "the checksum of the index is wrong"
            return
        ends = np.cumsum(self.tiles["count"], dtype=np.int64)
        if not np.array_equal(ends - self.tiles["count"], self.tiles["first"]) or int(
            ends[-1] if len(ends) else 0
        ) != len(self.points):
            yield "the tiles do not hold each point once"
            return
        for k, tile in enumerate(self.tiles):
            block = self.points[tile["first"] : tile["first"] + tile["count"]]
            if zlib.crc32(block.tobytes()) != tile["crc"]:
                yield f"the checksum of tile {k} of {len(self.tiles)} is wrong"

    @cached_property
    def frame(self) -> str:
        """Name of the Moon-fixed frame."""
        return FRAMES[self.header["frame"]]

    @property
    def detection_probability(self) -> Array:
        """Detection probabilities (n, scale, sun, view), NaN where no claim is made."""
        number = self.points["claims"][..., 0]
        return np.where(number == NONE, np.nan, number * DETECTION_STEP)

    @property
    def sigma_m(self) -> Array:
        """1 sigma along the major and the minor axis (n, scale, sun, view, 2), metres; NaN for none."""
        number = self.points["claims"][..., 1:3]
        log = self.header["sigma_log_least"] + number * self.header["sigma_log_step"]
        return np.where(number == NONE, np.nan, np.exp(log))

    @property
    def sigma_angle_deg(self) -> Array:
        """Directions of the major axis clockwise from north (n, scale, sun, view), degrees."""
        number = self.points["claims"][..., 3] % DEPENDENT
        known = self.points["claims"][..., 0] != NONE
        return np.where(known, number * (180.0 / ANGLE_STEPS), np.nan)

    @property
    def usable(self) -> Mask:
        """True for usable conditions (n, scale, sun, view)."""
        claims = self.points["claims"]
        with np.errstate(invalid="ignore"):
            likely = reaches(self.detection_probability, float(self.header["min_detection"]))
        return np.asarray(likely & (claims[..., 3] < DEPENDENT))


def flight_rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    """The figures of `describe_flight` as names and lines of text."""
    nodes, scales = found["patch_nodes"], ", ".join(f"{one:g}" for one in found["image_scale"])
    return [
        ("points", f"{found['points']} in {found['tiles']} tiles, {found['frame']}"),
        ("size", f"{found['bytes']} bytes, {found['bytes_a_point']} a point"),
        ("patches", f"{nodes} x {nodes} nodes{', with albedo' if found['albedo'] else ''}"),
        ("claims", f"{found['suns']} Suns, {found['views']} views, image scales {scales}"),
        ("usable", f"{percent(found['usable_share'])} of the claims"),
        (
            "rounding",
            f"heights {found['worst_height_rounding_m']:.2g} m, sigmas {percent(found['sigma_rounding_share'])}",
        ),
        ("catalogue", f"content_sha256 {found['catalog_sha256']}"),
    ]


def _damaged(path: Path | str, problem: str) -> CatalogError:
    return CatalogError(f"{path}: {problem}; export it again")


def describe_flight(path: Path | str) -> dict[str, Any]:
    """Contents and integrity of a flight file, with the names of `catalog.summary.describe`; CatalogError for one
    that cannot be read.
    """
    names = ("points", "usable_share", "schema_version", "sources", "bounds")
    empty: dict[str, Any] = dict.fromkeys(names)
    try:
        found = FlightFile.of(path)
    except CatalogError as error:
        if isinstance(error.__cause__, OSError):
            raise
        problem = str(error).removeprefix(f"{path}: ").removesuffix("; export it again")
        return empty | {"intact": False, "problems": [problem]}
    header, known = found.header, np.isfinite(found.detection_probability)
    lon, lat, _ = mcmf_to_lonlat(found.points["position_m"])
    return {
        "points": len(found.points),
        "usable_share": float(found.usable.sum() / max(known.sum(), 1)),
        "intact": True,
        "problems": [],
        "schema_version": f"lcpf {VERSION}",
        "sources": [],
        "bounds": bounds(lon % 360.0, lat),
        "frame": found.frame,
        "tiles": len(found.tiles),
        "bytes": int(header["file_bytes"]),
        "bytes_a_point": int(header["point_bytes"]),
        "patch_nodes": int(header["nodes"]),
        "suns": int(header["suns"]),
        "views": int(header["views"]),
        "image_scale": [round(float(one), 6) for one in found.tables["image_scale"]],
        "albedo": bool(header["albedo"]),
        "min_detection": round(float(header["min_detection"]), 6),
        "worst_height_rounding_m": float(header["worst_height_m"]),
        "sigma_rounding_share": float(np.expm1(0.5 * header["sigma_log_step"])),
        "catalog_sha256": bytes(header["catalog_sha256"]).hex(),
    }
