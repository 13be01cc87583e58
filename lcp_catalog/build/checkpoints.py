"""Checkpoints: finished areas of a build, stored beside the output until the catalogue is written, so that
an interrupted run loses none of them.

A checkpoint is an .npz file in ``OUTPUT.parts/``; ``run.json`` there holds the fingerprint of the run.
The folder is removed when the catalogue has been written.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np

from ..atomic_files import write_aside
from ..errors import OutputExistsError
from ..rendering.plan import ScenePlan
from .area_job import AreaResult, Candidates

_PLAN = "scene_plan"


@dataclass(frozen=True)
class Checkpoints:
    """The checkpoints of one run."""

    folder: Path
    fingerprint: str

    @classmethod
    def beside(cls, output: Path, fingerprint: str) -> Checkpoints:
        """The checkpoints of an output file."""
        return cls(output.with_name(output.name + ".parts"), fingerprint)

    def begin(self, resume: bool) -> None:
        """Make the folder. Without ``resume`` remove older checkpoints; with it raise OutputExistsError for
        those of a run with other inputs.
        """
        note = self.folder / "run.json"
        if self.folder.exists() and not resume:
            shutil.rmtree(self.folder)
        if self.folder.exists() and note.exists():
            theirs = json.loads(note.read_text(encoding="utf-8")).get("fingerprint")
            if theirs != self.fingerprint:
                raise OutputExistsError(
                    f"{self.folder}: its finished areas are from a run with another configuration, DEM or version; "
                    "run without --resume to remove them"
                )
        self.folder.mkdir(exist_ok=True)
        with write_aside(note, overwrite=True) as path:
            path.write_text(json.dumps({"fingerprint": self.fingerprint}), encoding="utf-8")

    def path(self, name: str) -> Path:
        """The file of an area."""
        return self.folder / f"{name}.npz"

    def write(self, name: str, result: AreaResult) -> None:
        """Store a finished area."""
        with write_aside(self.path(name), overwrite=True) as path, path.open("wb") as stream:
            arrays: dict[str, Any] = _flatten("", result.candidates)
            arrays[_PLAN] = np.array(str(result.plan))
            np.savez(stream, **arrays)

    def read(self, name: str) -> AreaResult | None:
        """A finished area; None if there is none or its file is damaged (it is computed again)."""
        try:
            with np.load(self.path(name), allow_pickle=False) as arrays:
                plan = ScenePlan.from_json(json.loads(str(arrays[_PLAN])))
                return AreaResult(_unflatten("", Candidates, arrays), plan)
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None

    def remove(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _flatten(prefix: str, value: Any) -> dict[str, np.ndarray]:
    """Arrays of nested dataclasses by dotted name, without those that are None."""
    if value is None:
        return {}
    if not dataclasses.is_dataclass(value):
        return {prefix: value}
    found: dict[str, np.ndarray] = {}
    for field in dataclasses.fields(value):
        found |= _flatten(f"{prefix}.{field.name}".lstrip("."), getattr(value, field.name))
    return found


def _unflatten(prefix: str, kind: Any, arrays: Any) -> Any:
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        return arrays[prefix] if prefix in arrays or type(None) not in get_args(kind) else None
    hints = get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)]
    return kind(
        **{name: _unflatten(f"{prefix}.{name}".lstrip("."), hints[name], arrays) for name in names}
    )
