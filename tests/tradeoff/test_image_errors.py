"""``compare_images``: injected errors are counted correctly, compared with stacked images."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.trades import CONFIG, cratered_dem, faulty, one_in_a_hundred, tiers

from lcp_catalog.accuracy import TIERS
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.production import sweep as sweep_module
from lcp_catalog.production.run import Build
from lcp_catalog.production.sweep import Sweep
from lcp_catalog.tradeoff.image_errors import ImageChanges, _side_by_side, compare_images


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    return Build.plan((cratered_dem(tmp_path_factory.mktemp("dem")),), CONFIG)


@dataclasses.dataclass
class Twin:
    """Images of the same area, stacked: the reference for the sums of `compare_images`."""

    sweeps: dict[str, Sweep]

    @classmethod
    def of(cls, build: Build) -> Twin:
        from lcp_catalog.tradeoff.image_errors import _sweeps

        return cls(_sweeps(tiers(build)))

    def radiance(self, tier: str, view: int) -> np.ndarray:
        return np.stack([i.radiance for i in self.sweeps[tier].images(views=(view,))])

    def lit(self, tier: str) -> tuple[np.ndarray, np.ndarray]:
        """Lit and valid, each (Suns, rows, cols), from shadows and normals alone."""
        sweep = self.sweeps[tier]
        lit = []
        for azimuth in range(2):
            for elevation in np.flatnonzero(sweep.conditions.reachable[:, azimuth]):
                sun = direction_enu(CONFIG.sun.azimuths_deg[azimuth], CONFIG.sun.elevations_deg[elevation])  # fmt: skip
                dark = sweep.field.occluded_nodes(sun, sweep.window)
                lit.append(~dark & (sweep.normals @ sun > 0.0))
        known = np.isfinite(sweep.normals[..., 0])
        return np.stack(lit), np.broadcast_to(known, (len(lit), *known.shape))


def test_flipped_nodes_are_the_error_that_is_reported(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the flipped nodes those that face the Sun change their state; no other node does."""
    faulty(monkeypatch, one_in_a_hundred)
    changes, picture = compare_images(tiers(build))
    twin = Twin.of(build)
    exact, known = twin.lit("reference")
    wrong = ((twin.radiance("draft", 1) > 0.0) != exact) & known
    assert changes["draft"].judged == known.sum()
    assert changes["draft"].wrong == wrong.sum()
    assert 0.006 < changes["draft"].sunlit_error_share < 0.0105  # some face away from the Sun
    for tier in ("standard", "high", "reference"):
        assert changes[tier].wrong == 0
        assert changes[tier].radiance_rmse == 0.0
        assert changes[tier].near_edge_share is None
    assert picture is not None
    assert picture.sun_elevation_deg == 10.0
    assert not any(picture.wrong[tier].any() for tier in ("standard", "high"))
    per_sun = [int(w.sum()) for w in wrong]
    assert picture.wrong_nodes == max(per_sun[0], per_sun[2])  # 10 degrees, east and west


def test_radiance_is_compared_over_nodes_seen_in_both(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    faulty(monkeypatch, one_in_a_hundred)
    changes, _ = compare_images(tiers(build))
    twin = Twin.of(build)
    ours, exact = (
        np.concatenate([twin.radiance(tier, view) for view in (0, 1)]).astype(np.float64)
        for tier in ("draft", "reference")
    )
    both = np.isfinite(ours) & np.isfinite(exact)
    expected = np.sqrt(np.mean((ours[both] - exact[both]) ** 2)) / np.mean(exact[both])
    assert expected > 0.05
    assert changes["draft"].radiance_rmse == pytest.approx(expected, rel=1e-9)


def near_an_edge(dark: np.ndarray, reach: int) -> np.ndarray:
    """Nodes with both states within ``reach`` rows and columns."""
    padded = np.pad(dark, ((0, 0), (reach, reach), (reach, reach)), mode="edge")
    rows, cols = dark.shape[1:]
    steps = range(2 * reach + 1)
    around = [padded[:, i : i + rows, j : j + cols] for i in steps for j in steps]
    return np.max(around, axis=0) != np.min(around, axis=0)


@pytest.mark.parametrize(("near", "share"), [(True, 1.0), (False, 0.0)])
def test_errors_at_a_shadows_edge_are_told_from_others(
    build: Build, near: bool, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Edges are those of the lit terrain; the flipped nodes are two nodes from an edge, or have
    none within five.
    """
    exact, known = Twin.of(build).lit("reference")
    lit = {0: exact[:2], 1: exact[2:]}  # by azimuth: east, west

    def flips(azimuth: float, dark: np.ndarray) -> np.ndarray:
        ours = lit[int(azimuth > 3.0)]
        within = near_an_edge(ours, 2) & ~near_an_edge(ours, 1)
        chosen = within if near else ~near_an_edge(ours, 5) & ours
        return chosen & ~near_an_edge(~known[:2], 5)

    faulty(monkeypatch, flips)
    changes, _ = compare_images(tiers(build))
    assert changes["draft"].wrong > 20
    assert changes["draft"].near_edge_share == share


def test_occlusion_that_differs_is_counted(build: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    occluded = sweep_module.occluded

    def wrong(field: Any, direction: Any, accuracy: Any, window: Any) -> Any:
        hidden = np.zeros_like(occluded(field, direction, TIERS["reference"], window))
        if accuracy.tier == "standard":
            hidden[3, :7] = True
        else:
            hidden[5, :4] = True
        return hidden

    monkeypatch.setattr(sweep_module, "occluded", wrong)
    changes, _ = compare_images(tiers(build))
    size = Twin.of(build).sweeps["reference"].normals[..., 0].size
    assert changes["standard"].visible_error_share == pytest.approx((7 + 4) / (2 * size))
    assert changes["high"].visible_error_share == 0.0


def test_the_bounds_hold_where_nothing_is_wrong(build: Build) -> None:
    """The real tiers: none exceeds its bound; high and reference have no error."""
    changes, _ = compare_images(tiers(build))
    assert changes["high"].wrong == changes["high"].misseen == 0
    for tier, change in changes.items():
        assert change.sunlit_error_share <= TIERS[tier].node_error
        assert change.seconds > 0.0


def test_the_time_of_images_is_processor_time() -> None:
    """Waiting for a busy machine is no work of a tier."""

    def late() -> Iterator[str]:
        time.sleep(0.2)
        yield "image"

    changes = {"draft": ImageChanges()}
    sweep: Any = SimpleNamespace(images=late)
    assert list(_side_by_side({"draft": sweep}, changes)) == [{"draft": "image"}]
    assert changes["draft"].seconds < 0.1
