"""Smooth patterns in the residuals of a map."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import kstest

from lcp_catalog.cameras.sensor import ON_MAP, POSE
from lcp_catalog.validation import map_distortion, run
from lcp_catalog.validation.map_distortion import distortion_advice, smooth_pattern

PLACES = np.random.default_rng(0).uniform(0.0, 400.0, (40, 2))


def bent(rms_px: float) -> np.ndarray:
    """Residuals (40, 2) that are a parabola of the column, of this rms about their mean."""
    across = ((PLACES[:, 0] - 200.0) / 200.0) ** 2
    across -= across.mean()
    return np.stack([across, np.zeros(40)], axis=1) * rms_px / across.std()


@pytest.mark.slow
def test_chances_are_chances() -> None:
    """Of 2000 draws of errors without a pattern, also of unequal sigmas; a shift is none."""
    rng = np.random.default_rng(1)
    sigma = rng.uniform(0.3, 2.0, 40)
    chances = [
        10.0
        ** smooth_pattern(
            PLACES, rng.normal(3.0, sigma[:, None], (40, 2)), sigma, 40.0
        ).log10_chance
        for _ in range(2000)
    ]
    assert kstest(chances, "uniform").pvalue > 0.01


def test_matches_on_the_same_ground_count_once() -> None:
    """Each match twice says no more than once."""
    rng = np.random.default_rng(2)
    residual, sigma = bent(0.2) + rng.normal(0.0, 0.2, (40, 2)), np.full(40, 0.2)
    once = smooth_pattern(PLACES, residual, sigma, 40.0)
    twice = smooth_pattern(
        np.tile(PLACES, (2, 1)), np.tile(residual, (2, 1)), np.tile(sigma, 2), 40.0
    )
    assert twice.rms_px == pytest.approx(once.rms_px)
    assert twice.log10_chance == pytest.approx(once.log10_chance)
    assert smooth_pattern(PLACES, residual, sigma, 6.2).log10_chance == 0.0


def test_a_pattern_is_measured() -> None:
    rng = np.random.default_rng(3)
    found = smooth_pattern(
        PLACES, bent(0.8) + rng.normal(0.0, 0.1, (40, 2)) + 5.0, np.full(40, 0.1), 40.0
    )
    assert found.rms_px == pytest.approx(0.8, abs=0.05)
    assert found.is_named
    assert not smooth_pattern(PLACES, bent(0.2) + 5.0, np.full(40, 0.1), 40.0).is_named


@pytest.mark.parametrize(
    ("kind", "pattern_px", "named"), [(ON_MAP, 0.8, True), (ON_MAP, 0.0, False), (POSE, 0.8, False)]
)
def test_a_distorted_map_is_named(monkeypatch, kind, pattern_px, named) -> None:
    """The last match, which was not accepted, says nothing."""
    monkeypatch.setattr(map_distortion, "patch_width_px", lambda *_: 20.0)
    rng = np.random.default_rng(4)
    found = PLACES + bent(pattern_px) + rng.normal(0.0, 0.1, (40, 2))
    found[-1] += 300.0
    matches = SimpleNamespace(
        point=np.arange(40),
        found=np.arange(40) < 39,
        found_px=found,
        covariance_px2=np.tile(0.01 * np.eye(2), (40, 1, 1)),
    )
    sensor = SimpleNamespace(project=lambda places: places, corrections=kind)
    located = SimpleNamespace(pose=SimpleNamespace(sensor=sensor), matches=matches)
    said = distortion_advice(
        located, SimpleNamespace(position_mcmf=PLACES), SimpleNamespace(sensor=sensor)
    )
    assert said.startswith("the matches leave a smooth pattern of 0.78 px rms") == named
    assert bool(said) == named


@pytest.mark.parametrize("kind", [ON_MAP, POSE])
@pytest.mark.parametrize("known", [True, False])
def test_claims_are_tried_where_the_place_is_known(monkeypatch, kind, known) -> None:
    """Also those of a map, and also where it was not located; without a known place there is no trial then."""
    asked = []

    class Search:
        def __init__(self, catalog, image, model, criteria, true):
            asked.append(true)

        def claims(self, rows, searched):
            asked.append(searched)

    monkeypatch.setattr(run, "ClaimSearch", Search)
    sensor = SimpleNamespace(corrections=kind)
    request = SimpleNamespace(pose_is_known=known, law=None)
    located = SimpleNamespace(pose=None, matches=SimpleNamespace(point=np.arange(3)))
    run._claims(request, None, located, SimpleNamespace(sensor=sensor), None)
    assert asked == [sensor if known else None, known]
