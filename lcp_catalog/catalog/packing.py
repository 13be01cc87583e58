"""Packing of the claims: floating point numbers as whole numbers of one or two bytes, with the
attributes that CF readers need to unpack them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray, Float32
from .schema import DETECTION_STEP

SIGMA_STEPS_PER_CELL = 1000
"""Steps of a stored sigma in the smallest cell of a catalogue."""


@dataclass(frozen=True)
class Packing:
    """Rule of one variable: value = number * ``step``; ``missing`` stands for NaN, ``largest`` for
    itself and everything above.
    """

    dtype: str
    step: float
    largest: int
    missing: int

    def packed(self, values: ArrayLike) -> AnyArray:
        """Whole numbers nearest to the values; NaN becomes ``missing``, negative values 0."""
        array = np.asarray(values, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            number = np.clip(np.rint(array / self.step), 0.0, self.largest)
        return np.where(np.isnan(array), self.missing, number).astype(self.dtype)

    def unpacked(self, numbers: AnyArray) -> Float32:
        """Values as float32, NaN where missing."""
        table = np.arange(self.missing + 1) * self.step
        table[self.missing] = np.nan
        return table.astype(np.float32)[numbers]

    @property
    def attributes(self) -> dict[str, np.generic]:
        """CF attributes ``scale_factor`` and ``_FillValue``."""
        return {
            "scale_factor": np.float32(self.step),
            "_FillValue": np.dtype(self.dtype).type(self.missing),
        }


def sigma_step_m(gsd_m: AnyArray) -> float:
    """Step of the stored sigmas: a thousandth of the smallest cell, rounded to a float32."""
    smallest = float(np.min(gsd_m)) if np.size(gsd_m) else 1.0
    return float(np.float32(smallest / SIGMA_STEPS_PER_CELL))


def packing(name: str, sigma_step_m: float) -> Packing:
    """Rule of a variable of `schema.PACKED`."""
    if name == "detection_probability":
        return Packing("u1", DETECTION_STEP, 250, 255)
    if name == "sigma_angle":
        return Packing("u1", 1.0, 180, 255)
    return Packing("u2", sigma_step_m, 65534, 65535)


def axis_direction(angle_deg: ArrayLike) -> NDArray[np.float64]:
    """Directions of an axis in whole degrees, 0..179."""
    whole = np.array(np.rint(np.asarray(angle_deg, dtype=np.float64)) + 0.0)
    outside = (whole < 0.0) | (whole >= 180.0)  # np.mod takes ten times as long for NaN
    np.mod(whole, 180.0, out=whole, where=outside)
    return whole
