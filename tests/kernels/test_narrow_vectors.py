"""Vectors of 8 numbers, as on processors without AVX-512, by the tests of the kernels that use vectors."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.codegen import get_host_cpu_features

from lcp_catalog.kernels.vectors import LANES

TESTS = Path(__file__).resolve().parents[1]


@pytest.mark.slow
@pytest.mark.skipif(LANES == 8, reason="all tests use vectors of 8 on this processor")
def test_all_kernels_with_vectors_hold_with_vectors_of_8(tmp_path: Path) -> None:
    wide = ("avx512", "avx10", "amx", "evex512")
    features = [f for f in get_host_cpu_features().split(",") if not f[1:].startswith(wide)]
    env = os.environ | {
        "NUMBA_CPU_NAME": "haswell",
        "NUMBA_CPU_FEATURES": ",".join(features),
        "NUMBA_CACHE_DIR": str(tmp_path),
    }
    code = "from lcp_catalog.kernels.vectors import LANES; print(LANES)"
    said = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, check=True)
    assert said.stdout.strip() == b"8"
    files = ["kernels/test_vectors.py", "matching/test_maxima.py", "landmarks"]
    files += ["matching/test_template_products.py", "production/test_evaluation.py"]
    command = [sys.executable, "-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*command, *files], cwd=TESTS, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-3000:]
