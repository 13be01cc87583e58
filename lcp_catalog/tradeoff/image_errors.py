"""Images of one area in every tier: their time, their errors against ``reference``, and a section
to show.

Comparison of reflectance models on the images of one area: time, and correlation of windows with
those of `LAWS_BY_COST[-1]`.

Navigation correlates windows of a render and an image with free gain and offset. The cost of a
simpler model is therefore the loss of correlation of its windows with those of the most complete
model, on this terrain with its shadows.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Mask
from ..choices import LAWS_BY_COST
from ..photometry.laws import reflectance_model
from ..production.area_job import AreaJob, area_sweep
from ..production.sweep import Conditions, RenderedImage, Sweep
from ..threads import limit_threads
from ..validation.ground_comparison import compare

REFERENCE = "reference"

EDGE_NODES = 2
"""Largest distance in nodes from an edge of a shadow in the reference at which a wrong node counts
as at the edge.
"""

PICTURE_NODES = 160
"""Longest side of the section of an area that is shown, nodes."""


@dataclass
class ImageChanges:
    """Sums over the images of one tier compared with the reference; additive over areas."""

    seconds: float = 0.0
    judged: int = 0  # (node, Sun) pairs
    wrong: int = 0
    near_edge: int = 0
    looked: int = 0  # (node, view) pairs
    misseen: int = 0
    shared: int = 0  # nodes of all images that are visible in both
    squares: float = 0.0
    radiance: float = 0.0  # of the reference, summed over the same nodes

    def add(self, other: ImageChanges) -> None:
        for f in dataclasses.fields(self):
            setattr(self, f.name, getattr(self, f.name) + getattr(other, f.name))

    @property
    def sunlit_error_share(self) -> float:
        return self.wrong / max(self.judged, 1)

    @property
    def near_edge_share(self) -> float | None:
        return self.near_edge / self.wrong if self.wrong else None

    @property
    def visible_error_share(self) -> float:
        return self.misseen / max(self.looked, 1)

    @property
    def radiance_rmse(self) -> float:
        """Root mean square difference as a share of the mean radiance factor of the reference."""
        if not self.shared or not self.radiance:
            return 0.0
        return math.sqrt(self.squares / self.shared) / (self.radiance / self.shared)


@dataclass(frozen=True)
class ErrorPicture:
    """Section of an area under one low Sun: lit nodes of the reference, and the differences of each
    tier.

    lit: int8 (rows, cols), 1 lit, 0 dark, -1 without terrain; wrong[tier]: int8, +1 lit where the
    reference is dark, -1 dark where it is lit.
    """

    area: str
    sun_azimuth_deg: float
    sun_elevation_deg: float
    lit: NDArray[np.int8]
    wrong: dict[str, NDArray[np.int8]]
    wrong_nodes: int


def compare_images(jobs: dict[str, AreaJob]) -> tuple[dict[str, ImageChanges], ErrorPicture | None]:
    """Compare the images of one area in every tier: time on one thread, differences from
    ``reference``, and a section to show.

    jobs: the same area by tier. All nodes of the area's window with its margin are compared;
    shadows in the view from the zenith.
    """
    with limit_threads(1):
        sweeps = _sweeps(jobs)
        changes = {tier: ImageChanges() for tier in sweeps}
        for sweep in sweeps.values():  # loads kernels and makes pyramids before the timing
            next(dataclasses.replace(sweep).images(), None)
        shown = _Shown(next(iter(jobs.values())).task.name)
        above = int(np.argmin(next(iter(sweeps.values())).conditions.off_nadir_deg))
        for images in _side_by_side(sweeps, changes):
            if images[REFERENCE].view == above:
                _judge_light(images, changes)
                shown.look(images, sweeps[REFERENCE].conditions)
            if images[REFERENCE].view < len(jobs[REFERENCE].recipe.config.view):
                _judge_radiance(images, changes)
    for tier, sweep in sweeps.items():
        for view in range(len(sweep.view_directions)):
            hidden, exact = sweep.unseen(view), sweeps[REFERENCE].unseen(view)
            changes[tier].looked += exact.size
            changes[tier].misseen += int((hidden != exact).sum())
    return changes, shown.picture()


def _sweeps(jobs: dict[str, AreaJob]) -> dict[str, Sweep]:
    """The area's sweep in every tier over one terrain, with a view from the zenith added if the
    build has none.
    """
    job = jobs[REFERENCE]
    exact = area_sweep(job)
    conditions = exact.conditions
    if not (conditions.off_nadir_deg == 0.0).any():
        conditions = dataclasses.replace(
            conditions,
            off_nadir_deg=np.append(conditions.off_nadir_deg, 0.0),
            view_azimuth_deg=np.append(conditions.view_azimuth_deg, 0.0),
            view_altitude_km=np.append(conditions.view_altitude_km, np.inf),
        )
    return {
        tier: dataclasses.replace(
            exact, conditions=conditions, accuracy=tiered.recipe.config.model.precision
        )
        for tier, tiered in jobs.items()
    }


def _side_by_side(
    sweeps: dict[str, Sweep], changes: dict[str, ImageChanges]
) -> Iterator[dict[str, RenderedImage]]:
    """Each image in every tier; its processor time is added to the tier's seconds."""
    streams = {tier: sweep.images() for tier, sweep in sweeps.items()}
    while True:
        images = {}
        for tier, stream in streams.items():
            start = time.process_time()
            image = next(stream, None)
            changes[tier].seconds += time.process_time() - start
            if image is None:
                return
            images[tier] = image
        yield images


def judge(change: ImageChanges, ours: RenderedImage, exact: RenderedImage) -> None:
    """Add the differences of an image from another of the same nodes, Sun and view."""
    for judged in (_judge_light, _judge_radiance):
        judged({REFERENCE: exact, "": ours}, {REFERENCE: ImageChanges(), "": change})


def _judge_light(images: dict[str, RenderedImage], changes: dict[str, ImageChanges]) -> None:
    """Count the nodes that are lit in one image and dark in the other; views from the zenith, where
    only nodata is invisible.
    """
    exact = images[REFERENCE].radiance
    ground, lit = np.isfinite(exact), exact > 0.0
    for tier, image in images.items():
        wrong = ((image.radiance > 0.0) != lit) & ground
        changes[tier].judged += int(ground.sum())
        changes[tier].wrong += int(wrong.sum())
        changes[tier].near_edge += int(_at_edge(lit, ground, wrong).sum())


def _at_edge(lit: Mask, ground: Mask, nodes: Mask) -> Mask:
    """True (n,) for marked nodes with a node in the other state within `EDGE_NODES` rows and
    columns.
    """
    rows, cols = np.nonzero(nodes)
    found = np.zeros(len(rows), dtype=np.bool_)
    steps = range(-EDGE_NODES, EDGE_NODES + 1)
    for row_step in steps:
        for col_step in steps:
            r = np.clip(rows + row_step, 0, lit.shape[0] - 1)
            c = np.clip(cols + col_step, 0, lit.shape[1] - 1)
            found |= ground[r, c] & (lit[r, c] != lit[rows, cols])
    return found


def _judge_radiance(images: dict[str, RenderedImage], changes: dict[str, ImageChanges]) -> None:
    exact = images[REFERENCE].radiance
    for tier, image in images.items():
        both = np.isfinite(exact) & np.isfinite(image.radiance)
        ours, theirs = image.radiance[both].astype(np.float64), exact[both].astype(np.float64)
        changes[tier].shared += len(ours)
        changes[tier].squares += float(((ours - theirs) ** 2).sum())
        changes[tier].radiance += float(theirs.sum())


class _Shown:
    """Images of the lowest Sun with an error in any tier, and of those the ones with the most wrong
    nodes.
    """

    def __init__(self, area: str) -> None:
        self._area = area
        self._kept: tuple[float, float, dict[str, RenderedImage]] | None = None
        self._rank: tuple[bool, float, int] = (True, math.inf, 0)

    def look(self, images: dict[str, RenderedImage], conditions: Conditions) -> None:
        exact = images[REFERENCE]
        elevation = float(conditions.sun_elevation_deg[exact.elevation])
        wrong = sum(int(np.count_nonzero(_difference(i, exact))) for i in images.values())
        rank = (wrong == 0, elevation, -wrong)
        if rank < self._rank:
            azimuth = float(conditions.sun_azimuth_deg[exact.azimuth])
            self._rank, self._kept = rank, (azimuth, elevation, dict(images))

    def picture(self) -> ErrorPicture | None:
        if self._kept is None:
            return None
        azimuth, elevation, images = self._kept
        exact = images[REFERENCE]
        wrong = {t: _difference(i, exact) for t, i in images.items() if t != REFERENCE}
        lit = np.where(np.isfinite(exact.radiance), exact.radiance > 0.0, -1).astype(np.int8)
        section = _busiest(np.abs(np.stack(list(wrong.values()))).sum(axis=0, dtype=np.int64))
        return ErrorPicture(
            self._area,
            azimuth,
            elevation,
            lit[section],
            {t: w[section] for t, w in wrong.items()},
            -self._rank[2],
        )


def _difference(image: RenderedImage, exact: RenderedImage) -> NDArray[np.int8]:
    lit, wanted = image.radiance > 0.0, exact.radiance > 0.0
    return lit.astype(np.int8) - wanted.astype(np.int8)


def _busiest(counts: NDArray[np.int64]) -> tuple[slice, slice]:
    """The section of at most `PICTURE_NODES` a side with the largest sum."""
    sums = np.pad(counts.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    height, width = (min(PICTURE_NODES, side) for side in counts.shape)
    inside = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width]
    inside = inside + sums[:-height, :-width]
    row, col = (int(i) for i in np.unravel_index(np.argmax(inside), inside.shape))
    return slice(row, row + height), slice(col, col + width)


PHASES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 180.0)
"""Edges of the bins of phase angle."""

WINDOW = 32
"""Side of a window, nodes."""

CONTRAST = 1e-4
"""Least standard deviation of a window, as a share of its mean."""


@dataclass
class ModelChanges:
    """Correlations with the reference model by model and phase bin, and seconds of processor time by model, one of each
    area; additive over areas.
    """

    seconds: dict[str, list[float]] = field(
        default_factory=lambda: {law: [] for law in LAWS_BY_COST}
    )
    correlations: dict[tuple[str, int], list[Array]] = field(default_factory=dict)
    images: dict[int, int] = field(default_factory=dict)

    def add(self, other: ModelChanges) -> None:
        for law, seconds in other.seconds.items():
            self.seconds[law] += seconds
        for key, values in other.correlations.items():
            self.correlations.setdefault(key, []).extend(values)
        for phase, count in other.images.items():
            self.images[phase] = self.images.get(phase, 0) + count

    def rows(self) -> list[dict[str, Any]]:
        """One dictionary per model and phase bin that occurs, with statistics over the windows."""
        found = []
        for law in LAWS_BY_COST[:-1]:
            for phase in sorted(self.images):
                values = np.concatenate(self.correlations.get((law, phase), [np.empty(0)]))
                if not values.size:
                    continue
                found.append(
                    {
                        "reflectance": law,
                        "against": LAWS_BY_COST[-1],
                        "phase_deg": list(PHASES_DEG[phase : phase + 2]),
                        "images": self.images[phase],
                        "windows": int(values.size),
                        "correlation_median": float(np.median(values)),
                        "correlation_p05": float(np.percentile(values, 5)),
                        "share_above_0_9": float(np.mean(values > 0.9)),
                    }
                )
        return found

    def times(self) -> dict[str, tuple[float, float, float]]:
        """Time of all images with each model as a share of that with the reference model; least and greatest of an area."""
        exact = [max(one, 1e-12) for one in self.seconds[LAWS_BY_COST[-1]]] or [1e-12]
        found = {}
        for law, seconds in self.seconds.items():
            by_area = [own / whole for own, whole in zip(seconds, exact, strict=False)] or [0.0]
            found[law] = sum(seconds) / sum(exact), min(by_area), max(by_area)
        return found


def compare_models(job: AreaJob) -> ModelChanges:
    """Compare the images of an area with each of `LAWS_BY_COST`, on one thread, the models in turn
    for each image.
    """
    found = ModelChanges()
    with limit_threads(1):
        sweep = area_sweep(job)
        sweeps = {
            law: dataclasses.replace(sweep, model=reflectance_model(law)) for law in LAWS_BY_COST
        }
        for ready in sweeps.values():  # one-time work before the timing
            next(dataclasses.replace(ready).images(), None)
        streams = {law: ready.images() for law, ready in sweeps.items()}
        found.seconds = {law: [0.0] for law in LAWS_BY_COST}
        while True:
            images = {}
            for law, stream in streams.items():
                start = time.process_time()
                image = next(stream, None)
                found.seconds[law][0] += time.process_time() - start
                if image is None:
                    return found
                images[law] = image
            _correlate(sweep, images, found)


def _correlate(sweep: Sweep, images: dict[str, RenderedImage], found: ModelChanges) -> None:
    exact = images[LAWS_BY_COST[-1]]
    sun = sweep.sun_directions[exact.elevation, exact.azimuth]
    camera = sweep.view_directions[exact.view]
    phase_deg = math.degrees(math.acos(min(1.0, max(-1.0, float(sun @ camera)))))
    phase = int(np.searchsorted(PHASES_DEG, phase_deg, side="right")) - 1
    phase = min(phase, len(PHASES_DEG) - 2)
    found.images[phase] = found.images.get(phase, 0) + 1
    for law in LAWS_BY_COST[:-1]:
        values = window_correlations(images[law].radiance, exact.radiance)
        found.correlations.setdefault((law, phase), []).append(values)


def window_correlations(ours: NDArray[np.floating], theirs: NDArray[np.floating]) -> Array:
    """Centred normalised correlations (n,) of the windows whose nodes are all visible and that have
    contrast in ``theirs``; 0 for a window without contrast in ``ours``.
    """
    if min(ours.shape) < WINDOW:
        return np.empty(0)
    found = compare(ours, theirs, gsd_m=1.0, size=WINDOW, step=WINDOW, least_valid=1.0)
    corners = zip(found.row, found.col, strict=True)
    means = np.array([theirs[r : r + WINDOW, c : c + WINDOW].mean() for r, c in corners])
    return found.correlation[found.contrast > CONTRAST * means]
