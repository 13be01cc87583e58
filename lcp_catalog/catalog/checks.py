"""Checks of a catalogue's content: consistent shapes, values in their ranges and in agreement,
readable attributes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..constants import FRAME, MOON_RADIUS_M
from ..geometry.frames import enu_rotation, lonlat_to_mcmf
from .layout import FIXED, GROUPS, Values, centred, is_claim, key
from .packing import packing
from .schema import (
    COVERAGE_STATUS,
    COVERAGE_UNKNOWN,
    DETECTION_STEP,
    EVALUATED,
    OPTIONAL,
    PACKED,
    UNOCCLUDED,
    UNSHADOWED,
    USABLE,
    evaluated,
    summarise_usable,
    universal,
    usable,
)

_PLACE_TOLERANCE_M = 1e-3
_ROTATION_TOLERANCE = 1e-9
_CENTRE_TOLERANCE_M = 0.01
_ELEVATION_LIMIT_M = 20_000.0


def first_few(lines: Iterable[str], count: int = 3) -> str:
    """Problems as one line."""
    lines = list(lines)
    rest = f"; and {len(lines) - count} more" if len(lines) > count else ""
    return "; ".join(lines[:count]) + rest


def shape_problems(values: Values) -> list[str]:
    """Dimensions with different lengths in different variables, and variables with a wrong number
    of dimensions.
    """
    lines: list[str] = []
    root: dict[str, int] = dict(FIXED)
    for group, variables in GROUPS.items():
        lengths = dict(root) if group else root
        for short, variable in variables.items():
            name = key(group, short)
            if (name in OPTIONAL or is_claim(name)) and name not in values:
                continue
            array = values[name]
            if array.ndim != len(variable.dims):
                lines.append(
                    f"{name}: {array.ndim} dimensions instead of ({', '.join(variable.dims)})"
                )
                continue
            for dim, length in zip(variable.dims, array.shape, strict=True):
                if lengths.setdefault(dim, length) != length:
                    lines.append(f"{name}: {length} along {dim} where others have {lengths[dim]}")
    return lines


def value_problems(values: Values) -> list[str]:
    """Problems of the values, one line each; the shapes must be consistent."""
    return [line for check in _CHECKS for line in check(values)]


def claim_problems(values: Values, errors: Any) -> list[str]:
    """Problems of the claims of a catalogue that has them, one line each; ``errors``: the error
    model with ``min_detection``.
    """
    least = errors.get("min_detection") if isinstance(errors, dict) else None
    if not (isinstance(least, int | float) and 0.0 < least <= 1.0):
        return ["errors: has no min_detection in 0..1"]
    return [line for check in _CLAIM_CHECKS for line in check(values, float(least))]


def text_problems(attributes: dict[str, Any]) -> Iterator[str]:
    """Global attributes that are not the Moon's, or are not JSON where they should be."""
    if (
        attributes["reference_radius_m"] != MOON_RADIUS_M
        or attributes["body"] != "MOON"
        or attributes["frame"] != FRAME
    ):
        yield f"body, frame or reference_radius_m are not MOON, {FRAME}, {MOON_RADIUS_M:g}"
    for name in ("sources", "scene_plan", "albedo_map", "errors"):
        try:
            json.loads(attributes.get(name, "null"))
        except json.JSONDecodeError:
            yield f"{name}: is not JSON"


def _where(name: str, wrong: NDArray[np.bool_], text: str) -> list[str]:
    """One line about the wrong values of a variable, if there are any."""
    count = int(np.count_nonzero(wrong))
    if not count:
        return []
    first = ", ".join(str(int(index[0])) for index in np.nonzero(wrong))
    return [f"{name}: {text} ({count} of {wrong.size}; the first at [{first}])"]


def _outside(values: Values, name: str, low: float, high: float) -> list[str]:
    array = values[name]
    return _where(name, ~((array >= low) & (array <= high)), f"not in {low:g}..{high:g}")


def _check_axes(values: Values) -> Iterator[str]:
    for name in ("point", "view", "coverage/cell", *FIXED):
        if not np.array_equal(values[name], np.arange(len(values[name]))):
            yield f"{name}: is not 0, 1, 2, ..."
    for name in ("patch_row", "patch_col"):
        if not np.array_equal(values[name], centred(len(values[name]))):
            yield f"{name}: is not counted from the patch's centre"
    for name, sign in (
        ("sun_elevation", 1),
        ("sun_azimuth", 1),
        ("overview/x", 1),
        ("overview/y", -1),
    ):
        if not (np.isfinite(values[name]).all() and (np.diff(values[name]) * sign > 0).all()):
            yield f"{name}: is not strictly {'rising' if sign > 0 else 'falling'}"
    yield from _outside(values, "sun_elevation", 0.0, 90.0)
    yield from _outside(values, "sun_azimuth", 0.0, 360.0)
    yield from _outside(values, "view_off_nadir", 0.0, 90.0)
    yield from _outside(values, "view_azimuth", 0.0, 360.0)
    yield from _where("view_altitude", ~(values["view_altitude"] > 0.0), "not above 0")


def _check_places(values: Values) -> Iterator[str]:
    lon, lat, height = values["longitude"], values["latitude"], values["elevation"]
    yield from _where("longitude", ~((lon >= 0.0) & (lon < 360.0)), "not in 0..360")
    yield from _outside(values, "latitude", -90.0, 90.0)
    yield from _outside(values, "elevation", -_ELEVATION_LIMIT_M, _ELEVATION_LIMIT_M)
    repeated = len(values["point_id"]) - len(np.unique(values["point_id"]))
    if repeated:
        yield f"point_id: {repeated} numbers occur more than once"
    away = np.abs(values["position_mcmf"] - lonlat_to_mcmf(lon, lat, height)).max(
        axis=1, initial=0.0
    )
    wrong = ~(away <= _PLACE_TOLERANCE_M)
    yield from _where(
        "position_mcmf", wrong, "is not the place of longitude, latitude and elevation"
    )


def _check_rotations(values: Values) -> Iterator[str]:
    rotation, places = values["rotation_mcmf_to_enu"], (values["longitude"], values["latitude"])
    expected = np.array([enu_rotation(lon, lat) for lon, lat in zip(*places, strict=True)]).reshape(
        -1, 3, 3
    )
    skew = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    turned = np.abs(rotation - expected).max(axis=(1, 2), initial=0.0)
    yield from _where("rotation_mcmf_to_enu", ~(skew <= _ROTATION_TOLERANCE), "is not orthonormal")
    wrong = ~(turned <= _ROTATION_TOLERANCE)
    yield from _where("rotation_mcmf_to_enu", wrong, "is not the frame of longitude and latitude")


def _check_patches(values: Values) -> Iterator[str]:
    dem = values["dem"]
    rows, cols = dem.shape[1:]
    if not (rows == cols and rows % 2 == 1):
        yield f"dem: patches of {rows} x {cols} nodes have no centre node"
        return
    yield from _where("dem", ~np.isfinite(dem), "not a number")
    off = ~(np.abs(dem[:, rows // 2, cols // 2]) <= _CENTRE_TOLERANCE_M)
    yield from _where("dem", off, "the centre node is not at 0")
    yield from _where(
        "dem_product", np.array([not text for text in values["dem_product"]], bool), "is empty"
    )


def _check_albedo(values: Values) -> Iterator[str]:
    """Albedo is known for a whole patch or not at all, and is not negative."""
    if "albedo" not in values:
        return
    albedo = values["albedo"]
    known = np.isfinite(albedo)
    wrong = np.isinf(albedo) | np.asarray(known & (albedo < 0.0))
    yield from _where("albedo", wrong, "not 0 or above")
    part = np.asarray(known.any(axis=(1, 2)) & ~known.all(axis=(1, 2)))
    yield from _where("albedo", part, "is known for a part of the patch only")


def _check_resolutions(values: Values) -> Iterator[str]:
    for name in ("gsd", "gsd_min", "gsd_max"):
        yield from _where(
            name, ~((values[name] > 0.0) & np.isfinite(values[name])), "not a positive number"
        )
    slack = 1.0 + 1e-9
    if "detection_probability" in values:  # a point may work in coarser images only
        wrong = values["gsd_max"] * slack < values["gsd_min"]
        yield from _where("gsd_max", wrong, "below gsd_min")
        return
    yield from _where("gsd_min", values["gsd_min"] > values["gsd"] * slack, "above gsd")
    yield from _where("gsd_max", values["gsd_max"] * slack < values["gsd"], "below gsd")


def _check_conditions(values: Values) -> Iterator[str]:
    condition = values["condition"]
    yield from _where("condition", condition > USABLE, "has undefined bits")
    yield from _where(
        "condition", (condition > 0) & ~evaluated(condition), "has flags without 'evaluated'"
    )
    summary = summarise_usable(condition, values["sun_elevation"])
    for name, expected in zip(("sun_elevation_min", "sun_elevation_max"), summary, strict=True):
        same = np.isclose(values[name], expected, rtol=0.0, atol=1e-9, equal_nan=True)
        yield from _where(name, ~same, "does not agree with condition")


def _check_figures(values: Values) -> Iterator[str]:
    """Figures are numbers in their ranges; NaN is allowed for a point without a usable condition."""
    some = usable(values["condition"]).any(axis=(1, 2, 3))
    shares = ("false_match_probability", "shadow_dependence", "occlusion_dependence")
    limits = {name: (0.0, 1.0) for name in shares} | {
        "second_peak": (-1.0, 1.0),
        "harris_response": (0.0, np.inf),
        "localization_sigma": (0.0, np.inf),
    }
    for name, (low, high) in limits.items():
        array = values[name]
        known = some.reshape(-1, *[1] * (array.ndim - 1))
        within = np.isfinite(array) & (array >= low - 1e-6) & (array <= high + 1e-6)
        yield from _where(name, ~within & ~(np.isnan(array) & ~known), f"not in {low:g}..{high:g}")
    sigma = values["localization_sigma"]
    yield from _where(
        "localization_sigma", sigma[:, 0] < sigma[:, 1], "the major axis is below the minor"
    )


def _check_groups(values: Values) -> Iterator[str]:
    unknown = ~np.isin(values["coverage/status"], list(COVERAGE_STATUS))
    yield from _where("coverage/status", unknown, "has no meaning")
    yield from _outside(values, "coverage/latitude", -90.0, 90.0)
    yield from _outside(values, "coverage/longitude", -360.0, 720.0)
    yield from _where("overview/height", np.isinf(values["overview/height"]), "infinite")


def _check_scales(values: Values, least: float) -> Iterator[str]:
    scale = values["image_scale"]
    if not (len(scale) and scale[0] == 1.0 and (np.diff(scale) > 0.0).all()):
        yield "image_scale: does not rise from 1"
    yield from _where("level", values["level"] < 0, "below 0")
    wrong = ~np.isin(values["coverage/usable"], (0, 1, COVERAGE_UNKNOWN))
    yield from _where("coverage/usable", wrong, "has no meaning")


def _check_packed(values: Values, least: float) -> Iterator[str]:
    """Packed numbers in their ranges; sigmas known at least wherever a point is usable."""
    for name in PACKED:
        rule, array = packing(name, 1.0), values[name]
        wrong = (array > rule.largest) & (array != rule.missing)
        yield from _where(name, wrong, f"above {rule.largest}")
    missing = packing("sigma_major", 1.0).missing
    major, minor = values["sigma_major"], values["sigma_minor"]
    yield from _where("sigma_minor", (major == missing) != (minor == missing), "known for one axis")
    yield from _where("sigma_major", major < minor, "below sigma_minor")
    alone = (major[:, 0] == missing) & usable(values["condition"])
    yield from _where("sigma_major", alone, "is missing in usable conditions")


def _check_claimed_flags(values: Values, least: float) -> Iterator[str]:
    """Flags agree with the detection probability at scale 1, within half a step."""
    condition, stored = values["condition"], values["detection_probability"][:, 0]
    rule = packing("detection_probability", 1.0)
    known, half = stored != rule.missing, 0.5 + 1e-6
    wrong = known & ~evaluated(condition)
    yield from _where("detection_probability", wrong, "is given for a condition not evaluated")
    limit = least / DETECTION_STEP
    low = ~known | (stored < limit - half)
    wrong = usable(condition) & low
    yield from _where("condition", wrong, "usable below min_detection")
    others = EVALUATED | UNSHADOWED | UNOCCLUDED
    free = (condition & others) == others
    wrong = ~usable(condition) & free & known & (stored > limit + half)
    yield from _where("condition", wrong, "not usable in spite of the detection probability")
    wrong = (values["universal"] > 0) != universal(condition)
    yield from _where("universal", wrong, "does not agree with condition")


_CLAIM_CHECKS = (_check_scales, _check_packed, _check_claimed_flags)

_CHECKS = (
    _check_axes,
    _check_places,
    _check_rotations,
    _check_patches,
    _check_albedo,
    _check_resolutions,
    _check_conditions,
    _check_figures,
    _check_groups,
)
