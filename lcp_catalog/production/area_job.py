"""One area of a build: its terrain, its images, and its candidates with their evaluation.

`run_area` is a pure function of its job and runs in any process. It returns all candidates, usable or
not: the build chooses among the candidates of all areas. In a build of two passes it returns all with a first look
(`first_look`), then some of them, which the build names, with all conditions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ..arrays import AnyArray, Array, Float32, Index, Int16, Mask
from ..constants import MOON_RADIUS_M
from ..dem.block_cache import CACHES_BYTES, limit_caches
from ..dem.error_maps import height_errors
from ..dem.products import PLACE_PER_LENGTH
from ..geometry.frames import EnuFrame, enu_rotation, mcmf_to_lonlat
from ..landmarks.corners import Persistence, candidates_of_groups
from ..landmarks.selection import Places
from ..photometry.albedo_map import AlbedoCover, AlbedoMap
from ..rendering import decisions
from ..rendering.decisions import Decision
from ..rendering.plan import ScenePlan, ring_decision
from ..stages import timed
from ..terrain.heightfield import Window
from ..terrain.surroundings import SunRays, build_surrounded, ring_for_rays_m, surroundings
from ..terrain.terrain import Ground, Terrain, sample_patches
from .areas import AreaGrid, AreaTask
from .config import BuildConfig
from .evaluation import STEP, Evaluation, PlaceErrors, evaluate
from .first_look import first_look
from .kept_ground import AreaGround, packed, unpacked
from .recipe import Recipe
from .sweep import Conditions, Sweep, lowest_off_nadir_deg, plan_area

FIRST = "a"
"""The step of the first pass (`AreaJob.step`)."""

SITE = np.dtype([("row", "<i4"), ("column", "<i4"), ("box", "<i4", (2, 2))])
"""Where a candidate is in the core of its area's terrain; and the least and greatest row, and column, of all candidates
that are evaluated in the same images."""


@dataclass(frozen=True)
class AreaJob:
    """The input of one area's computation: a recipe and an area; small and picklable."""

    recipe: Recipe
    task: AreaTask
    grid: AreaGrid
    caches_mb: float = CACHES_BYTES / 1e6
    """What the process may keep of the DEM's files (`run.caches_mb`)."""
    step: str = ""
    """Of a build of two passes: `FIRST`, then a letter for each round of the second (`two_passes`)."""
    sites: AnyArray | None = field(default=None, compare=False)
    """(n,) of type `SITE`: the candidates that are evaluated, found before; None: they are looked for."""
    keeps: bool = field(default=False, compare=False)
    """True: its ground is returned for the steps after it (`kept_ground`)."""
    ground: bytes | None = field(default=None, compare=False)
    """The ground that a step before returned; None: it is made."""

    @property
    def name(self) -> str:
        """The name of what is kept of it."""
        return self.task.name + self.step

    @property
    def conditions(self) -> Conditions:
        """The conditions of the area."""
        return conditions_at(self.task.lat_deg, self.recipe.config)

    @property
    def nodes(self) -> int:
        """Nodes of the area without its halo."""
        return math.prod(self.task.window.shape)

    @property
    def work(self) -> int:
        """Own nodes times conditions, to which most of the time of an area is proportional."""
        return self.nodes * self.conditions.count


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
    patch_m: Float32  # (n, p, p) ENU z in the point's own frame
    product: Int16  # index of the DEM
    evaluation: Evaluation
    albedo: Float32 | None = None
    """(n, p, p) albedo factors of the patches' nodes, all NaN outside the map; None without a map."""
    sites: AnyArray | None = None
    """(n,) of type `SITE`."""
    slope_sigma: Array | None = None
    """(n,) 1 sigma of the slopes' errors."""

    def __len__(self) -> int:
        return len(self.lon_deg)


@dataclass(frozen=True)
class AreaResult:
    """Candidates of an area, and the scene plan that its images follow."""

    candidates: Candidates
    plan: ScenePlan
    ground: bytes | None = None
    """The terrain and the shadows, for a job that keeps them."""


def run_area(job: AreaJob) -> AreaResult:
    """Evaluate one area. Raises the library's errors; an area without heights has no candidates."""
    limit_caches(int(job.caches_mb * 1e6))
    sweep = area_sweep(job)
    core = _Core(job, sweep.terrain)
    if job.sites is None:
        rows, cols = _find(sweep, core, job.recipe.config)
    else:
        rows, cols = (job.sites[name].astype(np.int64) for name in ("row", "column"))
    found = _evaluated(job, core, sweep, rows, cols)
    return AreaResult(found, sweep.plan, packed(sweep) if job.keeps else None)


def area_sweep(job: AreaJob) -> Sweep:
    """The images of the area: its terrain with its halo as the core, its conditions and its plan."""
    recipe = job.recipe
    known = _ground(job) if job.ground is None else unpacked(job.ground)
    terrain, plan, brightness, shadows = known
    sweep = Sweep(
        terrain,
        job.conditions,
        plan,
        recipe.law.model,
        recipe.config.model.precision,
        brightness=brightness,
        albedo=recipe.albedo,
    )
    sweep.shadows.update(shadows)
    return sweep


def _ground(job: AreaJob) -> AreaGround:
    """The terrain of an area, its plan, the brightness of its nodes with an albedo map, and no shadows yet."""
    recipe = job.recipe
    terrain, beyond = _terrain(job)
    known_nodes = recipe.albedo and timed("albedo", is_stage=False)(recipe.albedo.known_nodes)
    brightness = known_nodes(terrain) if known_nodes else None
    albedo = _albedo_decision(recipe.albedo, terrain, brightness)
    plan = plan_area(terrain, job.conditions, recipe.config, recipe.law, beyond, albedo)
    return terrain, plan, brightness, {}


def _albedo_decision(
    albedo: AlbedoMap | None, terrain: Terrain, brightness: Float32 | None
) -> Decision | None:
    """The decision about an albedo map, by its factors at the core's nodes; None without a map."""
    if albedo is None or brightness is None:
        return None
    row0, row1, col0, col1 = terrain.core
    known = np.isfinite(terrain.field.z_m[row0:row1, col0:col1])
    return decisions.albedo(albedo, AlbedoCover.of(brightness.astype(np.float64), known))


_SLACK_RAD = math.radians(0.5)
"""Of turns: points' norths are seen in the plane of the area's frame."""


def _sun_rays(job: AreaJob) -> SunRays:
    """Rays to the Suns of an area. Its points turn them to their own norths (`_turns`): by at most the
    greatest difference of longitude of a spherical cap around the area's centre.
    """
    window, lat_rad = job.task.window, math.radians(job.task.lat_deg)
    rows = max(-window.row0, window.row1)
    cap_rad = math.hypot(rows, max(-window.col0, window.col1)) * job.recipe.gsd_m / MOON_RADIUS_M
    around_pole = cap_rad >= 0.5 * math.pi - abs(lat_rad)
    turn_rad = math.pi if around_pole else math.asin(math.sin(cap_rad) / math.cos(lat_rad))
    turn_rad += math.radians(job.recipe.config.model.direction_tolerance_deg) + _SLACK_RAD
    suns = job.conditions.sun_directions()[job.conditions.reachable]
    return SunRays.towards(suns, turn_rad)


_surroundings = timed("terrain beyond the area", is_stage=False)(surroundings)
_surrounded = timed("relief", is_stage=False)(build_surrounded)


def _terrain(job: AreaJob) -> tuple[Terrain, Decision]:
    """The terrain, its core the area with its halo, with the terrain around that can hide it from a view
    or shadow it under its Suns, up to the configured distance; and the decision about that.
    """
    config = job.recipe.config
    window = job.task.window.grown(config.points.halo_nodes(config.gsd_m))
    ground = Ground(job.recipe.dems, job.task.frame, window, config.gsd_m)
    limit_m = config.model.ring_max_km * 1e3
    view_rad = np.radians(90.0 - lowest_off_nadir_deg(config))
    tangent = float(np.tan(view_rad)) if view_rad < np.pi / 2 else math.inf
    view_m = ring_for_rays_m(ground, tangent, limit_m)
    around = _surroundings(ground, _sun_rays(job), view_m, limit_m)
    terrain = _surrounded(ground, around)
    needed_m = max(around.needed_m, view_m)
    return terrain, ring_decision(terrain, around.ring_m, needed_m, limit_m)


class _Core:
    """The core of an area's terrain: the positions of its nodes (NaN in the halo), and which of them
    belong to the area.
    """

    def __init__(self, job: AreaJob, terrain: Terrain) -> None:
        self.terrain, self.halo = terrain, job.recipe.config.points.halo_nodes(job.recipe.gsd_m)
        r0, r1, c0, c1 = terrain.core
        self.z = terrain.field.z_m[r0:r1, c0:c1]
        self.inner = np.s_[self.halo : -self.halo, self.halo : -self.halo]
        """Without the halo."""
        halo = self.halo
        lon, lat = self._places((r0 + halo, r1 - halo, c0 + halo, c1 - halo))
        self.lon, self.lat = np.full((2, *self.z.shape), np.nan)
        self.lon[self.inner], self.lat[self.inner] = lon, lat
        row, column = job.grid.owner(lon, lat)
        self.mine = np.zeros(self.z.shape, np.bool_)
        own = (row == job.task.row) & (column == job.task.column)
        self.mine[self.inner] = own & job.recipe.region.contains(lon, lat)
        self.useful = np.isfinite(self.z) & np.isin(
            terrain.product_index[r0:r1, c0:c1], job.recipe.sources
        )

    def places(self, rows: Index, cols: Index) -> Places:
        """Longitudes and latitudes of nodes without the halo."""
        return Places(self.lon[rows, cols], self.lat[rows, cols])

    def _places(self, window: Window) -> tuple[Array, Array]:
        """Longitude and latitude of every node of the window; without a height those on the sphere."""
        r0, r1, c0, c1 = window
        field, z = self.terrain.field, self.terrain.field.z_m[r0:r1, c0:c1]
        x, y = np.meshgrid(
            field.x0_m + np.arange(c0, c1) * field.gsd_m,
            field.y0_m - np.arange(r0, r1) * field.gsd_m,
        )
        z = np.where(np.isfinite(z), z, -(x**2 + y**2) / (2.0 * MOON_RADIUS_M))
        lon, lat, _ = mcmf_to_lonlat(self.terrain.frame.to_mcmf(np.stack([x, y, z], axis=-1)))
        return lon, lat

    @property
    def origin(self) -> tuple[int, int]:
        """Row and column of node [0, 0], counted from the frame's origin, as the spacing cells are."""
        window = self.terrain.window
        return window.row0 + self.terrain.core[0], window.col0 + self.terrain.core[2]


def _find(sweep: Sweep, core: _Core, config: BuildConfig) -> tuple[Index, Index]:
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
        spacing_px=config.points.spacing_nodes(config.gsd_m),
        per_cell=config.points.candidates_per_cell,
        border=core.halo,
        valid=core.mine & core.useful,
        origin=core.origin,
    )


def _evaluated(job: AreaJob, core: _Core, sweep: Sweep, rows: Index, cols: Index) -> Candidates:
    """Evaluate the candidates in groups of similar convergence, each with Suns turned to its own north."""
    config = job.recipe.config
    half = config.points.half
    whole = _has_whole_patch(core.useful, rows, cols, half)
    rows, cols = rows[whole], cols[whole]
    found = _patches(core.places(rows, cols), job.recipe)
    # the nodes of a patch, in its own frame, are not quite those of the area
    kept: Mask = np.all(np.isfinite(found.z_m), axis=(1, 2))
    kept &= np.isin(found.product, job.recipe.sources)
    if found.albedo is not None and sweep.brightness is not None:
        kept &= _known_alike(sweep.brightness, rows, cols, half, found.albedo)
    rows, cols, found = rows[kept], cols[kept], found.rows(kept)
    at = core.places(rows, cols)
    errors = _place_errors(job.recipe, at, found.product)
    turns = _turns(core.terrain.frame, at, config)
    sites = _sites(rows, cols, turns) if job.sites is None else job.sites
    how = first_look if job.step == FIRST else evaluate
    parts = Evaluation.empty(len(rows), len(config.points.scales), sweep.conditions.shape)
    for turn in np.unique(turns):
        group = np.flatnonzero(turns == turn)
        ends, sides = sites["box"][group[0]].astype(np.int64)
        part, row0, col0 = sweep.around(ends, sides, core.halo, float(turn))
        own = how(part, rows[group] - row0, cols[group] - col0, config, errors.rows(group))
        parts.put(group, own)
    return Candidates(
        at.lon_deg,
        at.lat_deg,
        found.elevation_m,
        found.z_m,
        found.product,
        parts,
        found.albedo,
        sites,
        errors.slope_sigma,
    )


def _sites(rows: Index, cols: Index, turns: Array) -> AnyArray:
    """The sites of candidates, of which those with the same turn are evaluated together."""
    sites = np.zeros(len(rows), SITE)
    sites["row"], sites["column"] = rows, cols
    for turn in np.unique(turns):
        group = turns == turn
        sites["box"][group] = [[at[group].min(), at[group].max()] for at in (rows, cols)]
    return sites


def _place_errors(recipe: Recipe, at: Places, product: Int16) -> PlaceErrors:
    """Error models of the candidates: the build's figures, or those of their maps and DEMs (`Recipe.by_place`)."""
    sigma, length = height_errors(recipe.dems, at.lon_deg, at.lat_deg, recipe.maps, product)
    by_place, unknown = recipe.by_place, np.full(len(product), np.nan)
    return PlaceErrors.of_heights(
        recipe.errors,
        sigma if "height_sigma_m" in by_place else unknown,
        length if "height_length_m" in by_place else unknown,
        (recipe.config.points.error_step or STEP) if recipe.maps else None,
        PLACE_PER_LENGTH * length if "position_sigma_m" in by_place else None,
    )


def _has_whole_patch(useful: Mask, rows: Index, cols: Index, half: int) -> Mask:
    whole = [
        useful[r - half : r + half + 1, c - half : c + half + 1].all()
        for r, c in zip(rows, cols, strict=True)
    ]
    return np.array(whole, dtype=np.bool_)


def _turns(frame: EnuFrame, at: Places, config: BuildConfig) -> Array:
    """Azimuth of each point's north in the area's frame, radians, rounded to twice the direction tolerance."""
    north = enu_rotation(at.lon_deg, at.lat_deg)[:, 1]
    east_up = frame.direction_from_mcmf(north)
    turn = np.arctan2(east_up[:, 0], east_up[:, 1])
    step = 2.0 * np.radians(config.model.direction_tolerance_deg)
    return np.asarray(np.round(turn / step) * step)


def _known_alike(
    brightness: Float32,
    rows: Index,
    cols: Index,
    half: int,
    patches: Float32,
) -> Mask:
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

    z_m: Float32
    elevation_m: Array
    product: Int16
    albedo: Float32 | None

    def rows(self, some: Mask) -> _Found:
        """A selection of the candidates."""
        albedo = None if self.albedo is None else self.albedo[some]
        return _Found(self.z_m[some], self.elevation_m[some], self.product[some], albedo)


def _patches(at: Places, recipe: Recipe) -> _Found:
    """The candidates' patches, with the albedo factors of the same nodes."""
    size, gsd_m = recipe.config.points.patch_nodes, recipe.gsd_m
    found = sample_patches(recipe.dems, at.lon_deg, at.lat_deg, size, gsd_m)
    frames = [patch.frame for patch in found]
    z = np.array([patch.z_m for patch in found], dtype=np.float32).reshape(-1, size, size)
    return _Found(
        z,
        np.array([frame.height_m for frame in frames]),
        np.array([patch.product for patch in found], dtype=np.int16),
        recipe.albedo.patches(frames, z, gsd_m) if recipe.albedo else None,
    )
