"""A render as the bytes of a file: bands and tags; and the document of an explained plan."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._version import __version__
from ..constants import FRAME, MOON_RADIUS_M
from .rasters import geotiff, node_transform, orthographic_crs
from .renderer import Rendering
from .scene import Scene

COLOURS = ("red", "green", "blue")


def encode(scene: Scene, result: Rendering) -> bytes:
    """The GeoTIFF of ``lcp render``."""
    bands: dict[str, ArrayLike] = {
        "radiance": result.radiance,
        "sunlit": result.sunlit,
        "visible": result.visible,
        "incidence": result.incidence_deg,
        "emission": result.emission_deg,
        "phase": result.phase_deg,
    }
    units = ["1", "1", "1", "degree", "degree", "degree"]
    if result.position_mcmf_m is not None:
        bands |= dict(zip("xyz", np.moveaxis(result.position_mcmf_m, -1, 0), strict=True))
        units += ["metre"] * 3
        if result.composite is not None:
            bands["composite"] = result.composite
            units.append("1")
        colours = _add_colours(bands, units, result)
        return geotiff(bands, "float64", tags(scene), units=units, colours=colours)
    assert result.height_m is not None
    bands["height"] = result.height_m
    units.append("metre")
    colours = _add_colours(bands, units, result)
    assert scene.gsd_m is not None
    transform = node_transform(*scene.corner_m, scene.gsd_m)
    crs = orthographic_crs(scene.frame)
    return geotiff(bands, "float32", tags(scene), crs, transform, units, colours)


def _add_colours(
    bands: dict[str, ArrayLike], units: list[str], result: Rendering
) -> dict[str, str]:
    """Add the radiance in red, green and blue, if there is one; return the colours of these bands."""
    if result.colour is None:
        return {}
    colours = {f"radiance_{colour}": colour for colour in COLOURS}
    bands |= dict(zip(colours, result.colour, strict=True))
    units += ["1"] * len(colours)
    return colours


def tags(scene: Scene) -> dict[str, str]:
    """The tags of a result; they have no paths and no clock time."""
    frame = scene.frame
    gsd = {} if scene.gsd_m is None else {"gsd_m": repr(float(scene.gsd_m))}
    dems = scene.request.dems
    found = {
        "body": "MOON",
        "frame": FRAME,
        "software": f"lcp {__version__}",
        "center_lon": repr(float(frame.lon_deg)),
        "center_lat": repr(float(frame.lat_deg)),
        "reference_radius_m": repr(MOON_RADIUS_M),
        **gsd,
        "sun_azimuth": repr(scene.sun.azimuth_deg),
        "sun_elevation": repr(scene.sun.elevation_deg),
        "sun_direction_mcmf": json.dumps(frame.direction_to_mcmf(scene.sun).tolist()),
        "camera": json.dumps(scene.view.describe(), sort_keys=True),
        "sun_model": "disc" if scene.light.first.disc is not None else "point",
        "light": json.dumps(scene.light.describe(), sort_keys=True),
        "reflectance": scene.model.name,
        "accuracy": scene.request.accuracy.tier,
        "surface": "heightfield" if scene.plan.relief.modelled else "sphere",
        "dem": json.dumps([dem.path.name for dem in dems.dems] if dems is not None else []),
        "scene_plan": str(scene.plan),
    }
    if scene.request.environment is not None:
        found["environment"] = json.dumps(scene.request.environment.report, sort_keys=True)
    return found | ({"albedo": str(scene.request.albedo)} if scene.request.albedo else {})


def explain(scene: Scene) -> dict[str, Any]:
    """The document of an explained plan: the plan's decisions, and the light."""
    light = scene.light.describe()
    if scene.request.environment is not None:
        light["environment"] = scene.request.environment.report
    return scene.plan.to_json() | {"light": light}
