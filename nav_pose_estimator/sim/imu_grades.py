"""Error models of IMUs, for consumer grades with the errors in flight, including rotor vibration and warm-up.

Noise densities, bias instabilities (Gauss-Markov, standard deviation) and matrix errors are typical in-flight figures
for the ICM-42688-P, BMI088 and MPU-6000, about twice those of the data sheets. Turn-on offsets are the data sheets'
limits, taken as two standard deviations.
"""

import math
from dataclasses import dataclass, replace

from nav_pose_estimator.core.numerics.units import STANDARD_GRAVITY
from nav_pose_estimator.errors import UserError, unknown

DEG = math.radians(1.0)
DEG_PER_HOUR = DEG / 3600.0  # rad/s
MG = 1e-3 * STANDARD_GRAVITY  # m/s^2


@dataclass(frozen=True)
class ImuGrade:
    """Errors of an IMU, per axis: measured = (I + M) true + bias + noise, rounded to the resolution."""

    name: str
    gyro_noise: float = 0.0  # rad/s/sqrt(Hz)
    accel_noise: float = 0.0  # m/s^2/sqrt(Hz)
    gyro_bias_sd: float = 0.0  # rad/s, Gauss-Markov
    gyro_bias_tau: float = 300.0  # s
    accel_bias_sd: float = 0.0  # m/s^2, Gauss-Markov
    accel_bias_tau: float = 300.0  # s
    gyro_turn_on_sd: float = 0.0  # rad/s
    accel_turn_on_sd: float = 0.0  # m/s^2
    gyro_matrix_sd: float = 0.0  # standard deviation of each element of M: scale factors and cross-axis terms
    accel_matrix_sd: float = 0.0
    gyro_resolution: float = 0.0  # rad/s, 0: not rounded
    accel_resolution: float = 0.0  # m/s^2
    gyro_per_kelvin: float = 0.0  # rad/s/K, standard deviation
    accel_per_kelvin: float = 0.0  # m/s^2/K, standard deviation
    warm_up: float = 0.0  # K: rise of the temperature after switching on
    warm_up_tau: float = 120.0  # s


_ICM42688 = ImuGrade(
    "icm42688",
    gyro_noise=0.005 * DEG,
    accel_noise=0.150 * MG,
    gyro_bias_sd=5.0 * DEG_PER_HOUR,
    accel_bias_sd=0.25 * MG,
    gyro_turn_on_sd=0.25 * DEG,
    accel_turn_on_sd=10.0 * MG,
    gyro_matrix_sd=0.002,
    accel_matrix_sd=0.001,
    gyro_resolution=500.0 / 32768.0 * DEG,
    accel_resolution=8000.0 / 32768.0 * MG,
    gyro_per_kelvin=0.005 * DEG,
    accel_per_kelvin=0.15 * MG,
)
_BMI088 = ImuGrade(
    "bmi088",
    gyro_noise=0.014 * DEG,
    accel_noise=0.300 * MG,
    gyro_bias_sd=8.0 * DEG_PER_HOUR,
    accel_bias_sd=0.5 * MG,
    gyro_turn_on_sd=0.5 * DEG,
    accel_turn_on_sd=10.0 * MG,
    gyro_matrix_sd=0.003,
    accel_matrix_sd=0.002,
    gyro_resolution=500.0 / 32768.0 * DEG,
    accel_resolution=6000.0 / 32768.0 * MG,
    gyro_per_kelvin=0.015 * DEG,
    accel_per_kelvin=0.2 * MG,
)
_MPU6000 = ImuGrade(
    "mpu6000",
    gyro_noise=0.010 * DEG,
    accel_noise=0.600 * MG,
    gyro_bias_sd=20.0 * DEG_PER_HOUR,
    gyro_bias_tau=200.0,
    accel_bias_sd=1.0 * MG,
    accel_bias_tau=200.0,
    gyro_turn_on_sd=10.0 * DEG,
    accel_turn_on_sd=25.0 * MG,
    gyro_matrix_sd=0.005,
    accel_matrix_sd=0.003,
    gyro_resolution=500.0 / 32768.0 * DEG,
    accel_resolution=8000.0 / 32768.0 * MG,
    gyro_per_kelvin=0.02 * DEG,
    accel_per_kelvin=0.2 * MG,
)


def calibrated(grade: ImuGrade) -> ImuGrade:
    """The same IMU after calibration, with turn-on offsets of 0.02 deg/s and 2 mg, and a tenth of the matrix errors."""
    return replace(
        grade,
        name=f"{grade.name}_calibrated",
        gyro_turn_on_sd=min(grade.gyro_turn_on_sd, 0.02 * DEG),
        accel_turn_on_sd=min(grade.accel_turn_on_sd, 2.0 * MG),
        gyro_matrix_sd=0.1 * grade.gyro_matrix_sd,
        accel_matrix_sd=0.1 * grade.accel_matrix_sd,
    )


_NAVIGATION = ImuGrade(
    "navigation",
    gyro_noise=0.001 * DEG / 60.0,
    accel_noise=1e-3 * MG,
    gyro_turn_on_sd=0.01 * DEG_PER_HOUR,
    accel_turn_on_sd=1e-2 * MG,
)
"""IMU of a ship's inertial navigation system."""
_TACTICAL = ImuGrade(
    "tactical",
    gyro_noise=0.05 * DEG / 60.0,
    accel_noise=0.02 * MG,
    gyro_bias_sd=0.5 * DEG_PER_HOUR,
    accel_bias_sd=0.1 * MG,
    gyro_bias_tau=1000.0,
    accel_bias_tau=1000.0,
    gyro_turn_on_sd=0.5 * DEG_PER_HOUR,
    accel_turn_on_sd=0.1 * MG,
    gyro_matrix_sd=1e-4,
    accel_matrix_sd=1e-4,
)
"""Fibre-optic IMU of an underwater vehicle: 0.5 deg/h, 0.05 deg/sqrt(h), 0.1 mg."""
PERFECT = ImuGrade("perfect")
_CONSUMER = (_ICM42688, _BMI088, _MPU6000)
IMU_GRADES = {grade.name: grade for grade in (*_CONSUMER, *map(calibrated, _CONSUMER), _TACTICAL, _NAVIGATION, PERFECT)}


def imu_grade(name: str | ImuGrade) -> ImuGrade:
    """The grade of that name; ``UserError`` with the closest name if it does not exist."""
    if isinstance(name, ImuGrade):
        return name
    if name not in IMU_GRADES:
        raise UserError(unknown("IMU grade", name, IMU_GRADES))
    return IMU_GRADES[name]
