"""Goniophotometer measurements from a CSV file: reflected light by direction for each angle of
incidence.

One header line, then one line for each measurement; lines that begin with ``#`` are comments.
Columns, in any order: ``incidence_deg`` (0..90); ``emission_deg``, signed in the plane of
incidence: positive on the side of the source, the specular direction at -incidence (the paper's
sign); optionally ``azimuth_deg`` (-180..180, default 0) of a direction out of that plane, counted
from the source; and one of

- ``intensity``: luminous or radiant intensity, in any unit (Lambert: proportional to the cosine of emission);
- ``brightness``: brightness coefficient or radiance, in any unit (Lambert: constant);
- ``radiance_factor``: I/F = pi L / E, absolute, E perpendicular to the source (Lambert: A cos(incidence)).

The separator is a comma, a semicolon or a tab; with the last two, a decimal comma is accepted.
"""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import MeasurementError

QUANTITIES = ("intensity", "brightness", "radiance_factor")
LEAST_POINTS = 7
"""One more than the number of the model's parameters."""

_RANGES = {
    "incidence_deg": (0.0, 89.9),
    "emission_deg": (-89.9, 89.9),
    "azimuth_deg": (-180.0, 180.0),
}
_SEPARATORS = ";\t,"
_LEVEL_DEG = 0.5
"""Greatest distance from the plane of incidence of a direction that counts as in it."""
_GAP_DEG = 20.0
"""Greatest gap across which values are interpolated."""


@dataclass(frozen=True, eq=False)
class IncidenceSeries:
    """Measurements of one incidence: signed emission, azimuth (degrees) and intensity divided by
    ``level``, (n,) each.
    """

    incidence_deg: float
    emission_deg: Array
    azimuth_deg: Array
    intensity: Array
    level: float = 1.0

    def __len__(self) -> int:
        return len(self.intensity)

    def scaled(self) -> IncidenceSeries:
        """The same relative to the intensity in the specular direction. MeasurementError if it was
        not measured on both sides of that direction, or is 0.
        """
        value = self.in_plane(-self.incidence_deg)
        if value is None or not value > 0.0:
            raise MeasurementError(
                f"incidence {self.incidence_deg:g} deg: no intensity around the specular direction, emission "
                f"{-self.incidence_deg:g}; measure there, or use `normalize` none"
            )
        return replace(self, intensity=self.intensity / value, level=self.level * value)

    def in_plane(self, emission_deg: float) -> float | None:
        """Intensity in a direction of the plane of incidence, linear between its neighbours; None
        without close neighbours.
        """
        emission, values = self.level_values()
        k = int(np.searchsorted(emission, emission_deg))
        if k < len(emission) and emission[k] == emission_deg:
            return float(values[emission == emission_deg].mean())
        if k in (0, len(emission)) or emission[k] - emission[k - 1] > _GAP_DEG:
            return None
        return float(np.interp(emission_deg, emission[k - 1 : k + 1], values[k - 1 : k + 1]))

    def level_values(self) -> tuple[Array, Array]:
        """Signed emissions, increasing, and intensities of the measurements in the plane of
        incidence.
        """
        front = np.abs(self.azimuth_deg) <= _LEVEL_DEG
        back = np.abs(np.abs(self.azimuth_deg) - 180.0) <= _LEVEL_DEG
        emission = np.where(back, -self.emission_deg, self.emission_deg)[front | back]
        order = np.argsort(emission, kind="stable")
        return emission[order], self.intensity[front | back][order]


@dataclass(frozen=True, eq=False)
class Measurements:
    """A file: one sample for each incidence, increasing; the measured quantity; the file's name and
    checksum.
    """

    samples: tuple[IncidenceSeries, ...]
    quantity: str
    name: str
    sha256: str

    @property
    def largest_emission_deg(self) -> float:
        """Greatest measured emission angle."""
        return max(float(np.abs(sample.emission_deg).max()) for sample in self.samples)

    @property
    def absolute(self) -> bool:
        return self.quantity == "radiance_factor"


def read_measurements(path: Path | str) -> Measurements:
    """Read and check a CSV file. The message of a MeasurementError is one line with the file and
    the line number.
    """
    try:
        raw = Path(path).read_bytes()
        text = raw.decode("utf-8-sig")
    except OSError as error:
        raise MeasurementError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise MeasurementError(f"{path}: not a text file in UTF-8") from error
    try:
        quantity, rows = _table(text)
        samples = tuple(_samples(quantity, rows))
    except MeasurementError as error:
        raise MeasurementError(f"{path}: {error}") from error
    return Measurements(samples, quantity, Path(path).name, hashlib.sha256(raw).hexdigest())


def _table(text: str) -> tuple[str, Array]:
    """The measured quantity, and rows (n, 4): incidence, emission, azimuth, value."""
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise MeasurementError("the file is empty; the first line must name the columns")
    separator = max(_SEPARATORS, key=lines[0][1].count)
    header = [name.strip().lower() for name in _cells(lines[0][1], separator)]
    columns, quantity = _columns(header)
    rows = [_row(number, line, separator, len(header), columns) for number, line in lines[1:]]
    if not rows:
        raise MeasurementError("no measurements below the header")
    return quantity, np.array(rows)


def _columns(header: list[str]) -> tuple[dict[str, int], str]:
    """Position of each required column and of the azimuth, if it exists; and the measured quantity."""
    for name in ("incidence_deg", "emission_deg"):
        if name not in header:
            raise MeasurementError(f"no column {name}; the columns are {', '.join(header)}")
    found = [name for name in QUANTITIES if name in header]
    if len(found) != 1:
        said = f"both {found[0]} and {found[1]}" if found else f"none ({', '.join(header)})"
        raise MeasurementError(
            f"one column of {', '.join(QUANTITIES)} is needed; the file has {said}"
        )
    twice = [name for name in (*_RANGES, *found) if header.count(name) > 1]
    if twice:
        raise MeasurementError(f"column {twice[0]} appears twice")
    wanted = [name for name in (*_RANGES, *found) if name in header]
    return {name: header.index(name) for name in wanted}, found[0]


def _row(
    number: int, line: str, separator: str, width: int, columns: dict[str, int]
) -> tuple[float, ...]:
    cells = _cells(line, separator)
    if len(cells) != width:
        raise MeasurementError(f"line {number} has {len(cells)} values; the header names {width}")
    values = {}
    for name, place in columns.items():
        cell = cells[place].strip()
        try:
            values[name] = float(cell.replace(",", ".") if separator != "," else cell)
        except ValueError:
            raise MeasurementError(f"line {number}: {name} is not a number: {cell!r}") from None
        low, high = _RANGES.get(name, (0.0, math.inf))
        if not low <= values[name] <= high or math.isinf(values[name]):
            limits = f"{low:g}..{high:g}" if high < math.inf else "0 or more, and finite"
            raise MeasurementError(f"line {number}: {name} {cell} is not within {limits}")
    return (
        values.pop("incidence_deg"),
        values.pop("emission_deg"),
        values.pop("azimuth_deg", 0.0),
        *values.values(),
    )


def _cells(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator))


def _samples(quantity: str, rows: Array) -> Iterator[IncidenceSeries]:
    """Samples by increasing incidence, as intensities."""
    for incidence in np.unique(rows[:, 0]):
        _, emission, azimuth, values = rows[rows[:, 0] == incidence].T
        if len(values) < LEAST_POINTS:
            raise MeasurementError(
                f"incidence {incidence:g} deg has {len(values)} measurements; a fit of six parameters needs {LEAST_POINTS}"
            )
        if not values.any():
            raise MeasurementError(f"incidence {incidence:g} deg: every value is 0")
        if quantity != "intensity":
            values = values * np.cos(np.radians(emission))
        if quantity == "radiance_factor":
            values = values / math.cos(math.radians(incidence))
        yield IncidenceSeries(float(incidence), emission, azimuth, values)
