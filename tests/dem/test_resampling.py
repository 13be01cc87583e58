"""Effect of resampling on heights and slopes, and averages of a cylinder's narrow pixels near a pole.

Judges: analytic surfaces, and means of a product's own pixels over the ground of a cell, taken place by place.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.products import DEGREE_M, RADIUS_M, cylinder, geotiff, hills, ldem_80s
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.dem.grid import Grid
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.tiles import row_lengths

PIXEL_M = 100.0
CELL_M = DEGREE_M / 64.0  # 473.8 m
KEYS_GAIN = 1.25**2
"""Greatest sum of |weights| of Keys' convolution in two dimensions."""


# -- heights and slopes


def waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A surface without wavelengths below 10 pixels of 100 m at x (columns,) and y (rows,); slopes of some 10 degrees rms."""
    rng = np.random.default_rng(11)
    length, turn, phase = np.array(
        [(rng.uniform(1000.0, 8000.0), *rng.uniform(0.0, 2.0 * np.pi, 2)) for _ in range(60)]
    ).T
    k = 2.0 * np.pi / length
    across = k * np.cos(turn) * x[:, None] + phase
    along = k * np.sin(turn) * y[:, None]
    high = 0.004 * length  # sin(a + b) by sines and cosines of a and b
    return np.asarray(
        np.cos(along) * high @ np.sin(across).T + np.sin(along) * high @ np.cos(across).T
    )


@pytest.fixture(scope="module")
def band_limited(tmp_path_factory: pytest.TempPathFactory) -> DemSet:
    """`waves` in float64 on pixels of 100 m around longitude 0.66, latitude 0.66."""
    x = (np.arange(420) + 0.5) * PIXEL_M
    path = tmp_path_factory.mktemp("waves") / "waves.tif"
    return DemSet.open([geotiff(path, waves(x, 42_000.0 - x), 0.0, 42_000.0, PIXEL_M)])


def grid_of(dems: DemSet, cell_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Heights on a lattice of cells that fits the pixels nowhere, and the surface's own there."""
    at = np.arange(4_000.0 + 33.3, 38_000.0, cell_m)
    x, y = at, at[::-1, None]
    return dems.heights(x / DEGREE_M, y / DEGREE_M, cell_m)[0], waves(x, at[::-1])


@pytest.mark.parametrize(
    ("ratio", "height_m", "slope_loss"),
    [
        (0.25, 0.02, 1e-3),
        (1.0, 0.02, 1e-3),
        (1.5, 0.7, 0.012),
        (3.0, 1.6, 0.022),
        (8.0, 16.0, 0.08),
    ],
)
def test_slopes_and_heights_of_a_band_limited_surface(
    band_limited: DemSet, ratio: float, height_m: float, slope_loss: float
) -> None:
    """docs/measurements/inputs.md: rms of the height's error, and how much rms slope of the grid is lost against the
    same differences of the surface itself. Never gained: no detail is made."""
    height, true = grid_of(band_limited, ratio * PIXEL_M)
    assert np.sqrt(np.mean((height - true) ** 2)) <= height_m
    slopes = [
        np.sqrt(np.mean(sum(d**2 for d in np.gradient(z, ratio * PIXEL_M)))) for z in (height, true)
    ]
    assert 1.0 - slope_loss <= slopes[0] / slopes[1] <= 1.0 + 1e-3


def test_no_stair_steps_at_the_posting(band_limited: DemSet) -> None:
    """Seen 4 times finer than its pixels the second difference has no more power at the posting than a thousandth of its own
    (a picture of the pixels has most of it there)."""
    x = np.arange(4_000.0, 38_000.0, 25.0)
    lines = np.linspace(5_000.0, 37_000.0, 25)[:, None]
    z, _ = band_limited.heights(x / DEGREE_M, lines / DEGREE_M, 25.0)

    def posting_share(line: np.ndarray) -> float:
        bend = np.diff(line, 2, axis=-1) * np.hanning(line.shape[-1] - 2)
        power = (np.abs(np.fft.rfft(bend, axis=-1)) ** 2).sum(axis=0)
        frequency = np.fft.rfftfreq(bend.shape[-1], 0.25)  # in cycles a pixel
        return float(power[np.abs(frequency - 1.0) < 0.12].sum() / power.sum())

    steps = np.repeat(z[:, ::4], 4, axis=1)
    assert posting_share(waves(x, lines[:, 0])) < 1e-9
    assert posting_share(z) < 2e-2
    assert posting_share(steps) > 0.2


def test_half_metre_counts(tmp_path: Path) -> None:
    """Rounding to 0.5 m moves a height by at most 0.25 m x 1.5625 (Keys' gain), 0.14 m rms at a pixel; slopes of 20 m cells by
    0.5 / 20 / sqrt 6 rms."""
    dems = DemSet.open([ldem_80s(tmp_path, 200)])
    u, v = np.random.default_rng(3).uniform(10.0, 189.0, (2, 20_000))
    error = dems.heights(*dems.dems[0].grid.lonlat(u, v), 20.0)[0]
    error -= hills(*dems.dems[0].grid.lonlat(u, v))
    assert np.abs(error).max() <= 0.25 * KEYS_GAIN + 0.01
    assert 0.08 < error.std() <= 0.5 / np.sqrt(12.0)


# -- narrow pixels


@pytest.fixture(scope="module")
def noise(tmp_path_factory: pytest.TempPathFactory) -> tuple[DemSet, np.ndarray]:
    """64 pixels a degree, 84..90 north all around, one-pixel noise of 100 m."""
    pixels = np.random.default_rng(5).normal(0.0, 100.0, (384, 23_040)).astype(np.float32)
    path = tmp_path_factory.mktemp("noise") / "noise.tif"
    west = -180.0 * DEGREE_M
    return DemSet.open([geotiff(path, pixels, west, 90.0 * DEGREE_M, CELL_M)]), pixels


def ground_means(pixels: np.ndarray, lon: np.ndarray, lat: np.ndarray, cell_m: float) -> np.ndarray:
    """Brute force: mean of the nearest pixels at 24 x 600 points of each cell's square in its tangent plane."""
    east, north = np.meshgrid(
        ((np.arange(600) + 0.5) / 600 - 0.5) * cell_m, ((np.arange(24) + 0.5) / 24 - 0.5) * cell_m
    )
    out = []
    for o, a in zip(np.radians(lon), np.radians(lat), strict=True):
        radius = RADIUS_M * np.cos(a) - north * np.sin(a)
        rho = np.hypot(radius, east)
        z = RADIUS_M * np.sin(a) + north * np.cos(a)
        lons = np.degrees(o + np.arctan2(east, radius))
        lats = np.degrees(np.arctan2(z, rho))
        rows = np.clip(((90.0 - lats) * 64).astype(int), 0, 383)
        out.append(pixels[rows, ((lons + 180.0) * 64).astype(int) % 23_040].mean())
    return np.array(out)


@pytest.mark.slow
@pytest.mark.parametrize("lat", [85.3, 87.0, 88.5, 89.5, 89.9])
def test_noise_is_averaged_over_the_ground(noise: tuple[DemSet, np.ndarray], lat: float) -> None:
    """One-pixel noise has the spread of true means over the cell's area; sampled without averaging it has 3 to 20 times as
    much."""
    dems, pixels = noise
    rng = np.random.default_rng(int(lat * 10))
    lon = rng.uniform(-180.0, 180.0, 400)
    row_middle = 90.0 - (np.floor((90.0 - lat) * 64) + 0.5) / 64
    judge = ground_means(pixels, lon, np.full(400, row_middle), CELL_M)
    found = dems.heights(lon, row_middle, CELL_M)[0]
    assert found.std() == pytest.approx(judge.std(), rel=0.2)
    if lat < 89.0:  # nearer to the pole a square and a piece of a ring differ
        assert np.corrcoef(found, judge)[0, 1] > 0.9
    raw = dems.heights(lon, row_middle, 1.0)[0]
    assert raw.std() > 2.5 * found.std()


def test_no_step_and_no_spokes(noise: tuple[DemSet, np.ndarray]) -> None:
    """On a polar lattice of half cells from 84.2 degrees on: the spread falls steadily poleward, neighbours stay alike over a cell,
    and
    nothing repeats along meridians beyond a cell."""
    dems, _ = noise
    lat = 84.2 + np.arange(5.6 * 64 * 2) / 128.0
    lon = np.linspace(0.0, 350.0, 60)
    height, _ = dems.heights(lon, lat[:, None], CELL_M)
    spread = np.array([height[k : k + 40].std() for k in range(0, 680, 40)])
    assert (spread[1:] < 1.15 * spread[:-1]).all()
    ratio = spread / (100.0 * np.sqrt(np.cos(np.radians(lat[20:700:40]))))
    assert ratio.max() / ratio.min() < 1.35
    z = height / np.repeat(np.append(spread, spread[-1]), 40)[: lat.size, None]
    z = z - z.mean(axis=0)
    apart = [np.mean(z[k:] * z[: z.shape[0] - k]) / np.mean(z * z) for k in (1, 2, 8, 16, 40)]
    assert apart[0] > 0.5
    assert max(map(abs, apart[2:])) < 0.05


def test_a_plane_through_the_moon_stays(tmp_path: Path) -> None:
    """0.08 of x, y and z of the Moon-fixed frame: averaged over cells of 474 m it moves by less than 3 cm beyond 3 rows of
    the pole, and by less than 2 % of a cell's height around it."""
    half_km = 0.08 * RADIUS_M

    def plane(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        o, a = np.radians(lon), np.radians(lat)
        return half_km * (np.cos(a) * (np.cos(o) + 0.5 * np.sin(o)) + 0.3 * (np.sin(a) - 1.0))

    dems = DemSet.open([cylinder(tmp_path / "p.tif", -180.0, 90.0, (256, 23_040), 64.0, plane)])
    lon = np.random.default_rng(6).uniform(-180.0, 180.0, 20_000)
    lat = np.random.default_rng(7).uniform(86.1, 90.0, 20_000)
    error = np.abs(dems.heights(lon, lat, CELL_M)[0] - plane(lon, lat))
    near = lat > 90.0 - 3.0 / 64
    assert error[~near].max() < 0.03
    assert error[near].max() < 0.02 * CELL_M * 0.08 * np.hypot(1.0, 0.5)


def test_hills_seen_at_the_ground_s_cell(tmp_path: Path) -> None:
    """A smooth surface, cylinder against a polar frame over the pole: within its interpolation's own error."""
    dems = DemSet.open([cylinder(tmp_path / "h.tif", 0.0, 90.0, (128, 5760), 16.0)])
    x, y = np.meshgrid(np.linspace(-1e5, 1e5, 101), np.linspace(-1e5, 1e5, 101))
    lat = np.degrees(np.arccos(np.clip(np.hypot(x, y) / RADIUS_M, 0.0, 1.0)))
    lon = np.degrees(np.arctan2(x, -y))
    raw, seen = (dems.heights(lon, lat, gsd)[0] - hills(lon, lat) for gsd in (1.0, DEGREE_M / 16))
    assert not np.isnan(seen).any()
    assert np.abs(seen).max() < np.abs(raw).max() + 1.0


def test_it_does_not_matter_where_a_file_begins(
    tmp_path: Path, noise: tuple[DemSet, np.ndarray]
) -> None:
    """The same surface in a file of 0..360 instead of -180..180, over its seam and the pole: the same bits, since sums along a
    row are of whole numbers."""
    dems, pixels = noise
    turned = np.roll(pixels, 11_520, axis=1)
    other = DemSet.open([geotiff(tmp_path / "t.tif", turned, 0.0, 90.0 * DEGREE_M, CELL_M)])
    lon = np.concatenate([np.linspace(-0.3, 0.3, 50), np.linspace(179.7, 180.3, 50)])
    for lat in (86.0, 89.0, 89.99):
        one, two = (d.heights(lon, np.full(100, lat), CELL_M)[0] for d in (dems, other))
        np.testing.assert_allclose(one, two, atol=0.02)
        alone = [dems.heights(o, lat, CELL_M)[0] for o in lon]
        np.testing.assert_array_equal(one, alone)


def test_holes_and_ends_of_rows(tmp_path: Path) -> None:
    """A mean is that of the pixels which are there, NaN where less than half are; a part of a ring works like a whole one."""
    heights = np.tile(np.float32([5.0, 9.0]), (64, 320))
    heights[20:40, 300:500] = np.nan
    heights[10, 100] = np.nan
    path = geotiff(tmp_path / "r.tif", heights, 0.0, 86.0 * DEGREE_M, CELL_M)
    dems = DemSet.open([path])
    u, v = np.meshgrid(np.arange(640.0), np.arange(64.0))
    got, _ = dems.heights(*dems.dems[0].grid.lonlat(u, v), CELL_M)
    length = CELL_M / (CELL_M * np.cos(np.radians(86.0 - 30.5 / 64)))  # 12.6 pixels there
    assert np.isnan(got[30, 310:490]).all()
    assert np.isfinite(got[:, : 300 - int(length)]).all()  # one missing pixel is no hole
    gone = np.isnan(got[30])
    assert 200 - 2 <= gone.sum() <= 200 + 2
    np.testing.assert_allclose(got[np.isfinite(got)], 7.0, atol=0.7)


@settings(max_examples=80, deadline=None)
@given(st.floats(0.0, 89.95), st.floats(0.2, 20.0), st.integers(1, 8))
def test_row_lengths(lat: float, ratio: float, factor: int) -> None:
    """The cell's width in pixels on the surface, from 4 pixels on; 1 below 2; steady in latitude. The shrinking is that of the mean
    of cos over the pixels, summed one by one."""
    grid = Grid("equirectangular", 23_040, 11_520, CELL_M, 0.0, 90.0 * DEGREE_M - CELL_M / 2)
    row = int((90.0 - lat) * 64 / factor)
    rows = np.arange(row, row + 3)
    length, turn = row_lengths(grid, rows, factor, ratio * factor * CELL_M)
    at = np.radians(90.0 - (rows + 0.5) * factor / 64.0)
    pixels = ratio / np.cos(at)
    step = factor / 64.0 * np.pi / 180.0
    capped = np.minimum(np.where(pixels >= 4.0, pixels, length), 2.0 / step)
    np.testing.assert_allclose(length, np.maximum(capped, 1.0), rtol=1e-9)
    assert (length[pixels <= 2.0] == 1.0).all()
    assert (length >= 1.0).all()
    assert (length <= np.maximum(pixels, 1.0) + 1e-9).all()
    for n, moved, a in zip(length, turn, at, strict=True):
        half = int((n - 1.0) // 2)
        weight = np.r_[(n - 1.0) / 2.0 - half, np.ones(2 * half + 1), (n - 1.0) / 2.0 - half] / n
        gain = float(weight @ np.cos(np.arange(-half - 1, half + 2) * step))
        want = (1.0 - gain) / np.tan(a) / (factor * CELL_M / MOON_RADIUS_M)
        assert moved == pytest.approx(want, abs=1e-6 + 1e-6 * abs(want))
