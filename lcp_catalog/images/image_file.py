"""Images from files: signal, weights, sensor and Sun.

Recognition of files that hold heights, so that a DEM is not searched as an image.

The Sun of an image from its label: the tables of an ISIS cube, times or subsolar point of a PDS3
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

from ..arrays import Array, Float32
from ..cameras.camera_file import read_sensor
from ..cameras.map_projected import MapImage
from ..cameras.mistakes import Sees, sees_moon
from ..cameras.sensor import ON_MAP, Sensor
from ..cameras.view import center_of
from ..choices import ENCODINGS
from ..dem.dem import Dem
from ..dem.products import facts_of
from ..dem.raster import POSSIBLE_M
from ..ephemeris.solar_position import SUNS_DIFFER_DEG, direction_from_subsolar, sun_direction_at
from ..ephemeris.times import instants
from ..errors import ImageError, LabelError, LcpError, SunError
from ..geometry.frames import EnuFrame
from ..light.sun_choice import SunChoice
from ..pds import pds3
from ..pds.label_files import find_label, sun_of_tables
from ..pds.pds3 import Quantity, read_label_text
from ..pds.pds4 import is_pds4, xml_root
from ..photometry.srgb import decode_srgb
from .image import Image
from .pixels import (
    NO_CODES,
    Codes,
    ImagePixels,
    SpecialPixels,
    image_shape,
    isis_special,
    plateau_ends,
    read_pixels,
    touching_edge,
)

log = logging.getLogger(__name__)

Item = tuple[str, Any]


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
            yield from _flat(pds3.parse_pvl(text))
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


LEAST_DEPTH_M = 50.0
DEEP_SHARE = {"f": 0.01, "i": 0.5}
"""Samples (floating-point, signed integers) of which this share is lower than minus that depth are
heights: brightness is negative only by noise. Integers may have an offset.
"""

LEAST_RELIEF_M = 20.0
"""Least range of the samples of a file with the name of a DEM product; calibrated brightness (I/F)
has a range of about 1.
"""

_ORTHOPHOTO = re.compile(r"_M\d{8,}", re.I)
"""Number of an observation in the name: an orthophoto made with a NAC DTM."""

_WINDOWS, _WINDOW_PX = 4, 256
"""Windows along each side of a file whose samples are read, and their size."""


def refuse_heights(path: Path) -> None:
    """ImageError, one line, for a map-projected DEM of the Moon instead of an image.

    A DEM is a file that `Dem.open` reads and that has either the name or label of a known product
    and relief in metres, or samples far below 0. Only some windows are read.
    """
    try:
        dem = Dem.open(path)
        heights = _some_heights(dem)
    except (LcpError, OSError):
        return  # no DEM; whether it is an image is found out by the reader of images
    if not _are_heights(dem, heights):
        return
    raise ImageError(
        f"{path}: holds heights ({dem.product}: {heights.min():.0f} to {heights.max():.0f} m), not brightness; "
        "give an image, and the DEM as `dem`"
    )


def _some_heights(dem: Dem) -> Array:
    """Finite heights (n,), metres, of windows spread over a DEM; special codes are left out."""
    raster, found = dem.raster, []
    for row in _starts(raster.height):
        for col in _starts(raster.width):
            end = min(row + _WINDOW_PX, raster.height), min(col + _WINDOW_PX, raster.width)
            found.append(raster.values(row, end[0], col, end[1]).ravel())
    values = np.concatenate(found)
    return np.asarray(values[np.abs(values) <= POSSIBLE_M])


def _starts(length: int) -> list[int]:
    """First rows or columns of the windows along a side."""
    places = np.linspace(0, max(length - _WINDOW_PX, 0), _WINDOWS).astype(int)
    return sorted(set(places.tolist()))


def _are_heights(dem: Dem, heights: Array) -> bool:
    if not heights.size:
        return False
    kind = dem.raster.samples(0, 1, 0, 1).dtype.kind
    known = facts_of(dem.product).family != "unknown" and not _ORTHOPHOTO.search(dem.path.stem)
    if kind not in DEEP_SHARE:
        return False
    deep = float(np.mean(heights < -LEAST_DEPTH_M)) > DEEP_SHARE[kind]
    return deep or (known and float(np.ptp(heights)) > LEAST_RELIEF_M)


@dataclass(frozen=True)
class ImageOptions:
    """Properties that an image file does not give itself.

    ``band``: None for the luminance of a colour image, else the first band. ``nodata``: value of
    missing samples. ``center_deg``: longitude and latitude, degrees, of the place for a Sun given
    by angles; None for the image's centre. ``off_nadir_deg``, ``view_azimuth_deg``: viewing
    direction of a map-projected image. ``encoding``: ``linear`` for integer samples proportional to
    radiance, ``srgb`` for codes of a display image. ImageError for another encoding.

    Examples
    --------
    >>> scan = lcp.ImageOptions(encoding="srgb")
    >>> decoded = lcp.open_image(folder / "AS15-M-0414.png", camera, options=scan)
    >>> round(float(decoded.signal[decoded.valid].max()), 2)
    0.99
    """

    band: int | None = None
    nodata: float | None = None
    center_deg: tuple[float, float] | None = None
    off_nadir_deg: float = 0.0
    view_azimuth_deg: float = 0.0
    encoding: str = ENCODINGS[0]

    def __post_init__(self) -> None:
        if self.encoding not in ENCODINGS:
            raise ImageError(
                f"invalid encoding {self.encoding!r}; available are {', '.join(ENCODINGS)}"
            )


@dataclass(frozen=True, eq=False)
class _Pixels:
    signal: Float32
    weight: Float32
    saturated_share: float
    missing_share: float


def open_image(
    path: Path | str,
    sensor: Sensor | Path | str | None = None,
    sun: SunChoice | None = None,
    options: ImageOptions | None = None,
    sees: Sees = sees_moon,
) -> Image:
    """The image in a file, with the sensor that took it.

    Parameters
    ----------
    path:
        Any raster that GDAL reads, PDS and ISIS images included.
    sensor:
        Camera or another sensor, or its file; None: the map on which the file is projected.
    sun:
        The Sun; None: the sensor's own, else that of the image's label.
    options:
        Band, nodata and encoding, which the file does not give itself.
    sees:
        As `read_sensor`.

    Raises
    ------
    ImageError
        For a file that is no image, has no geometry, no Sun, no valid pixel, or another size than
        its camera.
    CameraError
        For a camera file that cannot be read.
    SunError
        For an invalid Sun.

    Examples
    --------
    >>> image = lcp.open_image(folder / "AS15-M-0414.png", camera)
    >>> image.signal.shape, round(float(image.valid.mean()), 1)
    ((404, 404), 1.0)
    """
    options = options or ImageOptions()
    if isinstance(sensor, Path | str):
        sensor = read_sensor(sensor, image_shape(path), sees)
    image = read_pixels(path, options.band, options.nodata, options.encoding)
    label = read_image_label(image)
    taken_by = _sensor(image, sensor, options)
    pixels = _pixels(image, label.codes, sensor is None, options.encoding)
    position, direction = _sun(image.path, taken_by, sun or SunChoice(), label, options)
    return Image(
        name=image.path.name,
        signal=pixels.signal,
        weight=pixels.weight,
        sensor=taken_by,
        sun_position_mcmf_m=position,
        sun_direction_mcmf=direction,
        saturated_share=pixels.saturated_share,
        missing_share=pixels.missing_share,
    )


def decoded(image: Image, path: Path | str, options: ImageOptions) -> Image | None:
    """The image of a file that was opened as linear, with its samples of 8 bits taken as codes of a display
    image (sRGB); None for other samples.
    """
    pixels = read_pixels(path, options.band, options.nodata, "srgb")
    if not (pixels.samples.dtype == np.uint8 or pixels.is_decoded):
        return None
    on_map = image.sensor.corrections == ON_MAP
    found = _pixels(pixels, read_image_label(pixels).codes, on_map, "srgb")
    return replace(image, signal=found.signal, weight=found.weight)


def _sensor(image: ImagePixels, sensor: Sensor | None, options: ImageOptions) -> Sensor:
    rows, cols = image.samples.shape
    if sensor is None:
        if image.crs_wkt is None:
            raise ImageError(
                f"{image.path}: missing geometry: the image is not map-projected; give its `camera`"
            )
        return MapImage(
            image.crs_wkt,
            image.transform,
            (rows, cols),
            str(image.path),
            off_nadir_deg=options.off_nadir_deg,
            view_azimuth_deg=options.view_azimuth_deg,
        )
    if sensor.shape != (rows, cols):
        of_camera = f"{sensor.shape[1]} x {sensor.shape[0]}"
        raise ImageError(
            f"{image.path}: has {cols} x {rows} pixels, but its camera {sensor.name} has {of_camera}; "
            "give the camera of this image"
        )
    if image.crs_wkt is not None:
        log.warning(
            "%s: is map-projected; the map is ignored because a camera is given", image.path
        )
    return sensor


# -- pixels


def _pixels(image: ImagePixels, codes: Codes, on_map: bool, encoding: str) -> _Pixels:
    """Signal and weights; ImageError for an image without content.

    Samples that are too dark for the file take the darkest value that it can hold, with full
    weight: they are known to be dark, like the shadow of a render. A lower weight loses points. The
    value of samples that are too bright is unknown.
    """
    samples = image.samples
    kinds = _kinds(image, codes)
    valid = image.valid & ~kinds.missing
    plain = valid & ~kinds.low & ~kinds.high
    if not plain.any():
        raise ImageError(f"{image.path}: has no valid pixel")
    low, high = plateau_ends(samples, plain)
    bright = kinds.high if high is None else kinds.high | (plain & (samples == high))
    if on_map and low is not None and not image.states_nodata:
        valid &= ~touching_edge(plain & (samples == low))  # the margin of the map around the image
    something = samples[plain & valid]
    if something.min() == something.max():
        raise ImageError(f"{image.path}: is blank: all its valid pixels are equal")
    with np.errstate(over="ignore", invalid="ignore"):  # special float codes are the largest floats
        signal = _signal(image, encoding)
    signal[kinds.low & valid] = signal[plain & valid].min()
    signal[~valid | bright] = np.nan
    weight = (valid & ~bright).astype(np.float32)
    return _Pixels(signal, weight, float((bright & valid).mean()), float((~valid).mean()))


def _signal(image: ImagePixels, encoding: str) -> Float32:
    """Samples proportional to radiance; ImageError for floats with a display encoding."""
    samples = image.samples
    if encoding == "linear" or image.is_decoded:
        signal = np.multiply(samples, image.scale, dtype=np.float32, casting="same_kind")
        return np.asarray(signal + np.float32(image.offset))
    if samples.dtype.kind not in "ui":
        raise ImageError(
            f"{image.path}: has {samples.dtype} samples, which are not display codes: give `encoding` linear"
        )
    return decode_srgb(samples / float(np.iinfo(samples.dtype).max)).astype(np.float32)


def _kinds(image: ImagePixels, codes: Codes) -> SpecialPixels:
    """Samples that are not brightness: by the label, and by ISIS codes in cubes and in float images
    of any origin, where no other format uses these codes.
    """
    samples = image.samples
    found = codes.among(samples)
    floats = samples.dtype.name in ("float32", "float64")
    return found | isis_special(samples) if floats or image.isis is not None else found


# -- the Sun


def _sun(
    path: Path, sensor: Sensor, sun: SunChoice, label: ImageLabel, options: ImageOptions
) -> tuple[Array | None, Array | None]:
    """Position or direction of the Sun: given, of the sensor, or of the label, in this order; a
    warning where they differ.
    """
    own = ImageLabel("camera", sensor.sun_position_mcmf_m, time_utc=sensor.time_utc)
    stated = _stated(path, sensor, sun, options)
    suns = [
        (name, direction)
        for name, direction in (
            ("the given Sun", stated),
            ("the Sun of the camera", own.direction()),
            ("the Sun of the label", label.direction()),
        )
        if direction is not None
    ]
    if not suns:
        raise ImageError(f"{path}: the Sun is unknown: give `sun`, or a camera whose file has one")
    _warn(path, suns)
    if stated is not None:
        return None, stated
    best = own if own.direction() is not None else label
    if best.sun_position_mcmf_m is not None:
        return best.sun_position_mcmf_m, None
    return None, best.direction()


def _stated(path: Path, sensor: Sensor, sun: SunChoice, options: ImageOptions) -> Array | None:
    """The given direction; None if none is given."""
    if sun == SunChoice():
        return None
    by_angles = sun.azimuth_deg is not None and sun.elevation_deg is not None
    lon, lat = (options.center_deg or center_of(sensor, path)) if by_angles else (0.0, 0.0)
    return sun.direction_mcmf(EnuFrame(lon, lat), None)


def _warn(path: Path, suns: list[tuple[str, Array]]) -> None:
    name, direction = suns[0]
    for other, its in suns[1:]:
        apart = math.degrees(
            math.atan2(np.linalg.norm(np.cross(direction, its)), float(direction @ its))
        )
        if apart > SUNS_DIFFER_DEG:
            log.warning("%s: %s is %.1f deg from %s; the first is used", path, name, apart, other)
