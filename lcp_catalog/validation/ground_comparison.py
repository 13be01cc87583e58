"""A whole image against renders of the ground it shows: of a DEM, or of a catalogue's patches alone.

The image is brought to the ground's nodes, the ground is rendered under the image's Sun as its sensor saw it, both are brought
to the same cells and the same point spread, and windows are correlated (`windows`). Nothing is fitted but the sensor's place,
before, and each window's own gain and offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..accuracy import Accuracy
from ..arrays import Array, Index
from ..cameras.frame_camera import Camera
from ..cameras.view import View, sensor_view
from ..catalog.catalogue import Catalog
from ..catalog.patch_terrain import nodes_mcmf, patch_terrain
from ..errors import AreaError
from ..geometry.frames import mcmf_to_lonlat
from ..images.image import Image
from ..light.sun_choice import SunChoice
from ..photometry.albedo_map import AlbedoMap
from ..photometry.laws import Reflectance
from ..rendering.pipeline import prepare_terrain
from ..rendering.renderer import render_enu
from ..rendering.request import Request, ViewChoice
from .dem_resolution import of_terrain
from .orthoimage import orthorectify, terrain_nodes
from .point_spread import Pair, paired
from .window_correlation import WindowComparison, compare, of_patches

SEARCH_CELLS = 2
"""How far each window's own best place is looked for, for the quiver."""


@dataclass(frozen=True)
class WindowChoice:
    """Windows of ``size`` cells, each ``step`` from the next; cells of ``gsd_m``, None: of the ground's true resolution."""

    size: int = 16
    step: int = 16
    gsd_m: float | None = None
    remove_offset: bool = False

    @property
    def offset(self) -> Literal["kept", "removed"]:
        return "removed" if self.remove_offset else "kept"


@dataclass(frozen=True, eq=False)
class GroundComparison:
    """The windows, where each lies, how the cells were chosen and against what; ``image`` and ``render`` on those cells, (rows,
    cols) or of each patch (n, rows, cols), and the files that were read.
    """

    windows: WindowComparison
    longitude_deg: Array  # (n,) of each window's middle
    latitude_deg: Array
    resolution: str
    against: str
    image: Array
    render: Array
    point: Index | None = (
        None  # (n,) which point of the catalogue a window belongs to, where patches are compared
    )
    sources: tuple[Path, ...] = ()


# -- against a DEM


def against_dem(
    photo: Image,
    dem_paths: Sequence[Path | str],
    model: Reflectance,
    accuracy: Accuracy,
    choice: WindowChoice = WindowChoice(),
    albedo: AlbedoMap | None = None,
) -> GroundComparison:
    """All of an image that a DEM holds. AreaError where it holds none; other errors as `exposure.prepare`.

    The DEM's own posting tells what it resolves. Cells finer than the posting are rendered at their own size.
    """
    request = dem_request(photo, dem_paths, model, accuracy, albedo)
    scene = prepare_terrain(request)
    resolution = of_terrain(scene.terrain)
    target_m = resolution.resolution_m if choice.gsd_m is None else choice.gsd_m
    cell_m = rendered_cell_m(scene.gsd_m, target_m)
    if cell_m != scene.gsd_m:
        scene = prepare_terrain(replace(request, gsd_m=cell_m))
    shot = scene.expose()
    nodes = terrain_nodes(scene.terrain)
    ortho = orthorectify(photo, nodes, shot.visible)
    how = {"target_m": target_m, "dem_fwhm_m": resolution.point_spread_m}
    pair = paired(ortho.signal, shot.radiance, ortho.weight, gsd_m=scene.gsd_m, **how)
    found = compare(
        pair.image, pair.render, pair.weight, gsd_m=pair.gsd_m, size=choice.size, step=choice.step,
        offset=choice.offset, search_px=SEARCH_CELLS,
    )  # fmt: skip
    lon, lat = _places(nodes, pair, found)
    names = ", ".join(Path(path).name for path in dem_paths)
    told = resolution.how if choice.gsd_m is None else f"cells as asked; {resolution.how}"
    return GroundComparison(
        found,
        lon,
        lat,
        told,
        f"{names} at {scene.gsd_m:.5g} m{', with albedo' if albedo else ''}",
        np.where(pair.weight > 0.5, pair.image, np.nan),
        np.where(pair.weight > 0.5, pair.render, np.nan),
        sources=scene.sources,
    )


def rendered_cell_m(posting_m: float, target_m: float) -> float:
    """The cells to render on for windows on cells of ``target_m``: half of those, not finer than the DEM; cells finer than the
    DEM as they are. Finer renders cost the square of the ratio more, and made photographs no more alike (docs/validation.md).
    """
    return min(max(posting_m, 0.5 * target_m), target_m)


def dem_request(
    photo: Image,
    dem_paths: Sequence[Path | str],
    model: Reflectance,
    accuracy: Accuracy,
    albedo: AlbedoMap | None = None,
) -> Request:
    """What a render of the ground that an image shows is asked for, at the DEM's own cells and under the image's Sun."""
    sensor = photo.sensor.full
    if isinstance(sensor, Camera):
        sensor = replace(sensor, sun_position_mcmf_m=photo.sun_position_mcmf_m)
        view = ViewChoice(camera=sensor)
    else:
        view = ViewChoice(sensor=sensor)
    sun = SunChoice()
    if not isinstance(sensor, Camera) or photo.sun_position_mcmf_m is None:
        sun = SunChoice(subsolar_deg=subsolar(photo))
    return Request(
        dem_paths,
        sun=sun,
        view=view,
        model=model,
        accuracy=accuracy,
        albedo=albedo,
        surface="heightfield",
    )


def subsolar(photo: Image) -> tuple[float, float]:
    """Where the Sun is overhead, longitude and latitude: the place whose vertical is the direction to it."""
    lon, lat, _ = mcmf_to_lonlat(photo.sun_directions(np.zeros(3)))
    return float(lon), float(lat)


def _places(nodes: Array, pair: Pair, found: WindowComparison) -> tuple[Array, Array]:
    """Longitude and latitude of the windows' middles, each from its nearest node; NaN over ground without a height."""
    middle = 0.5 * (found.size - 1)
    row, col = (
        np.clip(np.rint(pair.grid.start_px + pair.grid.ratio * (first + middle)), 0, count - 1)
        for first, count in zip((found.row, found.col), nodes.shape[:2], strict=True)
    )
    lon, lat, _ = mcmf_to_lonlat(nodes[row.astype(int), col.astype(int)])
    return lon, lat


# -- against patches alone


def against_patches(
    photo: Image,
    catalog: Catalog,
    points: Index,
    model: Reflectance,
    accuracy: Accuracy,
    choice: WindowChoice = WindowChoice(),
) -> GroundComparison:
    """The patches of some of a catalogue's points (rows, (n,)), each rendered from its own nodes, on their own cells (or on
    coarser ones, as asked). AreaError where none lies whole in the image, or for cells finer than theirs.

    Where patches have different cells those of the most common size are taken.
    """
    gsd_m, rows = _of_one_size(catalog, points)
    target_m = gsd_m if choice.gsd_m is None else choice.gsd_m
    if target_m < gsd_m * (1.0 - 1e-6):
        raise AreaError(
            f"cells of {target_m:g} m are finer than the patches' {gsd_m:g} m; give --dem, or a coarser --gsd"
        )
    pairs = [_pair(photo, catalog, int(row), model, accuracy, target_m) for row in rows]
    whole = [k for k, pair in enumerate(pairs) if pair is not None and (pair.weight > 0.5).all()]
    if not whole:
        raise AreaError(
            f"{photo.name}: no patch of the catalogue lies whole in the image, lit by its Sun and with valid pixels"
        )
    images, renders, weights = (
        np.stack([getattr(pairs[k], name) for k in whole]) for name in ("image", "render", "weight")
    )
    found = of_patches(images, renders, weights, gsd_m=target_m, size=choice.size, step=choice.step)
    assert found.patch is not None
    point = rows[whole][found.patch]
    told = "the patches' own cells" if choice.gsd_m is None else "cells as asked"
    if found.size < choice.size:
        told += f"; a patch holds only {found.size} of them a side"
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
    """The most common cell of some points' patches, and which of them have it."""
    if not len(points):
        raise AreaError("none of the catalogue's points is in view")
    sizes, count = np.unique(np.round(catalog.gsd[points], 6), return_counts=True)
    common = float(sizes[int(np.argmax(count))])
    return common, points[np.isclose(catalog.gsd[points], common, rtol=1e-6)]


def _pair(
    photo: Image,
    catalog: Catalog,
    row: int,
    model: Reflectance,
    accuracy: Accuracy,
    target_m: float,
) -> Pair | None:
    """One patch, and the image on its nodes; None where the sensor cannot have seen its middle."""
    terrain = patch_terrain(catalog, row)
    sensor = photo.sensor.full
    towards = sensor.towards(terrain.frame.origin_mcmf_m)
    if not np.isfinite(towards).all() or towards @ terrain.frame.rotation[2] <= 0.0:
        return None
    sun = terrain.frame.direction_from_mcmf(photo.sun_directions(terrain.frame.origin_mcmf_m))
    if sun[2] <= 0.0:
        return None
    shot = render_enu(
        terrain,
        sun,
        _beyond_image(sensor_view(sensor, terrain.frame)),
        model=model,
        accuracy=accuracy,
    )
    radiance = np.asarray(shot.radiance, dtype=np.float64)
    if catalog.albedo is not None:
        radiance = radiance * np.nan_to_num(catalog.albedo[row], nan=1.0)
    ortho = orthorectify(photo, nodes_mcmf(catalog, [row])[0], shot.visible)
    how: dict[str, Any] = {"gsd_m": terrain.field.gsd_m, "target_m": target_m}
    pair = paired(ortho.signal, radiance, ortho.weight, **how)
    whole = np.ones(radiance.shape)  # a patch's own edge is no gap in it
    return replace(pair, weight=pair.weight / paired(whole, whole, whole, **how).weight)


def _beyond_image(view: View) -> View:
    """The view without its image's border: which nodes lie in the image `ortho` knows."""
    return replace(view, camera=None)
