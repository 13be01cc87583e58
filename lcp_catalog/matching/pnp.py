"""A framing camera's place from points in its image when nothing is known of it: the start for `pose.solve`.

OpenCV's perspective-n-point inside RANSAC, and SQPnP (Terzakis and Lourakis 2020) on those that agree. The lens is
undone first, by the camera's own model.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..cameras.frame_camera import Camera
from ..errors import PoseError

LEAST = 4
"""Three points have up to four solutions; the fourth chooses."""

_TRIALS = 2000
_CONFIDENCE = 0.9999


def initial(
    camera: Camera, points_mcmf_m: ArrayLike, pixels: ArrayLike, tolerance_px: float = 2.0
) -> tuple[Camera, NDArray[np.bool_]]:
    """The camera where points (n, 3) are seen at pixels (n, 2), and which of them, (n,), are, to within a tolerance.

    Of the camera only focal length, principal point and lens are used. NaN pixels are left out. Raises PoseError for
    fewer than four points, or where no place agrees with four.
    """
    points, found = (np.asarray(a, dtype=np.float64) for a in (points_mcmf_m, pixels))
    rays = camera.focal_plane.directions(found)
    known = np.isfinite(rays).all(-1) & (rays[:, 2] > 0.0)
    if known.sum() < LEAST:
        raise PoseError(
            f"{camera.name}: {known.sum()} points do not decide its place; {LEAST} are needed"
        )
    f = camera.focal_length_px
    ideal = f * rays[known, :2] / rays[known, 2:]
    middle = points[known].mean(axis=0)  # MCMF numbers are large beside what they differ by
    solved, turn, shift, inliers = cv2.solvePnPRansac(
        points[known] - middle,
        ideal,
        np.diag([f, f, 1.0]),
        None,
        iterationsCount=_TRIALS,
        reprojectionError=tolerance_px,
        confidence=_CONFIDENCE,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not solved or inliers is None or len(inliers) < LEAST:
        raise PoseError(
            f"{camera.name}: no place of it agrees with {LEAST} of {known.sum()} points"
        )
    rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    agrees = np.zeros(len(points), dtype=np.bool_)
    agrees[np.flatnonzero(known)[inliers[:, 0]]] = True
    placed = replace(
        camera,
        position_mcmf_m=middle - rotation.T @ shift[:, 0],
        rotation_mcmf_to_camera=rotation,
    )
    return placed, agrees
