"""Parameters of the attitude filters."""

from dataclasses import dataclass, field

from nav_pose_estimator.engine.parameters.schema import param


@dataclass(frozen=True)
class TwoStageParameters:
    """Parameters of the two-stage filter alone; it shares the others with the complementary filter."""

    wander: float = param(
        0.009, "rad/sqrt(s)", "Random walk of the attitude from gyroscope errors in motion", 1e-6, 1.0
    )
    force_sd: float = param(0.8, "m/s^2", "Deviation of the low-passed force at the start", 1e-3, 10.0)
    shared_windows: float = param(10.0, "", "Feedback windows of the low-passed force that share their noise", 1.0, 1e4)
    regulator_p: float = param(0.05, "", "Proportional gain of the regulator of the force's noise", 0.0, 1.0)
    regulator_i: float = param(0.002, "", "Integral gain of the regulator", 0.0, 1.0)
    regulator_band: float = param(1.0, "", "The integral works below this relative mismatch", 0.0, 100.0)
    heading_noise: float = param(0.1, "rad*sqrt(s)", "Root density of the error of a magnetic heading", 1e-3, 100.0)
    bias_tau_start: float = param(25.0, "s", "Time constant of the gyroscope bias in motion at first", 1.0, 1e4)
    bias_tau: float = param(1000.0, "s", "Time constant of the gyroscope bias in motion later", 1.0, 1e5)
    correction: str = param(
        "projected", "", "literal zeroes components of the quaternion", choices=("projected", "literal")
    )


@dataclass(frozen=True)
class AttitudeParameters:
    """One set of parameters for all motions; docs/attitude.md names the data that it was chosen on."""

    filter: str = param("complementary", "", "Attitude filter", choices=("complementary", "two_stage"))
    world_frame: str = param("enu", "", "Axes of the published attitude (ned: body FRD)", choices=("enu", "ned"))
    feedback_period: float = param(
        0.05, "s", "Time between feedbacks of specific force and field", 0.005, 1.0, mutable=True
    )
    gravity: float = param(9.81, "m/s^2", "Local gravity", 9.7, 9.9, mutable=True)
    # --- the gyroscope ---
    wander: float = param(
        0.0026,
        "rad/sqrt(s)",
        "Random walk of the attitude from gyroscope noise, vibration included",
        1e-6,
        0.1,
        mutable=True,
    )
    turn_noise: float = param(
        0.0007,
        "sqrt(s)",
        "Random walk of the attitude from gyroscope errors that grow with the rate, per rad/s",
        0.0,
        0.1,
        mutable=True,
    )
    initial_bias_sd: float = param(0.01, "rad/s", "Deviation of the gyroscope bias at power-on", 0.0, 1.0)
    bias_walk: float = param(3e-5, "rad/s/sqrt(s)", "Random walk of the gyroscope bias", 0.0, 0.01, mutable=True)
    scale_sd: float = param(0.0035, "", "Deviation of the gyroscope's scale factors", 0.0, 0.1, mutable=True)
    misalignment_sd: float = param(0.002, "", "Deviation of the gyroscope's misalignments", 0.0, 0.1, mutable=True)
    matrix_walk: float = param(
        5e-5, "1/sqrt(s)", "Random walk of scale factors and misalignments", 0.0, 0.01, mutable=True
    )
    timing_sd: float = param(
        0.0025, "s", "Unknown delay of the IMU; enters the covariance only", 0.0, 0.1, mutable=True
    )
    # --- the specific force ---
    initial_tilt_sd: float = param(0.15, "rad", "Deviation of the tilt from the first sample alone", 1e-3, 1.0)
    motion_floor: float = param(
        0.17, "m/s*sqrt(s)", "Lower bound of the root density of the vehicle's sway", 1e-3, 100.0, mutable=True
    )
    motion_tau: float = param(
        1.0, "s", "How long a sway lasts: density of the sway per variance, halved", 0.0, 60.0, mutable=True
    )
    sway_noise: float = param(
        0.02, "m/s/sqrt(s)", "Random walk of the sway from accelerometer noise", 0.0, 10.0, mutable=True
    )
    sway_tilt: float = param(
        0.008, "rad/(m/s)", "Tilt per lasting sway, from lasting acceleration; covariance only", 0.0, 1.0, mutable=True
    )
    reject_from: float = param(
        0.4, "m/s^2", "p(a) falls below 1 at this error of the low-passed norm", 0.0, 50.0, mutable=True
    )
    reject_to: float = param(4.0, "m/s^2", "p(a) reaches its minimum at this error", 0.01, 100.0, mutable=True)
    # --- rest ---
    still_rate: float = param(0.035, "rad/s", "At rest the rate stays this close to its mean", 1e-4, 1.0, mutable=True)
    still_force: float = param(
        0.5, "m/s^2", "At rest the specific force stays this close to its mean", 1e-3, 5.0, mutable=True
    )
    still_norm: float = param(
        0.3, "m/s^2", "At rest the magnitude of the specific force is this close to gravity", 1e-3, 5.0, mutable=True
    )
    learn_after: float = param(
        1.5, "s", "After this long at rest the mean rate is the gyroscope bias", 0.1, 60.0, mutable=True
    )
    max_bias: float = param(0.05, "rad/s", "A larger mean rate is motion, not gyroscope bias", 0.0, 1.0, mutable=True)
    # --- the magnetometer ---
    heading_noise: float = param(
        0.14, "rad*sqrt(s)", "Root density of the error of a magnetic heading", 1e-3, 100.0, mutable=True
    )
    compass_deviation: float = param(
        0.05, "rad", "Local error of a magnetic heading; at one place it does not average out", 0.0, 1.0, mutable=True
    )
    anomaly_gain: float = param(
        60.0, "", "Noise per anomaly (squared, relative to the horizontal field)", 0.0, 1e4, mutable=True
    )
    field_tau: float = param(20.0, "s", "Memory of the learned field", 0.1, 1e4, mutable=True)
    new_field_after: float = param(
        15.0, "s", "A steady new field is accepted after this long at the latest", 1.0, 1e4, mutable=True
    )
    hard_iron: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), "T", "Constant field of the vehicle, subtracted (sensor axes)", -1.0, 1.0
    )
    soft_iron: tuple[float, ...] = param(
        (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        "",
        "Matrix applied to the field, row by row (sensor axes)",
        -10.0,
        10.0,
    )
    two_stage: TwoStageParameters = field(default_factory=TwoStageParameters)
