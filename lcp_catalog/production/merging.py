"""Catalogues of neighbouring regions or of several cell sizes joined into one, without doubles.

Coverage and overview of catalogues that are merged.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np

from ..arrays import AnyArray, Index
from ..atomic_files import check_output
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..catalog.layout import packing
from ..catalog.maps import overview_levels, usable_nearby
from ..catalog.model import BLOCK_BYTES, Coverage, Overview, Promise, held
from ..catalog.origins import Origin, merged_config, origins, united
from ..catalog.promise import merged_promise
from ..catalog.schema import PACKED, levels, usable
from ..catalog.shards import Shard
from ..catalog.stored import content_sha256, sharded
from ..catalog.writing import new_catalog, write_catalog
from ..choices import INDEX
from ..errors import AreaError, CatalogError, ConfigError, not_a, printable
from ..geometry.bounds import enclosing_bounds, turned_deg
from ..geometry.frames import lonlat_to_mcmf
from ..geometry.map_plane import ORTHOGRAPHIC, MapPlane
from ..landmarks.selection import Places, Status, nearest, select
from ..terrain.area import Area
from .config import BuildConfig
from .error_config import place_for
from .overlap import MergedPart, agreement, near_pairs
from .region_maps import COVERAGE_BYTES, COVERAGE_CELLS, OVERVIEW_NODES, middles, ring_cells

log = logging.getLogger(__name__)

_RANK = np.array([6, 2, 3, 4, 1, 5])
"""Order of the codes of `Status`: of several reports on a cell the highest holds."""

_CODE = np.array([Status.NODATA, *np.argsort(_RANK)], np.uint8)
"""The code of each rank; 0: no report."""


@dataclass(frozen=True, eq=False)
class MergedMaps:
    """The maps of catalogues together."""

    parts: Sequence[MergedPart]

    @property
    def spacing_m(self) -> float:
        """Spacing of the coverage: the largest of the parts."""
        return max(part.catalog.coverage.spacing_m for part in self.parts)

    @property
    def regions(self) -> list[Area]:
        """Every region once, in an order that does not depend on that of the parts."""
        return sorted({region for part in self.parts for region in part.regions}, key=repr)

    def coverage(self, points: Places, condition: AnyArray) -> Coverage:
        """Coverage on latitude rings (`region_maps.ring_cells`): whether a point, a longitude and a latitude
        in degrees, lies within the spacing of a cell's centre, or else the status of the nearest
        cell of an input whose region contains the centre; of several the one that came furthest
        towards a point. ``condition``: flags of the points, as in `usable_nearby`.
        """
        most = min(COVERAGE_CELLS, COVERAGE_BYTES // max(1, math.prod(condition.shape[1:])))
        lon, lat, step_m = ring_cells(self.regions, self.spacing_m, most)
        if not len(lon):  # narrower than a cell
            lon, lat = np.array([[turned_deg(one.lon_deg), one.lat_deg] for one in self.regions]).T
        rank = np.zeros(len(lon), np.int64)
        for part in self.parts:
            mine = np.flatnonzero(part.contains(lon, lat))
            cells = part.catalog.coverage
            cell, _ = nearest(Places(lon[mine], lat[mine]), Places(cells.longitude, cells.latitude))
            if len(cells.status):
                rank[mine] = np.maximum(rank[mine], _RANK[cells.status[cell]])
        rank[nearest(Places(lon, lat), points)[1] <= self.spacing_m] = _RANK[Status.POINT]
        nearby = usable_nearby(Places(lon, lat), points, condition, self.spacing_m)
        return Coverage(lon, lat, _CODE[rank], self.spacing_m, nearby, step_m)

    def overview(self) -> Overview:
        """The heights of all overviews in one raster; where several show a place, of the finest."""
        boxes = [region.bounds for region in self.regions]
        west, south, east, north = np.array(boxes).T
        box = enclosing_bounds(west, east, float(south.min()), float(north.max()))
        whole = Area.from_bounds(box.west, box.south, box.east, box.north)
        if whole.is_local:
            frame, extent_m = whole.frame, whole.extent_m
            plane = MapPlane(ORTHOGRAPHIC, frame.lon_deg, frame.lat_deg)
        else:
            plane = MapPlane.showing(box)
            extent_m = plane.extent_m(box)
        x0, x1, y0, y1 = extent_m
        finest = sorted(self.parts, key=lambda part: part.step_m)
        step = max(finest[0].step_m, max(x1 - x0, y1 - y0) / OVERVIEW_NODES)
        x, y = middles(x0, x1, step), middles(y0, y1, step)[::-1]
        lon, lat = plane.lonlat(*np.meshgrid(x, y))
        height = np.full(lon.shape, np.nan)
        known = np.isfinite(lon)
        place = np.full((*lon.shape, 3), np.nan)
        place[known] = lonlat_to_mcmf(lon[known], lat[known])
        for part in finest:
            todo = np.isnan(height) & known
            todo[todo] = part.near(place[todo])
            height[todo] = part.heights(lon[todo], lat[todo])
        return Overview(
            height.astype(np.float32), x, y, plane.center_lon, plane.center_lat, plane.projection
        )


_AXES = (
    "image_scale",
    "view_off_nadir",
    "view_azimuth",
    "view_altitude",
    "sun_elevation",
    "sun_azimuth",
)

_OF_PLACES = ("height_sigma_m", "height_length_m", "position_sigma_m")
"""Figures of the error model that follow from the DEM: catalogues may differ in them, in the last if no configuration
states it."""

_OF_FLAGS = ("min_lit_share", "max_dependence", "patch_nodes")
"""Settings by which flags mean the same."""

POINTS = np.dtype(
    [
        ("id", "<i8"),
        ("lon_deg", "<f8"),
        ("lat_deg", "<f8"),
        ("gsd_m", "<f8"),
        ("usable", "<i4"),
        ("quality", "<f8"),
        ("level", "<i4"),
        ("input", "<i4"),
        ("row", "<i8"),
    ]
)
"""What a point is chosen by, as in `finished_area.TABLE`, and its place in the inputs."""

Sizes = tuple[tuple[float, ...], ...]
"""Cell sizes of each level, metres."""

_SHORT = 60


@dataclass(frozen=True)
class MergeReport:
    """Numbers of points: in the merged catalogue, in the ``inputs`` that differ, and of the points left out
    because of another with the same id (``doubles``) or because of one nearer than the spacing
    (``crowded``); cell sizes of each level, metres.
    """

    points: int
    inputs: tuple[int, ...]
    doubles: int
    crowded: int
    levels_m: Sizes


@dataclass(frozen=True, eq=False)
class _Input:
    path: str
    catalog: Catalog
    digest: str
    builds: list[Origin]

    @classmethod
    def of(cls, catalog: CatalogOrPath, folder: Path) -> _Input:
        """One in memory is written into a ``folder`` first: the file's digest is what counts."""
        path = catalog.path if isinstance(catalog, Catalog) else catalog
        if path is None:
            path = folder / f"memory-{len(list(folder.iterdir()))}.h5"
            write_catalog(opened_catalog(catalog), path)
        catalog = opened_catalog(path)
        digest = content_sha256(catalog)
        itself = Origin(printable(Path(path).name), digest, len(catalog), {})
        try:
            return cls(str(path), catalog, digest, origins(catalog.config, itself))
        except CatalogError as error:
            raise CatalogError(f"{path}: {error}") from error

    @cached_property
    def configs(self) -> list[BuildConfig]:
        """The configurations of the builds. CatalogError for one without region or cell size."""
        try:
            found = [BuildConfig.from_dict(build.config) for build in self.builds]
        except ConfigError as error:
            raise CatalogError(f"{self.path}: its configuration is invalid: {error}") from error
        for config in found:
            if config.area.gsd_m is None:
                raise CatalogError(f"{self.path}: its configuration does not state the cell size")
            try:
                if config.area.region is None:
                    raise CatalogError(f"{self.path}: its configuration states no region")
            except AreaError as error:
                raise CatalogError(f"{self.path}: its configuration is invalid: {error}") from error
        other = ~np.isin(self.catalog.gsd, [config.area.gsd_m or 0.0 for config in found])
        if other.any():
            size = self.catalog.gsd[np.argmax(other)]
            raise CatalogError(f"{self.path}: its configuration states no cells of {size:g} m")
        return found

    @property
    def regions(self) -> list[Area]:
        """The regions of the builds."""
        return [region for config in self.configs if (region := config.area.region)]

    def points(self, number: int) -> AnyArray:
        """Its points as `POINTS`; ``number``: its own among the inputs."""
        catalog = self.catalog
        found = np.zeros(len(catalog), POINTS)
        found["id"], found["gsd_m"] = catalog.point_id, catalog.gsd
        found["lon_deg"], found["lat_deg"] = catalog.longitude, catalog.latitude
        for rows in catalog.blocks("condition"):
            found["usable"][rows] = usable(catalog.part("condition", rows)).sum(axis=(1, 2, 3))
        largest = catalog.part("localization_sigma", slice(None), 0)
        found["quality"] = -np.nan_to_num(largest, nan=np.inf, posinf=1e30)
        found["input"], found["row"] = number, np.arange(len(catalog))
        return found


def merge_catalogs(
    catalogs: Sequence[CatalogOrPath],
    output: Path | str,
    overwrite: bool = False,
    *,
    of_one_build: bool = False,
) -> MergeReport:
    """Join catalogues, or files of them, into one and write it to ``output``; an output that ends in .lcpx is an
    index of the files, in which the points stay. Their order does not change it.

    Of points with the same id one is kept, and of points of the same level (`schema.levels`) that are nearer to each other
    than the spacing, as a build chooses: the one with more usable conditions, then the finer localised
    one. Coverage and overview are joined (`MergedMaps`). What the builds promise (`Promise`) stays, less
    the points that are left out (`merged_promise`).

    CatalogError for a file that is no catalogue, or for one that does not go with the first: other axes,
    errors, albedo map or meaning of the flags, or contradicting heights of the same ground (`overlap.agreement`), but for
    levels ``of_one_build``, whose DEMs were compared when it was planned;
    OutputExistsError and OutputError as
    `atomic_files.check_output`.
    """
    if isinstance(catalogs, Catalog | Path | str):
        raise not_a(catalogs, "catalogs", "a list of catalogues, or of the paths of their files")
    catalogs = list(catalogs)
    if not catalogs:
        raise CatalogError("no catalogue was given to be merged")
    for one in catalogs:
        if not isinstance(one, Catalog | Path | str):
            raise not_a(one, "catalogs", "catalogues, or the paths of their files")
    paths = [one.path if isinstance(one, Catalog) else one for one in catalogs]
    if (index := Path(output).suffix.lower() == INDEX) and None in paths:
        raise CatalogError(f"{output}: an index is of files; write the catalogue first")
    check_output(output, overwrite, [path for path in paths if path is not None])
    with TemporaryDirectory() if None in paths else nullcontext("") as folder:
        inputs = [_Input.of(one, Path(folder)) for one in catalogs]
        for other in inputs[1:]:
            _require_compatible(inputs[0], other)
        inputs.sort(key=lambda one: (one.digest, one.builds[0].name), reverse=True)
        different = {one.digest: one for one in inputs}
        merge = _Merge([different[digest] for digest in sorted(different)])
        if not of_one_build:
            merge.require_agreement()
        (merge.write_index if index else merge.write)(output, overwrite)
    return merge.report


class _Merge:
    """Compatible catalogues, each once, in the order of their digests, and what becomes of them."""

    def __init__(self, inputs: Sequence[_Input]) -> None:
        self.inputs = inputs
        self.catalogs = [one.catalog for one in inputs]
        self.builds = united(one.builds for one in inputs)
        configs = [config for one in inputs for config in one.configs]
        self.spacing_m, sizes = _spacings_m(configs)
        every = np.concatenate([one.points(k) for k, one in enumerate(inputs)])
        for level, own in enumerate(sizes):
            every["level"][np.isin(every["gsd_m"], own)] = level
        single = every[_best_of_each(every)]
        spread = [_spread(single, level, away_m) for level, away_m in enumerate(self.spacing_m)]
        self.chosen = single[np.sort(np.concatenate(spread))]
        self.maps = MergedMaps([MergedPart(one.catalog, one.regions) for one in inputs])
        self.report = MergeReport(
            points=len(self.chosen),
            inputs=tuple(len(catalog) for catalog in self.catalogs),
            doubles=len(every) - len(single),
            crowded=len(single) - len(self.chosen),
            levels_m=sizes,
        )

    def require_agreement(self) -> None:
        """CatalogError for two inputs whose heights of the same ground contradict each other. Logs a warning for those of which
        that could not be seen.
        """
        unseen = []
        for one, other in near_pairs(self.maps.parts):
            found = agreement(self.maps.parts[one], self.maps.parts[other])
            paths = self.inputs[other].path, self.inputs[one].path
            if found.fault:
                raise CatalogError(
                    f"{paths[0]}: cannot be merged with {paths[1]}: {found.fault}; one of "
                    "their DEMs is wrong there: leave it out"
                )
            if found.unseen:
                unseen.append(f"{paths[0]}: merged with {paths[1]}, but {found.unseen}")
        if unseen:
            more = f"; so have {len(unseen) - 1} other pairs" if len(unseen) > 1 else ""
            log.warning("%s%s; compare their DEMs (lcp dem info)", unseen[0], more)

    def write_index(self, output: Path | str, overwrite: bool) -> None:
        """Write an index of the inputs (`catalog.shards`)."""
        flags = cast(AnyArray, _ChosenFlags(self))
        coverage = self.maps.coverage(Places(self.chosen["lon_deg"], self.chosen["lat_deg"]), flags)
        head = dataclasses.replace(self.head, shards=tuple(self._shards(output)))
        with new_catalog(head, 0, (), output, overwrite) as file:
            file.finish(coverage, self._promise())

    def _shards(self, output: Path | str) -> Iterator[Shard]:
        """The inputs that have points, as an index names them. CatalogError for one that is an index itself."""
        for k, (one, lost) in enumerate(zip(self.inputs, self._lost, strict=True)):
            if sharded(one.catalog):
                raise CatalogError(f"{one.path}: is an index; name its catalogues")
            own = self.chosen[self.chosen["input"] == k]
            if len(own):
                level = one.catalog.part("level", own["row"])
                _, first = np.unique(level, return_index=True)
                known = dict(zip(level[first].tolist(), own["level"][first].tolist(), strict=True))
                levels = [known.get(number, 0) for number in range(max(known) + 1)]
                places = one.catalog.part("position_mcmf", own["row"])
                yield Shard.of(one.path, output, one.digest, places, levels, lost)

    def write(self, output: Path | str, overwrite: bool) -> None:
        """Write the catalogue, a block of points at a time."""
        points, head, widest = self.chosen, self.head, self._widest
        step = max(1, BLOCK_BYTES // sum(map(widest.row_bytes, widest.point_variables)))
        with new_catalog(head, len(points), self._products(), output, overwrite) as file:
            for start in range(0, len(points), step):
                file.add(self._values(points[start : start + step]))
            places = Places(points["lon_deg"], points["lat_deg"])
            with file.flags() as condition:
                coverage = self.maps.coverage(places, condition)
            file.finish(coverage, self._promise())

    def _promise(self) -> Promise | None:
        """The promises of the inputs, without the points that are left out."""
        return merged_promise(self.catalogs, self._lost)

    @cached_property
    def _lost(self) -> list[Index]:
        """Rows of the points of each input that are left out."""
        lost = []
        for k, catalog in enumerate(self.catalogs):
            kept = np.zeros(len(catalog), bool)
            kept[self.chosen["row"][self.chosen["input"] == k]] = True
            lost.append(np.flatnonzero(~kept))
        return lost

    def _products(self) -> set[str]:
        """Names of the DEM products."""
        return set().union(*self._products_of_each)

    @cached_property
    def _products_of_each(self) -> list[set[str]]:
        """Names of the DEM products of each input."""
        return [
            {name for rows in one.blocks("dem_product") for name in one.part("dem_product", rows)}
            for one in self.catalogs
        ]

    @property
    def _widest(self) -> Catalog:
        """An input with all variables that any has."""
        return max(self.catalogs, key=lambda one: len(one.point_variables))

    @cached_property
    def head(self) -> Catalog:
        """The catalogue without points and coverage."""
        all_, none = self.catalogs, np.zeros(0, np.int64)
        overview, digests = self.maps.overview(), ", ".join(one.digest for one in self.inputs)
        return dataclasses.replace(
            self._widest.take(none, none),
            history=f"merge of {len(self.inputs)} catalogues with the content_sha256 {digests}",
            title=_shared([one.title for one in all_], Catalog.title),
            product_version=_shared([one.product_version for one in all_], Catalog.product_version),
            software_version=Catalog.software_version,
            config=merged_config(self.builds),
            sources=_distinct([one.sources for one in all_]),
            scene_plan=_merged_plan([one.scene_plan for one in all_]),
            errors=_merged_errors([one.errors for one in all_], self._products_of_each),
            sigma_step_m=_sigma_step_m(all_),
            overview=overview,
            overview_levels=overview_levels(overview),
            coverage=Coverage(none, none, none.astype(np.uint8), self.maps.spacing_m),
        )

    def _values(self, points: AnyArray) -> dict[str, AnyArray]:
        """The variables of some of the chosen points, as in the file."""
        found = {name: self.variable(name, points) for name in self.head.point_variables}
        return found | {"level": points["level"]}

    def variable(self, name: str, points: AnyArray) -> AnyArray:
        """A variable of some of the chosen points, as in the file."""
        by_input = [np.flatnonzero(points["input"] == k) for k in range(len(self.catalogs))]
        parts = [
            self._part(name, catalog, points["row"][own])
            for catalog, own in zip(self.catalogs, by_input, strict=True)
            if len(own)
        ]
        return np.asarray(np.concatenate(parts)[np.argsort(np.concatenate(by_input))])

    def _part(self, name: str, catalog: Catalog, rows: Index) -> AnyArray:
        """A variable of some points of an input, as in the merged file."""
        if name not in catalog.point_variables:  # albedo: the input has no map
            return np.full((len(rows), *np.shape(getattr(self.head, name))[1:]), np.nan, np.float32)
        part = catalog.part(name, rows)
        return packing(name, self.head.sigma_step_m or 1.0).packed(part) if name in PACKED else part


class _ChosenFlags:
    """`Catalog.condition` of the chosen points of a merge: each slice is read from the inputs."""

    def __init__(self, merge: _Merge) -> None:
        self._merge = merge
        along = np.shape(held(merge.catalogs[0], "condition"))[1:]
        self.shape: tuple[int, ...] = (len(merge.chosen), *along)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> AnyArray:
        return self._merge.variable("condition", self._merge.chosen[rows])


# -- points


def _spacings_m(configs: Sequence[BuildConfig]) -> tuple[list[float], Sizes]:
    """For each level the least distance of points of its builds, and their cell sizes, metres."""
    sizes = np.array([config.area.gsd_m for config in configs], np.float64)
    least = np.array([_lengths_m(config)[0] for config in configs])
    level = levels(sizes)
    numbers = range(int(level.max()) + 1)
    return (
        [float(least[level == k].min()) for k in numbers],
        tuple(tuple(np.unique(sizes[level == k]).tolist()) for k in numbers),
    )


def _lengths_m(config: BuildConfig) -> tuple[float, float]:
    """Least distance of points, and search radius, metres."""
    gsd_m = config.area.gsd_m or 0.0  # `_Input.configs` has them all
    return config.points.least_distance_m(gsd_m), config.points.search_nodes(gsd_m) * gsd_m


def _best_of_each(points: AnyArray) -> Index:
    """Rows of the best point of each id, in the order of the ids."""
    keys = ("input", "lat_deg", "lon_deg")
    best = np.lexsort((*(points[k] for k in keys), -points["quality"], -points["usable"]))
    _, first = np.unique(points["id"][best], return_index=True)
    return best[first]


def _spread(points: AnyArray, level: int, spacing_m: float) -> Index:
    """Rows of the points of a level that a build would choose; points that are never usable come last."""
    rows = np.flatnonzero(points["level"] == level)
    own = points[rows]
    places = Places(own["lon_deg"], own["lat_deg"])
    return rows[select(places, own["usable"] + 1, own["quality"], spacing_m)]


# -- the rest of the file


def _require_compatible(first: _Input, other: _Input) -> None:
    """CatalogError, with the difference, for a catalogue that cannot be merged with the first."""
    one, two = first.catalog, other.catalog
    pairs: list[tuple[str, Any, Any]] = [
        (name, getattr(one, name).tolist(), getattr(two, name).tolist()) for name in _AXES
    ]
    pairs.append(("patch_nodes", one.patch_nodes, two.patch_nodes))
    if one.albedo_map and two.albedo_map:
        # Files of earlier versions do not state the pixel, which follows from the map.
        a, b = ({**of, "pixel_m": 0.0} for of in (one.albedo_map, two.albedo_map))
        pairs.append(("albedo_map", a, b))
    free = {*_OF_PLACES, "by_place"}
    if not (_place_follows(one.errors) and _place_follows(two.errors)):
        free -= {"position_sigma_m"}
    for name in sorted((one.errors.keys() | two.errors.keys()) - free):
        pairs.append((f"errors.{name}", one.errors.get(name), two.errors.get(name)))
    mine, its = first.configs[0].points, other.configs[0].points
    pairs += [(f"points.{name}", getattr(mine, name), getattr(its, name)) for name in _OF_FLAGS]
    searches = {config.area.gsd_m: _lengths_m(config)[1] for config in first.configs}
    for config in other.configs:
        radius_m = _lengths_m(config)[1]
        pairs.append(("points.search_m", searches.get(config.area.gsd_m, radius_m), radius_m))
    for name, a, b in pairs:
        if a != b:
            text = f"{name} is {_short(b)}, not {_short(a)} as in {first.path}"
            raise CatalogError(f"{other.path}: cannot be merged: {text}")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= _SHORT else f"{text[:_SHORT]}..."


def _shared(texts: list[str], default: str) -> str:
    return texts[0] if len({*texts}) == 1 else default


def _distinct(lists: Sequence[list[Any]]) -> list[Any]:
    """The entries of lists, each once: in the order of the lists if they are equal, else sorted."""
    if all(one == lists[0] for one in lists):
        return lists[0]
    texts = {json.dumps(entry, sort_keys=True) for one in lists for entry in one}
    return [json.loads(text) for text in sorted(texts)]


def _merged_plan(plans: Sequence[Any]) -> Any:
    """All decisions of scene plans, each once."""
    if all(plan == plans[0] for plan in plans):
        return plans[0]
    known = [plan.get("decisions") for plan in plans if isinstance(plan, dict)]
    return {"decisions": _distinct([one for one in known if isinstance(one, list)])}


def _place_follows(errors: dict[str, Any]) -> bool:
    """True if the error of places was derived from the correlation length of heights."""
    if "position_sigma_m" in errors.get("by_place", {}):
        return True
    length_m = errors.get("height_length_m")
    return isinstance(length_m, float) and errors.get("position_sigma_m") == place_for(length_m)


def _merged_errors(
    models: Sequence[dict[str, Any]], products: Sequence[set[str]]
) -> dict[str, Any]:
    """The error model; figures that follow from the DEM are lists where they differ, and every point then has its own
    (`catalog.point_errors`). ``products``: names of the DEM products of each input.
    """
    found = dict(models[0])
    found.pop("by_place", None)
    by_place = {}
    for name in _OF_PLACES:
        stated = [model[name] for model in models if name in model]
        figures = {f for one in stated for f in (one if isinstance(one, list) else [one])}
        if figures:
            found[name] = sorted(figures) if len(figures) > 1 else figures.pop()
        if isinstance(found.get(name), list) or any(name in m.get("by_place", ()) for m in models):
            by_place[name] = _figures_of_products(name, models, products)
    return found | ({"by_place": by_place} if by_place else {})


def _figures_of_products(
    name: str, models: Sequence[dict[str, Any]], products: Sequence[set[str]]
) -> dict[str, float]:
    """A figure of the error model of every product for which all inputs state the same one."""
    found: dict[str, set[float | None]] = {}
    for model, own in zip(models, products, strict=True):
        stated = model.get(name)
        alone = None if isinstance(stated, list) else stated
        known = model.get("by_place", {}).get(name, dict.fromkeys(own, alone))
        for product in own:
            found.setdefault(product, set()).add(known.get(product))
    single = {product: figures.pop() for product, figures in found.items() if len(figures) == 1}
    return {product: figure for product, figure in sorted(single.items()) if figure is not None}


def _sigma_step_m(catalogs: Sequence[Catalog]) -> float:
    """The finest step of the stored sigmas, or the least that holds all sigmas which the inputs hold."""
    steps = [one.sigma_step_m or 1.0 for one in catalogs]
    if len({*steps}) == 1:
        return steps[0]
    most, largest = packing("sigma_major", 1.0).largest, 0.0
    for one, step in zip(catalogs, steps, strict=True):
        for rows in one.blocks("sigma_major"):
            sigma = one.part("sigma_major", rows)
            held = sigma[sigma < (most - 0.5) * step]
            largest = max(largest, float(held.max(initial=0.0)))
    return max(min(steps), float(np.nextafter(np.float32(largest / most), np.float32(np.inf))))
