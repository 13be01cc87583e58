"""The differences of two catalogues: points that came, went, moved or changed, and by how much."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import AnyArray, Array, Index
from ..landmarks.selection import nearest
from .catalogue import Catalog
from .cell_levels import levels
from .differences import ComparedPoints, Comparison
from .layout import GROUPS, TEXT, key
from .model import BLOCK_BYTES
from .schema import VARIABLES
from .stored import content_sha256
from .verification import open_catalog

_AXES = {
    "sun_elevation": "sun_elevation",
    "sun_azimuth": "sun_azimuth",
    "view_off_nadir": "view",
    "view_azimuth": "view",
    "view_altitude": "view",
    "image_scale": "image_scale",
}
"""Coordinates that both catalogues must share, and the dimension of each."""

_TURNS = {"longitude": 360.0, "sigma_angle": 180.0}
"""Variables that return to the same value after so many degrees."""

_OF_THE_FILE = ("point_id", "level")
"""Variables by which points are matched, or that depend on what else a file holds."""


def compare(first: Path | str, second: Path | str) -> Comparison:
    """The differences of two catalogue files, read in blocks. CatalogError for a file that is no
    catalogue or is damaged.

    Points are matched by their ids; the version of the software and the order of the points do not
    count. A point without partner is taken for moved if the nearest other one without partner, of a
    cell size of the same level (`cell_levels`), lies within the spacing, and each is nearest to the
    other. Files with the same digests of their content are not read further.
    """
    one, other = (open_catalog(path, check=False) for path in (first, second))
    if content_sha256(first) == content_sha256(second):
        return _equal(one)
    one, other = (open_catalog(path) for path in (first, second))
    return compare_catalogs(one, other)


def _equal(catalog: Catalog) -> Comparison:
    places = ComparedPoints.of(catalog)
    none = places.take(np.zeros(0, np.int64))
    points = len(catalog), len(catalog)
    return Comparison(points, {}, {}, (), none, none, none, none, np.zeros(0), places, {})


def compare_catalogs(one: Catalog, other: Catalog) -> Comparison:
    """The differences of a second catalogue from a first, as `compare`."""
    here, there = ComparedPoints.of(one), ComparedPoints.of(other)
    _, rows, others = np.intersect1d(
        here.point_id, there.point_id, assume_unique=True, return_indices=True
    )
    order = np.argsort(rows)  # chunks of the file are read in turn
    rows, others = rows[order], others[order]
    went = np.setdiff1d(np.arange(len(here)), rows)
    came = np.setdiff1d(np.arange(len(there)), others)
    spacing_m = min(one.coverage.spacing_m, other.coverage.spacing_m)
    old, new, away_m = _moves(here.take(went), there.take(came), spacing_m)
    unequal = _unequal_axes(one, other)
    mine, its = (set(catalog.point_variables) - {*_OF_THE_FILE} for catalog in (one, other))
    skipped = {n for n in mine & its if unequal & {*VARIABLES[n].dims}} | (mine ^ its)
    return Comparison(
        points=(len(here), len(there)),
        attributes=_attributes(one, other),
        maps=dict(_maps(one, other, unequal)),
        not_compared=tuple(name for name in VARIABLES if name in skipped),
        came=there.take(np.delete(came, new)),
        went=here.take(np.delete(went, old)),
        moved_from=here.take(went[old]),
        moved_to=there.take(came[new]),
        moved_m=away_m,
        matched=here.take(rows),
        amounts={
            name: amount
            for name in VARIABLES
            if name in mine & its - skipped
            if (amount := _amounts(name, one, rows, other, others)).any()
        },
    )


# -- points


def _moves(
    here: ComparedPoints, there: ComparedPoints, spacing_m: float
) -> tuple[Index, Index, Array]:
    """Rows of points without partner that are the same points moved, and their distances in metres:
    those of one level that are nearest to each other, then again among the rest.
    """
    level = levels(np.concatenate([here.gsd, there.gsd]))
    pairs: list[tuple[Index, Index, Array]] = []
    for number in np.unique(level).tolist():
        old = np.flatnonzero(level[: len(here)] == number)
        new = np.flatnonzero(level[len(here) :] == number)
        while True:
            a, b = here.take(old), there.take(new)
            to, away_m = nearest(a.longitude, a.latitude, b.longitude, b.latitude)
            back, _ = nearest(b.longitude, b.latitude, a.longitude, a.latitude)
            both = np.flatnonzero(away_m <= spacing_m)
            both = both[back[to[both]] == both]
            if not len(both):
                break
            pairs.append((old[both], new[to[both]], away_m[both]))
            old, new = np.delete(old, both), np.delete(new, to[both])
    empty = np.zeros(0, np.int64)
    columns = zip((empty, empty, np.zeros(0)), *pairs, strict=True)
    found, its, far_m = (np.concatenate(column) for column in columns)
    return found, its, far_m


def _amounts(name: str, one: Catalog, rows: Index, other: Catalog, others: Index) -> Array:
    """The largest difference of a variable of each of the points, which are given by their rows."""
    found = np.zeros(len(rows))
    numbers = one.part(name, rows[:1]).size  # float64 below
    step = max(1, BLOCK_BYTES // (8 * max(1, numbers)))
    for start in range(0, len(rows), step):
        part = slice(start, start + step)
        found[part] = _amount(name, one.part(name, rows[part]), other.part(name, others[part]))
    return found


def _amount(name: str, first: AnyArray, second: AnyArray) -> AnyArray:
    """The largest difference of each row: 0 for none, inf if only one has a value."""
    flat = (len(first), -1)
    if name == "condition":
        return np.count_nonzero((first != second).reshape(flat), axis=1)
    if VARIABLES[name].dtype == TEXT:
        return np.asarray(first != second, np.float64)
    a, b = first.astype(np.float64).reshape(flat), second.astype(np.float64).reshape(flat)
    away = np.abs(np.where(a == b, 0.0, a - b))
    if name in _TURNS:
        away = np.minimum(away % _TURNS[name], -away % _TURNS[name])
    if name == "position_mcmf":
        away = np.linalg.norm(away, axis=1, keepdims=True)
    unknown = np.isnan(a), np.isnan(b)
    alone = unknown[0] != unknown[1]
    away = np.where(alone, np.inf, np.where(unknown[0], 0.0, away))
    return np.asarray(away.max(axis=1, initial=0.0))


# -- the rest of the file


def _unequal_axes(one: Catalog, other: Catalog) -> set[str]:
    """Dimensions whose coordinates differ."""
    found = {
        dim for name, dim in _AXES.items() if not _same(getattr(one, name), getattr(other, name))
    }
    return found | ({"patch_row", "patch_col"} if one.patch_nodes != other.patch_nodes else set())


def _same(first: AnyArray, second: AnyArray) -> bool:
    return np.array_equal(first, second, equal_nan=first.dtype.kind == "f")


def _attributes(one: Catalog, other: Catalog) -> dict[str, tuple[Any, Any]]:
    """What differs, by name: the schema, axes and cell sizes first, then settings and provenance."""
    return {
        f"{name}.{path}" if path else name: values
        for (name, first), (_, second) in zip(_facts(one), _facts(other), strict=True)
        for path, values in _leaves(_finite(first), _finite(second))
    }


def _facts(catalog: Catalog) -> Iterator[tuple[str, Any]]:
    for name in _AXES:
        yield name, getattr(catalog, name).tolist()
    yield "patch_nodes", catalog.patch_nodes
    yield "gsd_m", np.unique(catalog.gsd).tolist()
    yield "spacing_m", catalog.coverage.spacing_m
    yield "coverage.step_m", catalog.coverage.step_m
    view = catalog.overview
    yield "overview", [view.projection, view.center_lon, view.center_lat]
    yield "sigma_step_m", catalog.sigma_step_m
    promise = catalog.promise
    numbers = ("gsd", "per_view", "footprint", "lower_bound")
    yield "promise", promise and [getattr(promise, name).tolist() for name in numbers]
    for name in ("title", "product_version", "sources", "albedo_map", "scene_plan"):
        yield name, getattr(catalog, name)
    yield "config", tomllib.loads(catalog.config)
    yield "errors", catalog.errors


def _leaves(first: Any, second: Any) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """The entries that differ in two documents, by their path."""
    if not (isinstance(first, dict) and isinstance(second, dict)):
        if first != second:
            yield "", (first, second)
        return
    for name in sorted(first.keys() | second.keys()):
        for path, values in _leaves(first.get(name), second.get(name)):
            yield f"{name}.{path}" if path else name, values


def _finite(value: Any) -> Any:
    """A document as JSON can hold it: numbers that are not finite as text."""
    if isinstance(value, dict):
        return {name: _finite(own) for name, own in value.items()}
    if isinstance(value, list):
        return [_finite(own) for own in value]
    return str(value) if isinstance(value, float) and not np.isfinite(value) else value


def _maps(one: Catalog, other: Catalog, unequal: set[str]) -> Iterator[tuple[str, str]]:
    """Variables of the groups that differ, and how."""
    skipped = {"cell", "place", "step", "part", "block", "code"}  # numbers of rows
    for group, members in GROUPS.items():
        whose = [group in catalog.groups() for catalog in (one, other)] if group else []
        if any(whose) and not all(whose):
            yield group, "only one of the two has it"
        for short, variable in members.items() if whose and all(whose) else ():
            name = key(group, short)
            if unequal & {*variable.dims} or short in skipped:
                continue
            text = _difference(one, other, name)
            if text:
                yield name, text


def _difference(one: Catalog, other: Catalog, name: str) -> str:
    """How a variable of a group differs; empty if it does not."""
    total = differ = 0
    for a, b in zip_longest(_parts(one, name), _parts(other, name)):
        if a is None or b is None or a.shape != b.shape:
            return "has another shape"
        total += a.size
        differ += int(np.count_nonzero((a != b) & ~(np.isnan(a) & np.isnan(b))))
    return f"{differ} of {total} values differ" if differ else ""


def _parts(catalog: Catalog, name: str) -> Iterator[AnyArray]:
    """A variable of a group, in blocks of rows."""
    step = max(1, BLOCK_BYTES // max(1, catalog.part(name, slice(0, 1)).nbytes))
    start = 0
    while len(part := catalog.part(name, slice(start, start + step))):
        yield part
        start += step
