"""Tables of the points: CSV (RFC 4180), GeoParquet, and ground control points of the Ames Stereo Pipeline (``.gcp``)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyproj

from ..arrays import Array
from ..atomic_files import csv_cell, csv_lines, csv_rows
from ..constants import MOON_RADIUS_M
from ..errors import package
from .points import Column, ExportedPoints, plain


def write_csv(points: ExportedPoints, path: Path) -> None:
    """One row per point. The name of a column ends with its unit; ``frame`` is a column."""
    write_columns(points.columns(), path)


def write_columns(columns: list[Column], path: Path) -> None:
    """Columns as CSV; numbers with all their digits, missing ones as empty cells."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(csv_lines([[column.name for column in columns]]))
        file.writelines(csv_rows(zip(*map(_csv_cells, columns), strict=True)))


def _csv_cells(column: Column) -> list[Any]:
    cells = plain(column.values, "")
    return cells if column.values.dtype.kind in "fiub" else list(map(csv_cell, cells))


def write_parquet(points: ExportedPoints, path: Path) -> None:
    """GeoParquet 1.1: one row per point, its place in ``geometry``, the other columns as in CSV.
    Units and meanings are metadata of the columns, the frame one of the file. MissingPackageError
    without pyarrow.
    """
    arrow = package("pyarrow", "gis", "a .parquet file")
    parquet = package("pyarrow.parquet", "gis", "a .parquet file")
    columns = points.columns()
    arrays = [arrow.array(column.values, from_pandas=True) for column in columns]
    fields = [
        arrow.field(
            column.name,
            array.type,
            metadata={"units": column.unit, "long_name": column.meaning},
        )
        for column, array in zip(columns, arrays, strict=True)
    ]
    xyz = points.lonlat_height
    arrays.append(arrow.array(_well_known_binary(xyz), arrow.binary()))
    fields.append(arrow.field("geometry", arrow.binary()))
    geometry: dict[str, Any] = {
        "encoding": "WKB",
        "geometry_types": ["Point Z"],
        "crs": pyproj.CRS.from_user_input(points.frame.crs).to_json_dict(),
    }
    if len(xyz):
        geometry["bbox"] = [*xyz.min(axis=0).tolist(), *xyz.max(axis=0).tolist()]
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": geometry}}
    about = {"frame": points.frame.name, "frame_meaning": points.frame.meaning, "body": "MOON"}
    schema = arrow.schema(fields, metadata=about | {"geo": json.dumps(geo)})
    parquet.write_table(arrow.Table.from_arrays(arrays, schema=schema), path)


def _well_known_binary(xyz: Array) -> list[bytes]:
    """Points (n, 3) as ISO WKB: byte order, type 1001 (Point Z), three numbers."""
    record = np.dtype([("order", "u1"), ("kind", "<u4"), ("xyz", "<f8", 3)])
    records = np.empty(len(xyz), record)
    records["order"], records["kind"], records["xyz"] = 1, 1001, xyz
    return [one.tobytes() for one in records]


_WKT = (
    'GEOGCS["{name}",DATUM["{name}",SPHEROID["Moon (2015) - Sphere",{radius:.0f},0]],'
    'PRIMEM["Reference_Meridian",0],UNIT["degree",0.0174532925199433]]'
)


def write_gcp(points: ExportedPoints, path: Path) -> None:
    """One line per point: number, latitude and longitude (degrees), height above the sphere (m), and
    1 sigma along latitude, longitude and height (m), as ASP reads it if errors of ground control are
    to be in longitude, latitude and height. Measures in images are left to the user.

    The first line is the datum. Numbers count from 1, since ASP reads 32 bits; a comment gives the
    ``point_id`` of each. A sigma that is unknown is the cell size: ASP demands a positive one.
    """
    across_m, along_m = (np.where(one > 0.0, one, points.gsd_m) for one in points.sigma_m)
    lon, lat = points.lonlat_deg
    height_m = np.linalg.norm(points.position_m, axis=1) - MOON_RADIUS_M
    wkt = _WKT.format(name=points.frame.name, radius=MOON_RADIUS_M)
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"# WKT: {wkt}\n")
        file.write(f"# frame {points.frame.name}: {points.frame.meaning}\n")
        file.write(
            "# number latitude longitude height sigma_latitude sigma_longitude sigma_height\n"
        )
        for k, point_id in enumerate(points.point_id):
            file.write(f"# number {k + 1}: point_id {point_id}\n")
            place = f"{lat[k]:.9f} {lon[k]:.9f} {height_m[k]:.4f}"
            file.write(f"{k + 1} {place} {across_m[k]:.3f} {across_m[k]:.3f} {along_m[k]:.3f}\n")
