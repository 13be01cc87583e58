"""One area of a build: its terrain, its images, and its candidates with their evaluation.

`run_area` is a pure function of its job and runs in any process. It returns all candidates, usable or
not: the build chooses among the candidates of all areas.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Mask
from ..constants import MOON_RADIUS_M
from ..dem.cache_limits import CACHES_BYTES, limit_caches
from ..dem.error_maps import ErrorMaps
from ..dem.height_errors import height_errors
from ..dem.mosaic import DemSet
from ..geometry.frames import EnuFrame, enu_rotation, mcmf_to_lonlat
from ..landmarks.corners import Persistence, candidates_of_groups
from ..landmarks.error_model import ErrorModel
from ..photometry.albedo_map import AlbedoCover, AlbedoMap
from ..photometry.law_choice import LawChoice
from ..rendering import decisions
from ..rendering.decisions import Decision
from ..rendering.plan import ScenePlan, ring_decision
from ..terrain.area import Area
from ..terrain.heightfield import Window
from ..terrain.surroundings import SunRays, build_surrounded, ring_for_rays_m, surroundings
from ..terrain.terrain import Terrain, sample_patches
from .areas import AreaGrid, AreaTask
from .config import BuildConfig
from .evaluation import Evaluation, evaluate, image_scales
from .levels import sources
from .place_errors import PlaceErrors
from .sweep import Conditions, Sweep, lowest_off_nadir_deg, plan_area

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class AreaJob:
    """The input of one area's computation; small and picklable."""

    task: AreaTask
    grid: AreaGrid
    region: Area
    gsd_m: float
    config: BuildConfig
    dems: DemSet
    choice: LawChoice
    errors: ErrorModel
    albedo: AlbedoMap | None = None
    maps: ErrorMaps | None = None
    caches_mb: float = CACHES_BYTES / 1e6
    """What the process may keep of the DEM's files (`worker_memory.caches_mb`)."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that the job reads."""
        return (
            *self.dems.files,
            *(self.albedo.files if self.albedo else ()),
            *(self.maps.files if self.maps else ()),
        )

    @property
    def work(self) -> int:
        """Own nodes times conditions, to which most of the time of an area is proportional."""
        return (
            math.prod(self.task.window.shape) * conditions_at(self.task.lat_deg, self.config).count
        )


@lru_cache(maxsize=1024)
def conditions_at(lat_deg: float, config: BuildConfig) -> Conditions:
    """The conditions of the areas of a row, kept: a build asks for them for each of its areas."""
    return Conditions.at(lat_deg, config)


@dataclass(frozen=True)
class Candidates:
    """All candidates of one area or of several, one row each; shapes (n, ...)."""

    lon_deg: Array
    lat_deg: Array
    elevation_m: Array
    patch_m: NDArray[np.float32]  # (n, p, p) ENU z in the point's own frame
    product: NDArray[np.int16]  # index of the DEM
    evaluation: Evaluation
    albedo: NDArray[np.float32] | None = None
    """(n, p, p) albedo factors of the patches' nodes, all NaN outside the map; None without a map."""

    def __len__(self) -> int:
        return len(self.lon_deg)


@dataclass(frozen=True)
class AreaResult:
    """Candidates of an area, and the scene plan that its images follow."""

    candidates: Candidates
    plan: ScenePlan


def run_area(job: AreaJob) -> AreaResult:
    """Evaluate one area. Raises the library's errors; an area without heights has no candidates."""
    limit_caches(int(job.caches_mb * 1e6))
    sweep = area_sweep(job)
    core = _Core(job, sweep.terrain, job.config.points.halo_nodes(job.gsd_m))
    rows, cols = _find(sweep, core, job.config, job.gsd_m)
    return AreaResult(_evaluated(job, core, sweep, rows, cols), sweep.plan)


def area_sweep(job: AreaJob) -> Sweep:
    """The images of the area: its terrain with its halo as the core, its conditions and its plan."""
    conditions = Conditions.at(job.task.lat_deg, job.config)
    rays = _sun_rays(job, conditions)
    terrain, beyond = _terrain(job, job.config.points.halo_nodes(job.gsd_m), rays)
    brightness = job.albedo.known_nodes(terrain) if job.albedo else None
    albedo = _albedo_decision(job.albedo, terrain, brightness)
    plan = plan_area(terrain, conditions, job.config, job.choice, beyond, albedo)
    how = (job.choice.model, job.config.model.precision)
    return Sweep(terrain, conditions, plan, *how, brightness=brightness)


def _albedo_decision(
    albedo: AlbedoMap | None, terrain: Terrain, brightness: NDArray[np.float32] | None
) -> Decision | None:
    """The decision about an albedo map, by its factors at the core's nodes; None without a map."""
    if albedo is None or brightness is None:
        return None
    row0, row1, col0, col1 = terrain.core
    known = np.isfinite(terrain.field.z_m[row0:row1, col0:col1])
    return decisions.albedo(albedo, AlbedoCover.of(brightness.astype(np.float64), known))


_SLACK_RAD = math.radians(0.5)
"""Of turns: points' norths are seen in the plane of the area's frame."""


def _sun_rays(job: AreaJob, conditions: Conditions) -> SunRays:
    """Rays to the Suns of an area. Its points turn them to their own norths (`_turns`): by at most the
    greatest difference of longitude of a spherical cap around the area's centre.
    """
    window, lat_rad = job.task.window, math.radians(job.task.lat_deg)
    rows = max(-window.row0, window.row1)
    cap_rad = math.hypot(rows, max(-window.col0, window.col1)) * job.gsd_m / MOON_RADIUS_M
    around_pole = cap_rad >= 0.5 * math.pi - abs(lat_rad)
    turn_rad = math.pi if around_pole else math.asin(math.sin(cap_rad) / math.cos(lat_rad))
    turn_rad += math.radians(job.config.model.direction_tolerance_deg) + _SLACK_RAD
    return SunRays.towards(conditions.sun_directions()[conditions.reachable], turn_rad)


def _terrain(job: AreaJob, halo: int, rays: SunRays) -> tuple[Terrain, Decision]:
    """The terrain, its core the area with its halo, with the terrain around that can hide it from a view
    or shadow it under its Suns, up to the configured distance; and the decision about that.
    """
    place = (job.dems, job.task.frame, job.task.window.grown(halo), job.gsd_m)
    limit_m = job.config.model.ring_max_km * 1e3
    view_rad = np.radians(90.0 - lowest_off_nadir_deg(job.config, job.gsd_m))
    view_m = (
        ring_for_rays_m(*place, float(np.tan(view_rad)), limit_m) if view_rad < np.pi / 2 else 0.0
    )
    around = surroundings(*place, rays, view_m, limit_m)
    terrain = build_surrounded(*place, around)
    needed_m = max(around.needed_m, view_m)
    return terrain, ring_decision(terrain, around.ring_m, needed_m, limit_m)


class _Core:
    """The core of an area's terrain: the positions of its nodes (NaN in the halo), and which of them
    belong to the area.
    """

    def __init__(self, job: AreaJob, terrain: Terrain, halo: int) -> None:
        self.terrain, self.frame, self.halo = terrain, terrain.frame, halo
        r0, r1, c0, c1 = terrain.core
        self.z = terrain.field.z_m[r0:r1, c0:c1]
        self.inner = np.s_[halo:-halo, halo:-halo]
        """Without the halo."""
        lon, lat = self._places((r0 + halo, r1 - halo, c0 + halo, c1 - halo))
        self.lon, self.lat = np.full((2, *self.z.shape), np.nan)
        self.lon[self.inner], self.lat[self.inner] = lon, lat
        row, column = job.grid.owner(lon, lat)
        self.mine = np.zeros(self.z.shape, np.bool_)
        self.mine[self.inner] = (
            (row == job.task.row) & (column == job.task.column) & job.region.contains(lon, lat)
        )
        self.sources = sources(job.config, job.dems, job.gsd_m)
        """Indices of the DEMs that points may come from."""
        self.useful = np.isfinite(self.z) & np.isin(
            terrain.product_index[r0:r1, c0:c1], self.sources
        )

    def _places(self, window: Window) -> tuple[Array, Array]:
        """Longitude and latitude of every node of the window; without a height those on the sphere."""
        r0, r1, c0, c1 = window
        field, z = self.terrain.field, self.terrain.field.z_m[r0:r1, c0:c1]
        x, y = np.meshgrid(
            field.x0_m + np.arange(c0, c1) * field.gsd_m,
            field.y0_m - np.arange(r0, r1) * field.gsd_m,
        )
        z = np.where(np.isfinite(z), z, -(x**2 + y**2) / (2.0 * MOON_RADIUS_M))
        lon, lat, _ = mcmf_to_lonlat(self.frame.to_mcmf(np.stack([x, y, z], axis=-1)))
        return lon, lat

    @property
    def origin(self) -> tuple[int, int]:
        """Row and column of node [0, 0], counted from the frame's origin, as the spacing cells are."""
        window = self.terrain.window
        return window.row0 + self.terrain.core[0], window.col0 + self.terrain.core[2]


def _find(
    sweep: Sweep, core: _Core, config: BuildConfig, gsd_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Corners at the area's own nodes that persist over the Suns, or over a group of them, in the view
    nearest to straight down.
    """
    nadir, number = int(np.argmin(sweep.conditions.off_nadir_deg)), sweep.conditions.sun_groups
    groups: dict[int, Persistence] = {}
    for image in sweep.images(views=(nadir,)):
        group = groups.setdefault(int(number[image.sun]), Persistence(core.z.shape, core.inner))
        group.add(image.radiance)
    every = Persistence(core.z.shape)
    for group in groups.values():
        every.include(group)
    return candidates_of_groups(
        every.score(),
        [
            groups[k].score() for k in sorted(groups, reverse=True)
        ],  # high Suns have the fewest points
        spacing_px=config.points.spacing_nodes(gsd_m),
        per_cell=config.points.candidates_per_cell,
        border=core.halo,
        valid=core.mine & core.useful,
        origin=core.origin,
    )


def _evaluated(
    job: AreaJob,
    core: _Core,
    sweep: Sweep,
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
) -> Candidates:
    """Evaluate the candidates in groups of similar convergence, each with Suns turned to its own north."""
    half = job.config.points.half
    whole = _has_whole_patch(core.useful, rows, cols, half)
    rows, cols = rows[whole], cols[whole]
    found = _patches(core.lon[rows, cols], core.lat[rows, cols], job)
    # the nodes of a patch, in its own frame, are not quite those of the area
    kept: Mask = np.all(np.isfinite(found.z_m), axis=(1, 2)) & np.isin(found.product, core.sources)
    if found.albedo is not None and sweep.brightness is not None:
        kept &= _known_alike(sweep.brightness, rows, cols, half, found.albedo)
    rows, cols, found = rows[kept], cols[kept], found.rows(kept)
    lon, lat = core.lon[rows, cols], core.lat[rows, cols]
    errors = _place_errors(job, lon, lat, found.product)
    turns = _turns(core.frame, lon, lat, job.config)
    scales = image_scales(job.config.points.patch_nodes)
    parts = Evaluation.empty(len(rows), len(scales), sweep.conditions.shape)
    for turn in np.unique(turns):
        group = np.flatnonzero(turns == turn)
        part, row0, col0 = sweep.around(rows[group], cols[group], core.halo, float(turn))
        at = rows[group] - row0, cols[group] - col0
        parts = parts.with_rows(
            group, evaluate(part, *at, job.config, job.gsd_m, errors.rows(group))
        )
    return Candidates(lon, lat, found.elevation_m, found.z_m, found.product, parts, found.albedo)


def _place_errors(job: AreaJob, lon: Array, lat: Array, product: NDArray[np.int16]) -> PlaceErrors:
    """Error models of the candidates: the configuration's figures, or those of maps and DEMs."""
    sigma, length = height_errors(job.dems, lon, lat, job.maps, product)
    own, unknown = job.config.errors, np.full(len(lon), np.nan)
    return PlaceErrors.of_heights(
        job.errors,
        sigma if own.height_sigma_m is None else unknown,
        length if own.height_length_m is None else unknown,
    )


def _has_whole_patch(
    useful: NDArray[np.bool_], rows: NDArray[np.int64], cols: NDArray[np.int64], half: int
) -> NDArray[np.bool_]:
    whole = [
        useful[r - half : r + half + 1, c - half : c + half + 1].all()
        for r, c in zip(rows, cols, strict=True)
    ]
    return np.array(whole, dtype=np.bool_)


def _turns(frame: EnuFrame, lon: Array, lat: Array, config: BuildConfig) -> Array:
    """Azimuth of each point's north in the area's frame, radians, rounded to twice the direction tolerance."""
    north = enu_rotation(lon, lat)[:, 1]
    east_up = frame.direction_from_mcmf(north)
    turn = np.arctan2(east_up[:, 0], east_up[:, 1])
    step = 2.0 * np.radians(config.model.direction_tolerance_deg)
    return np.round(turn / step) * step


def _known_alike(
    brightness: NDArray[np.float32],
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    half: int,
    patches: NDArray[np.float32],
) -> NDArray[np.bool_]:
    """True for patches (n, p, p) that are completely inside or completely outside the albedo map, both in
    the area and as stored. The edge of the map inside a patch would be an edge in the image only.
    """
    known, alike = np.isfinite(brightness), np.empty(len(rows), dtype=np.bool_)
    for i, (r, c) in enumerate(zip(rows, cols, strict=True)):
        area = known[r - half : r + half + 1, c - half : c + half + 1]
        own = np.isfinite(patches[i])
        alike[i] = (area.all() and own.all()) or not (area.any() or own.any())
    return alike


@dataclass(frozen=True)
class _Found:
    """The candidates' patches of the DEM, each in its own frame: (n, p, p), (n,), (n,), (n, p, p)."""

    z_m: NDArray[np.float32]
    elevation_m: Array
    product: NDArray[np.int16]
    albedo: NDArray[np.float32] | None

    def rows(self, some: NDArray[np.bool_]) -> _Found:
        """A selection of the candidates."""
        albedo = None if self.albedo is None else self.albedo[some]
        return _Found(self.z_m[some], self.elevation_m[some], self.product[some], albedo)


def _patches(lon: Array, lat: Array, job: AreaJob) -> _Found:
    """The candidates' patches, with the albedo factors of the same nodes."""
    size = job.config.points.patch_nodes
    found = sample_patches(job.dems, lon, lat, size, job.gsd_m)
    frames = [patch.frame for patch in found]
    z = np.array([patch.z_m for patch in found], dtype=np.float32).reshape(-1, size, size)
    return _Found(
        z,
        np.array([frame.height_m for frame in frames]),
        np.array([patch.product for patch in found], dtype=np.int16),
        job.albedo.patches(frames, z, job.gsd_m) if job.albedo else None,
    )
