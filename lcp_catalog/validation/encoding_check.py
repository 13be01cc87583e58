"""Check of the encoding of an image of 8 bits: its codes may be proportional to radiance, or those of a display
image (sRGB).

A wrong encoding bends the brightness: the matches stay where they are, with lower correlations. So the
points of a located image are searched near their places in the samples as they are and in the decoded ones.
The decoded ones fit better if the mean gain of artanh(correlation) is above two of its standard errors (a paired
test over the points, as many as share no terrain), and at least half of the points gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array
from ..catalog.catalogue import Catalog
from ..images.image import Image
from ..matching.consensus import independent_share
from ..matching.point_choice import evenly, patch_width_px, working_image
from ..matching.point_search import Criteria, find_points
from ..matching.position_fix import Fix
from ..photometry.laws import Reflectance

_MOST = 100
_REACH_PX = 3.0

SIGMAS = 2.0
"""Least gain by which decoded samples fit better, in standard errors."""


@dataclass(frozen=True)
class EncodingCheck:
    """Median correlations of ``points`` points in the samples as stored and in the decoded ones; share of the
    points that correlate better in the decoded ones, and their mean gain in standard errors (``sigmas``).
    ``used``: encoding of the result.
    """

    used: str
    points: int
    linear: float
    srgb: float
    share: float
    sigmas: float

    @property
    def better(self) -> str:
        """``srgb`` if the decoded samples fit significantly better, else ``linear``."""
        return "srgb" if self.share >= 0.5 and self.sigmas > SIGMAS else "linear"

    @property
    def sentence(self) -> str:
        """What the check says, one line."""
        figures = (
            f"median correlation {self.srgb:.3f} as sRGB codes, {self.linear:.3f} as linear values; "
            f"{self.share:.0%} of {self.points} points correlate better as sRGB codes "
            f"(gain of {self.sigmas:.1f} sigma)"
        )
        if self.used == self.better:
            return f"used as {self.used}: {figures}"
        return f"used as {self.used}, but fits better as {self.better} (encoding auto or {self.better}): {figures}"

    def figures(self) -> dict[str, Any]:
        """``encoding`` of an image in ``report.json``."""
        return {
            "used": self.used,
            "better": self.better,
            "points": self.points,
            "correlation": {"linear": self.linear, "srgb": self.srgb},
            "preferred_share": self.share,
            "gain_sigmas": self.sigmas,
        }


def check_encoding(
    catalog: Catalog,
    images: tuple[Image, Image],
    located: Fix,
    model: Reflectance,
    criteria: Criteria,
    used: str,
) -> EncodingCheck | None:
    """The check of a located image by at most 100 of its points; ``images``: with the samples as stored and
    decoded. None if no point was found alone.
    """
    assert located.pose is not None
    matches = located.matches
    chosen = evenly(np.flatnonzero(matches.found), _MOST)
    if not len(chosen):
        return None
    rows = matches.point[chosen]
    sensor = located.pose.sensor
    offset = matches.found_px[chosen] - sensor.project(catalog.position_mcmf[rows])

    def correlations(image: Image) -> Array:
        working = working_image(catalog, image.with_sensor(sensor), rows)
        reach = _REACH_PX * working.sensor.factor
        found = find_points(
            catalog, working, model, reach, points=rows, offset_px=offset, criteria=criteria
        )
        return np.nan_to_num(found.correlation)

    linear, srgb = (correlations(image) for image in images)
    gain = _z(srgb) - _z(linear)
    width_px = patch_width_px(catalog, sensor, rows)
    independent = len(rows) * independent_share(matches.found_px[chosen], width_px)
    error = float(gain.std() / np.sqrt(independent))
    return EncodingCheck(
        used=used,
        points=len(rows),
        linear=float(np.median(linear)),
        srgb=float(np.median(srgb)),
        share=float((srgb > linear).mean()),
        sigmas=float(gain.mean()) / error if error > 0.0 else 0.0,
    )


def _z(correlations: Array) -> Array:
    return np.arctanh(np.clip(correlations, -0.999, 0.999))
