"""Comparison of a whole image with renders of its terrain: of a DEM, or of a catalogue's patches
alone.

The image is resampled to the terrain's nodes; the terrain is rendered under the Sun and view of the
image; both are brought to the same cells and point spread; windows are correlated
(`window_correlation`). Nothing is fitted except the sensor's position, in advance, and the gain and
offset of each window.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from ..accuracy import TIERS, Accuracy
from ..arrays import Array, Index
from ..cameras.frame_camera import Camera
from ..cameras.view import CameraView, View, sensor_view
from ..catalog.catalogue import Catalog
from ..catalog.patch_terrain import nodes_mcmf, patch_terrain
from ..dem.effective_resolution import Resolution, of_file
from ..dem.mosaic import DemSet
from ..errors import AreaError, ImageError
from ..geometry.frames import mcmf_to_lonlat
from ..images.image import Image
from ..light.environment import Environment
from ..light.sun_choice import SunChoice
from ..photometry.albedo_map import AlbedoMap
from ..photometry.laws import Reflectance
from ..rendering.pipeline import prepare_terrain
from ..rendering.renderer import render_enu
from ..rendering.request import Request, ViewChoice
from ..terrain.terrain import Terrain
from .orthoimage import Pair, orthorectify, paired, terrain_nodes
from .window_correlation import WindowComparison, compare, of_patches

SEARCH_CELLS = 2
"""Search radius of the offset of each window, cells."""


@dataclass(frozen=True)
class WindowChoice:
    """Side and spacing of the windows in cells, and the cell size ``gsd_m`` (None: the effective
    resolution of the terrain).
    """

    size: int = 16
    step: int = 16
    gsd_m: float | None = None
    remove_offset: bool = False

    @property
    def offset(self) -> Literal["kept", "removed"]:
        return "removed" if self.remove_offset else "kept"


@dataclass(frozen=True)
class RenderSettings:
    """How terrain is rendered for a comparison. ``environment``: an environment map as the light, in
    each patch's own frame; ``disc``: extended solar disc over a DEM, None: as the accuracy says.
    """

    model: Reflectance
    accuracy: Accuracy = TIERS["standard"]
    albedo: AlbedoMap | None = None
    environment: Environment | None = None
    disc: bool | None = None


@dataclass(frozen=True, eq=False)
class GroundComparison:
    """The compared windows with their places; descriptions of the cell size (``resolution``) and of
    the rendered terrain (``against``); image and render on the cells, (rows, cols) or for each
    patch (n, rows, cols); and the files that were read.
    """

    windows: WindowComparison
    longitude_deg: Array  # (n,) of the windows' centres
    latitude_deg: Array
    resolution: str
    against: str
    image: Array
    render: Array
    point: Index | None = None  # (n,) row of each window's point in the catalogue, for patches
    sources: tuple[Path, ...] = ()


# -- against a DEM


def against_dem(
    image: Image,
    dems: DemSet,
    settings: RenderSettings,
    choice: WindowChoice = WindowChoice(),
) -> GroundComparison:
    """Compare the part of an image that a DEM covers. AreaError if there is none; ImageError
    if it is smaller than a window; other errors as `pipeline.prepare`.

    The effective resolution is that of the DEM file (`effective_resolution.of_file`). Cells finer
    than the posting are rendered at their own size.
    """
    request = dem_request(image, dems, settings)
    scene = prepare_terrain(request)
    resolution = resolution_of(scene.terrain, dems)
    target_m = resolution.resolution_m if choice.gsd_m is None else choice.gsd_m
    cell_m = rendered_cell_m(scene.gsd_m, target_m)
    if cell_m != scene.gsd_m:
        scene = prepare_terrain(replace(request, gsd_m=cell_m))
    shot = scene.expose()
    nodes = terrain_nodes(scene.terrain)
    ortho = orthorectify(image, nodes, shot.visible)
    pair = paired(
        ortho.signal, shot.radiance, ortho.weight, gsd_m=scene.gsd_m, target_m=target_m,
        dem_fwhm_m=resolution.point_spread_m,
    )  # fmt: skip
    rows, cols = pair.image.shape
    if min(rows, cols) < choice.size:
        raise ImageError(
            f"{image.name}: the image shows {rows} x {cols} cells of {pair.gsd_m:.4g} m, and a window has "
            f"{choice.size} x {choice.size}: give a DEM with finer detail, or smaller cells (`gsd_m`)"
        )
    found = compare(
        pair.image, pair.render, pair.weight, gsd_m=pair.gsd_m, size=choice.size, step=choice.step,
        offset=choice.offset, search_px=SEARCH_CELLS,
    )  # fmt: skip
    lon, lat = _places(nodes, pair, found)
    names = ", ".join(dem.path.name for dem in dems.dems)
    told = resolution.how if choice.gsd_m is None else f"cell size as given; {resolution.how}"
    return GroundComparison(
        found,
        lon,
        lat,
        told,
        f"{names} at {scene.gsd_m:.5g} m{', with albedo' if settings.albedo else ''}",
        np.where(pair.weight > 0.5, pair.image, np.nan),
        np.where(pair.weight > 0.5, pair.render, np.nan),
        sources=scene.sources,
    )


def resolution_of(terrain: Terrain, dems: DemSet) -> Resolution:
    """Effective resolution of the DEM file that gave most heights of a terrain's core."""
    row0, row1, col0, col1 = terrain.core
    index = terrain.product_index[row0:row1, col0:col1]
    return of_file(dems.dems[int(np.bincount(index[index >= 0]).argmax())])


def rendered_cell_m(posting_m: float, target_m: float) -> float:
    """Cell size of the render for windows on cells of ``target_m``: half of it, but not finer than
    the DEM; ``target_m`` itself if that is finer than the DEM. Still finer renders take longer by
    the square of the ratio and agree no better with images.
    """
    return min(max(posting_m, 0.5 * target_m), target_m)


def dem_request(image: Image, dems: DemSet, settings: RenderSettings) -> Request:
    """Request of a render of an image's terrain, at the DEM's cell size, under the Sun and view of
    the image, or under an environment map.
    """
    sensor = image.sensor.full
    if isinstance(sensor, Camera):
        sensor = replace(sensor, sun_position_mcmf_m=image.sun_position_mcmf_m)
    sun = SunChoice()
    if not isinstance(sensor, Camera) or image.sun_position_mcmf_m is None:
        sun = SunChoice(subsolar_deg=subsolar(image))
    return Request(
        dems,
        sun=sun,
        view=ViewChoice(sensor),
        model=settings.model,
        accuracy=settings.accuracy,
        albedo=settings.albedo,
        surface="heightfield",
        environment=settings.environment,
        disc=settings.disc,
    )


def subsolar(image: Image) -> tuple[float, float]:
    """Subsolar longitude and latitude, degrees: the place whose vertical is the direction to the
    Sun.
    """
    lon, lat, _ = mcmf_to_lonlat(image.sun_directions(np.zeros(3)))
    return float(lon), float(lat)


def _places(nodes: Array, pair: Pair, found: WindowComparison) -> tuple[Array, Array]:
    """Longitude and latitude of the windows' centres, from the nearest node; NaN without a height."""
    middle = 0.5 * (found.size - 1)
    row, col = (
        np.clip(np.rint(pair.grid.start_px + pair.grid.ratio * (first + middle)), 0, count - 1)
        for first, count in zip((found.row, found.col), nodes.shape[:2], strict=True)
    )
    lon, lat, _ = mcmf_to_lonlat(nodes[row.astype(int), col.astype(int)])
    return lon, lat


# -- against patches alone


def against_patches(
    image: Image,
    catalog: Catalog,
    points: Index,
    settings: RenderSettings,
    choice: WindowChoice = WindowChoice(),
) -> GroundComparison:
    """Compare the patches of some points, catalogue rows (n,), each rendered from its own nodes, on
    their own or on coarser cells.

    The albedo is the catalogue's. Of patches with different cell sizes those of the most common size
    are compared. AreaError if no patch lies entirely in the image, or for cells finer than those of the patches.
    """
    gsd_m, rows = _of_one_size(catalog, points)
    target_m = gsd_m if choice.gsd_m is None else choice.gsd_m
    if target_m < gsd_m * (1.0 - 1e-6):
        raise AreaError(
            f"cells of {target_m:g} m are finer than those of the patches, {gsd_m:g} m; give a `dem` or a coarser `gsd_m`"
        )
    pairs = [_pair(image, catalog, int(row), settings, target_m) for row in rows]
    whole = [k for k, pair in enumerate(pairs) if pair is not None and (pair.weight > 0.5).all()]
    if not whole:
        raise AreaError(
            f"{image.name}: no patch of the catalogue is entirely in the image, sunlit and without invalid pixels"
        )
    images, renders, weights = (
        np.stack([getattr(pairs[k], name) for k in whole]) for name in ("image", "render", "weight")
    )
    found = of_patches(images, renders, weights, gsd_m=target_m, size=choice.size, step=choice.step)
    assert found.patch is not None
    point = rows[whole][found.patch]
    told = "cell size of the patches" if choice.gsd_m is None else "cell size as given"
    if found.size < choice.size:
        told += f"; windows of {found.size} cells, because a patch is no larger"
    return GroundComparison(
        found,
        catalog.longitude[point],
        catalog.latitude[point],
        told,
        f"{len(whole)} patches of the catalogue",
        images,
        renders,
        point=point,
    )


def _of_one_size(catalog: Catalog, points: Index) -> tuple[float, Index]:
    """Most common cell size of some points' patches, and the points that have it."""
    if not len(points):
        raise AreaError("no point of the catalogue is in view")
    sizes, count = np.unique(np.round(catalog.gsd[points], 6), return_counts=True)
    common = float(sizes[int(np.argmax(count))])
    return common, points[np.isclose(catalog.gsd[points], common, rtol=1e-6)]


def _pair(
    image: Image, catalog: Catalog, row: int, settings: RenderSettings, target_m: float
) -> Pair | None:
    """Render of one patch and the image on its nodes; None if its centre is hidden from the sensor
    or not lit.
    """
    terrain = patch_terrain(catalog, row)
    sensor = image.sensor.full
    towards = sensor.towards(terrain.frame.origin_mcmf_m)
    if not np.isfinite(towards).all() or towards @ terrain.frame.rotation[2] <= 0.0:
        return None
    sun = terrain.frame.direction_from_mcmf(image.sun_directions(terrain.frame.origin_mcmf_m))
    if settings.environment is None and sun[2] <= 0.0:
        return None
    shot = render_enu(
        terrain,
        sun if settings.environment is None else settings.environment.lighting,
        _beyond_image(sensor_view(sensor, terrain.frame)),
        model=settings.model,
        accuracy=settings.accuracy,
    )
    radiance = np.asarray(shot.radiance, dtype=np.float64)
    if catalog.albedo is not None:
        radiance = radiance * np.nan_to_num(catalog.albedo[row], nan=1.0)
    ortho = orthorectify(image, nodes_mcmf(catalog, [row])[0], shot.visible)
    gsd_m = terrain.field.gsd_m
    pair = paired(ortho.signal, radiance, ortho.weight, gsd_m=gsd_m, target_m=target_m)
    whole = np.ones(radiance.shape)  # the patch's edge does not count as missing
    edge = paired(whole, whole, whole, gsd_m=gsd_m, target_m=target_m).weight
    return replace(pair, weight=pair.weight / edge)


def _beyond_image(view: View) -> View:
    """The view without the image's borders; `orthorectify` decides which nodes are in the image."""
    return CameraView(view.position_m) if isinstance(view, CameraView) else view
