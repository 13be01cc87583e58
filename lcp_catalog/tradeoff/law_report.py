"""What the laws of reflection cost against each other, as a section of the trade's page and of its table to paste."""

# ruff: noqa: E501 - lines of markup

from __future__ import annotations

from html import escape
from typing import Any

from ..accuracy import TIERS
from ..choices import LAWS_BY_COST, REFERENCE_LAW
from .law_costs import CONTRAST, WINDOW, ModelChanges

HEADING = "What the laws of reflection cost"

EXPLAINED = (
    f"Every image of the areas, shadows included, under {', '.join(LAWS_BY_COST)}; windows of {WINDOW} x {WINDOW} nodes that are seen whole and show "
    f"something (contrast over {CONTRAST:g} of their mean) are correlated with the same windows under {REFERENCE_LAW}, gain and offset left free. A catalogue or a "
    "render without a stated law takes the first of them that is off by at most "
    + ", ".join(f"{100 * row.law_residual:g} % ({row.tier})" for row in TIERS.values())
    + f" of the mean signal: the rms difference to {REFERENCE_LAW} in images of random relief, gain and offset left free."
)


def models_markdown(models: ModelChanges) -> list[str]:
    """Lines of a document."""
    lines = [f"## {HEADING}", "", EXPLAINED, "", _times(models), ""]
    lines += [f"| {' | '.join(_HEAD)} |", "| ---: | --- |" + " ---: |" * (len(_HEAD) - 2)]
    lines += [f"| {' | '.join(_cells(row))} |" for row in _by_phase(models)]
    return [*lines, ""]


def models_section(models: ModelChanges) -> str:
    """A section of the page."""
    head = "".join(f"<th scope='col'>{escape(name)}</th>" for name in _HEAD)
    lines = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in _cells(row)) + "</tr>"
        for row in _by_phase(models)
    )
    table = f"<div class='wide'><table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table></div>"
    return (
        f"<section><h2>{HEADING}</h2><p>{escape(_times(models))}</p>{table}"
        f"<p class='file'>{escape(EXPLAINED)}</p></section>"
    )


_HEAD = (
    "phase, deg",
    "law",
    "images",
    "windows",
    "correlation: median",
    "5th percentile",
    "above 0.9",
)


def _times(models: ModelChanges) -> str:
    shares = ", ".join(f"{law} {share:.2f}" for law, share in models.times().items())
    return f"Time of all images, shadows and light, as a share of {REFERENCE_LAW}'s: {shares}."


def _by_phase(models: ModelChanges) -> list[dict[str, Any]]:
    return sorted(
        models.rows(), key=lambda row: (row["phase_deg"], LAWS_BY_COST.index(row["reflectance"]))
    )


def _cells(row: dict[str, Any]) -> list[str]:
    low, high = row["phase_deg"]
    figures = (f"{row[name]:.4f}" for name in ("correlation_median", "correlation_p05"))
    share = f"{100 * row['share_above_0_9']:.1f} %"
    return [
        f"{low:g} to {high:g}",
        row["reflectance"],
        str(row["images"]),
        f"{row['windows']:,}",
        *figures,
        share,
    ]
