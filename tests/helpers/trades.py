"""A small build of synthetic craters with injected errors of tiers, for the tests of `lcp trade`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lcp_catalog.accuracy import TIERS
from lcp_catalog.catalog.schema import USABLE
from lcp_catalog.production import sweep
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.evaluation import Evaluation
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build
from lcp_catalog.terrain.occlusion import occluded_sweep
from lcp_catalog.tradeoff import measurement

from . import products, synthetic

GSD_M = 474.0
CONFIG = BuildConfig(
    area=AreaConfig(center_deg=(1.0, 9.0), size_km=50.0, gsd_m=GSD_M),
    sun=SunConfig((90.0, 270.0), (10.0, 30.0)),
    view=ViewConfig((30.0, 0.0), (90.0, 0.0), (float("inf"),) * 2),
    points=PointConfig(patch_nodes=17, search_m=5000.0),
    model=ModelConfig(direction_tolerance_deg=0.7, ring_max_km=20.0, albedo="none"),
)


def cratered_dem(folder: Path) -> Path:
    """Craters on 114 km around 1 E 9 N, with a gap of nodata."""
    heights = synthetic.cratered(240, GSD_M, seed=3)
    heights[100:103, 90:96] = -32768.0
    west, north = 1.0 - 120 / 64, 9.0 + 120 / 64
    return products.geotiff(
        folder / "craters.tif",
        heights,
        west * products.DEGREE_M,
        north * products.DEGREE_M,
        products.DEGREE_M / 64,
        nodata=-32768.0,
    )


def faulty(monkeypatch: pytest.MonkeyPatch, flips: Any, tier: str = "draft") -> None:
    """Exact tracing in every tier, except that ``tier`` has the inverted shadow at the nodes of
    ``flips(azimuth, dark)``.
    """

    def wrong(
        field: Any, azimuth: float, elevations: Any, accuracy: Any, window: Any, far: Any
    ) -> Any:
        dark = occluded_sweep(field, azimuth, elevations, TIERS["reference"], window, far)
        if accuracy.tier != tier:
            return dark
        return dark ^ flips(azimuth, dark).astype(np.uint8)

    monkeypatch.setattr(sweep, "occluded_sweep", wrong)


def one_in_a_hundred(azimuth: float, dark: np.ndarray) -> np.ndarray:
    return np.random.default_rng(int(1e6 * azimuth) + 1).random(dark.shape) < 0.01


def tiers(build: Build) -> dict[str, Any]:
    return {tier: measurement._in_tier(build.jobs[0], tier) for tier in TIERS}


def candidates(places: list[tuple[float, float]], states: list[list[int]]) -> list[Any]:
    """Fields of candidates with one view, one azimuth and as many elevations as states; sigma 10 m
    per condition.
    """
    count = len(places)
    shape = (1, len(states[0]) if states else 2, 1)
    evaluation = Evaluation.empty(count, 2, shape)
    if count:
        evaluation.condition[:, 0, :, 0] = states
        evaluation.sigma_major_m[:] = 10.0
        evaluation.detection[:] = np.where(evaluation.condition == USABLE, 1.0, 0.0)[:, None]
    lon, lat = (np.array([p[k] for p in places], dtype=np.float64) for k in (0, 1))
    patch = np.zeros((count, 3, 3), np.float32)
    return [lon, lat, np.zeros(count), patch, np.zeros(count, np.int16), evaluation]
