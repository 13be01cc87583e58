"""Covariance of the registration of a patch in an image that differs from its render.

Let a known patch t be matched with an image t(x - d) + n by least squares on the shift d, a gain and
an offset, with equal weights. With the rows B = [dt/dx, dt/dy, 1, t], F = B B^T and S = B C B^T, C
the covariance of the noise n, the covariance of the estimates is to first order F^-1 S F^-1. For
white noise it is noise^2 F^-1, the Cramer-Rao bound (Foerstner and Guelch 1987; the part of F for the
shift is the matrix of Harris and Stephens 1988). Correlated noise, as from smooth errors of a DEM,
moves a match much farther than white noise of the same variance.

Limits: first order, so for sigmas well below the width of the features; at a low signal the match
fails before the bound does, which `detection` describes. Differences damp detail near one pixel (an
ideal step counts half), so very sharp patches are located better than stated.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from ..arrays import AnyArray, Array, Float32, Index
from ..kernels.matching import patches as kernels
from ..kernels.matching import registration as kernel
from .error_model import ErrorModel, NoiseTerms, PatchErrors

HARRIS_K = 0.04


@dataclass(frozen=True, eq=False)
class Registration:
    """Statistics of the match of n patches with noisy images of themselves.

    ``contrast``: standard deviation of each patch relative to its mean signal; ``noise_variance``:
    of the noise about its mean over the patch; ``along``: V, variance of the noise's product with
    the centred patch of unit norm; ``shift_loss``: expected loss of correlation because the true
    place lies between whole pixels; (n,). ``covariance_px2`` (n, 2, 2) of the shift, columns first,
    rows downwards; infinite where the patch is not located in some direction. ``slope_noise`` (n, 2,
    2): covariance of the noise's products with the slopes of the patch, after the projection, in
    units of the squared norm of the centred patch. ``spread``: of the
    error model; the covariance is the mean over places, the other figures are those of a place with
    typical noise. ``bias`` (n, 2): displacement of the match, columns and rows, by the known
    difference between patch and image, as by shadows that terrain outside a patch casts into it, to
    first order (-F^-1 B e, restricted to the shift, for the difference e); infinite where the patch is
    not located. ``own`` (n,): noise-free correlation of the patch with the image at its place.
    ``pixels`` (n,): N, that a search compares.
    """

    contrast: Array
    noise_variance: Array
    along: Array
    shift_loss: Array
    covariance_px2: Array
    slope_noise: Array
    bias: Array
    own: Array
    pixels: Array
    spread: float = 0.0

    def rows(self, some: Index) -> Registration:
        """A selection of the patches."""
        parts = {
            field.name: getattr(self, field.name)[some]
            for field in dataclasses.fields(self)
            if isinstance(getattr(self, field.name), np.ndarray)
        }
        return dataclasses.replace(self, **parts)


def registration(
    patches: AnyArray,
    errors: PatchErrors,
    model: ErrorModel,
    pixel_m: float,
    level: AnyArray | float = 1.0,
    pixels: Array | None = None,
) -> Registration:
    """Statistics of patches (n, p, p) with their sources of error, which are divided by ``level``
    (n,), the mean signal; the patches are complete. ``pixels`` (n,):
    that a search for them compares; None: all nodes.

    The covariance is that of least squares on shift, gain and offset with unweighted pixels in
    correlated noise: with B = [dx, dy, 1, t], F = B B^T and S = B C B^T it is F^-1 S F^-1,
    restricted to the shift. The slopes are projected onto the complement of 1 and t first, which
    gives the same. They are differences of the sixth order: central differences over three nodes
    damp detail near a node's width, and the covariance grows with the square or, in smooth noise,
    the fourth power of that (measured over stated variance of the match: 0.78, 0.66 and 0.58 in
    white noise and noise of 1.5 and 4 nodes' length, and 0.96, 0.90 and 0.85 with the sixth order;
    `claims_simulated.py` of c896266).

    `Registration.bias` and `Registration.own` compare the patches with ``errors.level``, the image
    at their places.
    """
    p = np.shape(patches)[1]
    terms = NoiseTerms.of(model, p, pixel_m)
    whole, image, east, south = (
        np.ascontiguousarray(part, dtype=np.float32)
        for part in (patches, errors.level, errors.east, errors.south)
    )
    found = np.empty((len(whole), kernel.NUMBERS))
    unit = np.ascontiguousarray(np.broadcast_to(level, len(whole)), dtype=np.float64)
    kernel.registrations(
        whole, image, east, south, unit, terms.variances, terms.taps, terms.heights, terms.albedo,
        found,
    )  # fmt: skip
    contrast, noise_variance, along, shift_loss = np.ascontiguousarray(found[:, :4].T)
    return Registration(
        contrast=contrast,
        noise_variance=noise_variance,
        along=along,
        shift_loss=shift_loss,
        covariance_px2=_symmetric(found[:, 4:7]) * math.exp(2.0 * model.spread**2),
        pixels=np.full(len(whole), float(p * p)) if pixels is None else pixels,
        spread=model.spread,
        slope_noise=_symmetric(found[:, 7:10]),
        bias=found[:, 10:12],
        own=found[:, 12].copy(),
    )


def _symmetric(parts: Array) -> Array:
    """Matrices (n, 2, 2) of xx, yy, xy (n, 3)."""
    return np.ascontiguousarray(parts[:, [0, 2, 2, 1]]).reshape(-1, 2, 2)


def harris_response(patches: Float32, level: Array | None = None) -> Float32:
    """det M - 0.04 trace(M)^2 of each patch (n, p, p), divided by its mean lit level, over the
    squared number of nodes (Harris and Stephens 1988), (n,); NaN where a node is missing or no node
    is lit. level (n,): the mean lit levels, if they are known.
    """
    out = np.empty(len(patches))
    known = light_of(patches)[1] if level is None else level
    kernels.harris(np.ascontiguousarray(patches), known, HARRIS_K, out)
    return out.astype(np.float32)


def light_of(patches: Float32) -> tuple[Array, Array]:
    """Of each patch (n, p, p) the share of its nodes that are lit (> 0; missing nodes are not), and the
    mean of these: NaN where a node is missing or no node is lit; (n,) each.
    """
    share, level = np.empty((2, len(patches)))
    kernels.light(np.ascontiguousarray(patches), share, level)
    return share, level
