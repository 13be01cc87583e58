"""What a long call is doing reaches who shows it: a render and a simulated frame say their stages."""

from __future__ import annotations

import re
from contextlib import nullcontext

import pytest
from helpers.catalogs import HADLEY
from helpers.posed import camera
from lcp_cli import progress as shown
from lcp_cli.progress import _Lines, alive

import lcp_catalog as lcp
from lcp_catalog import stages


def test_stages_of_a_frame_come_with_their_share(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[str] = []
    monkeypatch.setattr(stages, "told", heard.append)
    monkeypatch.setattr("lcp_catalog.simulation.frame._RAYS_AT_ONCE", 2000)
    small = camera(size_px=40, focal_px=400.0)
    lcp.simulate(HADLEY, small, (96.0, 14.0), accuracy="draft", gsd_m=474.0)
    assert heard[0] == "heights"
    assert heard[-1] == "detector"
    shares = [int(one[1]) for text in heard if (one := re.match(r"(\d+) % of the rays, ", text))]
    assert shares == sorted(shares)
    assert shares[0] == 0
    assert shares[-1] > 50
    assert any(text.endswith("rays, occlusion") for text in heard)


def test_a_render_says_shadows_and_reflectance(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[str] = []
    monkeypatch.setattr(stages, "told", heard.append)
    lcp.render(HADLEY, center=(3.5, 26.0), size_km=10.0, sun=(96.0, 14.0))
    assert [heard[0], *{"cast shadows", "reflectance"} & set(heard)][0] == "heights"
    assert {"cast shadows", "reflectance"} <= set(heard)


def test_a_command_shows_the_stage(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:  # fmt: skip
    monkeypatch.setattr(shown, "_FIRST_S", 1.0)
    monkeypatch.setattr(shown.stages, "told", quiet := [].append)
    lines = _Lines("render", ())
    lines.enter("cast shadows")
    lines._began -= 5.0
    lines.beat()
    assert capsys.readouterr().err == "render: cast shadows, 5 s so far\n"
    monkeypatch.setattr(shown, "_beating", lambda beat: nullcontext())
    with alive("render"):
        assert shown.stages.told.__func__ is shown._Lines.enter
    assert shown.stages.told is quiet


def test_time_of_a_part_within_another_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that a part of 3 s within another of 5 s, and a call between of 2 s, move."""
    now = [0.0]
    monkeypatch.setattr(stages.time, "perf_counter", lambda: now[0])
    heard: list[str] = []
    monkeypatch.setattr(stages, "told", heard.append)

    def passes(seconds: float) -> None:
        now[0] += seconds

    inner = stages.timed("inner", is_stage=False)(passes)

    @stages.timed("outer")
    def outer() -> None:
        passes(1.0)
        inner(3.0)
        passes(1.0)

    with stages.shares_of_time() as costs:
        outer()
        passes(2.0)
        inner(3.0)
    assert costs == {"inner": 0.6, "outer": 0.2}
    assert heard == ["outer"]
    outer()  # nobody measures
    assert costs == {"inner": 0.6, "outer": 0.2}
