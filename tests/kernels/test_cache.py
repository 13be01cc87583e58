"""Files of compiled kernels: where they are looked up, which are not used, and that no two processes spoil them."""

from __future__ import annotations

import io
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import pytest

import lcp_catalog
from lcp_catalog.kernels import cache

PACKAGE = Path(lcp_catalog.__file__).parent


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's folder."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))
    monkeypatch.delenv(cache.SHARED, raising=False)
    monkeypatch.setattr(cache.tempfile, "tempdir", str(tmp_path))
    return tmp_path / "own" / "kernels" / cache.key()


def half(number: float = 3.0) -> tuple[float, bool]:
    """The half of a number by a kernel that a new process would load or compile, and whether it was loaded."""

    def halved(x: Any) -> Any:
        return x / 2

    kernel = cache.njit(nogil=True)(halved)
    return kernel(number), bool(kernel.stats.cache_hits)


def only_file(folder: Path) -> Path:
    (file,) = folder.iterdir()
    return file


def test_a_kernel_is_compiled_once_and_for_each_type(own: Path) -> None:
    assert half() == (1.5, False)
    assert half() == (1.5, True)
    assert half(3) == (1.5, False)
    assert half(3) == (1.5, True)
    assert len(list(own.iterdir())) == 2


def test_a_file_keeps_machine_code_alone(own: Path) -> None:
    """numba reads LLVM's code, too, for kernels that call this one: they have its part instead, but not with other versions."""
    half()
    body = cache._read(only_file(own))
    assert body is not None
    (_, kind, (machine_code, llvm_code)), *_ = cache._Unpickler(io.BytesIO(body)).load()
    assert kind == "object"
    assert len(machine_code) > 1000
    assert bool(list(llvmlite.binding.parse_bitcode(llvm_code).functions)) == (not cache.LINKED)
    assert half() == (1.5, True)


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "short digest": lambda data: data[:20],
    "half": lambda data: data[: len(data) // 2],
    "last byte": lambda data: data[:-1],
    "flipped code": lambda data: data[:2000] + bytes([data[2000] ^ 1]) + data[2001:],
    "flipped digest": lambda data: bytes([data[0] ^ 128]) + data[1:],
    "longer": lambda data: data + b"0",
    "other bytes": lambda data: os.urandom(len(data)),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_compiled_again(damage: str, own: Path) -> None:
    half()
    file = only_file(own)
    whole = file.read_bytes()
    assert len(whole) > 3000
    file.write_bytes(DAMAGES[damage](whole))
    assert half() == (1.5, False)
    assert half() == (1.5, True)
    assert only_file(own) == file


def test_a_pipe_in_the_place_of_a_file_is_replaced(own: Path) -> None:
    """Nobody waits for its writer."""
    half()
    file = only_file(own)
    file.unlink()
    os.mkfifo(file)
    with ThreadPoolExecutor(1) as pool:
        reading = pool.submit(cache._read, file)
        try:
            assert reading.result(5) is None
        finally:
            os.close(os.open(file, os.O_RDWR | os.O_NONBLOCK))  # whoever waits goes on
    assert [half(), half()] == [(1.5, False), (1.5, True)]


def test_the_file_of_another_signature_or_version_is_not_used(own: Path) -> None:
    half(3)
    whole_number = only_file(own)
    half(3.0)
    (other,) = set(own.iterdir()) - {whole_number}
    shutil.copy(whole_number, other)
    assert half(3.0) == (1.5, False)
    elsewhere = own.parent / "x86-64-v0-0123456789abcdef"
    own.rename(elsewhere)
    shutil.copytree(elsewhere, own)
    assert half(3) == (1.5, True)
    shutil.copy(own / other.name, elsewhere / "moved")
    assert cache._read(elsewhere / other.name) is None


def test_a_whole_file_that_cannot_be_read_as_a_result_is_compiled_again(own: Path) -> None:
    half()
    cache.write(only_file(own), b"not a pickle")
    assert half() == (1.5, False)
    assert half() == (1.5, True)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners of files are POSIX")
@pytest.mark.parametrize("others", ["group", "all", "owner"])
def test_a_file_that_others_could_have_written_is_not_run(
    others: str, own: Path, caplog: pytest.LogCaptureFixture
) -> None:
    half()
    file = only_file(own)
    if others == "owner":
        if os.getuid() != 0:
            pytest.skip("only root can give a file to another owner")
        os.chown(file, 12345, 12345)
    else:
        file.chmod(0o664 if others == "group" else 0o646)
    assert half() == (1.5, False)
    assert "others can write" in caplog.text
    assert half() == (1.5, True)  # it is replaced
    assert file.stat().st_uid == os.getuid()


def test_the_shared_folder_is_read_and_never_written(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    half()
    shared = tmp_path / "shared"
    own.parent.rename(shared)
    monkeypatch.setenv(cache.SHARED, str(shared))
    assert half() == (1.5, True)
    assert not own.exists()
    before = only_file(shared / own.name)
    assert half(3) == (1.5, False)
    assert only_file(shared / own.name) == before
    before.write_bytes(b"")
    assert half() == (1.5, False)
    assert before.read_bytes() == b""
    assert half() == (1.5, True)


def test_without_a_writable_folder_nothing_is_kept(own: Path, tmp_path: Path) -> None:
    """Files in the places of folders: unlike permissions this stops root too."""
    (tmp_path / "own").touch()
    assert half() == (1.5, False)
    assert half() == (1.5, True)  # in the temporary folder
    (temporary,) = tmp_path.glob("lcp-kernels-*")
    shutil.rmtree(temporary)
    temporary.touch()
    assert half() == (1.5, False)
    assert half() == (1.5, False)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners of files are POSIX")
def test_a_temporary_folder_that_another_user_could_have_made_is_not_used(
    own: Path, tmp_path: Path
) -> None:
    (tmp_path / "own").touch()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / f"lcp-kernels-{os.getuid()}").symlink_to(tmp_path / "elsewhere")
    assert half() == (1.5, False)
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_folders_of_old_versions_are_removed(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_KEPT", 2)
    own.parent.mkdir(parents=True)
    folders = [own.parent / f"x86-64-v3-{k:016x}" for k in range(4)]
    for k, folder in enumerate(folders):
        folder.mkdir()
        os.utime(folder, (1e9 + k, 1e9 + k))
    (own.parent / "not ours").mkdir()
    half()
    assert [folder.is_dir() for folder in folders] == [False, False, True, True]
    assert (own.parent / "not ours").is_dir()


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the kernels, to change and to run in other processes."""
    copy = tmp_path / "site" / "lcp_catalog"
    left_out = shutil.ignore_patterns("__pycache__", "compiled")
    shutil.copytree(PACKAGE / "kernels", copy / "kernels", ignore=left_out)
    for name in ("__init__.py", "_version.py", "constants.py"):
        shutil.copy(PACKAGE / name, copy / name)
    return copy.parent


def started(package: Path, code: str, **given: str) -> subprocess.Popen[str]:
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_", "LCP_"))}
    home = package.parent / "home"
    env = kept | {"PYTHONPATH": str(package), "HOME": str(home)} | given
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-c", code], env=env, cwd=package, text=True, **pipes)


def result(process: subprocess.Popen[str]) -> tuple[str, str]:
    out, said = process.communicate()
    assert process.returncode == 0, said
    return out.strip(), said


ROWS = "from lcp_catalog.kernels.matching.template_products import row_length; print(row_length(1))"


RAISES = """
import numpy as np
from lcp_catalog.kernels.cache import njit
from lcp_catalog.kernels.completion import all_done
@njit()
def fails(done, name):
    print(name.upper(), name.split("a")[1])
    all_done(done, 2)
try:
    fails(1, "name")
except MemoryError as error:
    print(error, len(fails.stats.cache_hits))
"""


@pytest.mark.slow
def test_files_name_no_folder_of_this_machine(package: Path) -> None:
    """Errors of a kernel and of numba's own functions, which name their sources, are raised from such files."""
    said = "NAME me\nno memory for the arrays of a parallel loop"
    (package / "program.py").write_text(RAISES)
    program = "import program"
    assert result(started(package, program))[0] == f"{said} 0"
    files = list((package.parent / "home").rglob("*.kernel"))
    for place in (package, Path(numba.__file__).parents[1]):
        assert [path.name for path in files if os.fsencode(place) in path.read_bytes()] == []
    assert any(b"/lcp_catalog/kernels/completion.py" in path.read_bytes() for path in files)
    assert any(b"/numba/cpython/unicode.py" in path.read_bytes() for path in files)
    assert result(started(package, program)) == (f"{said} 1", "")


@pytest.mark.slow
def test_a_kernel_is_compiled_again_when_one_that_it_calls_has_changed(package: Path) -> None:
    """`row_length` calls `multiple` of another file."""
    found, said = result(started(package, ROWS))
    assert said.count("compiling kernels") == 1
    vectors = package / "lcp_catalog" / "kernels" / "vectors.py"
    text = vectors.read_text()
    vectors.write_text(text.replace("// of * of", "// of * of + 1000"))
    assert int(result(started(package, ROWS))[0]) == int(found) + 1000
    vectors.write_text(text)
    assert result(started(package, ROWS)) == (found, "")


@pytest.mark.slow
def test_two_processes_that_compile_at_once_leave_whole_files(package: Path) -> None:
    found = [result(one) for one in [started(package, ROWS) for _ in range(3)]]
    assert len({out for out, _ in found}) == 1
    files = [path for path in package.parent.rglob("*") if path.is_file() and "home" in path.parts]
    assert {path.suffix for path in files} == {".kernel"}
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o644 for path in files)
    assert result(started(package, ROWS)) == (found[0][0], "")


LEVEL = """from lcp_catalog.kernels import cpu_level, vectors, cache
print(cpu_level.level(), vectors.LANES, cache.key().rsplit("-", 1)[0])"""


@pytest.mark.slow
@pytest.mark.parametrize(("level", "lanes"), [("x86-64-v4", 16), ("x86-64-v3", 8), ("x86-64", 8)])
def test_lanes_and_folder_follow_the_level(level: str, lanes: int, package: Path) -> None:
    out, _ = result(started(package, LEVEL, NUMBA_CPU_NAME=level))
    assert out == f"{level} {lanes} {level}"


def test_without_a_name_the_level_is_found_by_features() -> None:
    from lcp_catalog.kernels import cpu_level

    assert cpu_level.level() in {*cpu_level.LEVELS, "generic"}
    flags = Path("/proc/cpuinfo")
    if flags.exists() and cpu_level.level() != "generic":
        line = next(x for x in flags.read_text().splitlines() if x.startswith("flags"))
        has = set(line.split(":")[1].split())
        wide = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"} <= has
        assert (cpu_level.level() == "x86-64-v4") == wide


@pytest.mark.slow
def test_a_program_that_has_compiled_for_its_own_processor_goes_on_with_it(package: Path) -> None:
    first = "import numba; numba.njit(lambda x: x)(1); from numba.core.registry import cpu_target as t; "
    first += "own = t.target_context.codegen().magic_tuple(); "
    last = "; from lcp_catalog.kernels import cpu_level; print(cpu_level.target() == own)"
    out, _ = result(started(package, first + LEVEL.replace(chr(10), "; ") + last))
    assert out.endswith("True")


LOAD_ALL = """
import io, sys
from pathlib import Path
from lcp_catalog.kernels import cache
from numba.core.registry import cpu_target
from numba.core.compiler import CompileResult
cache.rtsys.initialize(cpu_target.target_context)
for path in sys.argv[1:]:
    body = cache._read(Path(path))
    CompileResult._rebuild(cpu_target.target_context, *cache._Unpickler(io.BytesIO(body)).load())
print(len(sys.argv) - 1, "scipy.linalg" in sys.modules)
"""


@pytest.mark.slow
def test_a_kernel_of_a_file_needs_nothing_that_numba_loads_to_compile() -> None:
    files = [path for folder in cache.folders() for path in folder.glob("*.kernel")]
    found = [str(path) for path in files if ".part-" not in path.name]
    assert found, "the tests compile some"
    done = subprocess.run(
        [sys.executable, "-c", LOAD_ALL, *found], check=False, capture_output=True, text=True
    )  # a symbol that is missing ends the process
    assert done.stdout == f"{len(found)} False\n", done.stderr


RENDERED = """
import sys
import lcp_catalog
image = lcp_catalog.render(sys.argv[1], center=(3.63, 26.13), size_km=8, sun=(96.5, 14), accuracy="draft")
print(image.radiance.shape, *sorted({"scipy.linalg", "cv2", "numba.np.linalg"} & {*sys.modules}))
"""


@pytest.mark.slow
def test_a_render_by_kernels_of_files_imports_neither_scipy_nor_opencv() -> None:
    dem = PACKAGE.parent / "sample_data" / "hadley_gld100_256ppd.tif"
    words = [sys.executable, "-c", RENDERED, str(dem)]
    subprocess.run(words, check=True, capture_output=True)  # compiles what is missing
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert done.stdout == "(69, 69)\n", done.stderr
