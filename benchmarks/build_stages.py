"""Time of an area by stage: public and private functions of the build are wrapped while it runs, and
every second counts for the innermost wrapped function.
"""

from __future__ import annotations

import importlib
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, wraps
from typing import Any

from build_areas import Package

STAGES: dict[str, tuple[str, ...]] = {
    "terrain": ("production.area_job:area_sweep", "build.area_job:_Core.__init__"),
    "corners": ("production.area_job:_find",),
    "heights of patches": (
        "production.area_job:_patches",
        "production.area_job:_place_errors",
        "production.area_job:_turns",
        "production.area_job:_known_alike",
        "production.area_job:_has_whole_patch",
    ),
    "shadows": (
        "production.sweep:Sweep._dark",
        "production.sweep:Sweep.dark",
        "production.sweep:Sweep._hidden",
    ),
    "shading": (
        "production.sweep:Sweep.shaded",
        "production.sweep:Sweep.normals",
        "production.sweep:Sweep.planes",
        "production.sweep:Sweep.steeper_planes",
        "photometry.laws:radiance_of_nodes",
        "photometry.laws:differences",
    ),
    "dependence": (
        "production.evaluation:_Patches._dependence",
        "production.patch_light:PatchLight.shadow_dependence",
        "production.patch_light:PatchLight.occlusion_dependence",
    ),
    "scales of the images, patches": (
        "landmarks.corners:fill_missing",
        "landmarks.patches:through_optics",
        "landmarks.patches:halved",
        "landmarks.patches:halved_changes",
        "landmarks.patches:patches_of",
        "landmarks.patches:gather_patches",
        "production.evaluation:_halved_change",
        "production.evaluation:_blurred_patches",
    ),
    "localization, detection": (
        "landmarks.localization:light_of",
        "landmarks.localization:lit_share",
        "landmarks.localization:mean_lit_level",
        "landmarks.detection:least_rival",
        "landmarks.localization:registration",
        "landmarks.localization:shift_bias",
        "landmarks.localization:harris_response",
        "landmarks.detection:detection_probability",
        "landmarks.detection:top_probability",
        "production.evaluation:_ellipse",
    ),
    "uniqueness": (
        "landmarks.uniqueness:SearchImages.of",
        "landmarks.uniqueness:other_places",
        "landmarks.uniqueness:places_around",
    ),
}
"""Functions of each stage, ``module:name``; names that a package does not have are left out, so that
the table holds for faf736b (`_Patches`, `gather_patches`, `shift_bias`, `lit_share`, ...) and for today's package."""

PIPELINE_STAGES: dict[str, tuple[str, ...]] = {
    "terrain": ("build_pipeline:Pipeline.__init__",),
    "corners": ("build_pipeline:Pipeline.corners",),
    "heights of patches": (),
    "shadows": ("build_pipeline:Pipeline.hidden", "build_pipeline:Surface.__init__"),
    "shading": ("build_pipeline:Shader.radiance",),
    "dependence": ("build_pipeline:Pipeline.dependence",),
    "scales of the images, patches": (
        "build_pipeline:filled",
        "build_pipeline:blurred",
        "build_pipeline:halved",
        "build_pipeline:halved_change",
        "build_pipeline_match:windows",
    ),
    "localization, detection": (
        "build_pipeline_match:registered",
        "build_pipeline_match:probabilities",
        "build_pipeline:correlation",
        "build_pipeline:sigma_major",
    ),
    "uniqueness": ("build_pipeline_match:search",),
}
"""The same stages of the straightforward pipeline."""

REST = "rest"


class Clock:
    """Seconds by stage; the time of a nested stage does not count for the outer one."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._stack = [REST]
        self._since = time.process_time()

    def _turn(self) -> None:
        now = time.process_time()
        self.seconds[self._stack[-1]] += now - self._since
        self._since = now

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its time counted for the stage."""

        @wraps(function)
        def inside(*args: Any, **kwargs: Any) -> Any:
            self._turn()
            self._stack.append(stage)
            try:
                return function(*args, **kwargs)
            finally:
                self._turn()
                self._stack.pop()

        return inside

    def stop(self) -> dict[str, float]:
        """Seconds of every stage of the table, in its order, and of the rest."""
        self._turn()
        return {stage: self.seconds.get(stage, 0.0) for stage in (*STAGES, REST)}


class Scripts:
    """The modules of the pipeline, in the place of a package."""

    def module(self, path: str) -> Any:
        """A module of this folder."""
        return importlib.import_module(path)

    def modules(self) -> list[Any]:
        """All modules in which a function can be held."""
        return [self.module(path) for path in ("build_pipeline", "build_pipeline_match")]


@contextmanager
def measured(package: Package | Scripts) -> Iterator[Clock]:
    """A clock that counts while the block runs. The kernels must have been compiled before."""
    clock = Clock()
    undo: list[Callable[[], None]] = []
    table = PIPELINE_STAGES if isinstance(package, Scripts) else STAGES
    for stage, names in table.items():
        for name in names:
            undo += wrapped(package, name, clock, stage)
    clock._turn()
    clock.seconds.clear()
    try:
        yield clock
    finally:
        for back in reversed(undo):
            back()


def wrapped(
    package: Package | Scripts, name: str, clock: Clock, stage: str
) -> list[Callable[[], None]]:
    """Wrap a function wherever the package's modules hold it; the calls that undo it."""
    path, _, attribute = name.partition(":")
    try:
        owner = package.module(path)
    except ModuleNotFoundError:
        return []
    *classes, last = attribute.split(".")
    for part in classes:
        owner = getattr(owner, part, None)
    found = vars(owner).get(last) if owner is not None else None
    if found is None:
        return []
    if isinstance(found, cached_property):
        return [_set(found, "func", clock.timed(stage, found.func))]
    if isinstance(found, classmethod):
        return [_set(owner, last, classmethod(clock.timed(stage, found.__func__)))]
    if classes:
        return [_set(owner, last, clock.timed(stage, found))]
    inside = clock.timed(stage, found)
    return [
        _set(module, key, inside)
        for module in package.modules()
        for key, value in list(vars(module).items())
        if value is found
    ]


def _set(owner: Any, name: str, value: Any) -> Callable[[], None]:
    before = getattr(owner, name) if not isinstance(owner, type) else vars(owner)[name]
    setattr(owner, name, value)
    return lambda: setattr(owner, name, before)
