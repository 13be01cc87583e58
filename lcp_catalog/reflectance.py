"""The photometric models, as radiance factor I/F (the radiance relative to a perfect white surface
lit head-on).

Lommel-Seeliger: I/F = w/4 * mu0 / (mu0 + mu), isotropic scattering, single-scattering albedo w =
0.21 (Hapke 2012, *Theory of Reflectance and Emittance Spectroscopy*, ch. 8 and 10; his radiance
factor is pi r = w/4 * mu0/(mu0+mu) * p). It has no phase function: within one image, where the
phase varies little, brightness is right relatively; between images it is not. Lambert: I/F = A mu0,
A = 0.12. mu0 and mu are the cosines of incidence and emission; the phase is the angle between the
directions to the Sun and to the camera, never their sum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import ConfigError
from .kernels import reflectance as kernel

Array = NDArray[np.float64]

MODELS = {"lommel-seeliger": kernel.LOMMEL_SEELIGER, "lambert": kernel.LAMBERT}
"""Name of a model and its code in the kernels."""

DEFAULT_MODEL = "lommel-seeliger"


class Photometry(NamedTuple):
    """Radiance factor and photometric angles (radians), one array each, of one shape."""

    radiance: Array
    incidence: Array
    emission: Array
    phase: Array


def model_code(name: str) -> int:
    """The kernels' code of a model; ConfigError for a name that is none."""
    if name not in MODELS:
        raise ConfigError(f"no reflectance model {name!r}; there are {', '.join(MODELS)}")
    return MODELS[name]


def photometry(
    normals: NDArray[np.floating],
    sun: Array,
    cameras: Array,
    lit: NDArray[np.bool_],
    seen: NDArray[np.bool_],
    model: str = DEFAULT_MODEL,
) -> Photometry:
    """Radiance and angles of points: normals (..., 3), directions to the Sun (3,) and to the camera
    (3,) or (..., 3).

    Radiance is 0 where seen but not lit and NaN where not seen; everything is NaN where the normal
    is.
    """
    flat = np.ascontiguousarray(normals, dtype=np.float64).reshape(-1, 3)
    towards = np.ascontiguousarray(cameras, dtype=np.float64).reshape(-1, 3)
    sun = np.ascontiguousarray(sun, dtype=np.float64)
    bands = kernel.shade_points(
        flat, sun, towards, np.ravel(lit), np.ravel(seen), model_code(model)
    )
    return Photometry(*(band.reshape(normals.shape[:-1]) for band in bands))
