"""The place of a render: of the DEMs, the view and the area of a request, the frame, the extent, the
view in the frame's axes and the cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..cameras.frame_camera import Camera
from ..cameras.mistakes import likely_mistake
from ..cameras.sensor import Sensor
from ..cameras.view import CameraView, View, footprint, looking_camera, optical_axis
from ..constants import HIGHEST_M, LOWEST_M, MOON_RADIUS_M
from ..dem.mosaic import DemSet, nearest_heights
from ..errors import AreaError, CameraError
from ..geometry import sphere_intersection
from ..geometry.bounds import Bounds
from ..geometry.frames import EnuFrame, lonlat_to_mcmf, mcmf_to_lonlat
from ..terrain.area import Area, NodeWindow
from ..terrain.relief_bounds import (
    COARSE_NODES,
    COARSE_SLOPE,
    lowest_view_tangent,
    nodes_enu,
    ring_needed_m,
)
from ..terrain.terrain import Ground, Terrain, build_terrain, native_gsd_m, require_room
from .request import AreaInView, Extent, Request, SphereArea

RING_MAX_M = 200e3
"""Greatest distance from the area of terrain that is tested for hiding it from the view."""

_EXTENT_MAX_M = 2000e3
_AXIS_STEPS = 1024
_WIDER = "render the plain sphere: `surface` sphere"


@dataclass(frozen=True, eq=False)
class TerrainPlace:
    """Where a request on terrain is rendered: the nodes and their DEMs, the view in the frame's axes, and
    the distance ``ring_m`` to which terrain around the nodes can hide them from the view.
    """

    ground: Ground
    view: View
    ring_m: float


@dataclass(frozen=True, eq=False)
class SpherePlace:
    """Where a request on the plain sphere is rendered: frame, view in its axes, and the extent and cell of
    nodes; in the plane of a given camera the cell is None, and the extent None for all that it sees.
    """

    frame: EnuFrame
    view: View
    gsd_m: float | None
    extent_m: Extent | None


def place_on_terrain(request: Request, area: Area, grows: bool) -> TerrainPlace:
    """The place of a request in its area (`area_of`). ``grows``: enlarge the area to hold all that the
    camera sees. AreaError for an area that is too wide for one plane; CameraError for the plane of a
    camera at infinity.
    """
    dems, frame, extent = request.ground, area.frame, area.extent_m
    view = request.view.view(frame)
    gsd_m = native_gsd_m(dems, area) if request.gsd_m is None else request.gsd_m
    _require_extent(extent)
    require_room(NodeWindow.covering(extent, gsd_m))
    if request.in_camera_plane and request.view.plane is None:
        view = _camera_over(frame, view, gsd_m, extent)
    coarse = _coarse_terrain(dems, frame, extent, gsd_m, view)
    if grows:
        extent = _grown(extent, _height_reach_m(coarse, view))
        coarse = _coarse_terrain(dems, frame, extent, gsd_m, view)
    ground = Ground(dems, frame, NodeWindow.covering(extent, gsd_m), gsd_m)
    return TerrainPlace(ground, view, _view_ring_m(coarse, view))


def place_on_sphere(request: Request) -> SpherePlace:
    """The place of a request on the plain sphere; a DEM, if there is one, gives area and cell where the
    request has none. AreaError without an area or a cell; CameraError for a camera that sees nothing of
    the Moon or is below the sphere.
    """
    camera = request.view.camera if request.in_camera_plane else None
    frame, extent = _sphere_part(request)
    view = request.view.view(frame)
    if camera is not None:
        return SpherePlace(frame, view, None, extent)
    gsd_m = _sphere_cell(request)
    if gsd_m is None:
        raise AreaError(
            "no cell size: state `gsd_m` (there is no DEM or albedo map to take one from)"
        )
    if extent is None:
        raise AreaError(
            "nodes need an area: state `center` and `size_km`, or `bounds`; "
            "or `frame` camera for all that the camera sees"
        )
    require_room(NodeWindow.covering(extent, gsd_m))
    if request.in_camera_plane:
        view = _camera_over(frame, view, gsd_m, extent)
        extent = cells_extent(NodeWindow.covering(extent, gsd_m), gsd_m)
    return SpherePlace(frame, view, gsd_m, extent)


def _sphere_part(request: Request) -> tuple[EnuFrame, Extent | None]:
    """The frame, and the extent that is rendered. Without an area: all that the camera sees, in the
    frame of the point at the image's centre, or below the camera if that is sky.
    """
    area, camera = request.area, request.view.camera
    if isinstance(area, AreaInView):
        middle_deg = _place_in_view(request, area, None)
        area = SphereArea(middle_deg[0], middle_deg[1], (area.size_km, area.size_km))
    if area is None and request.dems and not (request.in_camera_plane and camera):
        area, _ = area_of(request)
    if area is not None:
        return area.frame, area.extent_m
    if camera is None:
        raise AreaError("no area: state `center` and `size_km`, or `bounds`, or a `camera`")
    require_above(camera.name, float(sphere_intersection.heights(camera.position_mcmf_m)))
    width, height = camera.image_size_px
    _, middle = sphere_intersection.hits(
        camera.position_mcmf_m, camera.rays([(width - 1) / 2, (height - 1) / 2])
    )
    lon, lat = sphere_intersection.lonlat(camera.position_mcmf_m if np.isnan(middle[0]) else middle)
    return EnuFrame(float(lon), float(lat)), None


def _sphere_cell(request: Request) -> float | None:
    if request.gsd_m is not None:
        return request.gsd_m
    if request.dems is not None:
        return min(dem.gsd_m for dem in request.dems.dems)
    return None if request.albedo is None else request.albedo.gsd_m


def area_of(request: Request) -> tuple[Area, bool]:
    """The area of a request, and True if it must grow to hold all terrain, high and low, that the
    camera sees. AreaError if the camera sees nothing of the DEM.
    """
    dems = request.ground
    if isinstance(request.area, AreaInView):
        lon, lat = _place_in_view(request, request.area, dems)
        return Area(lon, lat, request.area.size_km), False
    if isinstance(request.area, SphereArea):
        raise AreaError(
            f"{request.area.size_km[0]:g} x {request.area.size_km[1]:g} km is too wide for a DEM; {_WIDER}"
        )
    if request.area is not None:
        return request.area, False
    if request.view.sensor is not None:
        return _seen_area(request, request.view.sensor, dems), True
    return _box_area(dems.bounds, request), False


def _place_in_view(request: Request, area: AreaInView, dems: DemSet | None) -> tuple[float, float]:
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


def _mistake(sensor: Sensor, dems: DemSet) -> str:
    """The mistake of a camera that sees nothing of the DEM, as the end of a sentence."""

    def sees(camera: Camera) -> bool:
        try:
            return footprint(camera, 17).common(dems.bounds) is not None
        except CameraError:
            return False

    mistake = likely_mistake(sensor, sees)
    return f"; {mistake}" if mistake else ""


def _seen_area(request: Request, looks: Sensor, dems: DemSet | None) -> Area:
    """The footprint of a camera, as far as the DEM covers it."""
    seen = footprint(looks)
    box = seen.common(dems.bounds) if dems is not None else seen
    if box is None:
        assert dems is not None
        raise AreaError(
            f"{looks.name}: the camera sees {seen}; the DEM covers {dems.bounds}{_mistake(looks, dems)}"
        )
    return _box_area(box, request)


def _box_area(box: Bounds, request: Request) -> Area:
    """The area of a box; for a box around a pole, a square centred on the pole."""
    if box.east - box.west < 360.0 - 1e-9:
        return Area.from_bounds(box.west, box.south, box.east, box.north)
    for pole, equatorward in ((90.0, box.south), (-90.0, -box.north)):
        if abs(box.north if pole > 0 else box.south) == abs(pole) and equatorward > 0:
            size_km = 2e-3 * MOON_RADIUS_M * math.cos(math.radians(equatorward))
            return Area(0.0, pole, min(size_km, _EXTENT_MAX_M / 1e3))
    wider = "" if request.surface == "sphere" else f", or {_WIDER}"
    raise AreaError(
        f"{box} does not fit into one plane: state `center` and `size_km`, or `bounds`{wider}"
    )


def axis_place(sensor: Sensor, dems: DemSet | None) -> tuple[float, float]:
    """Longitude and latitude, degrees, at which a sensor's optical axis first meets a DEM's stored
    pixels, or, without a DEM or beside it, the reference sphere. CameraError if it meets neither.

    The axis is sampled at `_AXIS_STEPS` places between the Moon's extreme heights, and once more between
    the two of these where it goes below the surface: terrain narrower than the first step may be
    passed over.
    """
    origin, ahead = optical_axis(sensor)
    away_m = _axis_met(origin, ahead, dems) if dems is not None else math.nan
    if math.isnan(away_m):
        away_m = float(sphere_intersection.ranges(origin, ahead))
    if math.isnan(away_m):
        raise CameraError(
            f"{sensor.name}: its optical axis does not meet the Moon; use `around` footprint"
        )
    lon, lat, _ = mcmf_to_lonlat(origin + away_m * ahead)
    return float(lon), float(lat)


def _axis_met(origin: Array, ahead: Array, dems: DemSet) -> float:
    """Distance along the axis to the first crossing of the DEM's pixels; NaN without one."""
    top, bottom = (
        float(sphere_intersection.ranges(origin, ahead, MOON_RADIUS_M + h))
        for h in (HIGHEST_M, LOWEST_M)
    )
    middle = -float(origin @ ahead)  # nearest to the Moon's centre
    if np.linalg.norm(origin) <= MOON_RADIUS_M + HIGHEST_M:
        top = 0.0
    first, last = top, 2.0 * middle - top if math.isnan(bottom) else bottom
    if not first < last:
        return math.nan
    for _ in range(2):
        away = np.linspace(first, last, _AXIS_STEPS)
        lon, lat, height = mcmf_to_lonlat(origin + away[:, None] * ahead)
        above = height - nearest_heights(dems, lon, lat)
        under = np.flatnonzero(above <= 0.0)
        if not under.size:
            return math.nan
        last = float(away[under[0]])
        first = float(away[max(under[0] - 1, 0)])
    return last


def _require_extent(extent_m: Extent) -> None:
    """Raise AreaError for an extent that is too wide for one plane."""
    width, height = extent_m[1] - extent_m[0], extent_m[3] - extent_m[2]
    if max(width, height) > _EXTENT_MAX_M * (1 + 1e-9):
        raise AreaError(
            f"{width / 1e3:.0f} x {height / 1e3:.0f} km do not fit into one plane "
            f"(limit {_EXTENT_MAX_M / 1e3:.0f} km): state a smaller `size_km` or `bounds`, or {_WIDER}"
        )


def _camera_over(frame: EnuFrame, view: View, gsd_m: float, extent_m: Extent) -> CameraView:
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


def _grown(extent_m: Extent, by_m: float) -> Extent:
    x0, x1, y0, y1 = extent_m
    return x0 - by_m, x1 + by_m, y0 - by_m, y1 + by_m


def _coarse_terrain(
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
    along, up = np.linspace(box.west, box.east, 65), np.linspace(box.south, box.north, 65)
    x0, x1, y0, y1 = extent_m
    farthest_m = 0.0
    for lon, lat in ((along, up[0]), (along, up[-1]), (along[0], up), (along[-1], up)):
        x, y, z = np.moveaxis(frame.from_mcmf(lonlat_to_mcmf(lon, lat)), -1, 0)
        if (z < -0.5 * MOON_RADIUS_M).any():
            return math.inf
        beyond = np.maximum(np.maximum(x0 - x, x - x1), np.maximum(y0 - y, y - y1))
        step = np.hypot(np.diff(x), np.diff(y)).max()  # between samples an edge goes no further
        farthest_m = max(farthest_m, float(beyond.max() + step))
    return farthest_m


def _height_reach_m(coarse: Terrain, view: View) -> float:
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


def _view_ring_m(coarse: Terrain, view: View) -> float:
    """Distance beyond the area to which terrain can hide it from the view."""
    tangent = lowest_view_tangent(view, nodes_enu(coarse.field, coarse.core))
    if not math.isfinite(tangent):
        return 0.0
    return ring_needed_m(coarse, tangent, COARSE_SLOPE * coarse.field.gsd_m)


def require_above(name: str, height_m: float) -> None:
    """Raise CameraError for a camera at a height of 0 or less."""
    if height_m <= 0.0:
        raise CameraError(
            f"{name}: the camera is {-height_m:.6g} m below the reference sphere and sees nothing of it: "
            "render a DEM with `surface` heightfield"
        )
