"""Renders of a catalogue's patches as a navigator makes them for an image: each from its own nodes
alone, under the image's Sun, seen by its camera, in its pixels.

Every node is projected by the camera itself, or to 0.002 px for a scanner (`node_pixels`). The
surface's triangles are drawn, the nearest in front, on ``sub`` x ``sub`` samples of each pixel,
with shadows that the patch casts on itself; a pixel is the mean over its square and a Gaussian
point spread. So the image is never resampled, and a drawing can be shifted by any fraction of a
pixel (`kernels.matching.point_spread`).

Projection of the nodes of patches: by the sensor itself, or, for a slow sensor, by a polynomial
per patch that is checked against it.

A scanner solves for the image line of every point. Over one patch its pixels are a smooth function
of position: all terms up to the third order in east, north and up, fitted to 4 x 4 x 3 exact
points, leave less than `TOLERANCE_PX`, unless the patch's width is a good part of its distance to
the sensor, or the projection jumps (push-frames). Residuals at those points and at 9 nodes detect
this, and such patches are projected node by node.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Float32, Index, Mask
from ..cameras.frame_camera import Camera
from ..cameras.public import SensorOrPath, any_sensor
from ..cameras.sensor import Sensor
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..catalog.patch_terrain import nodes_mcmf
from ..kernels.matching import draw_patch, point_spread
from ..landmarks.point_spread import LEAST_COVER, POINT_SPREAD_PX, reduced_spread_px
from ..photometry.law_choice import law_of
from ..photometry.laws import DEFAULT_MODEL, Reflectance
from .point_choice import directions_to_sun

TOLERANCE_PX = 0.002
"""Largest accepted difference between polynomial and sensor where it is checked."""

_ORDER = 3
_ACROSS = np.array([-1.0, -0.5, 0.5, 1.0])
_UP = np.array([-1.0, 0.0, 1.0])
_TERMS = [
    (a, b, c)
    for a in range(_ORDER + 1)
    for b in range(_ORDER + 1 - a)
    for c in range(min(len(_UP), _ORDER + 1 - a - b))
]
"""Powers of east, south and up."""


def node_pixels(catalog: Catalog, rows: Index, nodes_mcmf: Array, sensor: Sensor) -> Array:
    """Pixels (n, p, p, 2) of the nodes (n, p, p, 3) of the patches ``rows``; NaN for nodes that the
    sensor cannot see.
    """
    if isinstance(sensor.full, Camera) or not len(rows):  # projects by a closed form
        return sensor.project(nodes_mcmf)
    pixels, good = _interpolated(catalog, rows, nodes_mcmf, sensor)
    if not good.all():
        pixels[~good] = sensor.project(nodes_mcmf[~good])
    return pixels


def _interpolated(
    catalog: Catalog, rows: Index, nodes_mcmf: Array, sensor: Sensor
) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels by the polynomials, and True for the patches for which they are accurate."""
    half = 0.5 * (catalog.patch_nodes - 1)
    z = catalog.dem[rows].astype(np.float64)
    middle = 0.5 * (z.max(axis=(1, 2)) + z.min(axis=(1, 2)))
    rise = np.maximum(0.5 * np.ptp(z, axis=(1, 2)), 1e-3 * catalog.gsd[rows])
    east, south, up = (a.ravel() for a in np.meshgrid(_ACROSS, _ACROSS, _UP, indexing="ij"))
    across = (half * catalog.gsd[rows])[:, None]
    enu = np.stack([across * east, -across * south, middle[:, None] + rise[:, None] * up], axis=-1)
    places = catalog.position_mcmf[rows][:, None, :] + enu @ catalog.rotation_mcmf_to_enu[rows]
    exact = sensor.project(places)
    terms, solve = _design()
    factors = np.einsum("tk,nkc->ntc", solve, exact)
    worst = np.abs(np.einsum("kt,ntc->nkc", terms, factors) - exact).max(axis=(1, 2))
    height: Array = (z - middle[:, None, None]) / rise[:, None, None]
    step = np.linspace(-1.0, 1.0, catalog.patch_nodes)
    pixels = _evaluated(factors, step, height)
    some = np.unique(np.round(np.array([1 / 6, 1 / 2, 5 / 6]) * 2 * half).astype(np.int64))
    checked = np.ix_(np.arange(len(rows)), some, some)
    off = np.abs(pixels[checked] - sensor.project(nodes_mcmf[checked])).max(axis=(1, 2, 3))
    with np.errstate(invalid="ignore"):
        return pixels, np.asarray((worst < TOLERANCE_PX) & (off < TOLERANCE_PX))


@cache
def _design() -> tuple[Array, Array]:
    """The terms at the fitted points (k, t), and their pseudo-inverse (t, k)."""
    east, south, up = (a.ravel() for a in np.meshgrid(_ACROSS, _ACROSS, _UP, indexing="ij"))
    terms = np.stack([east**a * south**b * up**c for a, b, c in _TERMS], axis=-1)
    return terms, np.linalg.pinv(terms)


def _evaluated(factors: Array, step: Array, height: Array) -> Array:
    """The polynomials (n, t, 2) at nodes with places east and south ``step`` (p,) and heights (n,
    p, p).
    """
    powers = step[:, None] ** np.arange(_ORDER + 1)
    out = np.zeros((*height.shape, 2))
    for c in range(len(_UP)):
        square = np.zeros((len(factors), _ORDER + 1, _ORDER + 1, 2))
        for k, (a, b, up) in enumerate(_TERMS):
            if up == c:
                square[:, b, a] = factors[:, k]
        level = np.einsum("ib,nbac,ja->nijc", powers, square, powers, optimize=True)
        out += level * (height**c)[..., None]
    return out


_SAMPLES_A_NODE = 2.0
_SUB = (3, 8)
"""Samples along a pixel's side: two to each node's width, within these limits."""
_WIDEST_PX = 2048
"""Largest side in pixels of a patch that is drawn; a larger one is too close to the camera, or at
the limit of its lens model.
"""


@dataclass(frozen=True, eq=False)
class Templates:
    """Renders of n patches. ``values`` are radiance factors, 0 outside ``mask``; pixel (i, j) lies
    on the image's pixel (column origin[0] + j, row origin[1] + i).
    """

    point: Index  # (n,) rows in the catalogue
    predicted_px: Array  # (n, 2) of the patch's centre
    origin: Index  # (n, 2) column and row of the image
    values: Float32  # (n, rows, cols)
    mask: Mask  # (n, rows, cols) pixels that lie on the patch
    drawing: Float32  # (n, rows * sub, cols * sub) NaN where the patch is not seen
    sub: int
    sigma_px: float

    def __len__(self) -> int:
        return len(self.point)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of each template."""
        return self.values.shape[1], self.values.shape[2]

    @property
    def lit_share(self) -> Array:
        """Share of each template's pixels that receive light, (n,); 0 for an empty one."""
        count = self.mask.sum(axis=(1, 2))
        return np.asarray((self.values > 0.0).sum(axis=(1, 2)) / np.maximum(count, 1))


def render_patches(
    catalog: CatalogOrPath,
    index: ArrayLike,
    sensor: SensorOrPath,
    sun_directions: ArrayLike | None = None,
    model: Reflectance | str = DEFAULT_MODEL,
    *,
    psf_sigma_px: float = POINT_SPREAD_PX,
    least_cover: float = LEAST_COVER,
) -> Templates:
    """Render patches into the pixels of a sensor.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    index:
        Rows (n,) of the catalogue.
    sensor:
        Camera or another sensor, or its file.
    sun_directions:
        Unit MCMF vectors towards the Sun, (n, 3), or (3,) for all patches; None: from the sensor's
        own Sun position.
    model:
        Reflectance law, or its name.
    psf_sigma_px:
        Standard deviation of the Gaussian point spread, pixels of the full-resolution image.
    least_cover:
        Least share of a pixel's point spread that falls on the patch, for the pixel to count.

    Returns
    -------
    Templates
        ``values`` (n, rows, cols), radiance factors; all are as large as the largest one. ``mask`` is
        empty for a patch that the sensor does not see whole or that covers more than 2048 pixels
        along a side. Memory: 4 sub^2 + 5 bytes per template pixel, 64 per node.

    Raises
    ------
    SunError
        If ``sun_directions`` is None and the sensor has no Sun.

    Examples
    --------
    >>> points = lcp.choose_points(catalog, camera)
    >>> patches = lcp.render_patches(catalog, points, camera)
    >>> len(patches) == len(points), patches.values.dtype
    (True, dtype('float32'))
    """
    catalog, sensor = opened_catalog(catalog), any_sensor(sensor)
    placed = PlacedPatches.of(catalog, np.asarray(index, dtype=np.int64), sensor)
    suns = directions_to_sun(sensor, catalog.position_mcmf[placed.point], sun_directions)
    spread_px = reduced_spread_px(float(psf_sigma_px), sensor.factor)
    return placed.templates(suns, law_of(model) or DEFAULT_MODEL, spread_px, least_cover)


@dataclass(frozen=True, eq=False)
class PlacedPatches:
    """n patches where a sensor sees them: all of a render but the light and the law."""

    catalog: Catalog
    point: Index  # (n,) rows in the catalogue
    predicted_px: Array  # (n, 2) of the patch's centre
    towards: Array  # (n, 4, 3) from the corners to the sensor, in the patch's frame
    pixels: Array  # (n, p, p, 2) of the nodes
    seen: Mask  # (n,) whole
    origin: Index  # (n, 2) column and row of each render's first pixel
    shape: tuple[int, int]  # rows and columns of the renders
    sub: int

    @classmethod
    def of(cls, catalog: Catalog, rows: Index, sensor: Sensor) -> PlacedPatches:
        """The patches of rows (n,) of the catalogue."""
        nodes = nodes_mcmf(catalog, rows)
        corners = nodes[:, [0, 0, -1, -1], [0, -1, 0, -1]]
        towards = np.einsum(
            "nij,ncj->nci", catalog.rotation_mcmf_to_enu[rows], sensor.towards(corners)
        )
        pixels = node_pixels(catalog, rows, nodes, sensor)
        pixels, seen, origin, shape = _placed(pixels, towards)
        sub = _samples(pixels[seen], nodes.shape[1])
        predicted = sensor.project(catalog.position_mcmf[rows])
        towards = np.ascontiguousarray(towards)
        return cls(catalog, rows, predicted, towards, pixels, seen, origin, shape, sub)

    def drawn(self, sun_directions: Array, law: Reflectance) -> Float32:
        """Radiance factors (n, rows * sub, cols * sub) under Suns (n, 3), unit MCMF vectors; NaN where a patch
        is not seen.
        """
        catalog, rows = self.catalog, self.point
        suns = np.einsum("nij,nj->ni", catalog.rotation_mcmf_to_enu[rows], sun_directions)
        albedo = np.empty((len(rows), 0, 0), np.float32)
        if catalog.albedo is not None:
            albedo = np.nan_to_num(catalog.albedo[rows], nan=1.0)
        high, wide = (side * self.sub for side in self.shape)
        drawing = np.empty((len(rows), high, wide), dtype=np.float32)
        draw_patch.draw_patches(
            catalog.dem[rows], catalog.gsd[rows].astype(np.float64), albedo, suns, self.towards,
            self.pixels, self.origin, self.sub, law.code, law.numbers, drawing,
        )  # fmt: skip
        drawing[~self.seen] = np.nan
        return drawing

    def templates(
        self, suns: Array, law: Reflectance, spread_px: float, least_cover: float = LEAST_COVER
    ) -> Templates:
        """Renders under Suns (n, 3), unit MCMF vectors, with a point spread of ``spread_px`` (1 sigma) in the sensor's
        own pixels.
        """
        drawing = self.drawn(suns, law)
        values = np.empty((len(drawing), *self.shape), np.float32)
        mask = np.empty(values.shape, np.bool_)
        point_spread.templates(drawing, self.sub, spread_px, float(least_cover), values, mask)
        return Templates(
            self.point, self.predicted_px, self.origin, values, mask, drawing, self.sub, spread_px
        )


def _placed(pixels: Array, towards: Array) -> tuple[Array, Mask, Index, tuple[int, int]]:
    """Pixels (n, p, p, 2) of the nodes, 0 for patches that are not seen whole; True for those seen
    whole; column and row of the first pixel of each; rows and columns of the largest.
    """
    flat = np.ascontiguousarray(np.moveaxis(pixels, 3, 0))  # four times as fast to search
    low, high = flat.min(axis=(2, 3)).T, flat.max(axis=(2, 3)).T  # NaN where one of them is
    seen = (high - low < _WIDEST_PX).all(axis=1) & np.isfinite(towards).all(axis=(1, 2))
    if not seen.all():
        low, high = np.where(seen[:, None], low, 0.0), np.where(seen[:, None], high, 0.0)
        pixels = np.where(seen[:, None, None, None], pixels, 0.0)
    origin = np.floor(low + 0.5).astype(np.int64)
    size = np.ceil(high - 0.5).astype(np.int64) - origin + 1
    cols, rows = (int(v) for v in np.maximum(size.max(axis=0, initial=1), 1))
    return pixels, seen, origin, (rows, cols)


def _samples(pixels: Array, nodes: int) -> int:
    """Samples along a pixel's side, from the nodes' pixels (n, p, p, 2): by the patch with the
    closest nodes.
    """
    low, high = _SUB
    if not len(pixels) or nodes < 2:
        return low
    east, south = (pixels[:, 0, -1] - pixels[:, 0, 0]), (pixels[:, -1, 0] - pixels[:, 0, 0])
    area = np.abs(east[:, 0] * south[:, 1] - east[:, 1] * south[:, 0]) / (nodes - 1) ** 2
    node_px = math.sqrt(max(float(area.min()), 1e-6))
    return int(np.clip(math.ceil(_SAMPLES_A_NODE / node_px), low, high))
