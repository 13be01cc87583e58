"""Choice of the reflectance model of a scene, by the error of a cheaper model relative to Hapke's.

The error is the rms residual of Hapke's image after a fit of the other model's image with a free
gain and offset, as a share of the mean signal: sqrt(1 - r^2) of the contrast, where r is the
correlation of the two images. Image correlation is not affected by gain and offset; it sees the
residual as noise, which adds (in squares) to the other differences between an image and its render,
0.13 to 0.2 of the mean signal where they were measured as white noise. The images show random
relief: facets with normally distributed slopes, isotropic, restricted to those that are lit and
visible (shadows are the same under any model). If one image has many phase angles (a wide camera),
one gain and offset apply to all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..accuracy import Accuracy
from ..arrays import Array
from ..choices import AUTO_LAW, LAWS_BY_COST
from .laws import Reflectance, radiance_under, reflectance_model

SLOPE_RMS = math.tan(math.radians(8.0))
"""Rms slope in one direction if no terrain is known. Measured on GLD100 over 118 and 474 m: 6.0 deg
(Taurus-Littrow) to 8.1 deg (far-side highlands)."""

_QUADRATURE = 31
_NO_CONTRAST = 1e-24  # a variance below this is rounding


@dataclass(frozen=True)
class Cost:
    """Error of a reflectance model relative to another: ``residual``, the residual as a share of
    the mean signal in the worst image. ``contrast``: standard deviation over mean of that image;
    ``phase_deg``, ``incidence_deg``: its lowest and highest angles on level terrain; ``images``:
    number of images compared.
    """

    residual: float
    contrast: float
    phase_deg: tuple[float, float]
    incidence_deg: tuple[float, float]
    images: int

    @property
    def correlation(self) -> float:
        """Correlation of the worst image under the two models; 1 without contrast."""
        share = self.residual / self.contrast if self.contrast > 0.0 else 0.0
        return math.sqrt(max(0.0, 1.0 - share**2))


def cost(
    model: Reflectance,
    reference: Reflectance,
    suns: Array,
    cameras: Array,
    slope_rms: float = SLOPE_RMS,
) -> Cost:
    """Error of a model in the worst of some images. suns, cameras (k, n, 3): unit vectors from
    level terrain for k images with n pairs each; ``slope_rms``: tangent.
    """
    up, down = _facets(slope_rms)
    worst = Cost(-1.0, 0.0, (0.0, 0.0), (0.0, 0.0), len(suns))
    for sun, camera in zip(suns, cameras, strict=True):
        left, contrast = _residual(model, reference, sun, camera, up, down)
        if left > worst.residual:
            phase = np.degrees(np.arccos(np.clip(np.sum(sun * camera, axis=-1), -1.0, 1.0)))
            incidence = np.degrees(np.arccos(np.clip(sun[:, 2], -1.0, 1.0)))
            worst = Cost(left, contrast, _ends(phase), _ends(incidence), len(suns))
    return worst


def _facets(slope_rms: float) -> tuple[Array, Array]:
    """Normals (m, 3) and weights (m,) of facets of random relief, by Gauss-Hermite quadrature."""
    at, weight = np.polynomial.hermite_e.hermegauss(_QUADRATURE)
    east, north = (g.ravel() for g in np.meshgrid(slope_rms * at, slope_rms * at))
    normals = np.stack([-east, -north, np.ones_like(east)], axis=-1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals, np.outer(weight, weight).ravel() / weight.sum() ** 2


def _residual(
    model: Reflectance,
    reference: Reflectance,
    suns: Array,
    cameras: Array,
    normals: Array,
    share: Array,
) -> tuple[float, float]:
    """Residual of one image of facets under pairs of Sun and camera, and its contrast, both as
    shares of the mean.
    """
    ours, theirs, weights = [], [], []
    for sun, camera in zip(suns, cameras, strict=True):
        looked = (normals @ sun > 0.0) & (normals @ camera > 0.0)
        seen, lit = normals[looked], np.ones(int(looked.sum()), dtype=np.bool_)
        ours.append(radiance_under(seen, sun, camera, lit, model))
        theirs.append(radiance_under(seen, sun, camera, lit, reference))
        # the projected area of a facet is its weight in an image
        weights.append(share[looked] * (seen @ camera) / seen[:, 2])
    a, b, w = (np.concatenate(part) for part in (ours, theirs, weights))
    if not (w * b).sum() > 0.0:
        return 0.0, 0.0
    w = w / w.sum()
    a, b = a / (w * a).sum() - 1.0, b / (w * b).sum() - 1.0
    gain = (w * a * b).sum() / max((w * a * a).sum(), _NO_CONTRAST)
    return math.sqrt((w * (b - gain * a) ** 2).sum()), math.sqrt((w * b * b).sum())


def _ends(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


@dataclass(frozen=True)
class LawChoice:
    """The reflectance model of a scene, ``requested`` or chosen; the error of
    Lommel-Seeliger (``cost``) and of the model itself (``own``) relative to Hapke; and the tier's
    limit.
    """

    model: Reflectance
    requested: bool
    cost: Cost
    own: Cost
    limit: float

    @property
    def reason(self) -> str:
        """The choice in words, for the scene plan."""
        low, high = self.cost.phase_deg
        phase = f"{low:.0f} deg" if high - low < 1.0 else f"{low:.0f} to {high:.0f} deg"
        text = (
            f"{self.model.name}, {'as asked' if self.requested else 'chosen'}: at a phase of {phase} "
            f"Lommel-Seeliger differs from Hapke by {_percent(self.cost.residual)} of the mean signal, "
            f"gain and offset left free (correlation {self.cost.correlation:.4f}, the worst of "
            f"{self.cost.images} images of random relief); a law is chosen up to {_percent(self.limit)}"
        )
        if self.own.residual not in (0.0, self.cost.residual):
            text += f"; {self.model.name} differs by {_percent(self.own.residual)}"
        return text


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def choose(
    accuracy: Accuracy,
    suns: Array,
    cameras: Array,
    slope_rms: float = SLOPE_RMS,
    requested: Reflectance | None = None,
) -> LawChoice:
    """Return the requested model, or the cheapest of `LAWS_BY_COST` whose error is within
    `Accuracy.law_residual`. Directions as in `cost`.
    """
    laws = [reflectance_model(name) for name in LAWS_BY_COST]
    first, limit = cost(laws[0], laws[-1], suns, cameras, slope_rms), accuracy.law_residual
    for model in [requested] if requested else laws:
        own = first if model == laws[0] else cost(model, laws[-1], suns, cameras, slope_rms)
        if own.residual <= limit:
            break
    return LawChoice(model, requested is not None, first, own, limit)


def law_of(law: Reflectance | str) -> Reflectance | None:
    """A law, or that of a name as `named`."""
    return named(law) if isinstance(law, str) else law


def named(spec: str) -> Reflectance | None:
    """Model of a name; None for `AUTO_LAW`. ConfigError for an unknown name."""
    return None if spec == AUTO_LAW else reflectance_model(spec)
