"""The validation report: one self-contained HTML page. The template is ``validation.html.j2``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from ..catalog.summary import percent
from ..matching.position_fix import BY_ALL_POINTS
from ..matching.sun_check import SunCheck
from ..plots.html_page import page
from ..plots.numbers import number
from .report_claims import claims_data
from .report_points import points_data, table_data
from .report_pose import pose_data
from .report_windows import MODES, windows_data
from .result import ImageVerdict, Pictures, ValidationResult, plain


def render(verdict: ValidationResult, pictures: Sequence[Pictures]) -> str:
    """The report as HTML; one of ``pictures`` for each image. Equal content gives equal text."""
    names = ", ".join(image.facts.name for image in verdict.images)
    catalog = str(verdict.catalog.get("name", ""))
    document = verdict.document()
    stated = {name: document[name] for name in ("catalog", "options", "software")}
    return page(
        "validation.html.j2",
        title=f"Validation of {catalog}: {names}",
        heading="Validation of a catalogue with images",
        below=f"{catalog}: {names}",
        modes=MODES,
        claims=claims_data(verdict),
        images=[
            _image(image, shown) for image, shown in zip(verdict.images, pictures, strict=True)
        ],
        data=json.dumps(stated, indent=1, ensure_ascii=False),
    )


def _image(image: ImageVerdict, shown: Pictures) -> dict[str, Any]:
    """Everything the page shows of an image."""
    return {
        "name": image.facts.name,
        "opened": image.facts.opened,
        "result": image.verdict,
        "reason": image.reason,
        "overview": _overview_cells(image),
        "tiles": _tiles(image),
        "facts": _facts(image),
        "windows": windows_data(image, shown),
        "points": points_data(image, shown),
        "pose": pose_data(image.pose),
        "table": table_data(image),
    }


def _overview_cells(image: ImageVerdict) -> tuple[str, ...]:
    w = image.windows.compared if image.windows else None
    pose = image.pose
    return (
        f"{int(image.matches.found.sum())} of {len(image.matches)}",
        percent(w.share_above(0.9)) if w and w.count else "–",
        number(pose.pose.position_sigma_m) if pose else "–",
        _maybe(pose.position_error_m) if pose else "–",
    )


def _tiles(image: ImageVerdict) -> list[tuple[str, str]]:
    found: dict[str, Any] = plain(image.figures())
    count = f"{found['points_found']} of {found['points_in_view']}"
    what = (
        "points in view were found"
        if image.pose
        else "points that may be in view match individually"
    )
    shown = [(count, what) if found["points_in_view"] else ("0", "control points are in view")]
    if found["points_found"]:
        px, metres = found["offset_px"]["median"], found["offset_m"]["median"]
        shown.append(
            (f"{_maybe(px)} px", f"median offset from the given camera: {_maybe(metres)} m")
        )
    if image.pose is not None:
        error = image.pose.position_error_m
        known = "" if error is None else f"; error {number(error)} m"
        shown.append(
            (
                f"{number(image.pose.pose.position_sigma_m)} m",
                f"position uncertainty, 1 sigma{known}",
            )
        )
    if image.windows is not None and image.windows.compared.count:
        w = image.windows.compared
        text = f"of {w.count} windows of {w.size} x {w.size} cells correlate above 0.9"
        shown.append((percent(w.share_above(0.9)), text))
    return shown


def _facts(image: ImageVerdict) -> list[tuple[str, str]]:
    f, w = image.facts, image.windows
    sun = f"azimuth {f.sun_azimuth_deg:.1f}°, elevation {f.sun_elevation_deg:.1f}°"
    origin = f" ({f.sun_from})" if f.sun_from else ""
    rows = [
        ("image", f"{f.width_px} x {f.height_px} pixels of {_maybe(f.pixel_m)} m"),
        ("sensor", f.sensor),
        ("Sun", sun + origin if math.isfinite(f.sun_elevation_deg) else ""),
        ("off nadir", f"{f.off_nadir_deg:.1f}°" if math.isfinite(f.off_nadir_deg) else ""),
        ("saturated", percent(f.saturated_share) if f.saturated_share > 0 else ""),
        ("without data", percent(f.missing_share) if f.missing_share > 0 else ""),
        ("chance agreement", _chance(image)),
        ("check of the Sun", _light(image.located.sun)),
        ("encoding", image.encoding.sentence if image.encoding else ""),
        ("rendered DEM", w.against if w else ""),
        ("window cells", f"{number(w.compared.gsd_m, 4)} m: {w.resolution}" if w else ""),
        ("offset", w.offset_sentence if w else ""),
    ]
    return [(name, text) for name, text in rows if text]


def _chance(image: ImageVerdict) -> str:
    """Expected number of chance agreements as good as that of the points, or of the whole terrain."""
    known, rival = image.located.log10_false_alarms, image.located.rival_log10
    whole = image.located.by == BY_ALL_POINTS
    if not (whole or image.matches.found.any()) or not math.isfinite(known):
        return ""
    random = "images of other terrain" if whole else "random matches"
    return f"expected number of equally good agreements of {random}: 10^{known:.0f}; for the second-best position 10^{rival:.0f}"


def _light(check: SunCheck | None) -> str:
    """Median correlation of the points under the stated Sun direction and under others."""
    if check is None:
        return ""
    others = ", ".join(
        f"{number(value)} ({_turn(turned, raised)})"
        for (turned, raised), value in zip(check.turns_deg, check.correlations, strict=True)
    )
    says = "fits" if check.fits else "does not fit"
    if check.law:
        says += f" (rendered with {check.law}, which fits the image better)"
    return (
        f"{says}: median correlation {number(check.correlation)}; with the Sun elsewhere {others}"
    )


def _turn(turned_deg: float, raised_deg: float) -> str:
    parts = [(turned_deg, "turned"), (raised_deg, "raised")]
    return ", ".join(f"{how} {by:+g}°" for by, how in parts if by)


def _maybe(value: float | None) -> str:
    return number(math.nan if value is None else value)
