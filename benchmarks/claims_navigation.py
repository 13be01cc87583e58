"""Simulated navigation with the points of the simulated frames, without those whose claims are the worst.

From 20 random matches of a frame those with the largest stated sigma, or the lowest detection probability, are left out; random
ones for comparison. The others that lie at their true place, as a consensus finds out, give a horizontal position: the mean of
their errors, of equal weight, or weighted by the stated covariances. The share of false matches among those kept stands beside.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from claims_frames import Frame
from claims_scores import axes_px, text_px

SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
POINTS = 20
DRAWS = 50
LEAST = 10
SEED = 3
ORDERS = ("stated sigma", "detection probability", "random")
WEIGHTS = ("equal weights", "stated weights")
_SIDE_PX, _COLOURS = (420, 300), ((160, 90, 30), (40, 120, 40), (150, 150, 150))


FALSE = "false matches"


def errors(frames: list[Frame]) -> dict[tuple[str, str], np.ndarray]:
    """Errors of position, metres, (frames x draws, shares), by order and weights; under `FALSE` the shares of false matches. NaN
    with fewer than three true ones.
    """
    dice = np.random.default_rng(SEED)
    out: dict[tuple[str, str], list[list[float]]] = {
        (o, w): [] for o in ORDERS for w in (*WEIGHTS, FALSE)
    }
    for frame in frames:
        claims = frame.claims
        good = frame.accepted & claims.claimed & np.isfinite(claims.sigma_m).all(axis=1)
        good &= np.isfinite(claims.error_m).all(axis=1) & (claims.sigma_m > 0.0).all(axis=1)
        rows = np.flatnonzero(good)
        if len(rows) < LEAST:
            continue
        inverse = np.linalg.inv(claims.covariance_m2[rows])
        worst = {
            "stated sigma": claims.sigma_m[rows, 0],
            "detection probability": 1.0
            - claims.probability[rows]
            + 1e-9 * claims.sigma_m[rows, 0],
        }
        for _ in range(DRAWS):
            some = dice.permutation(len(rows))[:POINTS]
            worst["random"] = dice.random(len(rows))
            for order in ORDERS:
                ranked = some[np.argsort(worst[order][some], kind="stable")]
                kept = [ranked[: max(3, round((1.0 - share) * len(ranked)))] for share in SHARES]
                true = claims.found[rows]
                out[order, FALSE].append([float(np.mean(~true[k])) for k in kept])
                for weights in WEIGHTS:
                    off = [_off(claims.error_m[rows], inverse, k[true[k]], weights) for k in kept]
                    out[order, weights].append(off)
    return {key: np.array(values) for key, values in out.items()}


def _off(error: np.ndarray, inverse: np.ndarray, kept: np.ndarray, weights: str) -> float:
    """Error of the position from some of the points."""
    if len(kept) < 3:
        return float("nan")
    if weights == "equal weights":
        return float(np.linalg.norm(error[kept].mean(axis=0)))
    right = np.einsum("nij,nj->i", inverse[kept], error[kept])
    return float(np.linalg.norm(np.linalg.solve(inverse[kept].sum(axis=0), right)))


def report(frames: list[Frame], picture: Path) -> tuple[str, dict[str, object]]:
    """Markdown and figures; draws the curve."""
    found = errors(frames)
    count = len(next(iter(found.values())))
    if not count:
        return "No frame has enough matches.\n", {}
    lines = [
        f"Root mean square (median) error of the position, metres, {count} positions of up to {POINTS} matches.",
        "",
        "| left out by | weights | " + " | ".join(f"{100 * s:.0f} %" for s in SHARES) + " |",
        "| --- | --- |" + " ---: |" * len(SHARES),
    ]
    figures: dict[str, object] = {"positions": count, "shares": SHARES}
    for (order, weights), values in found.items():
        if weights == FALSE:
            share = np.mean(values, axis=0)
            lines.append(
                f"| {order} | {FALSE} | " + " | ".join(f"{100 * s:.1f} %" for s in share) + " |"
            )
            figures[f"{order}, {FALSE}"] = share.tolist()
            continue
        rms, middle = np.sqrt(np.nanmean(values**2, axis=0)), np.nanmedian(values, axis=0)
        cells = [f"{a:.0f} ({b:.0f})" for a, b in zip(rms, middle, strict=True)]
        lines.append(f"| {order} | {weights} | " + " | ".join(cells) + " |")
        figures[f"{order}, {weights}"] = {"rms_m": rms.tolist(), "median_m": middle.tolist()}
    _curve(picture, found)
    return "\n".join(lines) + "\n", figures


def _curve(path: Path, found: dict[tuple[str, str], np.ndarray]) -> None:
    """Rms error over the share left out, one panel for each weighting."""
    panels = []
    for weights in WEIGHTS:
        curves = {o: np.sqrt(np.nanmean(found[o, weights] ** 2, axis=0)) for o in ORDERS}
        top = 1.15 * max(float(c.max()) for c in curves.values())
        panel, at = axes_px(
            _SIDE_PX, (0.0, SHARES[-1]), (0.0, top), "share left out", f"rms error, m: {weights}"
        )
        for k, (order, curve) in enumerate(curves.items()):
            points = [at(s, v) for s, v in zip(SHARES, curve, strict=True)]
            cv2.polylines(panel, [np.array(points, np.int32)], False, _COLOURS[k], 2, cv2.LINE_AA)
            text_px(panel, order, (at(0.02, 0)[0], at(0, 0)[1] - 12 - 18 * k), 0.45, _COLOURS[k])
        panels.append(panel)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.concatenate(panels, axis=1))
