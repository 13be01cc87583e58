"""What a camera sees, and what is wrong with its file: place, view, ground pixel, Sun, points of a catalogue, DEM.

Directions in the image and on the ground are those at the point of the reference sphere in the image's middle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from ..arrays import Array
from ..cameras.camera_file import unjudged_sensor
from ..cameras.frame_camera import Camera
from ..cameras.mistakes import blindness, doubts, if_looking_down, likely_mistake
from ..cameras.public import SensorOrPath
from ..cameras.sensor import Sensor, pixel_size_m
from ..cameras.view import border_and_inside, footprint, optical_axis
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..constants import MOON_RADIUS_M
from ..dem.mosaic import DemSet
from ..dem.plausibility import warn_of_doubts
from ..dem.public import Dems, dem_set
from ..geometry.frames import Direction, EnuFrame, azimuth_elevation, direction_enu, mcmf_to_lonlat
from ..geometry.sphere_intersection import hits, nadir_angles, on_sphere
from ..light.sun_choice import SunChoice
from ..matching.point_choice import points_in_view, shows_points
from ..matching.search_area import none_in_view
from ..plots.axes import Axes, Axis, round_ticks

_GRID = 33
"""Rays along each side of the image, and a quarter as many along its inside, for shares and the outline."""

_WIDTH = 420.0
"""Side of the picture."""

_SIDES = ("right", "lower right", "lower edge", "lower left", "left", "upper left", "upper edge", "upper right")  # fmt: skip
"""Sides of an image, from the right clockwise in steps of 45 deg."""

_STYLE = """
svg{background:#fff;font:13px system-ui,sans-serif;fill:#5d6068}.grid{stroke:#e3e4e8;fill:none}.axis{stroke:#5d6068;fill:none}
.middle{text-anchor:middle}.end{text-anchor:end}
.image{fill:#1f5fbf;fill-opacity:.12;stroke:#1f5fbf;stroke-width:1.6}
.limb{fill:none;stroke:#c05a00;stroke-dasharray:6 4}.in{fill:#2a7f3e}.out{fill:#b9bcc4}
.nadir{fill:#c62320}.top{stroke:#1f5fbf;stroke-width:4}.legend{font-size:10.5px}
"""

_LEGEND = (
    '<text class="legend" x="-50" y="-8">'
    "thick: the image's upper edge; red: below the camera; green: in view; dashed: limb</text>"
)


def blind_to_points(catalog: Catalog, sensor: Sensor) -> str:
    """Why none of a catalogue's points is in view: how far the image's centre is from them, and mistakes of the
    camera without which some are; empty if some are.
    """
    if len(points_in_view(catalog, sensor)):
        return ""
    mistake = likely_mistake(sensor, shows_points(catalog))
    return none_in_view(catalog, sensor) + (f"; {mistake}" if mistake else "")


@dataclass(frozen=True, eq=False)
class CameraInfo:
    """What a camera sees: the JSON ``document`` of ``lcp camera info``, with ``position``, ``centre``, ``sun``, ``catalog``,
    ``dem`` (null where unknown) and ``problems``.

    Examples
    --------
    >>> info = lcp.camera_info(camera)
    >>> info.problems, info.document["sun"]["from_image_side"]
    ([], 'right')
    """

    sensor: Sensor
    document: dict[str, Any]
    catalog: Catalog | None = None

    def __repr__(self) -> str:
        """The answer in short; `lines` says all."""
        return f"<CameraInfo: {self.sensor.name:.200}, {len(self.problems)} problems>"

    @property
    def problems(self) -> list[str]:
        """What is wrong, or hardly so, each with what to do; empty if nothing was found."""
        return list(self.document["problems"])

    def lines(self) -> list[str]:
        """The answer as lines of text."""
        names = ("position", "centre", "sun", "catalog", "dem")
        of, centre, sun, points, dem = (self.document[name] for name in names)
        rows, cols = self.sensor.shape
        wide, high = of["field_of_view_deg"]
        share = of["ground_share"]
        ground = "below the sphere" if share is None else f"{100.0 * share:.0f} % of it ground"
        found = [
            f"{self.sensor.name}: {self.sensor.kind}, {cols} x {rows} pixels",
            f"camera     {_at(of)}, {of['height_km']:.1f} km above the sphere, {of['off_nadir_deg']:.1f} deg off nadir",
            f"view       {wide:.1f} x {high:.1f} deg, {ground}",
        ]
        if centre:
            found.append(
                f"middle     {_at(centre)}, pixels of {centre['pixel_m']:.4g} m; up in the image is towards azimuth "
                f"{round(centre['up_azimuth_deg']) % 360} deg"
            )
        if sun:
            side = f", from the image's {sun['from_image_side']}" if centre else ""
            angles = f"azimuth {sun['azimuth_deg']:.1f}, elevation {sun['elevation_deg']:.1f} deg"
            found.append(f"Sun        {angles}{side}")
        else:
            found.append(
                "Sun        none: state a time, angles or the subsolar point in each command"
            )
        if points:
            found.append(f"catalogue  {points['in_view']} of {points['points']} points in view")
        if dem:
            above = dem["height_above_ground_km"]
            text = "" if above is None else f"; the camera is {above:.2f} km above its ground"
            found.append(
                f"DEM        covers {100.0 * dem['covered_share']:.0f} % of the ground{text}"
            )
        return [*found, *(f"wrong      {one}" for one in self.problems)]

    def picture(self) -> str:
        """SVG of what the image shows (its upper edge thick), the limb (dashed), the place below the camera (red) and
        the points (green in view); km east and north of the middle.
        """
        edge, (position, _) = _border(self.sensor), optical_axis(self.sensor)
        frame, nadir = _frame(self.sensor), on_sphere(position)[None]
        points = np.zeros((0, 3)) if self.catalog is None else self.catalog.position_mcmf
        near = np.zeros(len(points), np.bool_)
        if self.catalog is not None:
            near[points_in_view(self.catalog, self.sensor)] = True
        flat = frame.from_mcmf(np.concatenate([edge, nadir, points]))[:, :2] / 1e3
        low, high = np.nanmin(flat, axis=0), np.nanmax(flat, axis=0)
        half = 0.55 * max(float((high - low).max()), 1e-3)
        x, y = (
            Axis(
                at - half, at + half, round_ticks(at - half, at + half, 6), f"km {text}", grid=True
            )
            for at, text in zip((0.5 * (low + high)).tolist(), ("east", "north"), strict=True)
        )
        axes = Axes(x, y, _WIDTH, _WIDTH)

        def line(css: str, places: Array) -> Markup:
            east, north, _ = frame.from_mcmf(places[np.isfinite(places[:, 0])]).T / 1e3
            return axes.line(east, north, css)

        dots = [
            Markup('<circle class="{}" cx="{:.1f}" cy="{:.1f}" r="{}"/>').format(css, a, b, r)
            for css, r, some in (
                ("out", 2, points[~near]),
                ("in", 2, points[near]),
                ("nadir", 4, nadir),
            )
            for a, b in zip(*axes.at(*(frame.from_mcmf(some)[:, :2].T / 1e3)), strict=True)
        ]
        drawn = [
            line("limb", _limb(position)),
            line("image", edge),
            line("top", edge[:_GRID]),
            *dots,
        ]
        clip = (
            '<clipPath id="c"><path d="M0 0H{0}V{0}H0z"/></clipPath><g clip-path="url(#c)">{1}</g>'
        )
        inside = Markup(clip + _LEGEND).format(_WIDTH, Markup().join(drawn))
        return str(axes.draw(inside, f"what {Path(self.sensor.name).name} sees", _STYLE)) + "\n"


def _at(place: dict[str, Any]) -> str:
    return f"longitude {place['longitude']:.3f}, latitude {place['latitude']:.3f}"


def _shown(sensor: Sensor, pixels: ArrayLike) -> Array:
    """Where rays meet the sphere, MCMF (..., 3); NaN for sky, and for a sensor below the sphere."""
    origins, rays = sensor.looks(pixels)
    above = np.linalg.norm(origins, axis=-1) > MOON_RADIUS_M
    return np.where(above[..., None], hits(origins, rays)[1], np.nan)


def _middle_px(sensor: Sensor) -> Array:
    return 0.5 * (np.array(sensor.shape[::-1]) - 1.0)


def _frame(sensor: Sensor) -> EnuFrame:
    """The frame of what the image's middle shows, or else of the place below the sensor."""
    middle = _shown(sensor, _middle_px(sensor))
    lon, lat, _ = mcmf_to_lonlat(middle if np.isfinite(middle).all() else optical_axis(sensor)[0])
    return EnuFrame(float(lon), float(lat))


def _border(sensor: Sensor) -> Array:
    """The image's border on the sphere from its upper left corner clockwise, MCMF (n, 3); NaN for sky."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * sensor.shape[::-1] - 0.5
    share = np.linspace(0.0, 1.0, _GRID)[:, None]
    return _shown(sensor, np.concatenate([a + share * (b - a) for a, b in pairwise(corners)]))


def _limb(position: Array) -> Array:
    """The limb of the sphere seen from a position (3,), MCMF (n, 3); empty from within."""
    level = MOON_RADIUS_M / float(np.linalg.norm(position))
    lon, lat, _ = mcmf_to_lonlat(position)
    ring = direction_enu(np.linspace(0.0, 360.0, 181), math.degrees(math.asin(min(level, 1.0))))
    return MOON_RADIUS_M * EnuFrame(float(lon), float(lat)).direction_to_mcmf(ring)


def _place(sensor: Sensor, ground: Array) -> dict[str, Any]:
    """Place, attitude and field of view; ``ground`` (n, 3): what the image shows of the sphere."""
    position, axis = optical_axis(sensor)
    lon, lat, height = (float(one) for one in mcmf_to_lonlat(position))
    middle, half = _middle_px(sensor), 0.5 * np.array(sensor.shape[::-1])
    rays = sensor.looks(middle + np.array([[-1, 0], [1, 0], [0, -1], [0, 1]]) * half)[1]
    share = float(np.isfinite(ground[:, 0]).mean())
    return {
        "longitude": lon,
        "latitude": lat,
        "height_km": 1e-3 * height,
        "off_nadir_deg": float(np.degrees(nadir_angles(position, axis))),
        "field_of_view_deg": [_angle_deg(*rays[:2]), _angle_deg(*rays[2:])],
        "ground_share": share if height > 0.0 else None,
        "bounds": footprint(sensor)._asdict() if share else None,
    }


def _centre(sensor: Sensor) -> dict[str, Any] | None:
    """What the image's middle shows; None for sky."""
    frame, middle = _frame(sensor), _middle_px(sensor)
    place, above = _shown(sensor, [middle, middle - [0.0, 0.01 * sensor.shape[0]]])
    if not np.isfinite(place + above).all():
        return None
    return {
        "longitude": frame.lon_deg,
        "latitude": frame.lat_deg,
        "pixel_m": float(pixel_size_m(sensor, place)),
        "up_azimuth_deg": float(azimuth_elevation(frame.from_mcmf(above))[0]),
    }


def _sun(sensor: Sensor) -> dict[str, Any] | None:
    """The Sun of the file over the middle, or below the camera where that shows sky; None without one."""
    if sensor.sun_position_mcmf_m is None and sensor.time_utc is None:
        return None
    frame = _frame(sensor)
    sun = Direction.from_mcmf(SunChoice().direction_mcmf(frame, sensor), frame)
    step = frame.to_mcmf(1e3 * direction_enu(sun.azimuth_deg, 0.0))
    x, y = np.nan_to_num(sensor.project(step) - sensor.project(frame.origin_mcmf_m))
    return {
        "azimuth_deg": sun.azimuth_deg,
        "elevation_deg": sun.elevation_deg,
        "from_image_side": _SIDES[round(math.degrees(math.atan2(y, x)) / 45.0) % 8],
    }


def _on_dem(sensor: Sensor, ground: Array, dems: DemSet, cell_m: float) -> dict[str, Any]:
    """Share of the ground where the DEM has heights, which are read, and the sensor's height above its own. Between
    the ground and the reference sphere, what it shows is taken on the sphere through the ground below it.
    """
    lon, lat, height = mcmf_to_lonlat(optical_axis(sensor)[0][None])
    below = float(dems.heights(lon, lat, cell_m)[0][0])
    if below < height[0] <= 0.0:
        origins, rays = sensor.looks(border_and_inside(sensor.shape, _GRID))
        ground = hits(origins, rays, MOON_RADIUS_M + below)[1]
        ground = ground[np.isfinite(ground[:, 0])]
    lon, lat, _ = mcmf_to_lonlat(ground)
    seen = dems.heights(lon, lat, cell_m)[0] if len(ground) else np.zeros(0)
    above_km = 1e-3 * (float(height[0]) - below)
    return {
        "covered_share": float(np.isfinite(seen).mean()) if len(ground) else 0.0,
        "height_above_ground_km": above_km if math.isfinite(above_km) else None,
    }


def _angle_deg(one: Array, other: Array) -> float:
    """Angle between two directions (3,); 0 if one is not known, as in a gap between framelets."""
    across = np.linalg.norm(np.cross(one, other))
    return float(np.degrees(np.nan_to_num(np.arctan2(across, one @ other))))


def _problems(sensor: Sensor, found: dict[str, Any], catalog: Catalog | None) -> Iterator[str]:
    """What is wrong with a camera by its ``found`` document; empty texts are no problems."""
    blind = "" if catalog is None else blind_to_points(catalog, sensor)
    if isinstance(sensor, Camera):
        sees = None if catalog is None else shows_points(catalog)
        yield blindness(sensor, sees) or blind or if_looking_down(sensor, sees)
        yield from doubts(sensor)
    else:
        yield blind
    if not blind and found["position"]["ground_share"] == 0.0:
        yield "it sees nothing of the Moon: check position and attitude"
    if found["sun"] and found["sun"]["elevation_deg"] < 0.0:
        yield (
            f"the Sun of the file is {-found['sun']['elevation_deg']:.1f} deg below the horizon at "
            f"{_at(found['centre'] or found['position'])}: check sun_position_mcmf_m and time_utc"
        )
    above = found["dem"] and found["dem"]["height_above_ground_km"]
    if found["dem"] and not found["dem"]["covered_share"] and not (above or 0.0) < 0.0:
        yield "the DEM holds nothing of what the camera sees: check the position, or give another DEM"
    if (above or 0.0) < 0.0:
        yield "the camera is below the DEM's ground: check position_mcmf_m"


def camera_info(
    camera: SensorOrPath, *, catalog: CatalogOrPath | None = None, dem: Dems | None = None
) -> CameraInfo:
    """What a camera sees, and what is wrong with it: mistakes in its file that other functions refuse or warn of,
    a Sun below the horizon, no point of a catalogue or nothing of a DEM in view.

    Parameters
    ----------
    camera:
        A sensor, or its file: CAMERA.json, USGS ISD, or .tsai.
    catalog:
        A catalogue whose points it should see.
    dem:
        DEM files whose ground it should see.

    Raises
    ------
    CameraError
        For a file that describes no camera.
    CatalogError, DemError
        For a catalogue or a DEM that cannot be read, or a DEM without a surface.

    Examples
    --------
    >>> info = lcp.camera_info(folder / "AS15-M-0414_camera.json", dem=folder / "hadley_gld100_256ppd.tif")
    >>> round(info.document["dem"]["covered_share"], 2)
    1.0
    """
    sensor = unjudged_sensor(camera) if isinstance(camera, Path | str) else camera
    points = None if catalog is None else opened_catalog(catalog)
    ground = _shown(sensor, border_and_inside(sensor.shape, _GRID))
    centre = _centre(sensor)
    found: dict[str, Any] = {
        "camera": sensor.name,
        "kind": sensor.kind,
        "image_size_px": [*sensor.shape[::-1]],
        "position": _place(sensor, ground),
        "centre": centre,
        "sun": _sun(sensor),
        "time_utc": sensor.time_utc,
        "catalog": None,
        "dem": None,
    }
    if points is not None:
        in_view = len(points_in_view(points, sensor))
        found["catalog"] = {"points": len(points), "in_view": in_view}
    if dem is not None:
        dems = dem_set(dem)
        dems.require_surface()
        warn_of_doubts(dems, dems.bounds)
        cell_m = max(dems.dems[0].gsd_m, centre["pixel_m"] if centre else 0.0)
        found["dem"] = _on_dem(sensor, ground[np.isfinite(ground[:, 0])], dems, cell_m)
    found["problems"] = list(filter(None, _problems(sensor, found, points)))
    return CameraInfo(sensor, found, points)
