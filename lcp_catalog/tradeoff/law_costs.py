"""Comparison of reflectance models on the images of one area: time, and correlation of windows with
those of `REFERENCE_LAW`.

Navigation correlates windows of a render and an image with free gain and offset. The cost of a
simpler model is therefore the loss of correlation of its windows with those of the most complete
model, on this terrain with its shadows.
"""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..choices import LAWS_BY_COST, REFERENCE_LAW
from ..photometry.laws import reflectance_model
from ..production.area_job import AreaJob, area_sweep
from ..production.sweep import RenderedImage, Sweep
from ..threads import limit_threads
from ..validation.window_correlation import compare

PHASES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 180.0)
"""Edges of the bins of phase angle."""

WINDOW = 32
"""Side of a window, nodes."""

CONTRAST = 1e-4
"""Least standard deviation of a window, as a share of its mean."""


@dataclass
class ModelChanges:
    """Correlations with the reference model by model and phase bin, and seconds by model; additive
    over areas.
    """

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(LAWS_BY_COST, 0.0))
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
                        "against": REFERENCE_LAW,
                        "phase_deg": list(PHASES_DEG[phase : phase + 2]),
                        "images": self.images[phase],
                        "windows": int(values.size),
                        "correlation_median": float(np.median(values)),
                        "correlation_p05": float(np.percentile(values, 5)),
                        "share_above_0_9": float(np.mean(values > 0.9)),
                    }
                )
        return found

    def times(self) -> dict[str, float]:
        """Time of all images with each model as a share of that with the reference model."""
        return {law: s / max(self.seconds[REFERENCE_LAW], 1e-12) for law, s in self.seconds.items()}


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
        while True:
            images = {}
            for law, stream in streams.items():
                start = time.perf_counter()
                image = next(stream, None)
                found.seconds[law] += time.perf_counter() - start
                if image is None:
                    return found
                images[law] = image
            _correlate(sweep, images, found)


def _correlate(sweep: Sweep, images: dict[str, RenderedImage], found: ModelChanges) -> None:
    exact = images[REFERENCE_LAW]
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
