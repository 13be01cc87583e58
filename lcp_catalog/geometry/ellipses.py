"""Error ellipses of covariances in a plane, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array


def error_ellipses(covariance: Array, first_axis_deg: float = 0.0) -> tuple[Array, Array]:
    """Error ellipses of covariances (n, 2, 2): 1 sigma along the major and the minor axis (n, 2), and
    the angle of the major axis (n,), 0..180 degrees, counted from ``first_axis_deg`` at the plane's first
    axis towards the second. NaN for a covariance that is not finite; the angle of a circle is
    ``first_axis_deg``.

    The variances are the roots of the characteristic polynomial; the axis (cos t, sin t) has
    tan 2t = 2 xy / (xx - yy).
    """
    known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    xx, yy, xy = (covariance[:, row, column] for row, column in ((0, 0), (1, 1), (0, 1)))
    xx, yy, xy = (np.where(known, part, 0.0) for part in (xx, yy, xy))
    middle, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    variance = np.maximum(np.stack([middle + apart, middle - apart], axis=-1), 0.0)
    angle = (np.degrees(0.5 * np.arctan2(2.0 * xy, xx - yy)) + first_axis_deg) % 180.0
    return np.where(known[:, None], np.sqrt(variance), np.nan), np.where(known, angle, np.nan)


def ellipse_covariance(sigma_m: ArrayLike, angle_deg: ArrayLike) -> Array:
    """Covariances (n, 2, 2), axes east and north, of ellipses with 1 sigma along the major and minor
    axis (n, 2) and the angle of the major axis clockwise from north, degrees (n,). NaN for ellipses
    that are not finite.
    """
    sigma, angle = np.asarray(sigma_m, np.float64), np.radians(angle_deg)
    variance = np.where(np.isfinite(sigma), sigma, np.nan) ** 2
    major = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    minor = np.stack([np.cos(angle), -np.sin(angle)], axis=-1)
    axes = np.stack([major, minor], axis=-1)
    return np.asarray((axes * variance[..., None, :]) @ np.swapaxes(axes, -1, -2))
