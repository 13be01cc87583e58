"""Apollo 15 Metric frames for the search: their cameras, catalogues of their terrain built by the
command from the DEM alone, and images that do not show what their camera says.

The cameras' positions and Suns are those of NASA's tables; attitude, focal length and principal
point were fitted to renders of GLD100 with the position fixed (PROVENANCE.txt beside the files):
the reference is no more accurate than that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from lcp_cli.main import run

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import pixel_size_m
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.images.image import Image
from lcp_catalog.images.image_file import open_image
from lcp_catalog.matching.fix import Fix
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.pose import position_error
from lcp_catalog.matching.sun_check import with_sun
from lcp_catalog.photometry.laws import reflectance_model

from .small_world import mirrored

DEM_PIXEL_M = 474.0
OFF_M, OFF_RAD = 5000.0, np.radians(0.5)
LAW = reflectance_model("lunar-lambert")

SWEEP = """
[area]
gsd_m = 474.0
[sun]
azimuths_deg = [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]
elevations_deg = [{elevations}]
[view]
off_nadir_deg = [0.0]
azimuth_deg = [0.0]
altitude_km = [inf]
[points]
patch_nodes = 33
{spacing}
[model]
albedo = "none"
direction_tolerance_deg = 1.0
"""
"""Patches of 15.6 km; Suns every 45 deg, one view: a coarse sweep, for its speed."""

BUILD = SWEEP.format(elevations="10.0, 20.0, 35.0", spacing="spacing_m = 8000.0")


@dataclass(frozen=True)
class Ground:
    """A folder of frames and the DEM of their terrain."""

    folder: str
    dem: str
    suffix: str  # of image files
    bounds_deg: tuple[float, float, float, float]


HADLEY = Ground(
    "apollo15-metric-hadley", "gld100_256ppd_lat20-30_lon000-010.tif", "", (0.1, 20.1, 9.9, 29.9)
)
FAR_SIDE = Ground(
    "apollo15-metric-farside",
    "gld100_064ppd_lat-28_-13_lon132-155.tif",
    "_SML",
    (136.5, -25.5, 151.5, -15.5),
)
FRAMES = {
    "AS15-M-0414": HADLEY,
    "AS15-M-1134": HADLEY,
    "AS15-M-0295": FAR_SIDE,
    "AS15-M-0299": FAR_SIDE,
    "AS15-M-0300": FAR_SIDE,
}


def built(data: Path, ground: Ground, folder: Path, bounds: tuple[float, ...] = ()) -> Catalog:
    """The catalogue of a terrain, built by the command unless it is in the folder already."""
    path = folder / f"{ground.folder}.h5"
    if not path.exists():
        config = folder / "build.toml"
        config.write_text(BUILD)
        dem = data / "images" / ground.folder / ground.dem
        area = [str(v) for v in bounds or ground.bounds_deg]
        options = ["-o", str(path), "--config", str(config), "--bounds", *area, "--jobs", "1"]
        assert run(["build-catalog", str(dem), *options]) == 0
    return open_catalog(path)


def frame(data: Path, key: str) -> Image:
    """A frame with its given camera and Sun."""
    ground = FRAMES[key]
    folder = data / "images" / ground.folder
    camera = read_camera(folder / f"{key}_camera.json")
    return open_image(folder / f"{key}{ground.suffix}.png", camera)


def displaced(photo: Image, seed: int) -> Image:
    """The frame with a camera 5 km and 0.5 deg from its own, in random directions."""
    dice = np.random.default_rng(seed)
    shift, turn = dice.normal(size=(2, 3))
    correction = [
        *(OFF_M * shift / np.linalg.norm(shift)),
        *(OFF_RAD * turn / np.linalg.norm(turn)),
    ]
    return photo.with_sensor(photo.sensor.moved(correction))


def transplanted(photo: Image, other: Image) -> Image:
    """An image with the position and the Sun of another, whose camera is scaled to the image's
    size.
    """
    camera = other.sensor
    assert isinstance(camera, Camera)
    rows, cols = photo.signal.shape
    factor = cols / camera.shape[1]
    cx, cy = camera.principal_point_px
    scaled = replace(
        camera,
        focal_length_px=camera.focal_length_px * factor,
        principal_point_px=((cx + 0.5) * factor - 0.5, (cy + 0.5) * factor - 0.5),
        image_size_px=(cols, rows),
    )
    return replace(
        photo, sensor=scaled, sun_position_mcmf_m=other.sun_position_mcmf_m, sun_direction_mcmf=None
    )


def spoilt(photo: Image, catalog: Catalog) -> Iterator[tuple[str, Image]]:
    """The frame with its own camera, changed so that it does not show its place."""
    ground = catalog.position_mcmf[points_in_view(catalog, photo.sensor)]
    for turn, up in ((20, 0), (-20, 0), (0, 20), (0, -10), (10, 0), (-10, 0)):
        yield f"Sun {turn:+d} deg azimuth, {up:+d} deg elevation", with_sun(photo, ground, turn, up)
    for side in ("left-right", "up-down"):
        yield f"mirrored {side}", mirrored(photo, side)
    for turn in ("90", "180", "270"):
        yield f"turned by {turn} deg", mirrored(photo, turn)
    dice = np.random.default_rng(0)
    shape = photo.signal.shape
    yield "blank", replace(photo, signal=np.full(shape, 80.0, dtype=np.float32))
    grain = dice.normal(100.0, 20.0, shape).astype(np.float32)
    yield "white noise", replace(photo, signal=grain)
    wave = np.hypot(
        *np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1]), indexing="ij")
    )
    spectrum = np.fft.rfft2(dice.normal(size=shape)) / np.maximum(wave, 0.005)
    yield (
        "noise like ground",
        replace(photo, signal=np.fft.irfft2(spectrum, s=shape).astype(np.float32)),
    )
    level = np.nanmedian(photo.signal)
    bright = photo.signal >= level
    cut = replace(photo, signal=np.minimum(photo.signal, level))
    yield "half saturated, not marked", cut
    yield (
        "half saturated, marked",
        replace(cut, weight=np.where(bright, 0.0, photo.weight).astype(np.float32)),
    )


def worst_off_m(answer: Fix, catalog: Catalog, known: Camera) -> float:
    """Distance, on the surface across the line of sight, of the worst accepted match from the known
    camera's projection.
    """
    rows = answer.matches.point[answer.matches.found]
    ground = catalog.position_mcmf[rows]
    off = answer.matches.found_px[answer.matches.found] - known.project(ground)
    return float((np.hypot(*off.T) * pixel_size_m(known, ground)).max())


def is_wrong(answer: Fix, catalog: Catalog, known: Camera) -> bool:
    """True if a pose is given that is outside its own 3 sigma (0.27 % in three dimensions: 14.2),
    or moves the frame's middle by more than 3 pixels.
    """
    if answer.pose is None:
        return False
    middle = catalog.position_mcmf[points_in_view(catalog, known)].mean(axis=0)
    off = np.linalg.norm(answer.pose.sensor.project(middle) - known.project(middle))
    return position_error(answer.pose, known).squared > 14.2 or off > 3.0
