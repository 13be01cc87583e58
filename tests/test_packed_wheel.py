"""The wheel with compiled kernels: what it holds, and that the first build from it compiles nothing."""

from __future__ import annotations

import base64
import hashlib
import os
import runpy
import subprocess
import sys
import sysconfig
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

import lcp_catalog as lcp
from lcp_catalog.kernels import cache, entries

ROOT = Path(__file__).resolve().parents[1]
PACK = runpy.run_path(str(ROOT / "packaging" / "pack_wheel.py"))["pack"]
PURE = "lcp_catalog-1.0-py3-none-any.whl"
TAG = "cp311-cp311-linux_x86_64"
FOLDER = "lcp_catalog-1.0.dist-info"
FACTS = "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n\n"
METADATA = """Name: lcp-catalog
Requires-Dist: click>=8.1.0
Requires-Dist: numba>=0.60.0
Requires-Dist: numpy>=2.0.0

Text of Requires-Dist: numba
"""


def test_a_packed_wheel_is_of_one_platform_and_pins_the_compiler(tmp_path: Path) -> None:
    files = {"lcp_catalog/a.py": "1\n", f"{FOLDER}/WHEEL": FACTS, f"{FOLDER}/METADATA": METADATA}
    with zipfile.ZipFile(tmp_path / PURE, "w") as wheel:
        for name, text in {**files, f"{FOLDER}/RECORD": "old"}.items():
            wheel.writestr(name, text)
    kernel = {"lcp_catalog/kernels/compiled/x/a.kernel": b"code"}
    packed = PACK(tmp_path / PURE, kernel, TAG)
    assert packed.name == f"lcp_catalog-1.0-{TAG}.whl"
    with zipfile.ZipFile(packed) as wheel:
        found = {name: wheel.read(name) for name in wheel.namelist()}
    assert found["lcp_catalog/a.py"] == b"1\n"
    assert found[next(iter(kernel))] == b"code"
    facts = found[f"{FOLDER}/WHEEL"].decode()
    assert facts == FACTS.replace("true", "false").replace("py3-none-any", TAG)
    head, text = found[f"{FOLDER}/METADATA"].decode().split("\n\n")
    assert set(head.splitlines()) == {
        *("Name: lcp-catalog", "Requires-Dist: click>=8.1.0", "Requires-Dist: numpy>=2.0.0"),
        f"Requires-Dist: numba=={version('numba')}",
        f"Requires-Dist: llvmlite=={version('llvmlite')}",
    }
    assert text == "Text of Requires-Dist: numba\n"
    rows = [row.split(",") for row in found.pop(f"{FOLDER}/RECORD").decode().splitlines()]
    assert rows.pop() == [f"{FOLDER}/RECORD", "", ""]
    assert {name: (digest, int(size)) for name, digest, size in rows} == {
        name: (
            f"sha256={base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip('=')}",
            len(data),
        )
        for name, data in found.items()
    }


@pytest.mark.slow
def test_the_first_build_from_the_wheel_compiles_nothing(tmp_path: Path) -> None:
    """Two jobs, in an environment that has only the wheel and, by a path, the libraries of this one."""
    pip = [sys.executable, "-m", "pip"]
    subprocess.run([*pip, "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(ROOT)], check=True)
    (pure,) = tmp_path.glob("*.whl")
    kernels = {
        f"lcp_catalog/kernels/compiled/{path.parent.name}/{path.name}": path.read_bytes()
        for path in lcp.warm_up(output=tmp_path / "kernels")
    }
    assert len(kernels) == len(entries.entries())
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    packed = PACK(pure, kernels, f"{python}-{python}-{platform}")

    env = tmp_path / "env"
    subprocess.run([sys.executable, "-m", "venv", str(env)], check=True)
    install = [*pip, "--python", str(env), "install", "-q", "--no-deps", str(packed)]
    subprocess.run(install, check=True)
    (site,) = env.glob("lib/python*/site-packages")
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")

    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA_", "LCP_"))}
    here = kept | {"NUMBA_CACHE_DIR": str(tmp_path / "own"), "TMPDIR": str(tmp_path / "tmp")}
    (tmp_path / "tmp").mkdir()

    def lcp_says(*words: str) -> str:
        command = [str(env / "bin" / "lcp"), *words]
        done = subprocess.run(
            command, env=here, cwd=tmp_path, capture_output=True, text=True, check=True
        )
        return done.stderr

    lcp_says("sample", "hadley")
    said = lcp_says(
        *("build-catalog", "hadley/hadley_gld100_256ppd.tif", "-o", "hadley.h5"),
        *("--config", "hadley/hadley.toml", "--jobs", "2"),
    )
    assert "compiling kernels" not in said
    assert "control points from 67 areas" in said
    assert not list((tmp_path / "own").rglob("*.kernel"))
    assert not list((tmp_path / "tmp").rglob("*.kernel"))
    where = "from lcp_catalog.kernels import cache; print(cache.__file__, cache.key())"
    command = [str(env / "bin" / "python"), "-c", where]
    found = subprocess.run(
        command, env=here, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert found.stdout.split()[0].startswith(str(site))
    assert found.stdout.split()[1] == cache.key()
