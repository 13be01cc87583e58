"""The flags of `condition`: under which Suns and views a point is usable."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray
from .schema import EVALUATED, USABLE


def usable(condition: ArrayLike) -> NDArray[np.bool_]:
    """Where a condition has all five flags; any shape."""
    return np.asarray((np.asarray(condition) & USABLE) == USABLE)


def evaluated(condition: ArrayLike) -> NDArray[np.bool_]:
    """Where a condition was evaluated: the Sun comes there; any shape."""
    return np.asarray((np.asarray(condition) & EVALUATED) > 0)


def summarise_usable(condition: ArrayLike, sun_elevation: ArrayLike) -> tuple[AnyArray, AnyArray]:
    """Lowest and highest usable Sun elevation, each (point, view, sun_azimuth) in degrees; NaN
    where none is usable.

    condition: uint8 (point, view, sun_elevation, sun_azimuth).
    """
    works = usable(condition)
    elevation = np.asarray(sun_elevation, dtype=np.float64)[None, None, :, None]
    none = ~works.any(axis=2)
    lowest = np.where(works, elevation, np.inf).min(axis=2, initial=np.inf)
    highest = np.where(works, elevation, -np.inf).max(axis=2, initial=-np.inf)
    lowest[none] = highest[none] = np.nan
    return lowest, highest
