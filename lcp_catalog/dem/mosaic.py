"""Several DEM files as one DEM: the product used at each place, seams between products, heights
above the sphere of 1 737 400 m.

At every place the products are ranked: first those whose latitudes of use (`products`) contain the
place, then by finer pixel, then in the given order. Where two products meet, heights are blended by
a smooth weight over a band (`tiles`): centred on a latitude at which the ranking changes, inside
the outer edge of a product with another one beneath, and over a few pixels around its missing
pixels.

Heights of single stored pixels at many places that lie far apart.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Int16, Mask
from ..atomic_files import file_facts
from ..constants import MOON_RADIUS_M
from ..errors import AreaError, DemError, not_a
from ..geometry.bounds import Bounds, enclosing_arc
from .dem import Dem
from .products import is_called
from .tiles import BAND_PX, BAND_SHARE, Layer, smoothstep

_DEGREE_M = np.radians(1.0) * MOON_RADIUS_M
_SEAM_MAX_DEG = 1.0
"""Greatest width of a seam between latitudes."""


class Zone(NamedTuple):
    """Absolute latitudes, degrees, of one ranking, and the layers in its order; ``seam_deg``: width
    of the seam at its poleward end.
    """

    low: float
    high: float
    order: tuple[int, ...]
    seam_deg: float


def dem_files(paths: Any) -> tuple[Path, ...]:
    """One path, or several. KindError for anything else."""
    alone = isinstance(paths, str) or not isinstance(paths, Iterable)
    several: Iterable[object] = [paths] if alone else paths
    found = []
    for path in several:
        if not isinstance(path, Path | str):
            wrong = path if isinstance(paths, list | tuple) else paths
            raise not_a(wrong, "dem", "the path of a DEM, several paths, or a DemSet")
        found.append(Path(path))
    return tuple(found)


@dataclass(frozen=True)
class DemSet:
    """Several files as one DEM. Picklable. DemError without files and for an ``order`` that matches
    none.

    ``order``: products (by name, family or file name) that come before all others everywhere;
    ``cell_m``: rank instead by the coarsest product whose pixels are not wider, metres.

    Examples
    --------
    >>> dems = lcp.dem_set(folder / "hadley_gld100_256ppd.tif")
    >>> height_m, index = dems.heights(3.63, 26.13, 120.0)
    >>> dems.products[int(index)], bool(height_m < 0.0)
    ('GLD100_256', True)
    """

    dems: tuple[Dem, ...]
    order: tuple[str, ...] = ()
    cell_m: float | None = None

    def __repr__(self) -> str:
        """The files in short, the first five by name."""
        names = ", ".join(one.path.name[:60] for one in self.dems[:5])
        return f"<DemSet: {len(self.dems)} file{'s' * (len(self.dems) > 1)} ({names}{', ...' * (len(self.dems) > 5)})>"

    def __post_init__(self) -> None:
        if not self.dems:
            raise DemError("no DEM was given")
        for name in self.order:
            if not any(_is_meant(dem, name) for dem in self.dems):
                given = ", ".join(dict.fromkeys(self.products))
                raise DemError(
                    f"`product_order`: no DEM matches {name}; products given: {given} "
                    "(families and file names are accepted too)"
                )

    @classmethod
    def open(
        cls, paths: Path | str | Sequence[Path | str], order: Sequence[str] | None = None
    ) -> DemSet:
        """Open one file or several. DemError or LabelError of the first that cannot be opened. No pixel is
        read. KindError for what is no path.
        """
        return cls(tuple(Dem.open(path) for path in dem_files(paths)), tuple(order or ()))

    def require_surface(self) -> None:
        """DemError for files that are all too small for ground (`Dem.too_small`)."""
        if all(dem.too_small for dem in self.dems):
            raise DemError(f"{self.dems[0].path.name}: {self.dems[0].too_small}")

    def require_patch(self, nodes: int, cell_m: float) -> None:
        """DemError for a single file that is narrower than a patch of ``nodes`` cells, so that it can hold no point."""
        grid, side_m = self.dems[0].grid, nodes * cell_m
        if len(self.dems) == 1 and min(grid.width, grid.height) * grid.pixel_m < side_m:
            raise DemError(
                f"{self.dems[0].path.name}: has {grid.height} x {grid.width} heights (rows x columns) of {grid.pixel_m:.4g} m; "
                f"a patch takes {nodes} x {nodes} cells of {cell_m:.4g} m: give a larger DEM, or fewer `points.patch_nodes`"
            )

    def for_cells(self, cell_m: float) -> DemSet:
        """The same files for distant terrain on cells of a width: of sufficiently fine products the
        coarsest, which needs the least reading.
        """
        return replace(self, cell_m=cell_m)

    @property
    def products(self) -> tuple[str, ...]:
        """Product name of each DEM, by index."""
        return tuple(dem.product for dem in self.dems)

    @cached_property
    def bounds(self) -> Bounds:
        """The box around all files."""
        boxes = [dem.grid.bounds for dem in self.dems]
        if len(boxes) == 1:
            return boxes[0]
        west, east = enclosing_arc([b.west for b in boxes], [b.east for b in boxes])
        return Bounds(west, min(b.south for b in boxes), east, max(b.north for b in boxes))

    # -- the product used at a place

    @cached_property
    def _members(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the files of each layer: files of one product on one lattice."""
        found: list[list[int]] = []
        for number, dem in enumerate(self.dems):
            for layer in found:
                first = self.dems[layer[0]]
                if first.product == dem.product and first.grid.same_lattice(dem.grid) is not None:
                    layer.append(number)
                    break
            else:
                found.append([number])
        return tuple(tuple(layer) for layer in found)

    @cached_property
    def layers(self) -> tuple[Layer[Dem], ...]:
        """The files of one product on one lattice as one layer, in the order of their first file."""
        return tuple(Layer(tuple(self.dems[i] for i in members)) for members in self._members)

    @cached_property
    def zones(self) -> tuple[Zone, ...]:
        """The rankings from the equator to the poles; neighbours differ."""
        spans = [dem.abs_latitude_use for dem in self.dems]
        cuts = sorted({0.0, 90.0} | {lat for span in spans if span for lat in span})
        zones: list[Zone] = []
        for low, high in itertools.pairwise(cuts):
            order = self._ranking((low + high) / 2.0)
            if zones and zones[-1].order == order:
                zones[-1] = zones[-1]._replace(high=high)
                continue
            if zones:
                zones[-1] = zones[-1]._replace(seam_deg=self._seam_deg(zones[-1].order, order))
            zones.append(Zone(low, high, order, 0.0))
        return tuple(zones)

    @cached_property
    def rankings(self) -> tuple[tuple[float, float, tuple[int, ...]], ...]:
        """Of each zone the lowest and highest absolute latitude, degrees, and the files in the
        order of their ranks.
        """
        return tuple(
            (zone.low, zone.high, tuple(i for layer in zone.order for i in self._members[layer]))
            for zone in self.zones
        )

    def _ranking(self, abs_lat_deg: float) -> tuple[int, ...]:
        """Layers by rank at an absolute latitude inside a zone."""

        def rank(layer: int) -> tuple[int, bool, float, int]:
            dem, members = self.layers[layer].dems[0], self._members[layer]
            if self.cell_m is not None:
                fine = dem.gsd_m <= self.cell_m
                return 0, not fine, -dem.gsd_m if fine else dem.gsd_m, members[0]
            named = [
                place
                for place, name in enumerate(self.order)
                if any(_is_meant(self.dems[i], name) for i in members)
            ]
            span = dem.abs_latitude_use
            used = span is not None and span[0] <= abs_lat_deg <= span[1]
            return min(named, default=len(self.order)), not used, dem.gsd_m, members[0]

        return tuple(sorted(range(len(self.layers)), key=rank))

    def _seam_deg(self, one: tuple[int, ...], other: tuple[int, ...]) -> float:
        """Width of the seam between two rankings, by the coarsest layer whose rank changes."""
        pixel_m = max(
            max(self.layers[a].pixel_m, self.layers[b].pixel_m)
            for a, b in zip(one, other, strict=True)
            if a != b
        )
        return float(min(BAND_PX * pixel_m / _DEGREE_M, _SEAM_MAX_DEG))

    @cached_property
    def bands_m(self) -> tuple[float, ...]:
        """Width of the seam at each layer's outer edge, metres: by the coarser of it and the next
        coarser layer that it overlaps (by boxes), at most a share of its smaller side.
        """
        found = []
        for layer in self.layers:
            below = [
                other.pixel_m
                for other in self.layers
                if other is not layer
                and other.pixel_m >= layer.pixel_m
                and any(a.grid.bounds.meets(b.grid.bounds) for a in layer.dems for b in other.dems)
            ]
            wanted = BAND_PX * min(below, default=layer.pixel_m)
            found.append(min(wanted, BAND_SHARE * layer.smaller_side_m))
        return tuple(found)

    def candidates_at(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> Mask:
        """True where a file's footprint contains a place, (files, n). No pixel is read."""
        lon, lat = _flat(lon_deg, lat_deg)
        out = np.zeros((len(self.dems), lon.size), np.bool_)
        for members, layer in zip(self._members, self.layers, strict=True):
            out[list(members)] = layer.holds(lon, lat)
        return out

    def product_at(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> Int16:
        """Index (n,) of the first-ranked file whose footprint contains each place, -1 without one.
        No pixel is read.
        """
        lon, lat = _flat(lon_deg, lat_deg)
        held, away = self.candidates_at(lon, lat), np.abs(lat)
        index = np.full(lon.size, -1, np.int16)
        for low, high, files in self.rankings:
            here = (away >= low) & ((away < high) | (high == 90.0))
            for file in files:
                index[here & held[file] & (index < 0)] = file
        return index

    def native_gsd_m(self, lon_deg: float, lat_deg: float) -> float:
        """Pixel size of the DEM that is used at a place. AreaError if there is no height."""
        return self.native_dem(lon_deg, lat_deg).gsd_m

    def native_dem(self, lon_deg: float, lat_deg: float) -> Dem:
        """The DEM that is used at a place. AreaError if there is no height."""
        finest = min(dem.gsd_m for dem in self.dems)
        _, index = self.heights([lon_deg], [lat_deg], finest)
        if index[0] >= 0:
            return self.dems[int(index[0])]
        raise AreaError(
            f"no DEM has a height at longitude {lon_deg:g}, latitude {lat_deg:g}; the DEM "
            f"covers {self.bounds}"
        )

    # -- heights

    def heights(self, lon_deg: ArrayLike, lat_deg: ArrayLike, gsd_m: float) -> tuple[Array, Int16]:
        """Heights above the sphere, metres (NaN without one), and the index of the DEM with the
        greatest weight in each (-1 without one).

        Cubic convolution, bilinear beside missing pixels; if ``gsd_m`` is at least 1.5 times a
        product's pixel, its pixels are first averaged in blocks (``Dem.factor``), and along the
        parallel where a cylinder's pixels are narrow (``tiles.row_lengths``). The height of a place
        does not depend on the other places.
        """
        shape = np.broadcast_shapes(np.shape(lon_deg), np.shape(lat_deg))
        lon, lat = _flat(lon_deg, lat_deg)
        if len(self.layers) == 1:
            height, index, _ = self.layers[0].sample(lon, lat, gsd_m)
            return height.reshape(shape), index.reshape(shape)
        height, index = np.full(lon.size, np.nan), np.full(lon.size, -1, np.int16)
        shares = self._zone_shares(np.abs(lat))
        for zone, share in zip(self.zones, shares, strict=True):
            if share.all() and share.min(initial=1.0) == 1.0:
                height, index, _ = self._blend(zone.order, lon, lat, gsd_m)
            elif (pure := np.flatnonzero(share == 1.0)).size:
                height[pure], index[pure], _ = self._blend(zone.order, lon[pure], lat[pure], gsd_m)
        mixed = np.flatnonzero(((shares > 0.0) & (shares < 1.0)).any(axis=0))
        if mixed.size:
            height[mixed], index[mixed] = self._mix(shares[:, mixed], lon[mixed], lat[mixed], gsd_m)
        return height.reshape(shape), index.reshape(shape)

    def _zone_shares(self, away_deg: Array) -> Array:
        """Share of each zone's ranking at absolute latitudes, (zones, n); they sum to 1."""
        shares = np.ones((len(self.zones), away_deg.size))
        for number, zone in enumerate(self.zones[:-1]):
            beyond = smoothstep((away_deg - zone.high) / zone.seam_deg + 0.5)
            shares[number] *= 1.0 - beyond
            shares[number + 1] *= beyond
        return shares

    def _mix(self, shares: Array, lon: Array, lat: Array, gsd_m: float) -> tuple[Array, Int16]:
        """Heights at latitudes where the ranking changes: those of both rankings by their shares."""
        height, weights = np.zeros(lon.size), np.zeros((len(self.dems), lon.size))
        for zone, share in zip(self.zones, shares, strict=True):
            here = np.flatnonzero(share > 0.0)
            if not here.size:
                continue
            found, _, parts = self._blend(zone.order, lon[here], lat[here], gsd_m, True)
            height[here] += share[here] * found
            assert parts is not None
            weights[:, here] += share[here] * parts
        best = weights.argmax(axis=0).astype(np.int16)
        return height, np.where(np.isnan(height), np.int16(-1), best)

    def _blend(
        self, order: tuple[int, ...], lon: Array, lat: Array, gsd_m: float, parted: bool = False
    ) -> tuple[Array, Int16, Array | None]:
        """Heights in one ranking: each layer takes its weight of the remainder. ``parted``: also
        each file's share of the height, (files, n).
        """
        count = lon.size
        left, total, sum_of_weights = np.ones(count), np.zeros(count), np.zeros(count)
        best, index = np.zeros(count), np.full(count, -1, np.int16)
        parts = np.zeros((len(self.dems), count)) if parted else None
        todo: NDArray[np.intp] | slice = slice(None)
        for number in order:
            found = self.layers[number].sample(lon[todo], lat[todo], gsd_m, self.bands_m[number])
            if found.weight is None and isinstance(todo, slice) and parts is None:
                return found.height, np.array(self._members[number], np.int16)[found.tile], None
            weight = left[todo] if found.weight is None else left[todo] * found.weight
            files = np.array([*self._members[number], -1], np.int16)[found.tile]
            total[todo] += np.where(files >= 0, weight * found.height, 0.0)
            sum_of_weights[todo] += weight
            index[todo] = np.where(weight > best[todo], files, index[todo])
            best[todo] = np.maximum(weight, best[todo])
            if parts is not None:
                parts[files, np.arange(count)[todo]] += weight  # of no file: weight 0
            left[todo] -= weight
            todo = np.flatnonzero(left > 0.0)
            if not todo.size:
                break
        with np.errstate(invalid="ignore"):
            height = total / sum_of_weights
            parts = None if parts is None else np.nan_to_num(parts / sum_of_weights)
        return height, index, parts

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that heights are read from, labels included, each once, in the given order."""
        return tuple(dict.fromkeys(path for dem in self.dems for path in dem.files))

    def sources(self) -> list[dict[str, Any]]:
        """Name, size and SHA-256 of every file that heights are read from, labels included, in the
        given order; no folders.
        """
        return file_facts(self.files)


def height_at(dem: Dem, lon_deg: float, lat_deg: float) -> float | None:
    """Height at a place, metres, from one product's own pixels without averaging; None without a
    height.
    """
    height, _ = DemSet((dem,)).heights(lon_deg, lat_deg, 0.0)
    return None if np.isnan(height) else round(float(height), 6)


def _flat(lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Array, Array]:
    lon, lat = np.broadcast_arrays(
        np.asarray(lon_deg, dtype=np.float64), np.asarray(lat_deg, dtype=np.float64)
    )
    return lon.ravel(), lat.ravel()


def _is_meant(dem: Dem, name: str) -> bool:
    """True if ``name`` is a DEM's product, its family or one of its files, with or without the
    ending.
    """
    files = {text.upper() for path in (dem.path, *dem.files) for text in (path.name, path.stem)}
    return is_called(dem.product, name) or name.upper() in files


_GAP_PX = 4000
"""Places of a row of pixels that are nearer to each other than this are read in one piece: reading so
many pixels takes about as long as another call."""


def nearest_heights(dems: DemSet, lon_deg: Array, lat_deg: Array) -> Array:
    """Heights of the stored pixels nearest to places (n,), metres, from the file that ranks first among
    those with one there; NaN without one. No blending between files.

    Rows of pixels are read in their order, each at most once from a file, and at most `_GAP_PX`
    pixels for a place.
    """
    height, away = np.full(len(lon_deg), np.nan), np.abs(lat_deg)
    for low, high, files in dems.rankings:
        here = (away >= low) & ((away < high) | (high == 90.0))
        for file in files:
            todo = np.flatnonzero(here & np.isnan(height))
            if todo.size:
                height[todo] = _pixels(dems.dems[file], lon_deg[todo], lat_deg[todo])
    return height


def _pixels(dem: Dem, lon_deg: Array, lat_deg: Array) -> Array:
    """Heights of one file's pixels at places (n,), NaN outside it and without a height."""
    height = np.full(len(lon_deg), np.nan)
    inside, column, row = dem.grid.located(lon_deg, lat_deg)
    u = np.clip(np.rint(column), 0, dem.grid.width - 1).astype(np.int64)
    v = np.clip(np.rint(row), 0, dem.grid.height - 1).astype(np.int64)
    order = np.flatnonzero(inside)
    order = order[np.lexsort((u[order], v[order]))]
    new = (np.diff(v[order]) != 0) | (np.diff(u[order]) > _GAP_PX)
    for places in np.split(order, np.flatnonzero(new) + 1) if order.size else ():
        line, first, last = int(v[places[0]]), int(u[places[0]]), int(u[places[-1]])
        height[places] = dem.read(line, line + 1, first, last + 1)[0, u[places] - first]
    return height


UNKNOWN_SIGMA_M = 10.0
"""1 sigma of absolute heights assumed for a product whose uncertainty is not published. Errors of its relief are another
matter: `error_maps.errors_of_file`.
"""
