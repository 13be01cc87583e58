"""Claims of a catalogue about its points in one image: the probability of a match before the search,
and the least covariance of a match.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Index, Mask
from ..cameras.sensor import Sensor, altitude_km, ground_slopes, pixel_size_m
from ..catalog.catalogue import Catalog
from ..catalog.prediction import Prediction, predict

NO_CLAIM = 0.5
"""Probability of a match before the search where the catalogue claims nothing."""

LEAST_SIGMA_PX = 0.02
"""1 sigma, each axis, of what a match errs beyond its covariance."""


@dataclass(frozen=True, eq=False)
class PointClaims:
    """Claims about n points. ``probability`` (n,): that a search finds the point; ``covariance_px2``
    (n, 2, 2): of the match, pixels of the searched image; ``usable`` (n,): the catalogue calls it
    usable. NaN, False: no claim.
    """

    probability: Array
    covariance_px2: Array
    usable: Mask

    @classmethod
    def of(
        cls, catalog: Catalog, rows: Index, sensor: Sensor, sun_directions: ArrayLike
    ) -> PointClaims:
        """Claims about rows (n,) of a catalogue in an image of ``sensor`` under Suns (n, 3)."""
        stated = claimed(catalog, rows, sensor, sun_directions)
        probability = np.asarray(stated.detection_probability, np.float64)
        slope = ground_slopes(
            sensor, catalog.position_mcmf[rows], catalog.rotation_mcmf_to_enu[rows]
        )
        covariance = slope @ stated.covariance_m2 @ np.swapaxes(slope, -1, -2)
        return cls(probability, covariance, stated.usable)

    def some(self, part: slice) -> PointClaims:
        """The claims about some of the points."""
        return PointClaims(self.probability[part], self.covariance_px2[part], self.usable[part])


def claimed(catalog: Catalog, rows: Index, sensor: Sensor, sun_directions: ArrayLike) -> Prediction:
    """Prediction for points (rows (n,) of a catalogue) in an image of ``sensor``, whose pixels are those
    of the searched image; ``sun_directions`` (n, 3): unit MCMF vectors.
    """
    places, rotation = catalog.position_mcmf[rows], catalog.rotation_mcmf_to_enu[rows]
    sun = np.einsum("nij,nj->ni", rotation, np.asarray(sun_directions, np.float64))
    view = np.einsum("nij,nj->ni", rotation, sensor.towards(places))
    pixel = pixel_size_m(sensor, places) if len(rows) else np.zeros(0)
    return predict(catalog, rows, sun, view, pixel, altitude_km(sensor, places))


def at_least(covariance: Array, least: Array) -> Array:
    """Covariances (n, 2, 2), raised so that none is smaller in any direction than ``least``
    (n, 2, 2): with least = L L^T, the eigenvalues of L^-1 C L^-T below 1 become 1. Unchanged where
    one of the two is not finite, or ``least`` is singular.
    """
    raised = np.array(covariance, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        area = least[:, 0, 0] * least[:, 1, 1] - least[:, 0, 1] ** 2
        known = np.isfinite(raised).all((1, 2)) & np.isfinite(least).all((1, 2))
        known &= (least[:, 0, 0] > 0.0) & (area > 1e-12 * least[:, 0, 0] * least[:, 1, 1])
    if known.any():
        root = np.linalg.cholesky(least[known])
        inverse = np.linalg.inv(root)
        inner = inverse @ raised[known] @ np.swapaxes(inverse, -1, -2)
        values, axes = np.linalg.eigh(inner)
        outer = root @ axes
        raised[known] = (outer * np.maximum(values, 1.0)[:, None]) @ np.swapaxes(outer, -1, -2)
    return raised
