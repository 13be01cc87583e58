"""Answers as JSON documents, CSV tables, GeoJSON and lines of text."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from ..arrays import AnyArray
from ..catalog.catalogue import Catalog
from ..geometry.angles import wrapped_deg
from ..plots.numbers import number
from .expected_position import Answer, ExpectedPosition
from .frame_points import CAUSES

POINT_COLUMNS = (
    "point_id", "longitude_deg", "latitude_deg", "elevation_m", "level", "detection_probability",
    "column_px", "row_px", "pixel_m", "sigma_major_px", "sigma_minor_px", "major_axis_px_deg",
    "sigma_major_m", "sigma_minor_m", "sigma_angle_deg",
)  # fmt: skip
"""One row per point. ``major_axis_px_deg`` is from right towards down in the image,
``sigma_angle_deg`` clockwise from north on the ground.
"""

FRAME_COLUMNS = (
    "time_utc", "x_m", "y_m", "z_m", "sun_azimuth_deg", "sun_elevation_deg",
    "in_view", "usable", "listed", "expected_points", "position_sigma_m",
    "sigma_east_m", "sigma_north_m", "sigma_up_m", "position_sigma_known_attitude_m", "position_dop",
    "reason",
)  # fmt: skip
"""One row per frame of a trajectory; figures that the points do not determine are empty."""

CRS = "urn:ogc:def:crs:IAU_2015::30100"
"""Longitude and latitude on the Moon's sphere of 1737.4 km, MOON_ME."""

MEANINGS = dict(
    zip(
        CAUSES[1:],
        (
            "Sun outside the catalogue's",
            "view outside the catalogue's",
            "pixel too coarse",
            "not evaluated",
            "shadow of other terrain",
            "hidden by other terrain",
            "detection unlikely",
            "cut by the image's edge",
        ),
        strict=True,
    )
)
"""Why points in view are not usable, for readers."""


def document(answer: Answer, catalog: Catalog) -> dict[str, Any]:
    """The answer for a frame as a JSON object; null for what the points do not determine."""
    position = answer.position
    dop, cofactors = position.dop, position.covariance
    azimuth, elevation = answer.sun_deg
    return {
        "time_utc": answer.frame.time_utc,
        "sun": {"azimuth_deg": round(azimuth, 4), "elevation_deg": round(elevation, 4)},
        "points": _points(answer, catalog),
        "counts": {"listed": len(answer.rows)} | answer.counts,
        "expected_points": round(position.expected_points, 3),
        "position_covariance_m2": _listed(position.position_covariance_m2),
        "position_sigma_m": position.position_sigma_m,
        "position_sigma_enu_m": _listed(position.sigma_enu_m),
        "position_sigma_known_attitude_m": position.known_attitude_sigma_m,
        "position_covariance_known_attitude_m2": _listed(position.known_attitude_m2),
        "covariance_6x6": _listed(cofactors),
        "dop": dop,
        "budget_m": position.budget_m,
        "reason": position.reason or None,
    }


def _listed(values: AnyArray | None) -> list[Any] | None:
    return None if values is None else values.tolist()


def _points(answer: Answer, catalog: Catalog) -> list[dict[str, Any]]:
    table = zip(
        *(getattr(catalog, name)[answer.rows].tolist() for name in ("point_id", "level")),
        np.round(answer.probability, 4).tolist(),
        np.round(answer.pixel, 3).tolist(),
        np.round(np.column_stack([answer.sigma_px, answer.angle_px_deg]), 4).tolist(),
        np.round(np.column_stack([answer.sigma_m, answer.angle_deg]), 4).tolist(),
        *(getattr(catalog, name)[answer.rows].tolist() for name in ("longitude", "latitude")),
        strict=True,
    )
    names = (
        "point_id", "level", "detection_probability", "pixel", "sigma_px", "sigma_m",
        "longitude", "latitude",
    )  # fmt: skip
    return [dict(zip(names, row, strict=True)) for row in table]


def points_csv(answer: Answer, catalog: Catalog) -> str:
    """Table of the points of one frame (`POINT_COLUMNS`)."""
    return "".join(_csv([POINT_COLUMNS, *_point_rows(answer, catalog)]))


def _point_rows(answer: Answer, catalog: Catalog) -> list[tuple[Any, ...]]:
    of_points = ("point_id", "longitude", "latitude", "elevation", "level")
    columns = (
        *(getattr(catalog, name)[answer.rows].tolist() for name in of_points),
        np.round(answer.probability, 4).tolist(),
        *np.round(answer.pixel, 3).T.tolist(),
        np.round(answer.pixel_m, 4).tolist(),
        *np.round(answer.sigma_px, 4).T.tolist(),
        np.round(answer.angle_px_deg, 2).tolist(),
        *np.round(answer.sigma_m, 4).T.tolist(),
        np.round(answer.angle_deg, 2).tolist(),
    )
    return list(zip(*columns, strict=True))


def points_geojson(answer: Answer, catalog: Catalog) -> str:
    """The points of one frame as GeoJSON, longitudes -180..180, with the Moon's coordinate system."""
    features = []
    for row in _point_rows(answer, catalog):
        figures = dict(zip(POINT_COLUMNS, row, strict=True))
        lon, lat, up = (figures[name] for name in ("longitude_deg", "latitude_deg", "elevation_m"))
        place = [wrapped_deg(lon), lat, up]
        shape = {"type": "Point", "coordinates": place}
        features.append({"type": "Feature", "geometry": shape, "properties": figures})
    whole = {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": CRS}},
        "features": features,
    }
    return json.dumps(whole, allow_nan=False) + "\n"


def frames_csv(answers: Iterable[Answer]) -> Iterator[str]:
    """Lines of the table of the frames of a trajectory (`FRAME_COLUMNS`)."""
    return _csv([FRAME_COLUMNS, *map(_frame_row, answers)])


def _frame_row(answer: Answer) -> tuple[Any, ...]:
    position = answer.position
    enu = position.sigma_enu_m
    dop = position.dop
    return (
        answer.frame.time_utc,
        *np.round(answer.sensor_position_m, 3).tolist(),
        *(round(angle, 4) for angle in answer.sun_deg),
        answer.counts["in_view"],
        answer.usable,
        len(answer.rows),
        round(position.expected_points, 3),
        _cell(position.position_sigma_m),
        *(("", "", "") if enu is None else map(_cell, enu.tolist())),
        _cell(position.known_attitude_sigma_m),
        _cell(None if dop is None else dop["position"]),
        position.reason,
    )


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def _csv(rows: Iterable[Sequence[Any]]) -> Iterator[str]:
    """Lines of a CSV table (RFC 4180)."""
    for row in rows:
        out = io.StringIO()
        csv.writer(out, lineterminator="\r\n").writerow(row)
        yield out.getvalue()


def point_lines(answer: Answer, catalog: Catalog, most: int) -> list[str]:
    """Table of at most ``most`` points for a terminal."""
    lines = [
        "  point_id             level  probability   column      row  sigma px        sigma m        towards"
    ]
    names = dict(zip(POINT_COLUMNS, range(len(POINT_COLUMNS)), strict=True))
    for row in _point_rows(answer, catalog)[:most]:
        given = {name: row[k] for name, k in names.items()}
        px = f"{given['sigma_major_px']:.2f} x {given['sigma_minor_px']:.2f}"
        metres = f"{number(given['sigma_major_m'])} x {number(given['sigma_minor_m'])}"
        lines.append(
            f"  {given['point_id']:<20} {given['level']:>5}  {given['detection_probability']:>11.3f}"
            f" {given['column_px']:>8.1f} {given['row_px']:>8.1f}  {px:<14}  {metres:<13}"
            f" {given['sigma_angle_deg']:>4.0f} deg"
        )
    more = len(answer.rows) - most
    return lines + ([f"  and {more} more"] if more > 0 else [])


def frame_lines(answers: Iterable[Answer]) -> Iterator[str]:
    """Table of the frames of a trajectory for a terminal."""
    yield "time (UTC)                  in view  usable  expected   position m  exact attitude m"
    for count, answer in enumerate(answers, 1):
        position = answer.position
        free, known = (
            "-" if value is None else number(value)
            for value in (position.position_sigma_m, position.known_attitude_sigma_m)
        )
        name = answer.frame.time_utc or f"frame {count}"
        yield (
            f"{name:<27} {answer.counts['in_view']:>7} {answer.usable:>7}"
            f" {position.expected_points:>9.1f} {free:>12} {known:>17}"
        )


def result_line(answer: Answer) -> str:
    """One line on the points and the position."""
    others = ", ".join(
        f"{answer.counts[cause]} {text}" for cause, text in MEANINGS.items() if answer.counts[cause]
    )
    listed = f", {len(answer.rows)} listed" if len(answer.rows) < answer.usable else ""
    return (
        f"{answer.usable} of {answer.counts['in_view']} points in view usable{listed}"
        f"{f' ({others})' if others else ''}; {position_text(answer.position)}"
    )


def position_text(position: ExpectedPosition) -> str:
    """The expected accuracy in a few words."""
    if position.covariance is None:
        return f"no position: {position.reason}"
    enu, sigma = position.sigma_enu_m, position.position_sigma_m
    known = position.known_attitude_sigma_m
    assert enu is not None
    assert sigma is not None
    east, north, up = (number(value) for value in enu.tolist())
    exact = "" if known is None else f"; {number(known)} m with an exact attitude"
    return f"position to {number(sigma)} m (1 sigma: east {east}, north {north}, up {up}){exact}"
