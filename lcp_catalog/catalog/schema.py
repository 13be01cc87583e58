"""Variables of a catalogue file: dimensions, type, unit and meaning of each, for writer, reader and
checks; and the flags of its conditions.

Datasets and attributes of the file by name, and how claims are packed; independent of HDF5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray, Float32, Index
from ..choices import LEVEL_RATIO
from ..constants import MOON_RADIUS_M
from ..geometry.map_plane import (
    EQUIRECTANGULAR,
    GEOGRAPHIC_WKT,
    ORTHOGRAPHIC,
    POLAR_STEREOGRAPHIC,
    MapPlane,
)

SCHEMA_VERSION = "3.0"
"""Version of the files that are written and read."""

PACKED = ("detection_probability", "sigma_major", "sigma_minor", "sigma_angle")
"""Variables stored as small whole numbers; the catalogue in memory holds them unpacked."""

FIGURES = (
    "harris_response",
    "second_peak",
    "false_match_probability",
    "gsd_min",
    "gsd_max",
    "shadow_dependence",
    "occlusion_dependence",
)
"""Variables of one figure for each point over its usable conditions."""

OPTIONAL_GROUPS = (
    "promise",
    "overview_2",
    "overview_4",
    "overview_8",
    "coverage_levels",
    "coverage_map",
)
"""Groups that a file has only if the catalogue was built with them."""

OPTIONAL = ("albedo",)
"""Variables that a file has only if the catalogue was built with them."""

FLAG_MASKS = (1, 2, 4, 8, 16)
FLAG_MEANINGS = ("evaluated", "localizable", "unique", "unshadowed", "unoccluded")
EVALUATED, LOCALIZABLE, UNIQUE, UNSHADOWED, UNOCCLUDED = FLAG_MASKS
USABLE = sum(FLAG_MASKS)

UNIVERSAL_SHARE = 0.95
"""Least usable share of the evaluated conditions of a universal point."""

DETECTION_STEP = 1.0 / 250.0
"""Step of the stored detection probability."""

COVERAGE_UNKNOWN = 255
"""Value of ``coverage/usable`` in conditions that were evaluated for no point."""

COVERAGE_STATUS = {
    0: "point",
    1: "featureless",
    2: "ambiguous",
    3: "dependent",
    4: "nodata",
    5: "spare",
}


class Cause(IntEnum):
    """Why fewer points than promised are usable near a place under a view and the Suns of a cell; those
    of several candidates: the last of the list.
    """

    MET = 0
    """As many as promised."""
    NODATA = 1
    """No heights there."""
    DARK = 2
    """Too dark, or without any contrast."""
    FEATURELESS = 3
    """Too little texture to localise a point, or no candidate at all."""
    AMBIGUOUS = 4
    """Similar to other terrain within the search radius."""
    DEPENDENT = 5
    """Shadowed or hidden by terrain outside the patch."""
    MARGINAL = 6
    """Usable under the Suns that were evaluated, but not surely between them."""
    FEW = 7
    """Usable candidates, but fewer than promised."""
    SIZE = 8
    """Enough usable candidates, but the number of points is limited."""


NO_CELL = 255
"""Value of ``promise/points`` and ``promise/cause`` where nothing is promised."""


class Variable(NamedTuple):
    """A variable of the file; ``dims``: names of its dimensions in order; ``dtype``: NumPy's name,
    or ``str`` for text.
    """

    dims: tuple[str, ...]
    dtype: str
    units: str
    long_name: str


_CONDITION = ("point", "view", "sun_elevation", "sun_azimuth")
_CLAIM = ("point", "image_scale", "view", "sun_elevation", "sun_azimuth")

COORDINATES = {
    "point": Variable(("point",), "i4", "1", "number of the control point in this file"),
    "patch_row": Variable(("patch_row",), "i4", "1", "nodes south of the patch's centre"),
    "patch_col": Variable(("patch_col",), "i4", "1", "nodes east of the patch's centre"),
    "view": Variable(("view",), "i4", "1", "number of the viewpoint"),
    "sun_elevation": Variable(
        ("sun_elevation",), "f8", "degree", "elevation of the Sun at the point"
    ),
    "sun_azimuth": Variable(
        ("sun_azimuth",), "f8", "degree", "azimuth of the Sun at the point, clockwise from north"
    ),
    "image_scale": Variable(
        ("image_scale",), "f8", "1", "pixel of the image as a multiple of the patch's cell size"
    ),
    "mcmf_axis": Variable(("mcmf_axis",), "i4", "1", "axis of the Moon-fixed frame: x, y, z"),
    "enu_axis": Variable(("enu_axis",), "i4", "1", "axis of the point's frame: east, north, up"),
    "ellipse_axis": Variable(
        ("ellipse_axis",), "i4", "1", "axis of the error ellipse: major, minor"
    ),
}

VARIABLES = {
    "view_off_nadir": Variable(
        ("view",), "f8", "degree", "angle at the point between the vertical and the camera"
    ),
    "view_azimuth": Variable(
        ("view",), "f8", "degree", "azimuth of the camera seen from the point"
    ),
    "view_altitude": Variable(
        ("view",), "f8", "km", "altitude of the camera, inf for parallel rays"
    ),
    "point_id": Variable(
        ("point",), "i8", "1", "identifier of the ground, the same in every build"
    ),
    "longitude": Variable(("point",), "f8", "degrees_east", "planetocentric longitude, 0..360"),
    "latitude": Variable(("point",), "f8", "degrees_north", "planetocentric latitude"),
    "elevation": Variable(
        ("point",), "f8", "m", "height of the patch's centre above the reference sphere"
    ),
    "position_mcmf": Variable(
        ("point", "mcmf_axis"), "f8", "m", "position of the patch's centre, Moon-fixed frame"
    ),
    "rotation_mcmf_to_enu": Variable(
        ("point", "enu_axis", "mcmf_axis"),
        "f8",
        "1",
        "rotation to the point's frame, rows east, north, up",
    ),
    "gsd": Variable(("point",), "f8", "m", "cell size of the patch"),
    "dem_product": Variable(("point",), "str", "1", "DEM product that the patch was cut from"),
    "elevation_sigma": Variable(
        ("point",),
        "f8",
        "m",
        "1-sigma of the DEM's heights, from a map or as published for the product, NaN for none",
    ),
    "dem_resolution": Variable(
        ("point",),
        "f8",
        "m",
        "effective ground resolution of the DEM, measured from its heights, else published, NaN for none",
    ),
    "dem": Variable(
        ("point", "patch_row", "patch_col"),
        "f4",
        "m",
        "up coordinate of the patch's nodes in the point's frame, row 0 north, column 0 west",
    ),
    "albedo": Variable(
        ("point", "patch_row", "patch_col"),
        "f4",
        "1",
        "brightness of the patch's nodes relative to the map's reference, NaN outside the map",
    ),
    "condition": Variable(
        _CONDITION, "u1", "1", "what holds for the point under each view and Sun"
    ),
    "sun_elevation_min": Variable(
        ("point", "view", "sun_azimuth"),
        "f8",
        "degree",
        "lowest usable elevation of the Sun, NaN for none",
    ),
    "sun_elevation_max": Variable(
        ("point", "view", "sun_azimuth"),
        "f8",
        "degree",
        "highest usable elevation of the Sun, NaN for none",
    ),
    "harris_response": Variable(
        ("point",), "f8", "1", "Harris response of the patch, median over usable conditions"
    ),
    "localization_sigma": Variable(
        ("point", "ellipse_axis"),
        "f8",
        "m",
        "1-sigma of the position, worst usable condition, at the stated noise",
    ),
    "second_peak": Variable(
        ("point",),
        "f8",
        "1",
        "highest correlation with anything else in the search radius, worst usable condition",
    ),
    "false_match_probability": Variable(
        ("point",),
        "f8",
        "1",
        "probability that the highest correlation is elsewhere, worst usable condition",
    ),
    "gsd_min": Variable(("point",), "f8", "m", "finest image resolution at which the point works"),
    "gsd_max": Variable(
        ("point",), "f8", "m", "coarsest image resolution at which the point works"
    ),
    "shadow_dependence": Variable(
        ("point",),
        "f8",
        "1",
        "share of the patch that terrain outside it darkens, worst usable condition",
    ),
    "occlusion_dependence": Variable(
        ("point",),
        "f8",
        "1",
        "share of the patch that terrain outside it hides, worst usable condition",
    ),
    "detection_probability": Variable(
        _CLAIM, "u1", "1", "probability that a search finds the true place and no other"
    ),
    "sigma_major": Variable(
        _CLAIM, "u2", "m", "1-sigma of the matched place along the major axis of its error ellipse"
    ),
    "sigma_minor": Variable(
        _CLAIM, "u2", "m", "1-sigma of the matched place along the minor axis of its error ellipse"
    ),
    "sigma_angle": Variable(
        _CLAIM, "u1", "degree", "direction of the major axis, clockwise from north"
    ),
    "universal": Variable(
        ("point",), "u1", "1", "1 for points usable in at least 95 % of the evaluated conditions"
    ),
    "level": Variable(("point",), "i4", "1", "index of the cell size"),
}

OVERVIEW = {
    "height": Variable(("y", "x"), "f4", "m", "height above the reference sphere"),
    "x": Variable(("x",), "f8", "m", "east of the centre, orthographic"),
    "y": Variable(("y",), "f8", "m", "north of the centre, orthographic"),
}

LEVEL_FACTORS = (2, 4, 8)
"""Nodes of the overview along the side of one of a level; cells of the coverage likewise."""

COVERAGE = {
    "cell": Variable(("cell",), "i4", "1", "number of the spacing cell"),
    "longitude": Variable(("cell",), "f8", "degrees_east", "longitude of the cell's centre"),
    "latitude": Variable(("cell",), "f8", "degrees_north", "latitude of the cell's centre"),
    "status": Variable(("cell",), "u1", "1", "whether a point is within one spacing, or why not"),
    "usable": Variable(
        ("cell", "view", "sun_elevation", "sun_azimuth"),
        "u1",
        "1",
        "1 if a usable point is within one spacing of the cell's centre",
    ),
}

COVERAGE_LEVELS = {
    "block": Variable(("block",), "i4", "1", "number of the wider cell"),
    "code": Variable(("code",), "i4", "1", "status of a cell of the coverage"),
    "factor": Variable(("block",), "i4", "1", "width over that of the cells of the coverage"),
    "longitude": Variable(("block",), "f8", "degrees_east", "longitude of the cell's centre"),
    "latitude": Variable(("block",), "f8", "degrees_north", "latitude of the cell's centre"),
    "cells": Variable(("block", "code"), "i4", "1", "number of cells of the coverage by status"),
    "usable_share": Variable(
        ("block",), "f4", "1", "share of cells and conditions with a usable point near"
    ),
}

COVERAGE_MAP = {
    "status": Variable(
        ("y_cell", "x_cell"), "u1", "1", "status of the nearest cell of the coverage"
    ),
    "usable_share": Variable(
        ("y_cell", "x_cell"), "f4", "1", "share of its conditions with a usable point near"
    ),
    "x_cell": Variable(("x_cell",), "f8", "m", "east of the centre, orthographic"),
    "y_cell": Variable(("y_cell",), "f8", "m", "north of the centre, orthographic"),
}

_NEAR = ("place", "view", "sun_elevation", "sun_azimuth")

PROMISE = {
    "place": Variable(("place",), "i4", "1", "number of the place"),
    "longitude": Variable(("place",), "f8", "degrees_east", "longitude of the place"),
    "latitude": Variable(("place",), "f8", "degrees_north", "latitude of the place"),
    "demand": Variable(("place",), "u1", "1", "usable points promised to a camera above the place"),
    "points": Variable(
        _NEAR,
        "u1",
        "1",
        "points near the place that are usable under all Suns from this elevation and azimuth to the next",
    ),
    "cause": Variable(_NEAR, "u1", "1", "why there are fewer points than promised"),
    "step": Variable(("step",), "i4", "1", "number of the step of the choice"),
    "size": Variable(("step",), "i4", "1", "number of points chosen up to the step"),
    "met": Variable(
        ("step",), "f8", "1", "share of the places and conditions with as many points as possible"
    ),
    "served": Variable(
        ("step",), "f8", "1", "share of all points that places and conditions ask for"
    ),
    "part": Variable(("part",), "i4", "1", "number of the promise of one cell size and region"),
    "places": Variable(
        ("part",), "i4", "1", "number of its places; those of the first promise come first"
    ),
    "gsd": Variable(("part",), "f8", "m", "cell size of the points that it counts"),
    "per_view": Variable(("part",), "i4", "1", "usable points promised in a footprint"),
    "footprint": Variable(("part",), "f8", "m", "diameter of the ground that a camera sees"),
    "radius": Variable(
        ("part",), "f8", "m", "around a place that every camera sees whose nearest place it is"
    ),
    "lower_bound": Variable(
        ("part",), "f8", "1", "points that every choice with the same promise has at least"
    ),
}


def usable(condition: ArrayLike) -> NDArray[np.bool_]:
    """True for conditions with all five flags; any shape."""
    return np.asarray((np.asarray(condition) & USABLE) == USABLE)


def evaluated(condition: ArrayLike) -> NDArray[np.bool_]:
    """True for conditions that were evaluated, because the Sun reaches them; any shape."""
    return np.asarray((np.asarray(condition) & EVALUATED) > 0)


def reaches(detection_probability: ArrayLike, least: float) -> NDArray[np.bool_]:
    """True where a probability, as stored in steps of `DETECTION_STEP`, is at least ``least``;
    False for NaN.
    """
    return np.asarray(np.asarray(detection_probability) >= least - DETECTION_STEP / 2.0)


def universal(condition: ArrayLike) -> NDArray[np.bool_]:
    """True for points that are usable in at least `UNIVERSAL_SHARE` of their evaluated conditions,
    (point,).

    ``condition``: uint8 (point, view, sun_elevation, sun_azimuth). False for a point without an
    evaluated condition.
    """
    axes = (1, 2, 3)
    known = evaluated(condition).sum(axis=axes)
    good = usable(condition).sum(axis=axes)
    return np.asarray((known > 0) & (good >= UNIVERSAL_SHARE * known))


def summarise_usable(condition: ArrayLike, sun_elevation: ArrayLike) -> tuple[AnyArray, AnyArray]:
    """Lowest and highest usable Sun elevation, each (point, view, sun_azimuth), degrees; NaN
    without a usable one.

    ``condition``: uint8 (point, view, sun_elevation, sun_azimuth).
    """
    works = usable(condition)
    elevation = np.asarray(sun_elevation, dtype=np.float64)[None, None, :, None]
    none = ~works.any(axis=2)
    lowest = np.where(works, elevation, np.inf).min(axis=2, initial=np.inf)
    highest = np.where(works, elevation, -np.inf).max(axis=2, initial=-np.inf)
    lowest[none] = highest[none] = np.nan
    return lowest, highest


def levels(gsd_m: ArrayLike) -> Index:
    """Level of each cell size (n,), metres: 0 for the finest, one more wherever the next larger size
    exceeds the one before by more than `LEVEL_RATIO`.
    """
    sizes, back = np.unique(np.asarray(gsd_m, np.float64), return_inverse=True)
    steps = np.concatenate(
        [np.zeros(min(1, len(sizes)), bool), sizes[1:] > LEVEL_RATIO * sizes[:-1]]
    )
    return np.asarray(np.cumsum(steps)[back.reshape(-1)], np.int64)


TEXT = "str"

LEVELS = tuple(f"overview_{factor}" for factor in LEVEL_FACTORS)
"""Groups of the coarser levels of the overview."""

GROUPS: dict[str, dict[str, Variable]] = {
    "": COORDINATES | VARIABLES,
    "overview": OVERVIEW,
    "coverage": COVERAGE,
    "promise": PROMISE,
    **dict.fromkeys(LEVELS, OVERVIEW),
    "coverage_levels": COVERAGE_LEVELS,
    "coverage_map": COVERAGE_MAP,
}
"""Every dataset of the file by group and name; the root group has no name."""

GROUP_ATTRIBUTES = {
    "overview": ("center_lon", "center_lat"),
    "coverage": ("spacing_m",),
    **dict.fromkeys(LEVELS, ("center_lon", "center_lat", "projection")),
    "coverage_levels": ("step_m",),
    "coverage_map": ("center_lon", "center_lat", "projection"),
}

OPTIONAL_GROUP_ATTRIBUTES = {"overview": "projection", "coverage": "step_m"}
"""Attributes of the groups of a region that no tangent plane shows (since schema 2.1)."""

OPTIONAL_ATTRIBUTES = ("albedo_map",)
"""Attributes of a catalogue with albedo."""

NUMBERS = ("reference_radius_m", "sigma_step_m")
"""Global attributes that are numbers; the others are text."""

GLOBAL_ATTRIBUTES = (
    "Conventions",
    "title",
    "product_version",
    "schema_version",
    "software",
    "software_version",
    "history",
    "body",
    "frame",
    "reference_radius_m",
    "config",
    "sources",
    "scene_plan",
    "errors",
    "sigma_step_m",
    "content_sha256",
)

FIXED = {"mcmf_axis": 3, "enu_axis": 3, "ellipse_axis": 2}
"""Lengths of the dimensions that all catalogues share."""

_CODES = {
    "status": COVERAGE_STATUS,
    "cause": {cause.value: cause.name.lower() for cause in Cause},
    "universal": {0: "no", 1: "yes"},
}
"""Meanings of the values of variables that stand for words."""

Values = Mapping[str, AnyArray]
"""Every dataset of the file by its path in it."""


def key(group: str, name: str) -> str:
    """Path of a variable inside the file."""
    return f"{group}/{name}" if group else name


_RASTERS = ("overview", *LEVELS, "coverage_map")
"""Groups of rasters in the plane of the overview."""

CRS, CRS_ATTRIBUTE = "crs", "grid_mapping"
"""Variable of a group for maps that holds its CRS, as attributes for CF readers and GDAL."""


def grid_mapping(group: str, numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of `CRS` of a group with the attributes ``numbers``; empty for a group without. ValueError
    for a plane that does not exist.
    """
    if group in ("coverage", "promise", "coverage_levels"):
        return {
            "grid_mapping_name": "latitude_longitude",
            "longitude_of_prime_meridian": 0.0,
            "earth_radius": MOON_RADIUS_M,
            "crs_wkt": GEOGRAPHIC_WKT,
        }
    if group not in _RASTERS:
        return {}
    plane = MapPlane(
        str(numbers.get("projection", ORTHOGRAPHIC)),
        float(numbers["center_lon"]),
        float(numbers["center_lat"]),
    )
    return {
        "grid_mapping_name": plane.projection.replace(" ", "_"),
        **_origin(plane),
        "false_easting": 0.0,
        "false_northing": 0.0,
        "earth_radius": MOON_RADIUS_M,
        "crs_wkt": plane.wkt,
    }


def _origin(plane: MapPlane) -> dict[str, float]:
    """Numbers of the projection by their names in CF."""
    lon, lat = plane.center_lon, plane.center_lat
    if plane.projection == POLAR_STEREOGRAPHIC:
        return {
            "straight_vertical_longitude_from_pole": lon,
            "latitude_of_projection_origin": lat,
            "scale_factor_at_projection_origin": 1.0,
        }
    found = {"longitude_of_projection_origin": lon, "latitude_of_projection_origin": lat}
    return found | ({"standard_parallel": lat} if plane.projection == EQUIRECTANGULAR else {})


def variable_attributes(
    group: str,
    name: str,
    variable: Variable,
    sigma_step_m: float = 1.0,
    projection: str = ORTHOGRAPHIC,
) -> dict[str, Any]:
    """Attributes of a variable of a group: unit, meaning, and those that CF readers need for flags,
    text, packed numbers and places. ``projection``: that of the overview.
    """
    meaning = variable.long_name.replace(ORTHOGRAPHIC, projection)
    found: dict[str, Any] = {"long_name": meaning, "units": variable.units}
    if variable.dtype == TEXT:
        found["_Encoding"] = "utf-8"
    if name in ("longitude", "latitude"):
        found["standard_name"] = name
    if name == "condition":
        found |= {
            "flag_masks": np.array(FLAG_MASKS, np.uint8),
            "flag_meanings": " ".join(FLAG_MEANINGS),
        }
    if name in _CODES:
        codes = np.array(list(_CODES[name]), np.uint8)
        found |= {"flag_values": codes, "flag_meanings": " ".join(_CODES[name].values())}
    if name in PACKED:
        found |= packing(name, sigma_step_m).attributes
    if variable.dims[0] == "place" and len(variable.dims) > 1:
        found["_FillValue"] = np.uint8(NO_CELL)
    if name == "usable":
        found["_FillValue"] = np.uint8(COVERAGE_UNKNOWN)
    if group in _RASTERS and len(variable.dims) == 2:
        whole = variable.dtype == "u1"  # GDAL reads NaN as 0 without a fill value
        found["_FillValue"] = np.uint8(NO_CELL) if whole else np.float32(np.nan)
    return found | _places(group, name, variable)


_VIEWS = "view_off_nadir view_azimuth view_altitude"
"""Coordinates of variables that depend on the view."""

_PLACES = {
    "": ("point", "point_id longitude latitude level"),
    "coverage": ("cell", "longitude latitude"),
    "promise": ("place", "longitude latitude"),
    "coverage_levels": ("block", "longitude latitude"),
}
"""Dimension of a group's places, and their coordinates."""


def _places(group: str, name: str, variable: Variable) -> dict[str, str]:
    """Attributes that say where the values of a variable lie."""
    if group in _RASTERS:
        if name in variable.dims:
            return {"standard_name": f"projection_{name[0]}_coordinate", "axis": name[0].upper()}
        return {CRS_ATTRIBUTE: CRS}
    if group not in _PLACES:
        return {}
    dim, own = _PLACES[group]
    if variable.dims[0] != dim or name in (dim, *own.split()):
        return {}
    if group:
        return {"coordinates": own, CRS_ATTRIBUTE: CRS}
    return {"coordinates": f"{own} {_VIEWS}" if "view" in variable.dims else own}


def centred(count: int) -> NDArray[np.int32]:
    """Indices of a patch's nodes counted from its centre."""
    return np.arange(count, dtype=np.int32) - count // 2


SIGMA_STEPS_PER_CELL = 1000
"""Steps of a stored sigma in the smallest cell of a catalogue."""


@dataclass(frozen=True)
class Packing:
    """Rule of one variable: value = number * ``step``; ``missing`` stands for NaN, ``largest`` for
    itself and everything above.
    """

    dtype: str
    step: float
    largest: int
    missing: int

    def packed(self, values: ArrayLike) -> AnyArray:
        """Whole numbers nearest to the values; NaN becomes ``missing``, negative values 0."""
        array = np.asarray(values, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            number = np.clip(np.rint(array / self.step), 0.0, self.largest)
        return np.where(np.isnan(array), self.missing, number).astype(self.dtype)

    def unpacked(self, numbers: AnyArray) -> Float32:
        """Values as float32, NaN where missing."""
        table = np.arange(self.missing + 1) * self.step
        table[self.missing] = np.nan
        return table.astype(np.float32)[numbers]

    @property
    def attributes(self) -> dict[str, np.generic]:
        """CF attributes ``scale_factor`` and ``_FillValue``."""
        return {
            "scale_factor": np.float32(self.step),
            "_FillValue": np.dtype(self.dtype).type(self.missing),
        }


def sigma_step_m(gsd_m: AnyArray) -> float:
    """Step of the stored sigmas: a thousandth of the smallest cell, rounded to a float32."""
    smallest = float(np.min(gsd_m)) if np.size(gsd_m) else 1.0
    return float(np.float32(smallest / SIGMA_STEPS_PER_CELL))


def packing(name: str, sigma_step_m: float) -> Packing:
    """Rule of a variable of `schema.PACKED`."""
    if name == "detection_probability":
        return Packing("u1", DETECTION_STEP, 250, 255)
    if name == "sigma_angle":
        return Packing("u1", 1.0, 180, 255)
    return Packing("u2", sigma_step_m, 65534, 65535)


def axis_direction(angle_deg: ArrayLike) -> NDArray[np.float64]:
    """Directions of an axis in whole degrees, 0..179."""
    whole = np.array(np.rint(np.asarray(angle_deg, dtype=np.float64)) + 0.0)
    outside = (whole < 0.0) | (whole >= 180.0)  # np.mod takes ten times as long for NaN
    np.mod(whole, 180.0, out=whole, where=outside)
    return whole
