"""Claims of groups of images as tables and reliability diagrams, by the library's own scores."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.markdown import table
from lcp_catalog.arrays import Array
from lcp_catalog.matching.joint_detection import at_least_found
from lcp_catalog.validation.claims import GATE_SIGMAS, Claims, Scores, score
from lcp_catalog.validation.report import reliability_diagram

Groups = Mapping[str, Sequence[Claims]]
"""Claims of images, one for each, by the name of a group."""
NAMES = ("probability", "usable", "sigma_m", "angle_deg", "tried", "found", "error_m")
"""Arrays of claims, as they are kept in files."""
SUBSETS, SIZES, FEWEST = 200, (6, 24), 30
"""Subsets of an image's points, their least and greatest number of points; subsets from which a bin is shown."""
STYLE = (
    "svg{width:430px;background:#fff;font:13px system-ui,sans-serif;fill:#333}.grid{stroke:#ddd}.axis{fill:none;stroke:#888}"
    ".middle{text-anchor:middle}.end{text-anchor:end}.bar{fill:#8aa8cf}.high{fill:#1f5fbf}"
    ".paper{fill:none;stroke:#c05a00;stroke-width:1.5;stroke-dasharray:5 3}.note{fill:#c05a00}.own{fill:#1f5fbf}"
    ".ideal{fill:none;stroke:#999;stroke-dasharray:4 3}.bin path{stroke:#8aa8cf}.bin circle{fill:#1f5fbf}"
)


def arrays(claims: Claims) -> dict[str, Any]:
    """What a file keeps of claims."""
    return {name: getattr(claims, name) for name in NAMES}


def kept(saved: Mapping[str, Any]) -> Claims:
    """Claims from what a file keeps."""
    return Claims(**{name: saved[name] for name in NAMES})


def share_near(claims: Claims) -> float:
    """Share of the usable points that were tried that were found within `GATE_SIGMAS` stated sigma."""
    usable = claims.usable & claims.tried
    squared = np.nan_to_num(claims.squared_distance, nan=np.inf)
    near = claims.found & (squared <= GATE_SIGMAS**2)
    return float(near[usable].mean()) if usable.any() else float("nan")


def scored(groups: Groups) -> dict[str, Scores]:
    """Scores of the groups that have trials."""
    pooled = {name: Claims.pooled(some) for name, some in groups.items()}
    return {name: score(of) for name, of in pooled.items() if (of.tried & of.claimed).any()}


def scores_table(groups: Groups) -> str:
    """One row a group with trials."""
    rows = []
    for name, of in scored(groups).items():
        near = share_near(Claims.pooled(groups[name]))
        shares = [of.found_of_usable, near, of.usable_of_found, of.found_of_unusable]
        briers = [of.brier, of.brier_of_the_mean, of.expected_calibration_error]
        rows.append([
            name, len(groups[name]), of.count, of.unclaimed, of.usable, *(f"{v:.3f}" for v in shares),
            *(f"{v:.4f}" for v in briers), f"{of.normalised_squared_error:.2f} ({of.errors})",
        ])  # fmt: skip
    head = [
        "",
        "images",
        "trials",
        "unclaimed",
        "usable",
        "found of usable",
        f"within {GATE_SIGMAS:g} sigma",
    ]
    head += ["usable of found", "found of others", "Brier", "of the mean", "calibration error"]
    return table([*head, "squared error"], rows)


def bins_table(groups: Groups) -> str:
    """Reliability by bin: predicted, observed and count of each."""
    found = scored(groups)
    some = [of.reliability for of in found.values()]
    rows = [
        [f"{bins[0].low:.1f}..{bins[0].high:.1f}",
         *(f"{b.predicted:.2f} -> {b.observed:.2f} ({b.count})" if b.count else "-" for b in bins)]
        for bins in zip(*some, strict=True)
    ]  # fmt: skip
    return table(["predicted", *found], rows)


def together_table(groups: Groups) -> str:
    """Probability that at least K of 6 to 24 points of an image are found, in seeded subsets: by tenths, stated and observed, and
    what the images that are there leave open: subsets of one image are not independent.
    """
    rng, columns = np.random.default_rng(35), []
    for some in groups.values():
        drawn = [
            draw for number, claims in enumerate(some) for draw in _subsets(claims, number, rng)
        ]
        tenth = np.array([min(int(10.0 * stated), 9) for stated, _, _ in drawn], np.int64)
        bins = [np.array(drawn).reshape(-1, 3)[tenth == k] for k in range(10)]
        columns.append([_told(b) if len(b) >= FEWEST and np.ptp(b[:, 2]) else "-" for b in bins])
    rows = [
        [f"{k / 10:.1f}..{(k + 1) / 10:.1f}", *cells] for k, cells in enumerate(zip(*columns, strict=True))
    ]  # fmt: skip
    return table(["at least K found (95 % by images; subsets, images)", *groups], rows)


def _told(drawn: Array) -> str:
    """Of subsets (n, 3): what is stated, the share that is observed, and its interval by drawing the images anew."""
    images, each = np.unique(drawn[:, 2], return_inverse=True)
    hits, count = np.bincount(each, drawn[:, 1]), np.bincount(each)
    share = np.full(len(images), 1.0 / len(images))
    again = np.random.default_rng(35).multinomial(len(images), share, 1000)
    low, high = np.percentile(again @ hits / (again @ count), [2.5, 97.5])
    stated, seen, _ = drawn.mean(axis=0)
    return f"{stated:.2f} -> {seen:.2f} ({low:.2f}..{high:.2f}; {len(drawn)}, {len(images)})"


def _subsets(
    claims: Claims, number: int, rng: np.random.Generator
) -> Iterator[tuple[float, float, int]]:
    """Of each subset of an image (by number): the probability of at least K points, 1 if so many are found."""
    some = claims.tried & claims.claimed
    probability, found = claims.probability[some], claims.found[some]
    for _ in range(SUBSETS if len(found) >= SIZES[0] else 0):
        size = rng.integers(SIZES[0], min(SIZES[1], len(found)) + 1)
        rows, least = rng.choice(len(found), size, replace=False), rng.integers(1, size + 1)
        yield (
            float(at_least_found(probability[rows])[least]),
            float(found[rows].sum() >= least),
            number,
        )


def write_diagrams(path: Path, title: str, groups: Groups) -> None:
    """A page of reliability diagrams beside each other."""
    head = f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{title}</title><style>{STYLE}</style><h1>{title}</h1>"
    figures = [
        f"<figure style='display:inline-block'><figcaption>{name}</figcaption>{reliability_diagram(of)}</figure>"
        for name, of in scored(groups).items()
    ]
    path.write_text(f"{head}{''.join(figures)}</html>\n", encoding="utf-8")
