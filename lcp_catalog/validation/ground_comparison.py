"""Comparison of a whole image with renders of its terrain: of a DEM, or of a catalogue's patches
alone.

The image is resampled to the terrain's nodes; the terrain is rendered under the Sun and view of the
image; both are brought to the same cells and point spread; windows are correlated
(`compare`). Nothing is fitted except the sensor's position, in advance, and the gain and
offset of each window.

Centred normalised correlation of image and render in windows of 16 x 16 cells.

Pivovarchuk et al. (2026) assess renders by the histogram of these correlations, its mode, and the
share above 0.9. Correlation is independent of gain and offset; nothing else is fitted, and every
window with enough valid cells counts. Arrays are (rows, cols) on one grid of the terrain.

Each window is centred by its own weighted means first. Integral images would be faster for
overlapping windows, but lose the digits that low-contrast terrain needs: its contrast is a
thousandth of its brightness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

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
from ..landmarks.correlation import moments
from ..light.environment import Environment
from ..light.sun_choice import SunChoice
from ..matching.subpixel import moved, moves, peaks, undone
from ..photometry.albedo_map import AlbedoMap
from ..photometry.laws import Reflectance
from ..rendering.pipeline import prepare_terrain
from ..rendering.renderer import Method, render_enu
from ..rendering.request import Request, ViewChoice
from ..terrain.terrain import Terrain
from .orthoimage import Pair, area_paired, orthorectify, paired, terrain_nodes

SIZE = 16
STEP = 16
LEAST_VALID = 0.9
"""Least valid share of the weight of a window that counts."""

BIN = 0.01
"""Bin width of the histogram and of its mode; the value 0.985 of the paper is the centre of a bin."""


@dataclass(frozen=True, eq=False)
class WindowComparison:
    """The n windows of a comparison, row by row from north to south.

    ``shift_px`` is the offset of the whole image from the render, in cells (right, down). If
    ``offset`` is "removed", it was removed before the comparison; if "kept", it was not estimated
    and is (0, 0).
    """

    size: int
    step: int
    gsd_m: float
    row: NDArray[np.int64]  # (n,) first row of the window
    col: NDArray[np.int64]  # (n,) first column
    correlation: Array  # (n,) -1..1; 0 where one of the two is flat
    contrast: Array  # (n,) standard deviation of the render, in its own unit
    valid: Array  # (n,) valid share of the window's weight
    offset: Literal["kept", "removed"]
    shift_px: tuple[float, float] = (0.0, 0.0)
    offset_px: Array | None = None  # (n, 2) best offset, column and row; NaN: at the search's edge
    peak: Array | None = None  # (n,) the correlation there
    patch: NDArray[np.int64] | None = None  # (n,) index of the window's patch, for patches

    @property
    def count(self) -> int:
        return len(self.correlation)

    def share_above(self, bound: float) -> float:
        """Share of the windows with a correlation above ``bound``; NaN without windows."""
        return float(np.mean(self.correlation > bound)) if self.count else float("nan")

    @property
    def median(self) -> float:
        """Median correlation; NaN without windows."""
        return float(np.median(self.correlation)) if self.count else float("nan")

    @property
    def mode(self) -> float:
        """Centre of the fullest bin of `histogram`, the highest of several; NaN without windows."""
        if not self.count:
            return float("nan")
        counts, edges = self.histogram()
        last = len(counts) - 1 - int(counts[::-1].argmax())
        return float(0.5 * (edges[last] + edges[last + 1]))

    def histogram(self, width: float = BIN) -> tuple[NDArray[np.int64], Array]:
        """Counts (m,) in bins of ``width`` from -1 to 1, and the edges of the bins (m + 1,)."""
        edges = np.linspace(-1.0, 1.0, round(2.0 / width) + 1)
        counts, _ = np.histogram(np.clip(self.correlation, -1.0, 1.0), edges)
        return counts.astype(np.int64), edges

    @property
    def textured(self) -> WindowComparison:
        """Half of the windows, those with the higher contrast in the render."""
        return self.where(
            self.contrast >= np.median(self.contrast) if self.count else self.contrast > 0
        )

    def where(self, chosen: NDArray[np.bool_]) -> WindowComparison:
        """Selection of windows by a mask (n,)."""
        arrays = ("row", "col", "correlation", "contrast", "valid", "offset_px", "peak", "patch")
        kept = {name: getattr(self, name) for name in arrays}
        return replace(self, **{name: a[chosen] for name, a in kept.items() if a is not None})

    def map(self, shape: tuple[int, int]) -> Array:
        """Correlations on the grid (rows, cols), NaN without a window; the last of overlapping
        windows.
        """
        drawn = np.full(shape, np.nan)
        for row, col, value in zip(self.row, self.col, self.correlation, strict=True):
            drawn[row : row + self.size, col : col + self.size] = value
        return drawn


def compare(
    image: ArrayLike,
    render: ArrayLike,
    weight: ArrayLike | None = None,
    *,
    gsd_m: float,
    size: int = SIZE,
    step: int = STEP,
    least_valid: float = LEAST_VALID,
    offset: Literal["kept", "removed"] = "kept",
    search_px: int = 0,
) -> WindowComparison:
    """Correlations of an image and a render (rows, cols) in windows of ``size`` x ``size`` cells at
    a spacing of ``step`` cells.

    ``weight`` (rows, cols) 0..1, default 1; cells that are NaN in either count as 0. Windows with a
    mean weight below ``least_valid`` are left out. ``offset``: "removed" first removes one common
    shift of the whole image (`common_shift`). ``search_px``: search radius of the offset of each
    window; the correlations do not use these offsets. ValueError for shapes or sizes that do not
    fit.
    """
    a, b, w = _checked(image, render, weight, size, step)
    if offset not in ("kept", "removed"):
        raise ValueError(f"offset must be kept or removed, not {offset!r}")
    shift = common_shift(a, b, w, size=size) if offset == "removed" else (0.0, 0.0)
    if offset == "removed":
        a, w = undone(a, w, shift)
    rows, cols = (np.arange(0, n - size + 1, step) for n in a.shape)
    grid = _correlations(a, b, w, size, step)
    there = grid.valid >= least_valid - 1e-9
    i, j = np.nonzero(there)
    found = WindowComparison(
        size, step, gsd_m, rows[i], cols[j], grid.correlation[there], grid.contrast[there],
        grid.valid[there], offset, shift,
    )  # fmt: skip
    return _with_offsets(found, a, b, w, search_px) if search_px else found


def of_patches(
    images: ArrayLike,
    renders: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    gsd_m: float,
    size: int = SIZE,
    step: int = STEP,
) -> WindowComparison:
    """Correlations of n patches (n, rows, cols), each an image and a render on the nodes of the
    patch.

    ``row`` and ``col`` refer to the patch; ``patch`` is its index. A patch smaller than a window is
    one window; ``size`` is then its side. Offsets are not removed. ValueError for other shapes.
    """
    a, b = np.asarray(images, dtype=np.float64), np.asarray(renders, dtype=np.float64)
    if a.ndim != 3:
        raise ValueError(f"patches must be (n, rows, cols), not {a.shape}")
    w = np.ones(a.shape) if weights is None else np.asarray(weights, dtype=np.float64)
    size = min(size, *a.shape[1:])
    each = [
        compare(image, render, weight, gsd_m=gsd_m, size=size, step=step)
        for image, render, weight in zip(a, b, w, strict=True)
    ]
    if not each:
        raise ValueError("no patch to compare")

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(found, name) for found in each])

    patch = np.repeat(np.arange(len(each)), [found.count for found in each])
    return WindowComparison(
        size=size, step=step, gsd_m=gsd_m, row=joined("row"), col=joined("col"),
        correlation=joined("correlation"), contrast=joined("contrast"), valid=joined("valid"),
        offset="kept", patch=patch,
    )  # fmt: skip


_COMMON_REACH_PX = 4


def common_shift(
    image: Array, render: Array, weight: Array, *, size: int = SIZE
) -> tuple[float, float]:
    """Offset of an image from a render in cells (right, down): the maximum of the mean correlation
    of the windows within 4 cells, interpolated by the quadratic through its neighbours.

    The error of the interpolation is below 0.05 cells for images smoothed to their cells (a test
    measures it).
    """
    scores = np.full(2 * (2 * _COMMON_REACH_PX + 1,), -np.inf)
    for (i, j), place in moves(_COMMON_REACH_PX):
        grid = _correlations(*moved(image, render, weight, place), size, size)
        there = grid.valid >= 0.5
        if there.any():
            scores[i, j] = grid.correlation[there].mean()
    if not np.isfinite(scores).any():
        return 0.0, 0.0
    column, row, _ = peaks(scores[:, :, None])
    return (float(column[0]), float(row[0])) if np.isfinite(column[0]) else (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class _Grid:
    """Figures of all windows (r, c), also of those that do not count."""

    correlation: Array
    contrast: Array
    valid: Array


def _correlations(a: Array, b: Array, w: Array, size: int, step: int) -> _Grid:
    views = [sliding_window_view(x, (size, size))[::step, ::step] for x in (a, b, w)]
    bands = [_of_row(*(np.array(view[k]) for view in views)) for k in range(len(views[0]))]
    stacked = np.array(bands).reshape(len(bands), 3, -1)
    return _Grid(*(np.ascontiguousarray(stacked[:, k]) for k in range(3)))


def _of_row(a: Array, b: Array, w: Array) -> Array:
    """Correlation, contrast and valid share (3, c) of windows (c, size, size)."""
    found = moments(*(x.reshape(len(x), -1) for x in (a, b, w)))
    return np.stack([found.correlation, found.deviation_b, found.weight / w[0].size])


def _checked(
    image: ArrayLike, render: ArrayLike, weight: ArrayLike | None, size: int, step: int
) -> tuple[Array, Array, Array]:
    """Image, render and weights in float64, 0 where either is missing."""
    a, b = np.array(image, dtype=np.float64), np.array(render, dtype=np.float64)
    w = np.ones(a.shape) if weight is None else np.array(weight, dtype=np.float64)
    if a.ndim != 2 or a.shape != b.shape or a.shape != w.shape:
        raise ValueError(
            f"shapes of image, render and weight differ: {a.shape}, {b.shape}, {w.shape}"
        )
    if size < 2 or step < 1:
        raise ValueError(f"invalid window size {size} or step {step}")
    if min(a.shape) < size:
        raise ValueError(
            f"windows of {size} cells are larger than {a.shape[0]} x {a.shape[1]} cells"
        )
    there = np.isfinite(a) & np.isfinite(b) & (w > 0.0)
    return np.where(there, a, 0.0), np.where(there, b, 0.0), np.where(there, w, 0.0)


def _with_offsets(
    found: WindowComparison, a: Array, b: Array, w: Array, reach: int
) -> WindowComparison:
    """Adds the offset with the highest correlation within ``reach`` cells to each window."""
    scores = np.full((2 * reach + 1, 2 * reach + 1, found.count), -np.inf)
    i, j = found.row // found.step, found.col // found.step
    for place, shift in moves(reach):
        grid = _correlations(*moved(a, b, w, shift), found.size, found.step)
        scores[place] = np.where(grid.valid[i, j] >= 0.5, grid.correlation[i, j], -np.inf)
    column, row, peak = peaks(scores)
    return replace(found, offset_px=np.stack([column, row], axis=-1), peak=peak)


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
    each patch's own frame; ``disc``: extended solar disc over a DEM, None: as the accuracy says;
    ``bounce``: light by way of other ground over a DEM (`choices.BOUNCES`).
    """

    model: Reflectance
    accuracy: Accuracy = TIERS["standard"]
    albedo: AlbedoMap | None = None
    environment: Environment | None = None
    disc: bool | None = None
    bounce: str = "off"


@dataclass(frozen=True, eq=False)
class GroundComparison:
    """The compared windows with their places; the same windows of area means without further
    smoothing (``plain``); descriptions of the cell size (``resolution``) and of the rendered terrain
    (``against``); image and render on the cells, (rows, cols) or for each patch (n, rows, cols);
    and the files that were read.
    """

    windows: WindowComparison
    plain: WindowComparison
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
    means = area_paired(
        ortho.signal, shot.radiance, ortho.weight, gsd_m=scene.gsd_m, target_m=target_m
    )
    plain = compare(
        means.image, means.render, means.weight, gsd_m=pair.gsd_m, size=choice.size,
        step=choice.step, offset=choice.offset,
    )  # fmt: skip
    lon, lat = _places(nodes, pair, found)
    names = ", ".join(dem.path.name for dem in dems.dems)
    told = resolution.how if choice.gsd_m is None else f"cell size as given; {resolution.how}"
    return GroundComparison(
        found,
        plain,
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
    """Cell size of the render for windows on cells of ``target_m``: the largest multiple of the
    posting up to half of it, so that heights are not interpolated, or the posting; ``target_m``
    itself if that is finer than the DEM. Still finer renders take longer by the square of the ratio
    and agree no better with images.
    """
    return min(posting_m * max(1, int(0.5 * target_m / posting_m + 1e-6)), target_m)


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
        bounce=settings.bounce,
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
    both = {k: two for k, two in enumerate(pairs) if two and (two[0].weight > 0.5).all()}
    whole = list(both)
    if not whole:
        raise AreaError(
            f"{image.name}: no patch of the catalogue is entirely in the image, sunlit and without invalid pixels"
        )
    images, renders, found = _of_pairs([pair for pair, _ in both.values()], choice)
    plain = _of_pairs([pair for _, pair in both.values()], choice)[2]
    assert found.patch is not None
    point = rows[whole][found.patch]
    told = "cell size of the patches" if choice.gsd_m is None else "cell size as given"
    if found.size < choice.size:
        told += f"; windows of {found.size} cells, because a patch is no larger"
    return GroundComparison(
        found,
        plain,
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


def _of_pairs(pairs: Sequence[Pair], choice: WindowChoice) -> tuple[Array, Array, WindowComparison]:
    """Images and renders (n, rows, cols) of pairs, and their windows."""
    images, renders, weights = (
        np.stack([getattr(pair, name) for pair in pairs]) for name in ("image", "render", "weight")
    )
    found = of_patches(
        images, renders, weights, gsd_m=pairs[0].gsd_m, size=choice.size, step=choice.step
    )
    return images, renders, found


def _pair(
    image: Image, catalog: Catalog, row: int, settings: RenderSettings, target_m: float
) -> tuple[Pair, Pair] | None:
    """Render of one patch and the image on its nodes, smoothed (`paired`) and as plain area means;
    None if its centre is hidden from the sensor or not lit.
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
        Method(model=settings.model, accuracy=settings.accuracy),
    )
    radiance = np.asarray(shot.radiance, dtype=np.float64)
    if catalog.albedo is not None:
        radiance = radiance * np.nan_to_num(catalog.albedo[row], nan=1.0)
    ortho = orthorectify(image, nodes_mcmf(catalog, [row])[0], shot.visible)
    gsd_m = terrain.field.gsd_m
    pair = paired(ortho.signal, radiance, ortho.weight, gsd_m=gsd_m, target_m=target_m)
    whole = np.ones(radiance.shape)  # the patch's edge does not count as missing
    edge = paired(whole, whole, whole, gsd_m=gsd_m, target_m=target_m).weight
    plain = area_paired(ortho.signal, radiance, ortho.weight, gsd_m=gsd_m, target_m=target_m)
    return replace(pair, weight=pair.weight / edge), plain


def _beyond_image(view: View) -> View:
    """The view without the image's borders; `orthorectify` decides which nodes are in the image."""
    return CameraView(view.position_m) if isinstance(view, CameraView) else view
