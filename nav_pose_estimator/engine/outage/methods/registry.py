"""Registry of the outage methods. A new one is a file in this folder and a line here; the rest follows from that."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from nav_pose_estimator.engine.outage.methods.anfis import Anfis
from nav_pose_estimator.engine.outage.methods.anfis_linear import AnfisLinear
from nav_pose_estimator.engine.outage.methods.best import Best
from nav_pose_estimator.engine.outage.methods.cnn_lstm import CnnLstm, Untrained
from nav_pose_estimator.engine.outage.methods.coast import Coast
from nav_pose_estimator.engine.outage.methods.const_velocity import ConstVelocity
from nav_pose_estimator.engine.outage.methods.drag import Drag
from nav_pose_estimator.engine.outage.methods.hold import Hold
from nav_pose_estimator.engine.outage.methods.method import Extrapolation, Method, OutageMethod
from nav_pose_estimator.engine.outage.methods.pseudo_gnss import PseudoGnss
from nav_pose_estimator.engine.outage.methods.velocity_prior import VelocityPrior

_METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Coast(),
        Hold(),
        ConstVelocity(),
        VelocityPrior(),
        Drag(),
        Anfis(),
        AnfisLinear(),
        Best(),
        CnnLstm(),
        Untrained(),
        PseudoGnss(),
    )
}


def all_methods() -> tuple[Method, ...]:
    """Every method, simple ones first."""
    return tuple(_METHODS.values())


def estimators() -> dict[str, OutageMethod]:
    """The methods that ``learner.method`` may select."""
    return {name: method for name, method in _METHODS.items() if isinstance(method, OutageMethod)}


def extrapolations() -> dict[str, Extrapolation]:
    """Methods without a filter, which exist in the benchmark only."""
    return {name: method for name, method in _METHODS.items() if isinstance(method, Extrapolation)}


@contextmanager
def registered(*methods: Method) -> Iterator[None]:
    """Register more methods temporarily, for ablations and tests. Processes spawned meanwhile do not have them."""
    clash = [method.name for method in methods if method.name in _METHODS]
    if clash:
        raise ValueError(f"there is a method {clash[0]!r} already")
    _METHODS.update({method.name: method for method in methods})
    try:
        yield
    finally:
        for method in methods:
            del _METHODS[method.name]
