"""The C reference of the flight file, compiled and called by ctypes: its structures as records of NumPy."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time, thread_time
from typing import Any

import numpy as np

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.matching.point_search import SearchImage

from . import flight_vector, twins_match

SOURCE = Path(__file__).resolve().parents[2] / "lcp_catalog" / "flight"
COMPILER = next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None)
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
CODES = (
    *("OK", "NOT_A_FILE", "DAMAGED", "TOO_LARGE", "ARGUMENT", "NOT_SEEN", "NOT_LIT", "PLAIN"),
    *("AT_THE_EDGE", "NO_PEAK", "NO_FIT"),
)
NODES, SIDE, SAMPLES, REACH = 33, 64, 192, 64


def _record(**fields: Any) -> np.dtype[Any]:
    return np.dtype([(name, *kind) for name, kind in fields.items()], align=True)


def _f8(*shape: int) -> tuple[Any, ...]:
    return ("f8", shape) if shape else ("f8",)


FILE = _record(raw=("u8", (32,)))
CAMERA = _record(
    position=_f8(3), rotation=_f8(3, 3), focal=_f8(), principal=_f8(2), distortion=_f8(5),
    size=("i4", (2,)), sun=_f8(3),
)  # fmt: skip
POINT = _record(
    id=("i8",), position=_f8(3), rotation=_f8(3, 3), gsd=_f8(), elevation_sigma=_f8(), nodes=("i4",),
    level=("i4",), height=("f4", (NODES * NODES,)), albedo=("f4", (NODES * NODES,)),
)  # fmt: skip
CLAIM = _record(
    point=("u4",), pixel=_f8(2), pixel_size=_f8(), usable=("i4",), probability=_f8(),
    sigma=_f8(2), angle=_f8(),
)  # fmt: skip
LAW = _record(lunar_lambert=("i4",), number=_f8(5))
IMAGE = _record(
    fine=("u8",), weight=("u8",), half=("u8",), half_weight=("u8",), rows=("i4",), cols=("i4",)
)
TEMPLATE = _record(
    rows=("i4",), cols=("i4",), sub=("i4",), origin=("i4", (2,)), predicted=_f8(2), sigma=_f8(),
    count=("i4",), value=("f4", (SIDE * SIDE,)), mask=("u1", (SIDE * SIDE,)),
)  # fmt: skip
MATCH = _record(
    shift=("i4", (2,)), correlation=_f8(), second=_f8(), pixel=_f8(2), covariance=_f8(3),
    fit_correlation=_f8(), gain=_f8(), noise=_f8(), likeness=_f8(),
)  # fmt: skip
WORK_BYTES = 2_000_000


def compiled(sources: Iterable[Path], out: Path, *flags: str) -> Path:
    """Compile sources of the reference with every warning an error."""
    assert COMPILER is not None
    words = [COMPILER, *STRICT, *flags, f"-I{SOURCE}", *map(str, sources), "-o", str(out), "-lm"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out


def calls(folder: Path, *flags: str) -> tuple[dict[str, int], dict[str, set[str]]]:
    """Bytes on the stack of each function of `lcpf.c`, and the functions that it calls; of gcc only."""
    compiled([SOURCE / "lcpf.c"], folder / "calls.o", "-c", "-fcallgraph-info=su", *flags)
    text = (folder / "calls.ci").read_text()
    nodes = re.findall(
        r'node: \{ title: "([^"]+)" label: "[^"]*?(\d+) bytes \((?:static|dynamic,bounded)\)', text
    )
    edges: dict[str, set[str]] = {}
    for one, other in re.findall(r'sourcename: "([^"]+)" targetname: "([^"]+)"', text):
        edges.setdefault(one, set()).add(other)
    return {name: int(size) for name, size in nodes}, edges


def stack_bytes(folder: Path, *flags: str) -> int:
    """The most that a call takes on the stack, without the functions of math.h; RecursionError where a function calls itself."""
    sizes, edges = calls(folder, *flags)

    def below(name: str) -> int:
        return sizes.get(name, 0) + max(map(below, edges.get(name, ())), default=0)

    return max(map(below, sizes))


class Reference:
    """The functions of the reference, with the memory of one thread."""

    def __init__(self, folder: Path, *flags: str) -> None:
        path = compiled(
            [SOURCE / "lcpf.c", SOURCE / "lcpf_example.c"], folder / "lcpf.so",
            "-O3", "-shared", "-fPIC", "-Dmain=example_main", *flags,
        )  # fmt: skip
        self.library = ctypes.CDLL(str(path))
        self.library.lcpf_half.restype = None
        self.work = np.zeros(WORK_BYTES, np.uint8)
        self.file, self.point = np.zeros((), FILE), np.zeros((), POINT)
        self.content = np.zeros(0, np.uint8)

    def law(self, lunar_lambert: bool) -> Any:
        """One of the two laws of the header."""
        name = "LCPF_LUNAR_LAMBERT" if lunar_lambert else "LCPF_LOMMEL_SEELIGER"
        raw = (ctypes.c_uint8 * LAW.itemsize).in_dll(self.library, name)
        return np.frombuffer(raw, LAW)[0]

    def call(self, name: str, *values: Any) -> int:
        """A function with arrays, records (by address) and whole numbers."""
        given = [
            ctypes.c_void_p(value.ctypes.data) if isinstance(value, np.ndarray) else value
            for value in values
        ]
        return int(getattr(self.library, name)(*given))

    def open(self, content: bytes) -> int:
        self.content = np.frombuffer(content, np.uint8)
        size = ctypes.c_size_t(len(content))
        return self.call("lcpf_open", self.file, self.content, size)

    def id_of(self, number: int) -> int:
        """The id of a point of the file."""
        assert self.call("lcpf_load", self.file, ctypes.c_uint32(number), self.point) == 0
        return int(self.point["id"])

    def in_view(self, camera: np.ndarray, most: int) -> np.ndarray:
        claims, count = np.zeros(most, CLAIM), np.zeros((), np.uint32)
        code = self.call("lcpf_in_view", self.file, camera, claims, ctypes.c_uint32(most), count)
        assert code == 0, CODES[code]
        return claims[: int(count)]

    def render(self, number: int, camera: np.ndarray, law: np.ndarray, sigma: float) -> int:
        code = self.call("lcpf_load", self.file, ctypes.c_uint32(number), self.point)
        assert code == 0, CODES[code]
        sigma_c = ctypes.c_double(sigma)
        return self.call("lcpf_render", self.point, camera, np.array(law, LAW), sigma_c, self.work)

    @property
    def shown(self) -> Any:
        """The template that was rendered last."""
        return np.frombuffer(self.work, TEMPLATE, 1)[0]

    def match(self, image: np.ndarray, offset: tuple[int, int], reach: int) -> tuple[int, Any]:
        """Search and fit of the template that was rendered last."""
        found, shift = np.zeros((), MATCH), np.array(offset, np.int32)
        code = self.call("lcpf_search", image, shift, ctypes.c_int32(reach), self.work, found)
        return code or self.call("lcpf_fit", image, self.work, found), found[()]


@dataclass(frozen=True)
class Difference:
    """The reference beside Python, of one point in one frame; NaN where one of the two found nothing."""

    code: int
    found: bool  # by Python
    render_share: float  # root mean square over the template's pixels, over its mean
    pixel_share: float  # largest of one pixel, over the mean
    match_px: float
    covariance_share: float  # of the larger variance
    c_seconds: float
    python_seconds: float
    match: Any
    python: flight_vector.PythonMatch


def difference(
    reference: Reference,
    number: int,
    frame: Frame,
    catalog: Catalog,
    row: int,
    law: str,
    reach: int,
) -> Difference:
    """Render, search and fit one point by both: its number in the file and its row in the catalogue."""
    start = process_time()
    python = flight_vector.match(catalog, row, frame.image, law, reach)
    seconds = process_time() - start
    c_seconds, given = np.inf, reference.law(law != "lommel-seeliger")
    for _ in range(3):  # the fastest counts
        start, c_match = thread_time(), None  # the kernels' threads do not count
        code = reference.render(number, frame.camera, given, 0.5)
        if code == 0:
            code, c_match = reference.match(frame.record, (0, 0), reach)
        c_seconds = min(c_seconds, thread_time() - start)
    shown, share, pixel, off, grown = reference.shown, np.nan, np.nan, np.nan, np.nan
    if code in (0, 8, 9, 10) and python.shown.shape == (shown["rows"], shown["cols"]):
        pixels = int(shown["rows"] * shown["cols"])
        mask, value = shown["mask"][:pixels] > 0, shown["value"][:pixels]
        there = python.shown.mask.ravel() & mask
        theirs = python.shown.values.ravel()[there]
        apart = (value[there] - theirs) / theirs.mean()
        share, pixel = float(np.sqrt(np.mean(apart**2))), float(np.abs(apart).max())
        share = np.inf if (mask != python.shown.mask.ravel()).mean() > 0.02 else share
    if code == 0 and np.isfinite(python.precise[2]):
        off = float(np.hypot(*(c_match["pixel"] - python.pixel)))
        change = np.abs(c_match["covariance"] - python.precise[3:6]).max()
        grown = float(change / python.precise[[3, 5]].max())
    found = bool(np.isfinite(python.precise[2]))
    shares = (share, pixel, off, grown)
    return Difference(code, found, *shares, c_seconds, seconds, c_match, python)


def agreeing(found: Sequence[Difference], slack_px: float = 2.0) -> list[int]:
    """Those that are near the median shift of the well correlated ones: matches for a position."""
    good = [k for k, one in enumerate(found) if one.code == 0 and one.python.precise[2] > 0.5]
    shifts = [found[k].match["pixel"] - found[k].python.shown.predicted_px[0] for k in good]
    if not good:
        return []
    off = np.hypot(*(np.array(shifts) - np.median(shifts, axis=0)).T)
    return [k for k, away in zip(good, off, strict=True) if away < slack_px]


@dataclass(frozen=True, eq=False)
class Frame:
    """An image for both: the searched image, its camera, and their records."""

    image: SearchImage
    sensor: Camera
    camera: np.ndarray
    record: np.ndarray
    arrays: list[np.ndarray]

    @classmethod
    def of(cls, image: SearchImage, camera: Camera) -> Frame:
        return cls(image, camera, camera_record(camera), *image_record(image))


def bent(frame: EnuFrame, *view: Any) -> Camera:
    """The camera of `twins_match.looking_at` with a lens that distorts by some pixels."""
    lens = np.array([-0.08, 0.02, 1e-3, -5e-4, 0.0])
    return replace(twins_match.looking_at(frame, *view), distortion=lens)


def position(
    reference: Reference,
    frame: Frame,
    places: np.ndarray,
    pixels: np.ndarray,
    covariances: np.ndarray,
) -> tuple[int, np.ndarray, np.ndarray]:
    """The example's position and its covariance, from matches (n,)."""
    out, six = np.zeros((), CAMERA), np.zeros((6, 6))
    given = [np.ascontiguousarray(one, np.float64) for one in (places, pixels, covariances)]
    count = ctypes.c_int32(len(places))
    code = reference.call("example_position", frame.camera, *given, count, out, six)
    return code, out["position"], six[:3, :3]


def position_sigmas(
    reference: Reference, frame: Frame, places: np.ndarray, found: Sequence[Difference]
) -> float:
    """Between the example's position and `pose.solve`, from the agreeing ones of points at places (n, 3), in sigmas of the
    position; NaN for fewer than four.
    """
    used = agreeing(found)
    if len(used) < 4:
        return float("nan")
    pixels = np.array([found[k].match["pixel"] for k in used])
    covariances = np.array([found[k].match["covariance"] for k in used])
    code, solved, six = position(reference, frame, places[used], pixels, covariances)
    pose = flight_vector.solved(frame.sensor, places[used], pixels, covariances)
    assert CODES[code] == "OK"
    theirs = pose.position_covariance_m2
    np.testing.assert_allclose(six, theirs, rtol=0.01, atol=0.01 * theirs.max())
    return float(np.linalg.norm(solved - pose.position_mcmf_m)) / pose.position_sigma_m


def camera_record(camera: Camera) -> np.ndarray:
    """A framing camera with its Sun."""
    out = np.zeros((), CAMERA)
    out["position"], out["rotation"] = camera.position_mcmf_m, camera.rotation_mcmf_to_camera
    out["focal"], out["principal"] = camera.focal_length_px, camera.principal_point_px
    out["distortion"], out["size"] = camera.distortion, camera.image_size_px
    out["sun"] = camera.sun_position_mcmf_m
    return out


def image_record(image: SearchImage) -> tuple[np.ndarray, list[np.ndarray]]:
    """An image, and the arrays that it points to."""
    arrays = [image.fine, image.weight, image.half, image.half_weight]
    arrays = [np.ascontiguousarray(one, np.float32) for one in arrays]
    out = np.zeros((), IMAGE)
    for name, array in zip(("fine", "weight", "half", "half_weight"), arrays, strict=True):
        out[name] = array.ctypes.data
    out["rows"], out["cols"] = image.fine.shape
    return out, arrays
