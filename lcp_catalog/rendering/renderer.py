"""Images of an area under one light and one view: at its own nodes, or in the camera's plane.

Directions are unit ENU vectors of the terrain's frame, from the surface to the source (its centre).
The scene plan says what is modelled (`plan`). A node without a height has a radiance of NaN, is
neither lit nor visible, casts no shadow and hides nothing.

The light is a `Lighting`, or the direction to a single Sun. The radiance is the sum over the sources,
irradiance times radiance factor, and over the samples of a sky. The bands sunlit, incidence and phase
are those of the first source.

The radiance under a disc is that under a point Sun at its centre, times the share of the disc above
the terrain's horizon. A facet that faces away from the disc's centre is dark even if it faces a part
of the disc: the error of the cosine of incidence is below sin(0.267 deg) = 0.0047.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from html import escape
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..accuracy import TIERS, Accuracy
from ..arrays import Array, Mask, sizes
from ..cameras.frame_camera import Camera
from ..cameras.scanners import Scanner
from ..cameras.view import CameraView, ParallelView, ScannerView, View, sensor_view
from ..errors import CameraError
from ..geometry.frames import EnuFrame, mcmf_to_lonlat
from ..light.bounced_light import bounced_at_points
from ..light.sky_sampling import sky_at_nodes, sky_at_points
from ..light.solar_disc import share_at_points, sunlit_share
from ..light.sources import Lighting, LightSource, SurfacePoints, light_above_horizon
from ..photometry.laws import DEFAULT_MODEL, Reflectance, bands_of_nodes, photometry, radiance_under
from ..photometry.srgb import luminance
from ..plots.pictures import new_axis, shown
from ..stages import timed
from ..terrain.far_terrain import HorizonPoints
from ..terrain.occlusion import occluded
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .decisions import SCATTERED
from .plan import ScenePlan, parallel_view, plan_scene

Band = NDArray[np.floating]


_BLOCK_ROWS = 256


class Albedo(Protocol):
    """Brightness of the surface, relative to the reflectance model; in colour with a first axis of
    red, green and blue.
    """

    def at_nodes(self, terrain: Terrain) -> Band:
        """Factors at the core window's nodes, (rows, cols) or (3, rows, cols)."""

    def at_points(self, terrain: Terrain, points: Array) -> Band:
        """Factors at ENU points (n, 3) of the surface, (n,) or (3, n)."""


@dataclass(frozen=True, eq=False)
class Rendering:
    """Bands of one render, each (rows, cols).

    radiance: radiance factor; 0 where visible but not lit, NaN where not visible. sunlit: visible share
    of the Sun's disc (0 or 1 for a point Sun). visible: mask; on the limb of the sphere the share of the
    pixel. incidence_deg, emission_deg, phase_deg: degrees, NaN without a surface. height_m: ENU z, for
    nodes. position_mcmf_m: (rows, cols, 3), for a camera's plane. composite: radiance with the
    background, where there is one (`compositing`). colour: radiance in red, green and blue
    (3, rows, cols) under an albedo map in colour; ``radiance`` is then their luminance.

    `rendering.public.render` adds the area's ``frame`` and, unless the image is a camera's plane, ``transform`` (affine) and
    ``crs`` (rasterio): x and y are the frame's east and north, metres.
    """

    radiance: Band
    sunlit: Band
    visible: Mask | Band
    incidence_deg: Band
    emission_deg: Band
    phase_deg: Band
    height_m: Band | None = None
    position_mcmf_m: Array | None = None
    composite: Band | None = None
    colour: Band | None = None
    frame: EnuFrame | None = None
    transform: Any = None
    crs: Any = None

    __repr__ = sizes

    def _repr_html_(self) -> str:
        """For a notebook its bands and a picture of the radiance."""
        return f"<p>{escape(repr(self))}</p>{shown(self.radiance)}"

    def plot(self, ax: Any = None) -> Any:
        """Draw the radiance into a matplotlib axis, a new one for None, which is returned: kilometres east and north
        of the centre, or pixels. MissingPackageError without matplotlib.
        """
        ax = ax or new_axis()
        extent, unit = None, "pixels"
        if self.transform is not None:
            rows, cols = self.radiance.shape
            (west, north), (east, south) = self.transform @ (0, 0), self.transform @ (cols, rows)
            extent, unit = (west / 1e3, east / 1e3, south / 1e3, north / 1e3), "km"
        ax.imshow(self.radiance, cmap="gray", vmin=0.0, extent=extent, interpolation="nearest")
        ax.set(xlabel=unit, ylabel=unit)
        return ax


@dataclass(frozen=True)
class Method:
    """How terrain is rendered. ``disc``: True for the disc of a Sun that is given as a direction. ``plan``: None: made
    for the scene.
    """

    model: Reflectance = DEFAULT_MODEL
    accuracy: Accuracy = TIERS["reference"]
    disc: bool = False
    plan: ScenePlan | None = None
    albedo: Albedo | None = None


def render_enu(
    terrain: Terrain, light: Lighting | Array, view: View, how: Method = Method()
) -> Rendering:
    """Render the nodes of the terrain's core, float32.

    ``light``: a `Lighting`, or the direction (3,) to a single Sun. With the view of a camera a node is
    visible only inside the image. CameraError if the camera is below the terrain, SunError if the Sun is
    below every horizon.
    """
    return _Shot.of(terrain, light, view, how).at_nodes(view)


def render_camera(
    terrain: Terrain, camera: Camera | Scanner, light: Lighting | Array, how: Method = Method()
) -> Rendering:
    """Render the camera's plane by the first hit of every pixel's ray, float64; ``light`` as in `render_enu`.
    Each line of a scanner is seen from its own position, all under one light (`pipeline` divides an image).

    Normals are interpolated between nodes. Terrain outside the core can hide the core, but is not
    rendered. A hit is visible even if its interpolated normal faces away (its emission is then 90 deg).
    """
    view = sensor_view(camera, terrain.frame)
    return _Shot.of(terrain, light, view, how, in_camera_plane=True).of_pixels(camera)


@dataclass(frozen=True, eq=False)
class _Shot:
    """Terrain under a light, of which sources below every horizon have no irradiance."""

    terrain: Terrain
    light: Lighting
    plan: ScenePlan
    how: Method

    @classmethod
    def of(
        cls,
        terrain: Terrain,
        light: Lighting | Array,
        view: View,
        how: Method,
        in_camera_plane: bool = False,
    ) -> _Shot:
        """Raises as `render_enu`."""
        light = light if isinstance(light, Lighting) else Lighting.of_sun(light, how.disc)
        plan = how.plan or plan_scene(
            terrain,
            light.first.direction.vector,
            view,
            in_camera_plane=in_camera_plane,
            accuracy=how.accuracy,
            disc=light.first.disc is not None,
            model=how.model,
        )
        shot = cls(terrain, light_above_horizon(terrain, light), plan, how)
        check_camera(terrain, view)
        return shot

    def at_nodes(self, view: View) -> Rendering:
        """The render of the core's nodes."""
        terrain, model, sun = self.terrain, self.how.model, self.light.first.direction.vector
        field, (row0, row1, col0, col1) = terrain.field, terrain.core
        lights = [(source, self._share_at_nodes(source, cast)) for source, cast in self._planned]
        sunlit, seen = lights[0][1], self._in_sight(view)
        parallel = self._as_planned(view)
        one_way = parallel.direction if isinstance(parallel, ParallelView) else None
        quick = None if self.how.accuracy.float64 or view.camera else one_way
        angles = [np.empty(seen.shape, dtype=np.float32) for _ in range(4)]
        for row in range(row0, row1, _BLOCK_ROWS):  # limits the memory for float64 vectors
            window = (row, min(row + _BLOCK_ROWS, row1), col0, col1)
            rows = slice(window[0] - row0, window[1] - row0)
            stored = field.normals(window)
            if quick is not None:
                bands = _bands_parallel(stored, lights, rows, quick, seen, model)
                for band, values in zip(angles, bands, strict=True):
                    band[rows] = values
                continue
            points, normals = nodes_enu(field, window), stored.astype(np.float64)
            towards = view.directions(points) if one_way is None else one_way
            sunlit[rows] *= np.sum(normals * sun, axis=-1) > 0
            seen[rows] &= np.sum(normals * towards, axis=-1) > 0
            if isinstance(view, ScannerView) and self.plan.occlusion.modelled:
                seen[rows] &= ~field.occluded_nodes_towards(towards, window)
            if view.sensor is not None:
                pixels = view.sensor.project(terrain.frame.to_mcmf(points))
                seen[rows] &= view.sensor.in_image(pixels)
            bands = self._bands(normals, towards, sunlit[rows], seen[rows])
            for source, share in lights[1:]:
                bands[0][...] += _radiance(normals, source, towards, share[rows], model)
            for band, values in zip(angles, bands, strict=True):
                band[rows] = values
        radiance, incidence, emission, phase = angles
        radiance += self._under_sky(parallel)
        if self.plan.bounces:
            dark = seen & ~(sunlit > 0.0) & np.isfinite(radiance)
            radiance[dark] += self._bounced(_nodes_at(terrain, parallel, dark))
        colour, albedo = None, self.how.albedo
        if albedo is not None:
            radiance, colour = in_colour(radiance * timed("albedo")(albedo.at_nodes)(terrain))
        height = field.z_m[row0:row1, col0:col1]
        return Rendering(
            radiance, sunlit, seen, incidence, emission, phase, height_m=height, colour=colour
        )

    def of_pixels(self, camera: Camera | Scanner) -> Rendering:
        """The render of a camera's plane."""
        terrain, model = self.terrain, self.how.model
        origin, rays = camera.rays_enu(terrain.frame)
        points = _first_hits(terrain, origin, rays)
        seen = _in_core(terrain, points)
        normals = np.full(points.shape, np.nan)
        normals[seen] = terrain.field.normals_at(points[seen][:, 0], points[seen][:, 1])
        seen &= ~np.isnan(normals[..., 0])
        points[~seen] = np.nan
        sunlit, *others = (
            self._share_at_points(points, normals, source, cast) for source, cast in self._planned
        )
        bands = self._bands(normals, -rays, sunlit, seen)
        for source, share in zip(self.light.others, others, strict=True):
            bands[0][...] += _radiance(normals, source, -rays, share, model)
        if self.light.sky is not None:
            at = SurfacePoints(points[seen], normals[seen], -rays[seen])
            bands[0][seen] += timed("sky light")(sky_at_points)(
                terrain, self.light.sky, at, model, self.how.accuracy
            )
        if self.plan.bounces:
            dark = seen & (sunlit == 0.0)
            at = SurfacePoints(points[dark], normals[dark], -rays[dark])
            bands[0][dark] += self._bounced(at)
        radiance: Band = bands[0]
        colour, albedo = None, self.how.albedo
        if albedo is not None:
            factors = timed("albedo")(albedo.at_points)(terrain, points[seen])
            bright = np.broadcast_to(radiance, (*factors.shape[:-1], *seen.shape)).copy()
            bright[..., seen] *= factors
            radiance, colour = in_colour(bright)
        position = terrain.frame.to_mcmf(points)
        return Rendering(
            radiance, sunlit, seen, *bands[1:], position_mcmf_m=position, colour=colour
        )

    @property
    def _planned(self) -> list[tuple[LightSource, bool]]:
        """The sources, each with True if cast shadows are computed for it. The plan decides about shadow
        and disc of the first source; for the others both are always modelled.
        """
        disc = self.plan.solar_disc.modelled
        first = self.light.first if disc else replace(self.light.first, disc=None)
        modelled = disc or self.plan.cast_shadows.modelled
        return [(first, modelled), *((source, True) for source in self.light.others)]

    @timed("cast shadows")
    def _share_at_nodes(self, source: LightSource, shadows: bool) -> Band:
        """Share of a source above the terrain's horizon at the core's nodes, float32; 1 without ``shadows``,
        0 for a source without irradiance.
        """
        field, core, far = self.terrain.field, self.terrain.core, self.terrain.far
        if source.irradiance == 0.0 or not shadows:
            row0, row1, col0, col1 = core
            share = 0.0 if source.irradiance == 0.0 else 1.0
            return np.full((row1 - row0, col1 - col0), share, dtype=np.float32)
        if source.disc is not None:
            return sunlit_share(field, source.direction, self.how.accuracy, core, source.disc, far)
        dark = occluded(field, source.direction, self.how.accuracy, core, far)
        return (~dark).astype(np.float32)

    @timed("cast shadows")
    def _share_at_points(
        self, points: Array, normals: Array, source: LightSource, shadows: bool
    ) -> Array:
        """The same at ENU points (..., 3) of the surface with their normals, float64 (...); 0 for points
        that face away.
        """
        field, far = self.terrain.field, self.terrain.far
        share = np.where(np.sum(normals * source.direction.vector, axis=-1) > 0, 1.0, 0.0)
        facing = share > 0
        if source.irradiance == 0.0 or not shadows:
            return np.zeros_like(share) if source.irradiance == 0.0 else share
        if source.disc is not None:
            share[facing] = share_at_points(
                field, points[facing], source.direction, self.how.accuracy, source.disc, far
            )
        else:
            seen_from = HorizonPoints(field, points[facing], far)
            share[facing] = ~seen_from.occluded(source.direction.vector)
        return share

    def _as_planned(self, view: View) -> View:
        """The view itself, or the parallel view in its place where the plan leaves the perspective out."""
        if self.plan.perspective.modelled or not isinstance(view, CameraView):
            return view
        return parallel_view(self.terrain, view)

    @timed("occlusion")
    def _in_sight(self, view: View) -> Mask:
        """The core's nodes that no terrain hides from a view; all where the plan leaves that out, and for
        a scanner, whose own directions tell it.
        """
        field, core = self.terrain.field, self.terrain.core
        if not self.plan.occlusion.modelled or isinstance(view, ScannerView):
            row0, row1, col0, col1 = core
            return np.ones((row1 - row0, col1 - col0), dtype=np.bool_)
        if isinstance(view, CameraView):
            return ~field.occluded_nodes_from(view.position_m, core)
        return ~occluded(field, view.direction, self.how.accuracy, core)

    @timed("reflectance")
    def _bands(
        self, normals: Array, towards: Array, sunlit: Band, seen: Mask
    ) -> tuple[Array, Array, Array, Array]:
        """Radiance under the first source; incidence, emission and phase in degrees."""
        first = self.light.first
        irradiance = first.irradiance * sunlit
        bands = photometry(
            normals, first.direction.vector, towards, irradiance > 0.0, seen, self.how.model
        )
        angles = [np.degrees(band) for band in bands[1:]]
        return bands.radiance * irradiance, angles[0], angles[1], angles[2]

    @timed("sky light")
    def _under_sky(self, view: View) -> Band | np.float32:
        """Radiance of the core's nodes under a sky."""
        sky, how = self.light.sky, self.how
        if sky is None:
            return np.float32(0.0)
        return sky_at_nodes(self.terrain, sky, view, how.model, how.accuracy)

    @timed(SCATTERED)
    def _bounced(self, at: SurfacePoints) -> Array:
        """Radiance of points by light from other ground, with the albedo there; of a map in colour its
        luminance.
        """
        albedo = self.how.albedo

        def factors(points: Array) -> Array:
            assert albedo is not None
            found = albedo.at_points(self.terrain, points)
            return np.asarray(found if found.ndim == 1 else luminance(found[:, None])[0])

        ground = None if albedo is None else factors
        return bounced_at_points(
            self.terrain, self.light, at, self.how.model, self.how.accuracy, ground
        )


def _nodes_at(terrain: Terrain, view: View, which: Mask) -> SurfacePoints:
    """Nodes of the core, those of a mask, as a view sees them."""
    points = nodes_enu(terrain.field, terrain.core)[which]
    normals = terrain.field.normals(terrain.core)[which].astype(np.float64)
    one_way = view.direction if isinstance(view, ParallelView) else None
    return SurfacePoints(points, normals, view.directions(points) if one_way is None else one_way)


def in_colour(radiance: Band) -> tuple[Band, Band | None]:
    """Radiance (rows, cols) itself, without colour; or the luminance of red, green and blue
    (3, rows, cols), and these.
    """
    return (radiance, None) if radiance.ndim == 2 else (luminance(radiance), radiance)


def check_camera(terrain: Terrain, view: View) -> None:
    """Raise CameraError for a camera below the terrain's surface."""
    if not isinstance(view, CameraView):
        return
    x, y, z = view.position_m
    ground = float(terrain.field.heights_at(x, y))
    if z < ground:
        name = view.camera.name if view.camera else "the view"
        _, _, height = mcmf_to_lonlat(terrain.frame.to_mcmf(view.position_m))
        raise CameraError(
            f"{name}: the camera is {ground - z:.0f} m below the surface "
            f"({float(height):.0f} m above the reference sphere)"
        )


@timed("occlusion")
def _first_hits(terrain: Terrain, origin: Array, rays: Array) -> Array:
    """ENU points (rows, columns, 3) where rays first meet the surface; ``origin`` (3,) of all of them, or
    (rows, 3).
    """
    if origin.ndim == 1:
        return np.asarray(origin + terrain.field.first_hits(origin, rays)[..., None] * rays)
    away = terrain.field.first_hits_of_lines(origin, rays)
    return np.asarray(origin[:, None] + away[..., None] * rays)


def _in_core(terrain: Terrain, points: Array) -> Mask:
    """Hits within half a cell of the core window's nodes; False for NaN."""
    row0, row1, col0, col1 = terrain.core
    field = terrain.field
    col = (points[..., 0] - field.x0_m) / field.gsd_m
    row = (field.y0_m - points[..., 1]) / field.gsd_m
    inside = (row >= row0 - 0.5) & (row <= row1 - 0.5) & (col >= col0 - 0.5) & (col <= col1 - 0.5)
    return np.asarray(inside)


@timed("reflectance")
def _bands_parallel(
    normals: NDArray[np.float32],
    lights: list[tuple[LightSource, Band]],
    rows: slice,
    towards: Array,
    seen: Mask,
    model: Reflectance,
) -> tuple[Band, Band, Band, Band]:
    """`_bands` of some rows in single precision, under all sources with their shares (rows, cols). The
    share of the first source and ``seen`` are updated in place.
    """
    weights: list[tuple[Array, Band | Mask]] = [
        (s.direction.vector, np.float32(s.irradiance) * share[rows]) for s, share in lights
    ]
    first = lights[0][0]
    if len(lights) == 1 and first.disc is None and first.irradiance == 1.0:
        weights = [(first.direction.vector, lights[0][1][rows] > 0.0)]
    bands = bands_of_nodes(normals, weights, towards, model)
    lights[0][1][rows] *= bands.lit_side
    seen[rows] &= bands.near_side
    bands.radiance[~seen[rows]] = np.nan
    return bands[:4]


def _radiance(
    normals: Array, source: LightSource, to_camera: Array, share: Band, model: Reflectance
) -> Array:
    """Radiance of visible points under another source."""
    factor = radiance_under(normals, source.direction.vector, to_camera, share > 0.0, model)
    return source.irradiance * share * factor
