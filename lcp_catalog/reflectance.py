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

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import ConfigError
from .kernels import reflectance as kernel

Array = NDArray[np.float64]

MODELS = ("lommel-seeliger", "lambert")
"""Names of the laws; what may follow a colon, a parameter set or a file, is each law's own."""

SINGLE_SCATTERING_ALBEDO = 0.21
LAMBERT_ALBEDO = 0.12


@dataclass(frozen=True)
class Reflectance:
    """A law of reflection: the name that was asked for, the law's code and its numbers."""

    name: str
    code: int
    law: tuple[float, ...]

    @cached_property
    def numbers(self) -> Array:
        """The law's numbers as the kernels want them, (n,)."""
        return np.array(self.law, dtype=np.float64)


def reflectance_model(spec: str) -> Reflectance:
    """The law of a name; ConfigError for a name that is none."""
    if spec == "lommel-seeliger":
        return Reflectance(spec, kernel.LOMMEL_SEELIGER, (SINGLE_SCATTERING_ALBEDO,))
    if spec == "lambert":
        return Reflectance(spec, kernel.LAMBERT, (LAMBERT_ALBEDO,))
    raise ConfigError(f"no reflectance model {spec!r}; there are {', '.join(MODELS)}")


DEFAULT_MODEL = reflectance_model("lommel-seeliger")


class Photometry(NamedTuple):
    """Radiance factor and photometric angles (radians), one array each, of one shape."""

    radiance: Array
    incidence: Array
    emission: Array
    phase: Array


def photometry(
    normals: NDArray[np.floating],
    sun: Array,
    cameras: Array,
    lit: NDArray[np.bool_],
    seen: NDArray[np.bool_],
    model: Reflectance = DEFAULT_MODEL,
) -> Photometry:
    """Radiance and angles of points: normals (..., 3), directions to the Sun (3,) and to the camera
    (3,) or (..., 3).

    Radiance is 0 where seen but not lit and NaN where not seen; everything is NaN where the normal
    is.
    """
    rays = _flat(normals), np.ascontiguousarray(sun, dtype=np.float64), _flat(cameras)
    bands = kernel.shade_points(*rays, np.ravel(lit), np.ravel(seen), model.code, model.numbers)
    return Photometry(*(band.reshape(normals.shape[:-1]) for band in bands))


def radiance_under(
    normals: NDArray[np.floating],
    sun: Array,
    cameras: Array,
    lit: NDArray[np.bool_],
    model: Reflectance = DEFAULT_MODEL,
) -> Array:
    """The radiance alone, (...), of points that are seen; shapes as in `photometry`. 0 where not
    lit.
    """
    rays = _flat(normals), np.ascontiguousarray(sun, dtype=np.float64), _flat(cameras)
    values = kernel.radiance_of_points(*rays, np.ravel(lit), model.code, model.numbers)
    return np.asarray(values.reshape(normals.shape[:-1]))


def _flat(vectors: NDArray[np.floating]) -> Array:
    return np.ascontiguousarray(vectors, dtype=np.float64).reshape(-1, 3)
