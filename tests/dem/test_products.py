"""Facts about products: the method's latitudes, published figures, and the agreement of two products."""

from __future__ import annotations

import logging
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from helpers import real_heights
from helpers.products import cylinder, geotiff, hills
from helpers.small_build import CONFIG
from lcp_cli.main import cli

from lcp_catalog.dem.disagreements import disagreements, warn_of_disagreements
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.products import facts_of, is_called, product_name, tie_of
from lcp_catalog.errors import ConfigError, DemError
from lcp_catalog.geometry.bounds import Bounds
from lcp_catalog.production.config import AreaConfig, BuildConfig, DemConfig
from lcp_catalog.production.run import Build


@pytest.mark.parametrize(
    ("identifier", "name", "use", "sigma_m", "resolution_m"),
    [
        # latitudes: Pivovarchuk et al. 2026; 3 to 4 m and 60 m: abstract of Barker et al. 2016
        ("SLDEM2015_512_00N_30N_000_045_FLOAT", "SLDEM2015_512", (0.0, 60.0), 4.0, 60.0),
        ("SLDEM2015_256_0N_60N_000_120", "SLDEM2015_256", (0.0, 60.0), 4.0, 118.5),
        ("SLDEM2015_128_60S_60N_000_360_FLOAT", "SLDEM2015_128", (0.0, 60.0), 4.0, 236.9),
        # about 10 m radial: abstract of Smith et al. 2010
        ("LDEM_512_45N_90N_000_090", "LDEM_512", (60.0, 75.0), 10.0, None),
        ("LDEM_128", "LDEM_128", None, 10.0, None),
        ("LDEM_5120", "LDEM_5120", None, 10.0, None),
        ("ldem_75s_30m", "LDEM_75S_30M", (75.0, 80.0), None, None),
        ("LDEM_80N_20M", "LDEM_80N_20M", (80.0, 85.0), None, None),
        ("LDEM_85S_10M", "LDEM_85S_10M", (85.0, 90.0), None, None),
        ("LDEM_875S_5M", "LDEM_875S_5M", None, None, None),
        ("LDEM_80S_20MPP_ADJ", "LDEM_80S_20MPP_ADJ", (80.0, 85.0), None, None),
        ("LDEM_83S_10MPP_ADJ", "LDEM_83S_10MPP_ADJ", None, None, None),
        # median rms 0.30 to 0.50 m: PGDA product 78
        ("Site01_final_adj_5mpp_surf", "Site01_final_adj_5mpp_surf", None, 0.5, None),
        # 10 to 20 m, close to 300 m: LROC page of the product
        ("WAC_GLD100_E300N0450_256P", "GLD100_256", None, 20.0, 300.0),
        # 1 to 2 m: Burns et al. 2012
        ("NAC_DTM_APOLLO11", "NAC_DTM_APOLLO11", None, 2.0, None),
        ("kaguya_tc", "kaguya_tc", None, None, None),
    ],
)
def test_names_and_figures(
    identifier: str,
    name: str,
    use: tuple[float, float] | None,
    sigma_m: float | None,
    resolution_m: float | None,
) -> None:
    facts = facts_of(product_name(identifier))
    assert product_name(identifier) == name
    assert facts.abs_latitude_use == use
    assert (facts.sigma_m, facts.resolution_m) == (sigma_m, resolution_m)
    assert facts.source


@pytest.mark.parametrize(
    ("product", "tie_m"),
    [
        ("GLD100_064", 30.0),  # 12 to 50 m: Moon Trek's metadata of the WAC mosaic
        # below 10 m horizontally, 1 m vertically: abstract of Barker et al. 2016
        ("SLDEM2015_128", 10.0),
        ("LDEM_512", 10.0),
        ("LDEM_80S_20M", 10.0),
        ("LDEM_80S_20MPP_ADJ", 10.0),
        ("Site01_final_adj_5mpp_surf", 10.0),
        ("NAC_DTM_APOLLO11", 10.0),  # README of the product: tied to LOLA
        ("kaguya_tc", None),
    ],
)
def test_places_of_maps_have_a_source(product: str, tie_m: float | None) -> None:
    tie = tie_of(product)
    assert (tie and tie[0]) == tie_m
    assert tie is None or len(tie[1]) > 40


def test_the_latitudes_of_use_leave_no_gap() -> None:
    names = ("SLDEM2015_512", "LDEM_512", "LDEM_75N_30M", "LDEM_80N_20M", "LDEM_85N_10M")
    spans = [facts_of(name).abs_latitude_use for name in names]
    ends = [lat for span in spans if span for lat in span]
    assert ends == [0.0, 60.0, 60.0, 75.0, 75.0, 80.0, 80.0, 85.0, 85.0, 90.0]


@pytest.mark.parametrize(
    ("product", "name", "meant"),
    [
        ("LDEM_80S_20M", "ldem_80s_20m", True),
        ("LDEM_80S_20M", "LDEM_80S", True),
        ("LDEM_80S_20M", "LDEM_POLAR", True),
        ("LDEM_80S_20M", "LDEM_80", False),
        ("SLDEM2015_512", "SLDEM2015", True),
        ("SLDEM2015_512", "LDEM", False),
        ("LDEM_512", "LDEM_51", False),
    ],
)
def test_what_a_name_means(product: str, name: str, meant: bool) -> None:
    assert is_called(product, name) is meant


class TestDisagreement:
    BOX = Bounds(10.0, 20.0, 14.0, 24.0)

    @staticmethod
    def pair(folder: Path, first: str, second: str, offset_m: float, tilt_m: float = 0.0) -> DemSet:
        """Two products of hills; the second higher by an offset and by up to ``tilt_m`` more."""

        def higher(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
            return hills(lon, lat) + offset_m + tilt_m * np.sin(np.radians(90.0 * lon))

        made: list[tuple[str, Callable]] = [(first, hills), (second, higher)]
        return DemSet.open(
            [cylinder(folder / f"{n}.tif", 9.0, 25.0, (192, 192), 32.0, s) for n, s in made]
        )

    @pytest.mark.parametrize(("offset_m", "found"), [(31.5, 0), (33.0, 1), (-33.0, 1)])
    def test_beyond_three_sigma_of_the_difference(
        self, tmp_path: Path, offset_m: float, found: int
    ) -> None:
        """SLDEM2015 4 m and LDEM_512 10 m: 3 hypot(4, 10) = 32.31 m."""
        dems = self.pair(tmp_path, "SLDEM2015_512", "LDEM_512", offset_m)
        seen = disagreements(dems, self.BOX)
        assert len(seen) == found
        if found:
            assert seen[0].products == ("SLDEM2015_512", "LDEM_512")
            assert seen[0].median_m == pytest.approx(33.0, abs=0.2)
            assert seen[0].limit_m == pytest.approx(32.311, abs=0.01)
            assert seen[0].places > 900
            assert seen[0].assumed == ()

    def test_single_places_do_not_count(self, tmp_path: Path) -> None:
        """A wave of 60 m, whose median size is 60 / sqrt 2."""
        dems = self.pair(tmp_path, "SLDEM2015_512", "SLDEM2015_256", 0.0, 20.0)
        assert disagreements(dems, self.BOX) == []  # 14 m against 3 hypot(4, 4) = 17 m

    def test_one_warning_with_figures_and_names(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        dems = self.pair(tmp_path, "mine", "LDEM_512", 100.0)
        with caplog.at_level(logging.WARNING, "lcp_catalog"):
            warn_of_disagreements(dems, self.BOX)
        assert len(caplog.records) == 1
        text = caplog.records[0].getMessage()
        assert "mine and LDEM_512 differ by 100.0 m" in text
        assert "42.4 m" in text  # 3 hypot(10, 10)
        assert "that of mine is not published: 10 m assumed" in text

    def test_agreement_and_a_box_elsewhere_are_silent(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        warn_of_disagreements(self.pair(tmp_path, "mine", "LDEM_512", 5.0), self.BOX)
        warn_of_disagreements(
            self.pair(tmp_path, "mine", "LDEM_512", 500.0), Bounds(100.0, 20.0, 104.0, 24.0)
        )
        assert caplog.records == []


class TestShift:
    """Two files of real ground, of which one lies elsewhere."""

    WHOLE = Bounds(0.0, 20.0, 10.0, 30.0)

    @staticmethod
    def cut(path: Path, cols: slice, east_m: float = 0.0, north_m: float = 0.0) -> Path:
        with rasterio.open(real_heights.SAMPLE) as file:
            heights, affine = file.read(1)[600:1600, cols], file.transform
        at = rasterio.Affine.translation(east_m, north_m) * affine
        x0, y0 = at * (cols.start, 600)
        return geotiff(path, heights, x0, y0, affine.a)

    @pytest.mark.slow
    @pytest.mark.parametrize("shared", [1000, 20])  # columns of 118 m
    @pytest.mark.parametrize(
        ("east_m", "north_m", "says"),
        [
            (500.0, 0.0, r"lies 4[45]\d \+- "),  # of the map: 453 m at 25 N
            (0.0, 237.0, r"GLD100_256P_b.tif lies 23\d \+- "),  # whole pixels: one lattice
            (
                -300.0,
                300.0,
                r"lies 40\d \+- \d m apart \(fitted to \d+ places\), beyond the 1[23]\d m",
            ),
        ],
    )
    def test_ground_that_lies_elsewhere_is_said(
        self, shared: int, east_m: float, north_m: float, says: str, tmp_path: Path
    ) -> None:
        one = self.cut(tmp_path / "GLD100_256P_a.tif", slice(200, 1200))
        other = self.cut(
            tmp_path / "GLD100_256P_b.tif", slice(1200 - shared, 2200 - shared), east_m, north_m
        )
        (found,) = disagreements(DemSet.open([one, other]), self.WHOLE)
        assert re.search(says, str(found)), str(found)

    def test_a_plan_of_several_levels_says_it(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        """Before the work, at whose end levels of one build are merged whatever their heights are."""
        one = self.cut(tmp_path / "GLD100_256P_a.tif", slice(200, 1200))
        other = self.cut(tmp_path / "GLD100_256P_b.tif", slice(200, 1200), 500.0)
        area = {"area.gsd_m": None, "area.levels_m": (474.0, 948.0)}
        build = Build.plan([one, other], CONFIG.replaced(area))
        assert len(build.levels) == 2
        assert re.search(r"the ground of .* lies 4[45]\d \+- \d m apart", caplog.text)

    def test_what_errors_of_place_explain_is_silent(self, tmp_path: Path) -> None:
        one = self.cut(tmp_path / "GLD100_256P_a.tif", slice(200, 1200))
        other = self.cut(tmp_path / "GLD100_256P_b.tif", slice(200, 1200), 60.0, 60.0)
        assert disagreements(DemSet.open([one, other]), self.WHOLE) == []

    @pytest.mark.slow
    @pytest.mark.parametrize("seed", range(8))
    def test_real_products_agree_about_the_place(
        self, seed: int, ldem_4: Path, shared_data: Path
    ) -> None:
        """GLD100 and LOLA, of 1.9 and 7.6 km."""
        dems = DemSet.open(
            [shared_data / "dem/gld100/gld100_016ppd_global.tif", ldem_4 / "LDEM_4.LBL"]
        )
        dice = np.random.default_rng(seed)
        west, south, size = (
            dice.uniform(-180.0, 160.0),
            dice.uniform(-70.0, 50.0),
            dice.choice([5.0, 20.0]),
        )
        assert disagreements(dems, Bounds(west, south, west + size, south + size)) == []


class TestOrderIsHandedThrough:
    """``--product-order`` from the command line to the heights, and through a build's configuration."""

    @pytest.fixture
    def two(self, tmp_path: Path) -> tuple[Path, ...]:
        return tuple(
            cylinder(tmp_path / f"{name}.tif", 9.0, 25.0, (64, 64), 16.0, surface)
            for name, surface in (
                ("high", lambda o, a: 0.0 * o + 9.0),
                ("low", lambda o, a: 0.0 * o + 1.0),
            )
        )

    @pytest.mark.parametrize(
        ("order", "height_m"), [(None, 9.0), ("low", 1.0), ("LOW.tif,high", 1.0)]
    )
    def test_render(
        self, two: tuple[Path, ...], tmp_path: Path, order: str | None, height_m: float
    ) -> None:
        out = tmp_path / "out.tif"
        flags = ["--center", "11", "23", "--size", "20", "--sun-azimuth", "90"]
        flags += ["--sun-elevation", "30", "-o", str(out)]
        flags += [] if order is None else ["--product-order", order]
        done = CliRunner().invoke(cli, ["render", *map(str, two), *flags])
        assert done.exit_code == 0, done.output
        with rasterio.open(out) as dataset:
            height = dataset.read(7)
        middle = height[tuple(n // 2 for n in height.shape)]
        assert middle == pytest.approx(height_m, abs=0.5)

    def test_build(self, two: tuple[Path, ...]) -> None:
        config = BuildConfig.from_dict({"dem": {"product_order": ["low"]}})
        assert config.dem.product_order == ("low",)
        assert BuildConfig.from_dict(tomllib.loads(config.to_toml())) == config
        area = AreaConfig(center_deg=(11.0, 23.0), size_km=20.0)
        wrong = replace(config, area=area, dem=DemConfig(("middle",)))
        with pytest.raises(DemError, match="matches middle; products given: high, low"):
            Build.plan(two, wrong)
        Build.plan(two, replace(config, area=area))
        with pytest.raises(ConfigError, match=r"dem\.product_order must be a list of texts"):
            BuildConfig.from_dict({"dem": {"product_order": "low"}})
