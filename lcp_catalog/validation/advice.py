"""What would help where a validation says no or fits badly, and verdicts that the data do not carry.

Check of the encoding of an image of 8 bits: its codes may be proportional to radiance, or those of a display
image (sRGB).

A wrong encoding bends the brightness: the matches stay where they are, with lower correlations. So the
points of a located image are searched near their places in the samples as they are and in the decoded ones.
The decoded ones fit better if the mean gain of artanh(correlation) is above two of its standard errors (a paired
test over the points, as many as share no terrain), and at least half of the points gain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Array
from ..cameras.frame_camera import Camera
from ..catalog.catalogue import Catalog
from ..images.image import Image
from ..landmarks.ground_votes import independent_share
from ..matching.fix import NOT_HERE, Fix
from ..matching.point_choice import evenly, patch_width_px, points_in_view, working_image
from ..matching.point_search import Criteria, find_points
from ..matching.sun_check import fisher_z
from ..photometry.laws import Reflectance
from .ground_comparison import WindowComparison

_MOST = 100
_REACH_PX = 3.0

SIGMAS = 2.0
"""Least gain by which decoded samples fit better, in standard errors."""

_SAID = {
    ("srgb", "srgb"): "decoded as sRGB, which fits better",
    ("srgb", "linear"): "decoded as sRGB: only so the image was located",
    ("linear", "srgb"): "taken as linear, but fit better as sRGB (encoding auto or srgb)",
    ("linear", "linear"): "taken as linear; sRGB does not fit better",
}
"""What was done with the samples, by the encoding used and the better one."""


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
        """How the samples were taken, whether the other way fits better, and the figures, one line."""
        figures = (
            f"median correlation {self.srgb:.3f} as sRGB (codes of a display image), {self.linear:.3f} as linear values; "
            f"{100.0 * self.share:.0f} % of {self.points} points correlate better as sRGB (mean gain of {self.sigmas:.1f} sigma)"
        )
        return f"samples {_SAID[self.used, self.better]}: {figures}"

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
    gain = fisher_z(srgb) - fisher_z(linear)
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


_FAILS, _PLAIN = 0.8, 0.15
"""Share of windows above 0.7 below which windows fail, and by how much it is less for those without texture."""


def turned_or_unlit(
    located: Fix, catalog: Catalog, image: Image, locate: Callable[[Image], Fix]
) -> str:
    """Of an image that was not located: that its Sun is below the horizon, or by which turn it would be located, as
    the end of a sentence; empty if neither is so.
    """
    dark = _unlit(catalog, image)
    return _turned(image, locate) if not dark and located.verdict == NOT_HERE else dark


def _unlit(catalog: Catalog, image: Image) -> str:
    """That the Sun is below the horizon of all points in view, as the end of a sentence; empty if it is not."""
    places = catalog.position_mcmf[points_in_view(catalog, image.sensor)]
    up = places / np.linalg.norm(places, axis=-1, keepdims=True)
    highest = float((up * image.sun_directions(places)).sum(axis=-1).max(initial=-1.0))
    if not len(places) or highest >= 0.0:
        return ""
    deep = np.degrees(-np.arcsin(highest))
    return (
        f"; the Sun is {deep:.1f} deg below the horizon of every point in view: state another Sun"
    )


def _turned(image: Image, locate: Callable[[Image], Fix]) -> str:
    """By which quarter turn about the optical axis an image of a framing camera would be located, as the end of a
    sentence; empty if by none.
    """
    camera = image.sensor.full
    if not isinstance(camera, Camera):
        return ""
    turn = np.eye(3, dtype=np.int64)
    for degrees in (90, 180, 270):
        turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) @ turn
        rotation = turn.astype(np.float64) @ camera.rotation_mcmf_to_camera
        found = locate(image.with_sensor(replace(camera, rotation_mcmf_to_camera=rotation)))
        if found.pose is not None:
            return (
                f"; turned by {degrees} deg about the optical axis it would be located ({found.reason}): multiply "
                f"rotation_mcmf_to_camera from the left by {turn.tolist()}"
            )
    return ""


_OPPOSITE = -0.5


def opposite_advice(windows: WindowComparison) -> str:
    """That light and dark are exchanged between an image and its render, from the median correlation of the windows;
    empty if they are not.
    """
    if not windows.count or not windows.median < _OPPOSITE:
        return ""
    return (
        f"the median correlation of the windows is {windows.median:.2f}: light and dark are exchanged; the stated Sun is "
        "probably opposite (turned by 180 deg), or the image is a negative"
    )


def albedo_advice(windows: WindowComparison) -> str:
    """Advice for windows, compared with a render without an albedo map, that fail where the render has little
    texture; empty for others.
    """
    if windows.count < 2 or windows.share_above(0.7) >= _FAILS:
        return ""
    textured, plain = (
        windows.textured,
        windows.where(windows.contrast < np.median(windows.contrast)),
    )
    high, low = textured.share_above(0.7), plain.share_above(0.7)
    if not high - low >= _PLAIN:
        return ""
    return (
        f"{100 * low:.0f} % of the windows with little texture in the render correlate above 0.7, "
        f"{100 * high:.0f} % of the others: brightness of the ground itself may prevail there; try an albedo map"
    )
