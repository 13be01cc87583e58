"""Figures of the error model at single points: a point has those of its own DEM or map (`production.recipe.Recipe.by_place`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..arrays import Array, Index
from ..dem.products import LENGTH_PER_RESOLUTION, PLACE_PER_LENGTH
from ..landmarks.error_model import ErrorModel

if TYPE_CHECKING:
    from .catalogue import Catalog


def error_figure(catalog: Catalog, name: str, rows: Index) -> Array:
    """A figure of the error model at points (rows (n,)): ``height_sigma_m``, ``height_length_m`` or
    ``position_sigma_m``, (n,) metres. Where ``errors`` has it "by_place", it is the product's that is stated there, or
    else by the point's ``elevation_sigma`` or ``dem_resolution``; one for all points otherwise.
    """
    found = np.full(len(rows), getattr(ErrorModel.from_dict(catalog.errors), name))
    known = catalog.errors.get("by_place", {}).get(name)
    if known is None:
        return found
    per_m = LENGTH_PER_RESOLUTION * (PLACE_PER_LENGTH if name == "position_sigma_m" else 1.0)
    of_height = name == "height_sigma_m"
    own = catalog.elevation_sigma[rows] if of_height else per_m * catalog.dem_resolution[rows]
    found = np.where(np.isfinite(own), own, found)
    product = catalog.part("dem_product", rows)
    for named, figure in known.items():
        found[product == named] = figure
    return found


def slope_sigma(catalog: Catalog, rows: Index) -> Array:
    """1 sigma (n,) of the slopes' errors at points (rows (n,)): that of heights over their correlation length."""
    heights = error_figure(catalog, "height_sigma_m", rows)
    return heights / error_figure(catalog, "height_length_m", rows)
