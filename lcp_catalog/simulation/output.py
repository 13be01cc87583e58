"""A simulated frame as files: PNG or GeoTIFF, and its camera with the Sun."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .._version import __version__
from ..cameras.frame_camera import Camera
from ..cameras.isd import isd_with_sun
from ..choices import PNG, TIFF
from ..constants import FRAME
from ..errors import OutputError
from ..rendering.output import geotiff, png
from .frame import SimulatedFrame


def encode_frame(frame: SimulatedFrame, path: Path | str) -> bytes:
    """The frame as a file, by the ending of its name: PNG with the numbers in 8 or 16 bits (of
    which ``bits`` are used), or GeoTIFF with the radiance factor by the numbers, float32, NaN where
    the terrain is unknown. OutputError for another ending.
    """
    ending = Path(path).suffix.lower()
    if ending in PNG:
        return png(frame.numbers)
    if ending in TIFF:
        tags = {name: json.dumps(value) for name, value in describe(frame).items()}
        said = {"body": "MOON", "frame": FRAME, "software": f"lcp {__version__}", **tags}
        return geotiff({"radiance": frame.signal}, "float32", said, units=["1"])
    raise OutputError(f"{path}: a frame is written as .png or .tif; name the output so")


def camera_path(path: Path | str) -> Path:
    """Path of the camera file of a frame: FRAME.png -> FRAME_camera.json."""
    return Path(path).with_name(f"{Path(path).stem}_camera.json")


def encode_camera(frame: SimulatedFrame, path: Path | str | None = None) -> bytes:
    """CAMERA.json of a frame, or of a scanner the ISD from which it was read (``path``), with the
    Sun's position, and with the settings of the simulation under ``simulated``.
    """
    if isinstance(frame.camera, Camera):
        document = frame.camera.to_json()
    else:
        assert path is not None
        document = isd_with_sun(json.loads(Path(path).read_text(encoding="utf-8")), frame.camera)
    return (json.dumps(document | {"simulated": describe(frame)}, indent=1) + "\n").encode()


def describe(frame: SimulatedFrame) -> dict[str, Any]:
    """The detector with its exposure, and the names of the source files, without folders."""
    detector = asdict(frame.detector) | {"full_scale": frame.full_scale}
    names = sorted({path.name for path in frame.sources})
    return {"detector": detector, "rays_per_pixel": frame.samples**2, "sources": names}
