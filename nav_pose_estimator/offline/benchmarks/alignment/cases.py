"""Cases of the alignment benchmark: vehicles, and error conditions of their receivers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.sim.imu_grades import ImuGrade, imu_grade
from nav_pose_estimator.sim.scenarios import Scenario, find_scenario
from nav_pose_estimator.sim.sensors import Gnss

_LONG = 1e6  # s: correlation time of a bias that is constant
_TRUSTED = {
    "gnss.position_sd": 0.001,  # low floors, so that the covariances stated by the receiver are used
    "gnss.vertical_sd": 0.001,
    "gnss.velocity_sd": 0.001,
    "gnss.velocity_vertical_sd": 0.001,
    "gnss.position_correlation": 0.0,
    "gnss.gate.hold": 0.0,
    "gnss.gate.max_horizontal_sd": 1000.0,
    "gnss.gate.max_vertical_sd": 1000.0,
    "navigator.gyro_matrix_states": False,
    "imu.learn_gyro_bias_sd": False,
}


@dataclass(frozen=True)
class Case:
    """A vehicle and how it starts.

    The filter starts with a random attitude error of ``misalignment_sd`` [deg] about East, North, Up, or with the error
    ``misalignment`` [deg]; without either the navigator aligns by itself.
    """

    name: str
    description: str
    scenario: str
    imu: str
    misalignment_sd: tuple[float, float, float] | None = None
    misalignment: tuple[float, float, float] | None = None
    velocity_sd: float = 0.1  # m/s, of the start
    lost_after: float = 1.5  # s

    @property
    def grade(self) -> ImuGrade:
        """The IMU's errors."""
        return imu_grade(self.imu)

    def parameters(self, method: str, change: Parameters | None = None) -> Parameters:
        """Parameters of a filter that knows the IMU's errors and uses the noise model ``method``."""
        grade = self.grade
        values = {
            "gnss.noise": method,
            "navigator.lost_after": self.lost_after,
            "imu.gyro_noise": grade.gyro_noise,
            "imu.accel_noise": grade.accel_noise,
            "imu.gyro_bias_sd": grade.gyro_bias_sd,
            "imu.accel_bias_sd": grade.accel_bias_sd,
            "imu.gyro_bias_tau": grade.gyro_bias_tau if grade.gyro_bias_sd else _LONG,
            "imu.accel_bias_tau": grade.accel_bias_tau if grade.accel_bias_sd else _LONG,
        }
        return update(change or Parameters(), _TRUSTED | values)

    def scenario_for(self, condition: str) -> Scenario:
        """The scenario with the receiver of ``condition``."""
        scenario = find_scenario(self.scenario)
        assert scenario.gnss is not None, "nothing aligns without GNSS"
        return replace(scenario, gnss=CONDITIONS[condition](scenario.gnss, scenario.duration))


CASES = {
    case.name: case
    for case in (
        Case(
            "ship",
            "sways at its mooring, 10 m at 1 Hz; starts 0.5, 0.5, 5 deg off",
            "ship_mooring",
            "navigation",
            misalignment_sd=(1.0, 1.0, 6.0),
            misalignment=(0.5, 0.5, 5.0),
            lost_after=5.0,
        ),
        Case(
            "drone",
            "manoeuvres in the air, 1.5 m and 0.15 m/s at 5 Hz; starts 1, 1, 5 deg off (deviation)",
            "alignment_in_air",
            "icm42688_calibrated",
            misalignment_sd=(1.0, 1.0, 5.0),
        ),
        Case("air", "the same, aligned by the navigator itself", "alignment_in_air", "icm42688_calibrated"),
        Case(
            "ground",
            "stands 30 s in wind, aligned by the navigator itself",
            "alignment_on_ground",
            "icm42688_calibrated",
        ),
    )
}


def _correlated(gnss: Gnss, duration: float) -> Gnss:
    """Receiver whose whole position error is correlated over 30 s, with the same stated covariances."""
    sd = gnss.position_noise
    return replace(gnss, position_sd=sd, position_noise=(0.0, 0.0, 0.0), position_tau=30.0)


CONDITIONS: dict[str, Callable[[Gnss, float], Gnss]] = {
    "white": lambda gnss, duration: gnss,
    "x10 for 30 s": lambda gnss, duration: replace(gnss, worse=((0.25 * duration, 30.0, 10.0),)),
    "x10 for a fifth": lambda gnss, duration: replace(gnss, worse=((0.25 * duration, 0.2 * duration, 10.0),)),
    "10 % outliers x10": lambda gnss, duration: replace(gnss, outliers=(0.1, 10.0)),
    "x3 from half-way": lambda gnss, duration: replace(gnss, worse=((0.5 * duration, duration, 3.0),)),
    "correlated 30 s": _correlated,
    "states x0.2": lambda gnss, duration: replace(gnss, stated=0.2),
    "states x0.32": lambda gnss, duration: replace(gnss, stated=math.sqrt(0.1)),
    "states x5": lambda gnss, duration: replace(gnss, stated=5.0),
}
"""Error conditions by name: receiver and length of the recording [s] to the receiver with errors."""


def start_deviations(
    misalignment_sd: tuple[float, float, float], velocity_sd: float, grade: ImuGrade, gnss: Gnss
) -> np.ndarray:
    """Deviations (15,) of a start, in the order of the filter's states: [deg] about East, North, Up, then [m/s]."""
    position = np.hypot(gnss.position_sd, gnss.position_noise)
    gyro = math.hypot(grade.gyro_turn_on_sd, grade.gyro_bias_sd, grade.warm_up * grade.gyro_per_kelvin)
    accel = math.hypot(grade.accel_turn_on_sd, grade.accel_bias_sd, grade.warm_up * grade.accel_per_kelvin)
    return np.r_[np.radians(misalignment_sd), [velocity_sd] * 3, position, [gyro] * 3, [accel] * 3]
