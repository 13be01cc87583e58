"""The differences of two catalogues: points that came, went, moved or changed, and by how much.

Public functions about catalogues: what one holds, how two differ.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..arrays import AnyArray, Array, Index
from ..atomic_files import csv_lines, write_lines
from ..errors import not_a, package
from ..landmarks.selection import Places, nearest
from .catalogue import Catalog
from .layout import GROUPS, TEXT, key
from .model import BLOCK_BYTES
from .schema import VARIABLES, levels
from .stored import content_sha256
from .summary import describe
from .verification import open_catalog

CONDITIONS = "conditions"
"""Unit of a difference of flags: the number of conditions of a point that differ."""


@dataclass(frozen=True, eq=False)
class ComparedPoints:
    """Points of one catalogue: ids, longitudes and latitudes in degrees, cell sizes in metres, each (n,)."""

    point_id: Index
    longitude: Array
    latitude: Array
    gsd: Array

    @classmethod
    def of(cls, catalog: Catalog) -> ComparedPoints:
        """All points of a catalogue."""
        return cls(catalog.point_id, catalog.longitude, catalog.latitude, catalog.gsd)

    def __len__(self) -> int:
        return len(self.point_id)

    def take(self, rows: Index) -> ComparedPoints:
        """Some of the points."""
        return ComparedPoints(
            self.point_id[rows], self.longitude[rows], self.latitude[rows], self.gsd[rows]
        )

    def documents(self) -> Iterator[dict[str, Any]]:
        """Id, longitude and latitude of each point, for JSON."""
        for one, lon, lat in zip(self.point_id, self.longitude, self.latitude, strict=True):
            yield {"point_id": int(one), "longitude": float(lon), "latitude": float(lat)}


@dataclass(frozen=True, eq=False)
class Comparison:
    """The differences of a second catalogue from a first.

    ``attributes``: what differs in axes, cell sizes, schema, configuration and sources, by name the values
    of both. ``maps``: by variable of the groups, what differs. ``not_compared``: variables of points
    on axes that differ, or that one catalogue is without. ``went``: points of the first alone;
    ``came``: of the second alone. ``moved_from``, ``moved_to``, ``moved_m``: points of both that are taken for the same under
    other ids, and their distances. ``matched``: points with the same id in both; ``amounts``: by
    variable the largest difference of each matched point, in the unit of `unit`; 0 for none, inf
    where only one catalogue has a value.
    """

    points: tuple[int, int]
    attributes: dict[str, tuple[Any, Any]]
    maps: dict[str, str]
    not_compared: tuple[str, ...]
    came: ComparedPoints
    went: ComparedPoints
    moved_from: ComparedPoints
    moved_to: ComparedPoints
    moved_m: Array
    matched: ComparedPoints
    amounts: dict[str, Array]

    def __repr__(self) -> str:
        """The numbers of points, and the names of what differs."""
        counts = ", ".join(f"{name} {count}" for name, count in self.counts().items())
        names = ", ".join([*self.attributes, *self.maps, *self.amounts])[:600]
        return f"<Comparison: {counts}; {f'differs in {names}' if names else 'no value differs'}>"

    def _repr_html_(self) -> str:
        """For a notebook tables of the numbers of points and of the variables that differ."""
        rows = [(name, str(count)) for name, count in self.counts().items()]
        rows += [
            (one["variable"], f"{one['points']} points, at most {one['largest']:.4g} {one['unit']}")
            for one in self.variables()
        ]
        cells = (f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows)
        return f"<table>{''.join(cells)}</table>"

    @property
    def differs(self) -> bool:
        """True if anything differs."""
        lists = (self.attributes, self.maps, self.not_compared, self.amounts)
        return any(len(one) for one in (*lists, self.came, self.went, self.moved_m))

    @property
    def changed(self) -> Index:
        """Rows of ``matched`` with a difference: most conditions first, then the largest difference of
        heights, then by id.
        """
        none = np.zeros(len(self.matched))
        some = np.any([*(amount > 0.0 for amount in self.amounts.values()), none > 0.0], axis=0)
        flags, heights = (self.amounts.get(name, none) for name in ("condition", "dem"))
        order = np.lexsort((self.matched.point_id, -heights, -flags))
        return np.asarray(order[some[order]])

    def counts(self) -> dict[str, int]:
        """Numbers of points: of either catalogue, matched, and of each kind of difference."""
        return {
            "first": self.points[0],
            "second": self.points[1],
            "matched": len(self.matched),
            "came": len(self.came),
            "went": len(self.went),
            "moved": len(self.moved_m),
            "changed": len(self.changed),
        }

    def variables(self) -> list[dict[str, Any]]:
        """For each variable that differs: its unit, the number of points, the largest difference and
        the point that has it, and the number of points with a value in one catalogue only.
        """
        found = []
        for name, amount in self.amounts.items():
            known = np.where(np.isfinite(amount), amount, 0.0)
            worst = int(np.argmax(known))
            found.append(
                {
                    "variable": name,
                    "unit": unit(name),
                    "points": int(np.count_nonzero(amount)),
                    "largest": float(known[worst]),
                    "point_id": int(self.matched.point_id[worst]),
                    "known_in_one": int(np.count_nonzero(np.isinf(amount))),
                }
            )
        return found

    def moves(self) -> Iterator[dict[str, Any]]:
        """The points that moved, the farthest first."""
        order = np.lexsort((self.moved_to.point_id, -self.moved_m))
        there = self.moved_to.take(order).documents()
        for row, document in zip(order, there, strict=True):
            old, far = self.moved_from.point_id[row], self.moved_m[row]
            yield document | {"former_id": int(old), "distance_m": float(far)}

    def changes(self) -> Iterator[dict[str, Any]]:
        """The points that changed, in the order of ``changed``: by variable the largest difference, None
        for a value that only one catalogue has.
        """
        rows = self.changed
        for row, document in zip(rows, self.matched.take(rows).documents(), strict=True):
            own = {name: float(amount[row]) for name, amount in self.amounts.items() if amount[row]}
            yield document | {"differences": {n: _plain(value) for n, value in own.items()}}

    def summary(self) -> dict[str, Any]:
        """Everything but the lists of points, for JSON."""
        return {
            "differs": self.differs,
            "attributes": [
                {"name": name, "first": first, "second": second}
                for name, (first, second) in self.attributes.items()
            ],
            "maps": [{"name": name, "difference": text} for name, text in self.maps.items()],
            "not_compared": list(self.not_compared),
            "points": self.counts(),
            "variables": self.variables(),
        }

    def json_pieces(self) -> Iterator[str]:
        """The whole as one JSON document, in pieces: `summary` with the lists ``came``, ``went``,
        ``moved`` and ``changed``, one point a line.
        """
        yield json.dumps(self.summary(), indent=2, allow_nan=False)[:-2]
        lists = {
            "came": self.came.documents(),
            "went": self.went.documents(),
            "moved": self.moves(),
            "changed": self.changes(),
        }
        for name, documents in lists.items():
            before = f',\n  "{name}": ['
            for document in documents:
                yield f"{before}\n    {json.dumps(document, allow_nan=False)}"
                before = ","
            yield "]" if before == "," else f"{before}]"
        yield "\n}"

    def write_table(self, path: Path | str, overwrite: bool = False) -> None:
        """Write all points that differ as CSV, one a line: id, kind of difference, place, former id and
        distance of a move, and a column for each variable that differs. Errors as
        `atomic_files.write_lines`.
        """
        write_lines(path, csv_lines(self._rows()), overwrite)

    def to_dataframe(self) -> Any:
        """All points that differ as a pandas.DataFrame with the columns of `write_table`, indexed by ``point_id``.
        MissingPackageError without pandas.
        """
        head, *rows = self._rows()
        pandas = package("pandas", "notebook", "a data frame")
        return pandas.DataFrame(rows, columns=head).replace("", None).set_index("point_id")

    def _rows(self) -> Iterator[list[Any]]:
        """The head of the table, then its rows."""
        names = [f"{name} [{unit(name)}]" if unit(name) else name for name in self.amounts]
        head = ["point_id", "difference", "longitude", "latitude", "former_id", "distance_m"]
        yield head + names
        for kind, documents in (
            ("came", self.came.documents()),
            ("went", self.went.documents()),
            ("moved", self.moves()),
            ("changed", self.changes()),
        ):
            for found in documents:
                own = found.get("differences", {})
                place = [found["point_id"], kind, found["longitude"], found["latitude"]]
                move = [found.get(name, "") for name in head[4:]]
                yield [*place, *move, *(_cell(own, name) for name in self.amounts)]


def unit(name: str) -> str:
    """Unit of a variable's differences; empty for text and numbers without one."""
    if name == "condition":
        return CONDITIONS
    text = (
        VARIABLES[name].units.replace("degrees_east", "degree").replace("degrees_north", "degree")
    )
    return "" if text == "1" else text


def _plain(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _cell(differences: dict[str, float | None], name: str) -> float | str | None:
    """A value of the table: empty for no difference, ``one`` where only one catalogue has a value."""
    return (
        ""
        if name not in differences
        else ("one" if differences[name] is None else differences[name])
    )


# -- the comparison

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
    cell size of the same level (`schema.levels`), lies within the spacing, and each is nearest to the
    other. Files with the same digest of their content are equal.
    """
    one, other = (open_catalog(path) for path in (first, second))
    if content_sha256(one) == content_sha256(other):
        return _equal(one)
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
            to, away_m = nearest(Places(a.longitude, a.latitude), Places(b.longitude, b.latitude))
            back, _ = nearest(Places(b.longitude, b.latitude), Places(a.longitude, a.latitude))
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
        return np.asarray(np.count_nonzero((first != second).reshape(flat), axis=1))
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
    numbers = ("gsd", "located_probability", "per_view", "footprint", "lower_bound")
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
    skipped = {"cell", "place", "step", "part", "block", "code", "unit"}  # numbers of rows
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


CatalogOrPath: TypeAlias = Catalog | Path | str


def opened_catalog(catalog: CatalogOrPath, check: bool = True) -> Catalog:
    """A catalogue, opened if its file is given (`open_catalog`); KindError for anything else."""
    if isinstance(catalog, Path | str):
        return open_catalog(catalog, check)
    if not isinstance(catalog, Catalog):
        raise not_a(catalog, "catalog", "a Catalog or the path of its file")
    return catalog


def inspect(catalog: Path | str) -> dict[str, Any]:
    """What a catalogue file holds, and whether it is intact. Every variable and checksum is read.

    Parameters
    ----------
    catalog:
        The file.

    Returns
    -------
    dict
        The document of ``lcp inspect``: ``points``, ``usable_share`` (of all evaluated
        conditions), ``intact``, ``problems`` (one line each), ``schema_version``, ``sources``,
        ``bounds`` (degrees; west above east if they cross the prime meridian) and others; None for
        what cannot be read. A damaged file is no error: ``intact`` is False.

    Examples
    --------
    >>> found = lcp.inspect(catalog)
    >>> found["intact"], found["problems"]
    (True, [])
    """
    if not isinstance(catalog, Path | str):
        raise not_a(catalog, "catalog", "the path of a catalogue's file")
    return describe(catalog)


def diff(first: CatalogOrPath, second: CatalogOrPath) -> Comparison:
    """Differences of two catalogues: points of the second that came, went, moved or changed since the
    first.

    Points are matched by their ids and compared in every variable. A point without partner has moved
    if the nearest one without partner of the same level lies within the spacing. The version of the
    software and the order of the points do not count.

    Parameters
    ----------
    first, second:
        Two catalogues, or their files.

    Returns
    -------
    Comparison
        ``differs``; ``counts()`` of points by kind; ``moves()`` and ``changes()`` point by point;
        ``summary()``, a document; ``to_dataframe()``.

    Raises
    ------
    CatalogError
        For a file that is no catalogue or is damaged.

    Examples
    --------
    >>> found = lcp.diff(catalog, catalog)
    >>> found.differs, found.counts()["changed"]
    (False, 0)
    """
    if isinstance(first, Catalog) or isinstance(second, Catalog):
        return compare_catalogs(opened_catalog(first), opened_catalog(second))
    return compare(first, second)
