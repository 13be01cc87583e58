"""Vector maps for GIS: points, footprints of the patches, and coverage cells, as GeoPackage and GeoJSON.

Longitudes are -180..180. A footprint across the antimeridian is cut there, one around a pole is
closed along the pole's edge of the map.
"""

from __future__ import annotations

import contextlib
import errno
import json
import sqlite3
import warnings
from collections.abc import Iterator
from pathlib import Path

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
Footprints = list[list[Array]]
"""Of each patch its polygons, each a closed ring (m, 2), counter-clockwise: longitudes and latitudes, degrees."""
Layer = tuple[str, str, Array | Footprints, Fields]


def layers(points: ExportedPoints) -> Iterator[Layer]:
    """Name, type of geometry, coordinates (of points (n, 2) or (n, 3)) and fields of each layer."""
    columns = points.columns()
    fields = {column.name: column.values for column in columns}
    yield "points", "Point Z", points.lonlat_height, fields
    few = {name: fields[name] for name in ("point_id", "gsd_m", "level", "usable_share", "frame")}
    yield "footprints", "MultiPolygon", _footprints(points), few
    found = cells(points)
    places = np.stack([found["longitude_deg"], found["latitude_deg"]], -1)
    status = np.array([COVERAGE_STATUS[code] for code in found["status"].tolist()], dtype=object)
    frame = np.full(len(status), points.frame.name, object)
    yield "coverage", "Point", places, {"status": status, "frame": frame}


def _footprints(points: ExportedPoints) -> Footprints:
    """Outlines of the patches through their outermost nodes."""
    side = points.catalog.patch_nodes - 1
    steps = np.unique(np.linspace(0, side, _SIDE + 1).round().astype(int))
    low, high = np.zeros(len(steps) - 1, int), np.full(len(steps) - 1, side)
    go, back = steps[:-1], steps[:0:-1]
    rows = np.concatenate([low, go, high, back])[::-1]  # counter-clockwise seen from above
    columns = np.concatenate([go, high, back, low])[::-1]
    rows, columns = (np.append(along, along[0]) for along in (rows, columns))
    found: Footprints = []
    for block, dem in points.blocks("dem"):
        lon, lat, _ = mcmf_to_lonlat(points.nodes_m(block, dem)[:, rows, columns])
        lon = wrapped_deg(lon)
        whole = [[ring] for ring in np.stack([lon, lat], -1)]
        for k in np.flatnonzero(np.ptp(lon, axis=1) > 180.0):
            whole[k] = outline(lon[k, :-1], lat[k, :-1])
        found += whole
    return found


def outline(lon_deg: Array, lat_deg: Array) -> list[Array]:
    """Polygons within longitudes -180..180 of a convex ring of places (m,) on the sphere."""
    lon = np.unwrap(np.append(lon_deg, lon_deg[0]), period=360.0)
    if abs(lon[-1] - lon[0]) > 180.0:
        return [_closed(_around_pole(lon_deg, lat_deg))]
    whole = np.stack([lon[:-1], lat_deg], -1)
    first, last = np.floor((lon.min() + 180.0) / 360.0), np.ceil((lon.max() + 180.0) / 360.0)
    parts = []
    for turn in np.arange(first, last) * 360.0:
        part = _cut(_cut(whole - [turn, 0.0], -180.0, 1.0), 180.0, -1.0)
        parts += [_closed(part)] if len(part) > 2 else []
    return parts


def _cut(ring: Array, edge: float, side: float) -> Array:
    """The part of a convex ring (m, 2) where the first coordinate is above the edge (``side`` 1) or below it (-1)."""
    kept: list[Array] = []
    for here, there in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        a, b = side * (here[0] - edge), side * (there[0] - edge)
        if a >= 0.0:
            kept.append(here)
        if a * b < 0.0:
            kept.append(np.array([edge, here[1] + (there[1] - here[1]) * a / (a - b)]))
    return np.array(kept).reshape(-1, 2)


def _closed(ring: Array) -> Array:
    """A ring (m, 2) counter-clockwise, its first place again at the end."""
    x, y = ring.T
    turned = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) < 0.0
    ring = ring[::-1] if turned else ring
    return np.concatenate([ring, ring[:1]])


def _around_pole(lon_deg: Array, lat_deg: Array) -> Array:
    """A ring around a pole, from one edge of the map to the other and along the pole."""
    order = np.argsort(wrapped_deg(lon_deg))
    lon, lat = wrapped_deg(lon_deg)[order], lat_deg[order]
    edge = np.interp(180.0, [lon[-1], lon[0] + 360.0], [lat[-1], lat[0]])
    pole = 90.0 if lat.mean() > 0.0 else -90.0
    ends = [(180.0, edge), (180.0, pole), (-180.0, pole), (-180.0, edge)]
    return np.concatenate([np.stack([lon, lat], -1), ends])


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
        for name, kind, places, fields in layers(points):
            first = name == "points"
            if isinstance(places, list):
                rings = [ring for one in places for ring in one]
                of_ring = np.repeat(np.arange(len(rings)), list(map(len, rings)))
                parts = shapely.linearrings(np.concatenate(rings), indices=of_ring)
                of_patch = np.repeat(np.arange(len(places)), list(map(len, places)))
                geometry = shapely.multipolygons(shapely.polygons(parts), indices=of_patch)
            else:
                geometry = shapely.points(places)
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
        for file in files:
            _name_authority(file)

    try:
        with warnings.catch_warnings(action="ignore"):  # GDAL's, of what `write_checked` finds
            write_checked(write, path)
    finally:
        pyogrio.set_gdal_config_options(before)


def _name_authority(package: Path) -> None:
    """Name the authority of the lunar CRS in its definition as PROJ and QGIS look it up: GDAL cuts ``IAU_2015`` in WKT 1 to
    ``IAU``, of which they know no code. OSError if it cannot be written.
    """
    try:
        with contextlib.closing(sqlite3.connect(package)) as tables:
            tables.execute("PRAGMA synchronous = OFF")
            tables.execute("PRAGMA journal_mode = MEMORY")
            tables.execute(
                "UPDATE gpkg_spatial_ref_sys SET definition = replace(definition, ?, ?)",
                ('AUTHORITY["IAU",', 'AUTHORITY["IAU_2015",'),
            )
            tables.commit()
    except sqlite3.Error as error:
        raise OSError(errno.EIO, str(error)) from error


def write_geojson(points: ExportedPoints, path: Path) -> None:
    """The features of the three layers in one collection; the property ``layer`` names theirs. The
    member ``crs`` (GeoJSON 2008; RFC 7946 has only the Earth's WGS 84) holds the lunar CRS.
    """
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
        for name, kind, places, fields in layers(points):
            rows = zip(*(plain(values, None) for values in fields.values()), strict=True)
            for place, row in zip(places, rows, strict=True):
                shape = (
                    [[ring.tolist()] for ring in place]
                    if isinstance(place, list)
                    else place.tolist()
                )
                feature = {
                    "type": "Feature",
                    "properties": {"layer": name} | dict(zip(fields, row, strict=True)),
                    "geometry": {"type": kind.partition(" ")[0], "coordinates": shape},
                }
                file.write(between + json.dumps(feature))
                between = ",\n"
        file.write("\n]}\n")
