"""Decorators of numeric kernels: machine code where numba is installed, plain Python elsewhere, from one source.

A kernel is written with scalars and explicit loops over small arrays. That is what numba compiles best, and plain
Python runs it faster than numpy calls on 3-vectors.
"""

import hashlib
import os
import sys
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

_hides_coverage = "coverage" not in sys.modules
if _hides_coverage:  # where it is installed, numba imports it for its own tests, which takes 30 ms and 4 MB
    sys.modules["coverage"] = None  # type: ignore[assignment]
try:
    import numba
except ImportError:
    numba = None  # type: ignore[assignment]
finally:
    if _hides_coverage:
        del sys.modules["coverage"]

_PACKAGE = __name__.partition(".")[0]  # kernels of all sub-packages may be compiled into each other
_FOLDER = os.path.dirname(sys.modules[_PACKAGE].__file__ or "")
COMPILED: bool = numba is not None and os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")
"""True when kernels run as machine code in this process."""
_LEAN_VERSIONS = (0, 61), (0, 68)
"""Oldest and newest numba in which the functions that ``kernel_cache`` replaces are the same, word for word."""

if COMPILED and _LEAN_VERSIONS[0] <= numba.version_info.short <= _LEAN_VERSIONS[1]:
    from nav_pose_estimator.core.numerics.kernel_cache import KernelCache
else:
    KernelCache = None  # type: ignore[assignment,misc]


def kernel(function):
    """Compile ``function`` with numba (cached on disk, float64, no fast-math); without numba return it unchanged."""
    return _compile(function)


def inlined(function):
    """Compile ``function`` as a kernel that is inlined into every kernel that calls it.

    A call between compiled functions costs tens of nanoseconds for the reference counts of its arrays alone, more than
    the arithmetic of a small kernel.
    """
    return _compile(function, forceinline=True)


def _compile(function, **options):
    if not COMPILED:
        return function
    options = {"error_model": "numpy", "no_cfunc_wrapper": True, **options}  # kernels are never called from C
    compiled = numba.njit(**options)(function)
    if KernelCache is None:
        compiled.enable_caching()
    else:
        compiled._cache = KernelCache(function)
    if not _tie_cache_to_sources(compiled):
        compiled = numba.njit(**options)(function)
    _ignore_literal_types(compiled)
    return compiled


def _ignore_literal_types(compiled) -> None:
    """Compile a kernel once for all values of a constant argument; numba would specialise it for each literal.

    An ``inlined`` kernel still benefits from constants, because it is optimised inside its caller.
    """
    for_types = compiled.get_call_template

    def for_plain_types(args, kws):
        plain = numba.types.unliteral
        return for_types([plain(arg) for arg in args], {name: plain(arg) for name, arg in kws.items()})

    compiled.get_call_template = for_plain_types


def _tie_cache_to_sources(compiled) -> bool:
    """Invalidate the cached machine code of a kernel when anything that was compiled into it has changed.

    Numba itself checks only the size and time of the kernel's file. Constants and kernels of other files are compiled
    in as well: with a stale cache, a changed state layout would be read at the old indices. So are numba's versions of
    NumPy functions, whose types depend on the installed NumPy. Returns False when this version of numba keeps its cache
    in another way; the kernel is then compiled without a cache.
    """
    function = compiled.py_func
    text, others = _text_of(function.__code__.co_filename), _compiled_in(function.__globals__)
    parts = (np.__version__, function.__module__, text, others)
    try:
        compiled.source_stamp = hashlib.sha256(repr(parts).encode()).hexdigest()
        compiled._cache._cache_file._source_stamp = compiled.source_stamp
    except AttributeError:
        return False
    return True


@cache
def _text_of(path: str) -> str:
    """Digest of a source file's text (not its time, so that a copied or touched file keeps its cache)."""
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def _compiled_in(names: dict[str, Any]) -> list[Any]:
    """Globals that kernels may have compiled in: numbers, tuples, kernels, and those of modules of this package."""
    parts: list[Any] = []
    for name, value in sorted(names.items()):
        if isinstance(value, int | float | tuple):
            parts.append((name, value))
        elif isinstance(value, ModuleType) and value.__name__.partition(".")[0] == _PACKAGE:
            parts.append((name, _compiled_in(vars(value))))
        elif hasattr(value, "source_stamp"):
            parts.append((name, value.source_stamp))
    return parts


def is_first_run() -> bool:
    """True when no kernel has been compiled yet: that takes about a minute, and the user should be told."""
    if not COMPILED or os.environ.get("NUMBA_CACHE_DIR"):
        return False
    return not any(name.endswith(".nbi") for _, _, names in os.walk(_FOLDER) for name in names)
