"""Cameras and solved positions for other programs: SPICE's SPK (``.bsp``, type 13) and CK (``.bc``, type 3), and ISD
(``.json``).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array
from ..atomic_files import ending_of, write_aside, write_bytes
from ..cameras.camera_file import read_sensor
from ..cameras.frame_camera import Camera
from ..cameras.isd import is_isd
from ..cameras.isd_writing import isd_moved, isd_of_camera
from ..cameras.json_fields import JsonFields, parsed
from ..cameras.sensor import POSE
from ..cameras.spice import OpenInstrument, SpiceCamera, loaded
from ..cameras.trajectory import Track
from ..child_process import call_apart
from ..choices import CAMERA_EXPORTS
from ..ephemeris.times import ephemeris_time
from ..errors import CameraError, ConfigError, unread
from .points import write_checked

GAP_S = 600.0
"""Cameras that are farther apart in time are in segments of their own: nothing is interpolated between them."""

ALONE_S = 0.5
"""Time before and after a camera without neighbours for which it is valid: its velocity and attitude go on."""

_NOT_COVERED = ("SPICE(SPKINSUFFDATA)", "SPICE(NOLOADEDFILES)")
_DEGREE = 7
_NODES = 257
_LONGEST_S = 600.0


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Ephemeris times (n,), positions (n, 3), MOON_ME metres, rotations (n, 3, 3) from MOON_ME to camera axes."""

    times: Array
    positions_m: Array
    rotations: Array


def export_cameras(
    cameras: Sequence[Path | str] | Path | str,
    output: Path | str,
    report: Path | str | None = None,
    kernels: Path | str | Sequence[Path | str] = (),
    observer: str = "",
    instrument: str = "",
    overwrite: bool = False,
) -> int:
    """Write cameras, or the positions that a validation solved for them, as SPICE kernel or ISD.

    Parameters
    ----------
    cameras:
        Camera files with a time: CAMERA.json, or an ISD.
    output:
        ``.json``: the ISD of one camera; ``.bsp``: the observer's positions; ``.bc``: the attitude of the structure (CK)
        that carries the instrument.
    report:
        ``report.json`` of `validate`, whose images had these cameras, in the same order: the cameras are corrected by
        its solutions, and those without one are left out.
    kernels, observer, instrument:
        For ``.bsp`` and ``.bc``: as of `SpiceCamera`.
    overwrite:
        True: replace an existing output.

    Returns
    -------
    int
        Number of cameras written.

    Raises
    ------
    CameraError
        For cameras without a time, for kernels that lack something, and for a damaged report.
    ConfigError
        For another ending, and for a report of other images.

    Examples
    --------
    >>> camera = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", "2026-03-01", kernels=folder / "META.tm")
    >>> _ = (folder / "one.json").write_text(json.dumps(camera.to_json()))
    >>> lcp.export_cameras(folder / "one.json", folder / "one_isd.json")
    1
    """
    given = [cameras] if isinstance(cameras, Path | str) else list(cameras)
    ending = ending_of(output, CAMERA_EXPORTS)
    corrections = [np.zeros(6)] * len(given) if report is None else _solved(report, len(given))
    kept = [
        (Path(path), one) for path, one in zip(given, corrections, strict=True) if one is not None
    ]
    if not kept:
        raise ConfigError(f"{report}: no image is located: nothing to write")
    if ending == ".json":
        if len(kept) > 1:
            raise ConfigError(f"{output}: an ISD is of one camera, not of {len(kept)}")
        text = json.dumps(_isd(kept[0][0], kept[0][1]), allow_nan=False)
        write_bytes(output, f"{text}\n".encode(), overwrite)
        return 1
    nodes = sorted(
        (_nodes(path, moved) for path, moved in kept), key=lambda one: float(one.times[0])
    )
    with loaded(kernels) as spice:
        there = OpenInstrument(spice, SpiceCamera(observer, instrument))
        make = _spk if ending == ".bsp" else _ck
        segments = [make(there, one) for one in _segments(nodes)]
    with write_aside(output, overwrite, given) as path:

        def write(files: tuple[Path, Path]) -> None:
            argument = json.dumps([ending, list(map(str, files)), segments])
            call_apart(write_kernels, argument, _LONGEST_S)

        write_checked(write, path)
    return len(kept)


def _solved(report: Path | str, count: int) -> list[Array | None]:
    """Corrections (6,) of the images of a report, None for one that is not located."""
    try:
        images = json.loads(Path(report).read_text(encoding="utf-8"))["images"]
        poses = [image["pose"] for image in images]
    except OSError as error:
        raise unread(report, error) from error
    except (ValueError, KeyError, TypeError) as error:
        raise CameraError(f"{report}: is no report.json of a validation, or damaged") from error
    if len(poses) != count:
        raise ConfigError(f"{report}: is of {len(poses)} images, and {count} cameras are given")
    if any(pose and set(pose["correction"]) != set(POSE) for pose in poses):
        raise ConfigError(f"{report}: map-projected images have no camera")
    return [pose and np.array([pose["correction"][name] for name in POSE]) for pose in poses]


def _document(path: Path) -> JsonFields:
    return parsed(path.read_text(encoding="utf-8"), str(path))


def _isd(path: Path, correction: Array) -> dict[str, Any]:
    sensor = read_sensor(path)
    if path.suffix.lower() != ".tsai" and is_isd(fields := _document(path)):
        return isd_moved(fields.document, str(path), correction)
    assert isinstance(sensor, Camera)  # only ISDs are of others
    return isd_of_camera(sensor.moved(correction))


def _nodes(path: Path, correction: Array) -> _Nodes:
    sensor = read_sensor(path).moved(correction)
    if isinstance(sensor, Camera):
        if sensor.time_utc is None:
            raise CameraError(f"{path}: lacks time_utc, which a kernel needs: add it")
        place, turn = sensor.position_mcmf_m[None], sensor.rotation_mcmf_to_camera[None]
        return _Nodes(np.array([ephemeris_time(sensor.time_utc)]), place, turn)
    middle, half = sensor.middle_s, 0.5 * sensor.duration_s
    times = middle + np.linspace(-half, half, _NODES)
    axes = [sensor.trajectory.to_mcmf(times, np.tile(axis, (_NODES, 1))) for axis in np.eye(3)]
    centre = _document(path).number("center_ephemeris_time")
    return _Nodes(centre + times, sensor.trajectory.positions(times), np.stack(axes, axis=1))


def _segments(nodes: Sequence[_Nodes]) -> list[_Nodes]:
    """The nodes in time, cut where neighbours are more than `GAP_S` apart, or overlap."""
    groups = [[nodes[0]]]
    for one in nodes[1:]:
        if 0.0 < one.times[0] - groups[-1][-1].times[-1] <= GAP_S:
            groups[-1].append(one)
        else:
            groups.append([one])
    parts = [
        [getattr(one, name) for one in group] for group in groups for name in _Nodes.__annotations__
    ]
    joined = [np.concatenate(part) for part in parts]
    return [_Nodes(*joined[k : k + 3]) for k in range(0, len(joined), 3)]


def _spk(there: OpenInstrument, nodes: _Nodes) -> dict[str, Any]:
    """A segment of positions (km) and velocities (km/s), J2000, about the Moon."""
    times = nodes.times
    turns = [there.turn(there.body, et).T for et in times]
    places = np.einsum("nij,nj->ni", turns, 1e-3 * nodes.positions_m)
    speeds = _velocities(there, times, places)
    if len(times) == 1:
        around = ALONE_S * np.array([-1.0, 0.0, 1.0])
        times, places = times + around, places + around[:, None] * speeds
        speeds = np.repeat(speeds, 3, axis=0)
    return {
        "body": there.observer,
        "degree": min(_DEGREE, 2 * len(times) - 1),
        "times": times.tolist(),
        "states": np.concatenate([places, speeds], axis=1).tolist(),
    }


def _velocities(there: OpenInstrument, times: Array, places: Array) -> Array:
    """Velocities (n, 3): of the kernels' own trajectory, else of the positions, else of one that stays over
    the ground.
    """
    try:
        return np.array([there.state(et)[3:] for et in times])
    except CameraError as error:
        if getattr(error.__cause__, "short", "") not in _NOT_COVERED:  # a kernel that is not read
            raise
        if len(times) > 1:
            track, step = Track(times - times[0], places), 1e-3 * float(np.diff(times).min())
            inside = np.clip(times - times[0], step, times[-1] - times[0] - step)
            return np.asarray((track.at(inside + step) - track.at(inside - step)) / (2.0 * step))
        later, here = (there.turn(there.body, times[0] + s).T for s in (1.0, 0.0))
        return np.asarray(((later - here) @ here.T @ places.T).T)


def _ck(there: OpenInstrument, nodes: _Nodes) -> dict[str, Any]:
    """A segment of attitudes from J2000 to the structure, at ticks of its clock."""
    structure, mounting = there.carrier()
    to_instrument = mounting @ there.camera_axes().T
    quaternions = [
        there.spice.m2q(to_instrument @ turn @ there.turn(there.body, et)).tolist()
        for et, turn in zip(nodes.times, nodes.rotations, strict=True)
    ]
    times = nodes.times
    if len(times) == 1:
        times = times + ALONE_S * np.array([-1.0, 1.0])
        quaternions *= 2
    return {
        "structure": structure,
        "times": there.ticks(structure, times),
        "quaternions": quaternions,
    }


def write_kernels(given: str) -> None:
    """Write SPK or CK files of JSON: ending, files, segments; in a process of its own, since SPICE ends its process
    where it cannot write.
    """
    ending, files, segments = json.loads(given)
    spice = import_module("spiceypy")
    for file in files:
        name = "lcp cameras"
        handle = (spice.spkopn if ending == ".bsp" else spice.ckopn)(file, name, 0)
        for one in segments:
            times = one["times"]
            ends = times[0], times[-1]
            if ending == ".bsp":
                spice.spkw13(
                    handle, one["body"], 301, "J2000", *ends, name, one["degree"], len(times), one["states"], times
                )  # fmt: skip
            else:
                still = np.zeros((len(times), 3))
                spice.ckw03(
                    handle, *ends, one["structure"], "J2000", False, name,
                    len(times), times, one["quaternions"], still, 1, times[:1],
                )  # fmt: skip
        (spice.spkcls if ending == ".bsp" else spice.ckcls)(handle)
