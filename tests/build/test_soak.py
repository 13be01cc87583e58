"""The benchmark that kills builds, with a few kills; `make soak` tries 200."""

from __future__ import annotations

import pytest
import soak


@pytest.mark.slow
@pytest.mark.parametrize("way", ["jobs", "parts"])
def test_killed_builds_give_the_same_bytes(way: str) -> None:
    result = soak.soak(3, [way], seed=3)
    assert sum(result.tried.values()) >= 3
    assert result.survived == result.tried, result.text()


def test_the_table_names_what_went_wrong() -> None:
    result = soak.Result()
    result.tried.update({"jobs: lcp, SIGKILL": 2})
    result.survived.update({"jobs: lcp, SIGKILL": 1})
    result.faults.append("jobs: lcp, SIGKILL: processes are left")
    assert result.text().splitlines()[2:] == [
        "| jobs: lcp, SIGKILL | 1 | 2 |",
        "| all | 1 | 2 |",
        "jobs: lcp, SIGKILL: processes are left",
    ]
