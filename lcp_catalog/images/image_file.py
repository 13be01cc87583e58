"""An image file as a `Image`: what is signal, what each pixel is worth, what took it, and where its Sun stood."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Float32
from ..cameras.map_projected import MapImage
from ..cameras.sensor import Sensor
from ..choices import ENCODINGS
from ..errors import ImageError
from ..geometry.frames import EnuFrame
from ..geometry.sphere_intersection import hits, lonlat
from ..light.sun_choice import SunChoice
from ..photometry.srgb import decode_srgb
from .image import Image
from .pixels import ImagePixels, read_pixels
from .special_pixels import Codes, Kinds, ends, isis_special, touching_edge
from .sun_from_label import ImageLabel, read_image_label

log = logging.getLogger(__name__)

SUNS_DIFFER_DEG = 1.0
"""Two statements of an image's Sun that differ by more are worth a warning."""


@dataclass(frozen=True)
class ImageOptions:
    """What a file does not say by itself: the band (None: luminance of colours, else the first), a value for "nothing here", the
    place (longitude, latitude, degrees) that a Sun given by angles is meant for (None: the image's middle), from where a
    map-projected image was seen, and whether integer samples are ``linear`` in radiance or codes of a display picture (``srgb``).
    """

    band: int | None = None
    nodata: float | None = None
    center_deg: tuple[float, float] | None = None
    off_nadir_deg: float = 0.0
    view_azimuth_deg: float = 0.0
    encoding: str = ENCODINGS[0]

    def __post_init__(self) -> None:
        if self.encoding not in ENCODINGS:
            raise ImageError(f"no encoding {self.encoding!r}; there are {', '.join(ENCODINGS)}")


@dataclass(frozen=True, eq=False)
class _Pixels:
    signal: Float32
    weight: Float32
    saturated_share: float
    missing_share: float


def open_image(
    path: Path | str,
    sensor: Sensor | None = None,
    sun: SunChoice | None = None,
    options: ImageOptions | None = None,
) -> Image:
    """The image in a file, with the sensor that took it; None: the map that the file says it was projected on.

    The Sun is the one that is stated (``sun``), else the sensor's own, else the one of the image's label.
    ImageError, one line, for what is no image, has no geometry, no Sun, another size than its camera's, or nothing in it;
    SunError for a Sun that is stated and cannot be.
    """
    options = options or ImageOptions()
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


def _sensor(image: ImagePixels, sensor: Sensor | None, options: ImageOptions) -> Sensor:
    rows, cols = image.samples.shape
    if sensor is None:
        if image.crs_wkt is None:
            raise ImageError(f"{image.path}: missing geometry: it has no map; give --camera")
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
            f"{image.path}: has {cols} x {rows} pixels, its camera {sensor.name} has {of_camera}; "
            "give the camera of this very image"
        )
    if image.crs_wkt is not None:
        log.warning(
            "%s: is on a map, which is left aside: its camera says what it sees", image.path
        )
    return sensor


# -- pixels


def _pixels(image: ImagePixels, codes: Codes, on_map: bool, encoding: str) -> _Pixels:
    """Signal and weights; ImageError for an image without anything in it.

    What is too dark for the file gets the darkest value that it could say, and counts like any other: it is known to be dark, as a
    render's shadow is. To weigh it less loses points (docs/images-in.md). What is too bright could be anything.
    """
    samples = image.samples
    kinds = _kinds(image, codes)
    valid = image.valid & ~kinds.missing
    plain = valid & ~kinds.low & ~kinds.high
    if not plain.any():
        raise ImageError(f"{image.path}: has no valid pixel")
    low, high = ends(samples, plain)
    bright = kinds.high if high is None else kinds.high | (plain & (samples == high))
    if on_map and low is not None and not image.states_nodata:
        valid &= ~touching_edge(plain & (samples == low))  # where the image ends before its map
    _require_something(image, samples[plain & valid])
    with np.errstate(over="ignore", invalid="ignore"):  # special floats are the largest there are
        signal = _signal(image, encoding)
    signal[kinds.low & valid] = signal[plain & valid].min()
    signal[~valid | bright] = np.nan
    weight = (valid & ~bright).astype(np.float32)
    return _Pixels(signal, weight, float((bright & valid).mean()), float((~valid).mean()))


def _signal(image: ImagePixels, encoding: str) -> Float32:
    """Samples as radiance up to a factor; ImageError for floats that are said to be codes of a display."""
    samples = image.samples
    if encoding == "linear" or image.is_decoded:
        signal = np.multiply(samples, image.scale, dtype=np.float32, casting="same_kind")
        return np.asarray(signal + np.float32(image.offset))
    if samples.dtype.kind not in "ui":
        raise ImageError(
            f"{image.path}: holds {samples.dtype}, no codes of a display: --encoding linear"
        )
    return decode_srgb(samples / float(np.iinfo(samples.dtype).max)).astype(np.float32)


def _kinds(image: ImagePixels, codes: Codes) -> Kinds:
    """What is no brightness: by ISIS's codes in cubes, and in floats of anybody, where nothing else has them; by the label."""
    samples = image.samples
    found = codes.among(samples)
    floats = samples.dtype.name in ("float32", "float64")
    return found | isis_special(samples) if floats or image.isis is not None else found


def _require_something(image: ImagePixels, values: NDArray[np.generic]) -> None:
    if values.min() == values.max():
        raise ImageError(f"{image.path}: is blank: all its valid pixels are the same")


# -- the Sun


def _sun(
    path: Path, sensor: Sensor, sun: SunChoice, label: ImageLabel, options: ImageOptions
) -> tuple[Array | None, Array | None]:
    """Position or direction of the Sun: by what was stated, the sensor, the label; a warning where they differ."""
    own = _of_sensor(sensor)
    stated = _stated(path, sensor, sun, options)
    claims = [
        (name, direction)
        for name, direction in (
            ("the Sun as given", stated),
            ("the Sun of its camera", own.direction()),
            ("the Sun of its label", label.direction()),
        )
        if direction is not None
    ]
    if not claims:
        raise ImageError(
            f"{path}: where the Sun stood is not known: give --time, --subsolar, or "
            "--sun-azimuth and --sun-elevation"
        )
    _warn(path, claims)
    if stated is not None:
        return None, stated
    best = own if own.direction() is not None else label
    if best.sun_position_mcmf_m is not None:
        return best.sun_position_mcmf_m, None
    return None, best.direction()


def _of_sensor(sensor: Sensor) -> ImageLabel:
    return ImageLabel("camera", sensor.sun_position_mcmf_m, time_utc=sensor.time_utc)


def _stated(path: Path, sensor: Sensor, sun: SunChoice, options: ImageOptions) -> Array | None:
    """The direction that flags state; None when they state none."""
    if sun == SunChoice():
        return None
    by_angles = sun.azimuth_deg is not None and sun.elevation_deg is not None
    center = (options.center_deg or center_of(sensor, path)) if by_angles else (0.0, 0.0)
    return sun.direction_mcmf(EnuFrame(*center), None)


def center_of(sensor: Sensor, path: Path | str = "") -> tuple[float, float]:
    """Longitude and latitude, degrees, of what an image's middle shows of the sphere; ImageError where that is sky."""
    rows, cols = sensor.shape
    origin, direction = sensor.looks(np.array([(cols - 1) / 2.0, (rows - 1) / 2.0]))
    known = bool(np.isfinite(origin).all() and np.isfinite(direction).all())
    lon, lat = lonlat(hits(origin, direction)[1]) if known else (np.nan, np.nan)
    if not math.isfinite(float(lat)):
        raise ImageError(
            f"{path or sensor.name}: its middle does not show the Moon, so that angles of the Sun "
            "have no place: give --time or --subsolar"
        )
    return float(lon), float(lat)


def _warn(path: Path, claims: list[tuple[str, Array]]) -> None:
    name, direction = claims[0]
    for other, its in claims[1:]:
        apart = math.degrees(
            math.atan2(np.linalg.norm(np.cross(direction, its)), float(direction @ its))
        )
        if apart > SUNS_DIFFER_DEG:
            log.warning(
                "%s: %s stands %.1f deg from %s; the first counts", path, name, apart, other
            )
