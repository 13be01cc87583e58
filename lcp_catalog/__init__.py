"""Catalogues of lunar control points: build, open, render, match, validate.

The names below are loaded when they are first used, so that ``import lcp_catalog`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from .cameras.camera_file import read_camera as read_camera
    from .cameras.frame_camera import Camera as Camera
    from .cameras.sensor import Uncertainty as Uncertainty
    from .catalog.catalogue import Catalog as Catalog
    from .catalog.hdf5 import open_catalog as open_catalog
    from .dem.mosaic import DemSet as DemSet
    from .errors import LcpError as LcpError
    from .images.image_file import open_image as open_image
    from .light.sun_choice import SunChoice as SunChoice
    from .matching.point_choice import choose_points as choose_points
    from .matching.point_search import find_points as find_points
    from .matching.position_fix import locate as locate
    from .matching.templates import render_patches as render_patches
    from .production.config import BuildConfig as BuildConfig
    from .production.run import build_catalog as build_catalog
    from .rendering.pipeline import render as render
    from .rendering.request import Request as Request
    from .rendering.request import ViewChoice as ViewChoice
    from .terrain.area import Area as Area
    from .validation.run import ImageFiles as ImageFiles
    from .validation.run import Validation as Validation
    from .validation.run import validate as validate

_MODULES = {
    "Area": "terrain.area",
    "BuildConfig": "production.config",
    "Camera": "cameras.frame_camera",
    "Catalog": "catalog.catalogue",
    "DemSet": "dem.mosaic",
    "ImageFiles": "validation.run",
    "LcpError": "errors",
    "Request": "rendering.request",
    "SunChoice": "light.sun_choice",
    "Uncertainty": "cameras.sensor",
    "Validation": "validation.run",
    "ViewChoice": "rendering.request",
    "build_catalog": "production.run",
    "choose_points": "matching.point_choice",
    "find_points": "matching.point_search",
    "locate": "matching.position_fix",
    "open_catalog": "catalog.hdf5",
    "open_image": "images.image_file",
    "read_camera": "cameras.camera_file",
    "render": "rendering.pipeline",
    "render_patches": "matching.templates",
    "validate": "validation.run",
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
