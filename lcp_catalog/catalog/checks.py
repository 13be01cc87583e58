"""Checks of a catalogue's content: consistent shapes, values in their ranges and in agreement,
readable attributes. Values are checked whole or block by block.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..constants import FRAME, MOON_RADIUS_M
from ..geometry.frames import enu_rotation, lonlat_to_mcmf
from ..geometry.map_plane import ORTHOGRAPHIC, MapPlane
from .layout import FIXED, GROUPS, LEVELS, Values, centred, key, packing
from .schema import (
    COVERAGE_STATUS,
    COVERAGE_UNKNOWN,
    DETECTION_STEP,
    EVALUATED,
    LEVEL_FACTORS,
    NO_CELL,
    PACKED,
    UNOCCLUDED,
    UNSHADOWED,
    USABLE,
    Cause,
    evaluated,
    summarise_usable,
    universal,
    usable,
)
from .shards import SHARDS, shards_problem

_PLACE_TOLERANCE_M = 1e-3
_ROTATION_TOLERANCE = 1e-9
_CENTRE_TOLERANCE_M = 0.01
_ELEVATION_LIMIT_M = 20_000.0


def first_few(lines: Iterable[str], count: int = 3) -> str:
    """Problems as one line."""
    lines = list(lines)
    rest = f"; and {len(lines) - count} more" if len(lines) > count else ""
    return "; ".join(lines[:count]) + rest


class Finding(NamedTuple):
    """A fault of a variable or an attribute; of an array, the number of wrong values among all,
    and the index of the first.
    """

    name: str
    text: str
    wrong: int = 0
    size: int = 0
    first: tuple[int, ...] = ()

    def of_block(self, start: int, stop: int, total: int) -> Finding:
        """The same in the whole variable, where this is of the rows from start to stop."""
        if not self.first:
            return self
        first = (self.first[0] + start, *self.first[1:])
        return self._replace(first=first, size=self.size // (stop - start) * total)


def lines(findings: Iterable[Finding]) -> list[str]:
    """Findings as lines of text; those of several blocks are counted together."""
    total: dict[tuple[str, str], Finding] = {}
    for new in findings:
        old = total.setdefault((new.name, new.text), new)
        if old is not new:
            total[new.name, new.text] = old._replace(wrong=old.wrong + new.wrong)
    return [_line(found) for found in total.values()]


def _line(found: Finding) -> str:
    if not found.wrong:
        return f"{found.name}: {found.text}"
    first = ", ".join(str(index) for index in found.first)
    return f"{found.name}: {found.text} ({found.wrong} of {found.size}; the first at [{first}])"


def shape_problems(shapes: Mapping[str, tuple[int, ...]]) -> list[str]:
    """Dimensions with different lengths in different variables, and variables with a wrong number
    of dimensions.
    """
    found: list[str] = []
    root: dict[str, int] = dict(FIXED)
    for group, variables in GROUPS.items():
        lengths = dict(root) if group else root
        for short, variable in variables.items():
            name = key(group, short)
            if name not in shapes:
                continue
            shape = shapes[name]
            if len(shape) != len(variable.dims):
                found.append(
                    f"{name}: {len(shape)} dimensions instead of ({', '.join(variable.dims)})"
                )
                continue
            for dim, length in zip(variable.dims, shape, strict=True):
                if lengths.setdefault(dim, length) != length:
                    found.append(f"{name}: {length} along {dim} where others have {lengths[dim]}")
    return found


def value_problems(values: Values, errors: Any) -> list[str]:
    """Problems of the values, one line each; the shapes must be consistent. ``errors``: the error
    model with ``min_detection``.
    """
    return lines(found for part in PARTS for found in part_findings(part, values, errors))


def part_findings(part: str, values: Values, errors: Any) -> Iterator[Finding]:
    """Faults of a part of the content (one of `PARTS`): the axes with all identifiers; and, whole or a
    block of rows at a time, points, coverage cells, and the rows of the overview.
    """
    for check in _CHECKS[part]:
        yield from check(values)
    least = errors.get("min_detection") if isinstance(errors, dict) else None
    if not (isinstance(least, int | float) and 0.0 < least <= 1.0):
        yield Finding("errors", "has no min_detection in 0..1")
        return
    for claim_check in _CLAIM_CHECKS.get(part, ()):
        yield from claim_check(values, float(least))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def text_problems(
    attributes: Mapping[str, Any], groups: Mapping[str, Mapping[str, float | str]]
) -> list[str]:
    """Attributes, global and of the groups, that are not the Moon's, not numbers, texts or JSON where
    they should be, or not what the schema says.
    """
    found = []
    if (
        attributes["reference_radius_m"] != MOON_RADIUS_M
        or attributes["body"] != "MOON"
        or attributes["frame"] != FRAME
    ):
        found.append(f"body, frame or reference_radius_m are not MOON, {FRAME}, {MOON_RADIUS_M:g}")
    texts = {name: text for name, text in attributes.items() if isinstance(text, str)}
    found += [
        f"{name}: {problem}"
        for name, text in texts.items()
        if (problem := _text_problem(text, name in _OF_LINES))
    ]
    found += [
        f"{name}: {problem}"
        for name, check in _JSON_CHECKS.items()
        if name in texts
        and (problem := json_problem(texts[name]) or check(json.loads(texts[name])))
    ]
    found += _plane_problems(**groups["overview"])
    plane: Mapping[str, float | str] = {"projection": ORTHOGRAPHIC, **groups["overview"]}
    for group in (*LEVELS, "coverage_map"):
        if {**plane, **groups.get(group, {})} != plane:
            found.append(f"{group}: is in another plane than the overview")
    numbers: dict[str, float] = {
        f"{group}: {name}": n
        for group in groups
        for name, n in groups[group].items()
        if not isinstance(n, str)
    }
    if "sigma_step_m" in attributes:
        numbers["sigma_step_m"] = attributes["sigma_step_m"]
    for name, number in numbers.items():
        least = 0.0 if "lower_bound" in name else np.nextafter(0.0, 1.0)
        low = -360.0 if "center" in name else least
        if not low <= number < 1e7:
            found.append(f"{name}: {number:g} is not in its range")
    return found


def _plane_problems(**attributes: Any) -> list[str]:
    """An overview in a plane that does not exist."""
    try:
        MapPlane(**{"projection": ORTHOGRAPHIC} | attributes)
    except ValueError as error:
        return [f"overview: {error}"]
    return []


def _text_problem(text: str, of_lines: bool) -> str:
    """What is wrong with a text; empty if nothing is."""
    if not (text.replace("\n", "").replace("\t", "") if of_lines else text).isprintable():
        return "has characters that cannot be printed"
    try:
        tomllib.loads(text if of_lines else "")
    except (tomllib.TOMLDecodeError, RecursionError):
        return "is not TOML"
    return ""


def json_problem(text: str) -> str:
    """What is wrong with a JSON text; empty if nothing is."""
    try:
        found = json.loads(text)
        level = [found]
        for _ in range(_JSON_DEPTH):
            level = [inner for outer in level for inner in _inside(outer)]
        if level:
            raise RecursionError
        json.dumps(found, ensure_ascii=False, allow_nan=False).encode()
    except RecursionError:
        return f"is JSON of more than {_JSON_DEPTH} levels"
    except ValueError:
        return "is not JSON"
    return ""


def _inside(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


def _sources_problem(found: Any) -> str:
    """Files are a list of objects with name, size and sha256, or etag."""
    for source in found if isinstance(found, list) else (None,):
        if not (
            isinstance(source, dict)
            and _is_name(source.get("name"))
            and _is_name(source.get("sha256", source.get("etag")))
            and _is_number(source.get("size"))
        ):
            return "is not a list of files with name, size and sha256"
    return ""


def _albedo_map_problem(found: Any) -> str:
    names = ("name", "encoding", "reference_is")
    if not (
        isinstance(found, dict)
        and all(_is_name(found.get(name)) for name in names)
        and _is_number(found.get("reference"))
        and _is_number(pixel_m := found.get("pixel_m", 1.0))
        and pixel_m > 0.0
        and not _sources_problem(found.get("files"))
    ):
        return "has not name, encoding, reference, reference_is, files and a pixel's side"
    return ""


def _errors_problem(found: Any) -> str:
    return "" if isinstance(found, dict) and all(map(_is_name, found)) else "is not an object"


def _is_name(value: Any) -> bool:
    """True for a text of one line."""
    return isinstance(value, str) and value.isprintable()


_OF_LINES = ("config",)
_JSON_DEPTH = 40
_JSON_CHECKS: dict[str, Callable[[Any], str]] = {
    "sources": _sources_problem,
    "albedo_map": _albedo_map_problem,
    "errors": _errors_problem,
    "scene_plan": lambda found: "",
    SHARDS: shards_problem,
}


def _where(name: str, wrong: NDArray[np.bool_], text: str) -> list[Finding]:
    """The fault of a variable with wrong values, if there are any."""
    count = int(np.count_nonzero(wrong))
    if not count:
        return []
    first = np.unravel_index(int(np.argmax(wrong)), wrong.shape)
    return [Finding(name, text, count, wrong.size, tuple(int(index) for index in first))]


def _outside(values: Values, name: str, low: float, high: float) -> list[Finding]:
    array = values[name]
    return _where(name, ~((array >= low) & (array <= high)), f"not in {low:g}..{high:g}")


def _numbered(values: Values, names: Iterable[str]) -> Iterator[Finding]:
    for name in names:
        if not np.array_equal(values[name], np.arange(len(values[name]))):
            yield Finding(name, "is not 0, 1, 2, ...")


def _rising(values: Values, *names: str) -> Iterator[Finding]:
    for name in names:
        if not (np.isfinite(values[name]).all() and (np.diff(values[name]) > 0).all()):
            yield Finding(name, "is not strictly rising")


def _falling(values: Values, *names: str) -> Iterator[Finding]:
    for name in names:
        if not (np.isfinite(values[name]).all() and (np.diff(values[name]) < 0).all()):
            yield Finding(name, "is not strictly falling")


def _check_axes(values: Values) -> Iterator[Finding]:
    for name in ("patch_row", "patch_col"):
        if not np.array_equal(values[name], centred(len(values[name]))):
            yield Finding(name, "is not counted from the patch's centre")
    yield from _numbered(values, ("point", "view", "coverage/cell", *FIXED))
    yield from _rising(values, "sun_elevation", "sun_azimuth", "overview/x")
    yield from _falling(values, "overview/y")
    yield from _outside(values, "sun_elevation", 0.0, 90.0)
    yield from _outside(values, "sun_azimuth", 0.0, 360.0)
    yield from _outside(values, "view_off_nadir", 0.0, 90.0)
    yield from _outside(values, "view_azimuth", 0.0, 360.0)
    yield from _where("view_altitude", ~(values["view_altitude"] > 0.0), "not above 0")
    scale = values["image_scale"]
    if not (len(scale) and scale[0] == 1.0 and (np.diff(scale) > 0.0).all()):
        yield Finding("image_scale", "does not rise from 1")
    for name in ("view", "sun_elevation", "sun_azimuth"):
        if not len(values[name]):
            yield Finding(name, "has no values")
    # np.unique takes 10 times as long
    repeated = np.count_nonzero(np.diff(np.sort(values["point_id"])) == 0)
    if repeated:
        yield Finding("point_id", f"{repeated} numbers occur more than once")


def _check_places(values: Values) -> Iterator[Finding]:
    lon, lat, height = values["longitude"], values["latitude"], values["elevation"]
    yield from _where("longitude", ~((lon >= 0.0) & (lon < 360.0)), "not in 0..360")
    yield from _outside(values, "latitude", -90.0, 90.0)
    yield from _outside(values, "elevation", -_ELEVATION_LIMIT_M, _ELEVATION_LIMIT_M)
    away = np.abs(values["position_mcmf"] - lonlat_to_mcmf(lon, lat, height)).max(
        axis=1, initial=0.0
    )
    wrong = ~(away <= _PLACE_TOLERANCE_M)
    yield from _where(
        "position_mcmf", wrong, "is not the place of longitude, latitude and elevation"
    )


def _check_rotations(values: Values) -> Iterator[Finding]:
    rotation = values["rotation_mcmf_to_enu"]
    expected = enu_rotation(values["longitude"], values["latitude"])
    turned = np.abs(rotation - expected).max(axis=(1, 2), initial=0.0)
    if (turned <= 0.1 * _ROTATION_TOLERANCE).all():
        return  # so they are orthonormal, too
    skew = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    yield from _where("rotation_mcmf_to_enu", ~(skew <= _ROTATION_TOLERANCE), "is not orthonormal")
    wrong = ~(turned <= _ROTATION_TOLERANCE)
    yield from _where("rotation_mcmf_to_enu", wrong, "is not the frame of longitude and latitude")


def _check_patches(values: Values) -> Iterator[Finding]:
    dem = values["dem"]
    rows, cols = dem.shape[1:]
    if not (rows == cols and rows % 2 == 1):
        yield Finding("dem", f"patches of {rows} x {cols} nodes have no centre node")
        return
    yield from _where("dem", ~np.isfinite(dem), "not a number")
    off = ~(np.abs(dem[:, rows // 2, cols // 2]) <= _CENTRE_TOLERANCE_M)
    yield from _where("dem", off, "the centre node is not at 0")
    products = values["dem_product"]
    yield from _where("dem_product", products == "", "is empty")
    yield from _where("level", values["level"] < 0, "below 0")
    odd = [text for text in set(products.tolist()) if not text.isprintable()]
    yield from _where(
        "dem_product", np.isin(products, odd), "has characters that cannot be printed"
    )


def _check_albedo(values: Values) -> Iterator[Finding]:
    """Albedo is known for a whole patch or not at all, and is not negative."""
    if "albedo" not in values:
        return
    albedo = values["albedo"]
    known = np.isfinite(albedo)
    wrong = np.isinf(albedo) | np.asarray(known & (albedo < 0.0))
    yield from _where("albedo", wrong, "not 0 or above")
    part = np.asarray(known.any(axis=(1, 2)) & ~known.all(axis=(1, 2)))
    yield from _where("albedo", part, "is known for a part of the patch only")


def _check_resolutions(values: Values) -> Iterator[Finding]:
    for name in ("gsd", "gsd_min", "gsd_max"):
        yield from _where(
            name, ~((values[name] > 0.0) & np.isfinite(values[name])), "not a positive number"
        )
    wrong = values["gsd_max"] * (1.0 + 1e-9) < values["gsd_min"]
    yield from _where("gsd_max", wrong, "below gsd_min")


def _check_conditions(values: Values) -> Iterator[Finding]:
    condition = values["condition"]
    yield from _where("condition", condition > USABLE, "has undefined bits")
    yield from _where(
        "condition", (condition > 0) & ~evaluated(condition), "has flags without 'evaluated'"
    )
    summary = summarise_usable(condition, values["sun_elevation"])
    for name, expected in zip(("sun_elevation_min", "sun_elevation_max"), summary, strict=True):
        same = np.isclose(values[name], expected, rtol=0.0, atol=1e-9, equal_nan=True)
        yield from _where(name, ~same, "does not agree with condition")


def _check_figures(values: Values) -> Iterator[Finding]:
    """Figures are numbers in their ranges; NaN is allowed for a point without a usable condition."""
    some = usable(values["condition"]).any(axis=(1, 2, 3))
    shares = ("false_match_probability", "shadow_dependence", "occlusion_dependence")
    limits = {name: (0.0, 1.0) for name in shares} | {
        "second_peak": (-1.0, 1.0),
        "harris_response": (-np.inf, np.inf),  # below 0 where one direction alone has texture
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


def _check_cells(values: Values) -> Iterator[Finding]:
    unknown = ~np.isin(values["coverage/status"], list(COVERAGE_STATUS))
    yield from _where("coverage/status", unknown, "has no meaning")
    yield from _outside(values, "coverage/latitude", -90.0, 90.0)
    yield from _outside(values, "coverage/longitude", -360.0, 720.0)
    nearby = values["coverage/usable"]
    wrong = (nearby > 1) & (nearby != COVERAGE_UNKNOWN)  # np.isin takes 12 times the memory
    yield from _where("coverage/usable", wrong, "has no meaning")


def _check_overview(values: Values) -> Iterator[Finding]:
    yield from _where("overview/height", np.isinf(values["overview/height"]), "infinite")


def _check_map_levels(values: Values) -> Iterator[Finding]:
    for group in LEVELS:
        if f"{group}/x" in values:
            yield from _rising(values, f"{group}/x")
            yield from _falling(values, f"{group}/y")
            yield from _where(f"{group}/height", np.isinf(values[f"{group}/height"]), "infinite")
    if "coverage_map/status" in values:
        yield from _rising(values, "coverage_map/x_cell")
        yield from _falling(values, "coverage_map/y_cell")
        unknown = ~np.isin(values["coverage_map/status"], [*COVERAGE_STATUS, NO_CELL])
        yield from _where("coverage_map/status", unknown, "has no meaning")
        yield from _shares(values, "coverage_map/usable_share")
    if "coverage_levels/block" not in values:
        return
    yield from _numbered(values, ("coverage_levels/block", "coverage_levels/code"))
    unknown = ~np.isin(values["coverage_levels/factor"], LEVEL_FACTORS)
    yield from _where("coverage_levels/factor", unknown, "is no level")
    yield from _outside(values, "coverage_levels/latitude", -90.0, 90.0)
    yield from _outside(values, "coverage_levels/longitude", 0.0, 360.0)
    yield from _where("coverage_levels/cells", values["coverage_levels/cells"] < 0, "below 0")
    yield from _shares(values, "coverage_levels/usable_share")


def _shares(values: Values, name: str) -> Iterator[Finding]:
    """Shares, NaN where they are not known."""
    yield from _where(name, (values[name] < 0) | (values[name] > 1), "not in 0..1")


def _check_promise(values: Values) -> Iterator[Finding]:
    if "promise/place" not in values:
        return
    yield from _numbered(values, ("promise/place", "promise/step", "promise/part", "promise/unit"))
    yield from _outside(values, "promise/latitude", -90.0, 90.0)
    yield from _outside(values, "promise/longitude", -360.0, 720.0)
    for name in ("met", "served", "located", "located_probability"):
        yield from _outside(values, f"promise/{name}", 0.0, 1.0)
    if not (np.diff(values["promise/size"]) > 0).all():
        yield Finding("promise/size", "does not rise")
    points, cause = values["promise/points"], values["promise/cause"]
    nothing = cause == NO_CELL
    yield from _where("promise/cause", (cause > max(Cause)) & ~nothing, "has no meaning")
    yield from _where("promise/points", (points == NO_CELL) != nothing, "is not as the cause says")
    enough = points >= values["promise/demand"][:, None, None, None]
    wrong = ~nothing & (enough != (cause == Cause.MET))
    yield from _where("promise/cause", wrong, "is not as demand and points say")
    places = values["promise/places"]
    yield from _where("promise/places", places < 1, "has none")
    if places.sum() != len(values["promise/place"]):
        yield Finding("promise/places", "are not as many as there are")
    for name in ("gsd", "footprint", "radius", "units"):
        found = values[f"promise/{name}"]
        yield from _where(f"promise/{name}", ~((found > 0.0) & np.isfinite(found)), "not above 0")
    for name in ("per_view", "lower_bound"):
        found = values[f"promise/{name}"]
        yield from _where(f"promise/{name}", ~((found >= 0) & np.isfinite(found)), "below 0")


def _check_packed(values: Values) -> Iterator[Finding]:
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


def _check_claimed_flags(values: Values, least: float) -> Iterator[Finding]:
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


_CLAIM_CHECKS = {"points": (_check_claimed_flags,)}

_CHECKS = {
    "axes": (_check_axes, _check_promise, _check_map_levels),
    "points": (
        _check_places,
        _check_rotations,
        _check_patches,
        _check_albedo,
        _check_resolutions,
        _check_conditions,
        _check_figures,
        _check_packed,
    ),
    "cells": (_check_cells,),
    "overview": (_check_overview,),
}

PARTS = tuple(_CHECKS)
"""Parts of the content whose checks need nothing of each other but the axes."""
