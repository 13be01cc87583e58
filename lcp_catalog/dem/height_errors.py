"""Height errors of a DEM: 1 sigma and correlation length, from maps, from a calibration, or from
the product's published figure and the resolution of its heights.

The errors of a DEM that was made by stereo, by filtering or by interpolation hang together over
about what it resolves: nodes that share observations share errors. A length of half the effective
resolution as the standard deviation of the Gaussian autocorrelation makes the errors of nodes one
effective resolution apart correlate by exp(-2) = 0.14.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from .dem import Dem
from .error_maps import ErrorMaps
from .mosaic import DemSet

log = logging.getLogger(__name__)

LENGTH_PER_RESOLUTION = 0.5
"""Correlation length of height errors (l of exp(-r^2 / (2 l^2))) over the effective resolution,
where no calibration gives the length.
"""

UNKNOWN_SIGMA_M = 10.0
"""1 sigma of heights of a product without a figure."""


@dataclass(frozen=True)
class HeightErrors:
    """1 sigma and correlation length of height errors, metres, and their sources."""

    sigma_m: float
    length_m: float
    sigma_source: str
    length_source: str


def errors_of_file(dem: Dem) -> HeightErrors:
    """Height errors of a DEM file: as calibrated, else as published (`products.facts_of`), else
    `UNKNOWN_SIGMA_M`; the length as calibrated, else by the effective resolution
    (`LENGTH_PER_RESOLUTION`).
    """
    facts, found = dem.facts, dem.effective_resolution
    if facts.calibrated_sigma_m is not None:
        sigma = facts.calibrated_sigma_m, facts.calibration
    elif facts.sigma_m is not None:
        sigma = facts.sigma_m, f"{facts.family}: {facts.source}"
    else:
        sigma = UNKNOWN_SIGMA_M, "no figure is known: a default"
    if facts.calibrated_length_m is not None:
        length = facts.calibrated_length_m, facts.calibration
    elif found.is_measured:
        length = (
            LENGTH_PER_RESOLUTION * found.resolution_m,
            f"half of the resolution of the heights: {found.how}",
        )
    elif facts.resolution_m is not None:
        length = (
            LENGTH_PER_RESOLUTION * max(facts.resolution_m, dem.gsd_m),
            "half of the published resolution",
        )
    else:
        length = LENGTH_PER_RESOLUTION * dem.gsd_m, "half of the posting: no resolution is known"
    return HeightErrors(sigma[0], length[0], sigma[1], length[1])


def warn_of_unknown(dems: DemSet, lon_deg: ArrayLike, lat_deg: ArrayLike) -> None:
    """Log a warning that names the files used at places (n,) for whose heights no 1 sigma is known."""
    used = np.unique(dems.product_at(lon_deg, lat_deg))
    facts = {dems.dems[n].path.name: dems.dems[n].facts for n in used[used >= 0].tolist()}
    unknown = [
        name
        for name, fact in facts.items()
        if fact.sigma_m is None and fact.calibrated_sigma_m is None
    ]
    if unknown:
        log.warning(
            "%s: not recognised as a known product (was the file renamed?): a 1 sigma of %g m is assumed for its "
            "heights, and what they resolve is estimated from them; give [errors] height_sigma_m in a BUILD.toml, or "
            "maps: `dem.sigma_map`, `dem.resolution_map`",
            ", ".join(unknown),
            UNKNOWN_SIGMA_M,
        )


def height_errors(
    dems: DemSet,
    lon_deg: ArrayLike,
    lat_deg: ArrayLike,
    maps: ErrorMaps | None = None,
    product: ArrayLike | None = None,
) -> tuple[Array, Array]:
    """1 sigma and correlation length of the height errors at places (n,), metres, both (n,).

    From the maps where they have a value; else those of the file that is used there
    (`errors_of_file`); NaN outside all files. ``product`` (n,): index of that file, -1 for none;
    default: the first by rank whose footprint contains the place (`DemSet.product_at`).
    """
    lon, lat = np.broadcast_arrays(*(np.atleast_1d(a).astype(float) for a in (lon_deg, lat_deg)))
    index = dems.product_at(lon, lat) if product is None else np.atleast_1d(product)
    sigma, length = np.full(lon.size, np.nan), np.full(lon.size, np.nan)
    for number in np.unique(index[index >= 0]).tolist():
        found = errors_of_file(dems.dems[number])
        here = index == number
        sigma[here], length[here] = found.sigma_m, found.length_m
    if maps is not None:
        mapped, resolution = maps.at(lon, lat)
        held = index >= 0
        sigma = np.where(held & np.isfinite(mapped), mapped, sigma)
        length = np.where(
            held & np.isfinite(resolution), LENGTH_PER_RESOLUTION * resolution, length
        )
    return sigma, length
