"""Detector model: blur, exposure, noise, quantisation, saturation.

A pixel's signal is the radiance factor weighted with the pixel's response: its own square,
convolved with a Gaussian of ``blur_px`` (standard deviation). Noise has two parts; ``noise`` is the
standard deviation of both together at the mean lit signal m, as a share of it: photon noise, whose
variance grows with the signal S, and read noise, whose variance does not:

    variance(S) = (noise m)^2 (shot_share S / m + 1 - shot_share)

Photon counts follow a Poisson distribution, with 1 / (noise^2 shot_share) photons at the mean. A
pixel's number is round((2^bits - 1) S / full_scale), limited to 0..2^bits - 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..errors import ConfigError

Numbers = NDArray[np.uint8] | NDArray[np.uint16]

BITS_MAX = 16
BLUR_MAX_PX = 16.0
REACH = 4.0
"""Sigmas at which the Gaussian is cut off; the 6e-5 beyond are spread over the rest."""

_SHARP_PX = 1e-6
"""A blur below this counts as 0: it moves less than that share of a pixel's light."""

BRIGHT_PERCENTILE, BRIGHT_SHARE = 99.5, 0.8
"""Default exposure: this percentile of the lit signal falls at this share of full scale."""

_LIT_SHARE = 0.02
"""Share of the bright signal (`BRIGHT_PERCENTILE`) from which a pixel is lit. Shadows have less: by way of
other ground up to 1 % on the crater of docs/explanation/lighting.md.
"""


@dataclass(frozen=True)
class Detector:
    """A detector; ConfigError for invalid values. ``full_scale``: radiance factor of the highest
    number; None: from the signal (`BRIGHT_PERCENTILE`). Equal seeds give equal noise.

    Examples
    --------
    >>> detector = lcp.Detector(noise=0.02, bits=12)
    >>> detector.highest
    4095
    """

    blur_px: float = 0.0
    noise: float = 0.0
    shot_share: float = 0.5
    full_scale: float | None = None
    bits: int = 8
    seed: int = 0

    def __post_init__(self) -> None:
        _require(0.0 <= self.blur_px <= BLUR_MAX_PX, f"blur must be 0..{BLUR_MAX_PX:g} pixels")
        _require(0.0 <= self.noise <= 10.0, "noise must be 0..10 times the mean lit signal")
        _require(0.0 <= self.shot_share <= 1.0, "the share of photon noise must be 0..1")
        scale = self.full_scale
        _require(scale is None or 0.0 < scale < math.inf, "exposure must be positive")
        _require(1 <= self.bits <= BITS_MAX, f"bits must be 1..{BITS_MAX}")
        _require(self.seed >= 0, "seed must not be negative")

    @property
    def highest(self) -> int:
        """The number at saturation."""
        return (1 << self.bits) - 1

    @property
    def margin_px(self) -> int:
        """Distance in pixels from which light outside an image is blurred into it."""
        return math.ceil(REACH * self.blur_px)

    def scale_of(self, signal: Array) -> float:
        """Radiance factor of full scale; 1 if none is stated and nothing is lit."""
        if self.full_scale is not None:
            return self.full_scale
        lit = lit_signal(signal)
        return float(np.percentile(lit, BRIGHT_PERCENTILE)) / BRIGHT_SHARE if lit.size else 1.0

    def noisy(self, signal: Array) -> Array:
        """A non-negative signal (rows, cols) with noise."""
        lit = lit_signal(signal)
        if self.noise == 0.0 or not lit.size:
            return signal
        mean, dice = float(lit.mean()), np.random.default_rng(self.seed)
        light: NDArray[np.floating] = signal
        if self.shot_share > 0.0:
            photons = 1.0 / (self.noise**2 * self.shot_share)
            light = dice.poisson(signal * (photons / mean)) * (mean / photons)
        read = self.noise * mean * math.sqrt(1.0 - self.shot_share)
        return np.asarray(light + read * dice.standard_normal(signal.shape))

    def numbers(self, signal: Array, full_scale: float) -> Numbers:
        """Numbers read out for a signal (rows, cols), uint8 up to 8 bits, else uint16; 0 for NaN."""
        known = np.isfinite(signal)
        scaled = self.noisy(np.where(known, signal, 0.0)) * (self.highest / full_scale)
        read = np.where(known, np.clip(np.rint(scaled), 0, self.highest), 0)
        return read.astype(np.uint8) if self.bits <= 8 else read.astype(np.uint16)


def lit_signal(signal: Array) -> Array:
    """Values of the lit pixels of a signal (rows, cols), (n,)."""
    some = signal[signal > 0.0]
    return some[some > _LIT_SHARE * np.percentile(some, BRIGHT_PERCENTILE)] if some.size else some


def response(blur_px: float, samples: int) -> Array:
    """Weights of the sub-pixels along one axis in a pixel's signal: ``samples`` in each of 2 m + 1
    pixels, m = ceil(4 blur_px), the pixel itself in the middle; their sum is 1.

    A weight is the integral over a sub-pixel of the square convolved with the Gaussian, in closed
    form.
    """
    margin = math.ceil(REACH * blur_px)
    edges = (np.arange(samples * (2 * margin + 1) + 1) / samples) - margin - 0.5
    rise = [_ramp(float(edge) + 0.5, blur_px) - _ramp(float(edge) - 0.5, blur_px) for edge in edges]
    weights = np.maximum(np.diff(rise), 0.0)
    return np.asarray(weights / weights.sum())


def _ramp(x: float, sigma: float) -> float:
    """Integral up to x of the Gaussian's cumulative distribution, or of a step if it is sharp."""
    if sigma < _SHARP_PX:
        return max(x, 0.0)
    t = x / sigma
    density = math.exp(-0.5 * t * t) / math.sqrt(2.0 * math.pi)
    return sigma * (t * 0.5 * math.erfc(-t / math.sqrt(2.0)) + density)


def gathered(fine: NDArray[np.floating], weights: Array, samples: int) -> Array:
    """Pixels (rows, cols) from sub-pixels (samples (rows + 2 m), samples (cols + 2 m)) by
    `response`. NaN is unknown and does not count; a pixel is NaN if less than half of its response
    is known.
    """
    known = np.isfinite(fine)
    light = _along(_along(np.where(known, fine, 0.0), weights, samples).T, weights, samples).T
    if known.all():
        return light
    share = _along(_along(known.astype(np.float64), weights, samples).T, weights, samples).T
    enough = share >= 0.5
    return np.where(enough, light / np.where(enough, share, 1.0), np.nan)


def _along(values: NDArray[np.floating], weights: Array, samples: int) -> Array:
    """Weighted sums down the rows, one for each pixel."""
    count = (len(values) - len(weights)) // samples + 1
    out = np.zeros((count, values.shape[1]))
    for first, weight in enumerate(weights):
        out += weight * values[first : first + samples * (count - 1) + 1 : samples]
    return out


def _require(holds: bool, why: str) -> None:
    if not holds:
        raise ConfigError(f"detector: {why}")
