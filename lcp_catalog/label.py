"""PDS3 labels of lunar DEM products: the text, and what it says about the pixels and the map.

Heights are taken from here and never from a reader's own idea of scale, offset and nodata: GDAL
3.10-3.12 gives scale 1 for
LOLA JP2 products (0.5 m counts), the sphere's radius as an offset of height, and a nodata value
that no label states.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .constants import MOON_RADIUS_M
from .errors import LabelError

log = logging.getLogger(__name__)

Pvl = dict[str, Any]
"""A label's statements; an OBJECT or GROUP is a nested dictionary, a number with a unit a
``Quantity``.
"""

_MAX_LABEL_BYTES = 262_144
_METRES = {"M": 1.0, "METER": 1.0, "METERS": 1.0, "METRE": 1.0, "METRES": 1.0}
_METRES |= {
    "KM": 1000.0,
    "KILOMETER": 1000.0,
    "KILOMETERS": 1000.0,
    "KILOMETRE": 1000.0,
    "KILOMETRES": 1000.0,
}
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
_CYLINDRICAL = {"SIMPLE CYLINDRICAL", "EQUIRECTANGULAR", "EQUIDISTANT CYLINDRICAL"}
_MATERIAL_SHIFT_PX = 0.1
"""A MAP_SCALE that moves the far edge by less than this share of a pixel is only rounded, and
nobody needs to hear of it.
"""


@dataclass(frozen=True)
class Quantity:
    """A number and the unit that stood behind it in angle brackets, upper case."""

    value: float
    unit: str


@dataclass(frozen=True)
class Label:
    """What a PDS3 label says, in metres and degrees, checked; nothing here is guessed by a reader
    of rasters.

    ``height_m = sample * height_scale_m``: the label's OFFSET is the sphere's radius and no term of
    height. Pixel (row,
    column), counted from 0, has its centre at ``x = (column - sample_offset) * pixel_m``, ``y =
    (line_offset - row) *
    pixel_m`` of a map with its origin at the centre longitude and the equator (cylindrical) or at
    the pole.
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
    sample_dtype: str | None  # None: the compressed file itself says it
    image_name: str
    image_offset_bytes: int
    compressed: bool

    @property
    def image_bytes(self) -> int:
        """Size that an uncompressed image file must have at least."""
        bits = int((self.sample_dtype or "i2")[-1])
        return self.image_offset_bytes + self.lines * self.line_samples * bits

    @classmethod
    def read(cls, path: Path) -> Label:
        """The label in ``path``: detached, or attached in front of an image; ``LabelError`` says
        what is wrong with it.
        """
        text = read_label_text(path)
        if text is None:
            raise LabelError(f"{path}: not a PDS3 label (it does not begin with PDS_VERSION_ID)")
        return cls.from_text(text, path)

    @classmethod
    def from_text(cls, text: str, path: Path) -> Label:
        """The label of ``text``; ``path`` is where it stood."""
        try:
            return _Interpreter(parse_pvl(text), path).label()
        except LabelError as error:
            raise LabelError(f"{path}: {error}") from None


def read_label_text(path: Path) -> str | None:
    """Text of the PDS3 label that ``path`` is or begins with; None for anything else."""
    with path.open("rb") as file:
        head = file.read(_MAX_LABEL_BYTES)
    if not head.lstrip(b"\xef\xbb\xbf \r\n\t").upper().startswith(b"PDS_VERSION_ID"):
        return None
    return head.decode("latin-1")


def find_label(image: Path) -> Path:
    """The label of an image file: itself when attached, else beside it; ``LabelError`` when there
    is none.

    LDEM_4.JP2 belongs to LDEM_4_JP2.LBL and not to LDEM_4.LBL, whose .IMG lies on another grid
    (0..360 against -180..180).
    """
    if read_label_text(image) is not None:
        return image
    beside = {p.name.lower(): p for p in sorted(image.parent.iterdir())}
    stem, ending = image.stem.lower(), image.suffix.lower().lstrip(".")
    for name in (f"{stem}_{ending}.lbl", f"{stem}.lbl"):
        label = beside.get(name)
        if label is not None and (ending != "jp2" or _describes_compressed(label)):
            return label
    wanted = f"{image.stem}_JP2.LBL" if ending == "jp2" else f"{image.stem}.LBL"
    why = (
        "a bare JP2 does not say its heights' scale"
        if ending == "jp2"
        else "an .IMG is bare numbers"
    )
    raise LabelError(
        f"{image}: its label {wanted} is missing ({why}); put the product's label beside it"
    )


def find_image(label: Label) -> Path:
    """The file that holds the label's pixels, whatever the case of its name."""
    if label.image_name == "":
        return label.path
    for path in sorted(label.path.parent.iterdir()):
        if path.name.lower() == label.image_name.lower():
            return path
    raise LabelError(
        f"{label.path}: the image that it describes, {label.image_name}, is not beside it"
    )


def _describes_compressed(path: Path) -> bool:
    return "COMPRESSED_FILE" in parse_pvl(read_label_text(path) or "")


_TOKEN = re.compile(
    r"""/\*.*?\*/ | (?P<string>"[^"]*"|'[^']*') | (?P<unit><[^>]*>) | (?P<mark>[={}(),])
    | (?P<word>[^\s={}(),<>"']+)""",
    re.S | re.X,
)


def parse_pvl(text: str) -> Pvl:
    """The statements of an ODL/PVL text, up to END; a key's first value counts."""
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
            stack.append(stack[-1].setdefault(str(value).upper(), {}))
        elif key in ("END_OBJECT", "END_GROUP"):
            if len(stack) > 1:
                stack.pop()
        elif value is not None:
            stack[-1].setdefault(key, value)
    return stack[0]


def _pvl_value(tokens: list[re.Match[str]], at: int) -> tuple[Any, int]:
    """The value that begins at token ``at``, and where the next statement begins."""
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
    value = " ".join(value[1:-1].split()) if token.lastgroup == "string" else _number(value)
    if at + 1 < len(tokens) and tokens[at + 1].lastgroup == "unit":
        unit = tokens[at + 1].group()[1:-1].strip().upper()
        return (Quantity(value, unit) if isinstance(value, float) else value), at + 2
    return value, at + 1


def _number(word: str) -> float | str:
    try:
        return float(word) if word[:1] in "+-.0123456789" else word
    except ValueError:
        return word


class _Interpreter:
    """Turns a label's statements into a ``Label``; every refusal is a ``LabelError`` without the
    path.
    """

    def __init__(self, pvl: Pvl, path: Path) -> None:
        self.pvl, self.path = pvl, path
        compressed, plain = pvl.get("COMPRESSED_FILE"), pvl.get("UNCOMPRESSED_FILE", pvl)
        self.compressed: Pvl | None = compressed if isinstance(compressed, dict) else None
        self.file: Pvl = plain if isinstance(plain, dict) else pvl
        self.image: Pvl = self._table(self.file, "IMAGE") or self._table(pvl, "IMAGE") or {}
        self.map: Pvl = self._table(pvl, "IMAGE_MAP_PROJECTION") or {}

    @staticmethod
    def _table(pvl: Pvl, key: str) -> Pvl | None:
        value = pvl.get(key)
        return value if isinstance(value, dict) else None

    def label(self) -> Label:
        if not self.map:
            raise LabelError("the label has no IMAGE_MAP_PROJECTION; a map-projected DEM is wanted")
        self._refuse_foreign_maps()
        projection = self._projection()
        lines, samples = self._size()
        name, offset = self._image_file()
        label = Label(
            path=self.path,
            product_id=self._product_id(name),
            projection=projection,
            center_lon_deg=self._want(self.map, "CENTER_LONGITUDE"),
            center_lat_deg=self._want(self.map, "CENTER_LATITUDE"),
            pixel_m=self._pixel_m(projection, max(lines, samples)),
            line_offset=self._want(self.map, "LINE_PROJECTION_OFFSET"),
            sample_offset=self._want(self.map, "SAMPLE_PROJECTION_OFFSET"),
            lines=lines,
            line_samples=samples,
            height_scale_m=self._height_scale_m(),
            missing=tuple(self._missing()),
            sample_dtype=None if self.compressed else self._dtype(),
            image_name=name,
            image_offset_bytes=offset,
            compressed=self.compressed is not None,
        )
        self._compare_with_bounds(label)
        return label

    def _get(self, table: Pvl, key: str) -> float | None:
        value = table.get(key)
        value = value.value if isinstance(value, Quantity) else value
        return float(value) if isinstance(value, float | int) and math.isfinite(value) else None

    def _want(self, table: Pvl, key: str) -> float:
        value = self._get(table, key)
        if value is None:
            raise LabelError(
                f"the label does not give {key} as a number (it says {table.get(key)!r})"
            )
        return value

    def _text(self, table: Pvl, key: str) -> str:
        return str(table.get(key, "")).upper()

    def _refuse_foreign_maps(self) -> None:
        target = self._text(self.pvl, "TARGET_NAME")
        if target not in ("", "MOON"):
            raise LabelError(f"the label's target is {target}; only the Moon is catalogued")
        for key in ("A_AXIS_RADIUS", "B_AXIS_RADIUS", "C_AXIS_RADIUS"):
            self._refuse_foreign_radius(key, self._radius_m(key))
        if self._text(self.map, "POSITIVE_LONGITUDE_DIRECTION") not in ("", "EAST"):
            raise LabelError("longitudes that grow to the west are not supported")
        if (self._get(self.map, "MAP_PROJECTION_ROTATION") or 0.0) != 0.0:
            raise LabelError(
                f"a map rotated by {self._get(self.map, 'MAP_PROJECTION_ROTATION'):g} deg "
                "is not supported"
            )
        if any(key.startswith("OBLIQUE_PROJ") for key in self.map):
            raise LabelError("an oblique map projection is not supported")

    def _radius_m(self, key: str) -> float | None:
        value = self.map.get(key)
        number = self._get(self.map, key)
        if number is None:
            return None
        unit = value.unit if isinstance(value, Quantity) else ("KM" if number < 10_000.0 else "M")
        return number * _metres(unit, key)

    @staticmethod
    def _refuse_foreign_radius(key: str, radius_m: float | None) -> None:
        if radius_m is not None and abs(radius_m - MOON_RADIUS_M) > 0.5:
            raise LabelError(
                f"{key} is {radius_m:.10g} m; heights are wanted above the sphere of "
                f"{MOON_RADIUS_M:.0f} m"
            )

    def _projection(self) -> str:
        name = self._text(self.map, "MAP_PROJECTION_TYPE").replace("_", " ")
        latitude = self._want(self.map, "CENTER_LATITUDE")
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
        lines, samples = self._get(self.image, "LINES"), self._get(self.image, "LINE_SAMPLES")
        lines = self._want(self.map, "LINE_LAST_PIXEL") if lines is None else lines
        samples = self._want(self.map, "SAMPLE_LAST_PIXEL") if samples is None else samples
        if lines < 1 or samples < 1 or (self._get(self.image, "BANDS") or 1.0) != 1.0:
            raise LabelError(f"an image of {lines:g} x {samples:g} pixels with one band is wanted")
        return int(lines), int(samples)

    def _image_file(self) -> tuple[str, int]:
        """Name of the image's file ("" when the label is attached to it) and the byte at which its
        pixels begin.
        """
        if self.compressed is not None:
            return str(self.compressed.get("FILE_NAME", "")), 0
        pointer = self.file.get("^IMAGE", self.pvl.get("^IMAGE"))
        parts = pointer if isinstance(pointer, list) else [pointer]
        name = next((p for p in parts if isinstance(p, str)), "")
        place = next((p for p in parts if isinstance(p, float | Quantity)), 1.0)
        if pointer is None:
            raise LabelError("the label does not say where its image is (^IMAGE)")
        if isinstance(place, Quantity):
            return name, int(place.value) - (1 if place.value > 0 else 0)
        record = self._get(self.file, "RECORD_BYTES") or self._get(self.pvl, "RECORD_BYTES") or 0.0
        return name, int((place - 1.0) * record)

    def _product_id(self, image_name: str) -> str:
        stem = Path(image_name).stem or self.path.stem
        return str(self.pvl.get("PRODUCT_ID") or stem)

    def _dtype(self) -> str:
        kind, bits = (
            self._text(self.image, "SAMPLE_TYPE"),
            int(self._want(self.image, "SAMPLE_BITS")),
        )
        if (kind, bits) not in _SAMPLES:
            raise LabelError(f"samples of type {kind} with {bits} bits are not supported")
        return _SAMPLES[kind, bits]

    def _described(self) -> Iterator[Pvl]:
        """Where a key of the pixels may stand, the file at hand first."""
        if self.compressed is not None:
            yield self.compressed
        yield self.image

    def _height_scale_m(self) -> float:
        for table in self._described():
            factor = self._get(table, "SCALING_FACTOR")
            if factor is not None:
                unit = self._text(table, "UNIT") or "METER"
                radius = self._get(table, "OFFSET")
                if radius not in (None, 0.0):
                    self._refuse_foreign_radius("OFFSET", radius * _metres(unit, "UNIT"))
                return factor * _metres(unit, "UNIT")
        unit = next((u for table in self._described() if (u := self._text(table, "UNIT"))), "")
        if unit:
            return _metres(unit, "UNIT")
        if self.compressed is not None:
            # SLDEM2015's JP2 labels are silent; the archive's JP2 files are all int16 counts of
            # half a metre
            log.warning(
                "%s: the label gives no SCALING_FACTOR; LOLA's JP2 counts of 0.5 m are assumed",
                self.path,
            )
            return 0.5
        return 1.0  # WAC GLD100 and NAC DTM labels give neither unit nor scale: metres

    def _missing(self) -> Iterator[float]:
        """Sample values that mean "nothing here"; "N/A" and silence mean that there are none."""
        for table in self._described():
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
                yield _from_hex(number[3:-1], self._dtype() if self.compressed is None else "<i2")
            elif isinstance(number, str) and number.upper() not in (
                "N/A",
                "UNK",
                "NULL",
                "NONE",
                "",
            ):
                raise LabelError(f"{key} = {number} is not understood")

    def _pixel_m(self, projection: str, pixels: int) -> float:
        """Pixel size on the map, metres.

        A cylinder's MAP_SCALE is often rounded (0.059225 km at 512 pix/deg): it is rebuilt from
        MAP_RESOLUTION and the
        radius. A polar map's MAP_RESOLUTION is the rounded one (1516.17 pix/deg at 20 m).
        """
        scale = self._map_scale_m()
        resolution = self._get(self.map, "MAP_RESOLUTION")
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
        shift = abs(scale / rebuilt - 1.0) * pixels
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
        """MAP_SCALE in metres; without a unit it decides nothing as long as MAP_RESOLUTION is there
        (GDAL takes km).
        """
        value = self.map.get("MAP_SCALE")
        number = self._get(self.map, "MAP_SCALE")
        if number is None:
            return None
        if number <= 0.0:
            raise LabelError(f"MAP_SCALE is {number:g}")
        if isinstance(value, Quantity):
            return number * _metres(value.unit.split("/")[0].strip(), "MAP_SCALE")
        resolution = self._get(self.map, "MAP_RESOLUTION")
        if resolution is None:
            raise LabelError(
                "MAP_SCALE has no unit and there is no MAP_RESOLUTION: metres or kilometres?"
            )
        rebuilt = math.radians(1.0) * MOON_RADIUS_M / resolution
        return min((number, number * 1000.0), key=lambda metres: abs(math.log(metres / rebuilt)))

    def _compare_with_bounds(self, label: Label) -> None:
        """Refuse a cylinder whose offsets contradict its latitudes or longitudes (older LROC labels
        turn the sign).
        """
        if label.projection != "equirectangular":
            return
        degree_m = math.radians(1.0) * MOON_RADIUS_M
        ring_m = degree_m * math.cos(math.radians(label.center_lat_deg))
        north = (label.line_offset + 0.5) * label.pixel_m / degree_m
        west = label.center_lon_deg - (label.sample_offset + 0.5) * label.pixel_m / ring_m
        said_north, said_west = (
            self._get(self.map, "MAXIMUM_LATITUDE"),
            self._get(self.map, "WESTERNMOST_LONGITUDE"),
        )
        tolerance = 1.5 * label.pixel_m / ring_m
        if said_north is not None and abs(north - said_north) > tolerance:
            raise LabelError(
                f"LINE_PROJECTION_OFFSET puts the north edge at {north:.6g} deg, "
                f"MAXIMUM_LATITUDE at {said_north:g}"
            )
        if said_west is not None and abs((west - said_west + 180.0) % 360.0 - 180.0) > tolerance:
            raise LabelError(
                f"SAMPLE_PROJECTION_OFFSET puts the west edge at {west:.6g} deg, "
                f"WESTERNMOST_LONGITUDE at {said_west:g}"
            )


def _metres(unit: str, key: str) -> float:
    factor = _METRES.get(unit.upper().strip())
    if factor is None:
        raise LabelError(f"the unit <{unit}> of {key} is not a length that is known here")
    return factor


def _from_hex(digits: str, dtype: str) -> float:
    """A missing constant given by its bits, most significant first."""
    import numpy as np  # noqa: PLC0415  # only labels with such a constant

    kind = np.dtype(dtype).newbyteorder(">")
    return float(np.frombuffer(bytes.fromhex(digits.zfill(2 * kind.itemsize)), dtype=kind)[0])
