"""A scene: everything that one image needs, read and decided. `HeightfieldScene` (`pipeline`) and
`SphereScene` (`sphere_pipeline`) are its kinds, so that a caller need not know the surface.
"""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

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


@dataclass(frozen=True, eq=False)
class Scene(ABC):
    """A request with its light, reflectance model, view and scene plan, in the axes of the area's frame.

    ``plan``: the decisions that `expose` follows; ``sources``: every file that was read, except the
    camera's.
    """

    request: Request
    light: Lighting
    model: Reflectance
    view: View
    plan: ScenePlan
    sources: tuple[Path, ...]

    @property
    def sun(self) -> Direction:
        """Direction to the first source."""
        return self.light.first.direction

    @property
    @abstractmethod
    def frame(self) -> EnuFrame:
        """The area's frame; directions to light and camera are in its axes."""

    @property
    @abstractmethod
    def gsd_m(self) -> float | None:
        """Cell size; None in the plane of a camera that needs no nodes."""

    @property
    @abstractmethod
    def window(self) -> NodeWindow:
        """The rendered nodes, counted from the frame's origin; needs a cell size."""

    @property
    @abstractmethod
    def corner_m(self) -> tuple[float, float]:
        """ENU x and y of the first (north-west) node; needs a cell size."""

    @abstractmethod
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
        if camera is None:
            raise CameraError(
                "the view: no ground to see: no node of the area lies among heights of the DEM on all sides; give a larger "
                "area or a larger DEM"
            )
        raise CameraError(f"{camera.name}: the camera sees nothing of the area")
    seen = np.asarray(result.visible, dtype=np.bool_)
    if seen.any() and not np.any(result.radiance[seen] > 0.0):
        name, up = scene.light.first.name, float(scene.light.first.direction.vector[2])
        log.warning(
            "nothing of the ground in the image is lit: %s at an elevation of %.2f deg at the area's centre; the ground is "
            "black",
            f"terrain hides the {name}, which is"
            if up > 0.0
            else f"the {name} is below the horizon,",
            math.degrees(math.asin(min(max(up, -1.0), 1.0))),
        )
    return result
