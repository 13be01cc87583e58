"""Reaches of the search, their pixels, and the decisions on the figures of the first search: the
search is recorded, or replaced.
"""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import small_world
from helpers.posed import spread_px2
from helpers.small_world import LAW, overhead
from helpers.suns import light

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.images.image import Image
from lcp_catalog.matching.common_errors import SharedTerrain
from lcp_catalog.matching.consensus import Consensus
from lcp_catalog.matching.fix import CANNOT_SAY, LOCATED, NOT_HERE, Fix
from lcp_catalog.matching.matches import Matches
from lcp_catalog.matching.options import Options
from lcp_catalog.matching.point_search import find_points
from lcp_catalog.matching.pose import solve
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.matching.search_area import SearchArea
from lcp_catalog.matching.sun_check import MatchedPoints
from lcp_catalog.matching.sun_verdict import SunCheck

QUICK = Options(check_sun=False)


@pytest.fixture(scope="module")
def few() -> Catalog:
    """25 points, 15 km apart, with cells of 400 m."""
    return small_world.world().catalog(step_m=15e3, half_m=30e3)


@pytest.fixture(scope="module")
def image() -> Image:
    """An image that is not noise, with pixels of 200 m."""
    signal = np.random.default_rng(0).normal(size=(200, 200)).cumsum(0).cumsum(1)
    sun = small_world.world().frame.rotation[2]
    weight = np.ones(signal.shape, np.float32)
    camera = overhead(pixel_m=200.0)
    return Image("made", signal.astype(np.float32), weight, camera, sun_direction_mcmf=sun)


@pytest.mark.parametrize(("sigma_m", "first"), [(3000.0, "find_points"), (6000.0, "find_points"), (10e3, "narrowed")])  # fmt: skip
def test_the_whole_image_is_shifted_first_from_64_searched_pixels_on(
    few: Catalog, image: Image, monkeypatch: pytest.MonkeyPatch, sigma_m: float, first: str
) -> None:
    """Pixels of 200 m, searched at half: 45, 90 and 150 pixels are 3 sigma."""

    asked = {name: Mock(side_effect=InterruptedError(name)) for name in ("find_points", "narrowed")}
    for name, stop in asked.items():
        monkeypatch.setattr(f"lcp_catalog.matching.position_fix.{name}", stop)
    with pytest.raises(InterruptedError, match=first):
        locate(few, image, Uncertainty(sigma_m), LAW, QUICK)
    if asked["narrowed"].called:  # by how much it may be narrowed at most
        assert asked["narrowed"].call_args.args[-2:] == (3.0, 32.0)


def test_reaches_are_in_the_searched_photographs_pixels(
    few: Catalog, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pixels of 200 m are searched at half: reaches of 16, then 6, and 3 under other Suns, and the
    error common to all points are twice as many pixels of the full-resolution image.
    """
    reaches, suns = [], []

    def listen(*given: object, **more: object) -> Matches:
        reaches.append(np.unique(given[3]).tolist())
        return find_points(*given, **more)

    def fits(*given: object) -> SunCheck:
        suns.append(given[-2])
        return light(0.1)

    monkeypatch.setattr("lcp_catalog.matching.position_fix.find_points", listen)
    monkeypatch.setattr(MatchedPoints, "check", fits)
    camera = overhead(pixel_m=200.0, size_px=320)
    answer = locate(
        few, small_world.world().photo(camera), Uncertainty(200.0), LAW, Options(common_px=0.2)
    )
    assert answer.verdict == LOCATED
    assert reaches[0] == [32.0]
    assert all(reach == [12.0] for reach in reaches[1:])
    assert suns == [6.0]
    found = answer.matches
    places = few.position_mcmf[found.point], found.found_px, found.covariance_px2
    shared = SharedTerrain.of(few, found.point, places[0], few.rotation_mcmf_to_enu[found.point])
    plain = solve(camera, *places, Uncertainty(200.0), answer.pose.used, shared)
    middle = few.position_mcmf[[len(few) // 2]]
    more = spread_px2(camera, middle, answer.pose.covariance - plain.covariance)[0]
    assert np.allclose(np.diag(more), 0.4**2, rtol=0.3)


def narrowed_to(
    few: Catalog, image: Image, monkeypatch: pytest.MonkeyPatch, chance: float, places: float
) -> Fix:
    """The result for a coarse offset with a given number of false alarms, chosen among a given
    number of areas; the points then agree on two places.
    """

    def narrow(area: SearchArea, *_: object) -> tuple[SearchArea, float, float]:
        return replace(area, log10_places=places), chance, 1.0

    def nowhere(
        catalog: Catalog, photo: Image, *_: object, points: np.ndarray, **__: object
    ) -> Matches:
        none, count = Matches.none(), len(points)
        rows = {
            n: np.full((count, *getattr(none, n).shape[1:]), np.nan)
            for n in none.__dataclass_fields__
        }
        return Matches(**rows | {"point": points, "code": np.full(count, 7, np.uint8)})

    said = Consensus(None, -40.0, -39.0)
    monkeypatch.setattr("lcp_catalog.matching.position_fix.narrowed", narrow)
    monkeypatch.setattr("lcp_catalog.matching.position_fix.find_points", nowhere)
    monkeypatch.setattr("lcp_catalog.matching.position_fix.agree", lambda *_, **__: said)
    return locate(few, image, Uncertainty(10e3), LAW, QUICK)


@pytest.mark.parametrize(("chance", "verdict"), [(-5.9, NOT_HERE), (-6.1, CANNOT_SAY)])
def test_a_shift_that_may_be_chance_is_none(few, image, monkeypatch, chance, verdict) -> None:
    answer = narrowed_to(few, image, monkeypatch, chance, 0.0)
    assert answer.verdict == verdict
    assert ("is significant" in answer.reason) == (verdict == NOT_HERE)  # fmt: skip


def test_an_area_chosen_among_many_has_as_many_false_alarms(few, image, monkeypatch) -> None:
    answer = narrowed_to(few, image, monkeypatch, -np.inf, 7.5)
    assert answer.log10_false_alarms == -32.5
    assert answer.rival_log10 == -39.0
