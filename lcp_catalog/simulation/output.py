"""A simulated frame: the public function that takes it, and its files (PNG or GeoTIFF, and its camera with
the Sun).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .._version import __version__
from ..accuracy import accuracy as accuracy_of
from ..atomic_files import ending_of, write_files
from ..cameras.frame_camera import Camera
from ..cameras.isd import AnySensor, isd_with_sun
from ..cameras.public import rendered_sensor
from ..catalog.catalogue import Catalog
from ..constants import FRAME
from ..dem.mosaic import DemSet
from ..dem.public import Dems, dem_set
from ..errors import ConfigError, not_a
from ..light.environment import Environment
from ..light.sun_choice import SunChoice, SunStated
from ..photometry.albedo_map import AlbedoMap, open_grey_map
from ..photometry.law_choice import law_of
from ..photometry.laws import Reflectance
from ..production.error_config import ErrorConfig
from ..rendering.public import geotiff, png
from ..rendering.request import Request, ViewChoice
from .detector import Detector
from .frame import DemSurface, SimulatedFrame, Surface, frame
from .patch_surface import PatchSurface, is_catalog


def encode_frame(frame: SimulatedFrame, path: Path | str) -> bytes:
    """The frame as a file, by the ending of its name: PNG with the numbers in 8 or 16 bits (of
    which ``bits`` are used), or GeoTIFF with the radiance factor by the numbers, float32, NaN where
    the terrain is unknown. ConfigError for another ending.
    """
    if ending_of(path, (".png", ".tif")) == ".png":
        return png(frame.numbers)
    tags = {name: json.dumps(value) for name, value in describe(frame).items()}
    said = {"body": "MOON", "frame": FRAME, "software": f"lcp {__version__}", **tags}
    return geotiff({"radiance": frame.signal}, "float32", said, units=["1"])


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


def simulate(
    source: Dems | Catalog,
    camera: AnySensor | Path | str,
    sun: SunStated = None,
    output: Path | str | None = None,
    *,
    seed: int | None = None,
    disc: bool | None = None,
    environment: Environment | Path | str | None = None,
    bounce: str = "off",
    detector: Detector | None = None,
    samples: int | None = None,
    gsd_m: float | None = None,
    reflectance: Reflectance | str = "auto",
    albedo: AlbedoMap | Path | str | None = None,
    accuracy: str | None = None,
    tolerance: float | None = None,
    product_order: Sequence[str] = (),
    overwrite: bool = False,
) -> SimulatedFrame:
    """Simulate the frame that a camera takes of a DEM, or of a catalogue's patches.

    Parameters
    ----------
    source:
        DEM files or an opened set, or a catalogue or its file.
    camera:
        Camera, or its file.
    sun:
        The Sun: its azimuth, degrees clockwise from north, and elevation at the middle of what is seen; or an instant (ISO
        text, UTC); or a `SunChoice`. None: the Sun of the camera's file.
    output:
        Also write the frame (.png: the detector's numbers; .tif: radiance factor) and, beside it,
        its camera as ``NAME_camera.json``.
    seed:
        In place of a detector: one of 8 bits with the noise that builds take images to have
        (`errors.sensor_noise`), from this seed.
    disc:
        True for the solar disc, False for a point; None: as the accuracy says.
    environment:
        In place of the Sun: an environment map (equirectangular panorama).
    bounce:
        Light that reaches ground by way of other ground: one of `choices.BOUNCES`; DEMs only.
    detector:
        Blur, noise, exposure, bits and seed; None: a sharp detector of 8 bits without noise.
    samples:
        Rays along a pixel's side; None: one per cell, 2 to 4.
    gsd_m:
        Cell size; None: the DEM's own. DEMs only.
    reflectance:
        Reflectance law, or its name (`choices.REFLECTANCE_MODELS`, or ``auto``).
    albedo:
        Albedo map, or its file. DEMs only.
    accuracy, tolerance:
        Tier (`accuracy.TIERS`; None: ``reference``), or instead the largest error of a node's sunlit
        share.
    product_order:
        Order of precedence where DEMs overlap.
    overwrite:
        True: replace existing outputs.

    Returns
    -------
    SimulatedFrame
        ``radiance`` (rows, cols), I/F before noise, NaN where the terrain is unknown; ``numbers``
        (rows, cols), uint8 or uint16; ``camera`` with the Sun's position; `SimulatedFrame.image`.

    Raises
    ------
    ConfigError
        For options of DEMs with a catalogue, for a seed beside a detector, and for ``sun`` or ``disc`` beside
        ``environment``.
    CameraError
        If the camera sees nothing of the terrain.
    LcpError
        As `render`.

    Examples
    --------
    >>> taken = lcp.simulate(
    ...     folder / "hadley_gld100_256ppd.tif", small_camera,
    ...     sun=(96.5, 14), accuracy="draft",
    ...     detector=lcp.Detector(noise=0.02, seed=1),
    ... )
    >>> taken.numbers.shape == small_camera.shape, taken.numbers.dtype
    (True, dtype('uint8'))
    """
    if seed is not None and detector is not None:
        raise ConfigError("`seed` and `detector` exclude each other: a Detector has its own seed")
    if seed is not None:
        if not hasattr(seed, "__index__"):
            raise not_a(seed, "seed", "a whole number")
        detector = Detector(noise=ErrorConfig().sensor_noise, seed=seed)
    detector = detector or Detector()
    seen = rendered_sensor(camera)
    sun = SunChoice.of(sun).beside(environment, disc)
    tier = accuracy_of(accuracy or ("reference" if tolerance is None else None), tolerance)
    light = Environment.opened(environment)
    surface: Surface
    of_catalog = lone_catalog(source, gsd_m, albedo, bounce == "on", product_order)
    if of_catalog is not None:
        surface = PatchSurface.lit(
            of_catalog, sun, seen, light, model=law_of(reflectance), accuracy=tier, disc=disc
        )
    elif not isinstance(source, Catalog):
        request = Request(
            dems=dem_set(source, product_order),
            gsd_m=gsd_m,
            sun=sun,
            view=ViewChoice(seen),
            albedo=open_grey_map(albedo) if isinstance(albedo, Path | str) else albedo,
            bounce=bounce,
            model=law_of(reflectance),
            accuracy=tier,
            disc=disc,
            environment=light,
        )
        surface = DemSurface.seen(request, detector.margin_px)
    taken = frame(surface, seen, detector, samples)
    if output is not None:
        path = camera if isinstance(camera, Path | str) else None
        frames = {Path(output): encode_frame(taken, output)}
        write_files(frames | {camera_path(output): encode_camera(taken, path)}, overwrite)
    return taken


def lone_catalog(source: Dems | Catalog, *of_dems: object) -> Catalog | Path | str | None:
    """The catalogue that is a source of frames; None for DEMs. ConfigError for a catalogue beside other files, or
    with a value of ``of_dems``: options that only DEMs have.
    """
    files = [source] if isinstance(source, Catalog | DemSet | Path | str) else list(source)
    first = files[0] if files else None
    if not (isinstance(first, Catalog) or (isinstance(first, Path | str) and is_catalog(first))):
        return None
    if len(files) > 1 or any(of_dems):
        name = first if isinstance(first, Path | str) else "the source"
        raise ConfigError(
            f"{name} is a catalogue: give it alone, without `gsd_m`, `albedo`, `bounce` and `product_order`"
        )
    return first
