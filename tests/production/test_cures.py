"""What is advised after a poor build: its price is that of the plan with the change, its effect that of builds of parts
of the region.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.catalogs import HADLEY
from lcp_cli.build_options import NUMBERS

from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.production import public
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.cures import Trial, Yield, cures, warn_of_small_footprint
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build, BuildRun
from lcp_catalog.terrain.area import Area

CONFIG = BuildConfig(
    area=AreaConfig(center_deg=(3.5, 26.0), size_km=120.0, gsd_m=474.0),
    sun=SunConfig(azimuths_deg=(90.0, 105.0, 120.0), elevations_deg=(10.0, 20.0, 30.0)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
).replaced({"points.search_m": 20_000.0, "model.albedo": "none"})
SMALL = replace(CONFIG, area=replace(CONFIG.area, size_km=60.0, gsd_m=948.0)).replaced(
    {"points.search_m": 40_000.0}
)


def planned(config: BuildConfig) -> Build:
    return Build.plan([HADLEY], config)


def work(build: Build) -> int:
    return sum(job.work for job in build.jobs)


@pytest.mark.parametrize(
    ("cause", "field", "value"),
    [
        ("few", "area.gsd_m", 474.0),
        ("ambiguous", "area.gsd_m", 948.0),
        ("marginal", "sun.azimuths_deg", (90.0, 97.5, 105.0, 112.5, 120.0, 285.0)),
        ("ambiguous", "points.search_m", 10_000.0),
        ("dark", "model.albedo", "moon"),
    ],
)
def test_the_price_is_that_of_another_plan(cause: str, field: str, value: object) -> None:
    """Areas of finer cells overlap a little less, 8 % here, and are cut alike under a large tolerance."""
    base = CONFIG
    if field == "area.gsd_m":
        base = base.replaced({"model.direction_tolerance_deg": 2.0})
    if cause == "few":
        base = base.replaced({field: 948.0})
    build = planned(base)
    (price,) = (one.work for one in cures(build, {cause: 1.0}) if field in one.changes)
    other = planned(base.replaced({field: value}))
    assert price == pytest.approx(work(other) / work(build), rel=0.1)


def test_changes_against_what_matters() -> None:
    build = planned(CONFIG)
    found = cures(build, {"marginal": 0.5, "ambiguous": 0.3, "dark": 0.3, "size": 0.02})
    assert {one.cause for one in found} == {"marginal", "ambiguous", "dark"}
    assert [one.work for one in found] == sorted(one.work for one in found)
    assert "sun.azimuths_deg" in found[-1].changes or found[-1].work >= 2.0  # twice the work
    assert cures(build, {"nodata": 1.0}) == []
    (closer,) = cures(
        build, {"few": 1.0}
    )  # no finer cells: 474 m is the finest that the DEM resolves
    assert str(closer) == "`points.spacing_m` 4 km and `points.located_probability` 0.99"
    assert build.recipe.config.replaced(closer.changes).points.promised
    assert closer.work == pytest.approx((17 / 8) ** 2)  # cells of the candidates, in nodes


def test_advice_is_as_the_options_take_it() -> None:
    """`--sun-azimuths` reads the text of the default grid, halved, and that of an uneven one."""
    for azimuths in (SunConfig().azimuths_deg, (90.0, 105.0, 140.0), (90.0, 90.0 + 100.0 / 3.0)):
        build = planned(replace(CONFIG, sun=SunConfig(azimuths, (10.0,))))
        (cure,) = cures(build, {"marginal": 1.0})
        read = NUMBERS.convert(str(cure).removeprefix("`sun.azimuths_deg` "), None, None)
        assert len(read) == 2 * len(azimuths)
        assert set(np.round(azimuths, 3)) <= set(np.round(read, 3))
    assert "`points.search_m` 10 km" in map(str, cures(planned(CONFIG), {"ambiguous": 1.0}))


Measure = Callable[[BuildConfig], Yield]


def advice(measure: Measure, causes: dict[str, float], limit_s: float = 1e3) -> str:
    """Of a build whose nodes take 10 us each."""
    build = planned(SMALL)
    spent_s = 1e-5 * work(build)
    return Trial(build, measure, limit_s, spent_s).advice(causes, [(3.5, 26.0), (3.6, 26.2)])


def test_only_what_helps_is_named() -> None:
    """Half the search radius helps at both places, larger patches at none."""
    asked: list[BuildConfig] = []

    def measure(config: BuildConfig) -> Yield:
        asked.append(config)
        return Yield(5, 30 if config.points.search_m == 20_000.0 else 20, 100)

    text = advice(measure, {"ambiguous": 0.6, "few": 0.01})
    assert re.match(
        r"tried on 2 x \S+ x \S+ km of the region, these help: `points.search_m` 20 km \(against ambiguous\) at 1 times "
        r"the work, \S+ s of processor time: the promise is kept in 30 % there \(20 % without\); without effect: ",
        text,
    )
    assert "`points.patch_nodes` 51" in text.partition("without effect")[2]
    assert {one.area.center_deg for one in asked} == {(3.5, 26.0), (3.6, 26.2)}
    assert {948.0, 1896.0} <= {one.area.gsd_m for one in asked} <= {948.0, 474.0, 1896.0}
    for one in asked:  # the region's, not the part's, and at least three patches of 33 nodes
        assert one.points.footprint_km == pytest.approx(max(60.0, 0.099 * one.area.gsd_m))


def test_beside_larger_cells_both_are_named() -> None:
    def measure(config: BuildConfig) -> Yield:
        return Yield(5, 30 if config.area.gsd_m == 1896.0 else 20, 100)

    assert (
        "the promise is kept in 30 % there (20 % without); with both, `area.levels_m` 948,1896, positions under low Suns "
        "are about as fine" in advice(measure, {"ambiguous": 0.6})
    )


def test_where_nothing_helps_the_cause_is_said() -> None:
    text = advice(lambda config: Yield(5, 20, 100), {"ambiguous": 0.6})
    assert (
        "km of the region, no change helps (ambiguous: the ground looks like other ground" in text
    )
    text = advice(lambda config: Yield(0), {"nodata": 5.0})
    assert text.startswith(
        "no change of the configuration is known to help (nodata: the DEM has no"
    )


@pytest.mark.parametrize(
    ("elevations", "lone"), [((15.0, 40.0), True), ((15.0, 27.5, 40.0), False), ((15.0,), False)]
)
def test_few_points_between_two_elevations_are_no_matter_of_cameras(
    elevations: tuple[float, ...], lone: bool
) -> None:
    config = CONFIG.replaced({"sun.elevations_deg": elevations, "points.per_view": 3})
    trial = Trial(planned(config), lambda config: Yield(0), 0.0, 0.0)
    said = trial.advice({"few": 0.8}, [])
    assert ("(few: two elevations of the Sun (of 15,40 deg) have no third" in said) is lone
    assert said.count("`sun.elevations_deg` 15:40:12.5") == (2 if lone else 0)  # cure and cause
    assert ("lie too thinly" in said) is not lone
    assert "`sun.elevations_deg` 15:40:12.5 comes" not in trial.advice(
        {"few": 0.1, "dark": 0.8}, []
    )


def test_points_where_there_were_none_help() -> None:
    text = advice(
        lambda config: Yield(3 if config.points.patch_nodes == 51 else 0), {"ambiguous": 9}
    )
    assert re.search(
        r"`points.patch_nodes` 51 \(against ambiguous\) at 2.4 times the work, \S+ s of processor time: 6 points there",
        text,
    )


def test_no_more_time_than_is_given() -> None:
    """Without time nothing is computed; too little leaves out the dearest."""

    def never(config: BuildConfig) -> Yield:
        raise AssertionError

    for limit_s in (0.0, 1e-3):
        text = advice(never, {"ambiguous": 0.6}, limit_s)
        assert text.startswith("these may help (not tried")
        assert "`points.search_m` 20 km (against ambiguous) at 1 times the work" in text
    assert "it would take longer than 0.001 s; " in text


def test_a_price_is_a_time_of_this_build() -> None:
    """The work of the build took 1e-5 s a node; half the search radius is as much again, larger patches 2.4 times."""
    build = planned(SMALL)
    for seconds in (0.01, 4.0, 300.0):
        causes = {"ambiguous": 0.6}
        text = Trial(build, lambda config: Yield(0), 0.0, seconds).advice(causes, [])
        prices = re.findall(r"at (\S+) times the work, ([\d.]+) s of processor time", text)
        assert len(prices) == 2
        for work_, price in prices:
            assert float(price) == pytest.approx(float(work_) * seconds, rel=0.06)
    unknown = Trial(build, lambda config: Yield(0), 0.0, 0.0).advice({"ambiguous": 0.6}, [])
    assert "processor time" not in unknown


def test_a_change_that_is_refused_is_not_named() -> None:
    """Half of the usual 8 km is less than half a patch of 33 cells of 474 m, and a half patch is hardly less than the radius."""
    build = planned(CONFIG.replaced({"points.search_m": None}))
    assert not any("points.search_m" in one.changes for one in cures(build, {"ambiguous": 1.0}))


@pytest.mark.slow
def test_the_effect_is_that_of_a_build_of_the_part(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The figures that are said are those of catalogues of the same places, made as any other. One change is tried."""
    monkeypatch.setattr("lcp_catalog.production.cures._TRIED", 1)
    run_ = BuildRun(planned(SMALL), tmp_path / "c.h5", try_cures_s=1e3)
    with caplog.at_level(logging.WARNING):
        run_.whole()
    first, second = (text for text in caplog.messages if "c.h5" in text)
    assert re.search(r"the promise is kept in \d+ % of places, views and Suns \(else ", first)
    assert "tried on 2 x " in second
    part = {"area.center_deg": (3.5, 26.0), "area.size_km": 45.5, "points.footprint_km": 60.0}
    config = SMALL.replaced(part)
    public.build_catalog(HADLEY, tmp_path / "part.h5", config=config)
    own = Yield.of(open_catalog(tmp_path / "part.h5"))
    assert run_._small(config) == own
    assert own.conditions > 0


@pytest.mark.parametrize(
    ("size_km", "gsd_m", "points", "said"),
    [
        (70.0, 474.0, {}, (250.0, 1.3, 0.99, 4.2)),
        (70.0, 237.0, {}, (237.0, 1.3, 0.99, 4.0)),
        (70.0, 474.0, {"patch_nodes": 17}, (474.0, 1.9, 0.99, 7.6)),
        (70.0, 474.0, {"spacing_m": 4000.0, "located_probability": 0.9}, (250.0, 1.3, 0.9, 4.2)),
        (70.0, 237.0, {"spacing_m": 1200.0, "located_probability": 0.9}, None),
        (70.0, 474.0, {"per_view": 3}, None),
        (70.0, 118.0, {}, None),  # ten patches
        (40.0, 474.0, {}, None),  # the whole region
        (70.0, 474.0, {"footprint_km": None}, None),
    ],
)
def test_small_footprints_are_advised(
    size_km: float,
    gsd_m: float,
    points: dict[str, Any],
    said: tuple[float, ...] | None,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A footprint of 40 km wants patches of 8 km, 32 cells of 250 m, points at a sixth of a patch, at least four cells, and a
    search as far as `locate` looks for a place known to 1 km, more than half a patch. What is advised is not refused.
    """
    config = PointConfig(**{"footprint_km": 40.0} | points)
    warn_of_small_footprint(Area(3.5, 26.0, size_km), config, gsd_m)
    if said is None:
        assert not caplog.messages
        return
    (text,) = caplog.messages
    found = re.search(r"most (\S+) m, .*_m` (\S+) km .*_probability` (.+)\) .*_m` (\S+) km", text)
    assert found is not None
    assert tuple(map(float, found.groups())) == said
    closer = replace(config, spacing_m=1e3 * said[1], search_m=1e3 * said[3])
    closer.check_cells(said[0])


@pytest.mark.parametrize(
    ("elevations", "points", "said"),
    [
        ((10.0, 20.0), {}, None),  # points that locate a frame count beyond both by their claims
        ((10.0, 20.0), {"per_view": 3}, "10:20:5"),
        (
            (5.0, 10.0, 50.0, 60.0),
            {"per_view": 3},
            "5,7.5,10,50,55,60",
        ),  # no row between 10 and 50 deg
        ((10.0, 15.0, 20.0), {"per_view": 3}, None),
        ((10.0,), {"per_view": 3}, None),
        ((10.0, 50.0), {"per_view": 3}, None),  # each of them is evaluated as it is
        ((10.0, 20.0), {"spacing_m": 7500.0}, None),  # nothing is promised
    ],
)
def test_two_elevations_alone_are_advised_against(
    elevations: tuple[float, ...],
    points: dict[str, Any],
    said: str | None,
    caplog: pytest.LogCaptureFixture,
) -> None:
    area = replace(CONFIG.area, size_km=40.0)
    sun = SunConfig((90.0, 105.0, 180.0), elevations)
    config = replace(CONFIG, area=area, sun=sun, points=PointConfig(**points))
    planned(config)
    if said is None:
        assert not caplog.messages
        return
    (text,) = caplog.messages
    assert text.endswith(f"add one: `sun.elevations_deg` {said}")
    given = NUMBERS.convert(said, None, None)
    caplog.clear()
    planned(replace(config, sun=replace(sun, elevations_deg=given)))
    assert not caplog.messages


@pytest.mark.slow
def test_an_elevation_between_two_helps(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Ground with many usable candidates, of which none counts between two elevations; the build says so, and the figure that
    it names is that of builds with the third elevation.
    """
    two = SMALL.replaced({"sun.elevations_deg": (10.0, 20.0), "points.per_view": 3})
    run_ = BuildRun(planned(two), tmp_path / "c.h5", try_cures_s=1e3)
    with caplog.at_level(logging.WARNING):
        run_.whole()
    assert any(
        "two elevations of the Sun (of 10,20 deg) have no third" in text for text in caplog.messages
    )
    text = caplog.messages[-1]
    found = re.search(
        r"elevations_deg` 10:20:5 \(against few\) .*? kept in (\d+) % there \((\d+)", text
    )
    assert found is not None
    with_third, without = map(int, found.groups())
    assert without < 10
    assert with_third > 50
