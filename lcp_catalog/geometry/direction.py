"""A direction at a place: one value that gives its vector and its angles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from .frames import EnuFrame, azimuth_elevation, direction_enu


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction to the Sun, the Earth or a camera in the east-north-up (ENU) frame of a place.

    ``vector`` (3,): unit vector east, north, up. The angles are computed from the vector. NumPy
    functions take a `Direction` as its vector. ValueError for a vector that is not finite, is zero
    or has another shape.
    """

    vector: Array

    def __post_init__(self) -> None:
        vector = np.asarray(self.vector, dtype=np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
            raise ValueError(f"no such direction: {vector.tolist()}")
        object.__setattr__(self, "vector", vector)

    @classmethod
    def of(cls, direction: Direction | ArrayLike) -> Direction:
        """The direction itself, or a `Direction` from an ENU vector (3,)."""
        return direction if isinstance(direction, Direction) else cls(np.asarray(direction))

    @classmethod
    def from_angles(cls, azimuth_deg: float, elevation_deg: float) -> Direction:
        """From an azimuth, clockwise from north, and an elevation above the horizontal, degrees."""
        return cls(direction_enu(azimuth_deg, elevation_deg))

    @classmethod
    def from_mcmf(cls, direction_mcmf: ArrayLike, frame: EnuFrame) -> Direction:
        """From an MCMF vector (3,), in the axes of a frame."""
        return cls(frame.direction_from_mcmf(direction_mcmf))

    @cached_property
    def azimuth_rad(self) -> float:
        """Azimuth clockwise from north, -pi..pi; 0 for a vertical direction."""
        east, north, _ = self.vector
        return math.atan2(east, north)

    @cached_property
    def elevation_rad(self) -> float:
        """Elevation above the horizontal, -pi/2..pi/2."""
        east, north, up = self.vector
        return math.atan2(up, math.hypot(east, north))

    @cached_property
    def azimuth_deg(self) -> float:
        """Azimuth clockwise from north, 0 <= azimuth < 360; 0 for a vertical direction."""
        return float(azimuth_elevation(self.vector)[0])

    @cached_property
    def elevation_deg(self) -> float:
        """Elevation above the horizontal, -90..90."""
        return float(azimuth_elevation(self.vector)[1])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.vector, dtype=dtype, copy=copy)
