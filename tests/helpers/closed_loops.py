"""Closed loops: a frame is taken at a place that is known, offered as from one that is a little wrong, located, and compared.

Drawn at random: where it looks, from where, how it is rolled, how wide it sees, under which Sun that can stand there, its
noise, and by how much its place and attitude are believed wrong. Frames are rendered by the product (`by_product`) or by
Embree with a camera of its own (`embree_camera`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rasterio
from numpy.typing import NDArray

from lcp_catalog.accuracy import TIERS
from lcp_catalog.arrays import Array
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.ephemeris.solar_position import direction_from_subsolar
from lcp_catalog.geometry.frames import EnuFrame, azimuth_elevation, direction_enu, mcmf_to_lonlat
from lcp_catalog.geometry.sphere_intersection import hits
from lcp_catalog.images.image import Image
from lcp_catalog.matching.fix import LOCATED, Fix
from lcp_catalog.matching.options import Options
from lcp_catalog.matching.point_search import find_points
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.photometry.laws import DEFAULT_MODEL, Reflectance
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.simulation.frame import DemSurface, frame

from .one_patch import sample_patch
from .twins_match import catalog_of_patches

if TYPE_CHECKING:
    from .embree_camera import Ground

Renderer = Callable[[Camera, "Shot"], Image]

SUN_M = 1.496e11
SNR = 50.0
BITS = 10
BLUR_PX = 0.6
OPTIONS = Options()
POSITION_SIGMA_M = 2000.0  # each axis
ATTITUDE_SIGMA_RAD = np.radians(20.0 / 3600.0)
FALSE_PX = 3.0
"""A solution that puts a catalogue's point further off than this in the image is false."""
_TRIES = 500


@dataclass(frozen=True)
class Draw:
    """What frames are drawn from."""

    fov_deg: tuple[float, float] = (10.0, 60.0)
    off_nadir_deg: tuple[float, float] = (0.0, 40.0)
    sun_elevation_deg: tuple[float, float] = (5.0, 60.0)
    pixel_cells: tuple[float, float] = (0.75, 2.0)  # in the middle, in the catalogue's cells
    size_px: int = 384


@dataclass(frozen=True)
class Shot:
    """What was drawn for one frame."""

    number: int
    fov_deg: float
    off_nadir_deg: float
    roll_deg: float
    sun_elevation_deg: float
    sun_azimuth_deg: float
    phase_deg: float
    pixel_m: float
    lon_deg: float
    lat_deg: float


@dataclass(frozen=True, eq=False)
class Site:
    """A catalogue, and the DEM that it and the frames are made of."""

    name: str
    dem: Path
    catalog: Catalog

    @property
    def bounds_deg(self) -> tuple[float, float, float, float]:
        """West, south, east, north of the DEM, an equirectangular map."""
        with rasterio.open(self.dem) as file:
            box, radius = file.bounds, file.crs.to_dict()["R"]
        west, south, east, north = np.degrees(np.array(box) / radius).tolist()
        return west, south, east, north

    def shots(self, count: int, seed: int, draw: Draw = Draw()) -> Iterator[tuple[Shot, Camera]]:
        """Frames that lie on the DEM, whole: how they look is drawn first, then where, until it fits."""
        dice, bounds = np.random.default_rng(seed), self.bounds_deg
        number = 0
        while number < count:
            looks = _Looks.drawn(dice, draw)
            for _ in range(_TRIES):
                shot, camera = self._placed(number, looks, dice, draw)
                low, high = draw.sun_elevation_deg
                if low <= shot.sun_elevation_deg <= high and _on_dem(camera, bounds):
                    yield shot, camera
                    number += 1
                    break

    def _placed(
        self, number: int, looks: _Looks, dice: np.random.Generator, draw: Draw
    ) -> tuple[Shot, Camera]:
        """One frame, near a point of the catalogue's, under a Sun that may be below its horizon."""
        row = dice.integers(len(self.catalog))
        lon, lat = (
            float(values[row] + dice.normal(0.0, 0.1))
            for values in (self.catalog.longitude, self.catalog.latitude)
        )
        cells = np.exp(dice.uniform(*np.log(draw.pixel_cells)))
        pixel_m = float(np.median(self.catalog.gsd)) * cells
        sun = direction_from_subsolar(dice.uniform(0.0, 360.0), dice.uniform(-1.54, 1.54))
        place = EnuFrame(lon % 360.0, lat)
        azimuth, elevation = (float(v) for v in azimuth_elevation(place.direction_from_mcmf(sun)))
        focal = 0.5 * draw.size_px / np.tan(np.radians(looks.fov_deg) / 2.0)
        towards = direction_enu(dice.uniform(0.0, 360.0), 90.0 - looks.off_nadir_deg)
        camera = Camera(
            place.to_mcmf(focal * pixel_m * towards),
            _axes(-towards, np.radians(looks.roll_deg)) @ place.rotation,
            focal,
            ((draw.size_px - 1) / 2.0,) * 2,
            (draw.size_px,) * 2,
            sun_position_mcmf_m=place.origin_mcmf_m + SUN_M * sun,
            name=f"{self.name} {number}",
        )
        shot = Shot(
            number,
            looks.fov_deg,
            looks.off_nadir_deg,
            looks.roll_deg,
            elevation,
            azimuth,
            float(np.degrees(np.arccos(np.clip(place.direction_from_mcmf(sun) @ towards, -1, 1)))),
            pixel_m,
            place.lon_deg,
            lat,
        )
        return shot, camera


@dataclass(frozen=True)
class _Looks:
    """How a frame looks, wherever that is."""

    fov_deg: float
    off_nadir_deg: float
    roll_deg: float

    @classmethod
    def drawn(cls, dice: np.random.Generator, draw: Draw) -> _Looks:
        return cls(
            dice.uniform(*draw.fov_deg), dice.uniform(*draw.off_nadir_deg), dice.uniform(0.0, 360.0)
        )


def _axes(ahead: Array, roll_rad: float) -> Array:
    """Right, down and ahead in ENU; any roll is as good as another, so that its zero is nobody's."""
    right = np.cross(ahead, np.eye(3)[np.argmin(np.abs(ahead))])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    return np.stack([cos * right + sin * down, cos * down - sin * right, ahead])


def _on_dem(camera: Camera, bounds: tuple[float, float, float, float]) -> bool:
    """Whether the image's border meets the sphere within a DEM, 0.1 degrees inside."""
    rows, cols = camera.shape
    along = np.linspace(-0.5, rows - 0.5, 17)
    sides = [np.stack([along, np.full(17, edge)], -1) for edge in (-0.5, cols - 0.5)]
    pixels = np.concatenate([*sides, *(side[:, ::-1] for side in sides)])
    distance, points = hits(camera.position_mcmf_m, camera.rays(pixels))
    if np.isnan(distance).any():
        return False
    lon, lat, _ = mcmf_to_lonlat(points)
    west, south, east, north = bounds
    lon = (lon - west) % 360.0 + west
    return bool(
        ((lon > west + 0.1) & (lon < east - 0.1) & (lat > south + 0.1) & (lat < north - 0.1)).all()
    )


def cut(dem: Path, places_deg: Iterable[tuple[float, float]], nodes: int, gsd_m: float) -> Catalog:
    """A catalogue of patches cut at places (longitude, latitude), whatever they are worth."""
    dems = DemSet.open([dem])
    patches = [sample_patch(dems, lon % 360.0, lat, nodes, gsd_m) for lon, lat in places_deg]
    return catalog_of_patches(
        np.array([patch.z_m for patch in patches]),
        [patch.frame for patch in patches],
        gsd_m,
        gsd_min=np.full(len(patches), gsd_m / 16),
        dem_resolution=np.full(len(patches), gsd_m),
    )


def by_product(dem: Path, law: Reflectance = DEFAULT_MODEL) -> Renderer:
    """Frames by `lcp simulate`'s library."""

    def take(camera: Camera, shot: Shot) -> Image:
        detector = Detector(blur_px=BLUR_PX, noise=1.0 / SNR, bits=BITS, seed=shot.number)
        request = Request(
            DemSet.open([dem]),
            view=ViewChoice(camera),
            model=law,
            accuracy=TIERS["reference"],
            disc=False,
        )
        ground = DemSurface.seen(request, detector.margin_px)
        return replace(frame(ground, camera, detector).image, name=camera.name)

    return take


def embree_frame(
    ground: Ground, camera: Camera, snr: float, bits: int, samples: int, seed: int
) -> Image:
    """A frame of a ground by the independent renderer, its camera made from CAMERA.json's numbers alone."""
    from .embree_camera import Pinhole, photograph, read_out

    said = camera.to_json()
    judge = Pinhole(
        np.array(said["position_mcmf_m"]),
        np.array(said["rotation_mcmf_to_camera"]),
        said["focal_length_px"],
        tuple(said["principal_point_px"]),
        tuple(said["image_size_px"]),
    )
    sun = np.array(said["sun_position_mcmf_m"])
    light = photograph(ground, judge, sun, blur_px=BLUR_PX, samples=samples, seed=seed)
    known = np.isfinite(light)
    numbers = read_out(np.nan_to_num(light), snr, bits, seed)
    signal = np.where(known, numbers, np.nan).astype(np.float32)
    weight = (known & (numbers < 2**bits - 1)).astype(np.float32)
    return Image(camera.name, signal, weight, camera, sun_position_mcmf_m=sun)


def by_embree(dem: Path, middle_deg: tuple[float, float], reach_m: float) -> Renderer:
    """Frames of the DEM's mesh within reach of a place; the judge's camera is made from CAMERA.json's numbers alone."""
    from .embree_camera import Ground

    ground = Ground.of(dem, *middle_deg, reach_m)

    def take(camera: Camera, shot: Shot) -> Image:
        return embree_frame(ground, camera, SNR, BITS, samples=3, seed=shot.number)

    return take


@dataclass(frozen=True)
class Row:
    """One frame of a loop. Lengths in metres, image distances in pixels; NaN where there is no pose."""

    site: str
    shot: Shot
    attitude: bool  # solved for
    verdict: str
    reason: str
    points: int  # in view
    found: int
    position_m: float
    across_m: float  # both directions across the line of sight together
    across_px: float  # of a pixel in the middle
    sigma_across_px: float
    squared: float  # error in units of its covariance, squared, of all that was solved
    squared_position: float
    unknowns: int
    off_px: float  # how far the solution puts a catalogue's point from where it is, the worst
    seconds: float
    bias_px: tuple[float, float] = (np.nan, np.nan)  # mean residual of matches at the true place
    bias_sigma_px: tuple[float, float] = field(default=(np.nan, np.nan))

    @property
    def located(self) -> bool:
        return self.verdict == LOCATED

    @property
    def is_false(self) -> bool:
        """Fix somewhere else."""
        return self.located and not self.off_px <= FALSE_PX


def fly(
    site: Site, shot: Shot, camera: Camera, photo: Image, attitude: bool, with_bias: bool = False
) -> Row:
    """Offer a photo as from a place that is wrong, locate it, compare."""
    dice = np.random.default_rng([shot.number, int(attitude), 7])
    uncertainty = Uncertainty(POSITION_SIGMA_M, ATTITUDE_SIGMA_RAD if attitude else 0.0)
    wrong = dice.normal(0.0, 1.0, 6) * uncertainty.sigmas(camera)
    believed = camera.moved(wrong)
    start = time.perf_counter()
    found = locate(site.catalog, photo.with_sensor(believed), uncertainty, options=OPTIONS)
    seconds = time.perf_counter() - start
    row = _compared(site, shot, camera, believed, found, attitude, seconds)
    if not with_bias:
        return row
    bias, sigma = bias_px(site.catalog, photo.with_sensor(camera))
    return replace(row, bias_px=bias, bias_sigma_px=sigma)


def bias_px(catalog: Catalog, photo: Image) -> tuple[tuple[float, float], tuple[float, float]]:
    """Mean over a photo's matches of found minus where its camera has them, column and row, each counted by its own covariance,
    and the mean's sigma by their scatter; matches further off than 2 pixels are no matches.
    """
    matches = find_points(catalog, photo, reach_px=8.0, criteria=OPTIONS.criteria)
    near = matches.found & (np.abs(np.nan_to_num(matches.offset_px, nan=9.0)).max(axis=1) < 2.0)
    off = matches.offset_px[near]
    if len(off) < 3:
        return (np.nan, np.nan), (np.nan, np.nan)
    weight = 1.0 / matches.covariance_px2[near][:, [0, 1], [0, 1]]
    share = weight / weight.sum(axis=0)
    mean = (share * off).sum(axis=0)
    sigma = np.sqrt((share**2 * (off - mean) ** 2).sum(axis=0))
    return (float(mean[0]), float(mean[1])), (float(sigma[0]), float(sigma[1]))


def _compared(
    site: Site,
    shot: Shot,
    camera: Camera,
    believed: Camera,
    found: Fix,
    attitude: bool,
    seconds: float,
) -> Row:
    matches, pose = found.matches, found.pose
    seen = camera.in_image(camera.project(site.catalog.position_mcmf))
    about = (site.name, shot, attitude, found.verdict, found.reason, int(seen.sum()))
    count = int(matches.found.sum())
    if pose is None:
        return Row(*about, count, *[np.nan] * 6, 0, np.nan, seconds)
    solved = pose.sensor
    error = np.concatenate(
        [
            solved.position_mcmf_m - camera.position_mcmf_m,
            _turn(solved.rotation_mcmf_to_camera @ camera.rotation_mcmf_to_camera.T),
        ]
    )
    ahead = camera.rotation_mcmf_to_camera[2]
    flat = np.eye(3) - np.outer(ahead, ahead)
    across = float(np.linalg.norm(flat @ error[:3]))
    sigma = float(np.sqrt(np.trace(flat @ pose.covariance[:3, :3] @ flat)))
    points = site.catalog.position_mcmf[seen]
    off = np.linalg.norm(solved.project(points) - camera.project(points), axis=-1)
    return Row(
        *about,
        count,
        float(np.linalg.norm(error[:3])),
        across,
        across / shot.pixel_m,
        sigma / shot.pixel_m,
        _squared(error, pose.covariance, pose.solved),
        _squared(error[:3], pose.covariance[:3, :3], pose.solved[:3]),
        int(pose.solved.sum()),
        float(np.max(off, initial=0.0)),
        seconds,
    )


def _turn(rotation: Array) -> Array:
    """The vector of a small rotation."""
    return 0.5 * np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )


def _squared(error: Array, covariance: Array, solved: NDArray[np.bool_]) -> float:
    """e^T C^-1 e of what was solved for."""
    e, c = error[solved], covariance[np.ix_(solved, solved)]
    scale = 1.0 / np.sqrt(np.diag(c))
    e, c = e * scale, c * np.outer(scale, scale)
    return float(e @ np.linalg.solve(c, e))
