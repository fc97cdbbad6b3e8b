"""Options of ``replay`` that change parameters: ``--aid`` and ``--origin``."""

from dataclasses import fields

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.aids import AidParameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, update
from nav_pose_estimator.errors import UserError

NO_AID = "none"


def with_aids(parameters: Parameters, text: str) -> Parameters:
    """``parameters`` with exactly the aids of a comma-separated list enabled; ``none`` for none.

    The aids are the boolean parameters of ``aids``. ``ParameterError`` for an unknown one.
    """
    chosen = [name.strip() for name in text.split(",") if name.strip()]
    known = [item.name for item in fields(AidParameters) if isinstance(item.default, bool)]
    unknown = [name for name in chosen if name not in known and name != NO_AID]
    if unknown or not chosen:
        what = f"there is no aid {unknown[0]!r}" if unknown else "it names no aid"
        raise ParameterError(f"--aid {text}: {what}; choose from {', '.join(known)} or {NO_AID}")
    return update(parameters, {f"aids.{name}": name in chosen for name in known})


def with_origin(parameters: Parameters, text: str) -> Parameters:
    """``parameters`` with the fixed origin ``LAT,LON,HEIGHT``; ``UserError`` for an invalid one."""
    try:
        latitude, longitude, height = map(float, text.split(","))
    except ValueError:
        raise UserError(f"--origin {text}: three numbers are needed, latitude,longitude,height") from None
    values = {"origin.latitude": latitude, "origin.longitude": longitude, "origin.height": height}
    changed: Parameters = update(parameters, values)
    if changed.origin.place() is None:
        raise UserError(f"--origin {text} is no latitude, longitude and height")
    return changed
