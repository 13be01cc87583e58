"""The benchmark that kills builds, with a few kills; by itself it tries 200."""

from __future__ import annotations

import pytest

from benchmarks.faults import kills


@pytest.mark.slow
@pytest.mark.parametrize("way", ["jobs", "parts"])
def test_killed_builds_give_the_same_bytes(way: str) -> None:
    result = kills.run(3, [way], seed=3)
    assert len(result.kills) >= 3
    assert result.survived == len(result.kills), result.text()


def test_the_table_names_what_went_wrong() -> None:
    name = "jobs: lcp, SIGKILL"
    result = kills.Result([kills.Kill(name), kills.Kill(name, "processes are left")])
    assert result.text().splitlines()[2:] == [
        "| jobs: lcp, SIGKILL | 1 | 2 |",
        "| all | 1 | 2 |",
        "jobs: lcp, SIGKILL: processes are left",
    ]
