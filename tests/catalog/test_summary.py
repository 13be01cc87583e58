"""The summary of a catalogue: its figures computed again."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from helpers import catalogs

from lcp_catalog.catalog import summary
from lcp_catalog.catalog.writing import write_catalog


def test_usable_share_counts_evaluated_conditions(tmp_path: Path) -> None:
    found = catalogs.catalog(20)
    flags = found.condition.ravel().tolist()
    share = sum(f == 31 for f in flags) / sum(f & 1 for f in flags)
    statistics = summary.Statistics.of(found)
    assert statistics.share == pytest.approx(share)
    one = found.condition[7].ravel().tolist()
    assert statistics.by_point[7] == pytest.approx(
        sum(f == 31 for f in one) / sum(f & 1 for f in one)
    )
    cell = found.condition[:, 1, 3, :]
    column = int(np.argmax((cell & 1).sum(axis=0)))
    expected = (cell[:, column] == 31).sum() / (cell[:, column] & 1).sum()
    assert statistics.by_view_and_sun[1, 3, column] == pytest.approx(expected)
    assert np.isnan(statistics.by_view_and_sun[:, (found.condition == 0).all(axis=(0, 1))]).all()
    path = tmp_path / "c.h5"
    write_catalog(found, path)
    described = summary.describe(path)
    assert described["usable_share"] == pytest.approx(share)
    assert described["points"] == 20
    assert described["intact"] is True


def test_a_bad_file_is_described(tmp_path: Path) -> None:
    path = tmp_path / "bad.h5"
    path.write_bytes(b"nothing")
    described = summary.describe(path)
    assert described["intact"] is False
    assert len(described["problems"]) == 1
    assert described["points"] is None


MERGED = """[[merged]]
name = "a.h5"
content_sha256 = "0"
points = 3
[merged.config.model]
accuracy = "high"
[[merged]]
name = "b.h5"
content_sha256 = "1"
points = 2
[merged.config.model]
tolerance = 0.01
"""


@pytest.mark.parametrize(
    ("config", "tiers", "half"),
    [
        ("[model]\nring_max_km = 20.0\n", "standard", True),
        ('[model]\naccuracy = "draft"\n', "draft", True),
        ("[model]\ntolerance = 0.0\n", "reference", False),
        ('[model]\naccuracy = "high"\n', "high", False),
        ('[model]\naccuracy = "high"\nwhole_search = false\n', "high", True),
        ("[model]\nwhole_search = true\n", "standard", False),
        (MERGED, "draft, high", True),
        ('[model]\naccuracy = "best"\n', "–", True),
        ("model = 3\n", "–", True),
    ],
)
def test_the_tier_is_named_and_what_it_does_to_second_peaks(
    config: str, tiers: str, half: bool
) -> None:
    found = dataclasses.replace(catalogs.catalog(5), config=config)
    rows = dict(summary.summary_rows(summary.summary(found)))
    assert rows["accuracy"] == tiers
    assert ("half resolution" in rows["second peak"]) == half


@pytest.mark.parametrize(
    ("lon", "west", "east"),
    [([10.0, 20.0], 10.0, 20.0), ([350.0, 5.0, 355.0], 350.0, 5.0), ([42.0], 42.0, 42.0)],
)
def test_bounds_are_the_narrowest(lon: list[float], west: float, east: float) -> None:
    box = summary.bounds(np.array(lon), np.linspace(-3.0, 4.0, len(lon)))
    assert (box["west"], box["east"]) == (west, east)
    assert box["south"] == -3.0


@pytest.mark.parametrize(
    ("west", "east", "says"),
    [(10.0, 20.0, "10.0000 to 20.0000"), (350.0, 5.0, "350.0000 to 5.0000"), (104.0, 86.0, "all around")],
)  # fmt: skip
def test_points_about_a_pole_lie_all_around(west: float, east: float, says: str) -> None:
    found = summary.summary(catalogs.catalog(5)) | {
        "bounds": {"west": west, "south": 88.0, "east": east, "north": 90.0}
    }
    rows = dict(summary.summary_rows(found))
    assert rows["points within"].startswith(says)
    assert rows["frame"].startswith("MOON_ME")
