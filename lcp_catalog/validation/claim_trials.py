"""Trials of a catalogue's claims in an image: a search for every point in view as the claims assume
it.

The claim of a point is that a search within the catalogue's search radius finds the true place and
no other. The final matches of `matching.position_fix` come from a search of a few pixels, which is
easier. Therefore every point with a claim is searched for once more, in the image as it was searched
(`matching.point_choice.working_image`), within the radius of the build. These searches do not use
the claims, which they judge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array, Index, Mask
from ..cameras.sensor import Sensor, ground_errors_m, pixel_size_m
from ..catalog.catalogue import Catalog
from ..catalog.origins import origins
from ..catalog.patch_terrain import nodes_mcmf
from ..images.image import Image
from ..matching.matches import CODE, Matches
from ..matching.point_choice import points_in_view, working_image
from ..matching.point_claims import NO_CLAIM, claimed
from ..matching.point_search import Criteria, find_points
from ..photometry.laws import Reflectance
from .claims import GATE_PX, GATE_SIGMAS, Claims, squared_distance

NO_TRIAL = tuple(CODE[reason] for reason in ("at the edge", "no data", "saturated"))
"""Codes of points whose surroundings the image does not show."""

SHOWN_SHARE = 0.9
"""Least share of a patch's nodes on valid pixels: a claim is about a patch that the image shows."""

_AT_ONCE = 256
_SEARCH_NODES = 64
"""Search radius of a build that does not state one, cells."""


@dataclass(frozen=True, eq=False)
class ClaimSearch:
    """Search for the points of a catalogue in an image, as their claims assume it.

    ``image``: at full resolution, with the best sensor known. ``true``: sensor that predicts the true
    places for the errors; None: the image's own. ``criteria``: those of the search that located the
    image.
    """

    catalog: Catalog
    image: Image
    model: Reflectance
    criteria: Criteria
    true: Sensor | None = None

    def claims(self, rows: Index, searched: bool) -> Claims:
        """Claims on points (rows (n,) of the catalogue) and results of their search. ``searched``:
        False if the image's sensor is too uncertain to tell true places, so that there is no trial.
        """
        if not len(rows):
            return Claims.none(reason="no point is in view")
        working = working_image(self.catalog, self.image, rows)
        claims = self._stated(working, rows)
        inside = np.isin(rows, points_in_view(self.catalog, self.image.sensor))
        inside[inside] = self._shown(working, rows[inside])
        if not claims.claimed.any():
            reason = "the catalogue claims nothing for this Sun, view and scale"
            return replace(claims, reason=reason)
        if not searched:
            return replace(claims, reason="the image was not located")
        return self._tried(working, rows, np.flatnonzero(claims.claimed & inside), claims)

    def _stated(self, working: Image, rows: Index) -> Claims:
        """The claims, without trials."""
        suns = working.sun_directions(self.catalog.position_mcmf[rows])
        stated = claimed(self.catalog, rows, working.sensor, suns)
        sigma = np.stack([stated.sigma_major_m, stated.sigma_minor_m], axis=-1)
        return replace(
            Claims.none(len(rows)),
            probability=np.asarray(stated.detection_probability, np.float64),
            usable=np.asarray(stated.usable, bool),
            sigma_m=sigma.astype(np.float64),
            angle_deg=np.asarray(stated.sigma_angle_deg, np.float64),
        )

    def _shown(self, working: Image, rows: Index) -> Mask:
        """True for points whose patch lies in the image, with at least `SHOWN_SHARE` of its nodes on
        valid pixels, (n,).
        """
        height, width = working.signal.shape
        shown = np.zeros(len(rows), np.bool_)
        for start in range(0, len(rows), _AT_ONCE):
            part = rows[start : start + _AT_ONCE]
            pixels = working.sensor.project(nodes_mcmf(self.catalog, part))
            column, row = np.moveaxis(
                np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64), -1, 0
            )
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            valid = working.valid[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
            enough = valid.mean(axis=(1, 2)) >= SHOWN_SHARE
            shown[start : start + _AT_ONCE] = inside.all(axis=(1, 2)) & enough
        return shown

    def _tried(self, working: Image, rows: Index, chosen: Index, claims: Claims) -> Claims:
        """The claims with trials of some of them, ``chosen`` (m,)."""
        places = self.catalog.position_mcmf[rows[chosen]]
        sensor, factor = self.image.sensor, working.sensor.factor
        matches = find_points(
            self.catalog,
            working,
            self.model,
            search_radius_m(self.catalog, rows[chosen]) / pixel_size_m(sensor, places),
            points=rows[chosen],
            criteria=replace(self.criteria, prior=NO_CLAIM),
        )
        offset = matches.found_px - sensor.project(places)
        sigmas = np.sqrt(
            squared_distance(
                self._error_m(sensor, rows[chosen], matches), claims.covariance_m2[chosen]
            )
        )
        at_place = (sigmas <= GATE_SIGMAS) | (np.linalg.norm(offset, axis=-1) <= GATE_PX * factor)
        tried, found, error = claims.tried.copy(), claims.found.copy(), claims.error_m.copy()
        tried[chosen] = ~np.isin(matches.code, NO_TRIAL)
        found[chosen] = matches.found & at_place
        error[chosen] = self._error_m(self.true or sensor, rows[chosen], matches)
        return replace(claims, tried=tried, found=found, error_m=error)

    def _error_m(self, sensor: Sensor, rows: Index, matches: Matches) -> Array:
        """Places found minus those that a sensor predicts, metres on the ground."""
        places = self.catalog.position_mcmf[rows]
        offset = matches.found_px - sensor.project(places)
        return ground_errors_m(sensor, places, self.catalog.rotation_mcmf_to_enu[rows], offset)


def search_radius_m(catalog: Catalog, rows: Index) -> Array:
    """Search radius (n,) of points, metres, from the configuration of the build or, in a merged
    catalogue, of the builds with cells of the point's size.
    """
    gsd_m = catalog.gsd[rows].astype(np.float64)
    radius = _SEARCH_NODES * gsd_m
    builds = origins(catalog.config)
    for config in (build.config for build in builds):
        search_m = config.get("points", {}).get("search_m")
        if search_m is not None:
            own = (gsd_m == config.get("area", {}).get("gsd_m")) | (len(builds) == 1)
            radius[own] = search_m
    return radius
