"""The area of a render, and the distance to which terrain around it can hide it from a view."""

from __future__ import annotations

import math

import numpy as np

from ..cameras.sensor import Sensor
from ..cameras.view import CameraView, View, footprint, looking_camera
from ..constants import HIGHEST_M, LOWEST_M, MOON_RADIUS_M
from ..dem.mosaic import DemSet
from ..errors import AreaError, CameraError
from ..geometry.bounds import Bounds
from ..geometry.frames import EnuFrame, lonlat_to_mcmf
from ..terrain.area import Area, NodeWindow
from ..terrain.relief_bounds import (
    COARSE_NODES,
    COARSE_SLOPE,
    lowest_view_tangent,
    nodes_enu,
    ring_needed_m,
)
from ..terrain.terrain import Terrain, build_terrain
from .axis_place import axis_place
from .request import AreaInView, Request
from .sphere_extent import Extent, SphereArea

RING_MAX_M = 200e3
"""Greatest distance from the area of terrain that is tested for hiding it from the view."""

_EXTENT_MAX_M = 2000e3
_WIDER = "render the plain sphere: `surface` sphere"


def area_of(request: Request, dems: DemSet) -> tuple[Area, bool]:
    """The area of a request, and True if it must grow to hold all terrain, high and low, that the
    camera sees. AreaError if the camera sees nothing of the DEM.
    """
    if isinstance(request.area, AreaInView):
        return Area(*place_in_view(request, request.area, dems), request.area.size_km), False
    if isinstance(request.area, SphereArea):
        raise AreaError(
            f"{request.area.size_km[0]:g} x {request.area.size_km[1]:g} km is too wide for a DEM; {_WIDER}"
        )
    if request.area is not None:
        return request.area, False
    if request.view.sensor is not None:
        return _seen_area(request, request.view.sensor, dems), True
    return _box_area(dems.bounds, request), False


def place_in_view(request: Request, area: AreaInView, dems: DemSet | None) -> tuple[float, float]:
    """Longitude and latitude of the centre of an area in the view of a request's camera. AreaError if
    there is no camera, or if it sees nothing of the DEM; CameraError if it sees nothing of the Moon.
    """
    looks = request.view.sensor
    if looks is None:
        raise AreaError("an area around a camera's view needs a camera")
    if area.axis:
        return axis_place(looks, dems)
    seen = _seen_area(request, looks, dems)
    return seen.lon_deg, seen.lat_deg


def _seen_area(request: Request, looks: Sensor, dems: DemSet | None) -> Area:
    """The footprint of a camera, as far as the DEM covers it."""
    seen = footprint(looks)
    box = _clipped(seen, dems.bounds) if dems is not None else seen
    if box is None:
        assert dems is not None
        raise AreaError(f"{looks.name}: the camera sees {seen}; the DEM covers {dems.bounds}")
    return _box_area(box, request)


def _box_area(box: Bounds, request: Request) -> Area:
    """The area of a box; for a box around a pole, a square centred on the pole."""
    if box.east - box.west < 360.0 - 1e-9:
        return Area.from_bounds(*box)
    for pole, equatorward in ((90.0, box.south), (-90.0, -box.north)):
        if abs(box.north if pole > 0 else box.south) == abs(pole) and equatorward > 0:
            size_km = 2e-3 * MOON_RADIUS_M * math.cos(math.radians(equatorward))
            return Area(0.0, pole, min(size_km, _EXTENT_MAX_M / 1e3))
    wider = "" if request.surface == "sphere" else f", or {_WIDER}"
    raise AreaError(
        f"{box} does not fit into one plane: state `center_deg` and `size_km`, or `bounds_deg`{wider}"
    )


def _clipped(box: Bounds, limit: Bounds) -> Bounds | None:
    """The intersection of two boxes; None if it is empty."""
    south, north = max(box.south, limit.south), min(box.north, limit.north)
    if south >= north:
        return None
    if limit.east - limit.west >= 360.0 - 1e-9:
        return Bounds(box.west, south, box.east, north)
    if box.east - box.west >= 360.0 - 1e-9:
        return Bounds(limit.west, south, limit.east, north)
    shared = []
    for turn in (-720.0, -360.0, 0.0, 360.0, 720.0):
        west, east = max(box.west + turn, limit.west), min(box.east + turn, limit.east)
        if west < east:
            shared.append((east - west, Bounds(west, south, east, north)))
    return max(shared)[1] if shared else None


def require_extent(extent_m: Extent) -> None:
    """Raise AreaError for an extent that is too wide for one plane."""
    width, height = extent_m[1] - extent_m[0], extent_m[3] - extent_m[2]
    if max(width, height) > _EXTENT_MAX_M * (1 + 1e-9):
        raise AreaError(
            f"{width / 1e3:.0f} x {height / 1e3:.0f} km do not fit into one plane "
            f"(limit {_EXTENT_MAX_M / 1e3:.0f} km): state a smaller `size_km` or `bounds_deg`, or {_WIDER}"
        )


def camera_over(frame: EnuFrame, view: View, gsd_m: float, extent_m: Extent) -> CameraView:
    """The view from a position through a camera that shows an extent. CameraError for another view."""
    if not isinstance(view, CameraView):
        raise CameraError("a camera at infinity has no plane: state its altitude, or a camera")
    size_m = (extent_m[1] - extent_m[0], extent_m[3] - extent_m[2])
    camera = looking_camera(frame, view.position_m, gsd_m, size_m)
    return CameraView(view.position_m, camera)


def cells_extent(window: NodeWindow, gsd_m: float) -> Extent:
    """The outline of the cells around a window's nodes."""
    edges = window.col0, window.col1, 1 - window.row1, 1 - window.row0
    west, east, south, north = (gsd_m * (edge - 0.5) for edge in edges)
    return west, east, south, north


def grown(extent_m: Extent, by_m: float) -> Extent:
    x0, x1, y0, y1 = extent_m
    return x0 - by_m, x1 + by_m, y0 - by_m, y1 + by_m


def coarse_terrain(
    dems: DemSet,
    frame: EnuFrame,
    extent_m: Extent,
    gsd_m: float,
    view: View,
) -> Terrain:
    """The area and the terrain around it that could hide it, on coarse nodes."""
    coarse_m = COARSE_NODES * gsd_m
    corners = np.array([[x, y, 0.0] for x in extent_m[:2] for y in extent_m[2:]])
    tangent = lowest_view_tangent(view, corners)
    reach_m = min(RING_MAX_M, (HIGHEST_M - LOWEST_M) / tangent) if tangent > 0 else RING_MAX_M
    reach_m = min(reach_m, _dem_beyond_m(dems.bounds, frame, extent_m) + coarse_m)
    window = NodeWindow.covering(extent_m, coarse_m)
    return build_terrain(dems, frame, window, coarse_m, reach_m)


def _dem_beyond_m(box: Bounds, frame: EnuFrame, extent_m: Extent) -> float:
    """Greatest distance, along an axis of the frame, that a DEM extends beyond an area; inf if it
    extends to the far side of the Moon. It keeps the search around a small DEM short.
    """
    lon, lat = np.linspace(box.west, box.east, 65), np.linspace(box.south, box.north, 65)
    x0, x1, y0, y1 = extent_m
    farthest_m = 0.0
    for edge in ((lon, lat[0]), (lon, lat[-1]), (lon[0], lat), (lon[-1], lat)):
        x, y, z = np.moveaxis(frame.from_mcmf(lonlat_to_mcmf(*edge)), -1, 0)
        if (z < -0.5 * MOON_RADIUS_M).any():
            return math.inf
        beyond = np.maximum(np.maximum(x0 - x, x - x1), np.maximum(y0 - y, y - y1))
        step = np.hypot(np.diff(x), np.diff(y)).max()  # between samples an edge goes no further
        farthest_m = max(farthest_m, float(beyond.max() + step))
    return farthest_m


def height_reach_m(coarse: Terrain, view: View) -> float:
    """Greatest horizontal distance between the points where a ray of the camera meets the terrain and
    where it meets the reference sphere.
    """
    points = nodes_enu(coarse.field, coarse.core)
    height = np.linalg.norm(coarse.frame.to_mcmf(points), axis=-1) - MOON_RADIUS_M
    if not np.isfinite(height).any():
        return 0.0
    margin = COARSE_SLOPE * coarse.field.gsd_m
    highest = min(float(np.nanmax(np.abs(height))) + margin, HIGHEST_M)
    tangent = lowest_view_tangent(view, points)
    return min(highest / tangent, RING_MAX_M) if tangent > 0 else RING_MAX_M


def view_ring_m(coarse: Terrain, view: View) -> float:
    """Distance beyond the area to which terrain can hide it from the view."""
    tangent = lowest_view_tangent(view, nodes_enu(coarse.field, coarse.core))
    if not math.isfinite(tangent):
        return 0.0
    return ring_needed_m(coarse, tangent, COARSE_SLOPE * coarse.field.gsd_m)
