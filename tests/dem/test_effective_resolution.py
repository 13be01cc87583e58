"""Effective resolution of DEMs: synthetic terrain with a known point spread, noise or
interpolation, and real products.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.catalogs import HADLEY
from helpers.products import DEGREE_M, geotiff
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.constants import MOON_RADIUS_M, SIGMA_PER_FWHM
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.effective_resolution import Heights, of_file, of_windows, sample_windows
from lcp_catalog.dem.grid import Grid
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.raster import Gridded
from lcp_catalog.terrain.area import Area
from lcp_catalog.terrain.terrain import terrain_from_area

GSD_M = 100.0
HALF_WAVE = np.pi * SIGMA_PER_FWHM / np.sqrt(2.0 * np.log(2.0))
"""Half of the wavelength that a Gaussian halves, in units of its full width: exp(-2 (pi s /
wave)^2) = 1/2. It is 1.13.
"""


def true_resolution(heights_m, gsd_m):
    """Effective resolution of heights on a grid, steps down and across or both alike."""
    down, across = np.broadcast_to(gsd_m, 2).tolist()
    return of_windows([Heights(np.asarray(heights_m, float), (down, across))], max(down, across))


LEVEL, WAVE_M = 5.6e-5, 10e3
"""Power times k^4 at waves of 10 km, as in the far-side highlands of GLD100."""


def ground(rows, cols, exponent, seed, fwhm_m=0.0, gsd_m=GSD_M):
    """Heights with the spectrum LEVEL k^-4 (k WAVE_M)^(4 - exponent), smoothed by a Gaussian; not
    periodic.
    """
    rng = np.random.default_rng(seed)
    shape = (2 * rows, 2 * cols)
    down, across = (np.fft.fftfreq(n, gsd_m) for n in shape)
    k = np.hypot(down[:, None], across[None])
    k[0, 0] = 1.0 / WAVE_M
    power = LEVEL * k**-4.0 * (k * WAVE_M) ** (4.0 - exponent)
    power[0, 0] = 0.0
    height = np.sqrt(power) / gsd_m * np.exp(-2.0 * (np.pi * SIGMA_PER_FWHM * fwhm_m * k) ** 2)
    return np.fft.ifft2(np.fft.fft2(rng.normal(size=shape)) * height).real[:rows, :cols]


@settings(deadline=None, max_examples=4, derandomize=True)
@given(st.floats(3.2, 4.4), st.floats(220.0, 900.0), st.integers(0, 10_000))
def test_a_known_point_spread_is_found(exponent, fwhm_m, seed):
    """On 320 x 260 nodes, whatever the law of the ground in the range of the Moon's: within an
    eighth (the worst of 120 was 11 % off).
    """
    found = true_resolution(ground(320, 260, exponent, seed, fwhm_m), GSD_M)
    assert found.resolution_m == pytest.approx(HALF_WAVE * fwhm_m, rel=0.125)
    assert found.point_spread_m == pytest.approx(fwhm_m, rel=0.125)
    assert found.low_m <= found.resolution_m <= found.high_m
    assert found.high_m < 1.8 * found.low_m
    assert "waves of" in found.how


@settings(deadline=None, max_examples=4, derandomize=True)
@given(st.floats(3.2, 4.5), st.integers(0, 10_000))
def test_ground_that_is_all_there_has_its_posting(exponent, seed):
    found = true_resolution(ground(280, 280, exponent, seed), GSD_M)
    assert found.resolution_m < 1.03 * GSD_M
    assert found.exponent == pytest.approx(
        exponent, abs=0.45
    )  # on one tile; the worst of 120 was 0.36 off
    if found.resolution_m == GSD_M:
        assert found.point_spread_m == 0.0
        assert "down to the posting" in found.how


@settings(deadline=None, max_examples=8, derandomize=True)
@given(
    st.integers(20, 140), st.integers(20, 140), st.floats(2.0, 6.0), st.floats(0.0, 2000.0), st.integers(0, 999)
)  # fmt: skip
def test_never_below_the_posting(rows, cols, exponent, fwhm_m, seed):
    found = true_resolution(ground(rows, cols, exponent, seed, fwhm_m), GSD_M)
    assert found.low_m >= GSD_M
    assert found.resolution_m >= GSD_M
    assert found.posting_m == GSD_M


def test_cells_that_are_means_of_their_ground_have_their_posting():
    fine = ground(880, 880, 4.0, 3)
    coarse = fine.reshape(220, 4, 220, 4).mean(axis=(1, 3))
    assert true_resolution(coarse, 4 * GSD_M).resolution_m <= 1.05 * 4 * GSD_M


@pytest.mark.parametrize("how", [cv2.INTER_LINEAR, cv2.INTER_CUBIC])
@pytest.mark.parametrize("times", [3, 4])
def test_oversampling_adds_nothing(how, times):
    """A DEM of 400 m that was interpolated onto finer nodes resolves 400 m; what interpolation
    makes up of shorter waves is taken for ground to a sixth.
    """
    fine = cv2.resize(
        ground(220, 220, 4.0, 3, gsd_m=400.0), None, fx=times, fy=times, interpolation=how
    )
    assert true_resolution(fine, 400.0 / times).resolution_m == pytest.approx(400.0, rel=0.16)


@pytest.mark.parametrize("noise_m", [10.0, 30.0])
def test_noise_that_outweighs_the_ground_limits_it(noise_m):
    """White noise s has the power s^2 step^2 at every wave, the terrain LEVEL k^-4: equal at k =
    (LEVEL / s^2 step^2)^(1/4).
    """
    z = ground(360, 360, 4.0, 2)
    equal = (LEVEL / (noise_m * GSD_M) ** 2) ** 0.25
    noisy = z + np.random.default_rng(0).normal(scale=noise_m, size=z.shape)
    found = true_resolution(noisy, GSD_M)
    assert found.resolution_m == pytest.approx(0.5 / equal, rel=0.12)
    assert "noise" in found.how


def test_rounding_to_metres_is_the_noise_that_it_is():
    """A step of 1 m is 0.29 m of noise; it does not change the resolution of a smooth DEM."""
    z = ground(320, 320, 4.0, 5, 400.0)
    found = true_resolution(np.round(z), GSD_M)
    assert found.resolution_m == pytest.approx(HALF_WAVE * 400.0, rel=0.12)


def test_lines_of_a_cylinder_far_from_the_equator():
    """Nodes at half the distance along the parallel: the same terrain has the same resolution, and
    the posting is the larger step.
    """
    z = ground(300, 600, 4.0, 8, 500.0, gsd_m=50.0)[::2]
    found = true_resolution(z[:, :600], (100.0, 50.0))
    assert found.posting_m == 100.0
    assert found.resolution_m == pytest.approx(HALF_WAVE * 500.0, rel=0.12)


def test_noise_on_cells_that_are_not_square():
    """The power of white noise is its variance times the cell's area."""
    z = ground(300, 600, 4.0, 8, gsd_m=50.0)[::2]
    noisy = z + np.random.default_rng(1).normal(scale=25.0, size=z.shape)
    found = true_resolution(noisy, (100.0, 50.0))
    equal = (LEVEL / (25.0**2 * 100.0 * 50.0)) ** 0.25
    assert found.resolution_m == pytest.approx(0.5 / equal, rel=0.12)


def test_a_tilt_and_a_level_change_nothing():
    z = ground(200, 200, 4.0, 9, 400.0)
    y, x = np.mgrid[:200, :200]
    plain = true_resolution(z, GSD_M)
    tilted = true_resolution(z + 3.0 * x - 20.0 * y + 5000.0, GSD_M)
    assert tilted.resolution_m == pytest.approx(plain.resolution_m, rel=0.01)


def test_gaps_are_stepped_around():
    z = ground(320, 320, 4.0, 4, 400.0)
    z[100:130, 140:150] = np.nan
    assert true_resolution(z, GSD_M).resolution_m == pytest.approx(HALF_WAVE * 400.0, rel=0.12)


@pytest.mark.parametrize(
    "heights",
    [
        np.zeros((100, 100)),
        np.full((100, 100), np.nan),
        np.arange(900.0).reshape(30, 30),
        np.where(np.indices((120, 120)).sum(axis=0) % 9 == 0, np.nan, 1.0),
    ],
    ids=["level", "empty", "small", "full of holes"],
)
def test_what_cannot_tell_says_so(heights):
    found = true_resolution(heights, GSD_M)
    assert found.resolution_m == GSD_M
    assert found.high_m == np.inf
    assert "too few" in found.how or "level" in found.how


def test_cells_so_wide_that_the_moons_own_law_bends_cannot_tell(ldem_4):
    """LDEM_4: waves of 15 km and more; their spectrum falls with k^-2, which is not an effect of
    the DEM.
    """
    z = np.fromfile(ldem_4 / "LDEM_4.IMG", "<i2").reshape(720, 1440)[240:480] * 0.5
    found = true_resolution(z, 7580.8)
    assert found.resolution_m == 7580.8
    assert "too few" in found.how


# -- real products


def test_gld100_resolves_about_a_kilometre():
    """Published resolution: 1 to 1.5 km (Scholten et al. 2012, J. Geophys. Res. 117, E00H17), on
    cells of 118 m.
    """
    found = of_file(Dem.open(HADLEY))
    assert found.posting_m < 119.0
    assert 650.0 < found.resolution_m < 1500.0


def test_the_cells_of_the_same_ground_hardly_matter():
    """The resolution is the same at 118 m and at 237 m."""
    dems = DemSet.open([HADLEY])
    area = Area(3.4, 26.0, 100.0)
    fine, coarse = (terrain_from_area(dems, area, gsd).field for gsd in (None, 237.0))
    fine_m, coarse_m = (true_resolution(f.z_m, f.gsd_m).resolution_m for f in (fine, coarse))
    assert coarse_m == pytest.approx(fine_m, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    "file",
    [
        "dem/gld100/gld100_256ppd_taurus-littrow_lat17-24_lon027-035.tif",
        "dem/gld100/gld100_256ppd_giordano-bruno_lat33-39_lon099-107.tif",
        "images/apollo15-metric-farside/gld100_064ppd_lat-28_-13_lon132-155.tif",
        "images/apollo16-metric-series/gld100_064ppd_lat-16_-02_lon-01_020.tif",
    ],
)
def test_gld100_elsewhere(shared_data, file):
    assert 650.0 < of_file(Dem.open(shared_data / file)).resolution_m < 1500.0


# -- files


def test_a_file_of_one_window_is_its_own_heights(tmp_path):
    z = ground(300, 280, 4.0, 5, 400.0).astype(np.float32)
    path = geotiff(tmp_path / "dem.tif", z, 0.0, 15_000.0, GSD_M)
    assert of_file(Dem.open(path)) == true_resolution(z, (GSD_M, GSD_M * np.cos(0.0)))


def test_a_file_that_is_written_again_is_measured_again(tmp_path):
    path = tmp_path / "dem.tif"
    for fwhm_m in (300.0, 600.0):
        z = ground(320, 320, 4.0, 6, fwhm_m).astype(np.float32)
        geotiff(path, z, 0.0, 16_000.0, GSD_M)
        found = of_file(Dem.open(path))
        assert found.resolution_m == pytest.approx(HALF_WAVE * fwhm_m, rel=0.125)
        path.unlink()


@pytest.mark.slow
@pytest.mark.parametrize("north_m", [700e3, 2_150e3])
def test_pixels_of_a_cylinder_far_from_the_equator_are_measured_on_the_surface(tmp_path, north_m):
    """At 71 deg a pixel of 100 m is 33 m wide: means of three are about square. The ground has a
    point spread of 500 m on the surface, whatever the map.
    """
    rows, wide = 400, 1600
    narrow = np.cos((north_m - 0.5 * rows * GSD_M) / MOON_RADIUS_M)
    step = GSD_M * narrow
    across = ground(rows, wide, 4.0, 8, 500.0, gsd_m=GSD_M)
    columns = np.arange(int(wide * GSD_M / step) - 2) * narrow
    low = columns.astype(int)
    share = columns - low
    z = (across[:, low] * (1.0 - share) + across[:, low + 1] * share).astype(np.float32)
    found = of_file(Dem.open(geotiff(tmp_path / "dem.tif", z, 0.0, north_m, GSD_M)))
    assert found.resolution_m == pytest.approx(HALF_WAVE * 500.0, rel=0.15)
    assert found.posting_m == GSD_M


def test_windows_with_other_relief_count_alike(tmp_path):
    """The spectrum of a file is the geometric mean over its windows: ground a hundred times as rough
    in one of them does not decide.
    """
    quiet, rough = ground(200, 400, 4.0, 1, 700.0), 100.0 * ground(200, 400, 4.0, 2, 250.0)
    windows = [Heights(z, (GSD_M, GSD_M)) for z in (quiet, quiet[::-1], quiet[:, ::-1], rough)]
    pooled = of_windows(windows, GSD_M).resolution_m
    alone = [of_windows([w], GSD_M).resolution_m for w in windows]
    assert abs(np.log(pooled / alone[0])) < 0.5 * abs(np.log(alone[3] / alone[0]))


class Endless(Gridded):
    """A product of any size; windows that were read are noted."""

    def __init__(self, grid: Grid) -> None:
        self.grid, self.path, self.raster, self.windows = grid, HADLEY, self, []

    def read(self, row0, row1, col0, col1):
        self.windows.append((row0, row1, col0, col1))
        return np.zeros((row1 - row0, col1 - col0), np.float32)


@pytest.mark.parametrize("per_degree", [4, 64, 512])
def test_a_global_product_is_read_in_part(per_degree):
    """At most 16 windows of a million cells, none beyond 75 deg, some on both sides of the equator."""
    pixel_m = DEGREE_M / per_degree
    height, width = 180 * per_degree, 360 * per_degree
    grid = Grid(
        "equirectangular", width, height, pixel_m, 0.5 * pixel_m, 90 * DEGREE_M - 0.5 * pixel_m
    )
    endless = Endless(grid)
    cells = [window.z_m.size for window in sample_windows(endless)]
    assert 4 <= len(cells) <= 16
    assert max(cells) <= 1024**2
    rows = np.array([window[:2] for window in endless.windows]) / per_degree
    assert rows.min() >= 15.0 - 1.0 / per_degree
    assert rows.max() <= 165.0 + 1.0 / per_degree
    assert (rows[:, 0] < 90.0).any()
    assert (rows[:, 1] > 90.0).any()
    assert len(set(endless.windows)) == len(endless.windows)


def test_a_small_file_is_read_whole():
    grid = Grid("polar-stereographic", 2000, 1500, 20.0, -19_990.0, 14_990.0, 0.0, -90.0)
    endless = Endless(grid)
    steps = [window.steps_m for window in sample_windows(endless)]
    held = np.zeros((1500, 2000), bool)
    for row0, row1, col0, col1 in endless.windows:
        held[row0:row1, col0:col1] = True
    assert held.all()
    np.testing.assert_allclose(steps, 20.0, rtol=1e-3)
