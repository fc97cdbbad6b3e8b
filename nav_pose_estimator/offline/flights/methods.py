"""Outage methods by name, for replay and benchmark: those of the estimator, and extrapolations without one."""

from collections.abc import Sequence
from pathlib import Path

from nav_pose_estimator.engine.outage.methods.best import Best
from nav_pose_estimator.engine.outage.methods.coast import Coast
from nav_pose_estimator.engine.outage.methods.registry import all_methods, estimators, extrapolations
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.errors import UserError

BEST, COAST = Best.name, Coast.name
METHOD_PARAMETER, AIRFRAME_PARAMETER, PRIOR_PARAMETER = "learner.method", "learner.airframe", "learner.prior"


def available() -> list[str]:
    """Names of the methods that the benchmark compares."""
    return [method.name for method in all_methods()]


def classical() -> list[str]:
    """Names of the classical methods that a learned method is compared with."""
    return [method.name for method in all_methods() if method.is_classical]


def check(names: Sequence[str], allow_extrapolations: bool = True) -> list[str]:
    """``names`` without repetition. Raises ``UserError``, with the choices, for an unknown name."""
    usable = available() if allow_extrapolations else list(estimators())
    for name in names:
        if name not in usable:
            what = "is only available in benchmark outage" if name in extrapolations() else "does not exist"
            raise UserError(f"the method {name!r} {what}; choose from {', '.join(sorted(usable))}")
    return list(dict.fromkeys(names))


def passes(names: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """Methods to run, each with the extrapolations that start from its state at the loss, which is that of coasting."""
    without = tuple(name for name in names if name in extrapolations())
    flown = [name for name in names if name not in without]
    if without and COAST not in flown:
        flown.append(COAST)
    return [(name, without if name == COAST else ()) for name in flown]


def apply(parameters: Parameters, name: str, airframe: Path | None = None, prior: Path | None = None) -> Parameters:
    """``parameters`` with the method ``name`` and, if given, the files of an airframe and a prior."""
    check([name], allow_extrapolations=False)
    files = {AIRFRAME_PARAMETER: airframe, PRIOR_PARAMETER: prior}
    named = {key: str(path) for key, path in files.items() if path is not None}
    return update(parameters, {"learner.enabled": True, METHOD_PARAMETER: name, **named})
