"""The C reference of the flight file: compiled with every warning an error, beside Python point by point, and under
sanitizers. `make flight` compares 1000 points of frames.
"""

from __future__ import annotations

import copy
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import catalogs, flight_c, flight_vector, twins_match
from helpers.flight_c import CODES, SOURCE, Frame, Reference
from lcp_cli.main import run

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.schema import DETECTION_STEP, UNSHADOWED, USABLE, summarise_usable
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.exports.export import export
from lcp_catalog.exports.flight import FlightFile
from lcp_catalog.geometry.frames import EnuFrame, direction_enu, lonlat_to_mcmf, mcmf_to_lonlat
from lcp_catalog.images.image import Image
from lcp_catalog.images.image_file import open_image
from lcp_catalog.matching.point_choice import claimed, directions_to_sun, points_in_view
from lcp_catalog.matching.point_search import SearchImage
from lcp_catalog.matching.templates import render_patches
from lcp_catalog.photometry.law_choice import law_of
from lcp_catalog.photometry.laws import surface_law

pytestmark = pytest.mark.skipif(flight_c.COMPILER is None, reason="no C compiler is installed")
VECTOR = ("vector.lcpf", "vector_camera.txt", "vector.pgm", "vector_expected.txt")
SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("flight")


@pytest.fixture(scope="module")
def catalog():
    return flight_vector.site(5, 0.14)


@pytest.fixture(scope="module")
def reference(folder: Path, catalog) -> Reference:
    export(catalog, folder / "site.lcpf")
    made = Reference(folder)
    assert CODES[made.open((folder / "site.lcpf").read_bytes())] == "OK"
    assert made.call("lcpf_check", made.file) == 0
    return made


@pytest.fixture(scope="module")
def decoded(folder: Path, catalog, reference) -> tuple[Catalog, list[int]]:
    return flight_vector.as_stored(catalog, folder / "site.lcpf")


def _photograph() -> Frame:
    camera = read_camera(SAMPLE / "AS15-M-0414_camera.json")
    return Frame.of(SearchImage.of(open_image(SAMPLE / "AS15-M-0414.png", camera)), camera)


def _simulated(folder: Path) -> Frame:
    place = EnuFrame(*flight_vector.CENTRE, -1500.0)
    camera = flight_c.bent(place, 80e3, 35.0, 200.0, 20.0, 450.0, (170, 160))
    camera, grey = flight_vector.simulated(camera, (52.0, -1.0), 237.0, folder)
    known = camera.moved([60.0, -40.0, 30.0, 1e-3, -2e-3, 1e-3])
    return Frame.of(flight_vector.searched(grey, known), known)


@pytest.mark.parametrize("kind", ["photograph", "simulated"])
def test_it_finds_what_python_finds(kind: str, catalog, decoded, reference, folder: Path) -> None:
    """With the heights of the file to the last digits that matter, with those of the catalogue within the rounding."""
    frame = _photograph() if kind == "photograph" else _simulated(folder)
    law = "lunar-lambert" if kind == "photograph" else "lommel-seeliger"
    every, (as_stored, numbers) = range(len(catalog)), decoded

    def against(given: Catalog, rows: Sequence[int]) -> list[flight_c.Difference]:
        return [
            flight_c.difference(reference, numbers[row], frame, given, row, law, 32) for row in rows
        ]

    for one in against(as_stored, every[::2]):
        assert one.found == (one.code == 0)
        assert not one.render_share > 1e-5
        assert not one.match_px > 1e-4
        assert not one.covariance_share > 1e-4
    all_ = against(catalog, every)
    both = [one for one in all_ if np.isfinite(one.match_px)]
    assert len(both) >= 15
    assert sum(one.found != (one.code == 0) for one in all_) <= 1  # at a limit of a rule
    assert np.sqrt(np.mean([one.render_share**2 for one in both])) < 0.005
    assert np.sqrt(np.mean([one.match_px**2 for one in both])) <= 0.01
    assert max(one.covariance_share for one in both) <= 0.02
    sigmas = flight_c.position_sigmas(reference, frame, catalog.position_mcmf, all_)
    assert sigmas <= 0.05 or kind == "photograph"  # 25 places chosen blindly are too few in it


REASONS = {
    "not seen": "NOT_SEEN", "not lit": "NOT_LIT", "low contrast": "PLAIN", "no peak": "NO_PEAK",
    "at the edge": "AT_THE_EDGE", "no data": "AT_THE_EDGE", "saturated": "AT_THE_EDGE",
}  # fmt: skip


@pytest.mark.parametrize("count", [150, pytest.param(600, marks=pytest.mark.slow)])
def test_it_judges_as_python_does(count: int, decoded, reference) -> None:
    """Small and large templates beyond the image's edges and in gaps, low and high Suns, noise above the signal: the same
    reason, place, second peak and fit.
    """
    (site, numbers), rng = decoded, np.random.default_rng(8)
    pairs, seconds = [], 0
    for _ in range(count):
        row, law = (
            int(rng.integers(len(site))),
            ("lunar-lambert", "lommel-seeliger")[rng.integers(2)],
        )
        frame, reach = _odd_frame(site, row, law, rng), int(rng.integers(1, 65))
        one = flight_c.difference(reference, numbers[row], frame, site, row, law, reach)
        found = "OK" if one.found else "NO_FIT"
        pairs.append((CODES[one.code], REASONS.get(one.python.reason, found)))
        if pairs[-1] not in (("OK", "OK"), ("NO_FIT", "NO_FIT")):
            continue
        assert one.match["shift"].tolist() == one.python.shift.tolist()
        heights = (one.match["correlation"], one.match["second"])
        np.testing.assert_allclose(heights, one.python.found[2:4], atol=1e-4)
        seconds += np.isfinite(heights[1])
        assert not one.match_px > 1e-3
        assert not one.covariance_share > 0.01
    apart = [pair for pair in pairs if pair[0] != pair[1] and pair[0] != "TOO_LARGE"]
    assert len(apart) <= 2, apart  # at a limit of a rule
    names = ("OK", "NO_FIT", "NOT_LIT", "PLAIN", "AT_THE_EDGE")
    assert min(pairs.count((name, name)) for name in names) >= count // 75
    assert seconds > count // 12


def _odd_frame(site: Catalog, row: int, law: str, rng: np.random.Generator) -> Frame:
    """A patch in noise, somewhere in a small frame or across its border, with gaps."""
    lon, lat, up = (float(one) for one in mcmf_to_lonlat(site.position_mcmf[row]))
    place, size = EnuFrame(lon, lat, up), rng.integers(60, 150, 2)
    middle = (rng.uniform(0.0, size[0]), rng.uniform(0.0, size[1]))
    pixels = 10.0 ** rng.uniform(0.75, 1.75)  # of the patch's side
    view = (100e3, rng.uniform(0.0, 60.0), *rng.uniform(0.0, 360.0, 2), pixels * 100e3 / 3790.0)
    camera = twins_match.looking_at(place, *view, (int(size[0]), int(size[1])), middle)
    lens = np.array([-0.08, 0.02, 1e-3, -5e-4, 0.0]) * rng.integers(2)
    sun = place.direction_to_mcmf(
        direction_enu(rng.uniform(0.0, 360.0), 90.0 * rng.uniform(0.0, 1.0) ** 3)
    )
    camera = replace(camera, distortion=lens, sun_position_mcmf_m=1.5e11 * sun)
    model = law_of(law)
    assert model is not None
    suns = directions_to_sun(camera, site.position_mcmf[[row]])
    shown = render_patches(site, [row], camera, suns, model, psf_sigma_px=0.5)
    grey = rng.normal(size=(size[1], size[0])).astype(np.float32)
    grey = cv2.GaussianBlur(grey, (0, 0), 10.0 ** rng.uniform(-0.7, 0.7))
    grey *= shown.values[0].std() * 10.0 ** rng.uniform(-1.5, 0.7) / grey.std()
    shift = shown.origin[0] + rng.integers(-20, 21, 2)
    for i, j in np.argwhere(shown.mask[0]):
        r, c = i + shift[1], j + shift[0]
        if 0 <= r < size[1] and 0 <= c < size[0]:
            grey[r, c] += shown.values[0, i, j]
    weight = np.where(rng.uniform(size=grey.shape) < 0.3, rng.uniform(0.0, 1.0, grey.shape), 1.0)
    for _ in range(int(rng.integers(3))):
        top, left = rng.integers(0, size[::-1])
        weight[top : top + 20, left : left + 30] = 0.0
    image = Image("odd", grey, weight.astype(np.float32), camera, camera.sun_position_mcmf_m)
    return Frame.of(SearchImage.of(image), camera)


def test_points_in_view_and_their_claims(catalog, reference) -> None:
    """Those of the library, for views between, at and beyond those of the catalogue, and for Suns likewise."""
    rng, checked = np.random.default_rng(4), np.zeros(3, np.int64)
    for _ in range(40):
        view = (rng.uniform(60e3, 300e3), rng.uniform(0.0, 55.0))
        checked += _claims_agree(catalog, reference, _somewhere(rng, view))
    every, known, _ = checked
    assert every > 300
    assert 0.2 * every < known < every


@pytest.mark.slow
def test_claims_between_altitudes_and_near_the_limit(reference, folder: Path) -> None:
    """Views at three altitudes, of which each leaves some directions to the others; probabilities about the least one of a
    usable condition, so that the margins between and beyond the evaluated conditions decide.
    """
    site = _of_altitudes()
    export(site, folder / "altitudes.lcpf")
    other = copy.copy(reference)
    other.file = np.zeros((), flight_c.FILE)
    assert other.open((folder / "altitudes.lcpf").read_bytes()) == 0
    rng, checked = np.random.default_rng(5), np.zeros(3, np.int64)
    for _ in range(250):
        view = (10.0 ** rng.uniform(4.2, 5.8), rng.uniform(0.0, 65.0))
        checked += _claims_agree(site, other, _somewhere(rng, view))
    every, known, usable = checked
    assert every > 3000
    assert 0.2 * every < usable < known < every


def _somewhere(rng: np.random.Generator, view: tuple[float, float]) -> Camera:
    """A camera at a distance and an angle off nadir, over the site, with a Sun."""
    place = EnuFrame(flight_vector.CENTRE[0] + rng.uniform(-0.2, 0.2), 26.1, -1500.0)
    turn, focal = rng.uniform(0.0, 360.0), rng.uniform(200.0, 900.0)
    camera = twins_match.looking_at(place, *view, turn, 30.0, focal, (300, 280))
    sun = flight_vector.CENTRE[0] + rng.uniform(-85.0, 85.0), rng.uniform(-1.5, 1.5)
    return replace(camera, sun_position_mcmf_m=1.5e11 * lonlat_to_mcmf(*sun) / MOON_RADIUS_M)


def _claims_agree(catalog: Catalog, reference: Reference, camera: Camera) -> tuple[int, int, int]:
    """The points in view, those with a claim, and the usable ones: of the reference and of the library the same."""
    claims = reference.in_view(flight_c.camera_record(camera), 100)
    row_of = {int(point_id): row for row, point_id in enumerate(catalog.point_id)}
    rows = np.array([row_of[reference.id_of(int(k))] for k in claims["point"]], np.int64)
    assert sorted(rows.tolist()) == points_in_view(catalog, camera).tolist()
    pixels = camera.project(catalog.position_mcmf[rows])
    np.testing.assert_allclose(claims["pixel"], pixels, atol=1e-9)
    suns = directions_to_sun(camera, catalog.position_mcmf[rows])
    stated = claimed(catalog, rows, camera, suns)
    np.testing.assert_allclose(stated.detection_probability, claims["probability"], atol=1e-4)
    known = np.isfinite(claims["probability"])
    sigmas = np.stack([stated.sigma_major_m, stated.sigma_minor_m], axis=-1)
    np.testing.assert_allclose(claims["sigma"][known], sigmas[known], rtol=0.03)
    np.testing.assert_array_equal(claims["usable"] > 0, stated.usable)
    return len(rows), int(known.sum()), int(stated.usable.sum())


def _of_altitudes() -> Catalog:
    """The site with made-up claims for views at three altitudes."""
    site, rng = flight_vector.site(5, 0.14), np.random.default_rng(11)
    far, near = (np.inf, 100.0)
    views = (
        (0, 0, far),
        (30, 0, far),
        (30, 120, far),
        (30, 240, far),
        (0, 0, near),
        (35, 90, near),
    )
    views += ((50, 45, near), (50, 300, 30.0))
    off, azimuth, altitude = np.array(views, np.float64).T
    shape = (len(site), 3, len(views), len(site.sun_elevation), len(site.sun_azimuth))
    probability = np.rint(rng.uniform(0.86, 0.996, shape) / DETECTION_STEP) * DETECTION_STEP
    condition = np.full((shape[0], *shape[2:]), USABLE, np.uint8)
    condition[probability[:, 0] < site.min_detection] -= 2  # not localizable
    condition[rng.uniform(size=condition.shape) < 0.1] &= ~np.uint8(UNSHADOWED)
    condition[rng.uniform(size=condition.shape) < 0.05] = 0
    probability[np.broadcast_to((condition == 0)[:, None], shape)] = np.nan
    major = rng.uniform(5.0, 30.0, shape) + 0.0 * probability
    low, high = summarise_usable(condition, site.sun_elevation)
    return replace(
        site, view_off_nadir=off, view_azimuth=azimuth, view_altitude=altitude, condition=condition,
        detection_probability=probability, sigma_major=major, sigma_minor=0.5 * major,
        sigma_angle=rng.uniform(0.0, 180.0, shape) + 0.0 * probability, sun_elevation_min=low,
        sun_elevation_max=high, coverage=replace(site.coverage, usable=None),
    )  # fmt: skip


def test_of_many_points_the_likeliest_are_listed(reference) -> None:
    camera = _photograph().camera
    whole, few = reference.in_view(camera, 100), reference.in_view(camera, 5)
    best = np.sort(np.nan_to_num(whole["probability"]))[-5:]
    np.testing.assert_allclose(np.sort(np.nan_to_num(few["probability"])), best)


def test_albedo_is_in_its_renders(catalog, folder: Path, reference) -> None:
    dice = np.random.default_rng(9)
    grey = dice.uniform(0.7, 1.3, catalog.dem.shape).astype(np.float32)
    grey[3] = np.nan
    site = replace(catalog, albedo=grey, albedo_map=catalogs.ALBEDO_MAP)
    export(site, folder / "albedo.lcpf")
    other = copy.copy(reference)
    other.file = np.zeros((), flight_c.FILE)
    assert other.open((folder / "albedo.lcpf").read_bytes()) == 0
    ids, frame = FlightFile.of(folder / "albedo.lcpf").points["point_id"].tolist(), _photograph()
    for row in (0, 3, 12):
        number = ids.index(int(site.point_id[row]))
        one = flight_c.difference(other, number, frame, site, row, "lommel-seeliger", 16)
        assert one.render_share < 0.003
        bare = flight_c.difference(other, number, frame, catalog, row, "lommel-seeliger", 16)
        assert bare.render_share > 0.02 or row == 3


def test_a_damaged_file_is_refused(reference, folder: Path) -> None:
    content = (folder / "site.lcpf").read_bytes()
    rng = np.random.default_rng(3)
    other = copy.copy(reference)
    other.file = np.zeros((), flight_c.FILE)
    for place in [0, 9, 20, 40, 60, 190, 300, *rng.integers(192, len(content), 20)]:
        wrong = bytearray(content)
        wrong[place] ^= 1 << int(rng.integers(8))
        code = other.open(bytes(wrong))
        assert CODES[code or other.call("lcpf_check", other.file)] in ("DAMAGED", "NOT_A_FILE")
    assert CODES[other.open(content[:-1])] == "DAMAGED"
    assert CODES[other.open(content[:100])] == "NOT_A_FILE"


def test_its_law_is_ours(reference) -> None:
    np.testing.assert_allclose(reference.law(True)["number"], surface_law("sp-mid"), rtol=1e-15)


def test_its_source_stays_small() -> None:
    lines = sum(len((SOURCE / name).read_text().splitlines()) for name in ("lcpf.h", "lcpf.c"))
    assert lines < 1200
    text = (SOURCE / "lcpf.c").read_text()
    includes = [line for line in text.splitlines() if line.startswith("#include")]
    assert includes == ['#include "lcpf.h"', "#include <math.h>", "#include <string.h>"]
    for word in ("malloc", "free(", "printf", "memset", "goto", "while (1", "for (;;"):
        assert word not in text


def test_it_calls_nothing_but_mathematics_and_never_itself(tmp_path: Path) -> None:
    made = flight_c.compiled([SOURCE / "lcpf.c"], tmp_path / "lcpf.o", "-O0", "-c")
    lines = subprocess.check_output(["nm", "-u", str(made)], text=True).split()
    maths = "acos atan2 ceil cos erfc exp expm1 floor fmax fmin fmod hypot log pow sin sqrt"
    # compilers set arrays by memset themselves
    assert {*lines[1::2]} <= {*maths.split(), "memcpy", "memset", "__stack_chk_fail"}
    if "gcc" not in subprocess.check_output([flight_c.COMPILER, "-v"], stderr=-2, text=True):
        pytest.skip("the graph of calls is gcc's")
    assert flight_c.stack_bytes(tmp_path, "-O0") < 8000  # of no cycle


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_its_own_vector(compiler: str, tmp_path: Path) -> None:
    """`lcp flight-source`, `make test`; with a wrong place expected it fails."""
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    out = tmp_path / "src"
    assert run(["flight-source", "-o", str(out)]) == 0
    make = ["make", "-C", str(out), "test", f"CC={compiler}"]
    assert subprocess.run(make, check=False, capture_output=True).returncode == 0
    expected = out / "vector_expected.txt"
    first, *others = expected.read_text().splitlines()
    number, column, row = first.split()
    lines = [f"{number} {float(column) + 0.05} {row}", *others]
    expected.write_text("\n".join(lines) + "\n")
    done = subprocess.run(make, check=False, capture_output=True, text=True)
    assert done.returncode != 0
    assert "FAILED: 9 of 9 places, largest difference 0.05" in done.stdout


@pytest.mark.parametrize("machine", ["s390x", "mips"])
def test_its_own_vector_on_a_big_endian_machine(machine: str, tmp_path: Path) -> None:
    """In emulation, of 64 and of 32 bits."""
    compiler, emulator = f"{machine}-linux-gnu-gcc", f"qemu-{machine}"
    if shutil.which(compiler) is None or shutil.which(emulator) is None:
        pytest.skip(f"{compiler} and {emulator} are not installed")
    program, code = tmp_path / "example", ["lcpf.c", "lcpf_example.c"]
    words = [compiler, *flight_c.STRICT, "-O2", "-static", *code, "-o", str(program), "-lm"]
    subprocess.run(words, cwd=SOURCE, check=True)
    words = [emulator, str(program), *VECTOR]
    done = subprocess.run(words, cwd=SOURCE, check=False, capture_output=True, text=True)
    assert "passed: 9 of 9 places, largest difference 0.000" in done.stdout


@pytest.mark.slow
def test_it_survives_under_sanitizers(tmp_path: Path) -> None:
    """`make fuzz` runs 10^6 files and 10^5 images."""
    flags = ("-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    program = flight_c.compiled([SOURCE / "lcpf_fuzz.c"], tmp_path / "fuzz", *flags)
    words = [str(program), str(SOURCE / "vector.lcpf"), "2000", "60"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    files, images = (
        [int(word) for word in line.split(": ")[1].split()]
        for line in done.stdout.replace("code:", "code: ").splitlines()
    )
    assert sum(files) == 2000
    assert min(files[:4]) > 0  # right, no file, damaged, too large
    assert sum(images) == 60
    full = flight_c.compiled(
        [SOURCE / "lcpf_example.c", SOURCE / "lcpf.c"], tmp_path / "example", *flags
    )
    inputs = [str(SOURCE / name) for name in VECTOR]
    done = subprocess.run([str(full), *inputs], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
