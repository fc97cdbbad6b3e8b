"""One source for two worlds: numeric kernels are compiled where numba is installed and plain Python elsewhere.

A kernel is written with scalars and explicit loops over small arrays. That is what numba compiles best, and what
plain Python runs faster than numpy calls on 3-vectors.
"""

import hashlib
import os
from types import ModuleType
from typing import Any

import numpy as np

try:
    import numba
except ImportError:
    numba = None  # type: ignore[assignment]

COMPILED: bool = numba is not None and os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")
"""True when kernels run as machine code in this process."""


def kernel(function):
    """Compile ``function`` with numba (cached on disk, float64, no fast-math); without numba return it unchanged."""
    return _compile(function)


def inlined(function):
    """A kernel for the inside of others: the compiler copies it into every caller.

    A call between compiled functions costs tens of nanoseconds for its arrays alone (their reference counts), more
    than the arithmetic of a small kernel.
    """
    return _compile(function, forceinline=True)


def _compile(function, **options):
    if numba is None:
        return function
    compiled = numba.njit(cache=True, error_model="numpy", **options)(function)
    if not COMPILED or _tie_cache_to_sources(compiled):
        return compiled
    return numba.njit(error_model="numpy", **options)(function)


def _tie_cache_to_sources(compiled) -> bool:
    """Make the cached machine code of a kernel stale when anything that was compiled into it has changed.

    By itself numba looks at the kernel's own file only. Numbers and kernels of other files are compiled in as well:
    with an old cache, a new ``core.layout`` would be read at the old places. So are numba's forms of NumPy's functions,
    whose types follow the rules of the NumPy that is installed. False when this numba keeps its cache some other way:
    the kernel then has to do without.
    """
    parts = [np.__version__, *_compiled_in(compiled.py_func.__globals__)]
    try:
        file = compiled._cache._cache_file
        compiled.source_stamp = hashlib.sha256(repr((file._source_stamp, parts)).encode()).hexdigest()
        file._source_stamp = compiled.source_stamp
    except AttributeError:
        return False
    return True


def _compiled_in(names: dict[str, Any]) -> list[Any]:
    """What kernels may take from a module's globals: numbers, kernels, and those of modules of this package."""
    parts: list[Any] = []
    for name, value in sorted(names.items()):
        if isinstance(value, int | float | tuple):
            parts.append((name, value))
        elif isinstance(value, ModuleType) and value.__name__.startswith(__package__):
            parts.append((name, _compiled_in(vars(value))))
        elif hasattr(value, "source_stamp"):
            parts.append((name, value.source_stamp))
    return parts


def is_first_run() -> bool:
    """True when machine code has yet to be made, which takes about a minute: worth a word to who waits."""
    if not COMPILED or os.environ.get("NUMBA_CACHE_DIR"):
        return False
    folder = os.path.join(os.path.dirname(__file__), "__pycache__")
    return not (os.path.isdir(folder) and any(name.endswith(".nbi") for name in os.listdir(folder)))
