"""Ways through an outage by name: parameter overrides of the estimator, or a predictor that needs no filter."""

from collections.abc import Mapping
from typing import Any

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import flatten, update
from nav_pose_estimator.errors import UserError

BEST = "best"
COAST = "coast"
HOLD, CONST_VELOCITY = "hold", "const_velocity"
PREDICTORS = (HOLD, CONST_VELOCITY)
"""Methods that go on from the state of ``coast`` at the start of the outage."""
CLASSICAL = (COAST, HOLD, CONST_VELOCITY, "velocity_prior", "drag")
"""The rivals that a learned method has to beat."""
METHOD_PARAMETER = "learner.method"
LEARNED = ("velocity_prior", "drag", "anfis", "anfis_linear", "cnn_lstm")

OVERRIDES: dict[str, Mapping[str, Any]] = {
    COAST: {"learner.enabled": False},
    **{name: {"learner.enabled": True, METHOD_PARAMETER: name} for name in (*LEARNED, BEST)},
}


def available() -> list[str]:
    """Names of the methods that this version can run."""
    known = flatten(Parameters())
    return [*PREDICTORS, *(name for name, values in OVERRIDES.items() if _fits(known, values))]


def check(names: list[str], allow_predictors: bool = True) -> list[str]:
    """``names`` without repetition. Raises ``UserError`` for one that does not exist, listing what there is."""
    usable = [name for name in available() if allow_predictors or name not in PREDICTORS]
    for name in names:
        if name not in usable:
            what = "is not available in this version" if name in (*OVERRIDES, *PREDICTORS) else "does not exist"
            raise UserError(f"the method {name!r} {what}; there is {', '.join(sorted(usable))}")
    return list(dict.fromkeys(names))


def apply(parameters: Parameters, name: str) -> Parameters:
    """``parameters`` with the overrides of method ``name``."""
    check([name], allow_predictors=False)
    return update(parameters, OVERRIDES[name])


def _fits(known: Mapping[str, Any], values: Mapping[str, Any]) -> bool:
    if not all(key in known for key in values):
        return False
    try:
        update(Parameters(), values)
    except UserError:
        return False
    return True
