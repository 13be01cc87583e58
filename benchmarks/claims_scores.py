"""Scores of stated probabilities and covariances: Brier, reliability, calibration error, tables and diagrams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lcp_catalog.validation.claims import Scores

Picture = NDArray[np.uint8]

LEAST_COUNT = 30
"""Bins with fewer trials are shown, but not judged."""
_BINS = 10
_SIDE_PX, _EDGE_PX = 360, 56


@dataclass(frozen=True)
class Reliability:
    """Probabilities compared with what happened, by bins of equal width.

    ``brier`` is that of single trials; ``brier_of_cases`` of the shares of successes of each case, None where a case is one
    trial; ``spread`` is the mean of p (1 - p) as the cases' shares show it, the least Brier score of single trials that any
    prediction can reach; ``calibration`` the mean difference of the bins, by count; ``worst`` the largest difference of a bin of
    `LEAST_COUNT` trials (of cases, where a case is several).
    """

    cases: int
    trials: int
    brier: float
    brier_of_the_mean: float
    brier_of_cases: float | None
    spread: float | None
    calibration: float
    worst: float
    bins: list[tuple[float, float, int, float, float]]  # low, high, cases, predicted, observed


def reliability(predicted: ArrayLike, found: ArrayLike, trials: int = 1) -> Reliability:
    """Scores of predictions (n,) against the share found (n,) of so many trials each. ValueError without a case."""
    p, f = (np.asarray(a, dtype=np.float64) for a in (predicted, found))
    if not len(p):
        raise ValueError("no case to score")
    mean = f.mean()
    place = np.minimum((p * _BINS).astype(int), _BINS - 1)
    bins = []
    for k in np.unique(place):
        here = place == k
        bins.append(
            (
                k / _BINS,
                (k + 1) / _BINS,
                int(here.sum()),
                float(p[here].mean()),
                float(f[here].mean()),
            )
        )
    off = [(count, abs(said - seen)) for _, _, count, said, seen in bins]
    several = trials > 1
    return Reliability(
        len(p),
        len(p) * trials,
        float(np.mean(f * (1.0 - p) ** 2 + (1.0 - f) * p**2)),
        float(mean * (1.0 - mean)),
        float(np.mean((f - p) ** 2)) if several else None,
        float(np.mean(f * (1.0 - f)) * trials / (trials - 1)) if several else None,
        sum(count * gap for count, gap in off) / len(p),
        max((gap for count, gap in off if count >= LEAST_COUNT), default=0.0),
        bins,
    )


def of_scores(scores: Scores) -> Reliability:
    """The library's scores of single trials, for a diagram."""
    bins = [
        (b.low, b.high, b.count, b.predicted, b.observed) for b in scores.reliability if b.count
    ]
    off = [abs(said - seen) for _, _, count, said, seen in bins if count >= LEAST_COUNT]
    return Reliability(
        scores.count,
        scores.count,
        scores.brier,
        scores.brier_of_the_mean,
        None,
        None,
        scores.expected_calibration_error,
        max(off, default=0.0),
        bins,
    )


def row_of(name: str, of: Reliability) -> str:
    """Cells of `HEAD`."""
    cells = [name, f"{of.cases}", f"{of.trials}", _number(of.brier_of_cases), _number(of.brier)]
    cells += [
        _number(of.spread),
        _number(of.brier_of_the_mean),
        _number(of.calibration),
        _number(of.worst),
    ]
    return "| " + " | ".join(cells) + " |"


HEAD = (
    "| | cases | trials | Brier of cases | Brier of trials | least possible | of the mean | calibration error | worst bin |\n"
    "| --- |" + " ---: |" * 8
)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def bins_table(named: dict[str, Reliability]) -> str:
    """Reliability by bin: predicted, observed and count of each."""
    lines = ["| predicted | " + " | ".join(named) + " |", "| --- |" + " --- |" * len(named)]
    for k in range(_BINS):
        cells = []
        for of in named.values():
            here = [b for b in of.bins if round(b[0] * _BINS) == k]
            cells.append(f"{here[0][3]:.2f} -> {here[0][4]:.2f} ({here[0][2]})" if here else "-")
        lines.append(f"| {k / _BINS:.1f}..{(k + 1) / _BINS:.1f} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def as_json(of: Reliability) -> dict[str, object]:
    """For a file of results."""
    return asdict(of)


# Diagrams


def diagram(path: Path, title: str, named: dict[str, Reliability]) -> None:
    """Reliability diagrams side by side: share found over predicted probability. Discs grow with the count; below
    `LEAST_COUNT` they are hollow.
    """
    panels = [_panel(name, of) for name, of in named.items()]
    picture = np.concatenate(panels, axis=1)
    head = np.full((34, picture.shape[1], 3), 255, np.uint8)
    text_px(head, title, (10, 23), 0.55)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.concatenate([head, picture]))


def _panel(name: str, of: Reliability) -> Picture:
    shown = of.brier if of.brier_of_cases is None else of.brier_of_cases
    title = f"{name}: n {of.trials}, Brier {shown:.3f}"
    panel, at = axes_px((_SIDE_PX, _SIDE_PX), (0.0, 1.0), (0.0, 1.0), "predicted", title)
    cv2.line(panel, at(0.0, 0.0), at(1.0, 1.0), (150, 150, 150), 1, cv2.LINE_AA)
    points = [at(said, seen) for _, _, _, said, seen in of.bins]
    cv2.polylines(panel, [np.array(points, np.int32)], False, (160, 90, 30), 1, cv2.LINE_AA)
    for (_, _, count, _, _), point in zip(of.bins, points, strict=True):
        radius = int(np.clip(2.0 + 2.2 * np.log10(max(count, 1)), 3, 12))
        cv2.circle(
            panel, point, radius, (160, 90, 30), -1 if count >= LEAST_COUNT else 1, cv2.LINE_AA
        )
    return panel


def axes_px(
    size: tuple[int, int], x: tuple[float, float], y: tuple[float, float], below: str, title: str
) -> tuple[Picture, Callable[[float, float], tuple[int, int]]]:
    """An empty plot of ``size`` (width, height) pixels inside its axes, and the pixel of a value."""
    width, height = size
    panel = np.full((height + _EDGE_PX + 40, width + _EDGE_PX + 20, 3), 255, np.uint8)

    def at(a: float, b: float) -> tuple[int, int]:
        right, up = (a - x[0]) / (x[1] - x[0]), (b - y[0]) / (y[1] - y[0])
        return round(_EDGE_PX + right * width), round(34 + (1.0 - up) * height)

    for k in range(6):
        a, b = (low + k / 5 * (high - low) for low, high in (x, y))
        cv2.line(panel, at(a, y[0]), at(a, y[1]), (228, 228, 228), 1)
        cv2.line(panel, at(x[0], b), at(x[1], b), (228, 228, 228), 1)
        text_px(panel, f"{a:.3g}", (at(a, y[0])[0] - 10, at(a, y[0])[1] + 18), 0.4)
        text_px(panel, f"{b:.3g}", (_EDGE_PX - 38, at(x[0], b)[1] + 4), 0.4)
    cv2.rectangle(panel, at(x[0], y[1]), at(x[1], y[0]), (90, 90, 90), 1)
    text_px(panel, title, (_EDGE_PX, 22), 0.45)
    text_px(panel, below, (_EDGE_PX + width // 2 - 30, at(x[0], y[0])[1] + 38), 0.45)
    return panel, at


def text_px(
    picture: Picture,
    text: str,
    where: tuple[int, int],
    size: float,
    colour: tuple[int, int, int] = (40, 40, 40),
) -> None:
    """Write at a pixel (column, row of the baseline)."""
    cv2.putText(picture, text, where, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
