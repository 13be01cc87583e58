"""The Sun of an image from its label: the tables of an ISIS cube, times or subsolar point of a PDS3
or PDS4 label, or the tags of a render.
"""

from __future__ import annotations

import datetime as dt
import json
import logging
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array
from ..ephemeris.solar_position import direction_from_subsolar, sun_direction_at
from ..ephemeris.times import instants
from ..errors import ImageError, LabelError, SunError
from ..pds import pvl
from ..pds.isis_tables import sun_of_tables
from ..pds.label_files import find_label
from ..pds.pds3 import read_label_text
from ..pds.pds4 import is_pds4, xml_root
from ..pds.pvl import Quantity
from .pixels import NO_CODES, Codes, ImagePixels

Item = tuple[str, Any]

log = logging.getLogger(__name__)

LONGEST_SPAN_S = 7200.0
"""Longest time from start to stop of one image: the Sun moves by 1 deg over the Moon in that time.
A longer span belongs to a mosaic, which has no single Sun.
"""

_NOTHING = {"", "N/A", "UNK", "NULL", "NONE", "NA"}
_BASED = re.compile(r"(2|8|10|16)#([0-9A-Fa-f]+)#")
_CODE_KEYS = {
    "missing": ("NULL", "MISSINGCONSTANT", "MISSING"),
    "low": ("LOWINSTRSATURATION", "LOWREPRSATURATION"),
    "high": ("HIGHINSTRSATURATION", "HIGHREPRSATURATION"),
}
_PDS4 = {
    "{*}Time_Coordinates/{*}start_date_time": "STARTTIME",
    "{*}Time_Coordinates/{*}stop_date_time": "STOPTIME",
    "{*}Target_Identification/{*}name": "TARGETNAME",
}
_DAY_OF_YEAR = re.compile(r"(\d{4})-(\d{3})(?=T|$)")


@dataclass(frozen=True, eq=False)
class ImageLabel:
    """Sun of an image by its label: a position (3,) in MCMF metres, a unit direction (3,), or a
    time; None for each that the label does not give.

    ``source`` names the source of the first of these. ``codes``: stored samples that a PDS3 label
    defines as not brightness.
    """

    source: str = ""
    sun_position_mcmf_m: Array | None = None
    sun_direction_mcmf: Array | None = None
    time_utc: str | None = None
    codes: Codes = NO_CODES

    def direction(self) -> Array | None:
        """Unit MCMF direction (3,) from the Moon's centre to the Sun; None if the label gives no
        Sun.
        """
        if self.sun_position_mcmf_m is not None:
            return self.sun_position_mcmf_m / np.linalg.norm(self.sun_position_mcmf_m)
        if self.sun_direction_mcmf is not None:
            return self.sun_direction_mcmf
        return None if self.time_utc is None else sun_direction_at(self.time_utc)


def read_image_label(image: ImagePixels) -> ImageLabel:
    """The label of an image. Sources of the Sun, the most reliable first: position in a cube's
    tables, direction in a render's tags, subsolar point, middle of start and stop time.

    ImageError if the label names another body than the Moon. Damaged parts of a label are ignored
    and logged.
    """
    items = list(_statements(image))
    _require_moon(image.path, items)
    return replace(_sun_of(image, items), codes=_codes(image, items))


def _sun_of(image: ImagePixels, items: list[Item]) -> ImageLabel:
    time = _middle_time(image.path, items)
    position = None if image.isis is None else sun_of_tables(image.path, image.isis)
    if position is not None:
        return ImageLabel("the label's SunPosition table", position, time_utc=time)
    direction = _render_direction(image)
    if direction is not None:
        return ImageLabel("the render's tags", sun_direction_mcmf=direction, time_utc=time)
    direction = _subsolar(image.path, items)
    if direction is not None:
        return ImageLabel("the label's subsolar point", sun_direction_mcmf=direction, time_utc=time)
    return ImageLabel("the label's time" if time else "", time_utc=time)


# -- statements, of whatever language


def _statements(image: ImagePixels) -> Iterator[Item]:
    """Every key of the label with its value, in order; keys in upper case without underscores."""
    if image.isis is not None:
        yield from _flat(image.isis)
    try:
        text = read_label_text(image.path) or _text_beside(image.path)
        if text is not None:
            yield from _flat(pvl.parse_pvl(text))
        elif image.opened.suffix.lower() == ".xml" and is_pds4(image.opened):
            yield from _xml(image.opened)
    except (OSError, LabelError) as error:
        log.warning("%s: its label is ignored: %s", image.path, error)


def _text_beside(path: Path) -> str | None:
    """Text of the detached PDS3 label beside an image."""
    try:
        return read_label_text(find_label(path))
    except LabelError:
        return None


def _flat(document: Mapping[str, Any]) -> Iterator[Item]:
    for key, value in document.items():
        if isinstance(value, Mapping) and "value" not in value:
            yield from _flat(value)
        else:
            yield key.upper().replace("_", ""), value


def _xml(path: Path) -> Iterator[Item]:
    """Times and target of a PDS4 label; unfilled template values (${...}) are ignored."""
    root = xml_root(path)
    for tag, key in _PDS4.items():
        element = root.find(f".//{tag}")
        if element is not None and element.text and not element.text.startswith("${"):
            yield key, element.text


def _first(items: list[Item], key: str) -> Any:
    return next((value for name, value in items if name == key), None)


def _text(value: Any) -> str:
    value = value[0] if isinstance(value, list) and value else value
    return "" if value is None else str(value).strip().strip('"')


def _number(value: Any) -> float | None:
    """A finite number without its unit."""
    value = value.value if isinstance(value, Quantity) else value
    value = value.get("value") if isinstance(value, Mapping) else value
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _require_moon(path: Path, items: list[Item]) -> None:
    body = _text(_first(items, "TARGETNAME")).upper()
    if body not in _NOTHING | {"MOON", "LUNA"}:
        raise ImageError(f"{path}: its label names {body}, not the Moon")


def _codes(image: ImagePixels, items: list[Item]) -> Codes:
    """Stored samples that a PDS3 label defines as not brightness; for 16 bits without a declared
    missing code, the lowest value is missing.
    """
    if image.driver != "PDS":
        return NO_CODES
    found = {
        kind: tuple(
            code
            for key in keys
            for name in (key, f"CORE{key}")
            if (code := _code(_first(items, name))) is not None
        )
        for kind, keys in _CODE_KEYS.items()
    }
    if not found["missing"] and image.samples.dtype == np.int16:
        found["missing"] = (-32768,)
    return Codes(found["missing"], found["low"], found["high"])


def _code(value: Any) -> float | int | None:
    """A number, also in the form 16#FF7FFFFB#; whole numbers as int."""
    based = _BASED.fullmatch(_text(value))
    if based is not None:
        return int(based[2], int(based[1]))
    number = _number(value)
    return int(number) if number is not None and number == int(number) else number


# -- the Sun


def _middle_time(path: Path, items: list[Item]) -> str | None:
    """Middle of start and stop time, or the only one of them; None without a time, for invalid
    times and for long spans.
    """
    texts = [_text(_first(items, key)) for key in ("STARTTIME", "STOPTIME")]
    said = [_calendar(text) for text in texts if text.upper() not in _NOTHING]
    if not said:
        return None
    try:
        times = instants(said)
    except SunError as error:
        log.warning("%s: its time is ignored: %s", path, error)
        return None
    start, stop = times.civil[0], times.civil[-1]
    if abs((stop - start) / np.timedelta64(1, "s")) > LONGEST_SPAN_S:
        log.warning("%s: from %s to %s is too long for a single Sun", path, *said)
        return None
    return instants(np.array([start + (stop - start) // 2])).labels()[0]


def _calendar(text: str) -> str:
    """A time with the day of the year (2009-211T12:20:38) as a calendar date; other times
    unchanged.
    """
    found = _DAY_OF_YEAR.match(text)
    if found is None:
        return text
    day = dt.date(int(found[1]), 1, 1) + dt.timedelta(days=int(found[2]) - 1)
    return day.isoformat() + text[found.end() :]


def _subsolar(path: Path, items: list[Item]) -> Array | None:
    lon, lat = (_number(_first(items, f"SUBSOLAR{what}")) for what in ("LONGITUDE", "LATITUDE"))
    if lon is None or lat is None:
        return None
    try:
        return direction_from_subsolar(lon, lat)
    except SunError as error:
        log.warning("%s: its subsolar point is ignored: %s", path, error)
        return None


def _render_direction(image: ImagePixels) -> Array | None:
    text = (image.tags or {}).get("sun_direction_mcmf")
    if text is None:
        return None
    try:
        direction = np.array(json.loads(text), dtype=np.float64)
    except (TypeError, ValueError):
        direction = np.zeros(0)
    if direction.shape != (3,) or not abs(np.linalg.norm(direction) - 1.0) < 1e-3:
        log.warning("%s: its tag sun_direction_mcmf is not a direction and is ignored", image.path)
        return None
    return direction / np.linalg.norm(direction)
