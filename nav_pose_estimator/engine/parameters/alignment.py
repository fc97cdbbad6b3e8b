"""Parameters of the start-up alignment."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameters.schema import param


@dataclass(frozen=True)
class AlignmentParameters:
    """Thresholds of the rest detection, and the accuracy of level and heading that a start requires."""

    static_window: float = param(2.0, "s", "Length of the rest window that levels the filter", 0.5, 60.0)
    rest_gyro_sd: float = param(
        0.02, "rad/s", "Spread of the angular rate above which the vehicle is not at rest", 1e-5, 1.0
    )
    rest_accel_sd: float = param(
        0.35, "m/s^2", "Spread of the force above which the vehicle is not at rest", 1e-4, 10.0
    )
    rest_rate: float = param(
        0.62,
        "rad/s",
        "Mean angular rate above which the vehicle is not at rest; a gyroscope's turn-on bias is smaller",
        1e-4,
        1.0,
    )
    rest_speed: float = param(1.0, "m/s", "GNSS speed above which the vehicle is not at rest", 0.05, 10.0)
    gyro_bias_sd: float = param(0.02, "rad/s", "Deviation of the gyroscope bias before anything is known", 1e-5, 1.0)
    accel_bias_sd: float = param(
        0.25, "m/s^2", "Deviation of the accelerometer bias before anything is known", 1e-4, 5.0
    )
    tilt_sd: float = param(0.2, "rad", "Deviation of the tilt when levelled in motion", 0.01, 1.0)
    hypotheses: int = param(12, "", "Heading hypotheses that are tested in motion", 4, 72)
    heading_sd: float = param(0.17, "rad", "Largest deviation of the heading that is good enough to start", 0.01, 1.0)
    min_time: float = param(3.0, "s", "Time with GNSS before the heading hypotheses may decide", 0.5, 60.0)
    mag_heading_sd: float = param(0.35, "rad", "Deviation of a magnetic heading at the start", 0.01, 2.0)
    mag_trust: float = param(0.8, "", "Probability that a plausible magnetometer is as good as that", 0.0, 0.999)
