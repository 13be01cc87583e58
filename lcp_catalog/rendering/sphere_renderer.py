"""Images of the Moon as a plain sphere of 1 737 400 m, at nodes of a plane or in a camera's plane.

The counterpart of `renderer` for heightfields, without rays through terrain: a point is visible if it
faces the camera, and lit by the share of a source above its level horizon. There are no cast shadows,
and only the sphere's horizon hides anything.

Under a disc, a point near the terminator sees a part of it. Its light is that part's: the mean cosine
of incidence over the part, times its share of the flux, both in closed form. Incidence and phase are
those of the disc's centre.

For a pixel on the limb, ``visible`` is the share of its area that shows the sphere. Its radiance is the
mean over the whole pixel (the sky is black); the other bands are those at the middle of the visible part.

Means of a map of the Moon over the footprints of pixels, which may differ in size and shape.

A footprint is an ellipse on the surface: ``across`` is its axis across the line of sight, ``along``
the other one, which foreshortening stretches. It is covered by a row of 1, 2, 4 ... round probes. The
value of a probe is interpolated between means of the map over the two nearest of a series of widths,
a factor of 2 apart (Williams 1983, pyramidal parametrics; McCormack et al. 1999, footprint assembly).
This avoids aliasing; the blur is at most the longer axis over `PROBES_MOST`.

Pixels on the limb of the sphere, and the share of each that shows the sphere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Mask
from ..cameras.frame_camera import Camera
from ..cameras.view import CameraView, View
from ..constants import MOON_RADIUS_M
from ..errors import SunError
from ..geometry import sphere_intersection
from ..geometry.frames import EnuFrame, mcmf_to_lonlat
from ..geometry.sphere_intersection import limb_angle, nadir_angles
from ..kernels import sphere_rays as kernel
from ..light.sources import Lighting, LightSource
from ..photometry.albedo_map import ColourMap
from ..photometry.laws import DEFAULT_MODEL, Reflectance, photometry, radiance_factor
from ..stages import timed
from ..terrain.area import NodeWindow
from .placement import require_above
from .renderer import Band, Rendering, in_colour
from .request import Extent

COVERAGE_ERROR = 2e-4
"""Error of a limb pixel's coverage, as a share of the pixel; measured against brute force."""


_CELLS_LEAST = 4


_CELLS_MOST = 64


_CORNERS_AT_ONCE = 1 << 20


def coverage(
    camera: Camera, columns: ArrayLike, rows: ArrayLike, radius_m: float = MOON_RADIUS_M
) -> tuple[Array, Array]:
    """Share (n,) of the pixels' area that shows the sphere, and the middle (n, 2) of that part, column
    and row in the image; NaN if the share is 0.

    Each pixel is divided into cells in which the limb is nearly straight; their number depends on the
    curvature of the limb in the image. ValueError for a camera inside the sphere.
    """
    pixels = np.stack(np.broadcast_arrays(columns, rows), axis=-1).astype(np.float64).reshape(-1, 2)
    position, limb = camera.position_mcmf_m, limb_angle(camera.position_mcmf_m, radius_m)
    cells = _cells(camera.focal_length_px * math.tan(limb))
    steps = np.arange(cells + 1) / cells - 0.5
    off = np.stack(np.meshgrid(steps, steps), axis=-1)
    shares, middles = np.empty(len(pixels)), np.empty((len(pixels), 2))
    at_once = max(1, _CORNERS_AT_ONCE // off[..., 0].size)
    for first in range(0, len(pixels), at_once):
        part = slice(first, first + at_once)
        directions = camera.rays(pixels[part, None, None] + off)
        kernel.covered(limb - nadir_angles(position, directions), shares[part], middles[part])
    middles = np.where(shares[:, None] > 0.0, pixels + middles, np.nan)
    return shares, middles


def _cells(curvature_px: float) -> int:
    """Cells per side of a pixel, for a limb with a radius of curvature r in pixels of the image. The
    area between the limb and a chord across a cell of 1 / k pixels is 1 / (12 r k^3) pixels^2, and k
    chords cross a pixel.
    """
    wanted = math.sqrt(1.0 / (6.0 * max(curvature_px, 1e-3) * COVERAGE_ERROR))
    return min(max(math.ceil(wanted), _CELLS_LEAST), _CELLS_MOST)


def pixel_angle(camera: Camera) -> float:
    """Greatest angle between opposite corners of a pixel, radians, over the image."""
    width, height = camera.image_size_px
    column, row = (np.unique(np.linspace(0, n - 1, 33).round())[None, :] for n in (width, height))
    corners = camera.rays(np.stack(np.broadcast_arrays(*_corner_grid(column[0], row[0])), axis=-1))
    first = np.linalg.norm(corners[:, :, 1, 1] - corners[:, :, 0, 0], axis=-1)
    second = np.linalg.norm(corners[:, :, 1, 0] - corners[:, :, 0, 1], axis=-1)
    return 2.0 * math.asin(min(1.0, 0.5 * float(np.maximum(first, second).max())))


def _corner_grid(columns: Array, rows: Array) -> tuple[Array, Array]:
    """Columns and rows of the four corners of pixels, (rows, columns, 2, 2)."""
    half = np.array([-0.5, 0.5])
    return (
        columns[None, :, None, None] + half[None, None, None, :],
        rows[:, None, None, None] + half[None, None, :, None],
    )


def limb_pixels(camera: Camera, directions: Array, pixel_rad: float) -> NDArray[np.bool_]:
    """True for pixels that the limb may cross, by the directions (..., 3) of their centres;
    ``pixel_rad``: `pixel_angle`.
    """
    off = nadir_angles(camera.position_mcmf_m, directions) - limb_angle(camera.position_mcmf_m)
    return np.asarray(np.abs(off) <= pixel_rad)


PROBES_MOST = 16
_RUNGS = (-6, 24)  # widths of 2^-6 to 2^24 pixels of the map


class SurfaceMap(Protocol):
    """A map of values on the surface, such as `photometry.albedo_map.AlbedoMap`."""

    @property
    def gsd_m(self) -> float:
        """Pixel width of the map."""

    def at(self, lon_deg: Array, lat_deg: Array, gsd_m: float) -> Array:
        """Means over cells of width ``gsd_m`` around places; NaN where the map has no value."""


@timed("albedo")
def seen_through(
    ground: SurfaceMap, points_m: Array, across_m: Array, along_m: Array, towards: Array
) -> Array:
    """Means (n,) of a map over footprints: MCMF points (n, 3), axes (n,) in metres, and unit vectors
    (n, 3) in the direction of the longer axis ``along_m``. NaN where the map has no value.
    """
    out = np.empty(len(points_m))
    stretch = np.maximum(along_m, across_m) / across_m
    probes = np.exp2(np.ceil(np.log2(np.minimum(stretch, PROBES_MOST)) - 1e-9)).astype(int)
    width = np.maximum(across_m, along_m / probes)
    for count in np.unique(probes):
        some = np.flatnonzero(probes == count)
        total, known = np.zeros(some.size), np.zeros(some.size)
        for k in range(count):
            step = ((k + 0.5) / count - 0.5) * along_m[some]
            found = _rungs(ground, points_m[some] + step[:, None] * towards[some], width[some])
            total += np.nan_to_num(found)
            known += np.isfinite(found)
        with np.errstate(invalid="ignore"):
            out[some] = total / known
    return out


def _rungs(ground: SurfaceMap, points_m: Array, width_m: Array) -> Array:
    """Means over round probes, interpolated by the logarithm between the two nearest widths."""
    lon, lat, _ = mcmf_to_lonlat(points_m)
    rung = np.clip(np.log2(width_m / ground.gsd_m), *_RUNGS)
    low = np.floor(rung).astype(int)
    share, out = rung - low, np.zeros(rung.size)
    for step in range(low.min(initial=0), low.max(initial=-1) + 2):
        weight = np.where(low == step, 1.0 - share, np.where(low == step - 1, share, 0.0))
        some = np.flatnonzero(weight)
        if some.size:
            out[some] += weight[some] * ground.at(lon[some], lat[some], ground.gsd_m * 2.0**step)
    return out


_BLOCK_PIXELS = 1 << 18
_ANGLES = ("incidence_deg", "emission_deg", "phase_deg")
_FACING = 1e-9  # least cosine of emission for the stretch of a footprint


@dataclass(frozen=True, eq=False)
class _Bands:
    """Bands of points (n,): radiance of the surface, in colour (3, n), share of the first source, angles
    in degrees.
    """

    radiance: Array
    sunlit: Array
    incidence_deg: Array
    emission_deg: Array
    phase_deg: Array


def render_sphere_enu(
    frame: EnuFrame,
    window: NodeWindow,
    gsd_m: float,
    light: Lighting,
    view: View,
    *,
    model: Reflectance = DEFAULT_MODEL,
    albedo: SurfaceMap | ColourMap | None = None,
) -> Rendering:
    """Render the nodes of a window of the frame's plane, float32; NaN where the vertical of the plane
    misses the sphere. ``light`` and ``view`` are in the frame's axes.

    CameraError for a camera below the sphere, SunError if nothing visible is lit.
    """
    check_camera(frame, view)
    rows, cols = window.shape
    out = _empty((rows, cols), np.float32, albedo)
    height = np.full((rows, cols), np.nan, np.float32)
    x = (window.col0 + np.arange(cols)) * gsd_m
    at_once = max(1, _BLOCK_PIXELS // cols)
    for first in range(0, rows, at_once):
        block = slice(first, min(first + at_once, rows))
        y = -(window.row0 + np.arange(rows)[block]) * gsd_m
        nodes = sphere_nodes(*np.meshgrid(x, y))
        height[block] = nodes[..., 2]
        there = np.isfinite(nodes[..., 2])
        normals = frame.direction_to_mcmf(
            (nodes[there] + [0.0, 0.0, MOON_RADIUS_M]) / MOON_RADIUS_M
        )
        towards = frame.direction_to_mcmf(view.directions(nodes[there]))
        sizes = (
            np.full(len(normals), gsd_m),
            gsd_m / np.maximum(nodes[there][:, 2] / MOON_RADIUS_M + 1.0, _FACING),
        )
        leaning = _level(frame.rotation[2], normals)
        seen = np.sum(normals * towards, axis=-1) > 0.0
        if view.camera is not None:
            pixels = view.camera.project(normals * MOON_RADIUS_M)
            seen &= view.camera.in_image(pixels)
        bands = _shade(frame, normals, towards, light, model, seen)
        if albedo is not None:
            factor = _factors(albedo, normals[seen], sizes[0][seen], sizes[1][seen], leaning[seen])
            bright = np.broadcast_to(bands.radiance, (*factor.shape[:-1], len(seen))).copy()
            bright[..., seen] *= factor
            bands = replace(bands, radiance=bright)
        _put(out, block, there, bands, seen.astype(np.float32))
    result = _rendering(out, height_m=height)
    _require_light(result, light)
    return result


def render_sphere_camera(
    frame: EnuFrame,
    camera: Camera,
    light: Lighting,
    *,
    model: Reflectance = DEFAULT_MODEL,
    albedo: SurfaceMap | ColourMap | None = None,
    extent_m: Extent | None = None,
) -> Rendering:
    """Render the camera's plane, float64. ``light`` is in the frame's axes; ``extent_m`` (west, east,
    south, north in its plane): nothing outside is rendered. Raises the errors of `render_sphere_enu`.
    """
    height = float(sphere_intersection.heights(camera.position_mcmf_m))
    require_above(camera.name, height)
    rows, cols = camera.shape
    out = _empty((rows, cols), np.float64, albedo)
    position = np.full((rows, cols, 3), np.nan)
    pixel_rad = pixel_angle(camera)
    at_once = max(1, _BLOCK_PIXELS // cols)
    for first in range(0, rows, at_once):
        block = slice(first, min(first + at_once, rows))
        share, points, rays = _look(camera, block, pixel_rad)
        if extent_m is not None:
            share[~_within(frame, points, extent_m)] = 0.0
        there = share > 0.0
        normals, towards = points[there] / MOON_RADIUS_M, -rays[there]
        seen = np.ones(len(normals), dtype=np.bool_)
        bands = _shade(frame, normals, towards, light, model, seen)
        bright = bands.radiance
        if albedo is not None:
            bright = bright * _pixel_factors(albedo, camera, points[there], towards)
        bands = replace(bands, radiance=bright * share[there])
        position[block][there] = points[there]
        _put(out, block, there, bands, share[there])
    result = _rendering(out, position_mcmf_m=position)
    _require_light(result, light)
    return result


def sphere_nodes(x_m: Array, y_m: Array) -> Array:
    """ENU points (..., 3) of the sphere over a frame's plane; NaN heights beyond the limb. The height,
    without cancellation, is -(x^2 + y^2) / (R + sqrt(R^2 - x^2 - y^2)).
    """
    away2 = x_m * x_m + y_m * y_m
    under_root = MOON_RADIUS_M**2 - away2
    with np.errstate(invalid="ignore"):
        z = -away2 / (MOON_RADIUS_M + np.sqrt(under_root))
    return np.stack([x_m, y_m, z], axis=-1)


def share_and_cosine(sine: Array, source: LightSource) -> tuple[Array, Array]:
    """Share of a source above level horizons, and the mean cosine of incidence of that part. ``sine`` (n,):
    sine of the elevation of the source's centre. Where the share is 0 the cosine is the sine.

    In the plane tangent to the sky at the disc's centre, in radii of the disc, the horizon is the line
    y = -tan(e) / tan(r). Share: `LimbDarkening.share_above`. Mean height of the part: the integral of
    y times the flux of a chord, 2 a h + pi/2 b h^2 + 4/3 c h^3 with h^2 = 1 - y^2, over the part's
    flux; y dy = -h dh makes it a polynomial in h.
    """
    share, cosine = (sine > 0.0).astype(np.float64), sine.copy()
    if source.disc is None:
        return share, cosine
    law, tangent = source.disc.limb_darkening, math.tan(source.disc.radius_rad)
    level = np.sqrt(np.maximum(1.0 - sine * sine, 0.0))
    cut = np.flatnonzero(np.abs(sine) < tangent * level)
    y = -sine[cut] / (level[cut] * tangent)
    half = np.sqrt(1.0 - y * y)
    part = law.share_above(y)
    moment = (
        2.0 / 3.0 * law.a * half**3 + math.pi / 8.0 * law.b * half**4 + 4.0 / 15.0 * law.c * half**5
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        middle = np.clip(np.where(part > 0.0, moment / (law.flux * part), y), y, 1.0)
    share[cut] = part
    cosine[cut] = sine[cut] + tangent * level[cut] * middle
    return share, cosine


def check_camera(frame: EnuFrame, view: View) -> None:
    """Raise CameraError for a camera below the sphere."""
    if not isinstance(view, CameraView):
        return
    name = view.camera.name if view.camera else "the view"
    require_above(name, float(sphere_intersection.heights(frame.to_mcmf(view.position_m))))


def _require_light(result: Rendering, light: Lighting) -> None:
    if (result.visible > 0).any() and not (result.radiance > 0).any():
        raise SunError(
            f"the {light.first.name} is below the horizon at all visible points: nothing is lit; "
            f"state another {light.first.name}"
        )


def _look(camera: Camera, rows: slice, pixel_rad: float) -> tuple[Array, Array, Array]:
    """For a block of rows: the share of each pixel that shows the sphere, the visible point (MCMF) and its
    direction; on the limb those of the middle of the visible part.
    """
    column, row = np.meshgrid(np.arange(camera.shape[1]), np.arange(rows.start, rows.stop))
    rays = camera.rays(np.stack([column, row], axis=-1))
    near = limb_pixels(camera, rays, pixel_rad)
    share, middle = coverage(camera, column[near], row[near])
    rays[near] = np.where(
        share[:, None] > 0.0, camera.rays(np.where(share[:, None] > 0.0, middle, 0.0)), rays[near]
    )
    found, points = sphere_intersection.hits(camera.position_mcmf_m, rays)
    shares = np.isfinite(found).astype(np.float64)
    shares[near] = share
    missed = (shares > 0.0) & np.isnan(found)  # by rounding: the limb itself
    if missed.any():
        along = np.maximum(-(rays[missed] @ camera.position_mcmf_m), 0.0)
        nearest = camera.position_mcmf_m + along[:, None] * rays[missed]
        points[missed] = sphere_intersection.on_sphere(nearest)
    return shares, points, rays


def _within(frame: EnuFrame, points: Array, extent_m: Extent) -> Mask:
    x, y, z = np.moveaxis(frame.from_mcmf(points), -1, 0)
    west, east, south, north = extent_m
    inside = (x >= west) & (x <= east) & (y >= south) & (y <= north) & (z > -MOON_RADIUS_M)
    return np.asarray(inside)


@timed("reflectance")
def _shade(
    frame: EnuFrame, normals: Array, towards: Array, light: Lighting, model: Reflectance, seen: Mask
) -> _Bands:
    """Bands of points with unit MCMF normals (n, 3), in the directions (n, 3) of the camera."""
    radiance, first = np.zeros(len(normals)), None
    for source in light.sources:
        sun = frame.direction_to_mcmf(source.direction)
        share, cosine = share_and_cosine(normals @ sun, source)
        bands = photometry(normals, sun, towards, share > 0.0, seen, model)
        under = bands.radiance
        cut = np.flatnonzero(seen & (share > 0.0) & (share < 1.0))
        incidence = np.arccos(np.clip(cosine[cut], 0.0, 1.0))
        under[cut] = radiance_factor(model, incidence, bands.emission[cut], bands.phase[cut])
        radiance += source.irradiance * share * under
        if first is None:
            first = _Bands(radiance, share, *(np.degrees(band) for band in bands[1:]))
    assert first is not None
    return first


def _level(direction: Array, normals: Array) -> Array:
    """Horizontal unit vectors (n, 3) towards a direction (3,) or (n, 3); arbitrary where that is the
    vertical.
    """
    along = np.broadcast_to(direction, normals.shape)
    flat = along - np.sum(along * normals, axis=-1, keepdims=True) * normals
    length = np.linalg.norm(flat, axis=-1, keepdims=True)
    return np.asarray(flat / np.where(length > 0.0, length, 1.0))


def _pixel_factors(
    albedo: SurfaceMap | ColourMap, camera: Camera, points: Array, towards: Array
) -> Array:
    """Albedo factors of pixels. The footprint of a pixel is 1 / f wide across the line of sight and
    stretched along it by foreshortening, at the limb at most to sqrt(2 R s), s its width.
    """
    normals = points / MOON_RADIUS_M
    away = np.linalg.norm(camera.position_mcmf_m - points, axis=-1)
    across = away / camera.focal_length_px
    facing = np.maximum(np.sum(normals * towards, axis=-1), _FACING)
    along = np.minimum(across / facing, np.maximum(np.sqrt(2.0 * MOON_RADIUS_M * across), across))
    return _factors(albedo, normals, across, along, _level(towards, normals))


def _factors(
    albedo: SurfaceMap | ColourMap, normals: Array, across: Array, along: Array, towards: Array
) -> Array:
    """Albedo factors of footprints, (n,) or in colour (3, n)."""
    if isinstance(albedo, ColourMap):
        each = [_factors(band, normals, across, along, towards) for band in albedo.bands]
        return np.stack(each)
    found = seen_through(albedo, normals * MOON_RADIUS_M, across, along, towards)
    return np.where(np.isnan(found), 1.0, found)


def _empty(
    shape: tuple[int, int], dtype: type[np.floating], albedo: SurfaceMap | ColourMap | None
) -> dict[str, Any]:
    bands = {name: np.full(shape, np.nan, dtype) for name in _ANGLES}
    colours = (len(albedo.bands),) if isinstance(albedo, ColourMap) else ()
    bands["radiance"] = np.full((*colours, *shape), np.nan, dtype)
    return bands | {name: np.zeros(shape, dtype) for name in ("sunlit", "visible")}


def _put(out: dict[str, Any], block: slice, there: Mask, bands: _Bands, share: Array) -> None:
    for name in ("radiance", "sunlit", *_ANGLES):
        out[name][..., block, :][..., there] = getattr(bands, name)
    out["visible"][block][there] = share


def _rendering(
    out: dict[str, Any], height_m: Band | None = None, position_mcmf_m: Array | None = None
) -> Rendering:
    radiance, colour = in_colour(out["radiance"])
    sunlit, visible, incidence, emission, phase = (
        out[name] for name in ("sunlit", "visible", *_ANGLES)
    )
    return Rendering(
        radiance,
        sunlit,
        visible,
        incidence,
        emission,
        phase,
        height_m,
        position_mcmf_m,
        colour=colour,
    )
