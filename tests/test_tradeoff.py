"""``measure_trade``: injected faults come back as what they are, points are counted right, and the page says it all by itself."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import products
import pytest
import synthetic
from pages import parsed

from lcp_catalog import sweep as sweep_module
from lcp_catalog import trade_report, tradeoff
from lcp_catalog.accuracy import TIERS
from lcp_catalog.build import Build
from lcp_catalog.config import (
    AreaConfig,
    BuildConfig,
    ModelConfig,
    PointConfig,
    SunConfig,
    ViewConfig,
)
from lcp_catalog.errors import ConfigError, OutputError, OutputExistsError
from lcp_catalog.evaluate import Evaluation
from lcp_catalog.job import Candidates
from lcp_catalog.landmarks.select import stable_id
from lcp_catalog.schema import EVALUATED, USABLE
from lcp_catalog.shadows import occluded_sweep
from lcp_catalog.sphere import direction_enu
from lcp_catalog.sweep import Sweep
from lcp_catalog.trade_images import compare_images
from lcp_catalog.trade_plot import front, pareto
from lcp_catalog.trade_points import compare_points
from lcp_catalog.trade_runs import TimedArea
from lcp_catalog.tradeoff import Trade, measure_trade, spread

GSD_M = 474.0
CONFIG = BuildConfig(
    area=AreaConfig(center_deg=(1.0, 9.0), size_km=50.0, gsd_m=GSD_M),
    sun=SunConfig((90.0, 270.0), (10.0, 30.0)),
    view=ViewConfig((30.0, 0.0), (90.0, 0.0), (float("inf"),) * 2),
    points=PointConfig(patch_nodes=17, search_m=5000.0),
    model=ModelConfig(direction_tolerance_deg=0.7, ring_max_km=20.0),
)
CONTRACT = {
    "accuracy",
    "seconds",
    "memory_mb",
    "sunlit_error_share",
    "radiance_rmse",
    "points_lost",
    "points_gained",
    "conditions_changed_share",
}


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Craters on 114 km around 1 E 9 N, with a hole of nodata."""
    heights = synthetic.cratered(240, GSD_M, seed=3)
    heights[100:103, 90:96] = -32768.0
    west, north = 1.0 - 120 / 64, 9.0 + 120 / 64
    path = tmp_path_factory.mktemp("dem") / "craters.tif"
    return products.geotiff(
        path,
        heights,
        west * products.DEGREE_M,
        north * products.DEGREE_M,
        products.DEGREE_M / 64,
        nodata=-32768.0,
    )


@pytest.fixture(scope="module")
def build(dem: Path) -> Build:
    return Build.plan((dem,), CONFIG)


def faulty(monkeypatch: pytest.MonkeyPatch, flips: Any, tier: str = "draft") -> None:
    """Every tier traces exactly, but ``tier`` has the shadow of the nodes of ``flips(azimuth, dark)`` the other way round."""

    def wrong(
        field: Any, azimuth: float, elevations: Any, accuracy: Any, window: Any, far: Any
    ) -> Any:
        dark = occluded_sweep(field, azimuth, elevations, TIERS["reference"], window, far)
        if accuracy.tier != tier:
            return dark
        return dark ^ flips(azimuth, dark).astype(np.uint8)

    monkeypatch.setattr(sweep_module, "occluded_sweep", wrong)


def one_in_a_hundred(azimuth: float, dark: np.ndarray) -> np.ndarray:
    return np.random.default_rng(int(1e6 * azimuth) + 1).random(dark.shape) < 0.01


@dataclasses.dataclass
class Twin:
    """The same area's images, stacked: what the sums of `compare_images` are judged by."""

    sweeps: dict[str, Sweep]

    @classmethod
    def of(cls, build: Build) -> Twin:
        from lcp_catalog.trade_images import _sweeps

        return cls(_sweeps(tiers(build)))

    def radiance(self, tier: str, view: int) -> np.ndarray:
        return np.stack([i.radiance for i in self.sweeps[tier].images(views=(view,))])

    def lit(self, tier: str) -> tuple[np.ndarray, np.ndarray]:
        """Lit and known, each (Suns, rows, cols), from shadows and normals alone."""
        sweep = self.sweeps[tier]
        lit = []
        for azimuth in range(2):
            for elevation in np.flatnonzero(sweep.conditions.reachable[:, azimuth]):
                sun = direction_enu(CONFIG.sun.azimuths_deg[azimuth], CONFIG.sun.elevations_deg[elevation])  # fmt: skip
                dark = sweep.field.occluded_nodes(sun, sweep.window)
                lit.append(~dark & (sweep.normals @ sun > 0.0))
        known = np.isfinite(sweep.normals[..., 0])
        return np.stack(lit), np.broadcast_to(known, (len(lit), *known.shape))


def tiers(build: Build) -> dict[str, Any]:
    return {tier: tradeoff._in_tier(build.jobs[0], tier) for tier in TIERS}


def test_flipped_nodes_are_the_error_that_is_reported(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the flipped nodes those that face the Sun change from lit to dark or back; nothing else does."""
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
    """Edges are those of the lit ground: flipped are nodes two from one, or nodes with none within five."""
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
    """The tiers as they are: none beyond its bound, high and reference without an error."""
    changes, _ = compare_images(tiers(build))
    assert changes["high"].wrong == changes["high"].misseen == 0
    for tier, change in changes.items():
        assert change.sunlit_error_share <= TIERS[tier].node_error
        assert change.seconds > 0.0


# -- the whole way


@pytest.fixture(scope="module")
def trade(build: Build) -> Trade:
    """With a draft that is wrong at one node in ten; in this process."""
    patch = pytest.MonkeyPatch()
    faulty(patch, lambda azimuth, dark: np.random.default_rng(5).random(dark.shape) < 0.1)
    try:
        return measure_trade(build, areas=2, rounds=2, isolated=False)
    finally:
        patch.undo()


def test_a_wrong_tier_changes_points_and_the_others_do_not(trade: Trade) -> None:
    rows = {row["accuracy"]: row for row in trade.rows}
    assert list(rows) == ["draft", "standard", "high", "reference"]
    for tier in ("standard", "high", "reference"):
        found = rows[tier]
        nothing = (
            "sunlit_error_share",
            "radiance_rmse",
            "points_lost",
            "points_gained",
            "points_moved",
            "conditions_changed_share",
        )
        assert [found[name] for name in nothing] == [0.0] * len(nothing)
        assert found["localization_sigma_change_m"] == {"median": 0.0, "p95": 0.0}
        assert found["points"] == rows["reference"]["points"] > 0
    wrong = rows["draft"]
    assert wrong["sunlit_error_share"] > 0.06
    assert wrong["points_lost"] > 0
    assert wrong["points"] == rows["reference"]["points"] - wrong["points_lost"] + wrong["points_gained"]  # fmt: skip


def test_the_document_is_the_contracts(trade: Trade) -> None:
    document = json.loads(json.dumps(trade.document(), allow_nan=False))
    for row in document["rows"]:
        assert set(row) >= CONTRACT
        assert row["seconds"] > 0.0
        assert row["memory_mb"] is None  # not measured in one process
        assert row["bound"] == TIERS[row["accuracy"]].node_error
    assert document["rows"][-1]["seconds_relative"] == 1.0
    compared = document["compared"]
    assert (compared["areas"], compared["rounds"], compared["threads"]) == (2, 2, 1)
    assert compared["areas_of"] >= 4
    assert compared["suns"] == [4]
    assert compared["dems"] == ["craters.tif"]


def test_seconds_are_medians_and_tiers_take_turns(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that says what the calls say: the warm-up never counts, and each round begins with another tier."""
    calls: list[tuple[str, str]] = []
    empty = Candidates(*candidates([], []))

    def stand_in(job: Any) -> Any:
        tier = job.config.model.accuracy
        calls.append((job.task.name, tier))
        seen = calls.count(calls[-1])
        warm = 1000.0 if len(calls) <= len(TIERS) else 0.0
        seconds = warm + (2.0 if tier == "draft" else 4.0) * (9.0 if seen == 3 else 1.0)
        return TimedArea(seconds, seconds / 2.0, empty, 1.0, float(len(calls)))

    monkeypatch.setattr(tradeoff, "timed_area", stand_in)
    monkeypatch.setattr(tradeoff, "_images", lambda *_: ({t: tradeoff.ImageChanges() for t in TIERS}, None))  # fmt: skip
    rows = measure_trade(build, areas=2, rounds=3, isolated=False).rows
    assert [row["seconds"] for row in rows] == [4.0, 8.0, 8.0, 8.0]
    assert [row["cpu_seconds"] for row in rows] == [2.0, 4.0, 4.0, 4.0]
    assert [row["seconds_relative"] for row in rows] == [0.5, 1.0, 1.0, 1.0]
    firsts = [tier for _, tier in calls[4::8]]
    assert firsts == ["draft", "standard", "high"]


def test_counts_below_one_are_refused(build: Build) -> None:
    with pytest.raises(ConfigError, match="at least 1"):
        measure_trade(build, areas=0)
    with pytest.raises(ConfigError, match="at least 1"):
        measure_trade(build, rounds=0)


def test_areas_are_spread(build: Build) -> None:
    everything = spread(build, 10_000)
    assert sorted(everything) == list(range(len(build.jobs)))
    assert spread(build, 3) == everything[:3]


def test_the_middle_comes_first_then_what_is_far_away_and_slivers_last() -> None:
    """Five areas on the equator around 2.1 E, of which the middle one is cut to a tenth."""
    tasks = [
        SimpleNamespace(lon_deg=lon, lat_deg=0.0, window=SimpleNamespace(shape=(rows, 10)))
        for lon, rows in ((0.0, 10), (1.0, 10), (2.0, 1), (3.0, 10), (4.5, 10))
    ]
    region = SimpleNamespace(lon_deg=2.1, lat_deg=0.0)
    jobs = [SimpleNamespace(task=task) for task in tasks]
    assert spread(SimpleNamespace(jobs=jobs, region=region), 9) == [3, 0, 4, 1, 2]


# -- points, by hand


def candidates(places: list[tuple[float, float]], states: list[list[int]]) -> list[Any]:
    """Fields of candidates with one view, one azimuth and as many elevations as there are states; sigma 10 m a condition."""
    count = len(places)
    shape = (1, len(states[0]) if states else 2, 1)
    evaluation = Evaluation.empty(count, shape)
    if count:
        evaluation.condition[:, 0, :, 0] = states
        evaluation.sigma_major_m[:] = 10.0
    lon, lat = (np.array([p[k] for p in places], dtype=np.float64) for k in (0, 1))
    patch = np.zeros((count, 3, 3), np.float32)
    return [lon, lat, np.zeros(count), patch, np.zeros(count, np.int16), evaluation]


def test_lost_gained_and_moved_points_by_hand() -> None:
    """Spacing 16 km. A stays, B is lost, C moves by one cell, D is gained; E is a candidate in both and a point in neither."""
    a, b, c, c2, d, e = (0.0, 0.0), (3.0, 0.0), (6.0, 0.0), (6.02, 0.0), (9.0, 0.0), (12.0, 0.0)
    off = EVALUATED
    before = Candidates(
        *candidates([a, b, c, e], [[USABLE, USABLE], [USABLE, off], [USABLE, USABLE], [off, off]])
    )
    states = [[USABLE, USABLE], [off, 0], [USABLE, USABLE], [off, off], [USABLE, off]]
    after = Candidates(*candidates([d, e, c2, b, a], states))
    before.evaluation.sigma_major_m[0, 0, :, 0] = [20.0, 30.0]
    after.evaluation.sigma_major_m[4, 0, :, 0] = [21.0, 99.0]  # 99 where A is not usable any more
    points = PointConfig(spacing_m=16_000.0)
    found = compare_points(before, after, dataclasses.replace(CONFIG, points=points), GSD_M)
    assert (found.points, found.points_lost, found.points_gained, found.points_moved) == (3, 2, 2, 1)  # fmt: skip
    # A, B and E are in both: 2 + 2 + 1 conditions evaluated in both, of which one each of A and B changed
    assert found.conditions_changed_share == pytest.approx(2 / 5)
    assert found.localization_sigma_change_m.median == pytest.approx(9.0)
    assert found.localization_sigma_change_share.p95 == pytest.approx(9.0 / 30.0)


def test_equal_sets_in_another_order_differ_in_nothing() -> None:
    places = [(0.0, 0.0), (3.0, 1.0), (6.0, -1.0)]
    states = [[USABLE, EVALUATED], [USABLE, USABLE], [EVALUATED, USABLE]]
    one = Candidates(*candidates(places, states))
    other = Candidates(*candidates(places[::-1], states[::-1]))
    found = compare_points(one, other, CONFIG, GSD_M)
    assert (found.points, found.points_lost, found.points_gained) == (3, 0, 0)
    assert found.conditions_changed_share == 0.0
    assert len(set(stable_id(one.lon_deg, one.lat_deg).tolist())) == 3


def test_nothing_in_common_has_no_shares() -> None:
    one = Candidates(*candidates([(0.0, 0.0)], [[USABLE, USABLE]]))
    none = Candidates(*candidates([], []))
    found = compare_points(one, none, CONFIG, GSD_M)
    assert (found.points, found.points_lost, found.points_gained) == (0, 1, 0)
    assert found.conditions_changed_share is None
    assert found.localization_sigma_change_m.median is None


# -- the page


def row(accuracy: str, seconds: float, error: float = 0.0, **more: Any) -> dict[str, Any]:
    nothing = {"median": 0.0, "p95": 0.0}
    return {
        "accuracy": accuracy,
        "bound": TIERS[accuracy].node_error,
        "seconds": seconds,
        "seconds_relative": seconds / 10.0,
        "seconds_relative_range": [seconds / 11.0, seconds / 9.0],
        "cpu_seconds": seconds,
        "cpu_relative": seconds / 10.0,
        "render_seconds": seconds / 4.0,
        "render_relative": seconds / 10.0,
        "memory_mb": 400.0,
        "memory_base_mb": 150.0,
        "sunlit_error_share": error,
        "sunlit_error_near_edge_share": 1.0 if error else None,
        "visible_error_share": 0.0,
        "radiance_rmse": error,
        "points": 100,
        "points_lost": 0,
        "points_gained": 0,
        "points_moved": 0,
        "conditions_changed_share": 0.0,
        "localization_sigma_change_m": nothing,
        "localization_sigma_change_share": nothing,
    } | more


def named(sentences: list[str]) -> list[str]:
    return [re.search(r": (\w+)", sentence).group(1) for sentence in sentences]  # type: ignore[union-attr]


def test_advice_follows_its_rules() -> None:
    draft = row("draft", 3.0, 3e-3, points_lost=3, points_gained=2, conditions_changed_share=0.004)
    standard = row("standard", 4.0, 1e-4, points_lost=1, points_gained=1, conditions_changed_share=1e-3)  # fmt: skip
    rows = [draft, standard, row("high", 6.0), row("reference", 10.0)]
    assert named(trade_report.advice(rows)) == ["high", "standard", "draft", "high", "draft"]
    # a tier that saves less than a tenth is not named
    rows[2] = row("high", 9.5)
    assert named(trade_report.advice(rows))[0] == "reference"
    rows[0] = draft | {"cpu_seconds": 3.8}
    assert named(trade_report.advice(rows))[2] == "standard"
    # too many changed conditions are not the same catalogue, however few points are lost
    rows[1] = standard | {"conditions_changed_share": 0.02}
    assert named(trade_report.advice(rows))[1] == "reference"


def test_only_tiers_that_nobody_beats_are_on_the_front() -> None:
    rows = [row("draft", 3.0, 1e-3), row("standard", 12.0, 1e-4), row("high", 6.0), row("reference", 10.0)]  # fmt: skip
    assert [r["accuracy"] for r in front(rows)] == ["draft", "high"]


def test_a_tier_without_errors_stands_below_the_axis() -> None:
    plot = pareto([row("draft", 3.0, 1e-3), row("standard", 5.0, 1e-5), row("high", 6.0), row("reference", 10.0)])  # fmt: skip
    at = [float(y) for y in re.findall(r'class="whole" cx="[^"]*" cy="([^"]*)"', plot)]
    assert at[0] < at[1] < at[2] == at[3]
    left = [float(x) for x in re.findall(r'class="whole" cx="([^"]*)"', plot)]
    assert left == sorted(left)


def test_the_page_needs_nothing_but_itself(trade: Trade) -> None:
    html = trade_report.render_trade(trade)
    page = parsed(html)
    assert not re.search(r"url\(|@import|https?://|<link|<script|<iframe", html)
    assert len(page.addresses) == len(TIERS)
    assert all(address.startswith("data:image/png;base64,") for address in page.addresses)
    assert page.counts["circle"] == 2 * len(TIERS)
    assert page.counts["tr"] == len(trade_report.COLUMNS) + 1 + len(trade.models.rows())
    assert f"2 of {trade.compared['areas_of']} areas" in html
    assert "craters.tif" in html
    assert str(Path.home()) not in html
    assert "nan" not in re.sub(r"base64,[^'\"]*", "", html).lower().split()


def test_pictures_show_which_way_a_node_is_wrong() -> None:
    lit = np.zeros((9, 9), np.int8)
    lit[0, 0] = -1
    wrong = np.zeros((9, 9), np.int8)
    wrong[2, 2], wrong[6, 6] = 1, -1
    pixels = trade_report._wrong_pixels(lit, wrong)
    assert pixels[0, 0, 3] == 0
    over, under = pixels[2, 2].astype(int), pixels[6, 6].astype(int)
    assert over[0] > 2 * over[2]  # red: lit where it should be dark
    assert under[2] > 2 * under[0]
    assert (pixels[1:4, 1:4] == pixels[2, 2]).all()
    assert (pixels[4, 4, :3] == pixels[8, 0, :3]).all()


def test_the_table_has_a_column_a_tier(trade: Trade) -> None:
    text = trade_report.markdown(trade)
    tiers, _, laws = text.partition("\n## ")
    table = [line for line in tiers.splitlines() if line.startswith("|")]
    assert len(table) == len(trade_report.COLUMNS) + 1
    assert len([line for line in laws.splitlines() if line.startswith("|")]) == 2 + len(
        trade.models.rows()
    )
    assert {line.count("|") for line in table} == {len(TIERS) + 2}


def test_files_are_written_and_not_overwritten(trade: Trade, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    trade_report.write_trade(trade, folder)
    assert sorted(p.name for p in folder.iterdir()) == sorted(trade_report.FILES)
    written = json.loads((folder / "trade.json").read_text())
    assert written["advice"] == trade_report.advice(trade.rows)
    with pytest.raises(OutputExistsError, match="--overwrite"):
        trade_report.write_trade(trade, folder)
    trade_report.write_trade(trade, folder, overwrite=True)
    with pytest.raises(OutputError, match="not a folder"):
        trade_report.check_trade_folder(folder / "trade.json", overwrite=True)
    with pytest.raises(OutputError, match="does not exist"):
        trade_report.check_trade_folder(tmp_path / "no" / "where", overwrite=False)
