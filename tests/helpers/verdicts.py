"""Synthetic validation results for tests: a camera above the Moon, points with known errors,
windows of noise.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import ON_MAP, Uncertainty
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.matching.fix import Fix
from lcp_catalog.matching.matches import REASONS, Matches
from lcp_catalog.matching.pose import Pose, position_error, solve
from lcp_catalog.matching.sun_verdict import SunCheck
from lcp_catalog.validation import result
from lcp_catalog.validation.claims import Claims
from lcp_catalog.validation.ground_comparison import WindowComparison, compare
from lcp_catalog.validation.result import Pictures

WIDTH, HEIGHT = 640, 480
ALTITUDE_M = 100e3
MOVED = np.array([300.0, -200.0, 400.0, 5e-4, -4e-4, 3e-4])


def camera() -> Camera:
    """Above 0 E, 0 N, looking down; right is east."""
    rotation = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    place = np.array([MOON_RADIUS_M + ALTITUDE_M, 0.0, 0.0])
    middle = ((WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0)
    return Camera(place, rotation, 500.0, middle, (WIDTH, HEIGHT))


def ground(pixels: np.ndarray) -> np.ndarray:
    """Intersections of the rays of pixels (n, 2) with a plane 1 km below the sphere's top, (n, 3)."""
    start, ahead = camera().looks(pixels)
    return start + ahead * ((MOON_RADIUS_M - 1e3 - start[:, :1]) / ahead[:, :1])


def matches(n: int, seed: int = 0) -> tuple[Matches, np.ndarray]:
    """Random points with all match results, and their positions (n, 3). Found pixels differ from
    the true ones by their covariance.
    """
    dice = np.random.default_rng(seed)
    true = dice.uniform([5.0, 5.0], [WIDTH - 6.0, HEIGHT - 6.0], (n, 2))
    root = dice.normal(size=(n, 2, 2)) * 0.15
    covariance = root @ root.transpose(0, 2, 1) + 0.003 * np.eye(2)
    noise = np.linalg.cholesky(covariance) @ dice.normal(size=(n, 2, 1))
    code = (np.arange(n) * 5 % (2 * len(REASONS))).astype(np.uint8)
    code[code >= len(REASONS)] = 0
    lost = code != 0
    found, correlation = true + noise[..., 0], dice.uniform(0.7, 0.98, n)
    nowhere = lost & (
        code != REASONS.index("inconsistent")
    )  # what no camera sees there was found all the same
    found[nowhere], covariance[nowhere], correlation[lost] = np.nan, np.nan, 0.4
    correlation[code == REASONS.index("not lit")] = np.nan
    places = ground(true)
    predicted = camera().moved(MOVED).project(places)
    second, back = correlation - 0.3, np.where(lost, np.nan, 0.1)
    rows = np.arange(n, dtype=np.int64)
    prior = np.where(rows % 5 == 0, np.nan, dice.random(n))
    posterior = np.where(nowhere, np.nan, dice.random(n))
    made = Matches(
        rows, predicted, found, covariance, correlation, second, back, code, prior, posterior
    )
    return made, places


def solved(found: Matches, places: np.ndarray) -> Pose:
    """The given camera, corrected by the points found."""
    use = found.found
    prior = Uncertainty(600.0, 1e-3)
    chosen = (places[use], found.found_px[use], found.covariance_px2[use])
    return solve(camera().moved(MOVED), *chosen, prior)


def on_map() -> Pose:
    """A map moved by 3 m east and 4 m south."""
    sensor: Any = SimpleNamespace(corrections=ON_MAP)  # a pose asks no more of its sensor
    covariance = np.array([[4.0, 1.0], [1.0, 9.0]])
    yes = np.ones(2, dtype=bool)
    return Pose(sensor, np.array([3.0, -4.0]), covariance, yes, yes, 5.0, 4.0)


def pictures(rows: int = 96, cols: int = 128, seed: int = 0) -> Pictures:
    """Images for a report: blocks of 2 x 2 pixels; image and render of terrain that differ by
    noise, each with gaps and bright spots.
    """
    dice = np.random.default_rng(seed)
    render = np.cumsum(dice.normal(size=(rows, cols)), axis=1)
    image = (
        5.0
        + 2.0 * render
        + dice.normal(size=render.shape) * np.linspace(0.0, 20.0, cols) ** 1.5 / 4.0
    )
    image[:9, :17] = np.nan
    image[-6:, :20] += 1e3
    render[-6:, :20] = np.nan
    return Pictures(dice.uniform(size=(HEIGHT // 2, WIDTH // 2)), 2, image, render)


def windows(shown: Pictures) -> result.WindowFigures:
    """Window figures of the terrain images in ``shown``."""
    found = compare(shown.ground_image, shown.ground_render, gsd_m=948.0, search_px=2)
    return figures_of(found)


def figures_of(found: WindowComparison) -> result.WindowFigures:
    places = np.linspace(3.0, 4.0, found.count), np.linspace(26.0, 25.0, found.count)
    return result.WindowFigures(
        found, found, "from the heights' spectrum", "heights of 118 m", *places
    )


def claims(n: int, seed: int = 0) -> Claims:
    """Claims on random points, and trials that bear them out: each point is found with the claimed
    probability, its error drawn from the claimed ellipse. Every tenth point is without a claim,
    every seventh without a trial.
    """
    dice, order = np.random.default_rng([seed, 14]), np.arange(n)
    probability = dice.beta(3.0, 0.8, n)
    sigma = np.sort(dice.uniform(20.0, 90.0, (n, 2)), axis=1)[:, ::-1]
    angle, along = dice.uniform(0.0, 180.0, n), sigma * dice.normal(size=(n, 2))
    turn = np.radians(angle)
    error = along[:, :1] * np.stack([np.sin(turn), np.cos(turn)], axis=-1)
    error += along[:, 1:] * np.stack([np.cos(turn), -np.sin(turn)], axis=-1)
    claimed = order % 10 != 3
    tried = claimed & (order % 7 != 5)
    found = tried & (dice.random(n) < probability)
    error[~tried] = np.nan
    probability[~claimed], sigma[~claimed], angle[~claimed] = np.nan, np.nan, np.nan
    usable = claimed & (np.nan_to_num(probability) >= 0.9)
    return Claims(probability, usable, sigma, angle, tried, found, error)


def image(
    name: str = "frame.png", n: int = 60, located: bool = True, seed: int = 0
) -> result.ImageVerdict:
    """A result with a pose and windows, or without."""
    found, places = matches(n, seed)
    pose, error, corrected = None, None, np.full((n, 2), np.nan)
    if located:
        solution = solved(found, places)
        corrected = solution.sensor.project(places)
        pose, error = solution, position_error(solution, camera())
    points = result.PointFigures(
        np.arange(n, dtype=np.int64) * 7 + 10**15,
        np.linspace(0.0, 1.0, n),
        np.linspace(-1.0, 1.0, n),
        np.linspace(150.0, 250.0, n),
        corrected,
    )
    light = SunCheck(
        points=30,
        independent=20.0,
        correlation=0.9,
        turns_deg=((-20.0, 0.0), (0.0, 10.0)),
        correlations=(0.625, np.nan),
        gains=(-0.2, np.nan),
        shares=(0.125, np.nan),
        shifts_px=(0.25, np.nan),
    )
    verdict, reason = (
        (result.LOCATED, "")
        if located
        else (result.NOT_HERE, "3 of 30 points agree, as many as chance would give")
    )
    facts = result.ImageFacts(
        name, WIDTH, HEIGHT, "framing camera", 200.0, 90.0, 30.0, 0.0, "the camera file", 0.01, 0.0
    )
    return result.ImageVerdict(
        facts,
        Fix(verdict, reason, found, pose, -40.25, -0.5, light if located else None),
        points,
        claims(n, seed) if located else Claims.none(n, "the image was not located"),
        windows(pictures()) if located else None,
        "" if located else "without a place there is nothing to compare",
        error,
    )


def nothing(name: str = "blank.png") -> result.ImageVerdict:
    """An image with no point in view."""
    empty, pairs = np.empty(0), np.empty((0, 2))
    none = Matches(
        np.empty(0, np.int64), pairs, pairs, np.empty((0, 2, 2)), empty, empty, empty, np.empty(0, np.uint8)
    )  # fmt: skip
    said = Fix(result.CANNOT_SAY, "no point is in view", none, None, 0.0, 0.0, None)
    facts, points = result.ImageFacts(name, WIDTH, HEIGHT), result.PointFigures.none()
    return result.ImageVerdict(facts, said, points, Claims.none(reason="no point is in view"))


def unopened(name: str = "lost.png") -> result.ImageVerdict:
    """An image without a camera."""
    said = Fix(result.CANNOT_SAY, "missing geometry", Matches.none(), None, 0.0, 0.0, None)
    claims = Claims.none(reason="the image was not searched")
    return result.ImageVerdict(result.ImageFacts(name), said, result.PointFigures.none(), claims)


def whole() -> result.ValidationResult:
    """Three images: located, not this place, cannot say."""
    images = (image(), image("other.png", located=False), nothing())
    return result.ValidationResult(
        images, {"name": "c.h5", "points": 60}, {"size": 16, "gsd_m": None}
    )
