"""Parameters of the strapdown navigator and its Kalman filter."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameter_schema import param


@dataclass(frozen=True)
class NavigatorParameters:
    """Parameters of the strapdown navigator and its Kalman filter."""

    covariance_period: float = param(0.02, "s", "Time between covariance steps", 0.001, 1.0)
