"""What a label says of its pixels beyond what is needed to read them: extremes, sums, sizes, bounds.

Nothing here is believed when a file is opened; ``integrity`` holds it against the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

from . import pvl
from .pvl import Pvl


@dataclass(frozen=True)
class Claims:
    """None where the label is silent. ``minimum`` and ``maximum`` are as the label writes them: samples or
    heights; degrees for the bounds.
    """

    minimum: float | None = None
    maximum: float | None = None
    md5: str | None = None
    checksum: int | None = None  # PDS3: the unsigned 32-bit sum of all values of the image
    file_bytes: int | None = None  # of the file that holds the image
    record_bytes: int | None = None
    north_deg: float | None = None
    south_deg: float | None = None
    west_deg: float | None = None
    east_deg: float | None = None

    @classmethod
    def from_pvl(
        cls, root: Pvl, file: Pvl, image: Pvl, compressed: Pvl | None, map_: Pvl
    ) -> Claims:
        """Of a PDS3 label: its statements, and the tables of the file, the image, the compressed file and the map."""
        tables = [image, file, root] if compressed is None else [compressed, root]
        records = None if compressed is not None else _first([file, root], "FILE_RECORDS")
        record_bytes = None if compressed is not None else _first([file, root], "RECORD_BYTES")
        md5 = next(
            (t["MD5_CHECKSUM"] for t in tables if isinstance(t.get("MD5_CHECKSUM"), str)), None
        )
        checksum = None if compressed is not None else _first([image], "CHECKSUM")
        return cls(
            minimum=_first([image], "MINIMUM", "DERIVED_MINIMUM"),
            maximum=_first([image], "MAXIMUM", "DERIVED_MAXIMUM"),
            md5=None if md5 is None else md5.lower(),
            checksum=None if checksum is None else int(checksum),
            file_bytes=None
            if records is None or record_bytes is None
            else int(records * record_bytes),
            record_bytes=None if record_bytes is None else int(record_bytes),
            north_deg=pvl.number(map_, "MAXIMUM_LATITUDE"),
            south_deg=pvl.number(map_, "MINIMUM_LATITUDE"),
            west_deg=pvl.number(map_, "WESTERNMOST_LONGITUDE"),
            east_deg=pvl.number(map_, "EASTERNMOST_LONGITUDE"),
        )


def _first(tables: list[Pvl], *keys: str) -> float | None:
    found = (pvl.number(table, key) for table in tables for key in keys)
    return next((value for value in found if value is not None), None)
