"""PDS3 labels of lunar DEM products.

Scale, offset and missing values come from the label and not from GDAL: GDAL 3.10 to 3.12 gives
scale 1 for LOLA's JP2 products (0.5 m counts), the radius of the sphere as an offset of height, and
a nodata value that no label states.

PVL, the language of PDS3 labels: statements, and their numbers, texts and lengths.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..constants import MOON_RADIUS_M
from ..errors import LabelError
from ..geometry.bounds import wrapped_deg
from .label import DeclaredStatistics, Label, beginning, file_bytes, refuse_foreign

Pvl = dict[str, Any]
"""Statements of a label; an OBJECT or GROUP is a nested dictionary, a number with a unit a
``Quantity``.
"""

_METRES = {"M": 1.0, "METER": 1.0, "METERS": 1.0, "METRE": 1.0, "METRES": 1.0}
_METRES |= {
    "KM": 1000.0,
    "KILOMETER": 1000.0,
    "KILOMETERS": 1000.0,
    "KILOMETRE": 1000.0,
    "KILOMETRES": 1000.0,
}


@dataclass(frozen=True)
class Quantity:
    """A number with the unit given after it in angle brackets, upper case."""

    value: float
    unit: str


_DEPTH = 40
"""Most nested objects; labels have three or four."""

_TOKEN = re.compile(
    r"""/\*.*?\*/ | (?P<string>"[^"]*"|'[^']*') | (?P<unit><[^>]*>) | (?P<mark>[={}(),])
    | (?P<word>[^\s={}(),<>"']+)""",
    re.S | re.X,
)


def parse_pvl(text: str) -> Pvl:
    """Statements of an ODL/PVL text, up to END; of a repeated key the first value is kept. LabelError
    for objects that are nested too deeply.
    """
    tokens = [m for m in _TOKEN.finditer(text) if m.lastgroup is not None]
    stack: list[Pvl] = [{}]
    at = 0
    while at < len(tokens):
        key = tokens[at].group().upper()
        at += 1
        if key == "END":
            break
        if at < len(tokens) and tokens[at].group() == "=":
            value, at = _pvl_value(tokens, at + 1)
        else:
            value = None
        if key in ("OBJECT", "GROUP", "BEGIN_OBJECT", "BEGIN_GROUP"):
            found = stack[-1].setdefault(str(value).upper(), {})
            stack.append(found if isinstance(found, dict) else {})  # the first value is kept
            if len(stack) > _DEPTH:
                raise LabelError(f"the label has more than {_DEPTH} nested objects")
        elif key in ("END_OBJECT", "END_GROUP"):
            if len(stack) > 1:
                stack.pop()
        elif value is not None:
            stack[-1].setdefault(key, value)
    return stack[0]


def _pvl_value(tokens: list[re.Match[str]], at: int) -> tuple[Any, int]:
    """The value that begins at token ``at``, and the index of the token after it."""
    if at >= len(tokens):
        return None, at
    if tokens[at].group() in "({":
        items: list[Any] = []
        at += 1
        while at < len(tokens) and tokens[at].group() not in ")}":
            if tokens[at].group() in ",({":
                at += 1
                continue
            item, at = _pvl_value(tokens, at)
            items.append(item)
        return items, at + 1
    token = tokens[at]
    value: Any = token.group()
    value = " ".join(value[1:-1].split()) if token.lastgroup == "string" else _literal(value)
    if at + 1 < len(tokens) and tokens[at + 1].lastgroup == "unit":
        unit = " ".join(tokens[at + 1].group()[1:-1].split()).upper()
        return (Quantity(value, unit) if isinstance(value, float) else value), at + 2
    return value, at + 1


def _literal(word: str) -> float | str:
    try:
        return float(word) if word[:1] in "+-.0123456789" else word
    except ValueError:
        return word


def table(pvl: Pvl, key: str) -> Pvl | None:
    """The OBJECT or GROUP of a name; None for anything else."""
    value = pvl.get(key)
    return value if isinstance(value, dict) else None


def number(pvl: Pvl, key: str) -> float | None:
    """The finite number of a key, without its unit; None for anything else."""
    value = pvl.get(key)
    value = value.value if isinstance(value, Quantity) else value
    return float(value) if isinstance(value, float | int) and math.isfinite(value) else None


def wanted(pvl: Pvl, key: str) -> float:
    """The finite number of a key. LabelError if there is none."""
    value = number(pvl, key)
    if value is None:
        raise LabelError(f"the label does not give {key} as a number (it says {pvl.get(key)!r})")
    return value


def text(pvl: Pvl, key: str) -> str:
    """The upper-case text of a key, of a list its first item; empty if it is missing."""
    value = pvl.get(key, "")
    value = value[0] if isinstance(value, list) and value else value
    return str(value.value if isinstance(value, Quantity) else value).upper()


def metres(unit: str, key: str) -> float:
    """Metres in a unit of length. LabelError with the key if the unit is unknown."""
    factor = _METRES.get(unit.upper().strip())
    if factor is None:
        raise LabelError(f"the unit <{unit}> of {key} is not a known unit of length")
    return factor


log = logging.getLogger(__name__)
_MAX_LABEL_BYTES = 262_144
_CYLINDRICAL = {"SIMPLE CYLINDRICAL", "EQUIRECTANGULAR", "EQUIDISTANT CYLINDRICAL"}
_SAMPLES = {
    ("LSB_INTEGER", 16): "<i2",
    ("PC_INTEGER", 16): "<i2",
    ("MSB_INTEGER", 16): ">i2",
    ("INTEGER", 16): ">i2",
    ("SUN_INTEGER", 16): ">i2",
    ("LSB_INTEGER", 32): "<i4",
    ("MSB_INTEGER", 32): ">i4",
    ("PC_REAL", 32): "<f4",
    ("IEEE_REAL", 32): ">f4",
    ("REAL", 32): ">f4",
    ("SUN_REAL", 32): ">f4",
    ("PC_REAL", 64): "<f8",
    ("IEEE_REAL", 64): ">f8",
}
_MATERIAL_SHIFT_PX = 0.1
"""A rounded MAP_SCALE is reported if it moves the far edge by more than this share of a pixel."""


def read_pds3(path: Path) -> Label:
    """The label in ``path``, detached or attached in front of an image. LabelError states what is
    wrong with it.
    """
    text = read_label_text(path)
    if text is None:
        raise LabelError(f"{path}: not a PDS3 label (it does not begin with PDS_VERSION_ID)")
    return parse_pds3(text, path)


def parse_pds3(text: str, path: Path) -> Label:
    """The label with that text; ``path`` is the file that holds it."""
    try:
        return _Interpreter(parse_pvl(text), path).label()
    except LabelError as error:
        raise LabelError(f"{path}: {error}") from None


def read_label_text(path: Path) -> str | None:
    """Text of the PDS3 label that ``path`` is or begins with; None for other files."""
    head = beginning(path, _MAX_LABEL_BYTES)
    if not head.lstrip(b"\xef\xbb\xbf \r\n\t").upper().startswith(b"PDS_VERSION_ID"):
        return None
    return head.decode("latin-1")


class _Interpreter:
    """Converts the statements of a label to a ``Label``; raises LabelError without the path."""

    def __init__(self, statements: Pvl, path: Path) -> None:
        self.root, self.path = statements, path
        compressed = statements.get("COMPRESSED_FILE")
        plain = statements.get("UNCOMPRESSED_FILE", statements)
        self.compressed: Pvl | None = compressed if isinstance(compressed, dict) else None
        self.file: Pvl = plain if isinstance(plain, dict) else statements
        self.image: Pvl = table(self.file, "IMAGE") or table(statements, "IMAGE") or {}
        self.map: Pvl = table(statements, "IMAGE_MAP_PROJECTION") or {}
        self.samples = _Samples(self.image, self.compressed)

    def label(self) -> Label:
        if not self.map:
            raise LabelError(
                "the label has no IMAGE_MAP_PROJECTION; a map-projected DEM is required"
            )
        self._refuse_foreign_maps()
        projection = self._projection()
        lines, samples = self._size()
        name, offset = self._image_file()
        line_offset = wanted(self.map, "LINE_PROJECTION_OFFSET")
        sample_offset = wanted(self.map, "SAMPLE_PROJECTION_OFFSET")
        far = max(
            abs(x)
            for x in (line_offset, line_offset - lines, sample_offset, sample_offset - samples)
        )
        label = Label(
            path=self.path,
            product_id=self._product_id(name),
            projection=projection,
            center_lon_deg=wanted(self.map, "CENTER_LONGITUDE"),
            center_lat_deg=wanted(self.map, "CENTER_LATITUDE"),
            pixel_m=self._pixel_m(projection, far),
            line_offset=line_offset,
            sample_offset=sample_offset,
            lines=lines,
            line_samples=samples,
            height_scale_m=self._height_scale_m(),
            missing=tuple(self.samples.missing()),
            sample_dtype=None if self.compressed else self.samples.dtype(),
            image_name=name,
            image_offset_bytes=offset,
            compressed=self.compressed is not None,
            declared=self._declared(),
        )
        self._compare_with_bounds(label)
        return label

    def _declared(self) -> DeclaredStatistics:
        """Statements about the compressed file if there is one, else about the image and its file."""
        compressed, image, map_ = self.compressed, self.image, self.map
        tables = [image, self.file, self.root] if compressed is None else [compressed, self.root]
        md5 = next(
            (t["MD5_CHECKSUM"] for t in tables if isinstance(t.get("MD5_CHECKSUM"), str)), None
        )
        size = checksum = None
        if compressed is None:
            records = _first([self.file, self.root], "FILE_RECORDS")
            record_bytes = _first([self.file, self.root], "RECORD_BYTES")
            if records is not None and record_bytes is not None:
                size = file_bytes(records * record_bytes, "FILE_RECORDS times RECORD_BYTES")
            checksum = _first([image], "CHECKSUM")
        return DeclaredStatistics(
            minimum=_first([image], "MINIMUM", "DERIVED_MINIMUM"),
            maximum=_first([image], "MAXIMUM", "DERIVED_MAXIMUM"),
            md5=None if md5 is None else md5.lower(),
            checksum=None if checksum is None else int(checksum),
            file_bytes=size,
            north_deg=number(map_, "MAXIMUM_LATITUDE"),
            south_deg=number(map_, "MINIMUM_LATITUDE"),
            east_deg=number(map_, "EASTERNMOST_LONGITUDE"),
        )

    def _refuse_foreign_maps(self) -> None:
        target = text(self.root, "TARGET_NAME")
        if target not in ("", "MOON"):
            raise LabelError(f"the label's target is {target}; only the Moon is supported")
        if not target and number(self.map, "A_AXIS_RADIUS") is None:
            raise LabelError(
                "the label has neither TARGET_NAME nor A_AXIS_RADIUS, so the body is unknown"
            )
        for key in ("A_AXIS_RADIUS", "B_AXIS_RADIUS", "C_AXIS_RADIUS"):
            refuse_foreign(self._radius_m(key), key)
        if text(self.map, "POSITIVE_LONGITUDE_DIRECTION") not in ("", "EAST"):
            raise LabelError("west-positive longitudes are not supported")
        if (number(self.map, "MAP_PROJECTION_ROTATION") or 0.0) != 0.0:
            raise LabelError(
                f"a map rotated by {number(self.map, 'MAP_PROJECTION_ROTATION'):g} deg "
                "is not supported"
            )
        if any(key.startswith("OBLIQUE_PROJ") for key in self.map):
            raise LabelError("an oblique map projection is not supported")

    def _radius_m(self, key: str) -> float | None:
        value = self.map.get(key)
        radius = number(self.map, key)
        if radius is None:
            return None
        unit = value.unit if isinstance(value, Quantity) else ("KM" if radius < 10_000.0 else "M")
        return radius * metres(unit, key)

    def _projection(self) -> str:
        name = text(self.map, "MAP_PROJECTION_TYPE").replace("_", " ")
        latitude = wanted(self.map, "CENTER_LATITUDE")
        if name in _CYLINDRICAL:
            return "equirectangular"
        if name in ("POLAR STEREOGRAPHIC", "STEREOGRAPHIC") and abs(latitude) == 90.0:
            return "polar-stereographic"
        if name in ("POLAR STEREOGRAPHIC", "STEREOGRAPHIC"):
            raise LabelError(
                f"an oblique stereographic map (centre latitude {latitude:g}) is not supported"
            )
        raise LabelError(
            f"map projection {name or '(none)'} is not supported; cylindrical and polar "
            "stereographic are"
        )

    def _size(self) -> tuple[int, int]:
        lines, samples = number(self.image, "LINES"), number(self.image, "LINE_SAMPLES")
        lines = wanted(self.map, "LINE_LAST_PIXEL") if lines is None else lines
        samples = wanted(self.map, "SAMPLE_LAST_PIXEL") if samples is None else samples
        if lines < 1 or samples < 1 or (number(self.image, "BANDS") or 1.0) != 1.0:
            raise LabelError(
                f"an image of {lines:g} x {samples:g} pixels is not supported; at least one pixel and exactly one band are required"
            )
        return int(lines), int(samples)

    def _image_file(self) -> tuple[str, int]:
        """Name of the image's file ("" if the label is attached to it) and the offset of its
        pixels, bytes.
        """
        if self.compressed is not None:
            return str(self.compressed.get("FILE_NAME", "")), 0
        pointer = self.file.get("^IMAGE", self.root.get("^IMAGE"))
        parts = pointer if isinstance(pointer, list) else [pointer]
        name = next((p for p in parts if isinstance(p, str)), "")
        place = next((p for p in parts if isinstance(p, float | Quantity)), 1.0)
        if pointer is None:
            raise LabelError("the label does not name its image (^IMAGE)")
        if isinstance(place, Quantity):
            return name, file_bytes(place.value - (1 if place.value > 0 else 0), "^IMAGE")
        record = number(self.file, "RECORD_BYTES") or number(self.root, "RECORD_BYTES") or 0.0
        return name, file_bytes((place - 1.0) * record, "^IMAGE")

    def _product_id(self, image_name: str) -> str:
        stem = Path(image_name).stem or self.path.stem
        return str(self.root.get("PRODUCT_ID") or stem)

    def _height_scale_m(self) -> float:
        for table in self.samples.tables():
            factor, radius = number(table, "SCALING_FACTOR"), number(table, "OFFSET")
            unit = text(table, "UNIT")
            if (factor is None and not unit and not radius) or self._is_of_other_samples(table):
                continue
            if factor is not None and factor <= 0.0:
                raise LabelError(f"SCALING_FACTOR is {factor:g}")
            unit_m = metres(unit, "UNIT") if unit else self._unstated_unit_m(factor, radius)
            if radius:
                refuse_foreign(radius * unit_m, "OFFSET")
            return unit_m if factor is None else factor * unit_m
        if self.compressed is not None:
            # SLDEM2015's JP2 labels state no scale; all JP2 files of the archive are int16 counts
            # of half a metre
            log.warning(
                "%s: the label gives no SCALING_FACTOR; LOLA's JP2 counts of 0.5 m are assumed",
                self.path,
            )
            return 0.5
        return 1.0  # WAC GLD100 and NAC DTM labels give neither unit nor scale: metres

    def _is_of_other_samples(self, table: Pvl) -> bool:
        """True for the scale of an uncompressed image of real numbers, which is not that of the
        JP2's integers.
        """
        return (
            self.compressed is not None
            and table is self.image
            and "REAL" in text(table, "SAMPLE_TYPE")
        )

    def _unstated_unit_m(self, factor: float | None, radius: float | None) -> float:
        """Metres in the unit of a scale without UNIT: by the radius of the sphere, if it is given;
        integers that are not scaled are metres (ISIS writes SCALING_FACTOR = 1, OFFSET = 0).
        LabelError otherwise.
        """
        if radius:
            return 1000.0 if radius < 10_000.0 else 1.0
        if factor == 1.0 and "REAL" not in text(self.image, "SAMPLE_TYPE"):
            return 1.0
        raise LabelError(
            "SCALING_FACTOR has no UNIT, and no OFFSET shows it: metres or kilometres? Add UNIT to the label"
        )

    def _pixel_m(self, projection: str, far_px: float) -> float:
        """Pixel size on the map, metres; ``far_px``: distance of the far edge from the origin of
        the map.

        A cylinder's MAP_SCALE is often rounded (0.059225 km at 512 pix/deg): it is computed from
        MAP_RESOLUTION and the radius instead. Of a polar map MAP_RESOLUTION is the rounded one
        (1516.17 pix/deg at 20 m).
        """
        scale = self._map_scale_m()
        resolution = number(self.map, "MAP_RESOLUTION")
        if resolution is not None and resolution <= 0.0:
            raise LabelError(f"MAP_RESOLUTION is {resolution:g}")
        rebuilt = None if resolution is None else math.radians(1.0) * MOON_RADIUS_M / resolution
        if rebuilt is None:
            if scale is None:
                raise LabelError("the label gives neither MAP_RESOLUTION nor MAP_SCALE")
            return scale
        if scale is None:
            return rebuilt
        if abs(scale / rebuilt - 1.0) > 1e-3:
            raise LabelError(
                f"MAP_SCALE says {scale:.8g} m a pixel, MAP_RESOLUTION {rebuilt:.8g} m: "
                "one of them is wrong"
            )
        if projection == "polar-stereographic":
            return scale
        shift = abs(scale / rebuilt - 1.0) * far_px
        if shift > _MATERIAL_SHIFT_PX:
            log.warning(
                "%s: MAP_SCALE %.9g m is rounded (%.2f pixel at the far edge); %.9g m is "
                "used, rebuilt from MAP_RESOLUTION",
                self.path,
                scale,
                shift,
                rebuilt,
            )
        return rebuilt

    def _map_scale_m(self) -> float | None:
        """MAP_SCALE in metres; without a unit, metres or kilometres by MAP_RESOLUTION (GDAL assumes
        kilometres).
        """
        value = self.map.get("MAP_SCALE")
        scale = number(self.map, "MAP_SCALE")
        if scale is None:
            return None
        if scale <= 0.0:
            raise LabelError(f"MAP_SCALE is {scale:g}")
        if isinstance(value, Quantity):
            return scale * metres(value.unit.split("/")[0].strip(), "MAP_SCALE")
        resolution = number(self.map, "MAP_RESOLUTION")
        if resolution is None:
            raise LabelError(
                "MAP_SCALE has no unit and there is no MAP_RESOLUTION: metres or kilometres?"
            )
        rebuilt = math.radians(1.0) * MOON_RADIUS_M / resolution
        return min((scale, scale * 1000.0), key=lambda metres: abs(math.log(metres / rebuilt)))

    def _compare_with_bounds(self, label: Label) -> None:
        """Refuse a cylinder whose offsets contradict its latitudes or longitudes (older LROC labels
        have the other sign).
        """
        if label.projection != "equirectangular":
            return
        degree_m = math.radians(1.0) * MOON_RADIUS_M
        ring_m = degree_m * math.cos(math.radians(label.center_lat_deg))
        north = (label.line_offset + 0.5) * label.pixel_m / degree_m
        west = label.center_lon_deg - (label.sample_offset + 0.5) * label.pixel_m / ring_m
        said_north, said_west = (
            number(self.map, "MAXIMUM_LATITUDE"),
            number(self.map, "WESTERNMOST_LONGITUDE"),
        )
        tolerance = 1.5 * label.pixel_m / ring_m
        if said_north is not None and abs(north - said_north) > tolerance:
            raise LabelError(
                f"LINE_PROJECTION_OFFSET puts the north edge at {north:.6g} deg, "
                f"MAXIMUM_LATITUDE at {said_north:g}"
            )
        if said_west is not None and abs(wrapped_deg(west - said_west)) > tolerance:
            raise LabelError(
                f"SAMPLE_PROJECTION_OFFSET puts the west edge at {west:.6g} deg, "
                f"WESTERNMOST_LONGITUDE at {said_west:g}"
            )


def _first(tables: list[Pvl], *keys: str) -> float | None:
    found = (number(table, key) for table in tables for key in keys)
    return next((value for value in found if value is not None), None)


@dataclass(frozen=True)
class _Samples:
    """Storage of the samples of an image, by the tables of its label; raises LabelError."""

    image: Pvl
    compressed: Pvl | None  # its table comes before that of the image

    def dtype(self) -> str:
        """NumPy type of the samples of an uncompressed image."""
        kind, bits = (
            text(self.image, "SAMPLE_TYPE"),
            int(wanted(self.image, "SAMPLE_BITS")),
        )
        if (kind, bits) not in _SAMPLES:
            raise LabelError(f"samples of type {kind} with {bits} bits are not supported")
        return _SAMPLES[kind, bits]

    def tables(self) -> Iterator[Pvl]:
        """Tables that can hold a key of the pixels, that of the compressed file first."""
        if self.compressed is not None:
            yield self.compressed
        yield self.image

    def missing(self) -> Iterator[float]:
        """Sample values of missing data. There are none for "N/A" or without a statement."""
        for table in self.tables():
            for key in ("MISSING_CONSTANT", "MISSING", "INVALID_CONSTANT", "CORE_NULL", "NULL"):
                yield from self._constants(table.get(key), key)
            for key in table:
                if re.fullmatch(r"CORE_(LOW|HIGH)_(REPR|INSTR)_SATURATION", key):
                    yield from self._constants(table[key], key)

    def _constants(self, value: Any, key: str) -> Iterator[float]:
        for item in value if isinstance(value, list) else [value]:
            number = item.value if isinstance(item, Quantity) else item
            if isinstance(number, float):
                yield number
            elif isinstance(number, str) and re.fullmatch(r"16#[0-9A-Fa-f]+#", number):
                yield _from_hex(number[3:-1], self.dtype() if self.compressed is None else "<i2")
            elif isinstance(number, str) and number.upper() not in (
                "N/A",
                "UNK",
                "NULL",
                "NONE",
                "",
            ):
                raise LabelError(f"{key} = {number} is not understood")


def _from_hex(digits: str, dtype: str) -> float:
    """A missing constant given by its bits, most significant first."""
    import numpy as np  # noqa: PLC0415  # only labels with such a constant

    kind = np.dtype(dtype).newbyteorder(">")
    return float(np.frombuffer(bytes.fromhex(digits.zfill(2 * kind.itemsize)), dtype=kind)[0])
