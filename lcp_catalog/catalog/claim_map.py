"""The part of the catalogue report in which a Sun, a view and an image scale are chosen: the claims as
compact numbers for the page's script, and the frame of the map that it draws in.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import AnyArray, Index
from .catalogue import Catalog
from .charts import Map
from .packing import packing
from .schema import usable
from .summary import view_name

BYTES_MAX = 3_000_000
"""Most bytes of claims on a page, before base64. A larger catalogue is shown at image scale 1 alone,
and if that is still too large with an even sample of its points.
"""

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
        rows = np.arange(len(catalog))
        if len(rows) > most:
            rows = np.linspace(0, len(rows) - 1, most).astype(np.int64)
        return cls(rows, np.arange(scales))


def claim_map(
    catalog: Catalog, chart: Map, evaluated: AnyArray, bytes_max: int = BYTES_MAX
) -> dict[str, Any] | None:
    """Numbers for the script: JSON-ready, None for a catalogue without claims or points.
    ``evaluated``: True for the Suns to show, (sun_elevation, sun_azimuth).

    ``suns``: the evaluated directions as indices [elevation, azimuth]. ``data``: base64 of bytes, for
    the shown points n, scales s, views v and Suns k, in this order: condition (n, v, k), detection
    probability in steps of 1/250 (n, s, v, k), sigma of the major axis, minor over major axis in
    1/254, and direction of the major axis in degrees, clockwise from the point's north. A sigma is
    ``sigma_m`` * ``sigma_ratio`` ** code; code 254 stands for everything above. 255: not known.
    ``points``: identifier, longitude, latitude, map coordinates, cell size, and direction of the
    point's north on the map.
    """
    if not catalog.has_claims or not len(catalog):
        return None
    suns = np.argwhere(evaluated)
    shown = Shown.of(catalog, len(suns), bytes_max)
    x, y, turn = _places(catalog, chart, shown.rows)
    condition = catalog.part("condition", shown.rows)[:, :, suns[:, 0], suns[:, 1]]
    smallest, planes = _planes(catalog, shown, suns)
    content = b"".join(np.ascontiguousarray(plane).tobytes() for plane in (condition, *planes))
    scales = _scales(catalog)[shown.scales]
    return {
        "suns": suns.tolist(),
        "elevations": catalog.sun_elevation.tolist(),
        "azimuths": catalog.sun_azimuth.tolist(),
        "views": _view_names(catalog),
        "scales": scales.tolist(),
        "points": [
            [str(catalog.point_id[i]), round(float(catalog.longitude[i]), 4), round(float(catalog.latitude[i]), 4),
             round(float(px), 1), round(float(py), 1), float(catalog.gsd[i]), round(float(north), 1)]
            for i, px, py, north in zip(shown.rows, x, y, turn, strict=True)
        ],
        "sigma_m": smallest,
        "sigma_ratio": _SIGMA_RATIO,
        "least": catalog.min_detection,
        "px_per_m": chart.scale,
        "enlarged": _enlargement(catalog, shown, chart),
        "first": _first_choice(condition),
        "of": len(catalog),
        "data": base64.b64encode(content).decode("ascii"),
    }  # fmt: skip


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


def _places(catalog: Catalog, chart: Map, rows: Index) -> tuple[AnyArray, AnyArray, AnyArray]:
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


def _enlargement(catalog: Catalog, shown: Shown, chart: Map) -> int:
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
