"""Small image files by the specifications of their formats: ISIS cubes, PDS3 images, GeoTIFFs, PNGs;
a camera for them, and the images that they open as.
"""

from __future__ import annotations

import struct
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import Affine

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.errors import ImageError
from lcp_catalog.geometry.frames import enu_rotation, lonlat_to_mcmf
from lcp_catalog.images.image import Image
from lcp_catalog.images.image_file import ImageOptions, open_image
from lcp_catalog.light.sun_choice import SunChoice

MOON = (
    'GEOGCS["m",DATUM["d",SPHEROID["s",1737400,0]],PRIMEM["p",0],UNIT["degree",0.0174532925199433]]'
)
SUN_M = 1.5e11
SHAPE = (40, 60)
HOLE = np.s_[10:20, 30:50]
NOON = SunChoice(subsolar_deg=(0.0, 0.0))
MAP = {"crs": MOON, "transform": Affine(0.1, 0, 10, 0, -0.1, 5)}

ISIS_TYPES = {
    "uint8": "UnsignedByte",
    "int16": "SignedWord",
    "uint16": "UnsignedWord",
    "float32": "Real",
}


def camera_over(
    shape: tuple[int, int], lon_deg: float = 20.0, lat_deg: float = -10.0, sun: bool = True
) -> Camera:
    """Looking straight down from 100 km, rows to the south; its Sun 30 deg from overhead."""
    up = enu_rotation(lon_deg, lat_deg)
    rows, cols = shape
    sun_up = enu_rotation(lon_deg + 30.0, lat_deg)[2]
    return Camera(
        position_mcmf_m=lonlat_to_mcmf(lon_deg, lat_deg, 100e3),
        rotation_mcmf_to_camera=np.array([up[0], -up[1], -up[2]]),
        focal_length_px=1000.0,
        principal_point_px=((cols - 1) / 2, (rows - 1) / 2),
        image_size_px=(cols, rows),
        sun_position_mcmf_m=SUN_M * sun_up if sun else None,
    )


def write_image(
    path: Path,
    bands: Sequence[np.ndarray] | np.ndarray,
    driver: str = "GTiff",
    crs: str | None = None,
    transform: Affine | None = None,
    kinds: Sequence[ColorInterp] | None = None,
    mask: np.ndarray | None = None,
    tags: Mapping[str, str] | None = None,
    **profile: object,
) -> Path:
    """A GeoTIFF or PNG of bands (n, rows, cols) or of one band (rows, cols)."""
    planes = np.asarray(bands)
    planes = planes[None] if planes.ndim == 2 else planes
    count, rows, cols = planes.shape
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            path, "w", driver=driver, width=cols, height=rows, count=count, dtype=planes.dtype.name,
            crs=crs, transform=transform, **profile,
        ) as file:  # fmt: skip
            file.write(planes)
            if kinds is not None:
                file.colorinterp = tuple(kinds)
            if mask is not None:
                file.write_mask(mask)
            file.update_tags(**(tags or {}))
    return path


@dataclass(frozen=True, eq=False)
class Table:
    """A binary table of an ISIS cube: columns of doubles by name."""

    name: str
    columns: Mapping[str, Sequence[float]]
    extra: str = ""

    @property
    def data(self) -> bytes:
        rows = zip(*self.columns.values(), strict=True)
        return b"".join(struct.pack(f"<{len(self.columns)}d", *row) for row in rows)

    def label(self, start_byte: int) -> str:
        records = len(next(iter(self.columns.values())))
        fields = "".join(
            f"  Group = Field\n    Name = {name}\n    Type = Double\n    Size = 1\n  End_Group\n"
            for name in self.columns
        )
        return (
            f"Object = Table\n  Name = {self.name}\n  StartByte = {start_byte}\n"
            f"  Bytes = {len(self.data)}\n  Records = {records}\n  ByteOrder = Lsb\n{self.extra}{fields}End_Object\n"
        )


def write_cube(
    path: Path,
    samples: np.ndarray,
    base: float = 0.0,
    multiplier: float = 1.0,
    groups: str = "",
    tables: Sequence[Table] = (),
) -> Path:
    """An ISIS cube, band sequential: a label of 16 KiB, the samples, the tables."""
    label_bytes = 16384
    bands, rows, cols = samples.shape if samples.ndim == 3 else (1, *samples.shape)
    kind = ISIS_TYPES[samples.dtype.name]
    text = f"""Object = IsisCube
  Object = Core
    StartByte = {label_bytes + 1}
    Format = BandSequential
    Group = Dimensions
      Samples = {cols}
      Lines = {rows}
      Bands = {bands}
    End_Group
    Group = Pixels
      Type = {kind}
      ByteOrder = Lsb
      Base = {base}
      Multiplier = {multiplier}
    End_Group
  End_Object
{groups}
End_Object
Object = Label
  Bytes = {label_bytes}
End_Object
"""
    core = np.ascontiguousarray(samples).tobytes()
    at = label_bytes + len(core) + 1
    for table in tables:
        text += table.label(at)
        at += len(table.data)
    text += "End\n"
    head = text.encode("ascii").ljust(label_bytes, b"\0")
    assert len(head) == label_bytes
    path.write_bytes(head + core + b"".join(table.data for table in tables))
    return path


def write_pds3(path: Path, samples: np.ndarray, statements: str = "", image: str = "") -> Path:
    """A PDS3 image with an attached label, records of one line each."""
    rows, cols = samples.shape
    record = 4096
    bits = 8 * samples.dtype.itemsize
    kind = {"u": "LSB_UNSIGNED_INTEGER", "i": "LSB_INTEGER", "f": "PC_REAL"}[samples.dtype.kind]
    text = f"""PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = {record}
FILE_RECORDS = {1 + -(-samples.nbytes // record)}
LABEL_RECORDS = 1
^IMAGE = 2
{statements}
OBJECT = IMAGE
  LINES = {rows}
  LINE_SAMPLES = {cols}
  SAMPLE_TYPE = {kind}
  SAMPLE_BITS = {bits}
{image}
END_OBJECT = IMAGE
END
""".replace("\n", "\r\n")
    head = text.encode("ascii").ljust(record, b" ")
    assert len(head) == record
    path.write_bytes(head + samples.tobytes())
    return path


def write_pds4(path: Path, samples: np.ndarray, start: str, stop: str, target: str) -> Path:
    """A PDS4 product, label (.xml) and samples (.img): GDAL's label with times and target filled
    in.
    """
    write_image(path.with_suffix(".xml"), samples, driver="PDS4")
    text = path.with_suffix(".xml").read_text()
    for key, value in (("start_date_time", start), ("stop_date_time", stop)):
        open_ = f'<{key} xsi:nil="true" nilReason="inapplicable" />'
        assert open_ in text
        text = text.replace(open_, f"<{key}>{value}</{key}>")
    assert "${TARGET}" in text
    path.with_suffix(".xml").write_text(text.replace("${TARGET}", target))
    return path


def scene(dtype: str = "uint8", low: float = 20.0, high: float = 220.0) -> np.ndarray:
    """A bell-shaped brightness well within its scale, (rows, cols)."""
    rng = np.random.default_rng(3)
    bell = np.clip(rng.normal(0.5, 0.12, SHAPE), 0.0, 1.0)
    values = low + (high - low) * bell
    return np.round(values).astype(dtype) if np.dtype(dtype).kind in "ui" else values.astype(dtype)


def opened(path: Path, options: ImageOptions | None = None, **change: object) -> Image:
    return open_image(path, camera_over(SHAPE), None, options, **change)


def refused(why: str, path: Path, *arguments: object) -> None:
    with pytest.raises(ImageError, match=why) as caught:
        open_image(path, *arguments)  # type: ignore[arg-type]  # wrong types on purpose
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
