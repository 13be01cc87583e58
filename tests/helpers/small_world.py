"""Small synthetic terrain for tests of the search: craters near Hadley, a catalogue of them, and
images by the patches' own renderer, which takes the whole terrain as one large patch. The renderer
is tested elsewhere (test_templates, test_independent_frames); here only the search is tested.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.geometry.frames import EnuFrame, direction_enu, lonlat_to_mcmf, mcmf_to_lonlat
from lcp_catalog.images.image import Image
from lcp_catalog.matching.templates import render_patches
from lcp_catalog.photometry.laws import Reflectance, reflectance_model

from .posed import DOWN, HADLEY, turned
from .synthetic import cratered
from .twins_match import catalog_of_patches

GSD_M = 400.0
NODES = 321
PATCH = 33
LAW = reflectance_model("lunar-lambert")
UNCERTAIN = Uncertainty(2000.0, np.radians(0.3))


@dataclass(frozen=True, eq=False)
class World:
    """Heights on a grid of 400 m in the tangent plane of a place, 128 km a side."""

    seed: int = 1
    frame: EnuFrame = HADLEY

    @cached_property
    def heights(self) -> np.ndarray:
        """Coefficients of a cubic spline through the nodes."""
        return spline_filter(cratered(NODES, GSD_M, self.seed, 0.5).astype(np.float64))

    def level(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
        """Metres above the sphere."""
        enu = self.frame.from_mcmf(lonlat_to_mcmf(lon_deg, lat_deg))
        middle = (NODES - 1) / 2.0
        places = np.stack([middle - enu[..., 1] / GSD_M, middle + enu[..., 0] / GSD_M])
        return map_coordinates(self.heights, places, order=3, mode="mirror", prefilter=False)

    def patch(self, frame: EnuFrame, nodes: int) -> np.ndarray:
        """ENU z of the terrain's nodes in a frame, (nodes, nodes)."""
        axis = (np.arange(nodes) - (nodes - 1) / 2.0) * GSD_M
        east, north = np.meshgrid(axis, -axis)
        z = np.zeros_like(east)
        for _ in range(6):
            lon, lat, _ = mcmf_to_lonlat(frame.to_mcmf(np.stack([east, north, z], axis=-1)))
            ground = frame.from_mcmf(lonlat_to_mcmf(lon, lat, self.level(lon, lat)))
            z = (
                z
                + ground[..., 2]
                - frame.from_mcmf(frame.to_mcmf(np.stack([east, north, z], axis=-1)))[..., 2]
            )
        return z

    def catalog(self, step_m: float = 10e3, half_m: float = 40e3, nodes: int = PATCH) -> Catalog:
        """Points on a square lattice; made once for each spacing."""
        return _on_lattice(self, step_m, half_m, nodes)

    def _lattice(self, step_m: float, half_m: float, nodes: int) -> Catalog:
        axis = np.arange(-half_m, half_m + 1.0, step_m)
        east, north = (a.ravel() for a in np.meshgrid(axis, axis))
        return self._catalog(east, north, nodes)

    def _catalog(self, east: np.ndarray, north: np.ndarray, nodes: int) -> Catalog:
        count = len(east)
        flat = self.frame.to_mcmf(np.stack([east, north, np.zeros(count)], axis=-1))
        lon, lat, _ = mcmf_to_lonlat(flat)
        level = self.level(lon, lat)
        frames = [EnuFrame(*place) for place in zip(lon, lat, level, strict=True)]
        return catalog_of_patches(
            np.array([self.patch(f, nodes) for f in frames])
            .reshape(-1, nodes, nodes)
            .astype(np.float32),
            frames,
            GSD_M,
            gsd_min=np.full(count, GSD_M / 4.0),
            dem_resolution=np.full(count, GSD_M),
        )

    @cached_property
    def whole(self) -> Catalog:
        """The whole terrain as one patch."""
        return self._catalog(np.zeros(1), np.zeros(1), NODES)

    def photo(
        self,
        camera: Camera,
        sun_deg: tuple[float, float] = (100.0, 25.0),
        noise: float = 0.02,
        seed: int = 0,
        law: Reflectance = LAW,
    ) -> Image:
        """A camera's image under a Sun (azimuth, elevation at the middle); noise is 1 sigma over
        the mean signal. Terrain beyond the edge is missing.
        """
        sun = self.frame.direction_to_mcmf(direction_enu(*sun_deg))
        drawn = render_patches(self.whole, [0], camera, sun[None], law, least_cover=0.999)
        rows, cols = camera.shape
        signal = np.full((rows, cols), np.nan)
        (left, top), (high, wide) = drawn.origin[0], drawn.shape
        r0, r1, c0, c1 = max(top, 0), min(top + high, rows), max(left, 0), min(left + wide, cols)
        part = np.s_[r0 - top : r1 - top, c0 - left : c1 - left]
        signal[r0:r1, c0:c1] = np.where(drawn.mask[0][part], drawn.values[0][part], np.nan)
        dice = np.random.default_rng(seed)
        signal += dice.normal(0.0, noise * np.nanmean(signal), signal.shape)
        weight = np.isfinite(signal).astype(np.float32)
        return Image("made", signal.astype(np.float32), weight, camera, sun_direction_mcmf=sun)


@cache
def world() -> World:
    """The first of the terrains, made once for all modules."""
    return World()


@cache
def _on_lattice(world: World, step_m: float, half_m: float, nodes: int) -> Catalog:
    return world._lattice(step_m, half_m, nodes)


def overhead(
    frame: EnuFrame = HADLEY,
    turns: tuple[float, float, float] = (0.0, 0.0, 0.0),
    size_px: int = 200,
    pixel_m: float = GSD_M,
    altitude_m: float = 120e3,
) -> Camera:
    """A camera above a place with pixels of a given size on the surface."""
    middle = (size_px - 1) / 2.0
    return Camera(
        frame.to_mcmf([0.0, 0.0, altitude_m]),
        turned(np.array(turns)) @ DOWN @ frame.rotation,
        altitude_m / pixel_m,
        (middle, middle),
        (size_px, size_px),
    )


def believed(photo: Image, seed: int = 0, uncertainty: Uncertainty = UNCERTAIN) -> Image:
    """The image with a sensor that is off by one draw of the uncertainty."""
    sigmas = uncertainty.sigmas(photo.sensor)
    draw = np.clip(np.random.default_rng(seed).normal(size=len(sigmas)), -2.0, 2.0)
    return photo.with_sensor(photo.sensor.moved(sigmas * draw))


def mirrored(photo: Image, how: str) -> Image:
    """The pixels turned or mirrored, the camera unchanged."""
    turn = {
        "left-right": lambda a: a[:, ::-1],
        "up-down": lambda a: a[::-1],
        "90": np.rot90,
        "180": lambda a: a[::-1, ::-1],
        "270": lambda a: np.rot90(a, 3),
    }[how]
    signal, weight = (np.ascontiguousarray(turn(a)) for a in (photo.signal, photo.weight))
    return replace(photo, signal=signal, weight=weight)
