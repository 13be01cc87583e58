"""Error models of candidates by their places: height errors differ where maps or several DEMs give
them, all else is common to a build.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray, Array, Index
from ..landmarks.error_model import ErrorModel, PatchErrors
from ..landmarks.localization import Registration, registration

STEP = 0.05
"""Steps of the logarithm to which height errors are rounded, so that candidates share models: at
most 2.5 % of the 1 sigma and of the length.
"""

_LEAST_M = 1e-3


@dataclass(frozen=True, eq=False)
class PlaceErrors:
    """The error models of n candidates: ``which`` (n,) of ``models``."""

    models: tuple[ErrorModel, ...]
    which: Index

    @classmethod
    def alike(cls, model: ErrorModel, count: int) -> PlaceErrors:
        """One model for all candidates."""
        return cls((model,), np.zeros(count, np.int64))

    @classmethod
    def of_heights(cls, model: ErrorModel, sigma_m: Array, length_m: Array) -> PlaceErrors:
        """A build's model with the 1 sigma and the correlation length of height errors (n,) of each
        place; NaN: those of the model. A figure equal to the model's is kept as it is; others are
        rounded to `STEP`.
        """
        base = max(model.height_sigma_m, _LEAST_M), model.height_length_m
        steps = [
            np.rint(
                np.log(np.maximum(np.where(np.isfinite(own), own, figure), _LEAST_M) / figure)
                / STEP
            )
            for own, figure in zip((sigma_m, length_m), base, strict=True)
        ]
        found, which = np.unique(np.stack(steps, axis=1), axis=0, return_inverse=True)
        models = tuple(
            model
            if not step.any()
            else dataclasses.replace(
                model,
                height_sigma_m=float(base[0] * np.exp(STEP * step[0])),
                height_length_m=float(base[1] * np.exp(STEP * step[1])),
            )
            for step in found
        )
        return cls(models, which.reshape(-1))

    def rows(self, some: NDArray[np.int64]) -> PlaceErrors:
        """A selection of the candidates."""
        return PlaceErrors(self.models, self.which[some])

    def registration(
        self, patches: AnyArray, errors: PatchErrors, pixel_m: float, level: Array
    ) -> Registration:
        """`landmarks.localization.registration` of the candidates' patches (n, p, p), each with its
        own model.
        """
        if len(self.models) == 1:
            return registration(patches, errors, self.models[0], pixel_m, level)
        used = np.unique(self.which)
        parts = []
        for number in used.tolist():
            here = np.flatnonzero(self.which == number)
            own = registration(
                patches[here], errors.rows(here), self.models[number], pixel_m, level[here]
            )
            parts.append((here, own))
        return _joined(parts)


def _joined(parts: list[tuple[NDArray[np.intp], Registration]]) -> Registration:
    """Statistics of groups of patches, by their rows, in one."""
    back = np.argsort(np.concatenate([rows for rows, _ in parts]))
    first = parts[0][1]
    columns: dict[str, Any] = {}
    for field in dataclasses.fields(Registration):
        values = [getattr(one, field.name) for _, one in parts]
        columns[field.name] = (
            np.concatenate(values)[back] if isinstance(values[0], np.ndarray) else values[0]
        )
    return dataclasses.replace(first, **columns)
