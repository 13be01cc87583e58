"""Cameras over synthetic terrain, and their pixels, for the tests of pose and consensus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import ON_MAP, FullSensor, Sensor
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.matching.pose import jacobian

HADLEY = EnuFrame(3.6, 26.1)
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
"""Rotation from ENU to a camera that looks straight down, north up."""


def turned(angles_rad: np.ndarray) -> np.ndarray:
    """exp([angles]x) by its own series."""
    x, y, z = angles_rad
    generator = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    total = term = np.eye(3)
    for order in range(1, 30):
        term = term @ generator / order
        total = total + term
    return total


def camera(
    frame: EnuFrame = HADLEY,
    altitude_m: float = 110e3,
    focal_px: float = 268.0,
    size_px: int = 404,
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Camera:
    """A camera above a place, looking down except for a turn about its own axes."""
    middle = (size_px - 1) / 2.0
    return Camera(
        frame.to_mcmf([0.0, 0.0, altitude_m]),
        turned(np.array(tilt)) @ DOWN @ frame.rotation,
        focal_px,
        (middle, middle),
        (size_px, size_px),
    )


def ground(
    sensor: Sensor, count: int, dice: np.random.Generator, relief_m: float = 4e3
) -> np.ndarray:
    """Points (n, 3) that lie in the image, spread over it, at random heights about the level of
    HADLEY's tangent plane.
    """
    rows, cols = sensor.shape
    pixels = np.stack([dice.uniform(0, cols - 1, count), dice.uniform(0, rows - 1, count)], axis=-1)
    origin, looks = sensor.looks(pixels)
    up = HADLEY.rotation[2]
    height = dice.uniform(-0.5, 0.5, count) * relief_m
    reach = (height - (origin - HADLEY.origin_mcmf_m) @ up) / (looks @ up)
    return origin + reach[:, None] * looks


def noise(covariance: np.ndarray, dice: np.random.Generator) -> np.ndarray:
    """One draw (n, 2) of errors with covariances (n, 2, 2)."""
    return np.einsum(
        "nij,nj->ni", np.linalg.cholesky(covariance), dice.normal(size=covariance.shape[:2])
    )


def covariances(count: int, dice: np.random.Generator, sigma_px: float = 0.3) -> np.ndarray:
    """Covariances (n, 2, 2) of positions in an image: elongated, in all orientations, of many
    sizes.
    """
    angle = dice.uniform(0.0, np.pi, count)
    turn = np.stack([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).transpose(
        2, 0, 1
    )
    size = sigma_px * np.exp(dice.normal(0.0, 0.4, (count, 2)))
    return turn * size[:, None, :] ** 2 @ turn.transpose(0, 2, 1)


@dataclass(frozen=True, eq=False)
class PlainMap(FullSensor):
    """A map of the tangent plane at a place, 100 m per pixel, 1000 pixels a side, centred at the
    place.
    """

    frame: EnuFrame = HADLEY
    east_m: float = 0.0
    north_m: float = 0.0
    name: str = "plain map"
    shape: tuple[int, int] = (1000, 1000)
    sun_position_mcmf_m: np.ndarray | None = None
    time_utc: str | None = None
    corrections: tuple[str, ...] = ON_MAP

    def project(self, points_mcmf_m: np.ndarray) -> np.ndarray:
        enu = self.frame.from_mcmf(points_mcmf_m)
        east, north = enu[..., 0] - self.east_m, enu[..., 1] - self.north_m
        return np.stack([499.5 + east / 100.0, 499.5 - north / 100.0], axis=-1)

    def in_image(self, pixels: np.ndarray) -> np.ndarray:
        return np.asarray((np.abs(np.asarray(pixels) - 499.5) < 500.0).all(-1))

    def looks(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        column, row = np.moveaxis(np.asarray(pixels, dtype=float), -1, 0)
        east, north = (column - 499.5) * 100.0 + self.east_m, (499.5 - row) * 100.0 + self.north_m
        above = self.frame.to_mcmf(np.stack([east, north, np.full_like(east, 1e5)], axis=-1))
        return above, np.broadcast_to(-self.frame.rotation[2], above.shape)

    def towards(self, points_mcmf_m: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self.frame.rotation[2], np.shape(points_mcmf_m))

    def moved(self, correction: np.ndarray) -> PlainMap:
        east, north = np.asarray(correction, dtype=float)
        return PlainMap(self.frame, self.east_m + east, self.north_m + north)


def spread_px2(sensor: Sensor, points_mcmf_m: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Covariance (n, 2, 2) of the image places of points (n, 3), to first order, for a covariance
    (k, k) of the sensor's corrections.
    """
    slope = jacobian(sensor, points_mcmf_m)
    return np.asarray(slope @ np.asarray(covariance) @ np.swapaxes(slope, -1, -2))
