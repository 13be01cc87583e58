"""What candidates are good for under all Suns of a cell between the directions that were evaluated."""

from __future__ import annotations

import numpy as np

from ..arrays import Bytes, Mask
from ..catalog.packing import packing
from ..catalog.schema import (
    EVALUATED,
    LOCALIZABLE,
    UNIQUE,
    UNOCCLUDED,
    UNSHADOWED,
    Cause,
)
from ..catalog.sun_cells import SunCells
from .area_job import Candidates
from .config import BuildConfig


def cell_stages(candidates: Candidates, config: BuildConfig) -> Bytes:
    """`Cause` of each candidate by view and cell of the Sun grid, (n, view * elevation * azimuth): FEW
    if it is usable under all Suns of the cell, MARGINAL if only at the corners that were evaluated,
    else what stops it at the worst corner; MET (0) where there is no cell.
    """
    condition = candidates.evaluation.condition
    if not len(condition):
        return np.zeros((0, int(np.prod(condition.shape[1:]))), np.uint8)
    known: Mask = np.any((condition & EVALUATED) > 0, axis=(0, 1))
    grid = SunCells.of(config.sun.elevations_deg, config.sun.azimuths_deg)
    claims = grid.claims(float(np.mean(candidates.lat_deg)), known, config.points.min_detection)
    detection = packing("detection_probability", 1.0).packed(candidates.evaluation.detection[:, 0])
    stage = _stages(candidates)
    found = np.full(condition.shape, Cause.FEW, np.uint8)
    enough = np.ones(condition.shape, np.bool_)
    for counts, row, column in zip(claims.counts, *grid.corners(), strict=True):
        np.minimum(
            found, np.where(counts, stage[:, :, row, column], np.uint8(Cause.FEW)), out=found
        )
        enough &= ~counts | (detection[:, :, row, column] >= claims.least)
    found[(found == Cause.FEW) & ~enough] = Cause.MARGINAL
    return np.where(claims.exists, found, 0).astype(np.uint8).reshape(len(condition), -1)


def _stages(candidates: Candidates) -> Bytes:
    """What stops each candidate in each condition, FEW where it is usable, (n, v, e, a)."""
    evaluation = candidates.evaluation
    condition = evaluation.condition
    free = UNSHADOWED | UNOCCLUDED
    return np.select(
        [
            ~np.isfinite(evaluation.sigma_major_m[:, 0]),
            (condition & LOCALIZABLE) == 0,
            (condition & UNIQUE) == 0,
            (condition & free) != free,
        ],
        [Cause.DARK, Cause.FEATURELESS, Cause.AMBIGUOUS, Cause.DEPENDENT],
        Cause.FEW,
    ).astype(np.uint8)
