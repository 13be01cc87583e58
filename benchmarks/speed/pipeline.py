"""A straightforward pipeline that reaches the decisions of `run_area`: Embree shadows and occlusion,
shading in NumPy, cv2.cornerHarris, full-resolution cv2.matchTemplate, statistics in NumPy.

It takes from the library the terrain's heights, the list of conditions, the albedo factors and the
candidates' places. Its work is what `run_area` does: corners of the nadir images, then for every
condition the image with its slope derivatives, at three scales, and for every candidate the
dependence on terrain outside its patch, covariance, rivals and detection probability.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.optimize import brentq

from benchmarks.speed.pipeline_match import Match, probabilities, registered, search, windows
from lcp_catalog.geometry.frames import lonlat_to_mcmf
from lcp_catalog.landmarks.error_model import local_contrast
from lcp_catalog.production.area_job import area_sweep

LIFT_M = 0.05
"""Rays start so far above the nodes: ten times the rounding of a place 60 km from the origin."""
SLOPE_STEP = 0.01
LOMMEL_SEELIGER, LUNAR_LAMBERT = 0, 2


class Surface:
    """Triangles of heightfields, split from north-west to south-east, as Embree holds them."""

    def __init__(self, *fields: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        self.scene = EmbreeScene(robust=True)
        for x, y, z in fields:
            number = np.arange(z.size, dtype=np.int32).reshape(z.shape)
            nw, ne, sw, se = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
            corners = np.stack([nw, sw, se, nw, se, ne], -1).reshape(-1, 3)
            corners = corners[np.isfinite(z.ravel())[corners].all(axis=1)]
            points = np.stack([*np.meshgrid(x, y), np.nan_to_num(z)], -1).reshape(-1, 3)
            TriangleMesh(self.scene, points.astype(np.float32), corners)

    def hidden(self, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """True for points (n, 3) from which the direction is blocked."""
        rays = np.ascontiguousarray(np.broadcast_to(direction, points.shape), dtype=np.float32)
        return np.asarray(self.scene.run(points, rays, query="OCCLUDED")) >= 0


def places(field: Any, window: tuple[int, int, int, int] | None = None) -> tuple[Any, Any, Any]:
    """Coordinates x (cols,) and y (rows,) and heights of a heightfield's window."""
    r0, r1, c0, c1 = window or (0, field.z_m.shape[0], 0, field.z_m.shape[1])
    x = field.x0_m + np.arange(c0, c1) * field.gsd_m
    y = field.y0_m - np.arange(r0, r1) * field.gsd_m
    return x, y, field.z_m[r0:r1, c0:c1]


def starts(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Starts of the rays of all nodes, float32 (n, 3)."""
    lifted = np.stack([*np.meshgrid(x, y), np.nan_to_num(z) + LIFT_M], -1)
    return lifted.reshape(-1, 3).astype(np.float32)


def direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """Unit east, north, up."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    return np.array([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)])


# -- images


def law_factors(law: Any, cos_g: float) -> tuple[float, float]:
    """Factors of mu0 / (mu0 + mu) and of mu0; ValueError for another law."""
    numbers = law.law
    if law.code == LOMMEL_SEELIGER and len(numbers) == 1:
        return 0.25 * numbers[0], 0.0
    if law.code != LUNAR_LAMBERT:
        raise ValueError(f"the pipeline has no {law.name}")
    g = np.degrees(np.arccos(np.clip(cos_g, -1.0, 1.0)))
    share = max(0.0, 1.0 + g * (-0.019 + g * (0.242e-3 - 1.46e-6 * g)))
    surge, width, c, b = numbers[1:5]
    backward = 0.5 * (1.0 - c) / (1.0 + b * b - 2.0 * b * cos_g) ** 1.5
    forward = 0.5 * (1.0 + c) / (1.0 + b * b + 2.0 * b * cos_g) ** 1.5
    opposition = surge / (1.0 + np.tan(np.radians(g) / 2.0) / width)
    f = numbers[0] * (1.0 + opposition) * (1.0 - b * b) * (backward + forward)
    return 2.0 * share * f, (1.0 - share) * f


class Shader:
    """Radiance of the core's nodes, and that of slopes larger by `SLOPE_STEP`."""

    def __init__(self, z: np.ndarray, cell_m: float, law: Any) -> None:
        down, across = (np.asarray(s) for s in np.gradient(z.astype(np.float64), cell_m))
        east, south = -across[1:-1, 1:-1], down[1:-1, 1:-1]
        tilts = ((east, south), (east - SLOPE_STEP, south), (east, south + SLOPE_STEP))
        self.normals = [
            np.stack([e, s, np.ones_like(e)]) / np.sqrt(e * e + s * s + 1.0) for e, s in tilts
        ]
        self.normals = [normal.astype(np.float32) for normal in self.normals]
        self.law = law

    def radiance(self, which: int, sun: np.ndarray, view: np.ndarray) -> np.ndarray:
        """Without shadows: 0 for nodes that face away from the Sun, NaN for those that face away from
        the view."""
        normal = self.normals[which]
        first, second = law_factors(self.law, float(sun @ view))
        mu0, mu = (np.tensordot(d.astype(np.float32), normal, axes=1) for d in (sun, view))
        mu0 = np.maximum(mu0, np.float32(0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            image = np.float32(first) * mu0 / (mu0 + mu) + np.float32(second) * mu0
        return np.where(mu > 0.0, image, np.float32(np.nan))


def filled(image: np.ndarray, size: int) -> np.ndarray:
    """Missing nodes hold the mean of the valid ones in the box around them."""
    missing = np.isnan(image)
    if not missing.any() or missing.all():
        return np.asarray(np.nan_to_num(image))
    known, values = (~missing).astype(np.float32), np.nan_to_num(image)
    total, count = (
        cv2.boxFilter(a, cv2.CV_64F, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT)
        for a in (values, known)
    )
    local = np.where(count > 0.5, total / np.maximum(count, 1.0), values.sum() / known.sum())
    return np.asarray(np.where(missing, local, values), np.float32)


def blurred(image: np.ndarray, scale: int) -> np.ndarray:
    """Through the optics: a Gaussian of 0.5 pixel and the rest of the pixel's own square."""
    kernel = optics(scale)
    return cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REPLICATE)


@lru_cache
def optics(scale: int) -> np.ndarray:
    """Seven samples of a Gaussian whose variance at whole pixels is that of the optics."""
    at = np.arange(-3.0, 4.0)

    def samples(sigma: float) -> np.ndarray:
        kernel = np.exp(-0.5 * (at / sigma) ** 2)
        return np.asarray(kernel / kernel.sum())

    variance = 0.25 + 1.0 / (12.0 * scale**2)
    return samples(brentq(lambda sigma: samples(sigma) @ at**2 - variance, 0.1, 2.0))


def halved(image: np.ndarray) -> np.ndarray:
    rows, cols = (n // 2 * 2 for n in image.shape)
    return cv2.resize(image[:rows, :cols], (cols // 2, rows // 2), interpolation=cv2.INTER_AREA)


def corner_response(image: np.ndarray) -> np.ndarray:
    """Fourth root of cv2's Harris response over its 99th percentile, of one image."""
    lit = image > 0.0
    if not lit.any():
        return np.zeros_like(image)
    low, high = np.percentile(image[lit], [15.865, 84.135])
    scaled = np.nan_to_num(image) / max(0.5 * (high - low), 1e-12)
    response = cv2.cornerHarris(scaled.astype(np.float32), 7, 3, 0.04)
    positive = response[lit & (response > 0.0)]
    top = np.percentile(positive, 99.0) if positive.size else 1.0
    return np.where(lit, np.clip(response / top, 0.0, 1.0) ** 0.25, 0.0)


# -- the pipeline


@dataclass
class Group:
    """Candidates that share the Sun's azimuths: rows and columns in the core, and all others of the
    area."""

    rows: np.ndarray
    cols: np.ndarray
    turn_deg: float
    members: np.ndarray


class Pipeline:
    """All candidates of an area in all conditions; ``found`` is the result."""

    search: Any = staticmethod(search)
    probabilities: Any = staticmethod(probabilities)

    def __init__(self, job: Any, candidates: Any) -> None:
        self.job, self.sweep = job, area_sweep(job)
        self.points, self.errors = job.recipe.config.points, job.recipe.errors
        terrain = self.sweep.terrain
        field, core = terrain.field, terrain.core
        r0, r1, c0, c1 = core
        ring = field.z_m[r0 - 1 : r1 + 1, c0 - 1 : c1 + 1]
        self.shader = Shader(ring, field.gsd_m, self.sweep.model)
        self.field, self.core = field, places(field, core)
        self.starts = starts(*self.core)
        levels = terrain.far.levels if terrain.far else ()
        self.ground = Surface(places(field), *(places(level) for level in levels))
        self.factors = self.sweep.factors
        self.masks: dict[tuple[float, ...], np.ndarray] = {}
        self.groups = self._groups(candidates)
        shape = self.sweep.conditions.shape
        scaled = (len(candidates), 3, *shape)
        self.found = SimpleNamespace(
            condition=np.zeros((len(candidates), *shape), np.uint8),
            detection=np.full(scaled, np.nan),
            sigma_major_m=np.full(scaled, np.nan),
        )

    def _groups(self, candidates: Any) -> list[Group]:
        frame = self.sweep.terrain.frame
        lon, lat = np.radians(candidates.lon_deg), np.radians(candidates.lat_deg)
        here = frame.from_mcmf(
            lonlat_to_mcmf(candidates.lon_deg, candidates.lat_deg, candidates.elevation_m)
        )
        x, y, _ = self.core
        cols = np.rint((here[:, 0] - x[0]) / self.job.recipe.gsd_m).astype(int)
        rows = np.rint((y[0] - here[:, 1]) / self.job.recipe.gsd_m).astype(int)
        north = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], -1)
        towards = frame.direction_from_mcmf(north)
        step = 2.0 * self.job.recipe.config.model.direction_tolerance_deg
        turn = np.rint(np.degrees(np.arctan2(towards[:, 0], towards[:, 1])) / step) * step
        return [
            Group(rows[members], cols[members], float(value), members)
            for value in np.unique(turn)
            for members in [np.flatnonzero(turn == value)]
        ]

    def run(self) -> SimpleNamespace:
        """The decisions and figures of all candidates."""
        self.corners()
        for group in self.groups:
            self.evaluate(group)
        return self.found

    def suns(self, turn_deg: float) -> list[tuple[int, int, np.ndarray]]:
        """Indices and directions of the Suns that occur."""
        of = self.sweep.conditions
        return [
            (e, a, direction(of.sun_azimuth_deg[a] + turn_deg, of.sun_elevation_deg[e]))
            for e, a in np.argwhere(of.reachable)
        ]

    def hidden(self, towards: np.ndarray) -> np.ndarray:
        """Nodes of the core from which a direction is blocked; kept for the next time."""
        key = tuple(towards.tolist())
        if key not in self.masks:
            found = self.ground.hidden(self.starts, towards)
            self.masks[key] = found.reshape(self.core[2].shape)
        return self.masks[key]

    def corners(self) -> np.ndarray:
        """Places of the highest mean response over all Suns in the view straight down."""
        of, shape = self.sweep.conditions, self.core[2].shape
        nadir = int(np.argmin(of.off_nadir_deg))
        view = direction(of.view_azimuth_deg[nadir], 90.0 - of.off_nadir_deg[nadir])
        total = np.zeros(shape)
        for _, _, sun in self.suns(0.0):
            image = self.shader.radiance(0, sun, view)
            image = np.where(self.hidden(sun), 0.0, image)
            total += corner_response(image * self.factors if self.factors is not None else image)
        highest = cv2.dilate(total, np.ones((3, 3), np.uint8))
        return np.argwhere((total >= highest) & (total > 0.0))

    def evaluate(self, group: Group) -> None:
        """Every condition of a group."""
        half, of, shape = self.points.half, self.sweep.conditions, self.core[2].shape
        x, y, z = self.core
        bright = np.full(shape, np.nan) if self.factors is None else self.factors
        contrast = local_contrast(windows(bright, group.rows, group.cols, half))
        self.moving = self.errors.moving(contrast)
        squares = [
            (x[c - half : c + half + 1], y[r - half : r + half + 1],
             z[r - half : r + half + 1, c - half : c + half + 1])
            for r, c in zip(group.rows, group.cols, strict=True)
        ]  # fmt: skip
        alone = [(Surface(square), starts(*square)) for square in squares]
        views = [
            direction(azimuth + group.turn_deg, 90.0 - off)
            for azimuth, off in zip(of.view_azimuth_deg, of.off_nadir_deg, strict=True)
        ]
        hidden = [
            self.hidden(view) if view[2] < 1.0 - 1e-12 else np.zeros(shape, bool) for view in views
        ]
        occluded = [
            self.dependence(group, alone, view, mask)
            for view, mask in zip(views, hidden, strict=True)
        ]
        for e, a, sun in self.suns(group.turn_deg):
            dark = self.hidden(sun)
            cast = self.dependence(group, alone, sun, dark)
            for v, view in enumerate(views):
                bands = [self.shader.radiance(k, sun, view) for k in range(3)]
                if self.factors is not None:
                    bands = [band * self.factors for band in bands]
                bands[0][hidden[v]] = np.nan
                self.judge(group, bands, dark, cast, occluded[v], (v, e, a), view[2])

    def dependence(
        self, group: Group, alone: list[Any], towards: np.ndarray, dark: np.ndarray
    ) -> np.ndarray:
        """Nodes (n, p, p) of the patches from which only terrain outside blocks a direction."""
        half = self.points.half
        faces = np.tensordot(towards.astype(np.float32), self.shader.normals[0], axes=1) > 0.0
        blocked = windows(dark & faces, group.rows, group.cols, half).copy()
        for k in np.flatnonzero(blocked.any(axis=(1, 2))):
            surface, origin = alone[k]
            blocked[k] &= ~surface.hidden(origin, towards).reshape(blocked[k].shape)
        return blocked

    def judge(
        self,
        group: Group,
        bands: list[np.ndarray],
        dark: np.ndarray,
        cast: np.ndarray,
        occluded: np.ndarray,
        at: tuple[int, int, int],
        up: float,
    ) -> None:
        """One condition: ``bands`` are the radiance without cast shadows and that of larger slopes."""
        points, rows, cols = self.points, group.rows, group.cols
        half = points.half
        image = np.where(dark & np.isfinite(bands[0]), np.float32(0.0), bands[0])
        slopes = [
            np.where(dark | np.isnan(image), 0.0, (band - bands[0]) / SLOPE_STEP)
            for band in bands[1:]
        ]
        raw = windows(image, rows, cols, half)
        lit = (np.nan_to_num(raw) > 0.0).mean(axis=(1, 2)) >= points.min_lit_share
        sources = [filled(image, 2 * half + 1), *(np.nan_to_num(s).astype("f4") for s in slopes)]
        seen = windows(sources[0], rows, cols, half)
        unshadowed = windows(bands[0], rows, cols, half)
        change = np.where(cast & np.isfinite(unshadowed), unshadowed - seen, np.float32(0.0))
        whole = np.zeros((len(rows), 3, 2))
        sigma = np.full((len(rows), 3), np.inf)
        for slot, scale in enumerate((1, 2, 4)):
            if scale > 1:
                change = np.stack([
                    halved_change(part, r // (scale // 2), c // (scale // 2))
                    for part, r, c in zip(change, rows, cols, strict=True)
                ])  # fmt: skip
                sources = [halved(source) for source in sources]
            place = (rows // scale, cols // scale, half // scale)
            whole[:, slot], sigma[:, slot] = self._at_scale(scale, sources, place, change, lit, up)
        flags = np.full(len(rows), 1, np.uint8)
        flags |= np.where(whole[:, 0, 1] >= points.min_detection, 2, 0).astype(np.uint8)
        flags |= np.where(whole[:, 0, 0] >= points.min_detection, 4, 0).astype(np.uint8)
        for lost, flag in ((cast, 8), (occluded, 16)):
            share = lost.mean(axis=(1, 2))
            flags |= np.where(share <= points.max_dependence, flag, 0).astype(np.uint8)
        self.found.condition[(group.members, *at)] = flags
        self.found.detection[(group.members, slice(None), *at)] = whole[:, :, 0]
        self.found.sigma_major_m[(group.members, slice(None), *at)] = sigma

    def _at_scale(
        self,
        scale: int,
        sources: list[np.ndarray],
        place: tuple[np.ndarray, np.ndarray, int],
        change: np.ndarray,
        lit: np.ndarray,
        up: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities (n, 2) and sigma_major (n,) in the image of a scale."""
        rows, cols, half = place[0], place[1], place[2] - 1  # no template has the outer nodes
        shown = blurred(sources[0], scale)
        seen = windows(shown, rows, cols, half)
        changed = np.stack([blurred(part, scale) if part.any() else part for part in change])
        alone = seen + changed[:, 1:-1, 1:-1]
        bright = alone > 0.0
        count = bright.sum(axis=(1, 2))
        level = np.where(bright, alone, 0.0).sum(axis=(1, 2)) / np.maximum(count, 1)
        good = np.flatnonzero(lit & (count > 0))
        found, sigma = np.zeros((len(rows), 2)), np.full(len(rows), np.inf)
        if not len(good):
            return found, sigma
        rows, cols, level = rows[good], cols[good], level[good]
        seen, alone = seen[good], np.ascontiguousarray(alone[good])
        unit = level[:, None, None].astype(np.float32)
        parts = [seen, *(windows(source, rows, cols, half) for source in sources[1:])]
        errors = tuple(part / unit for part in parts)
        pixel_m = scale * self.job.recipe.gsd_m
        match = registered(alone / unit, seen / unit, errors, self.errors, pixel_m, up)
        reach = max(1, self.points.search_nodes(self.job.recipe.gsd_m) // scale)
        places_ = self.search(shown, alone, rows, cols, reach)
        own = correlation(alone, seen)
        found[good] = np.stack(
            self.probabilities(match, places_, level, own, self.errors.spread), 1
        )
        place_m = float(self.errors.place_sigma_m(self.job.recipe.gsd_m))
        sigma[good] = sigma_major(match, pixel_m, place_m, self.moving[good])
        return found, sigma


def halved_change(change: np.ndarray, row: int, col: int) -> np.ndarray:
    """A patch's change at half the resolution, on the pixels of the halved image; 0 beyond it."""
    fine = len(change) // 2
    size = 2 * (fine // 2) + 1
    if not change.any():
        return np.zeros((size, size), np.float32)
    top, left = 1 + fine % 2 - row % 2, 1 + fine % 2 - col % 2
    part = np.pad(change, 1)[top : top + 2 * size, left : left + 2 * size]
    return np.asarray(part.reshape(size, 2, size, 2).mean(axis=(1, 3)))


def correlation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    a, b = (x.astype(np.float64) - x.mean(axis=(1, 2), keepdims=True) for x in (a, b))
    product = np.sqrt((a * a).sum((1, 2)) * (b * b).sum((1, 2)))
    return np.where(product > 0.0, (a * b).sum((1, 2)) / np.where(product > 0.0, product, 1.0), 0.0)


def sigma_major(match: Match, pixel_m: float, position_m: float, share: np.ndarray) -> np.ndarray:
    """``share`` (n,): of the covariance by which matches are displaced."""
    whole = (
        share[:, None, None] * match.covariance + match.bias[:, :, None] * match.bias[:, None]
    ) * pixel_m**2
    finite = np.isfinite(whole).all(axis=(1, 2))
    values = np.linalg.eigvalsh(np.where(finite[:, None, None], whole, 0.0))[:, 1]
    return np.where(finite, np.sqrt(np.maximum(values, 0.0) + position_m**2), np.inf)
