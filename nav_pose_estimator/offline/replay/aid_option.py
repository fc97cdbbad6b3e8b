"""Option ``--aid``: the aids besides IMU and GNSS that a run uses."""

from dataclasses import fields

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.aids import AidParameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, update

NONE = "none"


def aid_names() -> list[str]:
    """Names of the aids that can be switched, which are the boolean parameters of ``aids``."""
    return [item.name for item in fields(AidParameters) if isinstance(item.default, bool)]


def with_aids(parameters: Parameters, text: str) -> Parameters:
    """``parameters`` with exactly the aids of a comma-separated list enabled; ``none`` for none."""
    chosen = [name.strip() for name in text.split(",") if name.strip()]
    known = aid_names()
    unknown = [name for name in chosen if name not in known and name != NONE]
    if unknown or not chosen:
        what = f"there is no aid {unknown[0]!r}" if unknown else "it names no aid"
        raise ParameterError(f"--aid {text}: {what}; choose from {', '.join(known)} or {NONE}")
    return update(parameters, {f"aids.{name}": name in chosen for name in known})
