"""The part of the catalogue report in which a Sun, a view and an image scale are chosen: the claims as
compact numbers for the page's script, and the frame of the map that it draws in.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import AnyArray, Index
from .catalogue import Catalog
from .charts import ReliefMap
from .layout import packing
from .schema import COVERAGE_UNKNOWN, usable
from .summary import view_name

BYTES_MAX = 12_000_000
"""Most bytes of claims on a page, before compression. A larger catalogue is shown at image scale 1
alone, and if that is still too large with an even sample of its points.
"""

CELLS_MAX = 5000
"""Most spacing cells on a page; of more an even sample."""

PATCHES_MAX = 500
"""Most points with their heights on a page; of more an even sample."""

UNKNOWN = 255
"""Code of a value that is not known."""

_SIGMA_RATIO = 1.02
"""Ratio of neighbouring codes of a sigma."""

_ELLIPSE_PX = 14.0
"""Semi-axis, in units of the map, that the median ellipse is enlarged to."""


@dataclass(frozen=True)
class Shown:
    """The points and image scales on the page."""

    rows: Index
    scales: Index

    @classmethod
    def of(cls, catalog: Catalog, suns: int, bytes_max: int) -> Shown:
        """All points and scales that fit into ``bytes_max`` with ``suns`` Sun directions."""
        views, scales = len(catalog.view_off_nadir), len(_scales(catalog))
        one = max(1, suns * views)  # bytes of a point, of each plane
        if len(catalog) * one * (4 * scales + 1) > bytes_max:
            scales = 1
        most = max(1, bytes_max // (one * (4 * scales + 1)))
        return cls(_sample(len(catalog), most), np.arange(scales))


def claim_map(
    catalog: Catalog, chart: ReliefMap, evaluated: AnyArray, bytes_max: int = BYTES_MAX
) -> dict[str, Any] | None:
    """Numbers for the script: JSON-ready, None for a catalogue without points.
    ``evaluated``: True for the Suns to show, (sun_elevation, sun_azimuth).

    All ``data`` are base64 of bytes that are compressed (RFC 1950). ``suns``: the evaluated directions
    as indices [elevation, azimuth]. ``data``, for
    the shown points n, scales s, views v and Suns k, in this order: condition (n, v, k), detection
    probability in steps of 1/250 (n, s, v, k), sigma of the major axis, minor over major axis in
    1/254, and direction of the major axis in degrees, clockwise from the point's north. A sigma is
    ``sigma_m`` * ``sigma_ratio`` ** code; code 254 stands for everything above. 255: not known.
    ``points``: identifier, longitude, latitude, map coordinates, index of the cell size in ``levels``,
    and direction of the point's north on the map. ``map_px``: width and height of the map.

    ``cells``: spacing cells with their map coordinates and width; ``data``: a row of bits (v, k) for each, filled
    up to whole bytes: 1 where a usable point is near; ``known`` (v, k): the condition was evaluated;
    ``of``: number of all cells. ``patches``: heights (``side``, ``side``) of the points ``of``, indices
    in ``points``; ``data``: little-endian int16 in steps of ``step_m``.
    """
    if not len(catalog):
        return None
    suns = np.argwhere(evaluated)
    shown = Shown.of(catalog, len(suns), bytes_max)
    x, y, turn = _places(catalog, chart, shown.rows)
    x, y = (np.where(np.isfinite(x + y), at, -1e6) for at in (x, y))  # not on the map
    condition = catalog.part("condition", shown.rows)[:, :, suns[:, 0], suns[:, 1]]
    smallest, planes = _planes(catalog, shown, suns)
    content = b"".join(np.ascontiguousarray(plane).tobytes() for plane in (condition, *planes))
    scales, gsd = _scales(catalog)[shown.scales], catalog.gsd[shown.rows]
    levels, level = np.unique(gsd, return_inverse=True)
    return {
        "suns": suns.tolist(),
        "elevations": catalog.sun_elevation.tolist(),
        "azimuths": catalog.sun_azimuth.tolist(),
        "views": _view_names(catalog),
        "scales": scales.tolist(),
        "points": [
            [str(catalog.point_id[i]), round(float(catalog.longitude[i]), 4), round(float(catalog.latitude[i]), 4),
             round(float(px), 1), round(float(py), 1), int(k), round(float(north), 1)]
            for i, px, py, k, north in zip(shown.rows, x, y, level, turn, strict=True)
        ],
        "levels": levels.tolist(),
        "map_px": list(chart.size_px),
        "sigma_m": smallest,
        "sigma_ratio": _SIGMA_RATIO,
        "least": catalog.min_detection,
        "px_per_m": chart.scale,
        "enlarged": _enlargement(catalog, shown, chart),
        "first": _first_choice(condition),
        "of": len(catalog),
        "data": _packed(content),
        "cells": _cells(catalog, chart, suns),
        "patches": _patches(catalog, shown.rows),
    }  # fmt: skip


def _packed(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode("ascii")


def _sample(count: int, most: int) -> Index:
    """Indices of all of ``count`` things, or of an even sample."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.int64)


def _cells(catalog: Catalog, chart: ReliefMap, suns: Index) -> dict[str, Any]:
    """The spacing cells and, by condition, whether a usable point is near; none if that is not known."""
    cells = catalog.coverage
    count = 0 if cells.usable is None else len(cells.status)
    rows = _sample(count, CELLS_MAX)
    x, y = chart.pixel(*chart.plane.at(cells.longitude[rows], cells.latitude[rows]))
    x, y = (np.where(np.isfinite(x + y), at, -1e6) for at in (x, y))  # not on the map
    near = np.zeros((0, len(catalog.view_off_nadir), len(suns)), np.uint8)
    if cells.usable is not None:
        near = np.asarray(cells.usable)[rows][:, :, suns[:, 0], suns[:, 1]]
    bits = np.packbits((near == 1).reshape(len(near), near.shape[1] * near.shape[2]), axis=1)
    return {
        "x": np.round(x, 1).tolist(),
        "y": np.round(y, 1).tolist(),
        "known": (near != COVERAGE_UNKNOWN).any(axis=0).tolist(),
        "of": count,
        "spacing_km": round(cells.spacing_m / 1e3, 2),
        "side_px": round(max(cells.spacing_m, cells.step_m or 0.0) * chart.scale, 2),
        "data": _packed(bits.tobytes()),
    }


def _patches(catalog: Catalog, rows: Index) -> dict[str, Any]:
    """Heights of an even sample of the shown points (``rows``)."""
    some = _sample(len(rows), PATCHES_MAX)
    z = np.nan_to_num(np.asarray(catalog.part("dem", rows[some]), dtype=np.float64))
    step_m = max(float(np.abs(z).max(initial=0.0)) / 32767.0, 1e-6)
    return {
        "side": catalog.patch_nodes,
        "of": some.tolist(),
        "step_m": step_m,
        "data": _packed(np.rint(z / step_m).astype("<i2").tobytes()),
    }


def _scales(catalog: Catalog) -> AnyArray:
    return np.asarray(catalog.image_scale)


def _view_names(catalog: Catalog) -> list[str]:
    altitudes = [float(h) if np.isfinite(h) else None for h in catalog.view_altitude]
    return [
        view_name({"off_nadir_deg": float(off), "azimuth_deg": float(az), "altitude_km": high})
        for off, az, high in zip(
            catalog.view_off_nadir, catalog.view_azimuth, altitudes, strict=True
        )
    ]


def _places(catalog: Catalog, chart: ReliefMap, rows: Index) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Map coordinates of points and the direction of their north on the map, degrees clockwise."""
    x, y = chart.pixel(*chart.plane.places(catalog.position_mcmf[rows]))
    return x, y, chart.plane.north(catalog.longitude[rows], catalog.latitude[rows])


def _planes(catalog: Catalog, shown: Shown, suns: Index) -> tuple[float, list[AnyArray]]:
    """The smallest sigma, and the bytes of probability, sigma, axis ratio and direction."""

    def cut(name: str) -> AnyArray:
        whole = catalog.part(name, shown.rows, slice(0, len(shown.scales)))
        return np.asarray(whole[..., suns[:, 0], suns[:, 1]], dtype=np.float64)

    detection, major, minor, angle = (
        cut(f"{n}") for n in ("detection_probability", "sigma_major", "sigma_minor", "sigma_angle")
    )
    known = np.isfinite(major) & (major > 0.0)
    smallest = float(major[known].min()) if known.any() else 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        code = np.rint(np.log(major / smallest) / np.log(_SIGMA_RATIO))
        share = np.rint(254.0 * minor / major)
    return smallest, [
        packing("detection_probability", 1.0).packed(detection),
        *(_codes(plane, known) for plane in (code, share, angle)),
    ]


def _codes(values: AnyArray, known: AnyArray) -> AnyArray:
    """Bytes 0..254, `UNKNOWN` where not known."""
    sound = known & np.isfinite(values)
    return np.where(sound, np.clip(np.nan_to_num(values), 0, 254), UNKNOWN).astype(np.uint8)


def _enlargement(catalog: Catalog, shown: Shown, chart: ReliefMap) -> int:
    """Round factor by which ellipses are enlarged on the map."""
    sigma = catalog.part("sigma_major", shown.rows, 0)
    sigma = sigma[usable(catalog.part("condition", shown.rows)) & (sigma > 0.0)]
    if not len(sigma):
        return 1
    ideal = _ELLIPSE_PX / (float(np.median(sigma)) * chart.scale)
    return next((n for n in (1000, 500, 200, 100, 50, 20, 10, 5, 2) if n <= ideal), 1)


def _first_choice(condition: AnyArray) -> list[int]:
    """View and Sun shown first: the pair with the median number of usable points, so that the page
    shows the catalogue neither at its best nor at its worst.
    """
    works = ((condition & 31) == 31).sum(axis=0)
    order = np.argsort(works[0], kind="stable")
    return [0, int(order[len(order) // 2])] if len(order) else [0, 0]
