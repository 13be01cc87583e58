"""Made fine DEMs of the ground around Hadley for docs/tutorial/descent.md: build/descent/made_59m.tif, made_30m.tif,
made_15m.tif, and the map of their height errors, made_sigma.tif.

The relief below 1 km is MADE, not Hadley's: the sample's DEM, whose heights are continued here, does not resolve it. It is the
sum of

- craters in equilibrium: 5 % of the geometric saturation, which is 1.54 D^-2 craters larger than D (Gault 1970; equilibrium at
  a few percent: Minton et al. 2019), from 45 to 900 m; 0.02 to 0.2 D deep, the latter when fresh (Pike 1977); a rim of a fifth
  of the depth that falls with the cube of the distance (McGetchin et al. 1973);
- a self-affine surface: height spectrum k^-3.9 (Hurst exponent 0.95, Rosenburg et al. 2011), as high as that of the sample at
  waves of 2 to 8 km, higher where the sample is rough; less the waves that the sample shows.

All is blended into the sample's heights over the outer 2 km.
"""

from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.windows import Window
from scipy import ndimage

from lcp_catalog._package_files import sample_folder

SAMPLE = sample_folder() / "hadley_gld100_256ppd.tif"
FOLDER = Path("build/descent")
RADIUS_M = 1737.4e3
LON_DEG, LAT_DEG = 3.6, 26.1  # of the landing site
SEED = 26
WIDE, AROUND = (
    144,
    32,
)  # half the side of the widest DEM and its margin in the work, pixels of the sample
DEMS = ((59, 2, WIDE, 2.0), (30, 4, 64, 1.0), (15, 8, 32, 0.5))
"""Of each: metres of a pixel in its name, pixels along one of the sample, half its side in pixels of the sample, 1 sigma of its
heights in metres (stereo of narrow-angle images: 1 to 2 m at finer pixels, Burns et al. 2012)."""
FINEST = DEMS[-1][1]
SHORTEST_M, EXPONENT = (
    2000.0,
    3.9,
)  # wave of which the sample shows a quarter of the power; fall of the spectrum
SATURATION, SHARE = 1.54, 0.05
CRATERS_KM = 0.045, 0.9
BORDER_M = 2000.0

Array = NDArray[np.float64]


def waves(shape: tuple[int, ...], step_m: float) -> Array:
    """Wavenumbers of `np.fft.rfft2`, cycles per metre."""
    return np.hypot(np.fft.fftfreq(shape[0], step_m)[:, None], np.fft.rfftfreq(shape[1], step_m))


def shown(k: Array) -> Array:
    """Share of the power at a wavenumber that the sample shows."""
    return 1.0 / (1.0 + 3.0 * (k * SHORTEST_M) ** 4)


def power(heights: Array, step_m: float) -> float:
    """A of the spectrum A k^-3.9 of heights at waves of 2 to 8 km."""
    taper = np.outer(*(np.hanning(n) for n in heights.shape))
    tapered = (heights - heights.mean()) * taper / np.sqrt(np.mean(taper**2))
    found = np.abs(np.fft.rfft2(tapered)) ** 2 * step_m**2 / heights.size
    k = waves(heights.shape, step_m)
    some = (k > 1 / 8000) & (k < 1 / 2000)
    return float(np.exp(np.mean(np.log(found[some] / shown(k[some]) * k[some] ** EXPONENT))))


def self_affine(
    shape: tuple[int, ...], step_m: float, a: float, dice: np.random.Generator
) -> Array:
    """A Gaussian surface of the spectrum A k^-3.9, less what the sample shows of it."""
    k = np.maximum(waves(shape, step_m), 1e-9)
    root = np.sqrt(a * k**-EXPONENT * (1.0 - shown(k))) / step_m
    return np.fft.irfft2(np.fft.rfft2(dice.normal(size=shape)) * root, shape)


def craters(shape: tuple[int, ...], step_m: float, dice: np.random.Generator) -> Array:
    """Heights of craters at random places."""
    most, least = (d**-2.0 for d in CRATERS_KM)
    count = dice.poisson(SATURATION * SHARE * (most - least) * np.prod(shape) * (step_m / 1e3) ** 2)
    width = 1e3 * (most - dice.random(count) * (most - least)) ** -0.5
    depth = width * dice.uniform(0.02, 0.2, count)
    out = np.zeros(shape)
    for (row, col), d, deep in zip(dice.random((count, 2)) * shape, width, depth, strict=True):
        reach = int(1.5 * d / step_m) + 1
        top, left = max(int(row) - reach, 0), max(int(col) - reach, 0)
        here = out[top : int(row) + reach, left : int(col) + reach]
        rows, cols = np.ogrid[top : top + here.shape[0], left : left + here.shape[1]]
        r = np.hypot(rows - row, cols - col) * step_m / (0.5 * d)
        bowl, rim = deep * (r**2 - 0.8), 0.2 * deep * np.maximum(r, 1.0) ** -3
        here += np.where(r < 1.0, bowl, np.where(r < 3.0, rim, 0.0))
    return out


def made(coarse: Array, step_m: float, dice: np.random.Generator) -> Array:
    """The sample's heights of the widest DEM and its margin, finer, with the made relief."""
    side = 2 * WIDE * FINEST
    place = (np.arange(side) + 0.5) / FINEST - 0.5 + AROUND
    at = np.meshgrid(place, place, indexing="ij")

    def finer(values: Array, order: int) -> Array:
        return ndimage.map_coordinates(values, at, order=order)

    short = coarse - ndimage.gaussian_filter(coarse, 8.0)
    rough = finer(np.sqrt(ndimage.gaussian_filter(short**2, 16.0)), 1)
    rough = np.clip(rough / np.sqrt(np.mean(short**2)), 0.3, 1.5)
    fine_m = step_m / FINEST
    relief = rough * self_affine((side, side), fine_m, power(coarse, step_m), dice)
    relief += craters((side, side), fine_m, dice)
    edge = np.minimum(np.arange(side), np.arange(side)[::-1]) * fine_m / BORDER_M
    share = np.clip(np.minimum(edge[:, None], edge), 0.0, 1.0)
    share = share**2 * (3.0 - 2.0 * share)
    smooth = finer(ndimage.gaussian_filter(coarse, 3.0), 3)
    return finer(coarse, 3) * (1.0 - share) + share * (smooth + relief)


def write(name: str, values: Array, to_map: rasterio.Affine, crs: rasterio.CRS) -> None:
    """A GeoTIFF of heights or their errors, metres."""
    about = {"count": 1, "dtype": "float32", "crs": crs, "transform": to_map, "compress": "deflate"}
    height, width = values.shape
    with rasterio.open(FOLDER / name, "w", "GTiff", width, height, **about) as file:
        file.write(values.astype(np.float32), 1)


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    with rasterio.open(SAMPLE) as sample:
        site = np.radians([LON_DEG, LAT_DEG]) * RADIUS_M
        col, row = (round(v) for v in ~sample.transform @ site)
        half = WIDE + AROUND
        window = Window(col - half, row - half, 2 * half, 2 * half)
        coarse = sample.read(1, window=window).astype(float)
        to_map, crs, step_m = sample.transform, sample.crs, sample.transform.a
    heights = made(coarse, step_m, np.random.default_rng(SEED))
    sigma = np.zeros((2 * WIDE, 2 * WIDE))
    for metres, times, half, error_m in DEMS:
        corner = to_map @ rasterio.Affine.translation(col - half, row - half)
        first, side = (WIDE - half) * FINEST, 2 * half * times
        own = heights[first : len(heights) - first, first : len(heights) - first]
        own = own.reshape(side, FINEST // times, side, FINEST // times).mean(axis=(1, 3))
        write(f"made_{metres}m.tif", own, corner @ rasterio.Affine.scale(1.0 / times), crs)
        sigma[WIDE - half : WIDE + half, WIDE - half : WIDE + half] = error_m
    corner = to_map @ rasterio.Affine.translation(col - WIDE, row - WIDE)
    write("made_sigma.tif", sigma, corner, crs)


if __name__ == "__main__":
    main()
