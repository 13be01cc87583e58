"""All finished areas of a build together: one table of their candidates, and the records of any of
them, read when they are asked for.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import AnyArray, Bytes, Index
from ..rendering.plan import ScenePlan
from .checkpoints import Checkpoints, StoredArea, lost_area


@dataclass(frozen=True)
class JoinedAreas:
    """The candidates (n,) of areas in the order of their names, as a table of type
    `finished_area.TABLE`; the number of each one's area and of its record in it; and the merged plan.
    """

    checkpoints: Checkpoints
    names: Sequence[str]
    table: AnyArray
    area: Index
    record: Index
    before: Index  # bytes before the records, by area
    plan: ScenePlan

    @classmethod
    def read(
        cls,
        checkpoints: Checkpoints,
        names: Sequence[str],
        seen: Callable[[AnyArray, Bytes], None] = lambda table, stages: None,
    ) -> JoinedAreas:
        """AreaFailedError for an area that is lost or damaged. ``seen``: called with the table and the
        stages of each area in turn, which are not kept.
        """
        tables: list[AnyArray] = []
        before: list[int] = []

        def plans() -> Iterator[tuple[str, ScenePlan]]:
            for name in names:
                found = _found(checkpoints, name)
                tables.append(found.table)
                before.append(found.before)
                seen(found.table, found.stages)
                yield name, ScenePlan.from_json(json.loads(found.plan))

        plan = ScenePlan.merged(plans())
        counts = [len(table) for table in tables]
        table = np.concatenate(tables)
        number = np.cumsum(table["usable"] > 0)
        first = np.cumsum([0, *counts[:-1]])  # rows
        earlier = np.concatenate([[0], number])[first]  # records in the areas before
        area = np.repeat(np.arange(len(names)), counts)
        return cls(
            checkpoints, names, table, area, number - 1 - earlier[area], np.array(before), plan
        )

    def records(self, rows: Index, kind: np.dtype[np.void]) -> AnyArray:
        """The records of rows of the table, of type ``kind``; each area is read once. AreaFailedError
        for an area that is lost or damaged.
        """
        found = np.empty(len(rows), kind)
        order = np.argsort(self.area[rows], kind="stable")
        rows = rows[order]
        areas, starts = np.unique(self.area[rows], return_index=True)
        ends = [*starts[1:].tolist(), len(rows)]
        for area, start, end in zip(areas.tolist(), starts.tolist(), ends, strict=True):
            own = rows[start:end]
            found[start:end] = self.checkpoints.records(
                self.names[area],
                kind,
                int(self.before[area]),
                self.record[own],
                self.table["checksum"][own],
            )
        if (np.diff(order) > 0).all():
            return found
        back = np.empty(len(order), np.int64)
        back[order] = np.arange(len(order))
        return found[back]


def _found(checkpoints: Checkpoints, name: str) -> StoredArea:
    found = checkpoints.read(name)
    if found is None:
        raise lost_area(checkpoints.path(name))
    return found
