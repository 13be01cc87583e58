"""USGS image support data (ISD): the JSON that ALE writes for the CSM sensor models of framing
cameras, line scanners and push-frame cameras of the Moon.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..arrays import Array
from ..geometry.rotations import inverse, turned
from .frame_camera import Camera, fields_of_plane
from .isd_optics import CORNER_PX, plane_of_isd
from .isd_tables import Tables
from .json_fields import JsonFields
from .scanners import BEYOND, LineScanner, PushFrame, Scanner

AnySensor = Camera | LineScanner | PushFrame


def is_isd(fields: JsonFields) -> bool:
    """True if a document is an ISD."""
    return "name_model" in fields.document or "instrument_pointing" in fields.document


def sensor_from_isd(fields: JsonFields) -> AnySensor:
    """The sensor that an ISD describes; CameraError names the file and the invalid field."""
    kinds: dict[str, Callable[[JsonFields, Tables], AnySensor]] = {
        "USGS_ASTRO_FRAME_SENSOR_MODEL": _frame,
        "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL": _line_scanner,
        "USGS_ASTRO_PUSH_FRAME_SENSOR_MODEL": _push_frame,
    }
    model = fields.text("name_model")
    if model not in kinds:
        fields.refuse("name_model", f"is {model}; supported are {', '.join(kinds)}")
    tables = Tables(fields)
    tables.check_body()
    return kinds[model](fields, tables)


def isd_with_sun(document: dict[str, Any], scanner: Scanner) -> dict[str, Any]:
    """The ISD of a scanner, ``document``, with the scanner's Sun in place of its own."""
    assert scanner.sun_position_mcmf_m is not None
    now = np.zeros(1)
    inertial = turned(inverse(scanner.trajectory.body.at(now)), scanner.sun_position_mcmf_m)
    sun = {
        "positions": (1e-3 * inertial).reshape(1, 3).tolist(),
        "ephemeris_times": [document["center_ephemeris_time"]],
        "reference_frame": 1,
        "unit": "km",
    }
    return document | {"sun_position": sun}


def _common(fields: JsonFields, tables: Tables) -> dict[str, Any]:
    return {
        "sun_position_mcmf_m": tables.sun(),
        "time_utc": tables.instant,
        "name": fields.name,
    }


def _frame(fields: JsonFields, tables: Tables) -> Camera:
    plane, axes = plane_of_isd(fields, looks_back=tables.looks_back)
    trajectory = tables.trajectory.with_axes(axes)
    return Camera(
        position_mcmf_m=trajectory.positions(np.zeros(1))[0],
        rotation_mcmf_to_camera=trajectory.to_mcmf(np.zeros(3), np.eye(3)),
        image_size_px=(fields.whole("image_samples"), fields.whole("image_lines")),
        **_common(fields, tables),
        **fields_of_plane(plane),
    )


def _line_scanner(fields: JsonFields, tables: Tables) -> LineScanner:
    lines, samples = fields.whole("image_lines"), fields.whole("image_samples")
    times = _line_times(fields, lines)
    tables.cover(times[BEYOND], times[-1 - BEYOND])
    plane, axes = plane_of_isd(fields, looks_back=tables.looks_back)
    return LineScanner(
        image_shape=(lines, samples),
        plane=plane,
        trajectory=tables.trajectory.with_axes(axes),
        times_s=times,
        line_px=-CORNER_PX,  # usgscsm takes the line of sight of the upper edge of the detector's line
        **_common(fields, tables),
    )


def _line_times(fields: JsonFields, count: int) -> Array:
    """Times of the middle of the exposure of every line, and of `BEYOND` lines before and after.

    Each row of ``line_scan_rate`` holds a line (its centre at .5), the time at which its exposure
    begins, and the duration of a line from there on.
    """
    lines, starts, lasting = fields.numbers("line_scan_rate", (None, 3)).T
    if not ((np.diff(lines) > 0.0).all() and (lasting > 0.0).all()):
        fields.refuse("line_scan_rate", "must have increasing lines and positive line times")
    line = np.arange(-BEYOND, count + BEYOND) + CORNER_PX
    part = np.clip(np.searchsorted(lines, line, side="right") - 1, 0, None)
    times = starts[part] + lasting[part] * (line - lines[part] + 0.5)
    if not (np.diff(times) > 0.0).all():
        fields.refuse("line_scan_rate", "has a later line with an earlier time")
    return np.asarray(times)


def _push_frame(fields: JsonFields, tables: Tables) -> PushFrame:
    lines, samples = fields.whole("image_lines"), fields.whole("image_samples")
    height = fields.positive("framelet_height") / fields.positive("detector_line_summing")
    if height != round(height) or lines % height:
        fields.refuse("framelet_height", f"does not divide {lines} lines into framelets")
    step = fields.positive("interframe_delay")
    first = fields.number("starting_ephemeris_time") - fields.number("center_ephemeris_time")
    first += 0.5 * fields.number("exposure_duration")
    last = first + step * (lines / height - 1.0)
    tables.cover(first, last)
    if fields.flag("framelet_order_reversed"):
        first, step = last, -step
    upside_down = int(height) if fields.flag("framelets_flipped") else None
    plane, axes = plane_of_isd(fields, looks_back=tables.looks_back, upside_down=upside_down)
    return PushFrame(
        image_shape=(lines, samples),
        plane=plane,
        trajectory=tables.trajectory.with_axes(axes),
        lines=int(height),
        first_s=first,
        step_s=step,
        **_common(fields, tables),
    )
