"""The first pass of a build of two: all candidates in a few conditions, and an estimate of all others from them.

It evaluates the view nearest to straight down, at the cells' own scale, under every second Sun that can occur, in
elevation and azimuth by turns, as on a chessboard. Every other view is taken to be as that one, every other Sun as the one
nearest to it of those. Which candidates are worth a complete evaluation is decided by it; nothing of it becomes a claim.
"""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np

from ..arrays import Array, Index, Mask
from ..landmarks.error_model import ErrorModel
from .config import BuildConfig
from .evaluation import Evaluation, PlaceErrors, evaluate
from .sweep import Conditions, Sweep


def suns_looked_at(reachable: Mask) -> Mask:
    """The Suns (elevation, azimuth) of the first pass, of those that can occur: every second in both, all if none of those
    occurs.
    """
    row, column = np.indices(reachable.shape)
    some: Mask = reachable & ((row + column) % 2 == 0)
    return some if some.any() else reachable


def first_look(
    sweep: Sweep, rows: Index, cols: Index, config: BuildConfig, errors: ErrorModel | PlaceErrors
) -> Evaluation:
    """`evaluation.evaluate` in some conditions; the others, and the coarser scales, have the values of the nearest."""
    view = straight_down(sweep.conditions)
    suns = suns_looked_at(sweep.conditions.reachable)
    points = replace(config.points, image_scales=1)
    found = evaluate(sweep.some(view, suns), rows, cols, replace(config, points=points), errors)
    whole = Evaluation.empty(len(rows), len(config.points.scales), sweep.conditions.shape)
    if len(rows):
        of = nearest_suns(sweep.conditions.sun_directions(), suns, sweep.conditions.reachable)
        for f in dataclasses.fields(Evaluation):
            own, all_suns = getattr(found, f.name), sweep.conditions.reachable
            taken = own.reshape(*own.shape[:-2], -1)[..., of]
            getattr(whole, f.name)[..., all_suns] = taken
    return whole


def straight_down(conditions: Conditions) -> int:
    """The view nearest to straight down."""
    return int(np.argmin(conditions.off_nadir_deg))


def nearest_suns(directions: Array, some: Mask, others: Mask) -> Index:
    """For each Sun of ``others`` the nearest of ``some``, as an index into the whole grid (elevation, azimuth), flat;
    the first of equally near ones.
    """
    flat = directions.reshape(-1, 3)
    there = np.flatnonzero(some)
    cosine = np.round(flat[np.flatnonzero(others)] @ flat[there].T, 9)
    return np.asarray(there[np.argmax(cosine, axis=1)])
