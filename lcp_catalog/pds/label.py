"""The label of a lunar DEM product: its statements about the pixels and the map, in one form for
PDS3 and PDS4.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..constants import MOON_RADIUS_M
from ..errors import LabelError
from ..file_kinds import may_wait

_LARGEST_FILE = 1e15


def beginning(path: Path, size: int) -> bytes:
    """The first bytes of a file. LabelError for a pipe, which would wait for its writer, and for a device."""
    if may_wait(path):
        raise LabelError(f"{path}: is a pipe or a device; only plain files are read")
    with path.open("rb") as file:
        return file.read(size)


@dataclass(frozen=True)
class DeclaredStatistics:
    """Statements of a label that are not needed to read the pixels; None where the label has none.
    `dem.file_check` compares them with the pixels.

    ``minimum`` and ``maximum`` are samples or heights, as the label states them; bounds are in
    degrees.
    """

    minimum: float | None = None
    maximum: float | None = None
    md5: str | None = None
    checksum: int | None = None  # PDS3: the unsigned 32-bit sum of all values of the image
    file_bytes: int | None = None  # of the file that holds the image
    north_deg: float | None = None
    south_deg: float | None = None
    east_deg: float | None = None


@dataclass(frozen=True)
class Label:
    """Statements of a label, in metres and degrees, checked.

    ``height_m = sample * height_scale_m``: a label's OFFSET is the radius of the sphere and no term
    of height. The centre of pixel (row, column), counted from 0, is at ``x = (column -
    sample_offset) * pixel_m``, ``y = (line_offset - row) * pixel_m`` of a map with its origin at
    the centre longitude and the equator (cylindrical) or at the pole.
    """

    path: Path
    product_id: str
    projection: str  # "equirectangular" | "polar-stereographic"
    center_lon_deg: float
    center_lat_deg: float  # standard parallel of the cylinder, or +-90
    pixel_m: float
    line_offset: float
    sample_offset: float
    lines: int
    line_samples: int
    height_scale_m: float
    missing: tuple[float, ...]
    sample_dtype: str | None  # None: stated by the compressed file itself
    image_name: str
    image_offset_bytes: int
    compressed: bool
    declared: DeclaredStatistics = field(default_factory=DeclaredStatistics)

    @property
    def image_bytes(self) -> int:
        """Least size of an uncompressed image file."""
        size = int((self.sample_dtype or "i2")[-1])
        return self.image_offset_bytes + self.lines * self.line_samples * size


def file_bytes(number: float, key: str) -> int:
    """A number of bytes that a label states; LabelError for one that no file has."""
    if not 0.0 <= number < _LARGEST_FILE:
        raise LabelError(f"{key} is {number:g} bytes")
    return int(number)


def refuse_foreign(radius_m: float | None, key: str) -> None:
    """LabelError for a radius that is not that of the sphere of heights."""
    if radius_m is not None and abs(radius_m - MOON_RADIUS_M) > 0.5:
        raise LabelError(
            f"{key} is {radius_m:.10g} m; heights must refer to the sphere of {MOON_RADIUS_M:.0f} m"
        )
