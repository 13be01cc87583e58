"""The section ``[errors]`` of a build's configuration (`config`): the differences between images and renders."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..dem.products import PLACE_PER_LENGTH
from ..fields import check_fields, meant

if TYPE_CHECKING:
    from ..landmarks.error_model import ErrorModel


@dataclass(frozen=True)
class ErrorConfig:
    """The differences between images and renders (`landmarks.error_model.ErrorModel`); None: heights by
    the DEM's product and effective resolution.

    The other figures were fitted to the Apollo 15 frames AS15-M-0414 and AS15-M-0295 on GLD100 cells
    of 474 m (`validation.error_fit`). With a map of albedo of 2.7 km per pixel the fit gave the same
    figure for brightness that no map holds as without one.
    """

    sensor_noise: float = meant(
        0.07,
        "Noise of an image's pixel, 1 sigma, as a share of the mean signal.",
        least=0.0,
        below=1.0,
    )
    height_sigma_m: float | None = meant(
        None,
        "1 sigma of heights.",
        default="the maps of [dem], else the DEM's product, else 2.45 % of what it resolves",
    )
    height_length_m: float | None = meant(
        None,
        "Correlation length of the heights' errors.",
        default="half of the effective resolution",
    )
    albedo_sigma: float = meant(0.09, "Relative 1 sigma of brightness that no map holds.")
    albedo_length_m: float = meant(1900.0, "Its correlation length.")
    position_sigma_m: float | None = meant(
        None,
        "1 sigma of a patch's place, each axis.",
        default=f"{100.0 * PLACE_PER_LENGTH:.2g} % of `errors.height_length_m` (38 m for GLD100)",
    )
    position_sigma_cells: float = meant(
        0.08, "The same at least, in cells: what a search adds that fits a peak between pixels."
    )
    spread: float = meant(0.25, "Standard deviation of the logarithm of all this between places.")
    shadow_shift: float = meant(
        0.11,
        "1 sigma, cells: shift of all points along a grazing Sun's azimuth by shadows below a cell; 0 from 35 deg on.",
    )
    moving_share: float = meant(
        0.25,
        "Part of the noise's covariance that displaces a match; 1 for simulated images whose height errors are independent.",
    )
    contrast_power: float = meant(
        0.9,
        "That part grows as the albedo's local contrast, to twice this power; 0 for such simulated images.",
    )
    detection_shift: float = meant(
        0.0,
        "Probits that a kind of images adds to the probability to find a patch; fitted to the claims of a catalogue.",
        least=-3.0,
        most=3.0,
    )

    def __post_init__(self) -> None:
        check_fields(self, "errors")
        self.model(height_sigma_m=1.0, height_length_m=1.0)

    def model(self, height_sigma_m: float, height_length_m: float) -> ErrorModel:
        """The error model with the given figures where the configuration has none. ConfigError for
        invalid values.
        """
        from ..landmarks.error_model import ErrorModel

        derived = {"height_sigma_m": height_sigma_m, "height_length_m": height_length_m}
        given = {k: v for k, v in dataclasses.asdict(self).items() if v is not None}
        whole = derived | given
        place_m = place_for(whole["height_length_m"])
        return ErrorModel(**({"position_sigma_m": place_m} | whole))


def place_for(length_m: float) -> float:
    """1 sigma of a patch's place, each axis, metres, for a correlation length of height errors."""
    return float(f"{PLACE_PER_LENGTH * length_m:.3g}")
