"""The result of a comparison of two catalogues: as a summary, as JSON, and as a table."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array, Index
from ..atomic_files import write_aside
from .catalogue import Catalog
from .schema import VARIABLES

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
        `atomic_files.write_aside`.
        """
        names = [f"{name} [{unit(name)}]" if unit(name) else name for name in self.amounts]
        head = ["point_id", "difference", "longitude", "latitude", "former_id", "distance_m"]
        with write_aside(path, overwrite) as aside, aside.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(head + names)
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
                    amounts = [_cell(own, name) for name in self.amounts]
                    table.writerow([*place, *move, *amounts])


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
