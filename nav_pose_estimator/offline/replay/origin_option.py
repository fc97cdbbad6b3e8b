"""Option ``--origin LAT,LON,HEIGHT``: the fixed origin of a replay."""

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.errors import UserError


def with_origin(parameters: Parameters, text: str) -> Parameters:
    """``parameters`` with the origin in ``text``; ``UserError`` for an invalid one."""
    try:
        latitude, longitude, height = map(float, text.split(","))
    except ValueError:
        raise UserError(f"--origin {text}: three numbers are needed, latitude,longitude,height") from None
    values = {"origin.latitude": latitude, "origin.longitude": longitude, "origin.height": height}
    changed: Parameters = update(parameters, values)
    if changed.origin.place() is None:
        raise UserError(f"--origin {text} is no latitude, longitude and height")
    return changed
