"""A simulated frame: the public function that takes it, and its files (PNG or GeoTIFF, and its camera with
the Sun).

Simulated frames: rendered with the exact surface, averaged over pixels, passed through a
detector.

A pixel is N x N rays, evenly spaced over its area and weighted with the detector's response; the
render extends beyond the frame by the reach of the blur. A ray that meets no terrain gives black
sky if it misses the reference sphere as well; else its radiance is unknown (NaN), because the
source holds no terrain there.

A scanner's ray has the time of its part of the line, so that the camera's motion during the exposure
is in the image. The framelets of a push-frame camera are frames of their own: blur does not mix them.

The patches of a catalogue as terrain for frames: islands with nothing between them.

Each patch is rendered in its own frame from its own nodes alone, as a navigator does: terrain
around it, which the catalogue does not hold, neither shadows nor hides it. Where patches overlap,
the surface nearest to the camera is seen.

Detector model: blur, exposure, noise, quantisation, saturation.

A pixel's signal is the radiance factor weighted with the pixel's response: its own square,
convolved with a Gaussian of ``blur_px`` (standard deviation). Noise has two parts; ``noise`` is the
standard deviation of both together at the mean lit signal m, as a share of it: photon noise, whose
variance grows with the signal S, and read noise, whose variance does not:

    variance(S) = (noise m)^2 (shot_share S / m + 1 - shot_share)

Photon counts follow a Poisson distribution, with 1 / (noise^2 shot_share) photons at the mean. A
pixel's number is round((2^bits - 1) S / full_scale), limited to 0..2^bits - 1.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .._version import __version__
from ..accuracy import TIERS, Accuracy
from ..accuracy import accuracy as accuracy_of
from ..arrays import Array, Float32, Mask
from ..atomic_files import write_files
from ..cameras.frame_camera import Camera
from ..cameras.isd import AnySensor, isd_with_sun
from ..cameras.public import rendered_sensor
from ..cameras.scanners import Scanner
from ..cameras.sensor import Sensor
from ..cameras.view import finest_pixel_m, sensor_view
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..catalog.patch_terrain import patch_terrain
from ..choices import PNG, TIFF
from ..constants import ASTRONOMICAL_UNIT_M, FRAME
from ..dem.mosaic import DemSet
from ..dem.public import Dems, dem_set
from ..ephemeris import solar_position
from ..errors import CameraError, ConfigError, OutputError
from ..geometry.frames import EnuFrame, ranges
from ..images.image import Image
from ..light.environment import Environment
from ..light.solar_disc import SolarDisc, radius_at
from ..light.sources import Lighting
from ..light.sun_choice import SunChoice, SunStated
from ..photometry.albedo_map import AlbedoMap, open_grey_map
from ..photometry.laws import DEFAULT_MODEL, Reflectance, law_of
from ..rendering.pipeline import HeightfieldScene, prepare_terrain
from ..rendering.plan import plan_scene
from ..rendering.public import geotiff, png
from ..rendering.renderer import Method, render_camera
from ..rendering.request import Request, ViewAngles, ViewChoice
from ..terrain.heightfield import Heightfield
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain

Numbers = NDArray[np.uint8] | NDArray[np.uint16]

BITS_MAX = 16
BLUR_MAX_PX = 16.0
REACH = 4.0
"""Sigmas at which the Gaussian is cut off; the 6e-5 beyond are spread over the rest."""

_SHARP_PX = 1e-6
"""A blur below this counts as 0: it moves less than that share of a pixel's light."""

BRIGHT_PERCENTILE, BRIGHT_SHARE = 99.5, 0.8
"""Default exposure: this percentile of the lit signal falls at this share of full scale."""

_LIT_SHARE = 0.02
"""Share of the bright signal (`BRIGHT_PERCENTILE`) from which a pixel is lit. Shadows have less: by way of
other ground up to 1 % on the crater of docs/explanation/lighting.md.
"""


@dataclass(frozen=True)
class Detector:
    """A detector; ConfigError for invalid values. ``full_scale``: radiance factor of the highest
    number; None: from the signal (`BRIGHT_PERCENTILE`). Equal seeds give equal noise.

    Examples
    --------
    >>> detector = lcp.Detector(noise=0.02, bits=12)
    >>> detector.highest
    4095
    """

    blur_px: float = 0.0
    noise: float = 0.0
    shot_share: float = 0.5
    full_scale: float | None = None
    bits: int = 8
    seed: int = 0

    def __post_init__(self) -> None:
        _require(0.0 <= self.blur_px <= BLUR_MAX_PX, f"blur must be 0..{BLUR_MAX_PX:g} pixels")
        _require(0.0 <= self.noise <= 10.0, "noise must be 0..10 times the mean lit signal")
        _require(0.0 <= self.shot_share <= 1.0, "the share of photon noise must be 0..1")
        scale = self.full_scale
        _require(scale is None or 0.0 < scale < math.inf, "exposure must be positive")
        _require(1 <= self.bits <= BITS_MAX, f"bits must be 1..{BITS_MAX}")
        _require(self.seed >= 0, "seed must not be negative")

    @property
    def highest(self) -> int:
        """The number at saturation."""
        return (1 << self.bits) - 1

    @property
    def margin_px(self) -> int:
        """Distance in pixels from which light outside an image is blurred into it."""
        return math.ceil(REACH * self.blur_px)

    def scale_of(self, signal: Array) -> float:
        """Radiance factor of full scale; 1 if none is stated and nothing is lit."""
        if self.full_scale is not None:
            return self.full_scale
        lit = lit_signal(signal)
        return float(np.percentile(lit, BRIGHT_PERCENTILE)) / BRIGHT_SHARE if lit.size else 1.0

    def noisy(self, signal: Array) -> Array:
        """A non-negative signal (rows, cols) with noise."""
        lit = lit_signal(signal)
        if self.noise == 0.0 or not lit.size:
            return signal
        mean, dice = float(lit.mean()), np.random.default_rng(self.seed)
        light: NDArray[np.floating] = signal
        if self.shot_share > 0.0:
            photons = 1.0 / (self.noise**2 * self.shot_share)
            light = dice.poisson(signal * (photons / mean)) * (mean / photons)
        read = self.noise * mean * math.sqrt(1.0 - self.shot_share)
        return np.asarray(light + read * dice.standard_normal(signal.shape))

    def numbers(self, signal: Array, full_scale: float) -> Numbers:
        """Numbers read out for a signal (rows, cols), uint8 up to 8 bits, else uint16; 0 for NaN."""
        known = np.isfinite(signal)
        scaled = self.noisy(np.where(known, signal, 0.0)) * (self.highest / full_scale)
        read = np.where(known, np.clip(np.rint(scaled), 0, self.highest), 0)
        return read.astype(np.uint8) if self.bits <= 8 else read.astype(np.uint16)


def lit_signal(signal: Array) -> Array:
    """Values of the lit pixels of a signal (rows, cols), (n,)."""
    some = signal[signal > 0.0]
    return some[some > _LIT_SHARE * np.percentile(some, BRIGHT_PERCENTILE)] if some.size else some


def response(blur_px: float, samples: int) -> Array:
    """Weights of the sub-pixels along one axis in a pixel's signal: ``samples`` in each of 2 m + 1
    pixels, m = ceil(4 blur_px), the pixel itself in the middle; their sum is 1.

    A weight is the integral over a sub-pixel of the square convolved with the Gaussian, in closed
    form.
    """
    margin = math.ceil(REACH * blur_px)
    edges = (np.arange(samples * (2 * margin + 1) + 1) / samples) - margin - 0.5
    rise = [_ramp(float(edge) + 0.5, blur_px) - _ramp(float(edge) - 0.5, blur_px) for edge in edges]
    weights = np.maximum(np.diff(rise), 0.0)
    return np.asarray(weights / weights.sum())


def _ramp(x: float, sigma: float) -> float:
    """Integral up to x of the Gaussian's cumulative distribution, or of a step if it is sharp."""
    if sigma < _SHARP_PX:
        return max(x, 0.0)
    t = x / sigma
    density = math.exp(-0.5 * t * t) / math.sqrt(2.0 * math.pi)
    return sigma * (t * 0.5 * math.erfc(-t / math.sqrt(2.0)) + density)


def gathered(fine: NDArray[np.floating], weights: Array, samples: int) -> Array:
    """Pixels (rows, cols) from sub-pixels (samples (rows + 2 m), samples (cols + 2 m)) by
    `response`. NaN is unknown and does not count; a pixel is NaN if less than half of its response
    is known.
    """
    known = np.isfinite(fine)
    light = _along(_along(np.where(known, fine, 0.0), weights, samples).T, weights, samples).T
    if known.all():
        return light
    share = _along(_along(known.astype(np.float64), weights, samples).T, weights, samples).T
    enough = share >= 0.5
    return np.where(enough, light / np.where(enough, share, 1.0), np.nan)


def _along(values: NDArray[np.floating], weights: Array, samples: int) -> Array:
    """Weighted sums down the rows, one for each pixel."""
    count = (len(values) - len(weights)) // samples + 1
    out = np.zeros((count, values.shape[1]))
    for first, weight in enumerate(weights):
        out += weight * values[first : first + samples * (count - 1) + 1 : samples]
    return out


def _require(holds: bool, why: str) -> None:
    if not holds:
        raise ConfigError(f"detector: {why}")


Window = tuple[int, int, int, int]

_HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True, eq=False)
class PatchAlbedo:
    """The albedo factors of a patch, linear on the surface's triangles."""

    factors: Heightfield

    def at_nodes(self, terrain: Terrain) -> NDArray[np.float32]:
        """At the patch's nodes, (rows, cols)."""
        return self.factors.z_m

    def at_points(self, terrain: Terrain, points: Array) -> Array:
        """At ENU points (n, 3)."""
        return self.factors.heights_at(points[:, 0], points[:, 1])


@dataclass(frozen=True, eq=False)
class PatchTerrain:
    """The patch of one point as a terrain; its core is the whole patch."""

    terrain: Terrain
    albedo: PatchAlbedo | None

    @classmethod
    def of(cls, catalog: Catalog, row: int) -> PatchTerrain:
        """The patch of the point in a row of the catalogue."""
        terrain = patch_terrain(catalog, row)
        if catalog.albedo is None:
            return cls(terrain, None)
        return cls(terrain, PatchAlbedo(replace(terrain.field, z_m=catalog.albedo[row])))

    def window(self, camera: Camera | Scanner) -> Window | None:
        """Rows and columns of a camera's image in which the patch may be seen (half open: first
        row, row after the last, first column, column after the last); None if it is outside.
        """
        whole = self.terrain.core
        nodes = self.terrain.frame.to_mcmf(nodes_enu(self.terrain.field, whole)).reshape(-1, 3)
        pixels = camera.project(nodes)
        pixels = pixels[np.isfinite(pixels).all(axis=-1)]
        if not len(pixels):
            return None
        (col0, row0), (col1, row1) = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0)) + 1
        rows, cols = camera.shape
        row0, row1 = max(int(row0), 0), min(int(row1), rows)
        col0, col1 = max(int(col0), 0), min(int(col1), cols)
        return (row0, row1, col0, col1) if row0 < row1 and col0 < col1 else None


@dataclass(frozen=True, eq=False)
class PatchSurface:
    """A catalogue's patches under the Sun at a position, (3,) MCMF metres; ``model`` None:
    `DEFAULT_MODEL`; ``path``: the catalogue's file, if it was read from one; ``environment``: an environment map in place of
    the Sun, in each patch's own frame.
    """

    catalog: Catalog
    path: Path | None
    sun_position_mcmf_m: Array
    model: Reflectance | None = None
    accuracy: Accuracy = TIERS["reference"]
    disc: bool | None = None
    environment: Environment | None = None

    @classmethod
    def lit(
        cls,
        source: CatalogOrPath,
        choice: SunChoice,
        camera: Camera | Scanner,
        environment: Environment | None = None,
        model: Reflectance | None = None,
        accuracy: Accuracy = TIERS["reference"],
        disc: bool | None = None,
    ) -> PatchSurface:
        """A catalogue, or its file, under a chosen Sun, whose angles are those at the middle of the
        catalogue's map, or under an environment map.
        """
        catalog = opened_catalog(source)
        path = None if isinstance(source, Catalog) else Path(source)
        middle = EnuFrame(catalog.overview.center_lon, catalog.overview.center_lat)
        place = (
            sun_position(choice, middle, camera)
            if environment is None
            else source_position(environment, middle)
        )
        return cls(catalog, path, place, model, accuracy, disc, environment)

    @property
    def sources(self) -> tuple[Path, ...]:
        own = () if self.path is None else (self.path,)
        return (*own, *(self.environment.files if self.environment else ()))

    @cached_property
    def patches(self) -> list[PatchTerrain]:
        """All patches, in the catalogue's order."""
        return [PatchTerrain.of(self.catalog, row) for row in range(len(self.catalog))]

    def cells_per_pixel(self, camera: Camera | Scanner) -> float:
        if isinstance(camera, Scanner):
            return finest_pixel_m(camera) / float(np.median(self.catalog.gsd))
        away_m = np.linalg.norm(self.catalog.position_mcmf - camera.position_mcmf_m, axis=1)
        return float(np.median(away_m / camera.focal_length_px / self.catalog.gsd))

    def radiance(self, camera: Camera | Scanner) -> Array:
        out = np.full(camera.shape, np.nan)
        nearest_m = np.full(camera.shape, np.inf)
        for patch in self.patches:
            window = patch.window(camera)
            if window is None:
                continue
            row0, row1, col0, col1 = window
            part = np.s_[row0:row1, col0:col1]
            light, range_m = self._rendered(patch, windowed(camera, window))
            nearer = range_m < nearest_m[part]
            out[part][nearer], nearest_m[part][nearer] = light[nearer], range_m[nearer]
        return out

    def _rendered(self, patch: PatchTerrain, camera: Camera | Scanner) -> tuple[Array, Array]:
        """Radiance factor and range of one patch; NaN and inf where it is not seen."""
        terrain = patch.terrain
        light = self._light(terrain.frame)
        view = sensor_view(camera, terrain.frame)
        plan = plan_scene(
            terrain,
            light.first.direction.vector,
            view,
            in_camera_plane=True,
            accuracy=self.accuracy,
            disc=light.first.disc is not None,
            model=self._law,
        )
        shot = render_camera(
            terrain,
            camera,
            light,
            Method(model=self._law, accuracy=self.accuracy, plan=plan, albedo=patch.albedo),
        )
        assert shot.position_mcmf_m is not None
        origin, _ = camera.rays_enu(terrain.frame)
        from_m = origin if isinstance(camera, Camera) else origin[:, None]
        away_m = np.linalg.norm(terrain.frame.from_mcmf(shot.position_mcmf_m) - from_m, axis=-1)
        seen = np.isfinite(shot.radiance)
        return np.asarray(shot.radiance), np.where(seen, away_m, np.inf)

    def _light(self, frame: EnuFrame) -> Lighting:
        """The light in a patch's frame."""
        if self.environment is not None:
            return self.environment.lighting
        towards = self.sun_position_mcmf_m - frame.origin_mcmf_m
        away_m = float(np.linalg.norm(towards))
        disc = self.accuracy.disc if self.disc is None else self.disc
        sun = frame.direction_from_mcmf(towards / away_m)
        return Lighting.of_sun(sun, SolarDisc(radius_at(away_m)) if disc else False)

    @cached_property
    def _law(self) -> Reflectance:
        return DEFAULT_MODEL if self.model is None else self.model


def is_catalog(path: Path | str) -> bool:
    """True if a file begins as HDF5 does; False if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return file.read(len(_HDF5)) == _HDF5
    except OSError:
        return False


Taking = TypeVar("Taking", bound=Camera | Scanner)

SAMPLES_LEAST, SAMPLES_MOST = 2, 4
"""Default number of rays along a pixel's side: one per cell, within these limits."""

_RAYS_AT_ONCE = 1 << 19


class Surface(Protocol):
    """The surface that a frame shows, under its Sun."""

    @property
    def sources(self) -> tuple[Path, ...]:
        """The files from which it was read."""

    @property
    def sun_position_mcmf_m(self) -> Array:
        """Position of the Sun, (3,)."""

    def cells_per_pixel(self, camera: Camera | Scanner) -> float:
        """Width of a pixel in cells of the surface, about."""

    def radiance(self, camera: Camera | Scanner) -> Array:
        """Radiance factor at the pixel centres, (rows, cols); NaN where a ray meets no terrain."""


@dataclass(frozen=True, eq=False)
class DemSurface:
    """The terrain of a DEM, as far as a camera's view and the ring around it need it."""

    scene: HeightfieldScene
    sun_position_mcmf_m: Array

    @classmethod
    def seen(cls, request: Request, margin_px: int = 0) -> DemSurface:
        """The surface in the view of a request's camera and ``margin_px`` pixels around it, under
        the request's light. Raises the library's errors for a scene that cannot be rendered.
        """
        camera = request.view.plane
        if camera is None:
            raise CameraError("a frame needs a camera; the request has none")
        wide = ViewChoice(grown(camera, margin_px) if isinstance(camera, Camera) else ViewAngles())
        if isinstance(camera, Scanner):
            wide = ViewChoice(camera.around(margin_px))
        scene = prepare_terrain(
            replace(request, view=wide, in_camera_plane=True, surface="heightfield")
        )
        if request.environment is not None:
            return cls(scene, source_position(request.environment, scene.frame))
        return cls(scene, sun_position(request.sun, scene.frame, camera))

    @property
    def sources(self) -> tuple[Path, ...]:
        return self.scene.sources

    def cells_per_pixel(self, camera: Camera | Scanner) -> float:
        if isinstance(camera, Scanner):
            return finest_pixel_m(camera) / self.scene.gsd_m
        away_m = np.linalg.norm(camera.position_mcmf_m - self.scene.frame.origin_mcmf_m)
        return float(away_m) / camera.focal_length_px / self.scene.gsd_m

    def radiance(self, camera: Camera | Scanner) -> Array:
        return np.asarray(self.scene.picture(camera).radiance)


@dataclass(frozen=True, eq=False)
class SimulatedFrame:
    """One frame, (rows, cols): the radiance factor that each pixel gathers before noise (NaN:
    unknown), and the number read out; ``camera`` has the Sun's position.
    """

    radiance: Float32
    numbers: Numbers
    full_scale: float
    detector: Detector
    camera: Camera | Scanner
    samples: int
    sources: tuple[Path, ...]

    @property
    def signal(self) -> Float32:
        """Radiance factor by the numbers, NaN where the terrain is unknown."""
        step = self.full_scale / self.detector.highest
        known = np.isfinite(self.radiance)
        return np.where(known, step * self.numbers, np.nan).astype(np.float32)

    def image(self, camera: Sensor | None = None, name: str = "simulated") -> Image:
        """The frame as an image for the search, with ``camera`` as its sensor (None: its own)."""
        known = np.isfinite(self.radiance)
        full = known & (self.numbers >= self.detector.highest)
        return Image(
            name,
            self.signal,
            (known & ~full).astype(np.float32),
            self.camera if camera is None else camera,
            sun_position_mcmf_m=self.camera.sun_position_mcmf_m,
            saturated_share=float(full.mean()),
            missing_share=float(1.0 - known.mean()),
        )


def frame(
    surface: Surface, camera: Camera | Scanner, detector: Detector, samples: int | None = None
) -> SimulatedFrame:
    """The frame that a camera takes of a surface. CameraError if the camera sees nothing of it."""
    count = samples or samples_for(surface.cells_per_pixel(camera))
    signal = _gathered(surface, camera, detector, count)
    scale = detector.scale_of(signal)
    return SimulatedFrame(
        signal.astype(np.float32),
        detector.numbers(signal, scale),
        scale,
        detector,
        replace(camera, sun_position_mcmf_m=surface.sun_position_mcmf_m),
        count,
        surface.sources,
    )


def simulated_image(
    request: Request, detector: Detector, samples: int | None = None, name: str = "simulated"
) -> Image:
    """The image that a request's camera takes of its DEM."""
    surface = DemSurface.seen(request, detector.margin_px)
    assert request.view.plane is not None
    return frame(surface, request.view.plane, detector, samples).image(name=name)


def samples_for(cells_per_pixel: float) -> int:
    """Rays along a pixel's side."""
    return min(max(SAMPLES_LEAST, math.ceil(cells_per_pixel - 0.01)), SAMPLES_MOST)


def subdivided(camera: Taking, count: int) -> Taking:
    """The camera whose pixels are ``count`` x ``count`` equal parts of each pixel."""
    if isinstance(camera, Scanner):
        rows, cols = camera.shape
        return camera.part((0, rows, 0, cols), count)
    (cx, cy), (width, height) = camera.principal_point_px, camera.image_size_px
    return replace(
        camera,
        focal_length_px=camera.focal_length_px * count,
        principal_point_px=((cx + 0.5) * count - 0.5, (cy + 0.5) * count - 0.5),
        image_size_px=(width * count, height * count),
    )


def grown(camera: Taking, margin_px: int) -> Taking:
    """The camera with ``margin_px`` more pixels on every side."""
    (rows, cols), by = camera.shape, margin_px
    return windowed(camera, (-by, rows + by, -by, cols + by))


def windowed(camera: Taking, window: tuple[int, int, int, int]) -> Taking:
    """The camera of a window of its image (first row, row after the last, first column, column
    after the last), which may lie beyond the image.
    """
    if isinstance(camera, Scanner):
        return camera.part(window)
    row0, row1, col0, col1 = window
    cx, cy = camera.principal_point_px
    return replace(
        camera, principal_point_px=(cx - col0, cy - row0), image_size_px=(col1 - col0, row1 - row0)
    )


def sun_position(choice: SunChoice, frame: EnuFrame, camera: Sensor | None) -> Array:
    """Position of the Sun, (3,) MCMF metres: that of the camera if the choice states none; else in
    the chosen direction from the frame's origin, at the distance of the chosen time, or one
    astronomical unit away.
    """
    own = None if camera is None else camera.sun_position_mcmf_m
    if own is not None and choice == SunChoice():
        return np.asarray(own)
    time = choice.instant(camera)
    away_m = ASTRONOMICAL_UNIT_M if time is None else solar_position.sun_distance_m(time)
    return np.asarray(frame.origin_mcmf_m + away_m * choice.direction_mcmf(frame, camera))


def source_position(environment: Environment, frame: EnuFrame) -> Array:
    """Position that stands for the Sun's under an environment map, (3,) MCMF metres: in the direction
    of its first source from a frame's origin, one astronomical unit away.
    """
    towards = frame.direction_to_mcmf(environment.lighting.first.direction)
    return np.asarray(frame.origin_mcmf_m + ASTRONOMICAL_UNIT_M * towards)


def _gathered(surface: Surface, camera: Camera | Scanner, detector: Detector, count: int) -> Array:
    """Radiance factor that each pixel gathers from ``count`` x ``count`` rays; every exposure by
    itself. CameraError if no ray meets the surface.
    """
    weights, signals, met = response(detector.blur_px, count), [], False
    for one in camera.exposures if isinstance(camera, Scanner) else [camera]:
        fine, meets = _rendered(surface, subdivided(grown(one, detector.margin_px), count))
        signals.append(gathered(fine, weights, count))
        met |= meets
    if not met:
        raise CameraError(f"{camera.name}: the camera sees nothing of the terrain")
    return np.concatenate(signals)


def _rendered(surface: Surface, camera: Camera | Scanner) -> tuple[Float32, bool]:
    """Radiance factor at a camera's pixel centres, rendered in blocks of rows; 0 for the sky. True if
    a ray meets the surface.
    """
    rows, cols = camera.shape
    out, met = np.empty((rows, cols), dtype=np.float32), False
    step = max(1, _RAYS_AT_ONCE // cols)
    for row in range(0, rows, step):
        part = windowed(camera, (row, min(row + step, rows), 0, cols))
        light = surface.radiance(part)
        dark = ~np.isfinite(light)
        met |= not dark.all()
        if dark.any():
            pixels = np.argwhere(dark)[:, ::-1].astype(np.float64)
            light[dark] = np.where(_misses_moon(part, pixels), 0.0, np.nan)
        out[row : row + step] = light
    return out, met


def _misses_moon(camera: Camera | Scanner, pixels: Array) -> Mask:
    """True for pixels (n, 2) whose rays miss the reference sphere; False for pixels without a ray."""
    origins, rays = camera.looks(pixels)
    known = np.isfinite(rays).all(axis=-1)
    misses = np.zeros(len(pixels), dtype=np.bool_)
    misses[known] = np.isnan(ranges(origins[known], rays[known]))
    return misses


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


def simulate(
    source: Dems | Catalog,
    camera: AnySensor | Path | str,
    output: Path | str | None = None,
    *,
    sun: SunStated = None,
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
    output:
        Also write the frame (.png: the detector's numbers; .tif: radiance factor) and, beside it,
        its camera as ``NAME_camera.json``.
    sun:
        The Sun: its azimuth, degrees clockwise from north, and elevation at the middle of what is seen; or an instant (ISO
        text, UTC); or a `SunChoice`. None: the Sun of the camera's file.
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
        For options of DEMs with a catalogue.
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
    detector = detector or Detector()
    seen = rendered_sensor(camera)
    sun = SunChoice.of(sun)
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
