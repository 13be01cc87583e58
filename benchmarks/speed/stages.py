"""Processor time by stage: a profiler's hook notes which module's function runs; no function is replaced."""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import lcp_catalog
from benchmarks.places import ROOT

LIBRARY: dict[str, str] = {
    "dem": "terrain",
    "terrain.terrain": "terrain",
    "terrain.relief_bounds": "terrain",
    "terrain.far_terrain": "terrain",
    "landmarks.corners": "corners",
    "terrain.occlusion": "shadows",
    "terrain.heightfield": "shadows",
    "production.evaluation": "shadows",
    "photometry.laws": "shading",
    "production.sweep": "shading",
    "landmarks.patches": "scales of the images, patches",
    "landmarks.localization": "localization, detection",
    "landmarks.detection": "localization, detection",
    "landmarks.error_model": "localization, detection",
    "landmarks.uniqueness": "uniqueness",
}
"""Modules of the library (a package's name stands for all of its modules) and the stage of what they do, called from
wherever; a module that is not named counts for the stage that calls it."""
PIPELINE: dict[str, str] = {
    "pipeline:Pipeline.__init__": "terrain",
    "pipeline:Pipeline.corners": "corners",
    "pipeline:Pipeline.hidden": "shadows",
    "pipeline:Pipeline.dependence": "shadows",
    "pipeline:Surface.__init__": "shadows",
    "pipeline:Shader.radiance": "shading",
    "pipeline:filled": "scales of the images, patches",
    "pipeline:blurred": "scales of the images, patches",
    "pipeline:halved": "scales of the images, patches",
    "pipeline:halved_change": "scales of the images, patches",
    "pipeline_match:windows": "scales of the images, patches",
    "pipeline_match:registered": "localization, detection",
    "pipeline_match:probabilities": "localization, detection",
    "pipeline:correlation": "localization, detection",
    "pipeline:sigma_major": "localization, detection",
    "pipeline_match:search": "uniqueness",
    "strong:search": "uniqueness",
    "strong:probabilities": "localization, detection",
}
"""Functions of the pipelines, and their stages."""
REST = "rest"
STAGES = (*dict.fromkeys(LIBRARY.values()), REST)
_FOLDERS = (Path(lcp_catalog.__file__).parent, ROOT / "benchmarks" / "speed")


class Clock:
    """Seconds by stage; the time of a nested stage does not count for the outer one."""

    def __init__(self, stages: Mapping[str, str]) -> None:
        self.stages = stages
        self.seconds: dict[str, float] = defaultdict(float)
        self._stack = [REST]
        self._since = time.process_time()
        self._known: dict[CodeType, str | None] = {}

    def hook(self, frame: FrameType, event: str, _argument: Any) -> None:
        """A call or a return, as `sys.setprofile` tells it."""
        if event not in ("call", "return"):
            return
        stage = self._stage(frame.f_code)
        if stage is None:
            return
        now = time.process_time()
        self.seconds[self._stack[-1]] += now - self._since
        self._since = now
        if event == "call":
            self._stack.append(stage)
        elif len(self._stack) > 1:
            self._stack.pop()

    def stop(self) -> dict[str, float]:
        """Seconds by stage, up to now."""
        now = time.process_time()
        self.seconds[self._stack[-1]] += now - self._since
        self._since = now
        return self.seconds

    def _stage(self, code: CodeType) -> str | None:
        if code not in self._known:
            self._known[code] = self._found(Path(code.co_filename), code.co_qualname)
        return self._known[code]

    def _found(self, file: Path, function: str) -> str | None:
        folder = next((folder for folder in _FOLDERS if folder in file.parents), None)
        if folder is None:
            return None
        parts = file.relative_to(folder).with_suffix("").parts
        names = [".".join(parts[:n]) for n in range(len(parts), 0, -1)]
        return next(
            (self.stages[n] for n in (f"{names[0]}:{function}", *names) if n in self.stages), None
        )


@contextmanager
def measured(stages: Mapping[str, str]) -> Iterator[dict[str, float]]:
    """Seconds by stage of what runs in the block, in this thread; complete after it."""
    clock, found = Clock(stages), dict.fromkeys(STAGES, 0.0)
    sys.setprofile(clock.hook)
    try:
        yield found
    finally:
        sys.setprofile(None)
        found.update(clock.stop())
