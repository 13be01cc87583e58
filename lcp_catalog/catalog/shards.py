"""An index of catalogues, `.lcpx`: a catalogue's file whose points stay in other files, its shards. It has everything
but the points, as if they were merged, and in its attribute `SHARDS` what each shard gives.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import AnyArray, Index

SHARDS = "shards"
"""Global attribute of an index: JSON, one object a shard."""


@dataclass(frozen=True)
class Shard:
    """A catalogue's file in an index.

    ``path``: from the index's folder. ``points``: number of its points, without its rows ``left_out`` (of another
    shard's points, too near or the same). ``levels``: the level in the index of each of its own. ``center_m``
    (MCMF) and ``radius_m``: a sphere around the places of the points.
    """

    path: str
    content_sha256: str
    points: int
    levels: tuple[int, ...]
    center_m: tuple[float, float, float]
    radius_m: float
    left_out: tuple[int, ...] = ()

    @classmethod
    def of(
        cls,
        path: Path | str,
        index: Path | str,
        digest: str,
        places_m: AnyArray,
        levels: Sequence[int],
        left_out: Index,
    ) -> Shard:
        """What the ``index`` says of the shard with this digest; ``places_m`` (n, 3): MCMF, of its points."""
        low, high = places_m.min(axis=0), places_m.max(axis=0)
        x, y, z = np.round((low + high) / 2.0, 1).tolist()
        away = np.linalg.norm(places_m - (x, y, z), axis=1).max()
        name = Path(os.path.relpath(path, Path(index).parent)).as_posix()
        rows = tuple(left_out.tolist())
        return cls(
            name,
            digest,
            len(places_m),
            tuple(levels),
            (x, y, z),
            math.ceil(float(away)) + 1.0,
            rows,
        )

    @classmethod
    def read(cls, stated: Any) -> Shard:
        """From its JSON; ValueError, TypeError for another."""
        found = cls(**dict(stated))
        whole = [found.points, *found.levels, *found.left_out]
        reals = [*found.center_m, found.radius_m]
        if not (
            isinstance(found.path, str)
            and isinstance(found.content_sha256, str)
            and all(type(number) is int and number >= 0 for number in whole)
            and len(found.center_m) == 3
            and all(isinstance(number, int | float) for number in reals)
        ):
            raise ValueError("not a shard")
        return found

    @property
    def stated(self) -> dict[str, Any]:
        """What its JSON is made of."""
        return asdict(self)

    def rows(self, count: int) -> Index:
        """Rows of its points in its file, which has ``count``."""
        return np.setdiff1d(np.arange(count), np.array(self.left_out, np.int64))


def shards_problem(stated: Any) -> str:
    """What is wrong with the JSON of `SHARDS`; empty if nothing is."""
    try:
        [Shard.read(one) for one in stated]
    except (TypeError, ValueError):
        return "is not a list of shards"
    return ""
