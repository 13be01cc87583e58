"""How threads wait between two kernels."""

import contextlib
import importlib
import os


def sleep_between_kernels() -> None:
    """Let threads that wait for the next kernel sleep, if it is called before numba loads OpenMP: GNU's would spin for
    milliseconds after each kernel, a fifth of the processor time of a frame that is located, and on a busy machine take the
    processor from what runs beside them. ``OMP_WAIT_POLICY`` of the environment, where it is set, holds; it is not changed.
    """
    if "OMP_WAIT_POLICY" in os.environ:
        return
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    try:
        with contextlib.suppress(ImportError):  # without OpenMP
            importlib.import_module("numba.np.ufunc.omppool")
    finally:
        del os.environ["OMP_WAIT_POLICY"]
