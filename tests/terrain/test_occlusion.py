"""Error bounds of the tiers, checked with exact rays; these are checked by brute force in
test_heightfield_occluded.

Bounds of `accuracy.TIERS`: draft at most 0.5 % of the nodes, 95 % of them within two nodes of a
shadow's edge; standard at most 0.02 %; high none, on any terrain.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.synthetic import cratered
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.kernels.shadows import scan_lines
from lcp_catalog.terrain import occlusion
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.occlusion import (
    LIKELY,
    PROVED,
    Effort,
    hybrid_occluded,
    occluded,
    occluded_sweep,
)
from lcp_catalog.threads import limit_threads, thread_limit

AZIMUTHS = (0, 17, 45, 77, 100, 143, 200, 270, 300, 339)
ELEVATIONS = (0.5, 2, 5, 15)

quick = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


KINDS = ("noise", "steps", "walk", "spikes", "plane", "smooth")


def terrain(rng: np.random.Generator) -> Heightfield:
    """A small terrain of any kind: noise, steps, walks, spikes on a plain, tilted planes, at all
    heights, with and without nodata.
    """
    shape, kind = tuple(rng.integers(2, 60, 2)), rng.choice(KINDS)
    if kind == "noise":
        z = rng.normal(size=shape) * rng.choice([0.01, 1.0, 100.0])
    elif kind == "steps":
        z = rng.integers(0, 3, shape).astype(float)
    elif kind == "walk":
        z = np.cumsum(rng.normal(size=shape), axis=1) + rng.choice([0.0, 2e4])
    elif kind == "spikes":
        z = np.where(rng.random(shape) < 0.02, rng.choice([5.0, 80.0, -30.0], shape), 0.0)
    elif kind == "plane":
        slopes = rng.integers(-2, 3, 2)
        z = np.add.outer(slopes[0] * np.arange(shape[0]), slopes[1] * np.arange(shape[1]))
    else:
        z = 5.0 * np.outer(np.sin(np.arange(shape[0]) / 3), np.cos(np.arange(shape[1]) / 4))
    z = z.astype(np.float32)
    z[rng.random(shape) < rng.choice([0.0, 0.0, 0.01, 0.1, 0.4])] = np.nan
    return Heightfield(z, float(rng.choice([0.5, 1.0, 20.0])))


def towards(rng: np.random.Generator, hair: bool) -> np.ndarray:
    """Any direction, often along rows, columns, diagonals or through nodes (or, with ``hair``, very
    close to them), often grazing.
    """
    if rng.random() < 0.3:
        direction = rng.integers(-3, 4, 3).astype(float)
        return direction if direction.any() else np.array([1.0, 0.0, 0.0])
    beside = 45.0 * rng.integers(0, 8) + (rng.choice([1e-7, -1e-9, 1e-9, 1e-12]) if hair else 0.0)
    azimuth = rng.choice(
        [rng.uniform(0, 360), 45.0 * rng.integers(0, 8), 26.56505117707799, beside]
    )
    elevation = rng.choice([rng.uniform(-5, 60), rng.uniform(0, 8), 0.0, 1e-6, 45.0, 89.9, 90.0])
    return direction_enu(azimuth, elevation)


def scene(rng: np.random.Generator) -> tuple[Heightfield, np.ndarray, tuple[int, ...]]:
    """A terrain, a direction and a window, in half of the cases all nodes."""
    field = terrain(rng)
    row0, col0 = (int(rng.integers(0, n)) for n in field.shape)
    row1, col1 = (
        int(rng.integers(row0, field.shape[0])) + 1,
        int(rng.integers(col0, field.shape[1])) + 1,
    )
    window = (row0, row1, col0, col1) if rng.random() < 0.5 else field.whole
    # very close to a node beside nodata `reference` itself takes the node for the edge
    return field, towards(rng, not field.has_holes), window


scenes = st.integers(0, 2**32 - 1).map(lambda seed: scene(np.random.default_rng(seed)))


class Craters:
    """A cratered highland under many Suns: exact masks and those of a tier."""

    def __init__(self) -> None:
        self.field = Heightfield(cratered(384), 20.0)
        self.exact = np.array(
            [[self.field.occluded_nodes(direction_enu(a, e)) for e in ELEVATIONS] for a in AZIMUTHS]
        )

    def swept(self, tier: str) -> np.ndarray:
        elevations = np.radians(ELEVATIONS)
        sweeps = [
            occluded_sweep(self.field, math.radians(a), elevations, TIERS[tier]) for a in AZIMUTHS
        ]
        return np.array(sweeps).astype(bool)


@pytest.fixture(scope="module")
def craters() -> Craters:
    return Craters()


class TestDraft:
    @pytest.mark.slow
    def test_wrong_nodes_are_few_under_every_sun(self, craters):
        share = (craters.swept("draft") != craters.exact).mean(axis=(2, 3))
        assert share.max() <= TIERS["draft"].node_error
        assert share.max() > 0.1 * TIERS["draft"].node_error  # the bound is not far too wide

    def test_wrong_nodes_lie_at_the_edges_of_shadows(self, craters):
        wrong = craters.swept("draft") != craters.exact
        edge = np.zeros_like(craters.exact)
        for di in range(-2, 3):
            for dj in range(-2, 3):
                edge |= np.roll(craters.exact, (di, dj), (2, 3)) != craters.exact
        assert (wrong & edge).sum() >= 0.95 * wrong.sum()

    def test_fewer_lines_would_not_keep_the_bound(self, craters, monkeypatch):
        """Without the stencil the bound is exceeded."""
        none = (np.zeros((1, 4), np.int64), np.zeros((1, 3)))  # an edge of no effect
        monkeypatch.setattr(scan_lines, "near_stencil", lambda *_: none)
        share = (craters.swept("draft") != craters.exact).mean(axis=(2, 3))
        assert share.max() > TIERS["draft"].node_error

    def test_what_is_skipped_under_a_high_sun_is_lit(self, craters, monkeypatch):
        """Skipping stretches without a steep facet in reach only corrects nodes."""
        rng, cases = np.random.default_rng(3), []
        # nearly flat except for a hill of 900 m off the middle, steeper than every ray here
        row, col = np.ogrid[:768, :512]
        hill = np.maximum(900.0 - 30.0 * np.hypot(row - 500.0, col - 200.0), 0.0)
        patch = 0.03 * np.tile(cratered(64), (12, 8)) + hill
        fields = [craters.field, Heightfield(patch, 20.0), *(terrain(rng) for _ in range(40))]
        for field in fields:
            for elevation in (8.0, 20.0, 35.0, 50.0):
                cases.append((field, direction_enu(rng.uniform(0, 360), elevation)))
        skipping = [occluded(field, towards, TIERS["draft"]) for field, towards in cases]
        asleep = 0
        awake = occlusion.SunAhead.awake

        def all_awake(sun, slope, width):
            nonlocal asleep
            found = awake(sun, slope, width)
            asleep += int((~found).sum())
            return np.ones_like(found)

        monkeypatch.setattr(occlusion.SunAhead, "awake", all_awake)
        for (field, direction), mask in zip(cases, skipping, strict=True):
            differs = mask != occluded(field, direction, TIERS["draft"])
            assert not (mask[differs] | field.occluded_nodes(direction)[differs]).any()
        assert asleep > 50  # something was skipped at all

    def test_nodata_casts_nothing(self):
        z = np.zeros((40, 40), np.float32)
        z[10:20, 10:20] = np.nan
        field = Heightfield(z, 1.0)
        z = z.copy()
        z[30, 30] = 1e-6  # so that the field is not recognised as flat
        rough = Heightfield(z, 1.0)
        for azimuth in range(0, 360, 30):
            for hollow in (field, rough):
                args = math.radians(azimuth), [0.01, 0.5], TIERS["draft"]
                assert not occluded_sweep(hollow, *args).any()
        empty = Heightfield(np.full((9, 9), np.nan), 1.0)
        assert not occluded_sweep(empty, 1.0, [0.1], TIERS["draft"]).any()

    def test_more_suns_than_one_pass_and_the_zenith(self):
        field = Heightfield(cratered(48), 20.0)
        elevations = np.radians(np.append(np.linspace(1, 60, 19), 90.0))
        together = occluded_sweep(field, 2.0, elevations, TIERS["draft"])
        for k, elevation in enumerate(elevations):
            alone = occluded_sweep(field, 2.0, [elevation], TIERS["draft"])[0]
            assert (together[k] == alone).mean() > 0.999  # float32 counts from other rows
        assert not together[-1].any()
        assert (np.diff(together.astype(int), axis=0) <= 0).all()  # a higher Sun lights more

    @quick
    @given(st.integers(0, 359), st.data())
    def test_a_window_is_a_part_of_the_whole(self, azimuth, data):
        field = Heightfield(cratered(64), 20.0)
        row0, col0 = data.draw(st.integers(0, 63)), data.draw(st.integers(0, 63))
        window = row0, data.draw(st.integers(row0, 64)), col0, data.draw(st.integers(col0, 64))
        args = math.radians(azimuth), np.radians([1, 10]), TIERS["draft"]
        whole = occluded_sweep(field, *args)[:, window[0] : window[1], window[2] : window[3]]
        part = occluded_sweep(field, *args, window)
        assert part.shape == whole.shape
        assert (part != whole).sum() <= 0.01 * part.size  # float32 counts from other rows


class TestStandard:
    def test_wrong_nodes_are_very_few_under_every_sun(self, craters):
        share = (craters.swept("standard") != craters.exact).mean(axis=(2, 3))
        assert share.max() <= TIERS["standard"].node_error

    def test_wrong_nodes_are_dark(self, craters):
        """Nodes that are lit by the proved upper bound are lit."""
        assert not (~craters.swept("standard") & craters.exact).any()

    def test_on_a_lunar_dem_at_low_suns(self, craters):
        """Half and twice the craters' relief: other statistics than those of its calibration."""
        for relief in (0.3, 2.0):
            field = Heightfield(cratered(384, seed=5, relief_m=relief), 20.0)
            for azimuth in (33, 160):
                direction = direction_enu(azimuth, 2.0)
                wrong = occluded(field, direction, TIERS["standard"]) != field.occluded_nodes(
                    direction
                )
                assert wrong.mean() <= TIERS["standard"].node_error

    def test_with_lines_farther_apart_it_would_not(self, craters):
        """One line per column is wrong at more than 0.02 % of the nodes in some scene."""
        worst = 0.0
        for a, azimuth in enumerate(AZIMUTHS):
            for e, elevation in enumerate(ELEVATIONS):
                ray = craters.field.ray_in_cells(direction_enu(azimuth, elevation))
                mask, _ = hybrid_occluded(
                    craters.field, ray, craters.field.whole, Effort(1, 0, False)
                )
                worst = max(worst, (mask != craters.exact[a, e]).mean())
        assert worst > TIERS["standard"].node_error


class TestHigh:
    @settings(quick, max_examples=200)
    @given(scenes)
    def test_is_exact_on_any_terrain(self, case):
        field, direction, window = case
        np.testing.assert_array_equal(
            occluded(field, direction, TIERS["high"], window),
            field.occluded_nodes(direction, window),
        )

    @pytest.mark.slow
    def test_search_for_counter_examples(self):
        """Forty thousand scenes, twenty million nodes: no bound is violated."""
        for seed in range(40_000):
            field, direction, window = scene(np.random.default_rng(seed))
            np.testing.assert_array_equal(
                occluded(field, direction, TIERS["high"], window),
                field.occluded_nodes(direction, window),
                err_msg=f"seed {seed}",
            )

    def test_is_exact_on_craters(self, craters):
        np.testing.assert_array_equal(craters.swept("high"), craters.exact)

    def test_traces_few(self, craters):
        """The bounds decide almost all nodes."""
        for effort, share in ((PROVED, 0.01), (LIKELY, 0.015)):
            ray = craters.field.ray_in_cells(direction_enu(77, 5))
            _, traced = hybrid_occluded(craters.field, ray, craters.field.whole, effort)
            assert 0 < traced < share * craters.exact[0, 0].size

    def test_slacks_cover_float32(self):
        """Without slacks rounding decides ties: Sun along the slope of a plane."""
        rows, cols = np.mgrid[:60, :60]
        field = Heightfield((0.7 * rows + 0.1 * cols).astype(np.float32) + 1e4, 1.0)
        direction = np.array([0.3, 1.0, 0.03 - 0.7])
        direction = direction / np.linalg.norm(direction)
        np.testing.assert_array_equal(
            occluded(field, direction, TIERS["high"]), field.occluded_nodes(direction)
        )

    def test_without_slack_it_would_be_wrong(self, monkeypatch):
        monkeypatch.setattr(occlusion, "slacks", lambda *_: (-1e-2, -1e-2))
        field = Heightfield(cratered(96, relief_m=0.01), 20.0)
        wrong = 0
        for azimuth in AZIMUTHS:
            direction = direction_enu(azimuth, 0.05)
            wrong += (
                occluded(field, direction, TIERS["high"]) != field.occluded_nodes(direction)
            ).sum()
        assert wrong > 0


class TestEveryTier:
    @pytest.mark.parametrize("tier", TIERS)
    def test_threads_do_not_matter(self, tier):
        field = Heightfield(cratered(300), 20.0)
        with limit_threads(1):
            one = occluded_sweep(field, 0.6, np.radians([1, 5, 20]), TIERS[tier])
        with limit_threads(thread_limit()):
            many = occluded_sweep(field, 0.6, np.radians([1, 5, 20]), TIERS[tier])
        np.testing.assert_array_equal(one, many)

    @pytest.mark.parametrize("tier", TIERS)
    @quick
    @given(case=scenes)
    def test_nodata_is_never_dark(self, tier, case):
        field, direction, _ = case
        assert not occluded(field, direction, TIERS[tier])[np.isnan(field.z_m)].any()

    @pytest.mark.parametrize("tier", TIERS)
    @pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1)])
    def test_without_cells_nothing_hides(self, tier, shape):
        field = Heightfield(np.arange(math.prod(shape)).reshape(shape), 1.0)
        for direction in ([1, 0, -1], [0, 1, 0.1], [0, 0, 1]):
            assert not occluded(field, direction, TIERS[tier]).any()

    @pytest.mark.parametrize("tier", TIERS)
    def test_one_direction_is_the_sweep_of_one(self, craters, tier):
        swept = occluded_sweep(craters.field, math.radians(40), [math.radians(3)], TIERS[tier])[0]
        alone = occluded(craters.field, direction_enu(40, 3), TIERS[tier])
        assert (alone != swept).mean() < 1e-4  # the angles are rounded once more

    @pytest.mark.parametrize("tier", TIERS)
    def test_bad_arguments(self, tier):
        field = Heightfield(np.zeros((3, 3)), 1.0)
        for elevations in ([-math.pi / 2], [math.nan], [2.0]):
            with pytest.raises(ValueError, match="elevations"):
                occluded_sweep(field, 0.0, elevations, TIERS[tier])
        with pytest.raises(ValueError, match="azimuth"):
            occluded_sweep(field, math.inf, [0.1], TIERS[tier])
        with pytest.raises(ValueError, match="direction"):
            occluded(field, [0, 0, 0], TIERS[tier])
        with pytest.raises(ValueError, match="window"):
            occluded(field, [0, 1, 1], TIERS[tier], (0, 4, 0, 3))
