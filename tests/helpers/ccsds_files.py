"""CCSDS messages of the mission of `spice_kernels`, whose kernels are loaded: OEM and AEM by the standards' texts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import spiceypy

AFTER_TAI_S = {"TAI": 0.0, "TT": 32.184}


def _epochs(system: str, step: float, ordinal: bool = False) -> list[tuple[float, str]]:
    """Ephemeris times of two minutes and more, with their text in a time system."""
    start = spiceypy.str2et("2026-03-01T00:00:00")
    found = []
    for et in start + np.arange(0.0, max(121.0, 4.5 * step), step) - (step if step > 60 else 0.0):
        if system == "UTC":
            text = spiceypy.et2utc(et, "ISOD" if ordinal else "ISOC", 6)
        elif system == "TDB":
            text = spiceypy.timout(et, "YYYY-MM-DDTHR:MN:SC.###### ::TDB")
        else:
            shown = spiceypy.unitim(et, "ET", "TAI") + AFTER_TAI_S[system]
            text = spiceypy.timout(shown, "YYYY-MM-DDTHR:MN:SC.###### ::TDB")
        found.append((et, text))
    return found


def oem(path: Path, frame: str = "EME2000", system: str = "UTC", step: float = 20.0) -> Path:
    axes = "MOON_ME" if frame == "MOON_ME" else "J2000"
    rows = [
        f"{text} " + " ".join(f"{x:.12f}" for x in spiceypy.spkezr("MY_ORBITER", et, axes, "NONE", "MOON")[0])
        for et, text in _epochs(system, step)
    ]  # fmt: skip
    times = f"START_TIME = {rows[0].split()[0]}\nSTOP_TIME = {rows[-1].split()[0]}\n"
    path.write_text(
        "CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2026-01-01T00:00:00\nORIGINATOR = TEST\n\nMETA_START\n"
        "OBJECT_NAME = MY_ORBITER\nOBJECT_ID = 2026-000A\nCENTER_NAME = MOON\n"
        f"REF_FRAME = {frame}\nTIME_SYSTEM = {system}\n{times}META_STOP\n\nCOMMENT a test\n"
        + "\n".join(rows)
        + "\nCOVARIANCE_START\nEPOCH = 2026-03-01T00:00:00\n1.0\n0.1 1.0\nCOVARIANCE_STOP\n"
    )
    return path


def aem(
    path: Path,
    body: str,
    frame: str = "EME2000",
    system: str = "UTC",
    first: bool = False,
    direction: str = "A2B",
    swapped: bool = False,
    ordinal: bool = False,
) -> Path:
    """The quaternion of CCSDS is the vector part e sin(a / 2) of the rotation of the axes, which SPICE has with
    the other sign.
    """
    axes, rows = "MOON_ME" if frame == "MOON_ME" else "J2000", []
    for et, text in _epochs(system, 2.5, ordinal):
        w, *vector = spiceypy.m2q(spiceypy.pxform(axes, body, et))
        sign = 1.0 if (direction == "B2A") != swapped else -1.0
        vector = [sign * x for x in vector]
        numbers = [w, *vector] if first else [*vector, w]
        rows.append(f"{text} " + " ".join(f"{x:.15f}" for x in numbers))
    frames = ("SC_BODY_1", frame) if swapped else (frame, "SC_BODY_1")
    path.write_text(
        "CCSDS_AEM_VERS = 1.0\nCREATION_DATE = 2026-01-01T00:00:00\nORIGINATOR = TEST\n\nMETA_START\n"
        "OBJECT_NAME = MY_ORBITER\nOBJECT_ID = 2026-000A\n"
        f"REF_FRAME_A = {frames[0]}\nREF_FRAME_B = {frames[1]}\nATTITUDE_DIR = {direction}\n"
        f"TIME_SYSTEM = {system}\nSTART_TIME = {rows[0].split()[0]}\nSTOP_TIME = {rows[-1].split()[0]}\n"
        f"ATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = {'FIRST' if first else 'LAST'}\nMETA_STOP\n\nDATA_START\n"
        + "\n".join(rows)
        + "\nDATA_STOP\n"
    )
    return path
