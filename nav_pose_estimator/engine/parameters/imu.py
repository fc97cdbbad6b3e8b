"""Parameters of the inertial sensors."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameters.schema import param


@dataclass(frozen=True)
class ImuParameters:
    """Mounting and noise of the IMU; noise as in flight, with vibration about twice that of the data sheet."""

    mounting_rpy: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), "rad", "Roll, pitch, yaw of the sensor in the body frame (fixed axes x, y, z)", -3.2, 3.2
    )
    convention: str = param("flu", "", "Axes of the sensor as published", choices=("flu", "frd"))
    sampling: str = param(
        "mean",
        "",
        "mean: values are means over the interval that ends at the stamp; point: instantaneous values",
        choices=("mean", "point"),
    )
    accel_bias: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), "m/s^2", "Bias of the accelerometer as published, subtracted first (calibrate)", -5.0, 5.0
    )
    accel_scale: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), "", "Scale errors s of its axes: published = (1 + s) true + bias (calibrate)", -0.3, 0.3
    )
    gyro_noise: float = param(5.0e-4, "rad/s/sqrt(Hz)", "Gyroscope noise density in flight", 1e-7, 0.1, mutable=True)
    accel_noise: float = param(
        0.02, "m/s^2/sqrt(Hz)", "Accelerometer noise density in flight", 1e-6, 10.0, mutable=True
    )
    gyro_bias_sd: float = param(4.0e-3, "rad/s", "Steady-state deviation of the gyroscope bias", 0.0, 0.1, mutable=True)
    learn_gyro_bias_sd: bool = param(
        True, "", "Learn in flight how much the gyroscope bias wanders: a quarter to twice gyro_bias_sd"
    )
    learn_noise: bool = param(
        True, "", "Identify in flight how noisy IMU and GNSS are: one to four times the noise that is set"
    )
    gyro_bias_tau: float = param(3000.0, "s", "Correlation time of the gyroscope bias", 1.0, 1e6)
    accel_bias_sd: float = param(
        0.03, "m/s^2", "Steady-state deviation of the accelerometer bias", 0.0, 1.0, mutable=True
    )
    accel_bias_tau: float = param(300.0, "s", "Correlation time of the accelerometer bias", 1.0, 1e6)
    gap: float = param(0.06, "s", "A longer interval between samples counts as missing data", 0.001, 10.0)
    max_gap: float = param(1.0, "s", "After a longer gap the navigator continues from its last state", 0.05, 60.0)
    max_rate: float = param(70.0, "rad/s", "A larger angular rate is rejected as invalid", 1.0, 1000.0)
    max_force: float = param(400.0, "m/s^2", "A larger specific force is rejected as invalid", 20.0, 10000.0)
    stuck_time: float = param(
        0.5, "s", "A sensor that repeats one value exactly for this long counts as stuck", 0.05, 60.0
    )
