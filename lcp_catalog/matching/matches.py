"""Results of the search for control points in an image: expected and found places, and why a point
was not found.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Mask

FOUND = "found"
MEANINGS = {
    FOUND: "where it was found",
    "at the edge": "most of its search area lies outside the image",
    "not lit": "the Sun is below its horizon, or too little of the patch is lit",
    "not seen": "hidden, turned away from the camera, or seen edge-on",
    "low contrast": "too little texture in its render",
    "no data": "too few valid pixels in the image",
    "saturated": "the image is saturated there",
    "weak": "the highest correlation is too low",
    "no peak": "no place in the search area correlates with its render",
    "no exact place": "it correlates, but the fit of its place does not converge near the peak",
    "ambiguous": "another place correlates about as well",
    "not confirmed": "the backward search ended at another place",
    "inconsistent": "contradicts the camera position of the other points",
    "not searched": "the image as a whole has no place from which single points are searched",
}
"""Results of the search for a point: name and meaning; the position in this table is the code."""

REASONS = tuple(MEANINGS)

CODE = {reason: code for code, reason in enumerate(REASONS)}

_NOT_FOUND = ("weak", "no peak", "no exact place", "ambiguous", "not confirmed", "inconsistent")
SEARCHED = tuple(CODE[reason] for reason in (FOUND, *_NOT_FOUND))
"""Codes of points that could be searched for, so that their result is evidence for or against the
place.
"""


@dataclass(frozen=True, eq=False)
class Matches:
    """One row for each of n control points expected in an image. Pixels are (column, row) of the
    full-resolution image.

    ``covariance_px2`` is that of ``found_px``. Both are NaN for a point that was not placed;
    ``correlation`` is NaN if no search was made. ``prior``: detection probability that the catalogue
    claims for the image's Sun, view and scale, NaN without a claim; ``posterior``: probability that
    the place found is the true one, from the prior (one half without a claim) and the two highest
    correlations, NaN for a point that was not placed. Both are NaN if they are not given. ``usable``: the
    catalogue calls the point usable there; False if it is not given.
    """

    point: NDArray[np.int64]  # (n,) row in the catalogue
    predicted_px: Array  # (n, 2) by the given sensor
    found_px: Array  # (n, 2)
    covariance_px2: Array  # (n, 2, 2)
    correlation: Array  # (n,) centred, normalised, at the peak
    second: Array  # (n,) highest peak elsewhere in the search area, NaN: none
    back_px: Array  # (n,) distance at which the backward search ended
    code: NDArray[np.uint8]  # (n,) index into `REASONS`
    prior: Array = field(default_factory=lambda: np.empty(0))  # (n,)
    posterior: Array = field(default_factory=lambda: np.empty(0))  # (n,)
    usable: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))  # (n,)

    def __post_init__(self) -> None:
        if len(self.usable) != len(self.point):
            object.__setattr__(self, "usable", np.zeros(len(self.point), np.bool_))
        for name in ("prior", "posterior"):
            if len(getattr(self, name)) != len(self.point):
                object.__setattr__(self, name, np.full(len(self.point), np.nan))

    @classmethod
    def none(cls) -> Matches:
        """An empty table."""
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
        """True (n,) for the points that were found."""
        return np.asarray(self.code == CODE[FOUND])

    @property
    def offset_px(self) -> Array:
        """Found minus predicted, (n, 2)."""
        return self.found_px - self.predicted_px

    def counts(self) -> dict[str, int]:
        """Number of points of each reason that occurs, in the order of `REASONS`."""
        seen = Counter(self.code.tolist())
        return {reason: seen[code] for code, reason in enumerate(REASONS) if seen[code]}

    @property
    def counted(self) -> str:
        """Number of points of each reason, as text: ``12 found, 30 not lit``."""
        return ", ".join(f"{count} {reason}" for reason, count in self.counts().items())

    def agreeing(self, agrees: Mask) -> Matches:
        """The matches, with those found that do not agree (n,) marked as inconsistent."""
        code = np.where(self.found & ~agrees, CODE["inconsistent"], self.code)
        return replace(self, code=code.astype(np.uint8))


def joined(parts: Sequence[Matches]) -> Matches:
    """Several tables in one, in their order."""
    names = Matches.__dataclass_fields__
    return Matches(
        **{name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
    )
