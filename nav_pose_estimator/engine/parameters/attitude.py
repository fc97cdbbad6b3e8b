"""Parameters of the attitude filters."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameter_schema import param


@dataclass(frozen=True)
class AttitudeParameters:
    """One set for all motions; see docs/attitude.md for where the numbers come from."""

    filter: str = param("complementary", "", "Attitude filter", choices=("complementary", "two_stage"))
    world_frame: str = param("enu", "", "Axes of the published attitude (ned: body FRD)", choices=("enu", "ned"))
    kp: float = param(0.4, "1/s", "Gain of the feedback from the low-passed specific force", 0.001, 10.0)
    tau: float = param(2.1, "s", "Time constant of the earth-frame low-pass of the specific force", 0.0, 60.0)
    reject_from: float = param(0.4, "m/s^2", "The feedback fades from this error of the low-passed norm on", 0.0, 50.0)
    reject_to: float = param(4.0, "m/s^2", "... and is gone at this one", 0.01, 100.0)
    rest_rate: float = param(0.035, "rad/s", "At rest the rate departs less from its mean", 1e-4, 1.0)
    rest_force: float = param(0.5, "m/s^2", "At rest the specific force departs less from its mean", 1e-3, 5.0)
    rest_after: float = param(1.5, "s", "Rest is believed after so long", 0.1, 60.0)
    max_bias: float = param(0.05, "rad/s", "A larger mean rate is motion, not gyroscope bias", 0.0, 1.0)
    initial_bias_sd: float = param(0.01, "rad/s", "Deviation of the gyroscope bias at power-on", 0.0, 1.0)
    accel_sd: float = param(0.3, "m/s^2", "Typical vehicle acceleration left after the low-pass", 1e-3, 10.0)
    mag_tau: float = param(10.0, "s", "Time constant of the heading's correction", 0.1, 1e4)
    mag_norm_sd: float = param(0.05, "", "Deviation of the undisturbed field's norm, relative", 1e-3, 1.0)
    mag_dip_sd: float = param(0.22, "rad", "Deviation of the undisturbed field's dip", 1e-3, 1.6)
    mag_hard_iron: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), "T", "Constant field of the vehicle, subtracted from the magnetometer (sensor axes)", -1.0, 1.0
    )
    mag_soft_iron: tuple[float, ...] = param(
        (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), "", "Matrix on the field, row by row (sensor axes)", -10.0, 10.0
    )
    gravity: float = param(9.81, "m/s^2", "Local gravity", 9.7, 9.9)
