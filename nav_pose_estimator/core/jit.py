"""One source for two worlds: numeric kernels are compiled where numba is installed and plain Python elsewhere.

A kernel is written with scalars and explicit loops over small arrays. That is what numba compiles best, and what
plain Python runs faster than numpy calls on 3-vectors.
"""

import os

try:
    import numba
except ImportError:
    numba = None

COMPILED: bool = numba is not None and os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")
"""True when kernels run as machine code in this process."""


def kernel(function):
    """Compile ``function`` with numba (cached on disk, float64, no fast-math); without numba return it unchanged."""
    if numba is None:
        return function
    return numba.njit(cache=True, error_model="numpy")(function)
