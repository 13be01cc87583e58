"""Control points sought in an image: where each was expected, where it was found, and why not where it was not."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array

FOUND = "found"
REASONS = (
    FOUND,
    "out of frame",  # its search area does not lie in the image
    "not lit",  # the Sun is below its horizon, or too little of the patch is lit
    "not seen",  # the camera sees it edge-on, from behind, or not at all
    "low contrast",  # its render has too little texture to be placed
    "no data",  # the image has too little that is valid there
    "saturated",
    "weak",  # the highest correlation is too low
    "ambiguous",  # another place correlates about as well
    "not confirmed",  # searched for backwards it is somewhere else
    "inconsistent",  # no camera that agrees with the others sees it there
)
"""What may be said of a point; the place in this list is its code."""

CODE = {reason: code for code, reason in enumerate(REASONS)}


@dataclass(frozen=True, eq=False)
class Matches:
    """One row for each of n control points that should be in an image. Pixels are (column, row) of the image as it came.

    ``covariance_px2`` is that of ``found_px``; what was not found has NaN there and in ``correlation``
    where no search was made.
    """

    point: NDArray[np.int64]  # (n,) row in the catalogue
    predicted_px: Array  # (n, 2) where the sensor, as it was given, puts it
    found_px: Array  # (n, 2)
    covariance_px2: Array  # (n, 2, 2)
    correlation: Array  # (n,) centred, normalised, at the peak
    second: Array  # (n,) the highest peak elsewhere in the search area, NaN: none
    back_px: Array  # (n,) how far off the backward search ended
    code: NDArray[np.uint8]  # (n,) index into `REASONS`

    @classmethod
    def none(cls) -> Matches:
        """Of no points."""
        pixels, figures = np.empty((0, 2)), np.empty(0)
        nothing = np.empty(0, np.uint8)
        return cls(
            np.empty(0, np.int64),
            pixels,
            pixels,
            np.empty((0, 2, 2)),
            figures,
            figures,
            figures,
            nothing,
        )

    def __len__(self) -> int:
        return len(self.point)

    @property
    def found(self) -> NDArray[np.bool_]:
        """Which were found, (n,)."""
        return np.asarray(self.code == CODE[FOUND])

    @property
    def offset_px(self) -> Array:
        """Found minus predicted, (n, 2)."""
        return self.found_px - self.predicted_px

    def counts(self) -> dict[str, int]:
        """How many of each reason, those that occur, in the order of `REASONS`."""
        seen = Counter(self.code.tolist())
        return {reason: seen[code] for code, reason in enumerate(REASONS) if seen[code]}
