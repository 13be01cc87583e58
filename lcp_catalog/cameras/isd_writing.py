"""ISDs of cameras, and of sensors whose position and attitude were solved."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, NoReturn

import numpy as np

from ..arrays import Array
from ..constants import ASTRONOMICAL_UNIT_M, MOON_RADIUS_M
from ..ephemeris.solar_position import apparent_sun
from ..ephemeris.times import ephemeris_time
from ..errors import CameraError
from ..geometry.rotations import by_vector, inverse, quaternion_of, turned
from .distortion import KaguyaLism, Lens, LroNac, NoLens, OnPlane, OpenCV, UsgsRadial
from .frame_camera import Camera
from .isd import CORNER_PX, Tables, sensor_from_isd
from .json_fields import JsonFields

_MEAN_EARTH = 31001


def isd_of_camera(camera: Camera) -> dict[str, Any]:
    """The ISD of a framing camera. Its J2000 axes are those of MOON_ME at the camera's time: the rotation of the
    body is the identity, so that no orientation of the Moon adds its error.

    CameraError for a camera without a time, or with a lens that an ISD cannot hold.
    """
    if camera.time_utc is None:
        raise CameraError(
            f"{camera.name}: lacks time_utc, which an ISD needs: add it to the camera"
        )
    et, sun = ephemeris_time(camera.time_utc), camera.sun_position_mcmf_m
    if sun is None:
        directions, away_au = apparent_sun(camera.time_utc)
        sun = directions[0] * away_au[0] * ASTRONOMICAL_UNIT_M
    unit, lens = _lens(camera)
    rows, cols = camera.shape
    per_mm = camera.focal_length_px / unit
    column, row = camera.principal_point_px
    now: dict[str, Any] = {"ephemeris_times": [et], "reference_frame": 1}
    turn = quaternion_of(camera.rotation_mcmf_to_camera)
    return {
        "name_model": "USGS_ASTRO_FRAME_SENSOR_MODEL",
        "center_ephemeris_time": et,
        "image_lines": rows,
        "image_samples": cols,
        "radii": {axis: 1e-3 * MOON_RADIUS_M for axis in ("semimajor", "semiminor")},
        "focal_length_model": {"focal_length": unit},
        "focal2pixel_samples": [0.0, per_mm, 0.0],
        "focal2pixel_lines": [0.0, 0.0, per_mm],
        "detector_center": {"sample": column + CORNER_PX, "line": row + CORNER_PX},
        **{f"starting_detector_{axis}": 0 for axis in ("sample", "line")},
        **{f"detector_{axis}_summing": 1 for axis in ("sample", "line")},
        "optical_distortion": lens,
        "instrument_position": now
        | {"positions": [camera.position_mcmf_m.tolist()], "velocities": [[0.0] * 3], "unit": "m"},
        "instrument_pointing": now | {"quaternions": [turn.tolist()]},
        "body_rotation": now
        | {"quaternions": [[1.0, 0.0, 0.0, 0.0]], "time_dependent_frames": [_MEAN_EARTH, 1]},
        "sun_position": now | {"positions": [sun.tolist()], "velocities": [[0.0] * 3], "unit": "m"},
    }


def _lens(camera: Camera) -> tuple[float, dict[str, Any]]:
    """Focal length in the unit of the lens, and the lens, as an ISD has it."""
    lens, unit = camera.focal_plane.lens, 1.0
    if isinstance(lens, OnPlane):
        into, out = np.array(lens.into), np.array(lens.out)
        unit = float(into[0, 0])
        square = unit * np.eye(2)
        if not (np.allclose(into, square, 1e-12) and np.allclose(out @ square, np.eye(2), 1e-12)):
            _no_isd(camera, lens)
        lens = lens.lens
    if isinstance(lens, NoLens):
        return unit, {"radial": {"coefficients": [0.0, 0.0, 0.0]}}
    if isinstance(lens, UsgsRadial):
        return unit, {"radial": {"coefficients": [lens.k0, lens.k1, lens.k2]}}
    if isinstance(lens, LroNac):
        return unit, {"lrolrocnac": {"coefficients": [lens.k]}}
    if isinstance(lens, OpenCV):
        numbers = [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]
        return unit, {"radtan": {"coefficients": numbers}}
    if isinstance(lens, KaguyaLism):
        place = {"boresight_x": lens.boresight_x, "boresight_y": lens.boresight_y}
        return unit, {"kaguyalism": {"x": list(lens.a), "y": list(lens.b), **place}}
    _no_isd(camera, lens)


def _no_isd(camera: Camera, lens: Lens) -> NoReturn:
    name = lens.to_json()["model"]
    raise CameraError(f"{camera.name}: an ISD has no lens {name} in these axes; use a CAMERA.json")


def isd_moved(document: Mapping[str, Any], name: str, correction: Array) -> dict[str, Any]:
    """An ISD whose sensor is corrected by a shift (three metres MCMF) and a turn about the camera's own axes
    (three radians), as `Camera.moved` and `Scanner.moved` do.
    """
    fields = JsonFields(document, name)
    tables, sensor = Tables(fields), sensor_from_isd(fields)
    trajectory, found = tables.trajectory, deepcopy(dict(document))
    pointing = found["instrument_pointing"]
    given = np.reshape(pointing.get("constant_rotation", np.eye(3).ravel()), (3, 3))
    now = np.zeros(3)
    camera_axes = (
        sensor.rotation_mcmf_to_camera
        if isinstance(sensor, Camera)
        else sensor.trajectory.to_mcmf(now, np.eye(3))
    )
    axes = camera_axes @ trajectory.to_mcmf(now, np.eye(3)).T  # sensor frame to camera axes
    turn = axes.T @ by_vector(correction[3:]) @ axes @ given
    pointing["constant_rotation"] = turn.ravel().tolist()
    shift = np.broadcast_to(correction[:3], trajectory.track.positions_m.shape)
    if not trajectory.fixed:
        shift = turned(inverse(trajectory.body.at(trajectory.track.times_s)), shift)
    position = found["instrument_position"]
    position["positions"] = (trajectory.track.positions_m + shift).tolist()
    if trajectory.track.velocities_m_s is not None:
        position["velocities"] = trajectory.track.velocities_m_s.tolist()
    position["unit"] = "m"
    return found
