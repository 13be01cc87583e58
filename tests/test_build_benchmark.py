"""The parts of benchmarks/build.py that its figures rest on."""

from types import SimpleNamespace

import numpy as np
import pytest
from build_areas import Package
from build_differences import Places, differences
from build_stages import PIPELINE_STAGES, REST, STAGES, Clock, Scripts, wrapped
from build_tables import Measured, Subject, ratio, stage_table, summary


def result(lon: list[float], flags: list[list[int]], detection: float = 0.5) -> Places:
    """Candidates on the equator with flags (n, conditions)."""
    condition = np.array(flags, np.uint8)
    values = np.full(condition.shape, detection, np.float32)
    evaluation = SimpleNamespace(
        condition=condition, detection=values, sigma_major_m=100.0 * values
    )
    return Places(np.array(lon), np.zeros(len(lon)), evaluation)


def test_candidates_are_paired_by_place_and_their_flags_compared() -> None:
    before = result([1.0, 2.0, 3.0], [[31, 31, 0], [1, 29, 31], [31, 31, 31]], 0.5)
    now = result([2.0, 1.0, 4.0], [[1, 31, 31], [31, 30, 0], [31, 31, 31]], 0.625)
    found = differences(before, now, cell_m=100.0)
    assert (found.paired, found.alone, found.evaluated) == (2, (1, 1), 5)
    assert found.any_flag == pytest.approx(2 / 5)  # 31 and 30, 29 and 31
    assert found.usable == pytest.approx(2 / 5)
    assert found.flags == pytest.approx([1 / 5, 1 / 5, 0.0, 0.0, 0.0])
    assert found.detection == pytest.approx((0.125, 0.125))
    assert found.sigma == pytest.approx((0.25, 0.25))


def test_a_nested_stage_does_not_count_for_the_outer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter(np.arange(20.0))
    monkeypatch.setattr("build_stages.time.process_time", lambda: float(next(times)))
    clock = Clock()  # 0
    inner = clock.timed("shadows", lambda: None)  # starts at 2, ends at 3
    clock.timed("corners", inner)()  # starts at 1, ends at 4
    assert {k: v for k, v in clock.stop().items() if v} == {
        "corners": 2.0,
        "shadows": 1.0,
        REST: 2.0,
    }


def timed(name: str, nodes: int, seconds: list[float], stages: dict[str, float]) -> Subject:
    """An area of 10 conditions that has been timed."""
    package = Package("lcp_catalog")
    return Subject(name, lambda: None, nodes, 10, package, None, package, seconds, [stages])


def test_the_ratio_is_the_median_over_rounds_for_each_node_and_condition() -> None:
    now = timed("now", 100, [1.0, 2.0, 1.0], {"terrain": 0.25, REST: 0.5})
    before = timed("before", 50, [8.0, 8.0, 2.0], {"terrain": 2.0, REST: 3.0})
    assert ratio(now, before) == pytest.approx(8.0)
    lines = stage_table([now, before]).splitlines()
    assert lines[0] == "| stage, ms | now | before |"
    assert lines[2:] == [
        "| terrain | 250.0 | 2000.0 |",
        "| rest | 500.0 | 3000.0 |",
        "| all | 750.0 | 5000.0 |",
    ]


def unwrapped(package: Package | Scripts, stages: dict[str, tuple[str, ...]]) -> list[str]:
    """Stages with functions, of which the package has none."""
    missing = []
    for stage, names in stages.items():
        undo = [back for name in names for back in wrapped(package, name, Clock(), stage)]
        missing += [] if undo or not names else [stage]
        for back in reversed(undo):
            back()
    return missing


def test_every_stage_has_a_function_in_the_package() -> None:
    assert unwrapped(Package("lcp_catalog"), STAGES) == []
    assert list(PIPELINE_STAGES) == list(STAGES)


def test_every_stage_has_a_function_in_the_pipeline() -> None:
    pytest.importorskip("embreex", reason="Embree has wheels for Linux and Windows on x86-64 only")
    each = {name: (name,) for names in PIPELINE_STAGES.values() for name in names}
    assert unwrapped(Scripts(), each) == []


def test_the_summary_has_a_row_for_each_case_and_the_stages_of_all() -> None:
    before = result([1.0], [[31, 1]])
    now = result([1.0], [[31, 31]])
    cases = []
    for name, nodes in (("mare", 100), ("pole", 200)):
        subjects = [timed("now", nodes, [0.5], {"terrain": 0.25, REST: 0.25})]
        subjects.append(timed("old", nodes, [2.0], {"terrain": 0.5, REST: 1.5}))
        for one, found in zip(subjects, (now, before), strict=True):
            one.result = found
        cases.append(Measured(name, subjects, {"old": differences(before, now, 100.0)}))
    lines = summary(cases).splitlines()
    assert lines[4] == "| mare | 100 | 10 | 1 | 0.002 | 0.001 | 4.0 | 50.000 |"
    assert lines[7:] == [
        "| ms: old / now | mare | pole |",
        "| --- | ---: | ---: |",
        "| terrain | 500 / 250 | 500 / 250 |",
        "| rest | 1500 / 250 | 1500 / 250 |",
    ]
