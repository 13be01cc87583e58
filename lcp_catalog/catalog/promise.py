"""How a catalogue keeps what it promises (`catalogue.Guarantee`), in figures for people: by cause, by Sun,
and by the number of points.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import AnyArray
from .catalogue import Catalog
from .schema import NO_CELL, Cause
from .sun_cells import SunCells

WORST = 5
"""Number of worst Suns that are named."""

_CURVE_STEPS = 12


def kept_promise(catalog: Catalog) -> dict[str, Any] | None:
    """Figures of the promise, ready for JSON; None for a catalogue without one.

    A condition is a view and a cell of the Sun grid at a place at which something is promised.
    ``kept_share``: of all conditions; ``causes``: shares of them by cause; ``worst_suns``: views and
    Suns with the smallest shares of places at which the promise is kept; ``curve``: pairs of a
    number of points and the share of the conditions with as many points as the candidates allow.
    """
    promise = catalog.guarantee
    if promise is None:
        return None
    cause = catalog.part("guarantee/cause")
    counts = np.bincount(cause.ravel(), minlength=NO_CELL + 1)[: max(Cause) + 1]
    total = max(1, int(counts.sum()))
    bound = promise.lower_bound
    steps = np.unique(np.linspace(0, len(promise.size) - 1, _CURVE_STEPS).astype(np.int64))
    return {
        "per_view": int(promise.per_view),
        "footprint_km": promise.footprint_m / 1e3,
        "places": len(promise.longitude),
        "conditions": int(counts.sum()),
        "kept_share": float(counts[Cause.MET] / total),
        "causes": {
            cause.name.lower(): float(counts[cause] / total)
            for cause in Cause
            if cause != Cause.MET and counts[cause]
        },
        "lower_bound": bound or None,
        "size_over_bound": len(catalog) / bound if bound else None,
        "worst_suns": _worst(catalog, cause),
        "curve": [
            [int(promise.size[k]), float(promise.met[k])] for k in steps if len(promise.size)
        ],
    }


def _worst(catalog: Catalog, cause: AnyArray) -> list[dict[str, Any]]:
    """The views and cells of the Sun grid with the smallest shares of places."""
    places = np.count_nonzero(cause != NO_CELL, axis=0)
    met = np.count_nonzero(cause == Cause.MET, axis=0)
    share = np.where(places > 0, met / np.maximum(places, 1), np.inf)
    cells = SunCells.of(catalog.sun_elevation, catalog.sun_azimuth)
    found = []
    for flat in np.argsort(share, axis=None, kind="stable")[:WORST]:
        view, row, column = (int(k) for k in np.unravel_index(flat, share.shape))
        if not share[view, row, column] < 1.0:
            break
        why = cause[:, view, row, column]
        counts = np.bincount(why[(why != NO_CELL) & (why != Cause.MET)], minlength=1)
        found.append(
            {
                "view": view,
                "sun_elevation_deg": _span(cells.elevation, row, int(cells.above[row])),
                "sun_azimuth_deg": _span(cells.azimuth, column, int(cells.after[column])),
                "places": int(places[view, row, column]),
                "kept_share": float(share[view, row, column]),
                "cause": Cause(int(counts.argmax())).name.lower(),
            }
        )
    return found


def _span(grid: AnyArray, first: int, last: int) -> list[float]:
    return [float(grid[first]), float(grid[last])]


def promise_rows(found: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Figures of `kept_promise` as names and lines of text."""
    if found is None:
        return []
    causes = ", ".join(f"{name} {100.0 * share:.1f} %" for name, share in found["causes"].items())
    rows = [
        (
            "promise",
            f"{found['per_view']} usable points in every footprint of {found['footprint_km']:.4g} km: kept in "
            f"{100.0 * found['kept_share']:.1f} % of {found['conditions']} places x views x Suns",
        )
    ]
    if causes:
        rows.append(("  else", causes))
    rows += [("  worst Sun", worst_text(sun)) for sun in found["worst_suns"]]
    if found["lower_bound"]:
        text = f"at least {found['lower_bound']:.1f} points keep it, {found['size_over_bound']:.2f} times as many do"
        rows.append(("  size", text))
    return rows


def worst_text(sun: dict[str, Any]) -> str:
    """Text for one of the worst Suns."""
    return (
        f"elevation {_range_text(sun['sun_elevation_deg'])}, azimuth {_range_text(sun['sun_azimuth_deg'])}, view "
        f"{sun['view']}: kept at {100.0 * sun['kept_share']:.1f} % of {sun['places']} places ({sun['cause']})"
    )


def _range_text(span: list[float]) -> str:
    return f"{' to '.join(dict.fromkeys(f'{value:g}' for value in span))}°"
