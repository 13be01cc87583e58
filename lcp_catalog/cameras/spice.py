"""Sensors from SPICE kernels: position by SPK, attitude by CK, FK and SCLK, the Moon's orientation by PCK
and FK, times by LSK, focal plane by IK. They pass through the content of an ISD (`isd`).

Everything is geometric: the observer relative to the Moon's centre and the instrument's frame, both at the
time itself. Neither light time nor stellar aberration is corrected (``NONE`` of SPICE).

SPICE has one pool of kernels a process and no locks: one thread at a time.
"""

from __future__ import annotations

import math
import os
import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..ephemeris.times import Time, Times, instants
from ..errors import CameraError, package, printable, unknown_keys, unread
from ..file_kinds import may_wait
from .frame_camera import Camera
from .isd import Tables, frame_from_isd, plane_of_isd, sensor_from_isd
from .json_fields import JsonFields
from .scanners import LineScanner

MEAN_EARTH = ("MOON_ME", "MOON_ME_DE440_ME421", "MOON_ME_DE421")
"""Names of the mean-Earth frame in NAIF's frame kernels, the first that is loaded is used."""

KEYWORDS = {
    # keyword of the instrument kernel, without INS<id>_: how many numbers, in which unit
    "FOCAL_LENGTH": (1, "mm"),
    "PIXEL_PITCH": (1, "mm"),
    "PIXEL_SIZE": (2, "mm"),
    "PIXEL_SAMPLES": (1, "pixels"),
    "PIXEL_LINES": (1, "pixels"),
    "BORESIGHT_SAMPLE": (1, "pixels from 1"),
    "BORESIGHT_LINE": (1, "pixels from 1"),
    "CCD_CENTER": (2, "pixels from 0"),
    "ITRANSS": (3, "pixels, pixels per mm"),
    "ITRANSL": (3, "pixels, pixels per mm"),
    "OD_K": (3, "1, mm^-2, mm^-4"),
    "BORESIGHT": (3, "a direction"),
}
"""What is read of an instrument kernel."""

_NAC = (-85600, -85610)
"""Instruments whose OD_K is the single number of LROC NAC's lens."""

_DAF = struct.Struct("84x4s8s")
"""Begin of a binary kernel (DAF): its first free place (in numbers of 8 bytes, from 1), and the order of its bytes."""

_RECORD = 1024
"""Bytes of a record of a binary kernel, of which SPICE reads whole ones."""

_COARSEST_MM = 0.2
_ROWS = 10_000
_WINDOWS = 20_000


@contextmanager
def loaded(kernels: Path | str | Sequence[Path | str]) -> Iterator[Any]:
    """The module spiceypy, with kernels loaded for the block beside those that the program has loaded.

    CameraError, one line, for one that SPICE refuses, for one that is cut, and for what SPICE refuses in the block;
    InputError for one that is not there; MissingPackageError without spiceypy.
    """
    spice = package("spiceypy", "spice", "SPICE kernels")
    done = []
    try:
        for one in [kernels] if isinstance(kernels, Path | str) else kernels:
            if not Path(one).is_file():
                raise unread(one, FileNotFoundError())
            _refuse_pipes(Path(one))
            done.append(str(one))  # a meta-kernel that fails half-way has loaded some
            before = spice.ktotal("ALL")
            with _explained(spice, f"{one}: SPICE cannot load it"):
                spice.furnsh(str(one))
            for k in range(before, spice.ktotal("ALL")):
                _check_whole(spice.kdata(k, "ALL")[0])
        with _explained(spice, "a kernel lacks something, or is cut"):
            yield spice
    finally:
        for name in reversed(done):
            spice.unload(name)


def kernel_files(path: Path | str) -> list[Path]:
    """A kernel's file, or that of a meta-kernel and the files that it names."""
    with loaded(path) as spice:
        names = [spice.kdata(k, "ALL")[0] for k in range(spice.ktotal("ALL"))]
    return [Path(name) for name in names]


def _refuse_pipes(path: Path) -> None:
    """CameraError for a meta-kernel that names a pipe or a device, for whose writer SPICE would wait."""
    try:
        with path.open("rb") as file:
            start = file.read(1_000_000)
    except OSError as error:
        raise unread(path, error) from error
    names = [os.fsdecode(name) for name in re.findall(rb"'([^'\n\0]*)'", start)]
    folders = [name for name in names if os.path.isdir(name)]  # values of path symbols
    for name in names:
        signs = re.findall(r"\$\w+", name)
        for place in [name.replace(sign, at) for sign in signs for at in folders] or [name]:
            if may_wait(place):
                raise CameraError(
                    f"{path}: names {printable(place)}, which is no plain file; give kernels as files"
                )


def _check_whole(path: str) -> None:
    """CameraError for a kernel that is cut, of which SPICE takes what is left: a binary one is shorter than it says, a
    text ends within a line or a list. Kernels have no checksums: nothing else shows it.
    """
    try:
        with open(path, "rb") as file:
            head, size = file.read(_DAF.size), os.fstat(file.fileno()).st_size
            binary = head.startswith((b"DAF/", b"NAIF/DAF", b"DAS/"))
            text = b"" if binary else head + file.read()
    except OSError as error:
        raise unread(path, error) from error
    if not binary:
        blocks = [one.partition(b"\\begintext")[0] for one in text.split(b"\\begindata")[1:]]
        lists = re.sub(rb"'[^'\n]*'", b"", b"".join(blocks))
        if not text.endswith(b"\n"):
            raise CameraError(f"{path}: its last line has no end: it is cut, or add a newline")
        if lists.count(b"(") != lists.count(b")"):
            raise CameraError(f"{path}: is cut: a list has no end")
    elif not head.startswith(b"DAS/"):
        free, layout = _DAF.unpack_from(head.ljust(_DAF.size, b"\0"))
        first_free = int.from_bytes(free, "big" if layout == b"BIG-IEEE" else "little")
        wanted = _RECORD * (-(-8 * (first_free - 1) // _RECORD))
        if size < wanted:
            raise CameraError(f"{path}: is cut: it has {size} of {wanted} bytes")


def _twice(found: Callable[[], Any]) -> Array:
    """What SPICE finds, asked twice: a read that fails gave zeros once, without an error. CameraError if they differ."""
    first, second = np.asarray(found()), np.asarray(found())
    if not np.array_equal(first, second):
        raise CameraError("SPICE could not read a kernel: it gives two answers to one question")
    return second


@contextmanager
def _explained(spice: Any, what: str) -> Iterator[None]:
    """CameraError of an error of SPICE, with its own words in one line."""
    try:
        yield
    except spice.utils.exceptions.SpiceyError as error:
        parts = (getattr(error, name, "") for name in ("short", "long", "explain"))
        short, long, explain = parts  # a NotFoundError has none of them
        said = " ".join((long or explain or str(error)).split())
        if "NOSUCHFILE" in short:
            said += " (names in a meta-kernel without a folder are those of the working folder)"
        raise CameraError(f"{what}: {short} {said}") from error


@dataclass(frozen=True)
class SpiceCamera:
    """An instrument of a spacecraft, by the names that its kernels have for them.

    Every method raises CameraError, one line: kernels that are missing or refused, a time that they do not cover, an
    unknown instrument or keyword.

    Parameters
    ----------
    observer, instrument:
        Names, or NAIF numbers as text: ``LRO`` and ``LRO_LROCNACL``.
    kernels:
        Files, also meta-kernels, that are loaded for each call beside those that the program has loaded with spiceypy.
    ik:
        Keywords of the instrument kernel without ``INS<id>_`` and their numbers (`KEYWORDS`), which have precedence over
        the kernel's.
    body_frame:
        The Moon's frame; default: the mean-Earth frame of the kernels.
    summing:
        Side, in pixels of the detector, of a pixel of the image.

    Examples
    --------
    >>> orbiter = lcp.SpiceCamera("MY_ORBITER", "MY_CAMERA", kernels=[folder / "META.tm"])
    >>> [camera.time_utc for camera in orbiter.along(lcp.instant_range("2026-03-01", "2026-03-01T00:02", "1m"))]
    ['2026-03-01T00:00:00Z', '2026-03-01T00:01:00Z', '2026-03-01T00:02:00Z']
    """

    observer: str
    instrument: str
    kernels: Path | str | Sequence[Path | str] = ()
    ik: Mapping[str, float | Sequence[float]] = field(default_factory=dict)
    body_frame: str | None = None
    summing: int = 1

    def __post_init__(self) -> None:
        if unknown := unknown_keys(self.ik, KEYWORDS):
            raise CameraError(f"`ik`: has {unknown}")

    def at(self, time: Time) -> Camera:
        """The framing camera at an instant (UTC)."""
        return self.along(time)[0]

    def along(self, times: Times) -> list[Camera]:
        """The framing cameras at instants (UTC), in their order."""
        with loaded(self.kernels) as spice:
            there = OpenInstrument(spice, self)
            common, looks_back = there.focal_plane(), there.looks_back
            common |= {
                "name_model": "USGS_ASTRO_FRAME_SENSOR_MODEL",
                "image_lines": int(there.number("PIXEL_LINES")) // self.summing,
            }
            found: list[Camera] = []
            for label in instants(times).labels():
                et = there.time(label)
                fields = JsonFields(common | there.tables([et], et), f"{self.instrument} {label}")
                if not found:
                    Tables(fields).check_body()
                camera = frame_from_isd(fields, Tables(fields), looks_back)
                found.append(replace(camera, time_utc=label))
        return found

    def scanner_isd(self, start: Time, stop: Time, line_s: float) -> dict[str, Any]:
        """The ISD of an image of a line scanner: from the begin of the exposure of its first line to the end of that
        of its last, with ``line_s`` seconds a line.
        """
        labels = instants([start, stop]).labels()
        with loaded(self.kernels) as spice:
            there = OpenInstrument(spice, self)
            if (rows := there.numbers("PIXEL_LINES")) and rows[0] > 1.0:
                raise CameraError(
                    f"{self.instrument} has {rows[0]:g} lines (PIXEL_LINES), so it is no line scanner: take a framing camera's "
                    "image by `time`, and of a push-frame camera the ISD of ALE; a line of such a detector by `ik` PIXEL_LINES=1"
                )
            first, last = map(there.time, labels)
            lines = round((last - first) / line_s) if line_s > 0.0 else 0
            if not 1 <= lines <= 1_000_000:
                raise CameraError(
                    f"`stop` is {last - first:g} s after `start`: {lines} lines of {line_s:g} s; 1 to a million are possible"
                )
            middle = 0.5 * (first + last)
            nodes = np.linspace(first, last, min(lines, _ROWS) + 1)
            document = there.focal_plane() | {
                "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL",
                "image_lines": lines,
                "line_scan_rate": [[0.5, first - middle, line_s]],
                **there.tables(nodes, middle),
            }
            document["detector_center"]["line"] = 0.0  # the line lies at y = 0
            if Tables(JsonFields(document, self.instrument)).looks_back != there.looks_back:
                raise CameraError(f"{self.instrument} looks away from the Moon at {labels[0]}")
        return document

    def scanner(self, start: Time, stop: Time, line_s: float) -> LineScanner:
        """The line scanner of `scanner_isd`."""
        document = self.scanner_isd(start, stop, line_s)
        found = sensor_from_isd(JsonFields(document, self.instrument))
        assert isinstance(found, LineScanner)
        return found


def _moon_frame(spice: Any, asked: str | None) -> str:
    """Name of the Moon's frame in the loaded kernels."""
    names = MEAN_EARTH if asked is None else (asked,)
    for name in names:
        if number := spice.namfrm(name):
            if (centre := int(spice.frinfo(number)[0])) != 301:
                raise CameraError(
                    f"`body_frame` {name} is a frame of body {centre}, not of the Moon (301), so it does not turn with it: leave "
                    f"it out, or give {MEAN_EARTH[0]} or IAU_MOON"
                )
            return name
    raise CameraError(
        f"the kernels lack the Moon's frame {names[0]}: load NAIF's moon_de440_250416.tf and moon_pa_de440_200625.bpc"
        " (or choose another as `body_frame`: IAU_MOON of pck00010.tpc differs by up to 155 m)"
    )


def moon_rotations(kernels: Path | str | Sequence[Path | str], times: Array) -> Array:
    """Rotations (n, 3, 3) from J2000 to the mean-Earth frame of kernels at ephemeris times (n,)."""
    with loaded(kernels) as spice:
        name = _moon_frame(spice, None)
        with _explained(spice, f"the kernels have no orientation of {name}: load the Moon's PCK"):
            return np.array([_twice(partial(spice.pxform, "J2000", name, et)) for et in times])


class OpenInstrument:
    """The instrument of loaded kernels."""

    def __init__(self, spice: Any, asked: SpiceCamera) -> None:
        self.spice, self.asked = spice, asked
        self.observer = self._number_of("observer", asked.observer)
        self.code = self._number_of("instrument", asked.instrument)
        self.frame = self._frame()
        self.body = _moon_frame(spice, asked.body_frame)

    def _number_of(self, field_name: str, name: str) -> int:
        """NAIF number of a name."""
        try:
            return int(self.spice.bods2c(name))
        except self.spice.utils.exceptions.NotFoundError as error:
            known = self._texts("NAIF_BODY_NAME")
            said = f"`{field_name}` {name} is not known to the kernels: load the FK that names it"
            raise CameraError(f"{said}; they name {', '.join(known) or 'none'}") from error

    def _texts(self, variable: str) -> list[str]:
        """Texts of a variable of the pool; none if it is missing."""
        try:
            return [one.strip() for one in self.spice.gcpool(variable, 0, 200)]
        except self.spice.utils.exceptions.NotFoundError:
            return []

    def _frame(self) -> str:
        """Name of the instrument's frame: that of its field of view, else that of its number."""
        named = self._texts(f"INS{self.code}_FOV_FRAME")
        frame = named[0] if named else str(self.spice.frmnam(self.code)).strip()
        if not frame or not self.spice.namfrm(frame):
            lacks = f"frame {frame}" if frame else f"frame of {self.asked.instrument} ({self.code})"
            raise CameraError(f"the kernels lack the {lacks}: load the spacecraft's FK")
        return frame

    def time(self, label: str) -> float:
        """Ephemeris time of UTC."""
        with _explained(self.spice, f"{label}: load a leap seconds kernel, such as naif0012.tls"):
            return float(self.spice.str2et(label.removesuffix("Z")))

    # instrument kernel

    def numbers(self, keyword: str) -> list[float] | None:
        """Numbers of a keyword, as given or as in the kernel; None without it."""
        most, _ = KEYWORDS[keyword]
        variable = f"INS{self.code}_{keyword}"
        if keyword in self.asked.ik:
            given = self.asked.ik[keyword]
            found = [float(one) for one in (given if isinstance(given, Sequence) else [given])]
        elif self.spice.expool(variable):
            with _explained(self.spice, variable):
                found = self.spice.gdpool(variable, 0, 100).tolist()
        else:
            return None
        if len(found) not in {1, most} or not all(map(math.isfinite, found)):
            self._refuse(keyword, f"has {len(found)} numbers, not {most}")
        return found

    def number(self, keyword: str) -> float:
        """The one positive number that must be there."""
        found = self.numbers(keyword)
        if found is None:
            self._refuse(keyword, "is not in the kernels")
        if not found[0] > 0.0:
            self._refuse(keyword, f"is {found[0]:g}")
        return found[0]

    def _refuse(self, keyword: str, why: str) -> NoReturn:
        unit = KEYWORDS[keyword][1]
        raise CameraError(
            f"INS{self.code}_{keyword} {why}: load the instrument's kernel, or state `ik` {keyword}=... ({unit})"
        )

    @property
    def looks_back(self) -> bool:
        """True if the instrument looks along -z of its frame; CameraError if along neither z nor -z."""
        along = self.numbers("BORESIGHT") or [0.0, 0.0, 1.0]
        if len(along) != 3 or abs(along[2]) < 0.5 * math.hypot(*along):
            self._refuse("BORESIGHT", f"is {along}, not near +z or -z of {self.frame}")
        return along[2] < 0.0

    def focal_plane(self) -> dict[str, Any]:
        """The fields of an ISD about lens and detector."""
        samples, lines = self.number("PIXEL_SAMPLES"), self.numbers("PIXEL_LINES")
        pitch = self._pitch_mm()
        centre = self._centre((samples, lines[0] if lines else 1.0))
        per_mm = {
            name: self.numbers(f"ITRANS{name[0].upper()}") or alone
            for name, alone in (
                ("samples", [0.0, 1.0 / pitch[0], 0.0]),
                ("lines", [0.0, 0.0, 1.0 / pitch[1]]),
            )
        }
        return {
            "radii": {axis: 1e-3 * MOON_RADIUS_M for axis in ("semimajor", "semiminor")},
            "image_samples": int(samples) // self.asked.summing,
            "focal_length_model": {"focal_length": self.number("FOCAL_LENGTH")},
            "detector_center": {"sample": centre[0], "line": centre[1]},
            "optical_distortion": self._lens(),
            **{f"focal2pixel_{name}": values for name, values in per_mm.items()},
            **{f"detector_{axis}_summing": self.asked.summing for axis in ("sample", "line")},
            **{f"starting_detector_{axis}": 0 for axis in ("sample", "line")},
        }

    def _pitch_mm(self) -> tuple[float, float]:
        """Width and height of a pixel of the detector."""
        keyword = "PIXEL_PITCH" if self.numbers("PIXEL_PITCH") else "PIXEL_SIZE"
        self.number(keyword)
        found = self.numbers(keyword) or []
        if max(found) > _COARSEST_MM:
            self._refuse(keyword, f"is {found[0]:g} mm; these are micrometres")
        return found[0], found[-1]

    def _centre(self, size: tuple[float, float]) -> list[float]:
        """The optical axis on the detector, counted from its corner: sample, line."""
        stated = [self.numbers(f"BORESIGHT_{axis}") for axis in ("SAMPLE", "LINE")]
        from_0 = self.numbers("CCD_CENTER")
        found = []
        for k, from_1 in enumerate(stated):
            if from_1 is not None:
                found.append(from_1[0] - 0.5)
            elif from_0 is not None and len(from_0) == 2:
                found.append(from_0[k] + 0.5)
            else:
                found.append(0.5 * size[k])
        return found

    def _lens(self) -> dict[str, Any]:
        numbers = self.numbers("OD_K") or [0.0]
        if self.code in _NAC and len(numbers) == 1:
            return {"lrolrocnac": {"coefficients": numbers}}
        if len(numbers) == 1 and numbers[0]:
            self._refuse("OD_K", "is one number, which is the lens of LROC NAC only; 3 are wanted")
        return {"radial": {"coefficients": (numbers * 3)[:3]}}

    # tables

    def tables(self, times: Sequence[float] | Array, middle: float) -> dict[str, Any]:
        """The fields of an ISD about position, attitude and the Moon's orientation at ephemeris times."""
        states = [self.state(et) for et in times]
        rows = {"ephemeris_times": [float(et) for et in times], "reference_frame": 1}
        code = int(self.spice.namfrm(self.body))
        return {
            "center_ephemeris_time": middle,
            "instrument_position": rows
            | {"positions": [one[:3] for one in states], "velocities": [one[3:] for one in states]},
            "instrument_pointing": rows | {"quaternions": self._quaternions(self.frame, times)},
            "body_rotation": rows
            | {"quaternions": self._quaternions(self.body, times)}
            | {"time_dependent_frames": [code, 1]},
        }

    def _quaternions(self, frame: str, times: Sequence[float] | Array) -> list[list[float]]:
        return [self.spice.m2q(self.turn(frame, et)).tolist() for et in times]

    def state(self, et: float) -> list[float]:
        """Position (km) and velocity (km/s) of the observer from the Moon's centre, J2000."""
        try:
            state = _twice(lambda: self.spice.spkez(self.observer, et, "J2000", "NONE", 301)[0])
        except self.spice.utils.exceptions.SpiceyError as error:
            covered = self._covered("SPK", self.observer)
            raise self._outside(f"position of {self.asked.observer}", et, covered, error) from error
        if not state[:3].any():
            raise CameraError(f"the kernels have {self.asked.observer} at the centre of the Moon")
        return list(map(float, state))

    def turn(self, frame: str, et: float) -> Array:
        """Rotation (3, 3) from J2000 to a frame."""
        try:
            return _twice(lambda: self.spice.pxform("J2000", frame, et))
        except self.spice.utils.exceptions.SpiceyError as error:
            of_moon = frame == self.body
            covered = (
                "it is in a PCK of the Moon" if of_moon else self._covered("CK", self.carrier()[0])
            )
            raise self._outside(f"orientation of {frame}", et, covered, error) from error

    def carrier(self) -> tuple[int, Array]:
        """Number of the structure (CK) that carries the instrument, of the frame itself if of none, and the rotation
        (3, 3) from the instrument's frame to its.
        """
        code, turn = int(self.spice.namfrm(self.frame)), np.eye(3)
        for _ in range(10):
            _, kind, number = self.spice.frinfo(code)
            if kind != 4:
                break
            to_next, code = self.spice.tkfram(code)
            turn = np.asarray(to_next) @ turn
        return int(number), turn

    def ticks(self, structure: int, times: Array) -> list[float]:
        """Ephemeris times as continuous ticks of the spacecraft clock of a structure."""
        with _explained(self.spice, f"the clock of {structure}: load the spacecraft's SCLK kernel"):
            clock = int(self.spice.ckmeta(structure, "SCLK"))
            return [float(self.spice.sce2c(clock, et)) for et in times]

    def camera_axes(self) -> Array:
        """Rotation (3, 3) from the instrument's frame to camera axes: right, down, ahead."""
        fields = JsonFields(self.focal_plane(), self.asked.instrument)
        return plane_of_isd(fields, looks_back=self.looks_back)[1]

    def _covered(self, kind: str, code: int) -> str:
        """What the loaded kernels of a kind have of an object: its first and its last time."""
        ends: list[float] = []
        for k in range(self.spice.ktotal(kind)):
            file, window = self.spice.kdata(k, kind)[0], self.spice.cell_double(_WINDOWS)
            if kind == "SPK":
                self.spice.spkcov(file, code, window)
            else:
                try:
                    self.spice.ckcov(file, code, False, "SEGMENT", 0.0, "TDB", window)
                except self.spice.utils.exceptions.SpiceyError:
                    return "the spacecraft clock (SCLK) is missing"
            ends += list(window)
        if not ends:
            return "none of them has it"
        return f"they cover {self._utc(min(ends))} to {self._utc(max(ends))}"

    def _outside(self, what: str, et: float, covered: str, error: Any) -> CameraError:
        return CameraError(
            f"the kernels have no {what} at {self._utc(et)}: {covered} ({error.short}); load kernels of this time"
        )

    def _utc(self, et: float) -> str:
        return str(self.spice.et2utc(et, "ISOC", 3)) + "Z"
