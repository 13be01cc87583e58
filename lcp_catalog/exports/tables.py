"""Tables of the points: CSV (RFC 4180) and Parquet."""

from __future__ import annotations

import csv
from pathlib import Path

from .packages import package
from .points import Column, ExportedPoints, plain


def write_csv(points: ExportedPoints, path: Path) -> None:
    """One row per point. The name of a column ends with its unit; ``frame`` is a column."""
    write_columns(points.columns(), path)


def write_columns(columns: list[Column], path: Path) -> None:
    """Columns as CSV; numbers with all their digits, missing ones as empty cells."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\r\n")
        writer.writerow([column.name for column in columns])
        writer.writerows(zip(*(plain(column.values, "") for column in columns), strict=True))


def write_parquet(points: ExportedPoints, path: Path) -> None:
    """One row per point. Units and meanings are metadata of the columns, the frame one of the file.
    MissingPackageError without pyarrow.
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
    about = {"frame": points.frame.name, "frame_meaning": points.frame.meaning}
    schema = arrow.schema(fields, metadata=about | {"body": "MOON"})
    parquet.write_table(arrow.Table.from_arrays(arrays, schema=schema), path)
