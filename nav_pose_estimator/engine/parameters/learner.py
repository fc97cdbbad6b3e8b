"""Parameters of the outage learning."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameter_schema import param


@dataclass(frozen=True)
class LearnerParameters:
    """Parameters of the outage learning."""

    enabled: bool = param(True, "", "Train and use the network")
