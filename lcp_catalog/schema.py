"""The catalogue's schema: its variables, flags and statuses, and what their values must satisfy. No file is touched here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .sphere import enu_rotation, lonlat_to_mcmf

SCHEMA_VERSION = "1.0"
"""Raised in front when an old reader would misread the file, behind when something is added."""

FLAGS = {"evaluated": 1, "localizable": 2, "unique": 4, "unshadowed": 8, "unoccluded": 16}
"""Bits of ``condition``; a condition is usable when it has all of them."""

USABLE = sum(FLAGS.values())

STATUSES = {"point": 0, "featureless": 1, "ambiguous": 2, "dependent": 3, "nodata": 4}
"""Values of ``coverage/status``: a point is near, or why there is none."""

AXES = {
    "mcmf_axis": ("x", "y", "z"),
    "enu_axis": ("east", "north", "up"),
    "ellipse_axis": ("major", "minor"),
}
"""Dimensions of fixed length and the names of what stands along them."""

TEXT = "text"
"""Kind of a variable that holds UTF-8 text; every other kind is a NumPy type."""

_PLACE_TOLERANCE_M = 1e-3
_ROTATION_TOLERANCE = 1e-9
_CENTRE_TOLERANCE_M = 0.01
_ELEVATION_LIMIT_M = 20_000.0
_DEGREE_TOLERANCE = 1e-4  # of angles that are stored as float32


@dataclass(frozen=True)
class Variable:
    """One dataset of the file: dimensions, NumPy type, unit, meaning, and further attributes."""

    name: str
    dims: tuple[str, ...]
    kind: str
    units: str
    long_name: str
    more: Mapping[str, Any] = field(default_factory=dict)

    @property
    def attributes(self) -> dict[str, Any]:
        return {"long_name": self.long_name, "units": self.units, **self.more}


def _flag_attributes(kind: str, table: Mapping[str, int]) -> dict[str, Any]:
    values = np.array(list(table.values()), dtype=np.uint8)
    return {kind: values, "flag_meanings": " ".join(table)}


_VIEW = {"coordinates": "view_off_nadir view_azimuth view_altitude"}
_POINT, _PATCH = ("point",), ("point", "patch_row", "patch_col")
_CONDITION = ("point", "view", "sun_elevation", "sun_azimuth")

COORDINATES = (
    Variable("point", ("point",), "int32", "1", "index of the control point"),
    Variable(
        "patch_row", ("patch_row",), "int32", "1", "row of a patch's node, from its centre, positive south"
    ),
    Variable(
        "patch_col", ("patch_col",), "int32", "1", "column of a patch's node, from its centre, positive east"
    ),
    Variable("view", ("view",), "int32", "1", "index of the viewpoint"),
    Variable(
        "sun_elevation",
        ("sun_elevation",),
        "float64",
        "deg",
        "elevation of the Sun above the point's own local horizontal",
    ),
    Variable(
        "sun_azimuth",
        ("sun_azimuth",),
        "float64",
        "deg",
        "azimuth of the Sun, clockwise from the point's own local north",
    ),
)

VIEW_VARIABLES = (
    Variable(
        "view_off_nadir",
        ("view",),
        "float64",
        "deg",
        "angle at the point between the local vertical and the direction to the camera",
    ),
    Variable(
        "view_azimuth", ("view",), "float64", "deg", "azimuth of the camera seen from the point, clockwise from north"
    ),
    Variable(
        "view_altitude",
        ("view",),
        "float64",
        "km",
        "altitude of the camera above the reference sphere; infinite: parallel rays",
    ),
)

POINT_VARIABLES = (
    Variable(
        "point_id", _POINT, "int64", "1", "stable identifier: the same ground has the same number in every build"
    ),
    Variable(
        "longitude",
        _POINT,
        "float64",
        "deg",
        "planetocentric longitude of the patch centre, positive east, 0..360",
        {"standard_name": "longitude"},
    ),
    Variable(
        "latitude",
        _POINT,
        "float64",
        "deg",
        "planetocentric latitude of the patch centre",
        {"standard_name": "latitude"},
    ),
    Variable("elevation", _POINT, "float64", "m", "height of the patch centre above the reference sphere"),
    Variable(
        "position_mcmf", ("point", "mcmf_axis"), "float64", "m", "Moon-centred, Moon-fixed position of the patch centre"
    ),
    Variable(
        "rotation_mcmf_to_enu",
        ("point", "enu_axis", "mcmf_axis"),
        "float64",
        "1",
        "rotation from Moon-centred, Moon-fixed to local axes; rows east, north, up",
    ),
    Variable("gsd", _POINT, "float64", "m", "cell size of the patch"),
    Variable(
        "dem_product", _POINT, TEXT, "1", "name of the elevation model that the patch was cut from", {"_Encoding": "utf-8"}
    ),
    Variable(
        "dem",
        _PATCH,
        "float32",
        "m",
        "up coordinate of the patch's nodes in the point's east-north-up frame, origin at position_mcmf",
    ),
    Variable(
        "condition",
        _CONDITION,
        "uint8",
        "1",
        "what holds for the point under a view and a Sun; usable where all five flags are set",
        {**_flag_attributes("flag_masks", FLAGS), **_VIEW},
    ),
    Variable(
        "sun_elevation_min",
        ("point", "view", "sun_azimuth"),
        "float32",
        "deg",
        "lowest Sun elevation at which the point is usable; NaN: at none",
        _VIEW,
    ),
    Variable(
        "sun_elevation_max",
        ("point", "view", "sun_azimuth"),
        "float32",
        "deg",
        "highest Sun elevation at which the point is usable; NaN: at none",
        _VIEW,
    ),
    Variable("harris_response", _POINT, "float32", "1", "Harris response of the patch, median over usable conditions"),
    Variable(
        "localization_sigma",
        ("point", "ellipse_axis"),
        "float32",
        "m",
        "standard deviation of the matched place along the axes of its ellipse, worst usable condition",
    ),
    Variable(
        "second_peak",
        _POINT,
        "float32",
        "1",
        "highest correlation with any other place in the search radius, worst usable condition",
    ),
    Variable(
        "false_match_probability",
        _POINT,
        "float32",
        "1",
        "probability that the highest correlation in the search radius is elsewhere, worst usable condition",
    ),
    Variable("gsd_min", _POINT, "float64", "m", "finest image ground sample distance at which the point still works"),
    Variable("gsd_max", _POINT, "float64", "m", "coarsest image ground sample distance at which the point still works"),
    Variable(
        "shadow_dependence",
        _POINT,
        "float32",
        "1",
        "share of the patch that only terrain outside it keeps from the Sun, worst usable condition",
    ),
    Variable(
        "occlusion_dependence",
        _POINT,
        "float32",
        "1",
        "share of the patch that only terrain outside it hides from the camera, worst usable condition",
    ),
)

OVERVIEW_VARIABLES = (
    Variable("x", ("x",), "float64", "m", "east in the frame of the region's centre"),
    Variable("y", ("y",), "float64", "m", "north in the frame of the region's centre; falls from row to row"),
    Variable("height", ("y", "x"), "float32", "m", "height above the reference sphere; NaN: none"),
)

COVERAGE_VARIABLES = (
    Variable("cell", ("cell",), "int32", "1", "index of the spacing cell"),
    Variable("longitude", ("cell",), "float64", "deg", "longitude of the cell's centre, positive east"),
    Variable("latitude", ("cell",), "float64", "deg", "latitude of the cell's centre"),
    Variable(
        "status",
        ("cell",),
        "uint8",
        "1",
        "whether a point is near the cell, or why there is none",
        _flag_attributes("flag_values", STATUSES),
    ),
)

AXIS_VARIABLES = tuple(
    Variable(name, (name,), TEXT, "1", f"names along {name}", {"_Encoding": "utf-8"}) for name in AXES
)

GROUPS: dict[str, tuple[Variable, ...]] = {
    "": COORDINATES + AXIS_VARIABLES + VIEW_VARIABLES + POINT_VARIABLES,
    "overview": OVERVIEW_VARIABLES,
    "coverage": COVERAGE_VARIABLES,
}
"""Every dataset of the file by group; the root group has no name."""

GROUP_ATTRIBUTES = {"overview": ("center_lon", "center_lat"), "coverage": ("spacing_m",)}

GLOBAL_ATTRIBUTES = (
    "Conventions",
    "title",
    "product_version",
    "schema_version",
    "software",
    "software_version",
    "body",
    "frame",
    "reference_radius_m",
    "config",
    "sources",
    "scene_plan",
    "content_sha256",
)

Values = Mapping[str, NDArray[Any]]
"""Arrays by name; those of a group as ``group/name``."""


def usable(condition: ArrayLike) -> NDArray[np.bool_]:
    """Where a condition has all five flags; any shape."""
    return np.asarray((np.asarray(condition) & USABLE) == USABLE)


def evaluated(condition: ArrayLike) -> NDArray[np.bool_]:
    """Where a condition was evaluated: the Sun comes there; any shape."""
    return np.asarray((np.asarray(condition) & FLAGS["evaluated"]) > 0)


def summarise_usable(
    condition: ArrayLike, sun_elevation: ArrayLike
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lowest and highest usable Sun elevation, each (point, view, sun_azimuth) float32 degrees; NaN where none is usable.

    condition: uint8 (point, view, sun_elevation, sun_azimuth).
    """
    works = usable(condition)
    elevation = np.asarray(sun_elevation, dtype=np.float64)[None, None, :, None]
    none = ~works.any(axis=2)
    lowest = np.where(works, elevation, np.inf).min(axis=2, initial=np.inf)
    highest = np.where(works, elevation, -np.inf).max(axis=2, initial=-np.inf)
    lowest[none] = highest[none] = np.nan
    return lowest.astype(np.float32), highest.astype(np.float32)


def key(group: str, name: str) -> str:
    """Name of a variable inside the file."""
    return f"{group}/{name}" if group else name


def value_problems(values: Values) -> list[str]:
    """What is wrong with the values, one line each; the shapes must fit together already (`shape_problems`)."""
    return [line for check in _CHECKS for line in check(values)]


def shape_problems(values: Values) -> list[str]:
    """Dimensions that have different lengths in different variables, or a wrong number of dimensions."""
    lines: list[str] = []
    for group, variables in GROUPS.items():
        lengths = {name: len(labels) for name, labels in AXES.items()}
        for variable in variables:
            array = values[key(group, variable.name)]
            if array.ndim != len(variable.dims):
                lines.append(
                    f"{key(group, variable.name)}: {array.ndim} dimensions instead of ({', '.join(variable.dims)})"
                )
                continue
            for dim, length in zip(variable.dims, array.shape, strict=True):
                if lengths.setdefault(dim, length) != length:
                    lines.append(
                        f"{key(group, variable.name)}: {length} along {dim} where others have {lengths[dim]}"
                    )
    return lines


def _where(name: str, wrong: NDArray[np.bool_], text: str) -> list[str]:
    """A line about the rows of a variable that are wrong, if any."""
    count = int(np.count_nonzero(wrong))
    if not count:
        return []
    first = ", ".join(str(int(i[0])) for i in np.nonzero(wrong))
    return [f"{name}: {text} ({count} of {wrong.size} values; the first at [{first}])"]


def _outside(values: Values, name: str, low: float, high: float) -> list[str]:
    array = values[name]
    return _where(name, ~((array >= low) & (array <= high)), f"not in {low:g}..{high:g}")


def _check_axes(values: Values) -> Iterator[str]:
    for name in ("point", "view", "coverage/cell"):
        if not np.array_equal(values[name], np.arange(len(values[name]))):
            yield f"{name}: is not 0, 1, 2, ..."
    for name in ("patch_row", "patch_col"):
        if not np.array_equal(values[name], centred(len(values[name]))):
            yield f"{name}: does not count from the patch's centre"
    for name, sign in (("sun_elevation", 1), ("sun_azimuth", 1), ("overview/x", 1), ("overview/y", -1)):
        if not (np.isfinite(values[name]).all() and (np.diff(values[name]) * sign > 0).all()):
            yield f"{name}: is not strictly {'rising' if sign > 0 else 'falling'}"
    for name, labels in AXES.items():
        if tuple(values[name]) != labels:
            yield f"{name}: is not {', '.join(labels)}"
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
    identifiers = values["point_id"]
    if len(np.unique(identifiers)) != len(identifiers):
        yield f"point_id: {len(identifiers) - len(np.unique(identifiers))} numbers occur more than once"
    away = np.abs(values["position_mcmf"] - lonlat_to_mcmf(lon, lat, height)).max(axis=1, initial=0.0)
    yield from _where(
        "position_mcmf", ~(away <= _PLACE_TOLERANCE_M), "is not the place of longitude, latitude and elevation"
    )
    rotation = values["rotation_mcmf_to_enu"]
    expected = np.array([enu_rotation(o, a) for o, a in zip(lon, lat, strict=True)]).reshape(-1, 3, 3)
    turned = np.abs(rotation - expected).max(axis=(1, 2), initial=0.0)
    squared = rotation @ rotation.transpose(0, 2, 1)
    skew = np.abs(squared - np.eye(3)).max(axis=(1, 2), initial=0.0)
    yield from _where("rotation_mcmf_to_enu", ~(skew <= _ROTATION_TOLERANCE), "is not orthonormal")
    yield from _where(
        "rotation_mcmf_to_enu", ~(turned <= _ROTATION_TOLERANCE), "is not the frame of longitude and latitude"
    )


def _check_patches(values: Values) -> Iterator[str]:
    dem = values["dem"]
    rows, cols = dem.shape[1:]
    if not (rows == cols and rows % 2 == 1):
        yield f"dem: patches of {rows} x {cols} nodes have no centre node"
        return
    yield from _where("dem", ~np.isfinite(dem), "not a number")
    centre = dem[:, rows // 2, cols // 2]
    yield from _where("dem", ~(np.abs(centre) <= _CENTRE_TOLERANCE_M), "the centre node is not at 0")
    yield from _where("dem_product", np.array([not text for text in values["dem_product"]], bool), "is empty")
    for name in ("gsd", "gsd_min", "gsd_max"):
        yield from _where(name, ~((values[name] > 0.0) & np.isfinite(values[name])), "not a positive number")
    slack = 1.0 + 1e-9
    yield from _where("gsd_min", values["gsd_min"] > values["gsd"] * slack, "above gsd")
    yield from _where("gsd_max", values["gsd_max"] * slack < values["gsd"], "below gsd")


def _check_conditions(values: Values) -> Iterator[str]:
    condition = values["condition"]
    yield from _where("condition", condition > USABLE, "has bits that mean nothing")
    yield from _where("condition", (condition > 0) & ~evaluated(condition), "has flags without 'evaluated'")
    summary = summarise_usable(condition, values["sun_elevation"])
    for name, expected in zip(("sun_elevation_min", "sun_elevation_max"), summary, strict=True):
        same = np.isclose(values[name], expected, rtol=0.0, atol=_DEGREE_TOLERANCE, equal_nan=True)
        yield from _where(name, ~same, "does not agree with condition")


def _check_figures(values: Values) -> Iterator[str]:
    """Figures are numbers in their ranges wherever a point has a usable condition, else NaN is allowed as well."""
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
        wrong = ~within & ~(np.isnan(array) & ~known)
        yield from _where(name, wrong, f"not in {low:g}..{high:g}")
    sigma = values["localization_sigma"]
    yield from _where("localization_sigma", sigma[:, 0] < sigma[:, 1], "the major axis is below the minor")


def _check_groups(values: Values) -> Iterator[str]:
    yield from _where("coverage/status", values["coverage/status"] > max(STATUSES.values()), "has no meaning")
    yield from _outside(values, "coverage/latitude", -90.0, 90.0)
    yield from _outside(values, "coverage/longitude", -360.0, 720.0)
    yield from _where("overview/height", np.isinf(values["overview/height"]), "infinite")


_CHECKS = (_check_axes, _check_places, _check_patches, _check_conditions, _check_figures, _check_groups)


def centred(count: int) -> NDArray[np.int32]:
    """Indices of a patch's nodes counted from its centre."""
    return np.arange(count, dtype=np.int32) - count // 2


def first_few(lines: Iterable[str], count: int = 3) -> str:
    """Problems as one line."""
    lines = list(lines)
    rest = f"; and {len(lines) - count} more" if len(lines) > count else ""
    return "; ".join(lines[:count]) + rest
