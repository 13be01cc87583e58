"""Vector maps for GIS: points, footprints of the patches, and coverage cells, as GeoPackage and GeoJSON.

Longitudes are -180..180. A footprint across the antimeridian is cut there, one around a pole is
closed along the pole's edge of the map.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import AnyArray, Array
from ..catalog.schema import COVERAGE_STATUS
from ..constants import FRAME
from ..errors import package
from ..geometry.bounds import wrapped_deg
from ..geometry.frames import mcmf_to_lonlat
from .points import ExportedPoints, cells, plain, write_checked

_SIDE = 8
"""Most pieces of a footprint's side."""

FIXED_TIME = "2000-01-01T00:00:00.000Z"
"""Time of change in a GeoPackage, so that equal exports have equal bytes."""

_OPTIONS = {
    "OGR_CURRENT_DATE": FIXED_TIME,
    "OGR_SQLITE_JOURNAL": "MEMORY",
    "OGR_SQLITE_SYNCHRONOUS": "OFF",
}
"""Of GDAL for a GeoPackage: the time of change, and no journal on the disk,
because the file is new, and synced as a whole before it gets its name.
"""

_URN = "urn:ogc:def:crs:IAU:2015:30100"

Fields = dict[str, AnyArray]
Layer = tuple[str, str, Any, Fields]


def layers(points: ExportedPoints, wanted_for: str) -> Iterator[Layer]:
    """Name, type of geometry, geometries and fields of each layer. MissingPackageError without
    shapely.
    """
    shapely = package("shapely", "gis", wanted_for)
    columns = points.columns()
    fields = {column.name: column.values for column in columns}
    yield "points", "Point Z", shapely.points(points.lonlat_height), fields
    few = {name: fields[name] for name in ("point_id", "gsd_m", "level", "usable_share", "frame")}
    yield "footprints", "MultiPolygon", _footprints(points, shapely), few
    found = cells(points)
    places = np.stack([found["longitude_deg"], found["latitude_deg"]], -1)
    status = np.array([COVERAGE_STATUS[code] for code in found["status"].tolist()], dtype=object)
    frame = np.full(len(status), points.frame.name, object)
    yield "coverage", "Point", shapely.points(places), {"status": status, "frame": frame}


def _footprints(points: ExportedPoints, shapely: Any) -> AnyArray:
    """Outlines of the patches through their outermost nodes, multi-polygons (n,)."""
    side = points.catalog.patch_nodes - 1
    steps = np.unique(np.linspace(0, side, _SIDE + 1).round().astype(int))
    low, high = np.zeros(len(steps) - 1, int), np.full(len(steps) - 1, side)
    go, back = steps[:-1], steps[:0:-1]
    rows = np.concatenate([low, go, high, back])
    columns = np.concatenate([go, high, back, low])[::-1]  # counter-clockwise seen from above
    rows = rows[::-1]
    found = []
    for block, dem in points.blocks("dem"):
        lon, lat, _ = mcmf_to_lonlat(points.nodes_m(block, dem)[:, rows, columns])
        lon = wrapped_deg(lon)
        whole = shapely.multipolygons(shapely.polygons(np.stack([lon, lat], -1))[:, None])
        for k in np.flatnonzero(np.ptp(lon, axis=1) > 180.0):
            whole[k] = outline(lon[k], lat[k], shapely)
        found.append(whole)
    return np.concatenate(found)


def outline(lon_deg: Array, lat_deg: Array, shapely: Any) -> Any:
    """Multi-polygon within longitudes -180..180 of a convex ring of places (m,) on the sphere."""
    lon = np.unwrap(np.append(lon_deg, lon_deg[0]), period=360.0)
    if abs(lon[-1] - lon[0]) > 180.0:
        return shapely.MultiPolygon(
            [shapely.orient_polygons(_around_pole(lon_deg, lat_deg, shapely))]
        )
    whole = shapely.Polygon(np.stack([lon, np.append(lat_deg, lat_deg[0])], -1))
    first, last = np.floor((lon.min() + 180.0) / 360.0), np.ceil((lon.max() + 180.0) / 360.0)
    parts: list[Any] = []
    for turn in np.arange(first, last) * 360.0:
        part = whole.intersection(shapely.box(turn - 180.0, -90.0, turn + 180.0, 90.0))
        parts.append(shapely.transform(part, lambda xy, by=turn: xy - [by, 0.0]))
    return shapely.MultiPolygon([shapely.orient_polygons(one) for one in parts])


def _around_pole(lon_deg: Array, lat_deg: Array, shapely: Any) -> Any:
    """Polygon of a ring around a pole, from one edge of the map to the other and along the pole."""
    order = np.argsort(wrapped_deg(lon_deg))
    lon, lat = wrapped_deg(lon_deg)[order], lat_deg[order]
    edge = np.interp(180.0, [lon[-1], lon[0] + 360.0], [lat[-1], lat[0]])
    pole = 90.0 if lat.mean() > 0.0 else -90.0
    ends = [(180.0, edge), (180.0, pole), (-180.0, pole), (-180.0, edge)]
    return shapely.Polygon([*zip(lon, lat, strict=True), *ends])


def write_geopackage(points: ExportedPoints, path: Path) -> None:
    """A GeoPackage with the three layers; the frame is metadata of file and layers, and a field.
    MissingPackageError without pyogrio or shapely.
    """
    pyogrio = package("pyogrio", "gis", "a .gpkg file")
    shapely = package("shapely", "gis", "a .gpkg file")
    about = {"frame": points.frame.name, "frame_meaning": points.frame.meaning, "body": "MOON"}
    before = {name: pyogrio.get_gdal_config_option(name) for name in _OPTIONS}
    pyogrio.set_gdal_config_options(_OPTIONS)

    def write(files: tuple[Path, Path]) -> None:
        for name, kind, geometry, fields in layers(points, "a .gpkg file"):
            first = name == "points"
            for file in files:
                pyogrio.raw.write(
                    file,
                    shapely.to_wkb(geometry),
                    list(fields.values()),
                    list(fields),
                    geometry_type=kind,
                    crs=points.frame.crs,
                    layer=name,
                    driver="GPKG",
                    append=not first,
                    layer_metadata=about,
                    dataset_metadata=about if first else None,
                )

    try:
        with warnings.catch_warnings(action="ignore"):  # GDAL's, of what `write_checked` finds
            write_checked(write, path)
    finally:
        pyogrio.set_gdal_config_options(before)


def write_geojson(points: ExportedPoints, path: Path) -> None:
    """The features of the three layers in one collection; the property ``layer`` names theirs. The
    member ``crs`` (GeoJSON 2008; RFC 7946 has only the Earth's WGS 84) holds the lunar CRS.
    MissingPackageError without shapely.
    """
    shapely = package("shapely", "gis", "a .geojson file")
    crs = _URN if points.frame.name == FRAME else points.frame.crs
    head = {
        "type": "FeatureCollection",
        "name": "lunar control points",
        "frame": f"{points.frame.name}: {points.frame.meaning}",
        "crs": {"type": "name", "properties": {"name": crs}},
    }
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(json.dumps(head)[:-1] + ', "features": [')
        between = "\n"
        for name, _, geometry, fields in layers(points, "a .geojson file"):
            rows = zip(*(plain(values, None) for values in fields.values()), strict=True)
            shapes = shapely.to_geojson(geometry)
            for shape, row in zip(shapes, rows, strict=True):
                properties = json.dumps({"layer": name} | dict(zip(fields, row, strict=True)))
                feature = f'{{"type": "Feature", "properties": {properties}, "geometry": {shape}}}'
                file.write(between + feature)
                between = ",\n"
        file.write("\n]}\n")
