"""Compiled kernels where neither the package nor the home can be written."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

import lcp_catalog
from lcp_catalog.kernels import cache

PACKAGE = Path(lcp_catalog.__file__).parent


@pytest.fixture
def fixed_package(tmp_path: Path) -> Path:
    """A copy of the kernels whose compiled files have no folder: files of that name stand in the
    places. Unlike permissions this stops root too.
    """
    copy = tmp_path / "site" / "lcp_catalog"
    shutil.copytree(
        PACKAGE / "kernels", copy / "kernels", ignore=shutil.ignore_patterns("__pycache__")
    )
    for name in ("__init__.py", "_version.py", "constants.py"):
        shutil.copy(PACKAGE / name, copy / name)
    for folder in {path.parent for path in copy.rglob("*.py")}:
        (folder / "__pycache__").touch()
    return copy.parent


def run_kernel(package: Path, temporary: Path) -> str:
    """Use a kernel twice in a new process without a home; return what was logged."""
    call = "moments({}, 1.0, 0.0, 0.0, 289)"
    code = "from lcp_catalog.kernels.matching.acquisition import moments; "
    code += call.format("0.1") + "; " + call.format(1)
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))}
    given = {"PYTHONPATH": str(package), "HOME": os.devnull, "TMPDIR": str(temporary)}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=kept | given,
        cwd=package,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


def test_kernels_are_kept_in_the_temporary_folder_and_compiled_once(
    fixed_package: Path, tmp_path: Path
) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    assert run_kernel(fixed_package, temporary).count("compiling kernels") == 1
    (folder,) = temporary.iterdir()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert len(list(folder.rglob("acquisition.moments-*.nbi"))) == 1
    assert run_kernel(fixed_package, temporary) == ""
    assert list(temporary.iterdir()) == [folder]


ROWS = "from lcp_catalog.kernels.matching.template_products import row_length; print(row_length(1))"


@pytest.mark.slow
@pytest.mark.parametrize("place", ["beside", "home", "given"])
def test_a_kernel_is_compiled_again_when_one_that_it_calls_has_changed(
    place: str, fixed_package: Path, tmp_path: Path
) -> None:
    """`row_length` calls `multiple` of another file, which the cache does not look at."""
    if place == "beside":
        for folder in fixed_package.rglob("__pycache__"):
            folder.unlink()
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))}
    env = kept | {"PYTHONPATH": str(fixed_package), "HOME": str(tmp_path / "home")}
    env |= {"NUMBA_CACHE_DIR": str(tmp_path / "given")} if place == "given" else {}
    (tmp_path / "home").mkdir()

    def length() -> int:
        command = [sys.executable, "-c", ROWS]
        done = subprocess.run(command, env=env, cwd=fixed_package, capture_output=True, check=True)
        return int(done.stdout)

    found = length()
    vectors = fixed_package / "lcp_catalog" / "kernels" / "vectors.py"
    text = vectors.read_text()
    vectors.write_text(text.replace("// of * of", "// of * of + 1000"))
    assert length() == found + 1000
    vectors.write_text(text)
    assert length() == found
    assert len(list(tmp_path.rglob("*row_length*.nbi"))) == (1 if place == "beside" else 2)


@pytest.mark.parametrize("planted", ["link", "open folder", "file"])
def test_a_folder_that_another_user_could_have_made_is_not_used(
    planted: str, tmp_path: Path
) -> None:
    """Files in it are unpickled and run."""
    name = cache._folder(tmp_path)
    name.rmdir()
    if planted == "link":
        (tmp_path / "elsewhere").mkdir()
        name.symlink_to(tmp_path / "elsewhere")
    elif planted == "file":
        name.touch()
    else:
        name.mkdir()
        name.chmod(0o777)
    other = cache._folder(tmp_path)
    assert other not in (name, tmp_path / "elsewhere")
    assert stat.S_IMODE(other.stat().st_mode) == 0o700


def test_another_source_of_the_kernels_has_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = cache._folder(tmp_path)
    assert cache._folder(tmp_path) == one
    monkeypatch.setattr(cache, "_source_digest", lambda: "0" * 64)
    assert cache._folder(tmp_path) != one
