"""Effective resolution of a DEM, estimated from the spectrum of its heights.

It belongs to the file: it is estimated once for each, at its own posting, over fixed windows
(`effective_resolution`), and does not depend on an image, an area or a catalogue.

The posting of stereo models and filtered products is often finer than their resolution. The height
spectrum of natural terrain follows one power law over many octaves (on the Moon about k^-4 in two
dimensions: Rosenburg et al. 2011, J. Geophys. Res. 116, E02001, Hurst exponents near 1 at these
scales). A spectrum that falls below the power law of its long waves has lost detail. The fitted
model is

    P(k) = A k^-b M(k)^2 + N,      M(k)^2 = 1 / (1 + 3 (k/c)^4)   or   exp(-ln 4 (k/c)^2)

N is the flat level of rounding and noise. The first M describes heights estimated with a penalty on
curvature, as in dense matching; the second is a Gaussian point spread; the better fit is used. M is
1/2 at k = c. The resolution is half of that wavelength: the largest cell that represents it. If
noise exceeds the signal at longer waves already, the resolution is half of the wavelength at which
both are equal. It is never below the posting.

Representative windows of a DEM file: a fixed lattice of them, so that what is measured in them
belongs to the file alone, and a global product is read in part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Float32
from ..constants import MOON_RADIUS_M, SIGMA_PER_FWHM
from .raster import Gridded

WINDOW_PX = 1024
"""Greatest side of a window, pixels."""

ACROSS, DOWN = 4, 4
"""Greatest numbers of windows across and down; a file that fewer windows cover is read whole."""

_ROWS_DEG = 12.0
"""Greatest height of a window of a cylinder, over which the width of its pixels changes."""

_FURTHEST_DEG = 75.0
"""Absolute latitude up to which a cylinder is sampled if it reaches nearer to the equator."""

_NARROWEST = 16
"""Greatest number of pixels of a cylinder that are averaged along a row to make cells square."""


class Heights(NamedTuple):
    """Heights (rows, cols) of a window, metres, NaN without one, and the distances of its nodes on
    the surface, (down, across) in metres; the file's first row, and how many of its pixels are averaged along a row.
    """

    z_m: Array | Float32
    steps_m: tuple[float, float]
    row0: int = 0
    averaged: int = 1


def sample_windows(dem: Gridded, side: int = WINDOW_PX) -> Iterator[Heights]:
    """The windows of a file from north to south and west to east, of at most ``side`` pixels. Pixels of a cylinder that
    are narrower than half of their height are averaged along the row, so that cells are about square.
    """
    for row0, row1 in _spans(*_rows(dem), min(side, _most_rows(dem)), DOWN):
        stretch = _pixel_shape(dem, row0, row1)
        factor = max(1, min(_NARROWEST, math.floor(stretch[0] / stretch[1] + 1e-9)))
        for col0, col1 in _spans(0, _columns(dem), side * factor, ACROSS):
            z = dem.read(row0, row1, col0, col1)
            whole = (col1 - col0) // factor * factor
            if not whole:
                continue
            means = z[:, :whole].reshape(len(z), -1, factor).mean(axis=2, dtype=np.float32)
            yield Heights(means, (stretch[0], stretch[1] * factor), row0, factor)


def _columns(dem: Gridded) -> int:
    """Columns of a file, those of a global cylinder once."""
    return min(dem.grid.width, dem.grid.period) if dem.grid.wraps else dem.grid.width


def _rows(dem: Gridded) -> tuple[int, int]:
    """First and last row (half open) that are sampled."""
    grid = dem.grid
    if grid.pole:
        return 0, grid.height
    per_degree = math.radians(1.0) * MOON_RADIUS_M / grid.pixel_m
    equator = grid.y0_m / grid.pixel_m
    top = max(0, math.ceil(equator - _FURTHEST_DEG * per_degree))
    bottom = min(grid.height, math.floor(equator + _FURTHEST_DEG * per_degree) + 1)
    return (top, bottom) if 2 * (bottom - top) > min(grid.height, WINDOW_PX) else (0, grid.height)


def _most_rows(dem: Gridded) -> int:
    """Greatest number of rows of a window."""
    if dem.grid.pole:
        return WINDOW_PX
    per_degree = math.radians(1.0) * MOON_RADIUS_M / dem.grid.pixel_m
    return max(1, min(WINDOW_PX, math.floor(_ROWS_DEG * per_degree)))


def _spans(first: int, last: int, side: int, most: int) -> list[tuple[int, int]]:
    """At most ``most`` spans of ``side`` or less in first..last, from end to end, evenly placed."""
    side = min(side, last - first)
    count = min(most, math.ceil((last - first) / side))
    starts = np.linspace(first, last - side, count).round().astype(int).tolist()
    return [(start, start + side) for start in starts]


def _pixel_shape(dem: Gridded, row0: int, row1: int) -> tuple[float, float]:
    """Size of the pixels of some rows on the surface, (down, across) in metres: at their middle."""
    grid = dem.grid
    middle = 0.5 * (row0 + row1 - 1)
    if grid.pole:
        scale = math.sqrt(float(grid.cell_weight(0.5 * (grid.width - 1), middle)))
        return grid.pixel_m * scale, grid.pixel_m * scale
    lat = (grid.y0_m - middle * grid.pixel_m) / MOON_RADIUS_M
    narrow = math.cos(lat) / math.cos(math.radians(grid.true_lat_deg))
    return grid.pixel_m, grid.pixel_m * max(narrow, 1e-3)


TILES = (512, 256, 128, 64, 32)
"""Side lengths of the tiles whose spectra are averaged, nodes; the first that covers at least half
of the heights is used.
"""

LAW_LONGEST_M = 30e3
"""Longest wave of the power law; the spectrum of the Moon is less steep beyond (LDEM_4: k^-2
between 30 and 100 km).
"""

EXPONENT, EXPONENT_SIGMA = 4.0, 0.3
"""Prior of b. Without it a small area cannot distinguish a steep power law from a smooth DEM."""

BETWEEN_AREAS = 0.25
"""Standard deviation of the logarithm of the estimate between areas of 100 to 700 km of one product
(ten areas of GLD100), because no terrain follows a power law exactly.
"""

_BINS_PER_OCTAVE = 6
_LONGEST = 3.0  # waves per tile: the taper and the removed plane distort longer waves
_SHORTEST = 0.95  # of the Nyquist wavenumber
_OCTAVES_LEAST = 2.5  # least ratio of the shortest to the longest wave's wavenumber
_CUTS = 300
_NOISES = 10
_MISFIT = 0.1  # model error in the logarithm of power
_TOLD = 0.8  # of the Nyquist wavenumber: beyond it aliasing resembles noise
_FITTED = 2.5  # times the cut: beyond it a DEM's own filters, which the model lacks, appear
_ROUNDS = 3


@dataclass(frozen=True)
class Resolution:
    """Effective resolution of a DEM.

    ``resolution_m``: half of the shortest wavelength, at least ``posting_m``. ``low_m`` to
    ``high_m``: the 1-sigma interval of the fit and of the variation between areas
    (`BETWEEN_AREAS`). ``point_spread_m``: full width at half maximum of the Gaussian that halves
    the same wave; 0 if the resolution is the posting. ``exponent``: b. ``how``: a description for reports.
    """

    resolution_m: float
    low_m: float
    high_m: float
    posting_m: float
    point_spread_m: float
    exponent: float
    how: str

    @property
    def is_measured(self) -> bool:
        """False if the heights were too few for an estimate: ``resolution_m`` is the posting."""
        return math.isfinite(self.high_m)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power (m^4) of heights over wavenumber (cycles per metre), and the number of waves in each
    mean; all (n,).
    """

    wavenumber: Array
    power: Array
    waves: Array


def of_file(dem: Gridded) -> Resolution:
    """Effective resolution of a DEM file, from its `sample_windows`; estimated once in a process.

    ``resolution_m`` is the posting, which ``how`` states, for a file of too few heights.
    """
    return _of_file(dem, dem.identity)


@lru_cache(maxsize=64)
def _of_file(dem: Gridded, identity: Hashable) -> Resolution:
    return of_windows(list(sample_windows(dem)), dem.gsd_m)


def of_windows(windows: Sequence[Heights], posting_m: float) -> Resolution:
    """Effective resolution of heights with nodes ``posting_m`` apart: the posting, which ``how`` states, for
    heights that are too few (below 32 x 32 nodes), full of gaps, constant, or with hardly an octave of
    waves below `LAW_LONGEST_M`.
    """
    spectrum = spectrum_of(windows)
    if spectrum is None:
        how = "posting; too few heights without gaps to estimate the resolution"
        return Resolution(posting_m, posting_m, math.inf, posting_m, 0.0, math.nan, how)
    return _fitted(spectrum, posting_m)


# -- the spectrum


def spectrum_of(windows: Sequence[Heights]) -> Spectrum | None:
    """Mean spectrum over tiles at half a tile's spacing, of one or several windows; None if too few
    tiles are without gaps or all are constant.

    Each tile has its plane removed and is tapered by the squared Hann window, whose leakage falls
    with k^-10, more steeply than the spectrum of any DEM. The mean over windows is geometric: the
    roughest does not outweigh the others.
    """
    heights = [window.z_m for window in windows]
    side, tiles = next(
        ((side, tiles) for side in TILES if (tiles := _tiles(heights, side))), (0, [])
    )
    if not tiles:
        return None
    step = max(max(window.steps_m) for window in windows)
    longest = max(_LONGEST / (side * step), 1.0 / LAW_LONGEST_M)
    shortest = _SHORTEST * 0.5 / step
    if shortest < _OCTAVES_LEAST * longest:
        return None
    octaves = math.log2(shortest / longest)
    edges = np.geomspace(longest, shortest, max(8, round(octaves * _BINS_PER_OCTAVE)) + 1)
    pairs = zip(windows, tiles, strict=True)
    found = [_of_tiles(some, window.steps_m, edges) for window, some in pairs if some]
    return _mean([one for one in found if one is not None])


def _of_tiles(
    tiles: Sequence[Array | Float32], steps_m: tuple[float, float], edges: Array
) -> Spectrum | None:
    """Spectrum of one window's tiles; None if all are constant."""
    power = np.mean([_power(tile) for tile in tiles], axis=0) * steps_m[0] * steps_m[1]
    if not power.max() > 0.0:
        return None
    side = len(power)
    down, across = np.fft.fftfreq(side, steps_m[0]), np.fft.rfftfreq(side, steps_m[1])
    k = np.hypot(down[:, None], across[None])
    half = (across[None] > 0) | (down[:, None] > 0)  # each conjugate pair once
    return _binned(k[half], power[half], edges, 0.5 * (len(tiles) + 1))


def _mean(spectra: Sequence[Spectrum]) -> Spectrum | None:
    """Geometric mean of spectra in the same bins, each weighted by its number of waves."""
    if len(spectra) <= 1:
        return spectra[0] if spectra else None
    bins = min(len(one.power) for one in spectra)  # the last can lack waves
    waves = np.array([one.waves[:bins] for one in spectra])
    logs = [np.log([one.wavenumber[:bins], one.power[:bins]]) for one in spectra]
    mean = np.exp(np.average(logs, axis=0, weights=np.repeat(waves[:, None], 2, axis=1)))
    return Spectrum(mean[0], mean[1], waves.sum(axis=0))


def _tiles(heights: Sequence[Array | Float32], side: int) -> list[list[Array | Float32]]:
    """Tiles without gaps of each window (rows, cols); an empty list if they cover less than half of
    all heights.
    """
    found, covered, there = [], 0, 0
    for z in heights:
        tiles, held, whole = _whole_tiles(z, side)
        found.append(tiles)
        covered, there = covered + held, there + whole
    return found if covered and 2 * covered >= there else []


def _whole_tiles(z: Array | Float32, side: int) -> tuple[list[Array | Float32], int, int]:
    """Tiles without gaps of a window, the number of heights in them, and of all its heights."""
    there = np.isfinite(z)
    covered = np.zeros(z.shape, np.bool_)
    tiles = []
    rows, cols = (range(0, n - side + 1, side // 2) for n in z.shape)
    for place in (np.s_[i : i + side, j : j + side] for i in rows for j in cols):
        if there[place].all():
            covered[place] = True
            tiles.append(z[place])
    return tiles, int(covered.sum()), int(there.sum())


def _power(tile: Array | Float32) -> Array:
    """Power of a tile (n, n) at the wavenumbers of ``fftfreq`` down and ``rfftfreq`` across."""
    n = len(tile)
    at = np.arange(n) - (n - 1) / 2
    level = tile.astype(np.float64)
    level -= level.mean()
    tilt = at / (n * float(at @ at))
    level -= (level.sum(axis=1) @ tilt) * at[:, None] + (level.sum(axis=0) @ tilt) * at[None]
    taper = (0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(n) + 0.5) / n)) ** 2
    level *= taper[:, None]
    level *= taper[None]
    wave = np.fft.rfft2(level)
    return (wave.real**2 + wave.imag**2) / float(np.sum(taper**2)) ** 2


def _binned(k: Array, power: Array, edges: Array, tiles: float) -> Spectrum:
    """Geometric means over bins of wavenumber, which are robust against artefacts of a few waves
    (interpolation, stripes).

    The geometric mean of a noisy spectrum is below its mean: by exp(-gamma) for one spectrum, by
    about exp(-1 / 2n) for the mean of n. The bias is removed.
    """
    which = np.digitize(k, edges) - 1
    inside = (which >= 0) & (which < len(edges) - 1)
    which = which[inside]
    waves = np.bincount(which, minlength=len(edges) - 1).astype(np.float64)
    enough = waves >= 4
    level, middle = (
        np.bincount(which, np.log(part[inside]), len(waves))[enough] / waves[enough]
        for part in (np.maximum(power, 1e-300), k)
    )
    below = 0.5 / tiles + 1.0 / (12.0 * tiles**2)  # ln n - digamma(n)
    return Spectrum(np.exp(middle), np.exp(level + below), waves[enough] * tiles)


# -- the fit


Shape = Callable[[Array, Array | float], Array]

SHAPES: dict[str, Shape] = {
    "a penalty on curvature": lambda k, cut: -np.log1p(3.0 * (k / cut) ** 4),
    "a Gaussian point spread": lambda k, cut: -math.log(4.0) * (k / cut) ** 2,
}
"""Logarithms of M^2."""


@dataclass(frozen=True)
class _Fit:
    """Fitted parameters of one shape, and its misfit (chi^2) as a function of the cut."""

    shape: str
    cut: float
    amplitude: float
    exponent: float
    noise: float
    chi2: float
    cuts: Array
    profile: Array

    def signal(self, k: Array) -> Array:
        """Power without noise."""
        return np.asarray(
            self.amplitude * k**-self.exponent * np.exp(SHAPES[self.shape](k, self.cut))
        )


def _fitted(spectrum: Spectrum, posting_m: float) -> Resolution:
    used, fit = spectrum, _best(spectrum)
    for _ in range(_ROUNDS):
        near = spectrum.wavenumber <= max(_FITTED * fit.cut, spectrum.wavenumber[7])
        used = Spectrum(*(a[near] for a in (spectrum.wavenumber, spectrum.power, spectrum.waves)))
        fit = _best(used)
    nyquist = 0.5 / posting_m
    noisy = _outweighed(fit, nyquist)
    cut = min(fit.cut, noisy)
    low, high = _interval(fit, len(used.power))
    resolution = max(posting_m, 0.5 / cut)
    sides = (1.0, 1.0) if noisy < fit.cut else (high / fit.cut, fit.cut / low)
    finer, coarser = (math.hypot(math.log(side), BETWEEN_AREAS) for side in sides)
    spread = 0.0 if fit.cut >= nyquist else _fwhm_m(fit.cut)
    return Resolution(
        resolution,
        max(posting_m, 0.5 / cut * math.exp(-finer)),
        max(posting_m, 0.5 / cut * math.exp(coarser)),
        posting_m,
        spread,
        fit.exponent,
        _words(fit, resolution, posting_m, noisy),
    )


def _words(fit: _Fit, resolution_m: float, posting_m: float, noisy: float) -> str:
    law = f"the heights' spectrum has the exponent -{fit.exponent:.1f}"
    if resolution_m <= posting_m:
        return f"{law} down to the posting"
    if noisy < fit.cut:
        return f"{law}; noise exceeds them at wavelengths below {2.0 * resolution_m:.0f} m"
    return f"{law}; waves of {2.0 * resolution_m:.0f} m are halved, as by {fit.shape}"


def _fwhm_m(cut: float) -> float:
    """Full width at half maximum of the Gaussian with transfer 1/2 at a wavenumber: exp(-2 (pi s
    k)^2) = 1/2.
    """
    return math.sqrt(0.5 * math.log(2.0)) / (math.pi * cut) / SIGMA_PER_FWHM


def _best(spectrum: Spectrum) -> _Fit:
    """Best fit over all shapes and noise levels."""
    least = float(spectrum.power.min())
    noises = [0.0, *(least * np.linspace(0.05, 0.95, _NOISES)).tolist()]
    fits = [_fit(spectrum, shape, noise) for shape in SHAPES for noise in noises]
    best = min(fits, key=lambda fit: fit.chi2)
    same = [fit.profile for fit in fits if fit.shape == best.shape]
    profile = np.min(same, axis=0)
    return _Fit(**{**best.__dict__, "profile": profile})


def _fit(spectrum: Spectrum, shape: str, noise: float) -> _Fit:
    """Amplitude and exponent by weighted least squares on logarithms, for all cuts at once. The
    prior of the exponent counts as one more measurement.
    """
    k, power = spectrum.wavenumber, spectrum.power
    clear = power - noise
    variance = (1.0 / spectrum.waves + _MISFIT**2) * (power / clear) ** 2
    w, x = 1.0 / variance, -np.log(k)
    cuts = np.geomspace(k[0], 8.0 * k[-1], _CUTS)
    falls = SHAPES[shape](k, cuts[:, None])
    y = np.log(clear)[None] - falls
    prior = 1.0 / EXPONENT_SIGMA**2
    s, sx, sxx = w.sum(), w @ x, w @ (x * x) + prior
    sy, sxy = y @ w, y @ (w * x) + prior * EXPONENT
    determinant = s * sxx - sx * sx
    exponent = (s * sxy - sx * sy) / determinant
    level = (sxx * sy - sx * sxy) / determinant
    model = level[:, None] + exponent[:, None] * x[None] + falls
    model = np.logaddexp(model, math.log(noise)) if noise > 0.0 else model
    off = (np.log(power)[None] - model) ** 2 / (1.0 / spectrum.waves + _MISFIT**2)
    profile = off.sum(axis=1) + prior * (exponent - EXPONENT) ** 2
    best = int(profile.argmin())
    return _Fit(
        shape,
        cut=float(cuts[best]),
        amplitude=float(np.exp(level[best])),
        exponent=float(exponent[best]),
        noise=noise,
        chi2=float(profile[best]),
        cuts=cuts,
        profile=profile,
    )


def _interval(fit: _Fit, count: int) -> tuple[float, float]:
    """1-sigma interval of the cut. If the best fit's chi^2 exceeds its degrees of freedom, chi^2 is
    scaled to them.
    """
    scale = max(1.0, fit.chi2 / max(1, count - 4))
    within = fit.cuts[fit.profile <= fit.profile.min() + scale]
    return float(within.min()), float(within.max())


def _outweighed(fit: _Fit, nyquist: float) -> float:
    """Least wavenumber at which the noise exceeds the signal; infinite if it is near or beyond
    Nyquist.
    """
    k = np.geomspace(fit.cuts[0], _TOLD * nyquist, 2000)
    over = np.flatnonzero(fit.signal(k) < fit.noise)
    return float(k[over[0]]) if over.size else math.inf
