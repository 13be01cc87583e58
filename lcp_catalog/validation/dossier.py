"""The dossier of a catalogue: the error budget of its points and of the positions that frames are
expected to give, a requirement on them, and validation reports as evidence. One HTML page for those
who decide whether a catalogue flies. The template is ``dossier.html.j2``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array
from ..atomic_files import check_output, write_bytes
from ..catalog.catalogue import Catalog
from ..catalog.schema import usable
from ..catalog.summary import Statistics, summary, summary_rows
from ..catalog.verification import open_catalog
from ..constants import FRAME
from ..errors import ConfigError
from ..matching.common_errors import map_sigma_m
from ..navigation.expected_position import SOURCES, Answer, Query, answers
from ..navigation.frame_points import PlannedImage
from ..plots.numbers import number, page
from .requirement import NUMBERS, Requirement

FRAME_NUMBERS = (
    "in_view",
    "usable",
    "listed",
    "expected_points",
    "located_probability",
    "position_sigma_m",
    "sigma_east_m",
    "sigma_north_m",
    "sigma_up_m",
    "position_sigma_known_attitude_m",
    "position_dop",
)
"""Figures of a frame that a requirement can name, beside those of a validation report."""


@dataclass(frozen=True)
class Evidence:
    """A ``report.json`` of a validation, by its file's name."""

    name: str
    document: Mapping[str, Any]

    @classmethod
    def read(cls, path: Path | str) -> Evidence:
        """ConfigError for a file that is no report of ``lcp validate``."""
        try:
            document = json.loads(Path(path).read_text(encoding="utf-8"))
            images = document["images"]
            sound = all(isinstance(image["image"], str) and image["verdict"] for image in images)
        except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
            raise ConfigError(f"{path}: is not a report.json of lcp validate ({error})") from None
        if not sound or not images:
            raise ConfigError(f"{path}: is not a report.json of lcp validate, or has no image")
        return cls(str(path), document)


@dataclass(frozen=True)
class RequirementVerdict:
    """What a requirement says about the frames and the evidence: failed terms, a line each."""

    requirement: str
    failures: tuple[str, ...]

    @classmethod
    def of(
        cls, text: str, frames: Sequence[Answer], evidence: Sequence[Evidence]
    ) -> RequirementVerdict:
        """Terms with a figure of a frame hold for every frame, others for every image of the evidence.
        ConfigError for an invalid term, and for one about which no frame or evidence is given.
        """
        wanted = Requirement.parse(text, (*FRAME_NUMBERS, *NUMBERS))
        of_frames = [term for term in wanted.terms if term.path in FRAME_NUMBERS]
        of_images = [term for term in wanted.terms if term.path not in FRAME_NUMBERS]
        images = [image for one in evidence for image in one.document["images"]]
        for terms, what, there in (
            (of_frames, "`camera` or `trajectory`", frames),
            (of_images, "`evidence`", images),
        ):
            if terms and not there:
                raise ConfigError(f"`require`: {terms[0].text} needs {what}")
        documents = [frame_figures(answer, k) for k, answer in enumerate(frames, 1)]
        lines = [
            *(_frame_failure(term, found) for found in documents for term in of_frames),
            *(term.failure(image) for image in images for term in of_images),
        ]
        return cls(text, tuple(line for line in lines if line))


def _frame_failure(term: Any, found: Mapping[str, Any]) -> str | None:
    if found[term.path] is None:
        return f"{found['image']}: no {term.path} ({found['reason']}); required: {term.text}"
    line: str | None = term.failure(found)
    return line


def frame_figures(answer: Answer, count: int) -> dict[str, Any]:
    """The figures `FRAME_NUMBERS` of a frame, None where the points do not determine one; its name as
    ``image``, and the ``reason`` of what is missing.
    """
    position = answer.position
    enu, dop = position.sigma_enu_m, position.dop
    east, north, up = (None, None, None) if enu is None else enu.tolist()
    return {
        "image": answer.frame.time_utc or f"frame {count}",
        "reason": position.reason,
        "in_view": answer.counts["in_view"],
        "usable": answer.usable,
        "listed": len(answer.rows),
        "expected_points": position.expected_points,
        "located_probability": answer.joint.located,
        "position_sigma_m": position.position_sigma_m,
        "sigma_east_m": east,
        "sigma_north_m": north,
        "sigma_up_m": up,
        "position_sigma_known_attitude_m": position.known_attitude_sigma_m,
        "position_dop": None if dop is None else dop["position"],
    }


def write_dossier(
    catalog_path: Path | str,
    output: Path | str,
    frames: Sequence[PlannedImage] = (),
    query: Query | None = None,
    requirement: str | None = None,
    evidence: Sequence[Path | str] = (),
    overwrite: bool = False,
) -> RequirementVerdict | None:
    """Write the dossier and return the verdict on the requirement; None without one.

    ``frames``: images to be taken, as for `navigation.expected_position.answers`; ``evidence``:
    ``report.json`` files of validations. Raises CatalogError, ConfigError for a requirement or an
    evidence that is not one, and the errors of `atomic_files.check_output`.
    """
    check_output(output, overwrite, [catalog_path, *evidence])
    given = [Evidence.read(path) for path in evidence]
    asked = query or Query()
    catalog = open_catalog(catalog_path)
    found = list(answers(catalog, frames, asked)) if frames else []
    verdict = None if requirement is None else RequirementVerdict.of(requirement, found, given)
    name = Path(catalog_path).name
    write_bytes(output, render(catalog, name, found, asked, verdict, given).encode(), overwrite)
    return verdict


def render(
    catalog: Catalog,
    name: str,
    found: Sequence[Answer],
    query: Query,
    verdict: RequirementVerdict | None,
    evidence: Sequence[Evidence],
) -> str:
    """The dossier as HTML. Equal inputs give equal text."""
    rows = summary_rows(summary(catalog, Statistics.of(catalog)))
    return page(
        "dossier.html.j2",
        title=f"Dossier: {name}",
        heading="Dossier of a catalogue of control points",
        below=name,
        verdict=verdict,
        catalogue=[(title.strip(), text) for title, text in rows if not title.startswith(" ")],
        of_a_point=point_budget(catalog, query),
        frames=[(frame_figures(answer, k), answer) for k, answer in enumerate(found, 1)],
        sources=SOURCES,
        attitude_deg=math.degrees(query.attitude_sigma_rad),
        evidence=evidence,
        figure=_text,
        files=catalog.sources,
        errors=catalog.errors,
        software=catalog.software_version,
    )


def point_budget(catalog: Catalog, query: Query) -> list[tuple[str, str, str]]:
    """Rows of the error budget of a point: source; median and 95th percentile of its 1 sigma, metres,
    over the usable conditions of all points.
    """
    major, place = _sigmas(catalog)
    match = np.sqrt(np.maximum(0.0, major**2 - place**2))
    heights = np.asarray(catalog.elevation_sigma, np.float64)
    if query.height_sigma_m is not None:
        heights = np.full(len(catalog), query.height_sigma_m)
    return [
        ("match, along the major axis of its ellipse", *_spread(match)),
        ("place on the ground, each axis (errors.position_sigma_m)", *_spread(place)),
        ("both together, as the catalogue states them", *_spread(major)),
        ("height (elevation_sigma)", *_spread(heights[np.isfinite(heights)])),
        ("tie of the map, common to all points, each axis", *_map_tie(catalog, query)),
        (f"frame: {FRAME}; taken for MOON_PA, a point is 875 m off", "–", "–"),
    ]


def _map_tie(catalog: Catalog, query: Query) -> tuple[str, str]:
    tie = query.map_sigma_m
    if tie is None:
        tie = map_sigma_m(catalog, np.arange(len(catalog)))
    return _spread(np.array([tie])) if tie > 0.0 else ("not stated", "not stated")


def _sigmas(catalog: Catalog) -> Array:
    """Major sigmas of the matches, metres, at the patch's scale in all usable conditions, and those of their points'
    places: (2, n).
    """
    found = []
    for rows in np.array_split(np.arange(len(catalog)), max(1, len(catalog) // 500)):
        works = usable(catalog.part("condition", rows))
        major = np.asarray(catalog.part("sigma_major", rows, 0), np.float64)
        place = catalog.place_sigma_m(rows)[:, None, None, None]
        found.append(np.stack([major, np.broadcast_to(place, major.shape)])[:, works])
    values = np.concatenate(found, axis=1)
    return np.asarray(values[:, np.isfinite(values[0])])


def _spread(values: Array) -> tuple[str, str]:
    if not len(values):
        return "not known", "not known"
    return number(float(np.median(values))), number(float(np.quantile(values, 0.95)))


def _text(value: Any) -> str:
    """A number with few digits; a dash for what is not known."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "–" if value is None else str(value)
    return str(value) if isinstance(value, int) else number(value)
