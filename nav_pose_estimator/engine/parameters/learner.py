"""Parameters of the outage learning."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameter_schema import param


@dataclass(frozen=True)
class LearnerParameters:
    """What helps the navigator through an outage."""

    enabled: bool = param(True, "", "Learn from the flight while GNSS is good and help the navigator without it")
    method: str = param(
        "best",
        "",
        "coast: nothing; velocity_prior: the vehicle moves as it has moved; best: that and the place it flies at",
        choices=("coast", "velocity_prior", "best"),
    )
    slow_speed: float = param(
        5.0, "m/s", "A vehicle that is slower than this for a tenth of its flight can hover", 0.0, 50.0
    )
    habit_share: float = param(
        0.3,
        "",
        "How much of the last two minutes' mean square speed is expected of a vehicle that hovers now",
        0.0,
        1.0,
    )
    velocity_prior_weight: float = param(6.0, "", "Factor on the variance of the velocity prior", 0.1, 100.0)
    position_prior_weight: float = param(
        30.0, "", "Factor on the variance of the position prior, once a second", 1.0, 1e4
    )
