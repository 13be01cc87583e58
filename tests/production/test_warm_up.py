"""Kernels compiled before they are called: the list, the pool of processes, other levels, and folders for others."""

from __future__ import annotations

import importlib
import logging
from dataclasses import replace
from pathlib import Path

import pytest
from numba.core.sigutils import normalize_signature

from lcp_catalog.errors import ConfigError, OutputError
from lcp_catalog.kernels import cache, entries
from lcp_catalog.kernels.cpu_level import LEVELS, level
from lcp_catalog.production import warm_up

SMALL = entries.Entry("vectors.multiple", "(int64, int64)", 0.1, ("build-catalog",))


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's folder; the list is one kernel."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))
    monkeypatch.delenv(cache.SHARED, raising=False)
    monkeypatch.setattr(warm_up, "entries", lambda *_: [SMALL])
    return tmp_path / "own" / "kernels" / cache.key()


def test_the_list_names_kernels_and_the_types_of_their_parameters() -> None:
    found = entries.entries()
    assert len({entry.file_name for entry in found}) == len(found) > 50
    for entry in found:
        module, _, name = entry.kernel.rpartition(".")
        kernel = getattr(importlib.import_module(f"lcp_catalog.kernels.{module}"), name)
        types = normalize_signature(entry.signature)[0]
        assert repr(tuple(types)) == entry.signature
        assert len(types) == kernel.py_func.__code__.co_argcount, entry.kernel
        assert entry.seconds > 0.0
    assert {"build-catalog", "render", "validate"} <= {c for e in found for c in e.commands}
    assert found[0].seconds == max(entry.seconds for entry in found)


@pytest.mark.slow
def test_what_is_missing_is_compiled_in_another_process_once(own: Path) -> None:
    seen: list[tuple[int, int]] = []
    assert warm_up.missing("build-catalog") == [SMALL]
    (file,) = warm_up.compile_kernels([SMALL], lambda *step: seen.append(step))
    assert seen == [(0, 1), (1, 1)]
    assert file == own / SMALL.file_name
    assert warm_up.missing("build-catalog") == []
    before = file.stat().st_mtime_ns
    assert warm_up.compile_kernels([SMALL]) == [file]
    assert file.stat().st_mtime_ns == before


@pytest.mark.slow
def test_files_for_others_and_for_another_level(own: Path, tmp_path: Path) -> None:
    if level() not in LEVELS:
        with pytest.raises(ConfigError, match="on such a processor"):
            warm_up.warm_up("x86-64-v3")
        return
    output = tmp_path / "a" / "shared"
    (one,) = warm_up.warm_up("x86-64-v3", output)
    (own_one,) = warm_up.warm_up(None, output)
    assert one.parent.parent == own_one.parent.parent == output
    assert one.parent.name.startswith("x86-64-v3-")
    assert own_one.parent.name == cache.key()
    assert cache._read(one) is not None
    assert (one.read_bytes() == own_one.read_bytes()) == (level() == "x86-64-v3")
    with pytest.raises(ConfigError, match="`level` must be one of x86-64-v4, x86-64-v3, x86-64"):
        warm_up.warm_up("v5")


@pytest.mark.slow
def test_a_kernel_that_cannot_be_compiled_is_told_and_left_out(
    own: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    wrong = replace(SMALL, signature="(int64,)")
    with caplog.at_level(logging.WARNING):
        assert warm_up.compile_kernels([wrong, SMALL]) == [own / SMALL.file_name]
    assert "cannot be compiled" in caplog.text
    monkeypatch.setattr(warm_up, "entries", lambda *_: [wrong])
    with pytest.raises(OutputError, match="1 of 1 kernels are not compiled"):
        warm_up.warm_up()
