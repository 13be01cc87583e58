"""Images of line scanners and push-frame cameras: each line from its own position, at its own time.

The image is rendered in parts of successive rows, with whole framelets of a push-frame camera. The rows
of a part share one direction to the Sun, that of the time of its middle. A part lasts so short that the
Sun moves by at most `SUN_MOVES_DEG` from there to its ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ..cameras.scanners import Scanner
from ..geometry.direction import Direction
from ..geometry.frames import EnuFrame
from ..light.sources import Lighting
from .decisions import Decision
from .renderer import Rendering
from .request import Request

SUN_MOVES_DEG = 0.001
"""Greatest angle between the Sun's direction at a line and the direction under which it is rendered."""

_PIXELS_AT_ONCE = 1 << 21
_EFFECT, _UNIT = "motion of the Sun", "deg"


@dataclass(frozen=True, eq=False)
class MovingSun:
    """Light of the lines of a scanner's image: ``light`` at time 0 of the trajectory, in a frame's axes.

    ``deg_per_s``: rate of the Sun's direction; 0 if one direction holds for all lines.
    """

    request: Request
    frame: EnuFrame
    light: Lighting
    deg_per_s: float

    @classmethod
    def of(cls, request: Request, frame: EnuFrame, light: Lighting) -> tuple[MovingSun, Decision]:
        """The light of a request's scanner, and the decision about its motion. Nodes (an image that is
        not in the camera's plane) have one Sun.
        """
        scanner = request.view.scanner
        assert scanner is not None
        lasts = f"its {scanner.shape[0]} lines take {scanner.duration_s:.3g} s"
        sun = request.sun.drift_mcmf(scanner, scanner.duration_s)
        if request.environment is not None or sun is None:
            reason = f"the stated light holds for all lines; {lasts}"
            return cls(request, frame, light, 0.0), Decision(_EFFECT, False, reason, 0.0, _UNIT)
        drift_deg = math.degrees(float(np.linalg.norm(sun)))
        moves = f"{lasts}, in which the Sun moves by {drift_deg:.2g} deg"
        if not request.in_camera_plane or _parts_for(drift_deg) == 1:
            reason = f"{moves}: one direction, that of the middle, for all"
            decision = Decision(_EFFECT, False, reason, 0.5 * drift_deg, _UNIT)
            return cls(request, frame, light, 0.0), decision
        reason = f"{moves}: parts of the image are rendered under the Sun of their own middle"
        decision = Decision(_EFFECT, True, reason, SUN_MOVES_DEG, _UNIT)
        return cls(request, frame, light, drift_deg / scanner.duration_s), decision

    def at(self, seconds: float) -> Lighting:
        """The light at a time of the trajectory."""
        moved = self.request.sun.drift_mcmf(self.request.view.scanner, seconds)
        if self.deg_per_s == 0.0 or moved is None:
            return self.light
        first, *others = self.light.sources
        to_sun = self.frame.direction_to_mcmf(first.direction) + moved
        there = Direction.from_mcmf(to_sun / np.linalg.norm(to_sun), self.frame)
        return replace(self.light, sources=(replace(first, direction=there), *others))


def render_scan(
    scanner: Scanner, sun: MovingSun, rendered: Callable[[Scanner, Lighting], Rendering]
) -> Rendering:
    """Render the plane of a scanner; ``rendered``: the render of a part of it under its light."""
    shots = [rendered(part, sun.at(part.middle_s)) for part in _parts(scanner, sun.deg_per_s)]
    bands: dict[str, Any] = {}
    for name in (one.name for one in fields(Rendering)):
        rows = [getattr(shot, name) for shot in shots]
        axis = 1 if name == "colour" else 0
        bands[name] = None if rows[0] is None else np.concatenate(rows, axis=axis)
    return replace(shots[0], **bands)


def _parts_for(drift_deg: float) -> int:
    return max(1, math.ceil(drift_deg / (2.0 * SUN_MOVES_DEG)))


def _parts(scanner: Scanner, deg_per_s: float) -> Sequence[Scanner]:
    """Parts of an image in the order of its rows, for a Sun of a rate."""
    (rows, cols), drift_deg = scanner.shape, deg_per_s * scanner.duration_s
    count = max(_parts_for(drift_deg), math.ceil(rows * cols / _PIXELS_AT_ONCE))
    return scanner.divided(count)
