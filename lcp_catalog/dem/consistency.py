"""Agreement of two products of a set in the area that they share, within their published
uncertainties.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..geometry.bounds import Bounds
from .mosaic import DemSet

log = logging.getLogger(__name__)

UNKNOWN_SIGMA_M = 10.0
"""1 sigma assumed for a product whose uncertainty is not published."""
FACTOR = 3.0
"""Two products disagree if the median of their absolute differences exceeds this many sigmas of a
difference.
"""

_CLUSTERS = 4  # along a side of the box
_NODES = 8  # along a side of a cluster: places close together are read in one small window
_PLACES_MIN = 30


@dataclass(frozen=True)
class Disagreement:
    """Disagreement of two products at ``places`` that both have: the median absolute difference and
    the limit that their uncertainties explain, metres.

    ``assumed``: those of the two whose uncertainty is not published, taken as `UNKNOWN_SIGMA_M`.
    """

    products: tuple[str, str]
    places: int
    median_m: float
    limit_m: float
    assumed: tuple[str, ...]

    def __str__(self) -> str:
        one, other = self.products
        text = (
            f"{one} and {other} differ by {self.median_m:.1f} m (median of {self.places} places), "
            f"beyond the {self.limit_m:.1f} m that their uncertainties explain"
        )
        if self.assumed:
            names = " and ".join(self.assumed)
            text += f" (that of {names} is not published: {UNKNOWN_SIGMA_M:g} m assumed)"
        return text


def disagreements(dems: DemSet, box: Bounds) -> list[Disagreement]:
    """Pairs of products that disagree in a box of longitudes and latitudes, the worst first.

    About a thousand places are compared, in clusters over the box, each pair at the pixel of the
    coarser one. Two products disagree if the median absolute difference is above `FACTOR` *
    hypot(sigma, sigma). Pairs with fewer than 30 common places are left out.
    """
    if len(dems.layers) < 2:
        return []
    found = []
    for first in range(len(dems.layers)):
        for second in range(first + 1, len(dems.layers)):
            pair = _compared(dems, first, second, box)
            if pair is not None and pair.median_m > pair.limit_m:
                found.append(pair)
    return sorted(found, key=lambda pair: pair.limit_m / pair.median_m)


def warn_of_disagreements(dems: DemSet, box: Bounds) -> None:
    """Log one warning about all products that disagree in a box."""
    found = disagreements(dems, box)
    if found:
        log.warning(
            "%s; terrain across their seam is tilted: check the files, or leave one out",
            "; ".join(map(str, found)),
        )


def _compared(dems: DemSet, first: int, second: int, box: Bounds) -> Disagreement | None:
    """Comparison of two layers; None if they share too few places."""
    layers = dems.layers[first], dems.layers[second]
    gsd_m = max(layer.pixel_m for layer in layers)
    differences = []
    for lon, lat in _clusters(box, gsd_m):
        if not all(layer.holds(lon, lat).any() for layer in layers):
            continue
        one, other = (layer.sample(lon, lat, gsd_m).height for layer in layers)
        differences.append(np.abs(one - other)[np.isfinite(one) & np.isfinite(other)])
    common = np.concatenate(differences) if differences else np.zeros(0)
    if common.size < _PLACES_MIN:
        return None
    facts = [layer.dems[0].facts for layer in layers]
    sigmas = [UNKNOWN_SIGMA_M if f.sigma_m is None else f.sigma_m for f in facts]
    names = layers[0].dems[0].product, layers[1].dems[0].product
    assumed = tuple(name for name, fact in zip(names, facts, strict=True) if fact.sigma_m is None)
    limit_m = FACTOR * math.hypot(*sigmas)
    return Disagreement(names, common.size, float(np.median(common)), limit_m, assumed)


def _clusters(box: Bounds, gsd_m: float) -> list[tuple[Array, Array]]:
    """Clusters of places whose centres are spread evenly over the area of the box; in a cluster
    places are a cell apart.
    """
    share = (np.arange(_CLUSTERS) + 0.5) / _CLUSTERS
    south, north = math.sin(math.radians(box.south)), math.sin(math.radians(box.north))
    step = math.degrees(gsd_m / MOON_RADIUS_M)
    row, column = np.meshgrid(*[(np.arange(_NODES) - (_NODES - 1) / 2.0) * step] * 2)
    places = []
    for z in south + share * (north - south):
        lat = math.degrees(math.asin(z))
        for lon in box.west + share * (box.east - box.west):
            lats = np.clip(lat + row.ravel(), -90.0, 90.0)
            places.append((lon + column.ravel() / math.cos(math.radians(lat)), lats))
    return places
