"""Catalogues of lunar control points: a function for every command, and the objects they work on.

The names below are loaded when they are first used, so that ``import lcp_catalog`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from .cameras.camera_file import read_camera as read_camera
    from .cameras.camera_file import read_sensor as read_sensor
    from .cameras.ccsds import cameras_from_ccsds as cameras_from_ccsds
    from .cameras.frame_camera import Camera as Camera
    from .cameras.sensor import Uncertainty as Uncertainty
    from .cameras.spice import SpiceCamera as SpiceCamera
    from .catalog.catalogue import Catalog as Catalog
    from .catalog.comparison import diff as diff
    from .catalog.comparison import inspect as inspect
    from .catalog.verification import open_catalog as open_catalog
    from .dem.mosaic import DemSet as DemSet
    from .dem.public import DemInfo as DemInfo
    from .dem.public import dem_info as dem_info
    from .dem.public import dem_set as dem_set
    from .ephemeris.times import instant_range as instant_range
    from .errors import LcpError as LcpError
    from .exports.cameras import export_cameras as export_cameras
    from .exports.export import export as export
    from .images.image import Image as Image
    from .images.image_file import ImageOptions as ImageOptions
    from .images.image_file import open_image as open_image
    from .light.sun_choice import Sun as Sun
    from .light.sun_choice import SunChoice as SunChoice
    from .light.sun_visibility import sun_at as sun_at
    from .matching.fix import Fix as Fix
    from .matching.point_choice import choose_points as choose_points
    from .matching.point_search import find_points as find_points
    from .matching.position_fix import locate as locate
    from .matching.templates import render_patches as render_patches
    from .navigation.camera_info import CameraInfo as CameraInfo
    from .navigation.camera_info import camera_info as camera_info
    from .navigation.catalogue_page import report as report
    from .navigation.expected_position import Answer as Answer
    from .navigation.expected_position import query as query
    from .navigation.expected_position import query_trajectory as query_trajectory
    from .navigation.site_windows import windows as windows
    from .production.config import BuildConfig as BuildConfig
    from .production.public import build_catalog as build_catalog
    from .production.public import merge as merge
    from .production.warm_up import warm_up as warm_up
    from .rendering.public import render as render
    from .simulation.detector import Detector as Detector
    from .simulation.output import simulate as simulate
    from .tradeoff.report import trade as trade
    from .validation.public import validate as validate

_MODULES = {
    "Answer": "navigation.expected_position",
    "BuildConfig": "production.config",
    "Camera": "cameras.frame_camera",
    "CameraInfo": "navigation.camera_info",
    "Catalog": "catalog.catalogue",
    "DemInfo": "dem.public",
    "DemSet": "dem.mosaic",
    "Detector": "simulation.detector",
    "Fix": "matching.fix",
    "Image": "images.image",
    "ImageOptions": "images.image_file",
    "LcpError": "errors",
    "SpiceCamera": "cameras.spice",
    "Sun": "light.sun_choice",
    "SunChoice": "light.sun_choice",
    "Uncertainty": "cameras.sensor",
    "build_catalog": "production.public",
    "camera_info": "navigation.camera_info",
    "cameras_from_ccsds": "cameras.ccsds",
    "choose_points": "matching.point_choice",
    "dem_info": "dem.public",
    "dem_set": "dem.public",
    "diff": "catalog.comparison",
    "export": "exports.export",
    "export_cameras": "exports.cameras",
    "find_points": "matching.point_search",
    "inspect": "catalog.comparison",
    "instant_range": "ephemeris.times",
    "locate": "matching.position_fix",
    "merge": "production.public",
    "open_catalog": "catalog.verification",
    "open_image": "images.image_file",
    "query": "navigation.expected_position",
    "query_trajectory": "navigation.expected_position",
    "read_camera": "cameras.camera_file",
    "read_sensor": "cameras.camera_file",
    "render": "rendering.public",
    "render_patches": "matching.templates",
    "report": "navigation.catalogue_page",
    "simulate": "simulation.output",
    "sun_at": "light.sun_visibility",
    "trade": "tradeoff.report",
    "validate": "validation.public",
    "warm_up": "production.warm_up",
    "windows": "navigation.site_windows",
}

__all__ = ["__version__", *_MODULES]  # noqa: PLE0604  the keys of the table are strings


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
