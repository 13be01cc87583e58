"""The parts of benchmarks/speed that its figures rest on."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import FunctionType, SimpleNamespace

import numpy as np
import pytest

from benchmarks.markdown import table
from benchmarks.speed import stages
from benchmarks.speed.differences import Places, differences
from benchmarks.timing import in_turn, ratio
from lcp_catalog.production import area_job


def result(lon: list[float], flags: list[list[int]]) -> Places:
    """Candidates on the equator with flags (n, conditions)."""
    evaluation = SimpleNamespace(condition=np.array(flags, np.uint8))
    return Places(np.array(lon), np.zeros(len(lon)), evaluation)


def test_candidates_are_paired_by_place_and_their_flags_compared() -> None:
    before = result([1.0, 2.0, 3.0], [[31, 31, 0], [1, 29, 31], [31, 31, 31]])
    now = result([2.0, 1.0, 4.0], [[1, 31, 31], [31, 30, 0], [31, 31, 31]])
    found = differences(before, now, cell_m=100.0)
    assert (found.paired, found.alone, found.evaluated) == (2, (1, 1), 5)
    assert found.usable == pytest.approx(2 / 5)  # 31 and 30, 29 and 31


@pytest.fixture
def ticks(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A processor clock that goes on by one second each time it is read."""
    times = iter(range(1000))
    monkeypatch.setattr(stages.time, "process_time", lambda: float(next(times)))
    yield
    sys.setprofile(None)


def test_a_nested_stage_does_not_count_for_the_outer_one(ticks: None) -> None:
    clock = stages.Clock({"areas:own_nodes": "shadows", "areas:polar_dem": "corners"})  # 0
    outer, inner = (frame(name) for name in ("polar_dem", "own_nodes"))
    for code, event in ((outer, "call"), (inner, "call"), (inner, "return"), (outer, "return")):
        clock.hook(code, event, None)  # 1, 2, 3, 4
    assert clock.stop() == {stages.REST: 2.0, "corners": 2.0, "shadows": 1.0}  # 5


def frame(function: str) -> SimpleNamespace:
    """What a profiler tells of a function of `benchmarks.speed.areas`."""
    from benchmarks.speed import areas

    return SimpleNamespace(f_code=getattr(areas, function).__code__)


@pytest.mark.parametrize(
    ("function", "stage"),
    [
        (area_job.height_errors, "terrain"),
        (area_job.candidates_of_groups, "corners"),
        (area_job.run_area, None),
        (table, None),
    ],
)
def test_functions_count_for_the_stage_of_their_module_or_their_caller(
    function: FunctionType, stage: str | None
) -> None:
    clock = stages.Clock(stages.LIBRARY)
    clock.hook(SimpleNamespace(f_code=function.__code__), "call", None)
    assert clock.stop().keys() == ({stages.REST, stage} if stage else {stages.REST})


def test_every_module_and_function_of_a_stage_exists() -> None:
    """Names of `stages.LIBRARY` and `stages.PIPELINE`: one that is gone would count for no stage, unseen."""
    import importlib

    for name in stages.LIBRARY:
        importlib.import_module(f"lcp_catalog.{name}")
    pytest.importorskip("embreex", reason="Embree has wheels for Linux and Windows on x86-64 only")
    for name in stages.PIPELINE:
        module, _, function = name.partition(":")
        owner = importlib.import_module(f"benchmarks.speed.{module}")
        for part in function.split("."):
            owner = getattr(owner, part)
        assert owner.__code__.co_qualname == function


def test_tasks_run_in_turn_and_the_ratio_is_the_median_over_rounds() -> None:
    order: list[str] = []
    tasks = {name: lambda name=name: order.append(name) for name in ("a", "b")}
    times = in_turn(tasks, 2, before=lambda: order.append("-"))
    assert "".join(order) == "ab-b-a-a-b"
    assert {name: len(some) for name, some in times.items()} == {"a": 2, "b": 2}
    assert ratio([1.0, 2.0, 1.0], [8.0, 8.0, 2.0]) == pytest.approx(4.0)


def test_a_table_aligns_numbers_to_the_right() -> None:
    assert table(["stage", "ms"], [["terrain", 250]]).splitlines() == [
        "| stage | ms |",
        "| --- | ---: |",
        "| terrain | 250 |",
    ]
