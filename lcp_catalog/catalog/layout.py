"""Datasets and attributes of the file by name, and how claims are packed; independent of HDF5."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray, Float32
from ..constants import MOON_RADIUS_M
from ..geometry.map_plane import (
    EQUIRECTANGULAR,
    GEOGRAPHIC_WKT,
    ORTHOGRAPHIC,
    POLAR_STEREOGRAPHIC,
    MapPlane,
)
from .schema import (
    COORDINATES,
    COVERAGE,
    COVERAGE_LEVELS,
    COVERAGE_MAP,
    COVERAGE_STATUS,
    COVERAGE_UNKNOWN,
    DETECTION_STEP,
    FLAG_MASKS,
    FLAG_MEANINGS,
    LEVEL_FACTORS,
    NO_CELL,
    OVERVIEW,
    PACKED,
    PROMISE,
    VARIABLES,
    Cause,
    Variable,
)

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
