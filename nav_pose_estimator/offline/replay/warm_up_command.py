"""``warm_up``: compile every kernel now, once for this machine, instead of at the first start of a node or a replay."""

import argparse
import compileall
import sys
import time
from collections.abc import Callable
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """There are no options."""
    parser.description = (
        "Compile the numeric kernels, which takes a minute or two, and keep them beside the package. Nodes and replays "
        "then start in seconds. To be repeated after an update of the package, NumPy or numba; `make setup` does it."
    )


def run(arguments: argparse.Namespace) -> int:
    """Compile part by part, and say how far it is."""
    import nav_pose_estimator
    from nav_pose_estimator.core.numerics.jit import COMPILED

    folder = str(Path(nav_pose_estimator.__file__).parent)
    compileall.compile_dir(folder, quiet=2)
    if not COMPILED:
        print("there is no compiler (numba): kernels run as plain Python")
        return 0
    parts, began = _parts(), time.monotonic()
    for number, (name, compile_it) in enumerate(parts):
        print(f"[{number + 1}/{len(parts)}] {name} ...", end=" ", flush=True)
        before = time.monotonic()
        compile_it()
        print(f"{time.monotonic() - before:.0f} s", flush=True)
    print(f"every kernel is compiled ({time.monotonic() - began:.0f} s)", file=sys.stderr)
    return 0


def _parts() -> list[tuple[str, Callable[[], object]]]:
    """(name, what compiles or loads it), the most basic first: the others build on it."""
    from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
    from nav_pose_estimator.engine.attitude.filters import KERNELS
    from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
    from nav_pose_estimator.engine.navigator.sins import SinsEngine
    from nav_pose_estimator.engine.outage.methods.registry import estimators
    from nav_pose_estimator.engine.parameters import Parameters
    from nav_pose_estimator.engine.parameters.schema import update

    def attitude_filters() -> None:
        for name in KERNELS:
            AttitudeEngine(update(Parameters(), {"attitude.filter": name})).warm_up()

    def outage_methods() -> None:
        for method in estimators().values():
            method.warm_up()

    return [
        ("attitude filters", attitude_filters),
        ("navigator", lambda: SinsEngine().warm_up()),
        ("outage methods", outage_methods),
        ("the whole estimator", lambda: PoseEstimator().warm_up()),
    ]
