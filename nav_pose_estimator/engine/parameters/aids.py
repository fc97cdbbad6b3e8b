"""Parameters of the aids besides GNSS."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameter_schema import param


@dataclass(frozen=True)
class AidParameters:
    """Parameters of the aids besides GNSS."""

    magnetometer: bool = param(True, "", "Use the magnetometer for heading")
