"""Parallel loops that notice lost passes.

numba drops an exception of a thread of a parallel loop: of an array that cannot be allocated, for one. The passes that the
thread still had are not made, and the loop ends as if they were. Every loop over `prange` therefore counts its
passes; numba adds a thread's count to the sum when the thread has made them all.
"""

from .cache import njit


@njit(nogil=True, error_model="numpy")
def all_done(done, count):
    """MemoryError if fewer than ``count`` passes of a parallel loop were made."""
    if done < count:
        raise MemoryError("no memory for the arrays of a parallel loop")
