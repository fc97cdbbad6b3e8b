"""Parameters of the start-up alignment."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameter_schema import param


@dataclass(frozen=True)
class AlignmentParameters:
    """Parameters of the start-up alignment."""

    static_window: float = param(2.0, "s", "Length of the rest window that levels the filter", 0.5, 60.0)
