"""Copies of products, damaged on purpose, and the one thing that ``check_dem`` says of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from lcp_catalog.dem.file_check import check_dem


def edit(path: Path, change: Callable[[str], str]) -> None:
    text = path.read_bytes().decode("latin-1")
    changed = change(text)
    assert changed != text
    path.write_bytes(changed.encode("latin-1"))


def substitute(path: Path, old: str, new: str) -> None:
    """The first of the label's places that hold ``old``."""
    edit(path, lambda text: text.replace(old, new, 1))


def set_samples(
    image: Path, dtype: str, change: Callable[[np.ndarray], None], skip: int = 0
) -> None:
    data = image.read_bytes()
    samples = np.frombuffer(data[skip:], dtype).copy().reshape(60, 72)
    change(samples)
    image.write_bytes(data[:skip] + samples.tobytes())


def only_problem(path: Path) -> str:
    verdict = check_dem(path)
    assert len(verdict.problems) == 1, verdict
    assert not verdict.sound
    assert str(path.parent) in verdict.problems[0]
    assert "\n" not in verdict.problems[0]
    return verdict.problems[0]
