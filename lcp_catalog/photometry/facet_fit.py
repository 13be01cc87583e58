"""Fit of the facet model to measurements: each incidence alone, then all of them with smooth curves
over cos(incidence).

After Labunets, Borzov, Akhmetov 2019 (see `facet_model`): first Nelder-Mead on the relative error,
eq. (4), at every incidence. Then, for one parameter after the other, Nelder-Mead over its nodes on
D = D1 + C D2: the relative growth of the errors, and the relative change in length of the curves
(shape-preserving cubics, constant beyond the nodes; angles in degrees), eq. (6).

The starting points are not from the paper: over a grid of the four nonlinear parameters, the two
weights follow by least squares, and the best points are refined. There are no random numbers: the
same measurements give the same model. The slopes of the cubics come from the kernels: scipy's
`PchipInterpolator` gives the same slopes to 1e-15, but takes 200 times as long per curve.

Polar charts of a fit of the facet model in the plane of incidence (figure 6 of the paper).

Angles are the paper's theta, positive on the side of the source. The source is on the upper left
and the specular direction on the right.

Goniophotometer measurements from a CSV file: reflected light by direction for each angle of
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
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize, nnls

from .._version import __version__
from ..arrays import Array
from ..errors import MeasurementError
from ..kernels.photometry import facet as kernel
from ..plots.axes import Curve, Panel, polar_chart
from ..stages import Progress, unseen
from .facet_model import (
    ALBEDO,
    LIMITS,
    PARAMETERS,
    FacetModel,
    Node,
    Optics,
    Shadowing,
    constants,
    lobes,
    nodes_table,
)

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


WEIGHT = 2.0
"""C of the paper: a weak preference (on Saaty's scale) for smooth curves."""
INTERVALS = 100
"""N of the paper: intervals over 0 <= cos(incidence) <= 1."""

BOUNDS = {
    "w_b": (0.0, 1e3),
    "shift_b_deg": (-30.0, 60.0),
    "sigma_b": (0.02, 20.0),
    "w_d": (0.0, 1e3),
    "shift_d_deg": (-30.0, 30.0),
    "sigma_d": (0.2, 5.0),
}
"""Bounds of the fit; within `facet_model.LIMITS`."""

_STARTS = {
    "shift_b_deg": (0.0, 10.0, 25.0, 45.0),
    "sigma_b": (0.05, 0.1, 0.2, 0.4, 1.0, 3.0),
    "shift_d_deg": (-8.0, 0.0, 8.0),
    "sigma_d": (0.8, 1.0, 1.25),
}
_REFINED = 3
"""Number of starting points that are refined. For 88 noisy incidences, one starting point alone
misses the minimum in 4, by up to 60 % of the error; three find the minimum of five in all of them.
"""
_STEPS = np.array([0.2, 3.0, 0.05, 0.1, 2.0, 0.05])
"""First simplex of the fit of an incidence: w_b and w_d relative, the others absolute."""
_SWEEPS = 10
_GAIN = 1e-3
"""Least gain in D of a sweep over the six curves; after a smaller gain the fit ends."""


@dataclass(frozen=True)
class Fit:
    """A fitted model with its errors, eq. (4), as shares, one for each incidence: of the nodes
    fitted alone, and of the smooth curves; D1 and D2 compare the two.
    """

    model: FacetModel
    alone: tuple[Node, ...]
    errors_alone: tuple[float, ...]
    errors: tuple[float, ...]
    d1: float
    d2: float
    weight: float
    sweeps: int
    normalized: bool

    @property
    def d(self) -> float:
        """D1 + C D2; 0 or less."""
        return self.d1 + self.weight * self.d2


@dataclass(frozen=True)
class _FitTask:
    """Samples, and the constants of the model (`facet_model.constants`) that the fit keeps."""

    samples: tuple[IncidenceSeries, ...]
    head: Array

    @cached_property
    def directions(self) -> list[Array]:
        """Cosine and sine of emission, then of azimuth, (n, 4) for each sample."""
        angles = [np.radians([s.emission_deg, s.azimuth_deg]) for s in self.samples]
        return [np.stack([np.cos(t), np.sin(t), np.cos(p), np.sin(p)], axis=1) for t, p in angles]

    def error(self, which: int, parameters: Sequence[float]) -> float:
        """Eq. (4) of one sample; parameters as in a `Node`."""
        w_b, shift_b, sigma_b, w_d, shift_d, sigma_d = parameters
        row = (w_b, math.radians(shift_b), sigma_b, w_d, math.radians(shift_d), sigma_d)
        sample = self.samples[which]
        psi = math.radians(sample.incidence_deg)
        found = kernel.misfit(self.head, row, psi, self.directions[which], sample.intensity)
        return float(found)

    def errors(self, table: Array) -> Array:
        """Eq. (4) of every sample; table (n, 6)."""
        return np.array([self.error(j, row) for j, row in enumerate(table.tolist())])

    @cached_property
    def cosines(self) -> Array:
        """Cosines of the incidences, (n,), in the order of the samples (decreasing)."""
        return np.cos(np.radians([sample.incidence_deg for sample in self.samples]))


def fit_reflectance(
    measurements: Measurements,
    name: str,
    *,
    weight: float = WEIGHT,
    optics: Optics | None = None,
    albedo: float = ALBEDO,
    normalize: bool = True,
    progress: Progress | None = None,
) -> Fit:
    """Fit a model to measurements.

    Relative measurements are divided by the value in the specular direction of their incidence
    (``normalize``), and ``albedo`` sets the brightness of the model. Absolute measurements (I/F)
    set the brightness themselves. ``weight``: C. ``progress``: called with the steps done and their
    total. MeasurementError if an incidence has no measurement around its specular direction.
    """
    optics, shadowing = optics or Optics(), Shadowing()
    report = progress or unseen
    taken = tuple(s.scaled() for s in measurements.samples) if normalize else measurements.samples
    task = _FitTask(taken, constants(optics, shadowing))
    total = len(taken) + _SWEEPS * len(PARAMETERS)
    rows = []
    for j in range(len(taken)):
        rows.append(fit_sample(task, j))
        report(j + 1, total)
    alone = np.array(rows)
    smooth, sweeps = regularise(task, alone, weight, lambda done: report(len(taken) + done, total))
    report(total, total)
    nodes = _nodes(taken, smooth)
    levels = tuple(s.level for s in taken) if measurements.absolute else None
    held = min(max(measurements.largest_emission_deg, 5.0), 89.0)
    model = FacetModel(name, nodes, optics, shadowing, held, albedo, levels)
    before, after = task.errors(alone), task.errors(smooth)
    return Fit(
        model,
        _nodes(taken, alone),
        tuple(before.tolist()),
        tuple(after.tolist()),
        d1(after, before),
        d2(task.cosines, smooth, alone),
        weight,
        sweeps,
        normalize,
    )


def fit_table(fit: Fit, measurements: Measurements) -> dict[str, Any]:
    """Data of a fit beside its model, as plain TOML or JSON."""
    return {
        "software": f"lcp {__version__}",
        "source": measurements.name,
        "sha256": measurements.sha256,
        "quantity": measurements.quantity,
        "normalized": fit.normalized,
        "points": [len(sample) for sample in measurements.samples],
        "errors": list(fit.errors),
        "errors_alone": list(fit.errors_alone),
        "c": fit.weight,
        "d1": fit.d1,
        "d2": fit.d2,
        "d": fit.d,
        "sweeps": fit.sweeps,
        "alone": nodes_table(fit.alone),
    }


def fit_sample(task: _FitTask, which: int) -> Array:
    """The six parameters of one incidence fitted alone, (6,)."""
    found = [_refined(task, which, start) for start in _starts(task, which)]
    return min(found, key=lambda row: task.error(which, row.tolist()))


def d1(errors: Array, before: Array) -> float:
    """Relative growth of the sum of the errors."""
    return float((errors - before).sum()) / _whole(before)


def d2(cosines: Array, table: Array, before: Array) -> float:
    """Relative change of the curves' lengths, summed over the parameters; tables (n, 6), angles in
    degrees.
    """
    return sum(
        curve_length(cosines, new) / curve_length(cosines, old) - 1.0
        for new, old in zip(table.T, before.T, strict=True)
    )


def curve_length(cosines: Array, values: Array) -> float:
    """Length of a parameter's curve, eq. (6), over decreasing cosines of incidence; (n,) both."""
    return float(kernel.curve_length(cosines[::-1], values[::-1], INTERVALS))


def regularise(
    task: _FitTask, alone: Array, weight: float, report: Callable[[int], None] = lambda done: None
) -> tuple[Array, int]:
    """Smooth curves (n, 6) through the parameters of incidences fitted alone, and the number of
    sweeps.
    """
    table, before = alone.copy(), task.errors(alone)
    if len(alone) < 2 or weight <= 0.0:
        return table, 0
    lengths = [curve_length(task.cosines, column) for column in alone.T]
    reached = 0.0
    for sweep in range(_SWEEPS):
        for k in range(len(PARAMETERS)):
            table[:, k] = _smoothed(task, table, k, before, weight, lengths)
            report(sweep * len(PARAMETERS) + k + 1)
        gained = d1(task.errors(table), before) + weight * d2(task.cosines, table, alone)
        if reached - gained < _GAIN:
            return table, sweep + 1
        reached = gained
    return table, _SWEEPS


def _smoothed(
    task: _FitTask, table: Array, k: int, before: Array, weight: float, lengths: list[float]
) -> Array:
    """Nodes of parameter k that minimise D, with the other parameters fixed."""
    others, total, cosines = table.copy(), _whole(before), task.cosines

    def loss(column: Array) -> float:
        others[:, k] = column
        length = curve_length(cosines, column) / lengths[k]
        return float(task.errors(others).sum()) / total + weight * length

    start = table[:, k].copy()
    low, high = BOUNDS[PARAMETERS[k]]
    spread = max(float(np.ptp(start)) / 4.0, 0.05 * float(np.abs(start).max()), 0.01)
    return _nelder_mead(loss, start, np.full(len(start), spread), [(low, high)] * len(start))


def _whole(errors: Array) -> float:
    """Sum of errors, with a small floor for exact fits."""
    return max(float(errors.sum()), 1e-9 * len(errors))


def _starts(task: _FitTask, which: int) -> list[Array]:
    """Best points of the grid, with weights by non-negative least squares."""
    sample = task.samples[which]
    data = sample.intensity

    def shape(**values: float) -> Array:
        node = Node(sample.incidence_deg, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0)._replace(**values)
        return lobes(node, task.head, sample.emission_deg, sample.azimuth_deg)

    directional_lobes = [
        ((shift, sigma), shape(w_b=1.0, shift_b_deg=shift, sigma_b=sigma))
        for shift, sigma in itertools.product(_STARTS["shift_b_deg"], _STARTS["sigma_b"])
    ]
    diffuse_lobes = [
        ((shift, sigma), shape(w_d=1.0, shift_d_deg=shift, sigma_d=sigma))
        for shift, sigma in itertools.product(_STARTS["shift_d_deg"], _STARTS["sigma_d"])
    ]
    found = []
    for (shift_b, sigma_b), directional in directional_lobes:
        for (shift_d, sigma_d), diffuse in diffuse_lobes:
            (w_b, w_d), _ = nnls(np.column_stack([directional, diffuse]), data)
            missed = w_b * directional + w_d * diffuse - data
            row = np.array([w_b, shift_b, sigma_b, w_d, shift_d, sigma_d])
            found.append((float(missed @ missed), row))
    found.sort(key=lambda pair: pair[0])
    return [row for _, row in found[:_REFINED]]


def _refined(task: _FitTask, which: int, start: Array) -> Array:
    steps = _STEPS.copy()
    steps[[0, 3]] *= np.maximum(start[[0, 3]], 0.1)

    def loss(row: Array) -> float:
        return task.error(which, row.tolist())

    return _nelder_mead(loss, start, steps, list(BOUNDS.values()))


def _nelder_mead(
    loss: Callable[[Array], float],
    start: Array,
    steps: Array,
    bounds: list[tuple[float, float]],
) -> Array:
    low, high = np.array(bounds).T
    first = np.clip(start, low, high)
    corners = np.vstack([first, first + np.diag(np.where(first + steps > high, -steps, steps))])
    found = minimize(
        loss,
        first,
        method="Nelder-Mead",
        bounds=bounds,
        options={
            "initial_simplex": corners,
            "maxfev": 400 * len(start),
            "xatol": 1e-5,
            "fatol": 1e-8,
            "adaptive": len(start) > 6,
        },
    )
    return np.asarray(found.x, dtype=np.float64)


def _nodes(samples: Sequence[IncidenceSeries], table: Array) -> tuple[Node, ...]:
    """Rows as nodes, clipped to `facet_model.LIMITS`."""
    limits = np.array([LIMITS[name] for name in PARAMETERS])
    rows = np.clip(table, limits[:, 0], limits[:, 1]).tolist()
    return tuple(Node._make([s.incidence_deg, *row]) for s, row in zip(samples, rows, strict=True))


def fit_chart(fit: Fit, measurements: Measurements) -> str:
    """SVG of relative intensities, one panel for each incidence: the measurements in the plane of
    incidence, the model, and its two lobes.
    """
    panels = []
    for sample, node in zip(measurements.samples, fit.model.nodes, strict=True):
        emission, values = (sample.scaled() if fit.normalized else sample).level_values()
        dots = Curve(emission, values, "dots", "measured")
        curves, source = (dots, *lobe_curves(fit.model, node)), (node.incidence_deg, "source")
        panels.append(Panel(f"incidence {node.incidence_deg:g}°", curves, (source,)))
    return polar_chart(panels, f"{measurements.name}: relative intensity", 2)


def lobe_curves(model: FacetModel, node: Node) -> tuple[Curve, ...]:
    """Relative intensities of the diffuse lobe, the directional lobe, and both."""
    theta, head = np.linspace(-89.9, 89.9, 361), constants(model.optics, model.shadowing)
    both = lobes(node, head, theta)
    diffuse = lobes(node._replace(w_b=0.0), head, theta)
    return (
        Curve(theta, diffuse, "dashed", "diffuse lobe"),
        Curve(theta, both - diffuse, "thin", "directional lobe"),
        Curve(theta, both, "solid", "model"),
    )
