"""A scene: everything that one image needs, read and decided. `HeightfieldScene` (`pipeline`) and
`SphereScene` (`sphere_pipeline`) have this protocol, so that a caller need not know the surface.
"""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Protocol

import numpy as np

from ..cameras.view import View, sees_nothing
from ..errors import CameraError
from ..geometry.frames import Direction, EnuFrame
from ..light.sources import Lighting
from ..photometry.laws import Reflectance
from ..terrain.area import NodeWindow
from .plan import ScenePlan
from .renderer import Rendering
from .request import Request

log = logging.getLogger(__name__)


class Scene(Protocol):
    """A request with its place, light, reflectance model, view and scene plan."""

    @property
    def request(self) -> Request:
        """The request that the scene was prepared for."""

    @property
    def frame(self) -> EnuFrame:
        """The area's frame; directions to light and camera are in its axes."""

    @property
    def light(self) -> Lighting:
        """All light sources."""

    @property
    def sun(self) -> Direction:
        """ENU unit vector (3,) to the first source."""

    @property
    def model(self) -> Reflectance:
        """The reflectance model."""

    @property
    def view(self) -> View:
        """The view."""

    @property
    def plan(self) -> ScenePlan:
        """The decisions that `expose` follows."""

    @property
    def sources(self) -> tuple[Path, ...]:
        """Every file that was read, except the camera's."""

    @property
    def gsd_m(self) -> float | None:
        """Cell size; None in the plane of a camera that needs no nodes."""

    @property
    def window(self) -> NodeWindow:
        """The rendered nodes, counted from the frame's origin; needs a cell size."""

    @property
    def corner_m(self) -> tuple[float, float]:
        """ENU x and y of the first (north-west) node; needs a cell size."""

    def expose(self) -> Rendering:
        """Render. CameraError if the camera sees nothing of the area, SunError if nothing is lit."""


def require_visible(scene: Scene, result: Rendering) -> Rendering:
    """The result itself; CameraError if nothing is visible and there is no background. Logs a warning
    if ground is visible and none of it is lit.
    """
    if not result.visible.any() and scene.request.backdrop is None:
        camera = scene.view.sensor
        if scene.view.camera and scene.request.area is None and scene.request.dems is None:
            raise sees_nothing(scene.view.camera)
        raise CameraError(
            f"{camera.name if camera else 'the view'}: the camera sees nothing of the area"
        )
    seen = np.asarray(result.visible, dtype=np.bool_)
    if seen.any() and not np.any(result.radiance[seen] > 0.0):
        first = scene.light.first
        log.warning(
            "nothing of the ground in the image is lit: terrain hides the %s, which is at an elevation of %.2f deg "
            "at the area's centre; the ground is black",
            first.name,
            math.degrees(math.asin(min(max(first.direction.vector[2], -1.0), 1.0))),
        )
    return result
