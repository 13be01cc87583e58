"""Cells between the angles of a catalogue's Suns: what a point needs at a cell's corners to be usable under all
Suns in it, by the rules of `prediction`, except that relief shows alike everywhere in a cell (`landmarks.relief_signal`): too much
where the Sun passes behind a camera. Promises take what points are worth at real moments from `kernels.sun_moments`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Bytes, Index, Mask
from ..ephemeris.solar_position import can_stand
from .prediction import BETWEEN_MARGIN, BEYOND_MARGIN
from .schema import DETECTION_STEP

WIDEST_DEG = 60.0, 30.0
"""Greatest step of the azimuths and of the elevations between which a cell extends; a direction
without a nearer neighbour is a cell of its own.
"""

_SAMPLES = 17
"""Suns along each side of a cell at which the margins are taken."""

_UNREACHED = 251
"""A stored probability above all others."""


@dataclass(frozen=True)
class SunCells:
    """The cells of a grid of Sun elevations (e,) and azimuths (a,), degrees, rising.

    Cell (i, j) extends from elevation i to the next and from azimuth j to the next, the last azimuth
    to the first. ``above``, ``after``: the numbers of the next ones; the own number where the cell
    has no extent; -1 where there is no cell, because the one before ends there.
    """

    elevation: Array
    azimuth: Array
    above: Index
    after: Index

    @classmethod
    def of(cls, elevation_deg: ArrayLike, azimuth_deg: ArrayLike) -> SunCells:
        """The cells of a catalogue's ``sun_elevation`` and ``sun_azimuth``."""
        elevation, azimuth = (np.asarray(a, np.float64) for a in (elevation_deg, azimuth_deg))
        wide, high = WIDEST_DEG
        steps = np.diff(azimuth)
        gap = azimuth[0] + 360.0 - azimuth[-1]
        wraps = len(azimuth) > 1 and gap <= steps.max() + 1e-9
        return cls(
            elevation,
            azimuth,
            _next(np.append(np.diff(elevation), np.inf), high),
            _next(np.append(steps, gap if wraps else np.inf), wide),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Elevations, azimuths."""
        return len(self.elevation), len(self.azimuth)

    def corners(self) -> tuple[Index, Index]:
        """Indices of elevation and azimuth of each cell's four corners, (4, e, a) each; any for what is
        no cell.
        """
        here = np.arange(len(self.elevation)), np.arange(len(self.azimuth))
        rows, columns = (
            np.stack([own, np.where(other < 0, own, other)])
            for own, other in zip(here, (self.above, self.after), strict=True)
        )
        whole = (4, *self.shape)
        return (
            np.broadcast_to(rows[[0, 0, 1, 1], :, None], whole),
            np.broadcast_to(columns[[0, 1, 0, 1], None, :], whole),
        )

    def claims(self, lat_deg: float, known: Mask, limit: float) -> CellClaims:
        """What is needed at the corners, at a latitude (degrees), for a detection probability above the
        ``limit`` in the cell; ``known`` (e, a): directions that are evaluated there.
        """
        corners = known[self.corners()]  # (4, e, a)
        near: Mask = np.any(corners, axis=0) & (self.above >= 0)[:, None] & (self.after >= 0)
        row, column = np.nonzero(near)
        cells = row.astype(np.int64), column.astype(np.int64)
        weight, happens = self._samples(lat_deg, cells)
        own = weight * corners[:, row, column][..., None]
        total = own.sum(axis=0)
        alone = (self.above[row] == row) | (self.after[column] == column)
        happens |= alone[:, None]  # it stands for its surroundings, as where it is evaluated
        happens &= total >= 0.5  # else nothing is claimed
        margin = BETWEEN_MARGIN * (1.0 - (own**2).sum(axis=0)) + BEYOND_MARGIN * (1.0 - total)
        exists, counts = np.zeros(self.shape, np.bool_), np.zeros((4, *self.shape), np.bool_)
        largest = np.zeros(self.shape)
        exists[cells] = happens.any(axis=1)
        counts[:, row, column] = ((own > 1e-9) & happens).any(axis=2)
        largest[cells] = np.where(happens, margin, 0.0).max(axis=1, initial=0.0)
        return CellClaims(exists, counts, _stored_at_least(limit, largest))

    def _samples(self, lat_deg: float, cells: tuple[Index, Index]) -> tuple[Array, Mask]:
        """Weights of the corners (4, n, s) at Suns over n cells, and (n, s) whether the Sun can stand
        there at a latitude.
        """
        share = np.linspace(0.0, 1.0, _SAMPLES)
        ups, ons = (part.ravel() for part in np.meshgrid(share, share, indexing="ij"))
        rises, turns = (
            (grid[after] - grid) % 360.0
            for grid, after in ((self.elevation, self.above), (self.azimuth, self.after))
        )
        up = np.where(rises[cells[0]][:, None] > 0.0, ups, 0.0)
        on = np.where(turns[cells[1]][:, None] > 0.0, ons, 0.0)
        elevation = np.radians(self.elevation[cells[0]][:, None] + up * rises[cells[0]][:, None])
        azimuth = np.radians(self.azimuth[cells[1]][:, None] + on * turns[cells[1]][:, None])
        weight = np.stack([(1 - up) * (1 - on), (1 - up) * on, up * (1 - on), up * on])
        return weight, can_stand(lat_deg, azimuth, elevation)


@dataclass(frozen=True)
class CellClaims:
    """What makes a point usable under all Suns of each cell that can happen at a latitude and for which
    the catalogue makes claims; (e, a).
    """

    exists: Mask
    """True if there are such Suns."""
    counts: Mask
    """(4, e, a): corners that were evaluated and have weight; the point must be usable there."""
    least: Bytes
    """(e, a): least stored detection probability there, in steps of `DETECTION_STEP`."""


def _next(steps: Array, widest: float) -> Index:
    """The number of the next direction of each, by the step to it; see `SunCells`."""
    joined = steps <= widest + 1e-9
    own = np.arange(len(steps))
    ends = ~joined & np.roll(joined, 1)
    return np.where(joined, (own + 1) % len(steps), np.where(ends, -1, own))


def _stored_at_least(least: float, margin: Array) -> Bytes:
    """The least stored probability whose logit exceeds that of the limit by the margin."""
    half = DETECTION_STEP / 2.0
    steps = np.clip(np.arange(_UNREACHED) * DETECTION_STEP, half, 1.0 - half)
    logit = np.log(steps / (1.0 - steps))
    bar = float(np.clip(least - half, 1e-12, 1.0 - 1e-12))
    need = math.log(bar / (1.0 - bar)) + margin
    return np.searchsorted(logit, need - 1e-9).astype(np.uint8)
