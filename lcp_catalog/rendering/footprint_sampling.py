"""Means of a map of the Moon over the footprints of pixels, which may differ in size and shape.

A footprint is an ellipse on the surface: ``across`` is its axis across the line of sight, ``along``
the other one, which foreshortening stretches. It is covered by a row of 1, 2, 4 ... round probes. The
value of a probe is interpolated between means of the map over the two nearest of a series of widths,
a factor of 2 apart (Williams 1983, pyramidal parametrics; McCormack et al. 1999, footprint assembly).
This avoids aliasing; the blur is at most the longer axis over `PROBES_MOST`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..arrays import Array
from ..geometry.frames import mcmf_to_lonlat

PROBES_MOST = 16
_RUNGS = (-6, 24)  # widths of 2^-6 to 2^24 pixels of the map


class SurfaceMap(Protocol):
    """A map of values on the surface, such as `photometry.albedo_map.AlbedoMap`."""

    @property
    def gsd_m(self) -> float:
        """Pixel width of the map."""

    def at(self, lon_deg: Array, lat_deg: Array, gsd_m: float) -> Array:
        """Means over cells of width ``gsd_m`` around places; NaN where the map has no value."""


def seen_through(
    ground: SurfaceMap, points_m: Array, across_m: Array, along_m: Array, towards: Array
) -> Array:
    """Means (n,) of a map over footprints: MCMF points (n, 3), axes (n,) in metres, and unit vectors
    (n, 3) in the direction of the longer axis ``along_m``. NaN where the map has no value.
    """
    out = np.empty(len(points_m))
    stretch = np.maximum(along_m, across_m) / across_m
    probes = np.exp2(np.ceil(np.log2(np.minimum(stretch, PROBES_MOST)) - 1e-9)).astype(int)
    width = np.maximum(across_m, along_m / probes)
    for count in np.unique(probes):
        some = np.flatnonzero(probes == count)
        total, known = np.zeros(some.size), np.zeros(some.size)
        for k in range(count):
            step = ((k + 0.5) / count - 0.5) * along_m[some]
            found = _rungs(ground, points_m[some] + step[:, None] * towards[some], width[some])
            total += np.nan_to_num(found)
            known += np.isfinite(found)
        with np.errstate(invalid="ignore"):
            out[some] = total / known
    return out


def _rungs(ground: SurfaceMap, points_m: Array, width_m: Array) -> Array:
    """Means over round probes, interpolated by the logarithm between the two nearest widths."""
    lon, lat, _ = mcmf_to_lonlat(points_m)
    rung = np.clip(np.log2(width_m / ground.gsd_m), *_RUNGS)
    low = np.floor(rung).astype(int)
    share, out = rung - low, np.zeros(rung.size)
    for step in range(low.min(initial=0), low.max(initial=-1) + 2):
        weight = np.where(low == step, 1.0 - share, np.where(low == step - 1, share, 0.0))
        some = np.flatnonzero(weight)
        if some.size:
            out[some] += weight[some] * ground.at(lon[some], lat[some], ground.gsd_m * 2.0**step)
    return out
