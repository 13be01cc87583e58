"""Tables of results in Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; the columns behind the first are aligned to the right."""
    lines = [[*head], ["---", *["---:"] * (len(head) - 1)]]
    lines += [[str(cell) for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def percent(share: float, digits: int = 1) -> str:
    """A share of 1 as a number of per cent, ``-`` for NaN."""
    return "-" if math.isnan(share) else f"{100.0 * share:.{digits}f} %"
