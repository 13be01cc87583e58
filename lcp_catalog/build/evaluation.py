"""Evaluation of candidates in every condition: localisable, unique, independent, with the figures for each."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..accuracy import TIERS
from ..arrays import Float32
from ..catalog.schema import EVALUATED, LOCALIZABLE, UNIQUE, UNOCCLUDED, UNSHADOWED
from ..landmarks.corners import fill_missing
from ..landmarks.independence import dependence
from ..landmarks.localization import coarsest_scale, lit_share, localization
from ..landmarks.patches import gather_patches
from ..landmarks.uniqueness import (
    effective_samples,
    expected_correlation,
    false_match_probability,
    second_peak,
)
from ..terrain.far_terrain import FarTerrain
from ..terrain.occlusion import occluded
from .config import BuildConfig
from .sweep import RenderedImage, Sweep

SCALES = (1.0, 2.0**0.5, 2.0, 2.0**1.5, 4.0)
"""Cell sizes at which a patch is evaluated, as multiples of its own."""


@dataclass(frozen=True)
class Evaluation:
    """Results by candidate and condition, shapes (n, view, sun_elevation, sun_azimuth); NaN where not
    evaluated.
    """

    condition: NDArray[np.uint8]
    sigma_major_m: Float32
    sigma_minor_m: Float32
    harris: Float32
    second_peak: Float32
    false_match: Float32
    coarsest_scale: Float32
    shadow_dependence: Float32
    occlusion_dependence: Float32

    @classmethod
    def empty(cls, count: int, shape: tuple[int, int, int]) -> Evaluation:
        """``count`` candidates without results."""
        condition = np.zeros((count, *shape), dtype=np.uint8)
        blank = [
            np.full((count, *shape), np.nan, dtype=np.float32) for _ in dataclasses.fields(cls)[1:]
        ]
        return cls(condition, *blank)

    def with_rows(self, rows: NDArray[np.int64], other: Evaluation) -> Evaluation:
        """A copy in which the given candidates are taken from ``other``."""
        merged = []
        for f in dataclasses.fields(self):
            values = getattr(self, f.name).copy()
            values[rows] = getattr(other, f.name)
            merged.append(values)
        return Evaluation(*merged)


def evaluate(
    sweep: Sweep,
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    config: BuildConfig,
    gsd_m: float,
) -> Evaluation:
    """Evaluate candidates at nodes (rows, cols) of the sweep's window in every condition that can occur."""
    result = Evaluation.empty(len(rows), sweep.conditions.shape)
    if not len(rows):
        return result
    patches = _Patches(sweep, rows, cols, config.points.half)
    hidden = [
        patches.occlusion_dependence(view) for view in range(len(sweep.conditions.off_nadir_deg))
    ]
    shaded: dict[tuple[int, int], Float32] = {}
    for image in sweep.images():
        sun = (image.elevation, image.azimuth)
        if sun not in shaded:
            shaded[sun] = patches.shadow_dependence(*sun)
        at = (slice(None), image.view, image.elevation, image.azimuth)
        result.shadow_dependence[at] = shaded[sun]
        result.occlusion_dependence[at] = hidden[image.view]
        _judge(result, at, image, patches, config, gsd_m)
    return result


def _judge(
    result: Evaluation,
    at: tuple[slice, int, int, int],
    image: RenderedImage,
    patches: _Patches,
    config: BuildConfig,
    gsd_m: float,
) -> None:
    """Evaluate one condition of all candidates."""
    points = config.points
    raw = gather_patches(image.radiance, patches.rows, patches.cols, patches.half)
    # hidden nodes: filled from their surroundings they have no texture, and they count as unlit
    filled = fill_missing(image.radiance, 2 * patches.half + 1)
    seen = gather_patches(filled, patches.rows, patches.cols, patches.half)
    where = localization(seen, points.image_noise)
    localizable = where.localizable(points.max_sigma_px) & (lit_share(raw) >= points.min_lit_share)
    result.sigma_major_m[at] = where.sigma_major_px * gsd_m
    result.sigma_minor_m[at] = where.sigma_minor_px * gsd_m
    result.harris[at] = where.harris
    flags = np.full(len(localizable), EVALUATED, dtype=np.uint8)
    flags |= np.where(localizable, LOCALIZABLE, 0).astype(np.uint8)
    flags |= np.where(result.shadow_dependence[at] <= points.max_dependence, UNSHADOWED, 0).astype(
        np.uint8
    )
    flags |= np.where(
        result.occlusion_dependence[at] <= points.max_dependence, UNOCCLUDED, 0
    ).astype(np.uint8)
    tried = np.flatnonzero(localizable)
    if len(tried):
        search = points.search_nodes(gsd_m)
        peak = second_peak(
            image.radiance, patches.rows[tried], patches.cols[tried], patches.half, search
        )
        true = expected_correlation(seen[tried], points.image_noise)
        column = (tried, *at[1:])
        result.second_peak[column] = peak
        mistaken = false_match_probability(
            true, peak.astype(np.float64), effective_samples(seen[tried])
        )
        result.false_match[column] = mistaken
        result.coarsest_scale[column] = coarsest_scale(
            seen[tried], points.image_noise, SCALES, points.max_sigma_px, points.min_lit_share
        )
        unique = (peak <= points.max_second_peak) & (mistaken <= points.max_false_match)
        flags[tried] |= np.where(unique, UNIQUE, 0).astype(np.uint8)
    result.condition[at] = flags


class _Patches:
    """The candidates' windows in the heightfield, and their dependence on terrain outside."""

    def __init__(
        self, sweep: Sweep, rows: NDArray[np.int64], cols: NDArray[np.int64], half: int
    ) -> None:
        self.sweep, self.rows, self.cols, self.half = sweep, rows, cols, half
        self._field_rows, self._field_cols = rows + sweep.window[0], cols + sweep.window[2]

    def shadow_dependence(self, elevation: int, azimuth: int) -> Float32:
        """Share of each patch's nodes that only terrain outside the patch shadows."""
        direction = self.sweep.conditions.sun_direction(elevation, azimuth, self.sweep.turn_rad)
        return self._dependence(direction, self.sweep.far)

    def occlusion_dependence(self, view: int) -> Float32:
        """Share of each patch's nodes that only terrain outside the patch hides from the camera."""
        direction = self.sweep.conditions.view_direction(view, self.sweep.turn_rad)
        return self._dependence(direction, None)

    def _dependence(self, direction: NDArray[np.float64], far: FarTerrain | None) -> Float32:
        field, half = self.sweep.field, self.half
        if far is not None and not far.matters(field, direction, self.sweep.window):
            far = None  # tested once for all patches
        normals = self.sweep.normals @ direction.astype(np.float32)
        faces = gather_patches(normals > 0.0, self.rows, self.cols, half)
        alone = ~field.occluded_alone(self._field_rows, self._field_cols, half, direction)
        exact = TIERS["reference"]
        full = np.stack(
            [
                ~occluded(
                    field, direction, exact, (r - half, r + half + 1, c - half, c + half + 1), far
                )
                for r, c in zip(self._field_rows, self._field_cols, strict=True)
            ]
        )
        return dependence(alone & faces, full & faces).astype(np.float32)
