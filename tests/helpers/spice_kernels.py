"""A small mission's SPICE kernels: an orbiter over the Moon with a framing camera and a line scanner. Texts by hand,
SPK and CK written with spiceypy.

The Moon is fixed to IAU_MOON here, and MOON_ME is a small turn from it; the orbit is a circle that passes over
`CENTER` at `TIME`; the camera's columns run to the west, so that its up is north.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import spiceypy

TIME, SPAN_S = "2026-03-01T00:00:00", 600.0
CENTER = (3.5, 26.0)
RADIUS_KM, OBSERVER, BUS, CAMERA, SCANNER = 1837.4, -900, -900000, -900100, -900200
GM = 4902.8

TEXTS = {
    "leap.tls": """KPL/LSK
\\begindata
DELTET/DELTA_T_A = 32.184
DELTET/K = 1.657D-3
DELTET/EB = 1.671D-2
DELTET/M = ( 6.239996D0 1.99096871D-7 )
DELTET/DELTA_AT = ( 36, @2015-JUL-1, 37, @2017-JAN-1 )
""",
    "moon.tpc": """KPL/PCK
\\begindata
BODY301_POLE_RA = ( 269.9949 0.0031 0 )
BODY301_POLE_DEC = ( 66.5392 0.0130 0 )
BODY301_PM = ( 38.3213 13.17635815 -1.4D-12 )
BODY301_RADII = ( 1737.4 1737.4 1737.4 )
""",
    "moon.tf": """KPL/FK
\\begindata
FRAME_MOON_ME = 31011
FRAME_31011_NAME = 'MOON_ME'
FRAME_31011_CLASS = 4
FRAME_31011_CLASS_ID = 31011
FRAME_31011_CENTER = 301
TKFRAME_31011_SPEC = 'ANGLES'
TKFRAME_31011_RELATIVE = 'IAU_MOON'
TKFRAME_31011_ANGLES = ( 12.0 7.0 -5.0 )
TKFRAME_31011_AXES = ( 3, 2, 1 )
TKFRAME_31011_UNITS = 'ARCSECONDS'
""",
    "orbiter.tf": """KPL/FK
\\begindata
NAIF_BODY_NAME += ( 'MY_ORBITER' 'MY_CAMERA' 'MY_SCANNER' )
NAIF_BODY_CODE += ( -900 -900100 -900200 )
FRAME_MY_BUS = -900000
FRAME_-900000_NAME = 'MY_BUS'
FRAME_-900000_CLASS = 3
FRAME_-900000_CLASS_ID = -900000
FRAME_-900000_CENTER = -900
CK_-900000_SCLK = -900
CK_-900000_SPK = -900
FRAME_MY_CAMERA = -900100
FRAME_-900100_NAME = 'MY_CAMERA'
FRAME_-900100_CLASS = 4
FRAME_-900100_CLASS_ID = -900100
FRAME_-900100_CENTER = -900
TKFRAME_-900100_SPEC = 'ANGLES'
TKFRAME_-900100_RELATIVE = 'MY_BUS'
TKFRAME_-900100_ANGLES = ( 90.0 2.0 -1.0 )
TKFRAME_-900100_AXES = ( 3, 2, 1 )
TKFRAME_-900100_UNITS = 'DEGREES'
FRAME_MY_SCANNER = -900200
FRAME_-900200_NAME = 'MY_SCANNER'
FRAME_-900200_CLASS = 4
FRAME_-900200_CLASS_ID = -900200
FRAME_-900200_CENTER = -900
TKFRAME_-900200_SPEC = 'ANGLES'
TKFRAME_-900200_RELATIVE = 'MY_BUS'
TKFRAME_-900200_ANGLES = ( -90.0 0.5 0.0 )
TKFRAME_-900200_AXES = ( 3, 2, 1 )
TKFRAME_-900200_UNITS = 'DEGREES'
""",
    "orbiter.ti": """KPL/IK
\\begindata
INS-900100_FOCAL_LENGTH = 50.0
INS-900100_PIXEL_SIZE = ( 0.05 0.05 )
INS-900100_PIXEL_SAMPLES = 400
INS-900100_PIXEL_LINES = 300
INS-900100_CCD_CENTER = ( 201.25 147.5 )
INS-900100_OD_K = ( 1.0D-3 2.0D-6 0.0 )
INS-900100_FOV_FRAME = 'MY_CAMERA'
INS-900100_BORESIGHT = ( 0 0 1 )
INS-900200_FOCAL_LENGTH = 100.0
INS-900200_PIXEL_PITCH = 0.05
INS-900200_PIXEL_SAMPLES = 500
INS-900200_BORESIGHT_SAMPLE = 240.0
INS-900200_ITRANSS = ( 0 0 20.0 )
INS-900200_ITRANSL = ( 0 20.0 0 )
""",
    "orbiter.tsc": """KPL/SCLK
\\begindata
SCLK_KERNEL_ID = ( @2026-01-01 )
SCLK_DATA_TYPE_900 = ( 1 )
SCLK01_TIME_SYSTEM_900 = ( 1 )
SCLK01_N_FIELDS_900 = ( 2 )
SCLK01_MODULI_900 = ( 4294967296 65536 )
SCLK01_OFFSETS_900 = ( 0 0 )
SCLK01_OUTPUT_DELIM_900 = ( 1 )
SCLK_PARTITION_START_900 = ( 0.0 )
SCLK_PARTITION_END_900 = ( 2.8147497671065E+14 )
SCLK01_COEFFICIENTS_900 = ( 0.0 700000000.0 1.0 )
""",
}


def mission(folder: Path) -> Path:
    """Write the kernels and their META.tm, which names them with their folder; its path."""
    for name, text in TEXTS.items():
        (folder / name).write_text(text, encoding="ascii")
    for name in TEXTS:
        spiceypy.furnsh(str(folder / name))
    try:
        middle = spiceypy.str2et(TIME)
        times = middle + np.linspace(-SPAN_S, SPAN_S, 241)
        states, turns, rates = zip(*(_flight(et, middle) for et in times), strict=True)
        handle = spiceypy.spkopn(str(folder / "orbiter.bsp"), "orbiter", 0)
        ends = (times[0], times[-1])
        spiceypy.spkw13(handle, OBSERVER, 301, "J2000", *ends, "s", 7, len(times), states, times)
        spiceypy.spkcls(handle)
        ticks = [spiceypy.sce2c(OBSERVER, et) for et in times]
        handle = spiceypy.ckopn(str(folder / "orbiter.bc"), "orbiter", 0)
        ends = (ticks[0], ticks[-1])
        spiceypy.ckw03(
            handle, *ends, BUS, "J2000", True, "s", len(ticks), ticks, turns, rates, 1, ticks[:1]
        )
        spiceypy.ckcls(handle)
    finally:
        for name in TEXTS:
            spiceypy.unload(str(folder / name))
    return meta_kernel(folder, str(folder))


def meta_kernel(folder: Path, named: str) -> Path:
    """Write the META.tm of kernels in a folder, which has this name in it; its path."""
    names = "".join(f"'$DIR/{name}'\n" for name in [*TEXTS, "orbiter.bsp", "orbiter.bc"])
    meta = folder / "META.tm"
    meta.write_text(
        "KPL/MK\n\\begindata\nPATH_SYMBOLS = ( 'DIR' )\nPATH_VALUES = (\n"
        + "".join(f"{line}\n" for line in _pieces(named))
        + f")\nKERNELS_TO_LOAD = (\n{names})\n",
        encoding="ascii",
    )
    return meta


def _pieces(path: str) -> list[str]:
    """A text in pieces that a line of a kernel can hold."""
    parts = [path[k : k + 70] for k in range(0, len(path), 70)]
    return [f"'{part}{'+' if k < len(parts) - 1 else ''}'" for k, part in enumerate(parts)]


def _flight(et: float, middle: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State, quaternion of the bus and its rate: down is z, along the track y, on a polar circle over `CENTER`."""
    to_j2000 = spiceypy.pxform("MOON_ME", "J2000", middle)
    lon, lat = np.radians(CENTER)
    up = to_j2000 @ [np.cos(lon) * np.cos(lat), np.sin(lon) * np.cos(lat), np.sin(lat)]
    south = to_j2000 @ [np.cos(lon) * np.sin(lat), np.sin(lon) * np.sin(lat), -np.cos(lat)]
    rate = np.sqrt(GM / RADIUS_KM**3)
    angle = rate * (et - middle)
    there = np.cos(angle) * up + np.sin(angle) * south
    along = np.cos(angle) * south - np.sin(angle) * up
    across = np.cross(along, -there)
    axes = np.stack([across, along, -there])
    state = np.concatenate([RADIUS_KM * there, RADIUS_KM * rate * along])
    return state, spiceypy.m2q(axes), axes @ (rate * np.cross(there, along))
