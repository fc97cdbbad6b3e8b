"""Parameters of the attitude filters."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameter_schema import param


@dataclass(frozen=True)
class AttitudeParameters:
    """Parameters of the attitude filters."""

    filter: str = param("complementary", "", "Attitude filter", choices=("complementary", "two_stage"))
