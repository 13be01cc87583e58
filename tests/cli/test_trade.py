"""``lcp trade`` as a user runs it: three files in a folder, one line for every mistake, no
incomplete output.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from helpers.commands import refusal
from lcp_cli.main import run

from lcp_catalog.tradeoff import confirmation, knobs, measurement, proposal, report

DEM = str(Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif")

SMALL = """
[area]
center_deg = [3.5, 26.0]
size_km = 25.0
gsd_m = 474.0
[sun]
azimuths_deg = [90.0, 270.0]
elevations_deg = [10.0]
[view]
off_nadir_deg = [0.0]
azimuth_deg = [0.0]
altitude_km = [inf]
[points]
patch_nodes = 17
search_m = 5000.0
[model]
accuracy = "draft"
direction_tolerance_deg = 1.0
ring_max_km = 20.0
"""


E2E = (
    SMALL.replace("size_km = 25.0", "size_km = 60.0")
    .replace("[90.0, 270.0]", "[0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]")
    .replace("[10.0]", "[5.0, 10.0, 20.0, 40.0]")
    .replace("search_m = 5000.0", "search_m = 5000.0\nspacing_m = 4000.0")
    .replace("direction_tolerance_deg = 1.0", 'direction_tolerance_deg = 0.5\nalbedo = "none"')
    .replace('"draft"', '"standard"')
)
"""Some areas more, with Suns low enough that approximations change something; its points are spread evenly."""


@pytest.fixture
def config(tmp_path: Path) -> str:
    path = tmp_path / "build.toml"
    path.write_text(SMALL)
    return str(path)


@pytest.mark.parametrize("own", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_it_writes_table_page_and_data(
    tmp_path: Path,
    config: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    own: bool,
) -> None:
    """Each tier in a process of its own (or in this one, which is quicker); options override the
    file; the file's tier has no effect.
    """
    if not own:
        workers = measurement.Workers
        monkeypatch.setattr(measurement, "Workers", lambda isolated: workers(isolated=not isolated))
    folder = tmp_path / "trade"
    flags = [
        "--config",
        config,
        "--areas",
        "1",
        "--rounds",
        "1",
        "--sun-elevations",
        "10,30",
        "--time-limit",
        "0",
    ]
    assert run(["trade", DEM, "-o", str(folder), *flags]) == 0
    told = capsys.readouterr()
    document = json.loads((folder / "trade.json").read_text())
    rows, compared = document["tiers"], document["compared"]
    assert [row["accuracy"] for row in rows] == ["draft", "standard", "high", "reference"]
    for row in rows:
        grown_mb = row["memory_mb"] - row["memory_base_mb"]
        assert grown_mb > 0.0 or (
            grown_mb == 0.0 and not own
        )  # a peak of here may be another test's
        assert row["memory_base_mb"] > 10.0
        assert row["seconds"] > 0.0
    assert compared["areas"] == 1 < compared["areas_of"]
    assert compared["sun_elevations_deg"] == [10.0, 30.0]
    assert compared["own_process"] is True
    assert told.out == (folder / "trade.md").read_text()
    assert f"1 of {compared['areas_of']} areas" in told.err
    assert "of which the build has" not in told.err
    assert (folder / "trade.html").read_text().startswith("<!DOCTYPE html>")
    assert sorted(p.name for p in folder.iterdir()) == ["trade.html", "trade.json", "trade.md"]


def test_more_areas_than_there_are_are_said(
    tmp_path: Path, config: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a line beside those that were taken."""
    document = {"areas": 2, "areas_of": 2}
    found = SimpleNamespace(compared=document, tiers=[], rows=[])
    monkeypatch.setattr(report, "trade", lambda *_, **given: found)
    monkeypatch.setattr(report, "markdown", lambda _: "")
    for areas, said in (("3", True), ("2", False), ("all", False)):
        flags = ["--config", config, "--areas", areas]
        assert run(["trade", DEM, "-o", str(tmp_path / "t"), *flags]) == 0
        assert ("--areas 3, of which the build has 2\n" in capsys.readouterr().err) == said
    document |= {"areas": 1, "areas_of": 9}
    assert run(["trade", DEM, "-o", str(tmp_path / "t"), "--config", config, "--areas", "2"]) == 0
    assert "--areas 2, of which the build has 9; 1 computed: " in capsys.readouterr().err


def test_what_is_there_is_kept(
    tmp_path: Path, config: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refused before the computation."""
    (tmp_path / "trade").mkdir()
    page = tmp_path / "trade" / "trade.html"
    page.write_text("mine")
    assert run(["trade", DEM, "-o", str(page.parent), "--config", config]) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert page.read_text() == "mine"
    assert [p.name for p in page.parent.iterdir()] == ["trade.html"]


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["nowhere.tif", "-o", "x"], 1, "nowhere.tif"),
        ([DEM], 2, "-o"),
        ([DEM, "-o", "x", "--areas", "0"], 2, "--areas"),
        ([DEM, "-o", "x", "--rounds", "0"], 2, "--rounds"),
        ([DEM, "-o", "x", "--center", "3", "26"], 2, "--size"),
        (
            [DEM, "-o", "x", "--center", "100", "26", "--size", "20"],
            1,
            "no height in the DEM, which covers",
        ),
        ([DEM, "-o", "no/such/folder/x"], 1, "folder"),
        ([DEM, "-o", DEM], 2, "the output is a folder; name it without .tif"),
        ([DEM, "-o", "x", "--config", "nowhere.toml"], 1, "nowhere.toml"),
        ([DEM, "-o", "x", "--sun-elevations", "5;6"], 2, "A,B,C"),
        ([DEM, "-o", "x", "--accuracy", "draft"], 2, "--accuracy"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str],
    code: int,
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refusal(["trade", *arguments], code, capsys)
    assert list(tmp_path.iterdir()) == []


def _flags(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (n, 3) on the unit sphere, and evaluated and usable conditions (n, ...) of a catalogue, by h5py alone."""
    with h5py.File(path) as file:
        lon, lat = (np.radians(file[name][:]) for name in ("longitude", "latitude"))
        flags = file["condition"][:]
        masks = dict(
            zip(
                file["condition"].attrs["flag_meanings"].split(),
                file["condition"].attrs["flag_masks"].tolist(),
                strict=True,
            )
        )
    place = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
    whole = sum(masks.values())
    return place, (flags & masks["evaluated"]) > 0, (flags & whole) == whole


@pytest.mark.slow
def test_the_configuration_for_an_error_holds_in_two_builds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command names a configuration, two builds are made with the user's and with that, and compared here by place: as
    much changes as was said. Of alternatives with the same Suns, whose points do not depend on what is chosen in other areas.
    """
    every = confirmation.settings
    same = "one direction per area", "searched again near the limit", "number of rivals"
    monkeypatch.setattr(
        confirmation, "settings", lambda config: [one for one in every(config) if one.knob in same]
    )
    # a coarser direction loses a tenth of the points here and would be refused; what is said of it must hold all the same
    monkeypatch.setattr(proposal, "LEAST_USABLE", 0.8)
    # what saves time on a busy machine is not asked here

    def areas_s(self: knobs.Outcome) -> tuple[float, None]:
        return 10.0 / self.level.recipe.config.model.direction_tolerance_deg**3, None

    monkeypatch.setattr(knobs.Outcome, "areas_s", areas_s)
    toml = tmp_path / "build.toml"
    toml.write_text(E2E)
    folder = tmp_path / "trade"
    asked = ["--max-error", "0.05", "--areas", "all", "--rounds", "1", "--time-limit", "900"]
    assert run(["trade", DEM, "-o", str(folder), "--config", str(toml), *asked]) == 0
    capsys.readouterr()
    document = json.loads((folder / "trade.json").read_text())
    best = document["best"]
    assert best["asked"] == {"seconds": None, "error": 0.05}
    assert best["value"]
    assert best["areas"] == document["compared"]["areas_of"]
    assert 0.0 < best["conditions_changed_share"] <= 0.05
    text = (folder / "best.toml").read_text()
    assert max(map(len, text.splitlines())) <= 100
    lines = text.replace("\n#   ", " ").splitlines()
    assert [line[2:] for line in lines if line.startswith("# ")] == document["best_said"]

    builds = [tmp_path / "own.h5", tmp_path / "best.h5"]
    for config, output in zip((toml, folder / "best.toml"), builds, strict=True):
        built = ["build-catalog", DEM, "--config", str(config), "-o", str(output)]
        assert run([*built, "--jobs", "1", "--try-cures", "0"]) == 0

    (old, known, works), (new, also, still) = (_flags(path) for path in builds)
    away_m = 1737400.0 * np.linalg.norm(old[:, None] - new, axis=2)
    lost, gained = ((away_m.min(axis=axis) > 2.0 * 474.0).sum() for axis in (1, 0))
    assert (best["points"], best["points_lost"], best["points_gained"]) == (len(new), lost, gained)
    here = np.flatnonzero(away_m.min(axis=1) <= 2.0 * 474.0)
    there = away_m[here].argmin(axis=1)
    judged = known[here] & also[there]
    changed = ((works[here] != still[there]) & judged).sum() / judged.sum()
    # the interval of all places, and two sigmas of the number of conditions that the points here have
    low, high = best["elsewhere"]
    counted = 2.0 * np.sqrt(best["conditions_changed_share"] / judged.sum())
    assert low - counted <= changed <= high + counted
    assert changed > 0.0
