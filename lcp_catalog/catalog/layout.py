"""Datasets and attributes of the file by name, and the digest of its content; independent of HDF5."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray
from ..constants import MOON_RADIUS_M
from ..geometry.map_plane import (
    EQUIRECTANGULAR,
    GEOGRAPHIC_WKT,
    ORTHOGRAPHIC,
    POLAR_STEREOGRAPHIC,
    MapPlane,
)
from .packing import packing
from .schema import (
    CLAIMS,
    COORDINATES,
    COVERAGE,
    COVERAGE_LEVELS,
    COVERAGE_MAP,
    COVERAGE_STATUS,
    COVERAGE_UNKNOWN,
    FLAG_MASKS,
    FLAG_MEANINGS,
    GUARANTEE,
    NO_CELL,
    OPTIONAL,
    OVERVIEW,
    OVERVIEW_LEVELS,
    PACKED,
    PROMISES,
    VARIABLES,
    Cause,
    Variable,
)

TEXT = "str"

GROUPS: dict[str, dict[str, Variable]] = {
    "": COORDINATES | VARIABLES,
    "overview": OVERVIEW,
    "coverage": COVERAGE,
    "guarantee": GUARANTEE,
    "promises": PROMISES,
    "overview_levels": OVERVIEW_LEVELS,
    "coverage_levels": COVERAGE_LEVELS,
    "coverage_map": COVERAGE_MAP,
}
"""Every dataset of the file by group and name; the root group has no name."""

GROUP_ATTRIBUTES = {
    "overview": ("center_lon", "center_lat"),
    "coverage": ("spacing_m",),
    "guarantee": ("per_view", "footprint_m", "radius_m", "lower_bound"),
    "overview_levels": ("center_lon", "center_lat", "projection"),
    "coverage_levels": ("step_m",),
    "coverage_map": ("center_lon", "center_lat", "projection"),
}

OPTIONAL_GROUP_ATTRIBUTES = {"overview": "projection", "coverage": "step_m"}
"""Attributes of the groups of a region that no tangent plane shows (since schema 2.1)."""

OPTIONAL_ATTRIBUTES = ("albedo_map", "albedo_sha256")
"""Attributes of a catalogue with albedo: its map, and a digest of both. `content_sha256` leaves
them out, so that a reader of schema 1.1 finds the content that it supports intact.
"""

CLAIM_ATTRIBUTES = ("errors", "sigma_step_m")
"""Attributes of a catalogue with claims: the error model they hold for (JSON), and the step in
metres in which sigmas are stored.
"""

NUMBERS = ("reference_radius_m", "sigma_step_m")
"""Global attributes that are numbers; the others are text."""

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

FIXED = {"mcmf_axis": 3, "enu_axis": 3, "ellipse_axis": 2}
"""Lengths of the dimensions that all catalogues share."""

_CODES = {
    "status": COVERAGE_STATUS,
    "cause": {cause.value: cause.name.lower() for cause in Cause},
    "universal": {0: "no", 1: "yes"},
}
"""Meanings of the values of variables that stand for words."""

_PIECE_BYTES = 2**23
"""Content that is digested together."""

Values = Mapping[str, AnyArray]
"""Every dataset of the file by its path in it."""

Groups = Mapping[str, Mapping[str, float | str]]
"""Attributes of the groups by group and name."""


def key(group: str, name: str) -> str:
    """Path of a variable inside the file."""
    return f"{group}/{name}" if group else name


def is_claim(path: str) -> bool:
    """True for a variable, by its path in the file, that only files with claims have."""
    return path in CLAIMS


_RASTERS = ("overview", "overview_levels", "coverage_map")
"""Groups of rasters in the plane of the overview."""

CRS, CRS_ATTRIBUTE = "crs", "grid_mapping"
"""Variable of a group for maps that holds its CRS, as attributes for CF readers and GDAL."""


def grid_mapping(group: str, numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of `CRS` of a group with the attributes ``numbers``; empty for a group without. ValueError
    for a plane that does not exist.
    """
    if group in ("coverage", "guarantee", "coverage_levels"):
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

LEVEL = "level"
"""Coordinate of points that files without claims, and those before schema 2.5, do not name."""

_PLACES = {
    "": ("point", f"point_id longitude latitude {LEVEL}"),
    "coverage": ("cell", "longitude latitude"),
    "guarantee": ("place", "longitude latitude"),
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


def without_level(attributes: dict[str, Any]) -> dict[str, Any]:
    """Attributes of a variable in files that do not name `LEVEL`."""
    names = [name for name in str(attributes.get("coordinates", "")).split() if name != LEVEL]
    return attributes | ({"coordinates": " ".join(names)} if names else {})


def former_attributes(attributes: dict[str, Any]) -> dict[str, Any]:
    """Attributes of a variable in files of `schema.WITHOUT_PLACES`."""
    new = (CRS_ATTRIBUTE, "axis")
    found = {name: value for name, value in attributes.items() if name not in new}
    if np.isnan(found.get("_FillValue", 0)):
        del found["_FillValue"]
    if str(found.get("standard_name", "")).startswith("projection"):
        del found["standard_name"]
    coordinates = found.pop("coordinates", "")
    return found | ({"coordinates": _VIEWS} if _VIEWS in coordinates else {})


def centred(count: int) -> NDArray[np.int32]:
    """Indices of a patch's nodes counted from its centre."""
    return np.arange(count, dtype=np.int32) - count // 2


def split(values: Values) -> tuple[dict[str, AnyArray], dict[str, AnyArray]]:
    """The variables of every catalogue, and those of some catalogues only."""
    optional = {name: values[name] for name in OPTIONAL if name in values}
    return {name: values[name] for name in values if name not in optional}, optional


def digest(values: Values, attributes: dict[str, Any], groups: Groups) -> str:
    """SHA-256 over names, shapes and content: detects damage where HDF5 has no checksum of its own.

    ``values``: arrays, or what gives arrays for slices along the first axis; numbers are read piece by
    piece, text as a whole. While a piece is read, a thread adds the one before.
    """
    total = hashlib.sha256(json.dumps([attributes, groups], sort_keys=True).encode())
    with ThreadPoolExecutor(1, "digest") as pool:
        before: Future[None] | None = None
        for piece in _pieces(values):
            if before is not None:
                before.result()
            before = pool.submit(total.update, piece)
        if before is not None:
            before.result()
    return total.hexdigest()


def _pieces(values: Values) -> Iterator[bytes]:
    """Names, shapes and content as `digest` adds them."""
    for name in sorted(values):
        array = values[name]
        yield f"{name} {array.shape}".encode()
        if array.dtype == object:
            yield json.dumps(list(array.ravel())).encode()
            continue
        rows = max(1, _PIECE_BYTES // max(1, array[:1].nbytes))
        for start in range(0, len(array), rows):
            yield array[start : start + rows].tobytes()


def digests(
    values: Values,
    attributes: dict[str, Any],
    groups: Groups,
    optional: dict[str, Any],
) -> dict[str, Any]:
    """The attributes that only some catalogues have, and the digests of the common and of the
    optional content.
    """
    plain, extra = split(values)
    found: dict[str, Any] = {"content_sha256": digest(plain, attributes, groups)}
    if optional:
        found |= optional | {"albedo_sha256": digest(extra, optional, {})}
    return found
