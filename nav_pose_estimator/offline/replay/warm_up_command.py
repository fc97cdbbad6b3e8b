"""Command ``warm_up``: compiles all kernels, instead of at the first start of a node or a replay."""

import argparse
import compileall
import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import CodeType


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add no options."""
    parser.description = (
        "Compile the numeric kernels, which takes a minute or two, and keep them beside the package. Nodes and replays "
        "then start in seconds. What is left of earlier versions of the package is removed. To be repeated after an "
        "update of NumPy or numba; `make setup` and `colcon build` do it."
    )


def run(arguments: argparse.Namespace) -> int:
    """Compile the parts in parallel, then the whole estimator, and print the progress."""
    import nav_pose_estimator
    from nav_pose_estimator.core.numerics.jit import COMPILED

    folder = Path(nav_pose_estimator.__file__).parent
    compileall.compile_dir(str(folder), quiet=2)
    if removed := remove_stale(folder):
        print(f"{removed} files of earlier kernels removed")
    if not COMPILED:
        print("there is no compiler (numba): kernels run as plain Python")
        return 0
    began, count = time.monotonic(), len(_PARTS) + 1
    with ProcessPoolExecutor(_processes(), multiprocessing.get_context("spawn")) as pool:
        under_way = [(name, pool.submit(_compile, name)) for name in _PARTS]
        for number, (name, done) in enumerate(under_way, 1):
            print(f"[{number}/{count}] {name} ...", end=" ", flush=True)
            print(f"{done.result():.0f} s", flush=True)
        print(f"[{count}/{count}] {WHOLE} ...", end=" ", flush=True)
        print(f"{pool.submit(_compile, WHOLE).result():.0f} s", flush=True)
    print(f"every kernel is compiled ({time.monotonic() - began:.0f} s)", file=sys.stderr)
    return 0


def remove_stale(folder: Path) -> int:
    """Delete numba's cache files below ``folder`` of functions that no longer exist; return their number.

    A file is named after module, function and first line of the function: ``seconds._apart-101.py312.nbi``.
    """
    kept: dict[Path, set[str]] = {}
    removed = 0
    for path in sorted(folder.rglob("__pycache__/*.nb[ic]")):
        source = path.parents[1] / f"{path.name.partition('.')[0]}.py"
        if source not in kept:
            kept[source] = _functions_of(source) if source.is_file() else set()
        if path.name.partition(".py3")[0] not in kept[source]:
            path.unlink(missing_ok=True)
            removed += 1
    return removed


def _functions_of(source: Path) -> set[str]:
    """Module, name and first line of every function in a file, in the format of the names of numba's cache files."""
    module = compile(source.read_bytes(), str(source), "exec", dont_inherit=True)
    found = [code for code in module.co_consts if isinstance(code, CodeType)]
    return {f"{source.stem}.{code.co_qualname}-{code.co_firstlineno}" for code in found}


def _processes() -> int:
    """Number of processes: that of the cores, limited by the available memory."""
    if sys.platform != "linux":
        return 1
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return max(1, min(len(os.sched_getaffinity(0)), len(_PARTS), memory // _MEMORY))


def _compile(name: str) -> float:
    """Compile or load one part in this process; return the time [s] that it took."""
    began = time.monotonic()
    {**_PARTS, WHOLE: _whole}[name]()
    return time.monotonic() - began


def _attitude_filters() -> None:
    from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
    from nav_pose_estimator.engine.attitude.filters import KERNELS
    from nav_pose_estimator.engine.parameters import Parameters
    from nav_pose_estimator.engine.parameters.schema import update

    for name in KERNELS:
        AttitudeEngine(update(Parameters(), {"attitude.filter": name})).warm_up()


def _navigator() -> None:
    from nav_pose_estimator.engine.navigator.sins import SinsEngine

    SinsEngine().warm_up()


def _outage_methods() -> None:
    from nav_pose_estimator.engine.outage.methods.registry import estimators

    for method in estimators().values():
        method.warm_up()


def _whole() -> None:
    """Compile what is still missing, such as after simultaneous writes to the same cache index."""
    import numpy as np

    from nav_pose_estimator.core.numerics.decimal_text import decimal_rows
    from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator

    _attitude_filters()
    _outage_methods()
    PoseEstimator().warm_up()
    decimal_rows(np.zeros((1, 1)), (1,), ",")  # the files of a replay


_PARTS: dict[str, Callable[[], object]] = {
    "attitude filters": _attitude_filters,
    "navigator": _navigator,
    "outage methods": _outage_methods,
}
WHOLE = "the whole estimator"
_MEMORY = 3 << 29
"""Memory [bytes] that is reserved for each process; the compiler needs about half of it."""
