"""Damaged input files: every parser of `lcp`, given valid files with random damage.

    python -m benchmarks.faults fuzz [PARSER...] [--inputs N] [--first SEED]

A parser survives an input if it accepts it or raises an error of the library (`LcpError`) of one line without control
characters. Other exceptions, accepted numbers that are not finite,
more than 1 GB of memory, more than 10 s and crashes are failures; they are grouped by the exception and
its place. The damage depends on the parser and the seed alone.
"""

from __future__ import annotations

import collections
import contextlib
import json
import random
import re
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import sections
from benchmarks.places import ROOT, SAMPLE, shared_data
from lcp_catalog.errors import LcpError
from tests.helpers import image_files, isd_files, merged_texts, products

LABELS = ROOT / "tests" / "data" / "labels"
LIMIT_BYTES = 1 << 30
LIMIT_S = 10


# -- parsers: each reads a file as the commands do


def read_dem(path: Path) -> None:
    from lcp_catalog.dem.dem import Dem

    dem = Dem.open(path)
    assert dem.grid.bounds
    dem.read(0, min(8, dem.grid.height), 0, min(8, dem.grid.width))


def check_dem(path: Path) -> None:
    from lcp_catalog.dem.file_check import check_dem as check

    check(path)


def read_image(path: Path) -> None:
    from lcp_catalog.images.image_file import read_image_label
    from lcp_catalog.images.pixels import read_pixels

    read_image_label(read_pixels(path)).direction()


def read_image_beside(label: Path) -> None:
    names = (f"{label.stem}.img", f"{label.stem}.IMG")
    read_image(next(path for path in label.parent.iterdir() if path.name in names))


def read_camera(path: Path) -> None:
    from lcp_catalog.cameras.camera_file import read_sensor

    sensor = read_sensor(path, (64, 64) if path.suffix == ".tsai" else None)
    rows, cols = sensor.shape
    sensor.looks(np.array([[0.0, 0.0], [(cols - 1) / 2, (rows - 1) / 2], [cols - 1.0, rows - 1.0]]))
    sensor.project(np.array([[1737400.0, 0.0, 0.0], [0.0, 0.0, 1737400.0]]))


def read_way(path: Path) -> None:
    from lcp_catalog.cameras.camera_file import read_camera as framing
    from lcp_catalog.navigation.trajectory_file import read_trajectory

    camera = framing(SAMPLE / "AS15-M-0414_camera.json") if path.suffix == ".csv" else None
    read_trajectory(path, camera)


def read_build(path: Path) -> None:
    from lcp_catalog.production.config import BuildConfig

    config = BuildConfig.from_toml(path)
    config.points.check_cells(100.0)
    config.to_toml()
    assert min(config.points.spacing_nodes(100.0), config.points.search_nodes(100.0)) >= 1


def read_facet(path: Path) -> None:
    from lcp_catalog.photometry.facet_model import load_model

    load_model(path).to_toml()


def read_goniometer(path: Path) -> None:
    from lcp_catalog.photometry.facet_fit import read_measurements

    read_measurements(path)


def read_albedo(path: Path) -> None:
    from lcp_catalog.photometry.albedo_map import AlbedoMap

    AlbedoMap.open(path).describe()


def read_environment(path: Path) -> None:
    from lcp_catalog.light.environment import Environment

    Environment.open(path)


# -- valid files


def dem_labels(folder: Path) -> Iterator[Path]:
    """Labels; the image beside each is not damaged."""
    yield products.sldem_512(folder, 3, 27, 24, 20)
    yield products.ldem_80s(folder, 24)
    yield products.gld100_attached(folder, np.zeros((12, 24)))
    for name in ("LDEM_4.LBL", "LDEM_4_JP2.LBL", "LDEM_4.IMG", "LDEM_4.JP2"):
        shutil.copy(ROOT / "tests" / "data" / "ldem_4" / name, folder)
    yield folder / "LDEM_4_JP2.LBL"
    yield from map(Path, (shutil.copy(one, folder) for one in sorted(LABELS.iterdir())))


def geotiffs(folder: Path) -> Iterator[Path]:
    heights = np.arange(600.0, dtype=np.float32).reshape(20, 30)
    for name, kind in (("plain.tif", "float32"), ("scaled.tif", "int16")):
        yield products.geotiff(
            folder / name, heights.astype(kind), 1e5, 8e5, 500.0, nodata=0.0, scale=0.5
        )


def jp2(folder: Path) -> Iterator[Path]:
    for name in ("LDEM_4.LBL", "LDEM_4_JP2.LBL", "LDEM_4.JP2"):
        shutil.copy(ROOT / "tests" / "data" / "ldem_4" / name, folder)
    yield folder / "LDEM_4.JP2"


def image_labels(folder: Path) -> Iterator[Path]:
    """Images with attached labels and tables, and images of other formats."""
    statements = (
        'START_TIME = 2009-07-30T12:20:38\nSTOP_TIME = 2009-07-30T12:20:40\nTARGET_NAME = "MOON"'
    )
    codes = "  CORE_NULL = -32768\n  CORE_LOW_REPR_SATURATION = 16#FF7FFFFC#"
    grey = image_files.scene("int16")
    yield image_files.write_pds3(folder / "a.img", grey, statements, codes)
    yield image_files.write_cube(folder / "b.cub", image_files.scene("float32"))
    yield (
        image_files.write_image(folder / "c.tif", image_files.scene("uint8"), driver="GTiff")
        or folder / "c.tif"
    )
    yield Path(shutil.copy(SAMPLE / "hadley_albedo_643nm_11ppd.tif", folder / "d.tif"))


def labels_beside(folder: Path) -> Iterator[Path]:
    """Detached labels; the image beside each is read (`read_image_beside`)."""
    attached = next(image_labels(folder)).read_bytes()
    head, samples = attached[:4096].rstrip(), attached[4096:]
    (folder / "f.img").write_bytes(samples)
    (folder / "f.lbl").write_bytes(head.replace(b"^IMAGE = 2", b'^IMAGE = "F.IMG"'))
    yield folder / "f.lbl"
    for name in ("LDEM_4.LBL", "LDEM_4.IMG"):
        shutil.copy(ROOT / "tests" / "data" / "ldem_4" / name, folder)
    yield folder / "LDEM_4.LBL"


def pds4_labels(folder: Path) -> Iterator[Path]:
    times = ("2009-07-30T12:20:38Z", "2009-07-30T12:20:40Z")
    yield image_files.write_pds4(folder / "e.xml", image_files.scene("int16"), *times, "Moon")
    yield Path(shutil.copy(LABELS / "LDEM_875S_20M_FLOAT_PDS4_excerpt.xml", folder))


def cameras(folder: Path) -> Iterator[Path]:
    yield Path(shutil.copy(SAMPLE / "AS15-M-0414_camera.json", folder))
    tsai = (
        "VERSION_4\nPINHOLE\nfu = 1e3\nfv = 1e3\ncu = 32\ncv = 32\nu_direction = 1 0 0\nv_direction = 0 1 0\n"
        "w_direction = 0 0 1\nC = 1800000 0 0\nR = 0 0 -1 0 1 0 1 0 0\npitch = 1\n"
        "TSAI\nk1 = 0\nk2 = 0\np1 = 0\np2 = 0\n"
    )
    (folder / "camera.tsai").write_text(tsai)
    yield folder / "camera.tsai"


def ways(folder: Path) -> Iterator[Path]:
    camera = json.loads((SAMPLE / "AS15-M-0414_camera.json").read_text())
    (folder / "way.json").write_text(json.dumps([camera | {"time_utc": "2026-01-01T00:00:00"}] * 2))
    yield folder / "way.json"
    place = ",".join(map(repr, camera["position_mcmf_m"]))
    numbers = ",".join(repr(n) for row in camera["rotation_mcmf_to_camera"] for n in row)
    heads = ",".join(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
    row = f"2026-01-01T00:00:00,{place}"
    (folder / "matrix.csv").write_text(f"time_utc,x_m,y_m,z_m,{heads}\n{row},{numbers}\n")
    yield folder / "matrix.csv"
    heads = "# a pass\ntime_utc,x_m,y_m,z_m,qw,qx,qy,qz\n"
    (folder / "turn.csv").write_text(heads + f"{row},0.6,0.8,0,0\n" * 3)
    yield folder / "turn.csv"


def isds(folder: Path) -> Iterator[Path]:
    makers = (
        "orbital_framer",
        "orbital_line_scan",
        "orbital_push_frame",
        "constant_velocity_line_scan",
    )
    for maker in makers:
        made = getattr(isd_files, maker)()
        document = getattr(made, "document", made)
        if isinstance(document, dict):
            (folder / f"{maker}.json").write_text(json.dumps(document))
            yield folder / f"{maker}.json"
    shared = shared_data() / "cameras"  # further real files, where they are
    for name in ("apollometric_isd.json", "chandrayaan2_ohrc_isd.json") if shared.is_dir() else ():
        yield Path(shutil.copy(shared / name, folder))


def builds(folder: Path) -> Iterator[Path]:
    from lcp_catalog.production.config import BuildConfig

    yield Path(shutil.copy(SAMPLE / "hadley.toml", folder))
    (folder / "all.toml").write_text(BuildConfig().to_toml())
    yield folder / "all.toml"


def facets(folder: Path) -> Iterator[Path]:
    from lcp_catalog.photometry.facet_model import FacetFile, facet_model

    (folder / "paint.toml").write_text(FacetFile(facet_model(), {"d": 1.0}).to_toml())
    yield folder / "paint.toml"


def goniometers(folder: Path) -> Iterator[Path]:
    yield Path(shutil.copy(SAMPLE / "goniometer_synthetic.csv", folder))


def albedos(folder: Path) -> Iterator[Path]:
    bright = np.linspace(0.1, 0.9, 600, dtype=np.float32).reshape(20, 30)
    yield products.geotiff(folder / "albedo.tif", bright, 1e5, 8e5, 5000.0)


def environments(folder: Path) -> Iterator[Path]:
    rows = 16
    light = np.ones((rows, 2 * rows, 3), "<f4")
    light[3, 5] = 900.0
    (folder / "sky.pfm").write_bytes(f"PF\n{2 * rows} {rows}\n-1.0\n".encode() + light.tobytes())
    yield folder / "sky.pfm"
    codes = np.full((rows, 2 * rows, 4), 128, np.uint8)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {rows} +X {2 * rows}\n"
    (folder / "sky.hdr").write_bytes(head.encode() + codes.tobytes())
    yield folder / "sky.hdr"


@dataclass(frozen=True)
class Parser:
    """A reading function and the valid files that are damaged for it."""

    read: Callable[[Path], None]
    sources: Callable[[Path], Iterator[Path]]


PARSERS = {
    "dem-label": Parser(read_dem, dem_labels),
    "dem-check": Parser(check_dem, dem_labels),
    "dem-pds4": Parser(read_dem, pds4_labels),
    "dem-geotiff": Parser(read_dem, geotiffs),
    "dem-geotiff-check": Parser(check_dem, geotiffs),
    "dem-jp2": Parser(read_dem, jp2),
    "image-label": Parser(read_image, image_labels),
    "image-label-beside": Parser(read_image_beside, labels_beside),
    "image-pds4": Parser(read_image, pds4_labels),
    "camera": Parser(read_camera, cameras),
    "trajectory": Parser(read_way, ways),
    "isd": Parser(read_camera, isds),
    "build": Parser(read_build, builds),
    "require": Parser(merged_texts.read_requirement, merged_texts.requirements),
    "merged": Parser(merged_texts.read_merged, merged_texts.merged),
    "facet": Parser(read_facet, facets),
    "goniometer": Parser(read_goniometer, goniometers),
    "albedo": Parser(read_albedo, albedos),
    "environment": Parser(read_environment, environments),
}


# -- damage

NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"0", b"-1", b"1e308", b"-1e308", b"1e400", b"nan", b"inf", b"-inf", b"9" * 400, b"1e-320", b"2147483648",
    b"4294967295", b"99999999999999999999", b"0.5", b"-0.0", b"1000000", b"1e12", b'"7"', b"null", b"true", b"[]", b"{}",
    b"16#FFFF#", b"16#G#", b"", b"9999-99-99T99:99:99", b"()", b"1 <km>", b"'",
)  # fmt: skip
WORDS = (
    b"\0",
    b"\xff\xfe",
    b"\xc3",
    b"\n",
    b'"',
    b"=",
    b"<",
    b"{",
    b"}",
    b"[",
    b"]",
    b"END\r\n",
    b"/*",
    b"&x;",
    b"\x1b[31m",
)
NESTS = (b"[", b"{", b'{"a":', b"<a>", b"(", b"OBJECT = A\r\n", b"a.", b"[a.")


def damaged(data: bytes, dice: random.Random) -> bytes:
    """The content with one to four random changes."""
    for _ in range(dice.choice((1, 1, 1, 2, 4))):
        data = dice.choice(CHANGES)(data, dice)
    return data


def _place(data: bytes, dice: random.Random) -> tuple[int, int]:
    """A random slice; headers are damaged more often than pixels."""
    size = len(data) if dice.random() < 0.6 else min(len(data), 2048)
    start = dice.randrange(size + 1)
    return start, min(len(data), start + dice.choice((1, 1, 2, 4, 8, 64, 1000)))


def _flip(data: bytes, dice: random.Random) -> bytes:
    found = bytearray(data)
    for _ in range(dice.choice((1, 1, 2, 8, 40))):
        at, end = _place(data, dice)
        if at < end:
            found[at] = dice.choice(
                (found[at] ^ (1 << dice.randrange(8)), dice.randrange(256), 0, 255)
            )
    return bytes(found)


def _cut(data: bytes, dice: random.Random) -> bytes:
    return data[: _place(data, dice)[0]]


def _delete(data: bytes, dice: random.Random) -> bytes:
    at, end = _place(data, dice)
    return data[:at] + data[end:]


def _repeat(data: bytes, dice: random.Random) -> bytes:
    at, end = _place(data, dice)
    return data[:end] + data[at:end] * dice.choice((1, 2, 50)) + data[end:]


def _insert(data: bytes, dice: random.Random) -> bytes:
    at, _ = _place(data, dice)
    return data[:at] + dice.choice(WORDS) + data[at:]


def _nest(data: bytes, dice: random.Random) -> bytes:
    at, _ = _place(data, dice)
    return data[:at] + dice.choice(NESTS) * dice.choice((5, 300, 20_000)) + data[at:]


def _number(data: bytes, dice: random.Random) -> bytes:
    found = list(NUMBER.finditer(data[:400_000]))
    if not found:
        return data
    one = dice.choice(found)
    return data[: one.start()] + dice.choice(NUMBERS) + data[one.end() :]


def _line(data: bytes, dice: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    if len(lines) < 2:
        return data
    here, there = dice.randrange(len(lines)), dice.randrange(len(lines))
    if dice.random() < 0.5:
        del lines[here]
    else:
        lines[here], lines[there] = lines[there], lines[here]
    return b"".join(lines)


CHANGES = (_flip, _flip, _cut, _delete, _repeat, _insert, _nest, _number, _number, _number, _line)


# -- one input, a run of inputs


class TooLongError(Exception):
    """An input took more than `LIMIT_S`."""


class DamagedFiles:
    """A folder with the valid files of a parser, of which one at a time is damaged."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.folder = name, folder
        self.files = [path for path in PARSERS[name].sources(folder) if path]
        self.content = {path: path.read_bytes() for path in self.files}

    def input(self, seed: int) -> tuple[Path, bytes]:
        """The file that is damaged, and its damaged content."""
        dice = random.Random(f"{self.name} {seed}")
        path = dice.choice(self.files)
        return path, damaged(self.content[path], dice)

    def failure(self, seed: int) -> str | None:
        """What is wrong with the answer to a damaged file; None if it survived."""
        path, content = self.input(seed)
        path.write_bytes(content)
        try:
            PARSERS[self.name].read(path)
        except LcpError as error:
            return None if str(error).isprintable() else f"more than a line: {str(error)!r:.200}"
        except TooLongError as error:
            return f"more than {LIMIT_S} s at {_place_of(error)}"
        except Exception as error:  # any other is what is looked for
            return f"{type(error).__name__} at {_place_of(error)}: {str(error)[:100]!r}"
        finally:
            path.write_bytes(self.content[path])
        return None


def _place_of(error: BaseException) -> str:
    """The last place in our own code."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [one for one in frames if "lcp_catalog" in one.filename] or frames
    return f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"


@contextlib.contextmanager
def limits() -> Iterator[None]:
    """Memory of 1 GB more than now, and an alarm that raises `TooLongError`."""

    def stop(*_: Any) -> None:
        raise TooLongError

    signal.signal(signal.SIGALRM, stop)
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + LIMIT_BYTES, resource.RLIM_INFINITY))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def child(name: str, first: int, last: int) -> None:
    """Try a range of seeds; print a line before and one after each."""
    import logging

    logging.disable(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as folder:
        files = DamagedFiles(name, Path(folder))
        for path in files.files:  # imports and compilers before the limits
            with contextlib.suppress(LcpError):
                PARSERS[name].read(path)
        with limits():
            for seed in range(first, last):
                print(json.dumps([seed]), flush=True)
                signal.alarm(LIMIT_S)
                found = files.failure(seed)
                signal.alarm(0)
                print(json.dumps([seed, found]), flush=True)


def survey(name: str, first: int, count: int) -> dict[str, list[int]]:
    """Seeds of the failures of a parser, by kind."""
    failures: dict[str, list[int]] = collections.defaultdict(list)
    seed, last = first, first + count
    while seed < last:
        tried = ["--child", name, str(seed), str(last)]
        words = [sys.executable, "-m", "benchmarks.faults", "fuzz", *tried]
        with subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
        ) as run:
            assert run.stdout is not None
            begun = seed - 1
            while True:
                ready, _, _ = select.select([run.stdout], [], [], 60 + 2 * LIMIT_S)
                line = run.stdout.readline() if ready else ""
                if not line:
                    break
                said = json.loads(line)
                begun = said[0]
                if len(said) == 2:
                    seed = said[0] + 1
                    if said[1]:
                        failures[said[1]].append(said[0])
            if not ready:
                run.kill()
            code = run.wait()
            if seed < last:
                why = (
                    "hangs"
                    if not ready
                    else f"ended by signal {-code}"
                    if code < 0
                    else f"ended with {code}"
                )
                failures[f"the process {why}"].append(begun)
                if begun < seed:
                    raise RuntimeError(f"{name}: the child does not start; try {' '.join(words)}")
                seed = begun + 1
    return dict(failures)


def main(words: Sequence[str]) -> int:
    if words[:1] == ["--child"]:
        child(words[1], int(words[2]), int(words[3]))
        return 0
    options = sections.parser("faults fuzz", __doc__)
    options.add_argument("parsers", nargs="*", choices=[[], *PARSERS], metavar="PARSER")
    options.add_argument("--inputs", type=int, default=6250, metavar="N")
    options.add_argument("--first", type=int, default=0, metavar="SEED")
    given = options.parse_args(words)
    bad = 0
    for name in given.parsers or PARSERS:
        failures = survey(name, given.first, given.inputs)
        failed = sum(len(seeds) for seeds in failures.values())
        bad += failed
        print(f"{name:18} {given.inputs - failed} of {given.inputs} survived", flush=True)
        for kind, seeds in sorted(failures.items(), key=lambda item: -len(item[1])):
            print(f"  {len(seeds):6} {kind}  seeds {seeds[:4]}", flush=True)
    return 1 if bad else 0
