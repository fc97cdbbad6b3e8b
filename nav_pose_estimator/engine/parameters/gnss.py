"""Parameters of GNSS: latency, antenna, gate, re-acquisition."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameter_schema import param


@dataclass(frozen=True)
class GnssParameters:
    """Parameters of GNSS: latency, antenna, gate, re-acquisition."""

    delay: float = param(0.0, "s", "Stamp minus time of validity of a fix", -1.0, 1.0)
