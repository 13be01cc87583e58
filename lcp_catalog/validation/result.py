"""Results of a validation: figures of each image, and the content of ``report.json``.

A figure that was not measured is NaN or None here and null in JSON.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._version import __version__
from ..arrays import AnyArray, Array
from ..cameras.sensor import ON_MAP, middle_ray
from ..catalog.summary import percent
from ..matching.fix import CANNOT_SAY, LOCATED, NOT_HERE, Fix
from ..matching.matches import CODE, Matches
from ..matching.pose import Pose, PositionError
from ..matching.sun_verdict import SunCheck
from ..plots.numbers import number
from .advice import EncodingCheck
from .claims import Claims, Scores, score
from .ground_comparison import WindowComparison

VERDICTS = (LOCATED, NOT_HERE, CANNOT_SAY)
"""Possible results of an image."""

DIGITS = 10
"""Significant digits of a figure in JSON and CSV; the last bits of a double differ between
processors.
"""


@dataclass(frozen=True)
class ImageFacts:
    """Properties of an image before the search; an image that could not be opened has no pixels.
    ``name`` is no absolute path; angles refer to the image centre; NaN: unknown.
    """

    name: str
    width_px: int = 0
    height_px: int = 0
    sensor: str = ""  # like "framing camera" or "line scanner"
    pixel_m: float = math.nan  # ground sample distance at the centre
    sun_azimuth_deg: float = math.nan
    sun_elevation_deg: float = math.nan
    off_nadir_deg: float = math.nan
    sun_from: str = ""  # source of the Sun's position
    saturated_share: float = math.nan
    missing_share: float = math.nan

    def __post_init__(self) -> None:
        if Path(self.name).is_absolute():
            raise ValueError(f"{self.name}: the name must not be an absolute path")

    @property
    def opened(self) -> bool:
        """False for an image that could not be opened, or whose camera or Sun is unknown."""
        return self.width_px > 0


@dataclass(frozen=True, eq=False)
class PointFigures:
    """Identifiers and places of the rows of `Matches`. Pixels are (column, row) of the original
    image.
    """

    point_id: NDArray[np.int64]  # (n,)
    longitude_deg: Array  # (n,) east, 0..360
    latitude_deg: Array  # (n,)
    pixel_m: Array  # (n,) ground sample distance there
    corrected_px: Array  # (n, 2) prediction of the corrected sensor, NaN without a pose

    @classmethod
    def none(cls) -> PointFigures:
        """Figures of zero points."""
        empty = np.empty(0)
        return cls(np.empty(0, np.int64), empty, empty, empty, np.empty((0, 2)))


@dataclass(frozen=True, eq=False)
class WindowFigures:
    """The n windows of an image, the same windows of plain area means (``plain``), and descriptions
    of the comparison.
    """

    compared: WindowComparison
    plain: WindowComparison
    resolution: str  # choice of the cell size, one line
    against: str  # rendered terrain, like "dem.tif at 948 m"
    longitude_deg: Array  # (n,) of the window's centre, east, 0..360
    latitude_deg: Array  # (n,)
    point_id: NDArray[np.int64] | None = None  # (n,) point of the window's patch, for patches

    @property
    def offset_sentence(self) -> str:
        """Statement on the offset of the whole image."""
        if self.compared.offset == "kept":
            return "none was removed before the comparison"
        right, down = (number(cells) for cells in self.compared.shift_px)
        return f"{right} cells right and {down} down, removed from the whole image before the comparison"


@dataclass(frozen=True, eq=False)
class Pictures:
    """Images for the report, None where there are none. Values have any gain and offset; NaN marks
    missing pixels.

    ``image`` (rows, cols) holds the means of blocks of ``image_factor`` x ``image_factor`` pixels
    of the image. ``ground_image`` and ``ground_render`` (rows, cols) are on the grid of the
    windows; if patches were compared, they are (k, rows, cols), and the windows refer to them.
    """

    image: AnyArray | None = None
    image_factor: int = 1
    ground_image: AnyArray | None = None
    ground_render: AnyArray | None = None


@dataclass(frozen=True, eq=False)
class PoseFigures:
    """A corrected sensor. ``error`` is None if the true position is unknown, and for maps."""

    pose: Pose
    error: PositionError | None = None

    @property
    def position_axes_m(self) -> Array:
        """1 sigma along the principal axes of the position covariance, descending; 3 axes for a
        camera, 2 for a map.
        """
        variances = np.linalg.eigvalsh(self.pose.covariance[:3, :3])[::-1]
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    @property
    def position_error_m(self) -> float | None:
        return None if self.error is None else self.error.error.whole_m

    @property
    def position_mcmf_m(self) -> Array | None:
        """Position (3,) of the corrected camera, of a scanner at its middle line; None for a map."""
        if self.pose.sensor.corrections == ON_MAP:
            return None
        return middle_ray(self.pose.sensor)[0]

    def figures(self) -> dict[str, Any]:
        """``pose`` in ``report.json``. `position_sigma_m` is the root of the sum of the position
        variances, the expected root mean square of the position error.
        """
        pose, error = self.pose, self.error
        names = pose.sensor.corrections
        return {
            "position_error_m": self.position_error_m,
            "position_sigma_m": pose.position_sigma_m,
            "position_error_across_m": error.error.across_m if error else None,
            "position_sigma_across_m": error.sigma.across_m if error else None,
            "position_sigma_axes_m": self.position_axes_m,
            "position_mcmf_m": self.position_mcmf_m,
            "normalised_error": pose.normalised_error,
            "correction": dict(zip(names, pose.correction, strict=True)),
            "sigma": dict(zip(names, pose.sigma, strict=True)),
            "covariance": pose.covariance,
        }


@dataclass(frozen=True, eq=False)
class ImageVerdict:
    """Results of one image. ``error``: of its pose, if the true one is known."""

    facts: ImageFacts
    located: Fix
    points: PointFigures  # of the rows of ``located.matches``
    claims: Claims  # on the same rows
    windows: WindowFigures | None = None
    windows_reason: str = ""  # reason if there are none
    error: PositionError | None = None
    encoding: EncodingCheck | None = None  # of a located image of 8 bits
    advice: tuple[str, ...] = ()  # one line each

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(
                f"{self.facts.name}: verdict {self.verdict!r} is not one of {VERDICTS}"
            )
        if (self.located.pose is not None) != (self.verdict == LOCATED):
            raise ValueError(f"{self.facts.name}: only a {LOCATED!r} image has a pose")
        if len(self.points.point_id) != len(self.matches):
            raise ValueError(f"{self.facts.name}: numbers of points and matches differ")
        if len(self.claims) != len(self.matches):
            raise ValueError(f"{self.facts.name}: numbers of claims and matches differ")

    @property
    def verdict(self) -> str:
        """One of `VERDICTS`."""
        return self.located.verdict

    @property
    def reason(self) -> str:
        return self.located.reason

    @property
    def matches(self) -> Matches:
        return self.located.matches

    @cached_property
    def pose(self) -> PoseFigures | None:
        """None unless `LOCATED`."""
        pose = self.located.pose
        return None if pose is None else PoseFigures(pose, self.error)

    @cached_property
    def scores(self) -> Scores:
        """Scores of the claims."""
        return score(self.claims)

    @cached_property
    def residual_px(self) -> Array:
        """Position found minus prediction of the corrected sensor (n, 2), also for rejected
        matches; NaN for points not found and without a pose.
        """
        return np.asarray(self.matches.found_px - self.points.corrected_px)

    def figures(self) -> dict[str, Any]:
        """One entry of ``images`` in ``report.json``."""
        found, matches = self.matches.found, self.matches
        offset = np.linalg.norm(matches.offset_px[found], axis=-1)
        counts = {reason: n for reason, n in matches.counts().items() if CODE[reason]}
        return {
            "image": self.facts.name,
            "verdict": self.verdict,
            "reason": self.reason,
            "points_in_view": len(matches),
            "points_found": int(found.sum()),
            "not_found": counts,
            "offset_px": _middle_and_most(offset),
            "offset_m": _middle_and_most(offset * self.points.pixel_m[found]),
            "residual_px": _middle_and_most(np.linalg.norm(self.residual_px[found], axis=-1)),
            "correlation": {
                "median": _percentile(matches.correlation[found], 50.0),
                "p05": _percentile(matches.correlation[found], 5.0),
            },
            "windows": self._windows(self.windows.compared if self.windows else None),
            "windows_plain": self._windows(self.windows.plain if self.windows else None),
            "pose": None if self.pose is None else self.pose.figures(),
            "claims": self.scores.figures(),
            "located_by": None if self.pose is None else self.located.by,
            "log10_false_alarms": self.located.log10_false_alarms,
            "log10_false_alarms_rival": self.located.rival_log10,
            "light": _light(self.located.sun),
            "encoding": self.encoding.figures() if self.encoding else None,
            "advice": list(self.advice),
            "size_px": [self.facts.width_px, self.facts.height_px],
            "sensor": self.facts.sensor,
            "pixel_m": self.facts.pixel_m,
            "sun": {
                "azimuth_deg": self.facts.sun_azimuth_deg,
                "elevation_deg": self.facts.sun_elevation_deg,
                "from": self.facts.sun_from,
            },
            "off_nadir_deg": self.facts.off_nadir_deg,
            "saturated_share": self.facts.saturated_share,
            "missing_share": self.facts.missing_share,
        }

    def _windows(self, w: WindowComparison | None) -> dict[str, Any]:
        """``windows`` or ``windows_plain`` in ``report.json``; the same names without values if
        there are none.
        """
        figures = self.windows
        return {
            "size": w.size if w else None,
            "step": w.step if w else None,
            "count": w.count if w else 0,
            "gsd_m": w.gsd_m if w else None,
            "resolution": figures.resolution if figures else "",
            "against": figures.against if figures else "",
            "share_above_0_9": w.share_above(0.9) if w else None,
            "share_above_0_7": w.share_above(0.7) if w else None,
            "median": w.median if w else None,
            "mode": w.mode if w else None,
            "textured": {
                "share_above_0_9": w.textured.share_above(0.9) if w else None,
                "share_above_0_7": w.textured.share_above(0.7) if w else None,
            },
            "offset": w.offset if w else None,
            "shift_px": list(w.shift_px) if w else None,
            "reason": self.windows_reason,
        }


@dataclass(frozen=True, eq=False)
class ValidationResult:
    """A whole validation: its images, facts of the catalogue (``name``, ``points`` ...), and the
    options.
    """

    images: tuple[ImageVerdict, ...]
    catalog: Mapping[str, Any]
    options: Mapping[str, Any]

    @cached_property
    def scores(self) -> Scores:
        """Scores of the claims on the points of all images together."""
        return score(Claims.pooled([image.claims for image in self.images]))

    def document(self) -> dict[str, Any]:
        """The content of ``report.json`` in plain values; None for figures that were not measured."""
        whole: dict[str, Any] = plain(
            {
                "catalog": dict(self.catalog),
                "options": dict(self.options),
                "images": [image.figures() for image in self.images],
                "claims": self.scores.figures(),
                "software": f"lcp-catalog {__version__}",
            }
        )
        return whole

    def to_json(self) -> str:
        """`document` as text; equal verdicts give equal bytes."""
        return json.dumps(self.document(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """Values for JSON: lists for arrays, numbers with `DIGITS` digits, None for nan and inf."""
    if isinstance(value, Mapping):
        return {str(name): plain(inner) for name, inner in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return _rounded(value) if math.isfinite(value) else None
    return value


def _light(check: SunCheck | None) -> dict[str, Any] | None:
    """Check of the Sun direction: as stated, and turned clockwise or raised. ``law``: reflectance
    model of the renders, if it differs from that of the search.
    """
    if check is None:
        return None
    tried = zip(check.turns_deg, check.correlations, check.shares, strict=True)
    return {
        "fits": check.fits,
        "elevation_fits": check.elevation_fits,
        "points": check.points,
        "law": check.law or None,
        "correlation": check.correlation,
        "others": [
            {
                "turned_deg": turned,
                "raised_deg": raised,
                "correlation": value,
                "preferred_share": share,
            }
            for (turned, raised), value, share in tried
        ],
    }


def _middle_and_most(values: Array) -> dict[str, float]:
    return {"median": _percentile(values, 50.0), "p95": _percentile(values, 95.0)}


def _percentile(values: Array, percent: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if len(known) else math.nan


def _rounded(value: float) -> float:
    """Value with `DIGITS` digits, without a sign at 0; unchanged if rounding overflows."""
    rounded = float(f"{value:.{DIGITS}g}")
    return rounded + 0.0 if math.isfinite(rounded) else value


# -- in a few lines of text


def summary_lines(verdict: ValidationResult) -> list[str]:
    """Summary of all images for a terminal."""
    lines = [line for image in verdict.images for line in image_lines(image)]
    if len(verdict.images) > 1 and verdict.scores.count:
        lines.append(f"all images: claims: {claims_text(verdict.scores)}")
    return lines


def image_lines(image: ImageVerdict) -> list[str]:
    """Lines on an image: the verdict, position, points, claims, then windows, as far as available."""
    found: dict[str, Any] = plain(image.figures())
    lines = [f"{image.facts.name}: {image.verdict}" + (f": {image.reason}" if image.reason else "")]
    if not image.facts.opened:
        return lines
    if image.pose is not None:
        lines.append(f"  pose     {pose_text(image.pose)}")
    view = "in view" if image.pose else "that may be in view"
    lines.append(f"  points   {found['points_found']} of {found['points_in_view']} {view} found")
    if not found["points_in_view"]:
        lines[-1] = "  points   none in view"
    if found["not_found"]:
        lines[-1] += "; " + ", ".join(f"{n} {reason}" for reason, n in found["not_found"].items())
    if found["points_found"]:
        lines.append(f"  offset   {_offset_text(found)}")
    lines.append(f"  claims   {claims_text(image.scores)}")
    lines.append(f"  windows  {windows_text(image)}")
    if image.encoding is not None:
        lines.append(f"  encoding {image.encoding.sentence}")
    lines += [f"  advice   {text}" for text in image.advice]
    return lines


def claims_text(scores: Scores) -> str:
    """One line on the scores of the claims."""
    if not scores.count:
        return "not scored" + (f": {scores.reason}" if scores.reason else "")
    of_usable = f"{percent(scores.found_of_usable)} of {scores.usable} usable points found"
    of_found = f"{percent(scores.usable_of_found)} of {scores.found} found points usable"
    error = f"; squared error over stated {number(scores.normalised_squared_error)}"
    return (
        f"{of_usable if scores.usable else 'no point usable'}, "
        f"{of_found if scores.found else 'none found'}; Brier score {number(scores.brier)} "
        f"(constant: {number(scores.brier_of_the_mean)}) of {scores.count} trials"
        f"{error if scores.errors else ''}"
        f"{f'; {scores.unclaimed} in view without a claim' if scores.unclaimed else ''}"
    )


def windows_text(image: ImageVerdict) -> str:
    """One line on the windows."""
    if image.windows is None or not image.windows.compared.count:
        return "none compared" + (f": {image.windows_reason}" if image.windows_reason else "")
    w = image.windows.compared
    return (
        f"{w.count} of {w.size} x {w.size} cells of {number(w.gsd_m, 4)} m: {100 * w.share_above(0.9):.1f} % above 0.9, "
        f"{100 * w.share_above(0.7):.1f} % above 0.7, median {w.median:.3f}, mode {w.mode:.3f}; "
        f"without smoothing {100 * image.windows.plain.share_above(0.9):.1f} % above 0.9; offset: {image.windows.offset_sentence}"
    )


def pose_text(figures: PoseFigures) -> str:
    """One line on the pose."""
    pose, error = figures.pose, figures.position_error_m
    known = "" if error is None else f", error {number(error)} m"
    return f"position to {number(pose.position_sigma_m)} m (1 sigma){known}; normalised error {number(pose.normalised_error)}"


def _offset_text(found: Mapping[str, Any]) -> str:
    px, metres, residual = (found[name] for name in ("offset_px", "offset_m", "residual_px"))
    text = (
        f"median {_figure(px['median'])} px ({_figure(metres['median'])} m), "
        f"95 % within {_figure(px['p95'])} px ({_figure(metres['p95'])} m)"
    )
    if residual["median"] is not None:
        text += f"; after the pose {_figure(residual['median'])} px"
    return text


def _figure(value: float | None) -> str:
    return number(math.nan if value is None else value)
