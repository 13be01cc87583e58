"""Check of a DEM file against its label: sizes, extremes, sums, bounds, and heights that are
possible on the Moon.

Every problem is one line that states what is wrong and what to do. The position of the map on the
Moon and the quality of the heights are not checked.
"""

from __future__ import annotations

import errno
import hashlib
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..errors import LcpError
from ..pds.label import Label
from ..pds.label_files import product_label
from ..pds.pds3 import read_pds3
from .dem import Dem, extremes_step, grid_of_label, is_geotiff
from .grid import Grid
from .pixel_statistics import Extreme, SampleStatistics, sample_statistics
from .plausibility import ALL_ZERO, doubts
from .products import facts_of
from .raster import POSSIBLE_M

_AGAIN = "fetch both again"
_APART_M, _REPEATED = 1000.0, 3
"""An extreme value in at least so many pixels, so far from all others, is a code for missing data
and no height.
"""


@dataclass(frozen=True)
class CheckResult:
    """Result for one file: with ``problems`` it must not be used; ``notes`` are remarks; ``warnings``: why
    its heights are hardly those of the Moon in metres (`plausibility`).
    """

    path: str
    product: str | None  # None when the file cannot be opened
    problems: tuple[str, ...]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def sound(self) -> bool:
        return not self.problems


def check_dem(path: Path | str) -> CheckResult:
    """Open a file, read all its pixels once, and compare them with the label. Faults of the file
    are in the result and never raised. OSError where the system does not open it (no permission, too many open files).
    """
    try:
        dem = Dem.open(path)
        label = _label_of(Path(path))
        grid = None if label is None else grid_of_label(label)
    except LcpError as error:
        return CheckResult(str(path), None, (_line(error),))
    problems, notes = _sizes(dem, label), _names(dem, label)
    try:
        survey = sample_statistics(dem.raster, dem.grid)
    except LcpError as error:
        return CheckResult(str(path), dem.product, (*problems, _line(error)), tuple(notes))
    wrong = _heights(dem, survey)
    problems += [f"{dem.path}: {text}" for text in wrong]
    doubtful = () if wrong else tuple(_doubts(dem, survey))
    notes += _stripes(survey)
    if label is not None and grid is not None:
        wrong = [*_extremes(dem, label, survey), *_sums(dem, label, survey)]
        wrong += _map(dem, label, grid)
        problems += [f"{label.path}: {text}" for text in wrong]
    return CheckResult(str(path), dem.product, tuple(problems), tuple(notes), doubtful)


def _doubts(dem: Dem, survey: SampleStatistics) -> Iterator[str]:
    if survey.lowest is not None and survey.highest is not None:
        low_m, high_m = (_metres(dem, one.value) for one in (survey.lowest, survey.highest))
        known = survey.pixels - survey.missing
        yield from doubts(dem, low_m, high_m, survey.pixels, known, survey.stuck)


def _line(error: LcpError) -> str:
    """A fault of the file as one line; that the system does not open it is raised. GDAL says so in its text alone."""
    text = " ".join(str(error).split())
    if any(
        os.strerror(code) in text for code in (errno.EIO, errno.EMFILE, errno.EACCES, errno.ENOMEM)
    ):
        raise error
    return text


def _label_of(path: Path) -> Label | None:
    """The product's label; for a GeoTIFF the one beside it that names it."""
    if not is_geotiff(path):
        return product_label(path)
    for beside in sorted(path.parent.iterdir()):
        if beside.name.lower() == f"{path.stem.lower()}.lbl":
            label = read_pds3(beside)
            return label if label.image_name.lower() == path.name.lower() else None
    return None


def _sizes(dem: Dem, label: Label | None) -> list[str]:
    """Problems of the label's sizes; an image that is too short or too long was refused on opening."""
    if label is None:
        return []
    if is_geotiff(dem.path):
        said, there = (label.lines, label.line_samples), (dem.grid.height, dem.grid.width)
        text = f"has {there[0]} x {there[1]} pixels where its label {label.path.name} states {said[0]} x {said[1]}"
        return [] if said == there else [f"{dem.path}: {text}; {_AGAIN}"]
    if label.compressed:
        return []
    stated = label.declared.file_bytes
    if stated is not None and stated < label.image_bytes:
        return [
            f"{label.path}: states a file of {stated} bytes, which cannot hold "
            f"{label.lines} x {label.line_samples} samples ({label.image_bytes} bytes); fetch the label again"
        ]
    return []


def _names(dem: Dem, label: Label | None) -> list[str]:
    notes = []
    if facts_of(dem.product).family == "unknown":
        notes.append("the product is not known: its accuracy and latitudes of use are unknown")
    if label is not None and label.image_name and label.image_name.lower() != dem.path.name.lower():
        notes.append(
            f"the label names its image {label.image_name}, the file is called {dem.path.name}"
        )
    return notes


def _heights(dem: Dem, survey: SampleStatistics) -> list[str]:
    """Problems of the pixels alone."""
    if dem.too_small:
        return [dem.too_small]
    if survey.lowest is None or survey.highest is None:
        return ["every pixel is missing; fetch the file again"]
    if survey.looks_swapped:
        return [
            "its samples are plausible heights only with swapped bytes: the label's SAMPLE_TYPE is wrong, or the "
            "image was converted; take LSB for MSB (or MSB for LSB) in the label, or fetch the image again"
        ]
    if survey.lowest.value == survey.highest.value and survey.zero_rows == dem.grid.height:
        return [ALL_ZERO]
    signs = [extreme for extreme in (survey.lowest, survey.highest) if _is_a_sign(dem, extreme)]
    problems = [
        f"the value {extreme.value:g} occurs in {extreme.count} pixels ({100.0 * extreme.count / survey.pixels:.2f} %), "
        f"{_apart(dem, extreme)}, and is not declared as missing; declare it (MISSING_CONSTANT in the label, nodata in a GeoTIFF)"
        for extreme in signs
    ]
    explained = sum(e.count for e in signs if abs(_metres(dem, e.value)) > POSSIBLE_M)
    if survey.impossible_at is not None and survey.impossible > explained:
        row, column, height = survey.impossible_at
        problems.append(
            f"{survey.impossible} heights lie beyond {POSSIBLE_M:.0f} m, the first at row {row}, column {column} "
            f"({height:g} m): its scale or unit is wrong, or the file is damaged"
        )
    return problems


def _metres(dem: Dem, sample: float) -> float:
    return sample * dem.raster.scale_m + dem.raster.offset_m


def _is_a_sign(dem: Dem, extreme: Extreme) -> bool:
    """True for a code of missing data: far from all other values, and repeated or impossible."""
    far = extreme.gap * dem.raster.scale_m >= _APART_M and math.isfinite(extreme.gap)
    return far and (extreme.count >= _REPEATED or abs(_metres(dem, extreme.value)) > POSSIBLE_M)


def _apart(dem: Dem, extreme: Extreme) -> str:
    return f"{extreme.gap * dem.raster.scale_m:.0f} m from all others"


def _stripes(survey: SampleStatistics) -> list[str]:
    stripes = [
        f"{n} {what}"
        for n, what in ((survey.zero_rows, "rows"), (survey.zero_columns, "columns"))
        if n
    ]
    if not stripes:
        return []
    return [f"{' and '.join(stripes)} hold only zeros: possibly undeclared missing data"]


def _extremes(dem: Dem, label: Label, survey: SampleStatistics) -> list[str]:
    """Compare MINIMUM and MAXIMUM with the pixels, as samples or as metres (the archive writes
    samples)..
    """
    problems = []
    step = extremes_step(dem.raster, label)
    for key, said, found in (
        ("MINIMUM", label.declared.minimum, survey.lowest),
        ("MAXIMUM", label.declared.maximum, survey.highest),
    ):
        if said is None or found is None:
            continue
        away = min(abs(said / scale - found.value) for scale in (1.0, dem.raster.scale_m))
        if away > step:
            problems.append(
                f"states {key} {said:g} where the pixels of {dem.path.name} have {found.value:g}; {_AGAIN}"
            )
    return problems


def _sums(dem: Dem, label: Label, survey: SampleStatistics) -> list[str]:
    """Compare the MD5 sum of the image (of the pixels alone if the label is attached) and the sum
    of its samples.
    """
    problems, declared = [], label.declared
    if declared.md5 is not None:
        digest = _md5(dem.path, label.image_offset_bytes if label.image_name == "" else 0)
        if digest != declared.md5:
            problems.append(
                f"states the MD5 sum {declared.md5}, {dem.path.name} has {digest}; {_AGAIN}"
            )
    there = survey.sample_sum
    if declared.checksum is not None and there is not None and declared.checksum % 2**32 != there:
        problems.append(
            f"states the CHECKSUM {declared.checksum}, the samples add up to {there}; {_AGAIN}"
        )
    return problems


def _md5(path: Path, start: int) -> str:
    digest = hashlib.md5(usedforsecurity=False)
    with path.open("rb") as file:
        file.seek(start)
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _map(dem: Dem, label: Label, grid: Grid) -> list[str]:
    """Compare the label's grid with that of the GeoTIFF that it describes."""
    if not is_geotiff(dem.path):
        return []
    column, row = dem.grid.pixel(*grid.lonlat(0.0, 0.0))
    away = math.hypot(float(column), float(row))
    same = grid.pole == dem.grid.pole and abs(grid.pixel_m / dem.grid.pixel_m - 1.0) <= 1e-4
    if same and away <= 1.0:
        return []
    where = f"{away:.1f} pixels away from where {dem.path.name} has it"
    return [f"puts the north-west pixel {where}; {_AGAIN}"]
