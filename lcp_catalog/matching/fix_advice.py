"""What would help where an image is not located, and verdicts that the search does not carry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cameras.frame_camera import Camera
from ..cameras.mistakes import likely_mistake
from ..cameras.sensor import Sensor, Uncertainty, pixel_size_m
from ..catalog.catalogue import Catalog
from ..landmarks.ground_votes import FEWEST
from .fix import CANNOT_SAY, NOT_HERE, Fix
from .search_area import perhaps_in_view


def advised(
    located: Fix,
    catalog: Catalog,
    sensor: Sensor,
    uncertainty: Uncertainty,
    sigmas: float,
) -> Fix:
    """The result of a search over ``sigmas`` times the uncertainty, with what would help in its reason.

    A place is not refuted by an image that is smaller than the search's reach (the ground in the image may
    hold none of the points), nor by fewer than `FEWEST` points (so few together cannot show one): the verdict is then `CANNOT_SAY`.
    """
    if located.pose is not None:
        return located
    area = perhaps_in_view(catalog, sensor, uncertainty, sigmas)
    if not len(area):
        return replace(
            located, reason=located.reason + _camera(catalog, sensor, uncertainty, sigmas)
        )
    if located.verdict not in (NOT_HERE, CANNOT_SAY):
        return located
    side, reach = min(sensor.shape), float(np.median(area.reach_px))
    help_ = _few_points(catalog, len(area)) if len(area) < FEWEST else ""
    if reach > side:
        help_ = _wide(catalog, sensor, uncertainty, (sigmas, reach), area.points) + help_
    if not help_:
        return located
    return replace(located, verdict=CANNOT_SAY, reason=located.reason + help_)


def _camera(catalog: Catalog, sensor: Sensor, uncertainty: Uncertainty, sigmas: float) -> str:
    """The mistake of a camera that has none of the points in view, as the end of a sentence."""

    def sees(camera: Camera) -> bool:
        return len(perhaps_in_view(catalog, camera, uncertainty, sigmas)) > 0

    mistake = likely_mistake(sensor, sees)
    return f"; {mistake}" if mistake else ""


def _wide(
    catalog: Catalog,
    sensor: Sensor,
    uncertainty: Uncertainty,
    searched: tuple[float, float],
    points: np.ndarray,
) -> str:
    """Advice on an uncertainty whose reach, ``searched``: number of sigmas and pixels, is wider than the image."""
    sigmas, reach = searched
    pixel_m = float(np.nanmedian(pixel_size_m(sensor, catalog.position_mcmf[points])))
    side = min(sensor.shape)
    alone = Uncertainty(0.0, uncertainty.attitude_rad)
    turning = perhaps_in_view(catalog, sensor, alone, sigmas).reach_px
    by_attitude = len(turning) > 0 and float(np.median(turning)) > 0.5 * reach
    share = 0.5 * side / reach
    if by_attitude:
        smaller = f"{np.degrees(uncertainty.attitude_rad) * share:.2g} deg of attitude"
    else:
        smaller = f"{uncertainty.position_m * share:.2g} m of position"
    return (
        f"; the stated uncertainty reaches {reach * pixel_m:.0f} m ({sigmas:g} sigma), further than the image of "
        f"{side * pixel_m:.0f} m: state a smaller one if it is known, like {smaller}"
    )


def _few_points(catalog: Catalog, count: int) -> str:
    """Advice on a catalogue with few points in view."""
    cell_m = float(np.median(catalog.gsd))
    return (
        f"; only {count} points may be in view: build the catalogue with more (a smaller "
        f"spacing, or finer cells than {cell_m:.3g} m)"
    )
