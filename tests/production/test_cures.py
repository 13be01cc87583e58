"""What is advised after a poor build: its price is that of the plan with the change."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.catalogs import HADLEY
from lcp_cli.build_options import NUMBERS

from lcp_catalog.errors import NAMED
from lcp_catalog.production import run
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.cures import cures
from lcp_catalog.production.run import Build

CONFIG = BuildConfig(
    area=AreaConfig(center_deg=(3.5, 26.0), size_km=120.0, gsd_m=474.0),
    sun=SunConfig(azimuths_deg=(90.0, 105.0, 120.0), elevations_deg=(10.0, 20.0, 30.0)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
).replaced({"points.search_m": 20_000.0, "model.albedo": "none"})


def planned(config: BuildConfig) -> Build:
    return Build.plan([HADLEY], config)


def work(build: Build) -> int:
    return sum(job.work for job in build.jobs)


@pytest.mark.parametrize(
    ("cause", "field", "value"),
    [
        ("few", "area.gsd_m", 474.0),
        ("marginal", "sun.azimuths_deg", (90.0, 97.5, 105.0, 112.5, 120.0, 285.0)),
        ("ambiguous", "points.search_m", 10_000.0),
        ("dark", "model.albedo", "moon"),
    ],
)
def test_the_price_is_that_of_another_plan(cause: str, field: str, value: object) -> None:
    """Areas of finer cells overlap a little less: 8 % here."""
    finer = field == "area.gsd_m"
    coarse = {field: 948.0, "model.direction_tolerance_deg": 2.0}
    base = CONFIG.replaced(coarse) if finer else CONFIG
    build = planned(base)
    text = cures(build, {cause: 1.0})
    told = re.search(rf"`{field}` [^;]* at (\S+) times the work", text)
    assert told
    price = float(told[1])
    other = planned(base.replaced({field: value}))
    assert price == pytest.approx(work(other) / work(build), rel=0.1)


def test_the_two_cheapest_of_what_matters() -> None:
    build = planned(CONFIG)
    text = cures(build, {"marginal": 0.5, "ambiguous": 0.3, "dark": 0.3, "size": 0.02})
    named = [found[1] for found in NAMED.finditer(text)]
    assert len(named) == 2
    assert "sun.azimuths_deg" not in named  # twice the work
    assert cures(build, {"nodata": 1.0}) == ""
    assert "gsd_m" not in cures(build, {"few": 1.0})  # 474 m is the finest that the DEM resolves


def test_a_build_that_keeps_little_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = replace(CONFIG, area=replace(CONFIG.area, size_km=60.0, gsd_m=948.0))
    with caplog.at_level(logging.WARNING):
        run.build_catalog(HADLEY, tmp_path / "c.h5", config=config)
    (line,) = (text for text in caplog.messages if "promise" in text)
    assert re.search(r"the promise is kept in \d+ % of places, views and Suns \(else ", line)
    assert "; these may help (effects not computed): `" in line


def test_advice_is_as_the_options_take_it() -> None:
    """`--sun-azimuths` reads the text of the default grid, halved, and that of an uneven one."""
    for azimuths in (SunConfig().azimuths_deg, (90.0, 105.0, 140.0), (90.0, 90.0 + 100.0 / 3.0)):
        build = planned(replace(CONFIG, sun=SunConfig(azimuths, (10.0,))))
        told = re.search(r"`sun.azimuths_deg` (\S+) ", cures(build, {"marginal": 1.0}))
        assert told
        read = NUMBERS.convert(told[1], None, None)
        assert len(read) == 2 * len(azimuths)
        assert set(np.round(azimuths, 3)) <= set(np.round(read, 3))
    assert "`points.search_m` 10 km (against ambiguous)" in cures(planned(CONFIG), {"ambiguous": 1})
