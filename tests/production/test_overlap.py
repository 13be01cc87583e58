"""Catalogues of the same ground that contradict each other are not merged; honest ones are."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import merges, real_heights
from helpers.merges import written
from scipy.ndimage import gaussian_filter

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.model import Overview
from lcp_catalog.errors import CatalogError
from lcp_catalog.geometry.map_plane import EQUIRECTANGULAR, ORTHOGRAPHIC, POLAR_STEREOGRAPHIC
from lcp_catalog.production.merging import MergedMaps, merge_catalogs
from lcp_catalog.production.overlap import Agreement, MergedPart, agreement, near_pairs
from lcp_catalog.terrain.area import Area

pytestmark = pytest.mark.usefixtures("unchecked")


def relief(catalog: Catalog, change: Any, *parts: str) -> Catalog:
    """The catalogue with changed heights: of the overview, of the patches, or of both."""
    dem, view = catalog.dem, catalog.overview
    dem = change(dem) if "patches" in parts else dem
    height = change(view.height) if "overviews" in parts else view.height
    return replace(catalog, dem=dem, overview=replace(view, height=height))


CONTRADICTIONS = {
    "mirrored": lambda z: z[..., ::-1],
    "upside down": lambda z: -z,
    "in kilometres": lambda z: z / 1e3,
}


def compared(one: Catalog, other: Catalog) -> Agreement:
    """As a merge compares them, without the files."""
    region = [Area.from_bounds(2.1, 24.9, 4.9, 27.1)]
    return agreement(MergedPart(one, region), MergedPart(other, region))


@pytest.mark.slow
@pytest.mark.parametrize("what", ["overviews", "patches"])
@pytest.mark.parametrize("change", CONTRADICTIONS)
def test_contradicting_heights_of_the_same_ground_are_found(
    what: str, change: str, inputs: list[Catalog]
) -> None:
    sigma = {**inputs[1].errors, "height_sigma_m": 2.0}
    one, other = (replace(each, errors=sigma) for each in inputs)
    other = relief(other, CONTRADICTIONS[change], what)
    says = rf"its heights differ by .* places of the {what}\), beyond"
    for pair in ((one, other), (other, one)):
        assert re.match(says, compared(*pair).fault)


@pytest.mark.slow
def test_contradicting_catalogues_are_refused_in_any_order(
    inputs: list[Catalog], tmp_path: Path
) -> None:
    paths = written(tmp_path, [inputs[0], relief(inputs[1], lambda z: z + 1e4, "overviews")])
    for order in (paths, paths[::-1]):
        with pytest.raises(CatalogError, match=r"cannot be merged with .*: its heights") as raised:
            merge_catalogs(order, tmp_path / "m.h5")
        assert "\n" not in str(raised.value)
    assert not (tmp_path / "m.h5").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("away_m", "merged"), [(80.0, True), (110.0, False)])
def test_what_the_errors_explain_is_merged(
    away_m: float, merged: bool, inputs: list[Catalog], tmp_path: Path
) -> None:
    """Three sigmas of a difference of two errors of 20 m, as published of GLD100, are 85 m."""
    other = relief(inputs[1], lambda z: z + np.float32(away_m), "overviews")
    products = (
        np.full(len(inputs[0]), "GLD100_256", object),
        np.full(len(other), "GLD100_256", object),
    )
    stated = [
        replace(one, dem_product=names)
        for one, names in zip((inputs[0], other), products, strict=True)
    ]
    paths = written(tmp_path, stated)
    if merged:
        merge_catalogs(paths, tmp_path / "m.h5")
    else:
        with pytest.raises(CatalogError, match=r"differ by 110\.0 m .* beyond the \d\d\.\d m"):
            merge_catalogs(paths, tmp_path / "m.h5")


Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]


def showing(
    catalog: Catalog, surface: Surface, east_m: float = 0.0, north_m: float = 0.0, up_m: float = 0.0
) -> Catalog:
    """The catalogue with an overview of a surface that lies elsewhere."""
    view = catalog.overview
    lon, lat = view.plane.lonlat(*np.meshgrid(view.x, view.y))
    degree_m = np.radians(1.0) * 1_737_400.0
    height = surface(lon - east_m / degree_m / np.cos(np.radians(lat)), lat - north_m / degree_m)
    errors = {**catalog.errors, "position_sigma_m": 38.0, "height_sigma_m": 40.0}
    view = replace(view, height=(height + up_m).astype(np.float32))
    return replace(catalog, overview=view, errors=errors)


@cache
def other_product(seed: int) -> Surface:
    """Hadley as another survey would have it: half as sharp, with errors of 15 m alike over 500 m and 8 m over 12 km."""
    dice = np.random.default_rng(seed)

    def errors(sigma_m: float, length_px: float) -> np.ndarray:
        made = gaussian_filter(dice.normal(size=(640, 640)), length_px)
        return np.asarray(sigma_m * made / made.std())

    error = errors(15.0, 1.0) + errors(8.0, 25.0) + 5.0

    def surface(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        away = [(i / 64.0, j / 64.0) for i in (-0.7, 0.7) for j in (-0.7, 0.7)]
        blurred = sum(real_heights.hadley(lon + i, lat + j) for i, j in away) / 4.0
        return np.asarray(blurred + real_heights.bilinear(error, lon * 63.0, (lat - 20.0) * 63.0))

    return surface


@pytest.mark.slow
def test_levels_of_one_build_are_merged_as_they_are(inputs: list[Catalog], tmp_path: Path) -> None:
    """Their DEMs were compared when it was planned, before the work."""
    west, east = (
        showing(one, real_heights.hadley, up_m=up)
        for one, up in zip(inputs, (0.0, 500.0), strict=True)
    )
    paths = written(tmp_path, [west, east])
    with pytest.raises(CatalogError, match="differ"):
        merge_catalogs(paths, tmp_path / "m.h5")
    merge_catalogs(paths, tmp_path / "m.h5", of_one_build=True)


SHIFTS = [
    ({"east_m": 474.0}, r"the same ground lies 4[67]\d \+- \d+ m apart \(fitted to \d+ places of the overviews\), beyond"),
    ({"north_m": -237.0}, r"the same ground lies 2[234]\d \+- \d+ m apart"),
    ({"up_m": 100.0}, r"its heights differ throughout by (9\d|10\d)\.\d \+- \d+\.\d m"),
]  # fmt: skip


SURFACES: dict[str, Callable[[], Surface]] = {
    "same DEM": lambda: real_heights.hadley,
    "another product": lambda: other_product(1),
}


@pytest.mark.slow
@pytest.mark.parametrize(("shift", "says"), SHIFTS)
@pytest.mark.parametrize("product", SURFACES)
def test_ground_that_lies_elsewhere_is_found(
    shift: dict[str, float], says: str, product: str, inputs: list[Catalog]
) -> None:
    """A cell of GLD100 or a half, and 100 m up; in any order."""
    west = showing(inputs[0], real_heights.hadley)
    east = showing(inputs[1], SURFACES[product](), **shift)
    for pair in ((west, east), (east, west)):
        assert re.match(says, compared(*pair).fault)


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3))])
def test_honest_products_of_the_same_ground_are_merged(
    seed: int, inputs: list[Catalog], tmp_path: Path
) -> None:
    """Also if each lies as far off as errors of place and published errors allow."""
    east = showing(inputs[1], other_product(seed), east_m=75.0, north_m=-75.0, up_m=25.0)
    west = showing(inputs[0], real_heights.hadley)
    merge_catalogs(written(tmp_path, [west, east]), tmp_path / "m.h5")


def test_heights_of_lola_and_of_images_are_merged(inputs: list[Catalog], ldem_4: Path) -> None:
    """Two real surveys: GLD100 and LOLA's LDEM_4, of cells of 7.6 km; not if its map is moved by two of them."""
    lola = np.fromfile(ldem_4 / "LDEM_4.IMG", "<i2").reshape(720, 1440) / 2.0
    region = [Area.from_bounds(0.5, 20.5, 9.5, 29.5)]

    def lola_at(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        return real_heights.bilinear(lola, lon * 4.0 - 0.5, (90.0 - lat) * 4.0 - 0.5)

    def part(surface: Surface, step_m: float, east_m: float = 0.0) -> MergedPart:
        axis = step_m * np.arange(-int(76e3 / step_m), int(76e3 / step_m) + 1)
        view = inputs[0].overview
        view = replace(view, x=axis, y=axis[::-1], height=np.zeros((len(axis), len(axis))))
        wide = replace(inputs[0].take(np.zeros(0, int)), overview=view)
        return MergedPart(showing(wide, surface, east_m), region)

    images = part(real_heights.hadley, 1900.0)
    assert agreement(images, part(lola_at, 7600.0)).fault == ""
    assert "apart" in agreement(images, part(lola_at, 7600.0, -15_200.0)).fault


@pytest.mark.parametrize("pairs", [6, pytest.param(40, marks=pytest.mark.slow)])
def test_flat_noise_has_no_place(pairs: int, inputs: list[Catalog]) -> None:
    """What fits best by chance is no shift: of 40 pairs of plains that differ by noise none is refused."""
    region = [Area.from_bounds(2.1, 24.9, 4.9, 27.1)]
    dice = np.random.default_rng(7)

    def plain(_: np.ndarray, lat: np.ndarray) -> np.ndarray:
        return np.asarray(dice.normal(0.0, 15.0, lat.shape))

    for width in (8, 60) * (pairs // 2):
        view = inputs[0].overview
        some = (slice(20, 20 + width),) * 2
        view = replace(view, x=view.x[some[1]], y=view.y[some[0]], height=view.height[some])
        one, other = (
            MergedPart(showing(replace(inputs[0], overview=view), plain), region) for _ in range(2)
        )
        assert agreement(one, other).fault == ""


def strip(inputs: list[Catalog], columns: int, surface: Surface, **shift: float) -> list[Catalog]:
    """Catalogues that share so many columns of their overviews, of 450 m, and have no points; of different files."""
    view = inputs[0].overview
    middle = len(view.x) // 2
    parts = (
        (slice(0, middle + columns), real_heights.hadley, {}),
        (slice(middle, None), surface, shift),
    )
    found = []
    for own, ground, moved in parts:
        whole = showing(inputs[0].take(np.zeros(0, int)), ground, **moved)
        height = np.full_like(whole.overview.height, np.nan)
        height[:, own] = whole.overview.height[:, own]
        files = [{"name": "a.tif", "size": 1, "sha256": str(len(found)) * 64}]
        found.append(replace(whole, overview=replace(view, height=height), sources=files))
    return found


@pytest.mark.parametrize("product", SURFACES)
@pytest.mark.parametrize(
    "shift", [{"east_m": 474.0}, {"north_m": 474.0}, {"east_m": -335.0, "north_m": 335.0}]
)
def test_a_strip_of_shared_ground_shows_a_shift(
    shift: dict[str, float], product: str, inputs: list[Catalog]
) -> None:
    """Four columns of 450 m; blocks of a broad area would hold too few places each."""
    fault = compared(*strip(inputs, 4, SURFACES[product](), **shift)).fault
    assert re.match(r"the same ground lies \d+ \+- \d+ m apart \(fitted to \d{3} places", fault)


@pytest.mark.parametrize("columns", [1, 2])
def test_what_a_small_overlap_does_not_show(columns: int, inputs: list[Catalog]) -> None:
    """Also of ground that is shifted; not of catalogues from the same files."""
    one, other = strip(inputs, columns, real_heights.hadley, east_m=474.0)
    found = compared(one, other)
    assert found.fault == ""
    assert found.unseen.startswith("a shift of the ground of any size could not be seen: ")
    assert re.search(r"\d places of the overviews are too few, or too flat", found.unseen)
    assert compared(one, replace(other, sources=one.sources)) == ("", "")


@pytest.mark.slow
def test_what_a_merge_could_not_see_is_said(
    inputs: list[Catalog], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shifted = strip(inputs, 1, real_heights.hadley, east_m=474.0)
    same = [replace(one, sources=shifted[0].sources) for one in shifted]
    merge_catalogs(written(tmp_path, same, "p"), tmp_path / "same.h5")
    assert caplog.text == ""
    merge_catalogs(written(tmp_path, shifted), tmp_path / "m.h5")
    (record,) = caplog.records
    says = record.getMessage()
    assert ".h5, but a shift of the ground of any size could not be seen: " in says


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3, 4, 5))]
)
def test_honest_products_agree_whatever_they_share(seed: int, inputs: list[Catalog]) -> None:
    for columns in (2, 3, 4, 6):
        one, other = strip(
            inputs, columns, other_product(seed), east_m=75.0, north_m=-75.0, up_m=25.0
        )
        other = replace(other, sources=one.sources)  # what could not be seen is not asked
        assert compared(one, other).fault == ""


def test_heights_of_other_ground_are_not_compared(inputs: list[Catalog], tmp_path: Path) -> None:
    west = merges.part(merges.whole(), 2.1, 3.0)
    east = merges.part(merges.whole(), 4.0, 4.9)
    half, x = west.overview.height.copy(), west.overview.x
    half[:, x > 0.0] = np.nan
    flipped = np.where(x > 0.0, -east.overview.height, np.nan).astype(np.float32)
    west = replace(west, overview=replace(west.overview, height=half))
    east = replace(east, overview=replace(east.overview, height=flipped))
    merge_catalogs(written(tmp_path, [west, east]), tmp_path / "m.h5")


TILES = [
    (0.0, 0.0, 30e3, ORTHOGRAPHIC),
    (1.5, 0.5, 30e3, ORTHOGRAPHIC),
    (2.0, 0.0, 32e3, ORTHOGRAPHIC),
    (359.0, 1.0, 30e3, ORTHOGRAPHIC),
    (180.0, 1.0, 200e3, ORTHOGRAPHIC),
    (20.0, 89.5, 60e3, ORTHOGRAPHIC),
    (200.0, 89.0, 60e3, ORTHOGRAPHIC),
    (0.0, 90.0, 900e3, POLAR_STEREOGRAPHIC),
    (50.0, 0.0, 1600e3, EQUIRECTANGULAR),
]
"""Longitude, latitude and half side (m) of regions at the meridian, at its other side and at a pole."""


def tiles(inputs: list[Catalog]) -> list[MergedPart]:
    """Overviews of the regions, each of other files and with two points in opposite corners."""
    found = []
    for lon, lat, half_m, projection in TILES:
        axis = np.linspace(-half_m, half_m, 41)
        height = np.random.default_rng(int(half_m)).normal(0.0, 10.0, (41, 41)).astype(np.float32)
        view = Overview(height, axis, axis[::-1], lon, lat, projection)
        corners = np.array([-0.98, 0.98]) * half_m
        some = merges.moved(inputs[0][:2], *view.plane.lonlat(corners, corners))
        files = [{"name": "a.tif", "size": 1, "sha256": f"{len(found):064x}"}]
        region = Area.from_bounds(lon - 1.0, max(lat - 1.0, -90.0), lon + 1.0, min(lat + 1.0, 90.0))
        found.append(MergedPart(replace(some, overview=view, sources=files), [region]))
    return found


@pytest.mark.slow
def test_only_pairs_of_other_ground_are_left_out(inputs: list[Catalog]) -> None:
    """Against the comparison of every pair, either way round."""
    parts = tiles(inputs)
    pairs = set(near_pairs(parts))
    every = list(itertools.combinations(range(len(parts)), 2))
    shown = {
        (one, other)
        for one, other in every
        if agreement(parts[one], parts[other]) != Agreement()
        or agreement(parts[other], parts[one]) != Agreement()
    }
    assert len(shown) > len(TILES)
    assert shown <= pairs
    assert len(pairs) < len(every) * 2 / 3


@pytest.mark.slow
def test_an_overview_is_that_of_all_parts(
    inputs: list[Catalog], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The places that a part is not asked for are none that it shows."""
    for some in (TILES[:4], TILES[5:8], TILES):
        parts = [tiles(inputs)[TILES.index(one)] for one in some]
        fast = MergedMaps(parts).overview().height
        with monkeypatch.context() as patch:
            patch.setattr(MergedPart, "near", lambda part, place: np.ones(len(place), bool))
            slow = MergedMaps(parts).overview().height
        assert np.isfinite(fast).any()
        np.testing.assert_array_equal(fast, slow)
