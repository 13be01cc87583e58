"""The part of a catalogue that the frames of a descent can use, for a flight file of them alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..cameras.sensor import altitude_km
from ..catalog.catalogue import Catalog
from ..catalog.prediction import conditions_used
from ..errors import AreaError
from ..exports.flight import KeptConditions
from .expected_position import Query, joint_of
from .frame_points import PlannedImage, points_of_frames


@dataclass(frozen=True, eq=False)
class Descent:
    """What the frames use, and the probability of each (f,) that its position is found."""

    kept: KeptConditions
    located: Array


def descent(catalog: Catalog, frames: Iterable[PlannedImage]) -> Descent:
    """The points in view of any frame with a claim there, and the Suns and views from which their claims are
    interpolated (`catalog.prediction`). AreaError if no frame has such a point.
    """
    rows, located = [np.zeros(0, np.int64)], []
    views = np.zeros(len(catalog.view_off_nadir), bool)
    suns = np.zeros((len(catalog.sun_elevation), len(catalog.sun_azimuth)), bool)
    for seen in points_of_frames(catalog, frames):
        some = np.flatnonzero(np.isfinite(seen.claims.detection_probability))
        located.append(joint_of(catalog, seen, Query()).located)
        if not len(some):
            continue
        places = catalog.position_mcmf[seen.rows[some]]
        rotation, sensor = seen.rotation[some], seen.frame.sensor
        view = np.einsum("nij,nj->ni", rotation, sensor.towards(places))
        above_km = altitude_km(sensor, places)
        used = conditions_used(catalog, rotation @ seen.frame.sun, view, above_km)
        views, suns = views | used[0], suns | used[1]
        rows.append(seen.rows[some])
    whole = np.unique(np.concatenate(rows))
    if not len(whole):
        raise AreaError("no frame of the trajectory sees a point with a claim under its Sun")
    return Descent(KeptConditions(whole, views, suns), np.array(located))
