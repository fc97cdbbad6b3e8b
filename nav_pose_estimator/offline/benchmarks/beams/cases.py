"""Cases of the beams benchmark: vehicles, parameters of their estimators, and goals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.sim import scenarios
from nav_pose_estimator.sim.beam_faults import Stretch
from nav_pose_estimator.sim.doppler import Doppler
from nav_pose_estimator.sim.imu_grades import ImuGrade, imu_grade
from nav_pose_estimator.sim.scenarios import Scenario
from nav_pose_estimator.sim.sensors import Gnss

_DOUBTED = 2.0  # ratio of the filter's noises to those of the simulation


@dataclass(frozen=True)
class Case:
    """A vehicle, for how long it has GNSS [s], its typical speed [m/s] and further parameters of its estimator."""

    name: str
    description: str
    scenario: Scenario
    imu: str
    aided: float
    speed: float
    special: tuple[tuple[str, Any], ...] = ()

    @property
    def grade(self) -> ImuGrade:
        """The IMU's errors."""
        return imu_grade(self.imu)

    @property
    def doppler(self) -> Doppler:
        """The sensor."""
        assert self.scenario.doppler is not None
        return self.scenario.doppler

    def scenario_for(self, length: float, mounting: float) -> Scenario:
        """The scenario with ``length`` [s] after GNSS, the sensor turned by ``mounting`` [rad] about its z axis."""
        turned = replace(self.doppler, misalignment=(0.0, 0.0, mounting))
        return replace(self.scenario, duration=self.aided + length, doppler=turned)

    def stretch(self, length: float) -> Stretch:
        """Interval of the beam faults: all of the time without GNSS."""
        model = self.doppler
        return Stretch(self.aided, length, self.speed, model.noise, model.rate, len(model.directions))

    def parameters(self, change: Parameters | None = None) -> Parameters:
        """Parameters by the data sheets and the nominal mounting of the sensor."""
        model = self.doppler
        values = {
            **_receiver(self.scenario.gnss),
            "aids.beam_velocity_source": "pointcloud2",
            "aids.beams.sd": model.noise,
            "aids.beams.bias_sd": _DOUBTED * model.bias_sd,
            "aids.beams.scale_sd": _DOUBTED * model.scale_sd,
            "aids.beams.lever": model.lever,
            "aids.beams.delay": model.latency,
            "aids.beams.delay_sd": 0.0,
        }
        return update(change or Parameters(), values | dict(self.special))


def _receiver(gnss: Gnss | None) -> dict[str, float]:
    """Parameters of the receiver's errors, with white errors of the same density at low frequencies."""
    assert gnss is not None
    lasting, white = gnss.position_sd[0], gnss.position_noise[0]
    return {
        "gnss.position_sd": math.hypot(lasting, white),
        "gnss.vertical_sd": math.hypot(gnss.position_sd[2], gnss.position_noise[2]),
        "gnss.velocity_sd": gnss.velocity_noise[0],
        "gnss.velocity_vertical_sd": gnss.velocity_noise[2],
        "gnss.position_correlation": 2.0 * gnss.position_tau * lasting**2 / (lasting**2 + white**2),
    }


def _data_sheet(grade: ImuGrade) -> tuple[tuple[str, Any], ...]:
    return (
        ("navigator.gyro_matrix_sd", _DOUBTED * grade.gyro_matrix_sd),
        ("imu.gyro_noise", grade.gyro_noise),
        ("imu.accel_noise", grade.accel_noise),
        ("imu.gyro_bias_sd", grade.gyro_bias_sd),
        ("imu.accel_bias_sd", grade.accel_bias_sd),
        ("imu.gyro_bias_tau", grade.gyro_bias_tau),
        ("imu.accel_bias_tau", grade.accel_bias_tau),
        ("imu.learn_gyro_bias_sd", False),
    )


CASES = {
    case.name: case
    for case in (
        Case(
            "auv",
            "lanes of 200 s at 1.5 m/s, 0.5 deg/h, depth gauge; beams x at 30 deg, 2 Hz, 1 cm/s; 900 s with GNSS",
            replace(scenarios.AUV, magnetometer=None),
            "tactical",
            900.0,
            1.5,
            (*_data_sheet(imu_grade("tactical")), ("aids.water_density", 1025.0)),
        ),
        Case(
            "drone",
            "lanes of 40 s at 4 to 8 m/s, calibrated ICM-42688; beams + at 25 deg, 2.5 Hz, 8 cm/s; 300 s with GNSS",
            scenarios.DRONE,
            "icm42688_calibrated",
            300.0,
            6.0,
            _data_sheet(imu_grade("icm42688_calibrated")),
        ),
    )
}


@dataclass(frozen=True)
class Goal:
    """Limits of the error at the end [% of distance], median and RMS over the seeds, for a fault on a case.

    ``velocity``: of the 3-D velocity's RMS outside total loss [m/s].
    """

    median: float
    rms: float
    velocity: float = math.inf


_SINGLE = ("none", "bias", "small bias", "scale", "noise", "outliers", "two neighbours lost")
USUAL_LENGTH, LONG = 600.0, 3000.0
"""Times without GNSS [s]."""
GOALS: dict[float, dict[tuple[str, str], Goal]] = {
    USUAL_LENGTH: {("auv", fault): Goal(0.07, 0.10) for fault in _SINGLE}
    | {("drone", fault): Goal(0.12, 0.15) for fault in _SINGLE}
    | {
        ("auv", "two opposite lost"): Goal(0.35, 0.50),
        ("auv", "three lost"): Goal(0.35, 0.50),
        ("auv", "all lost"): Goal(0.12, 0.16),
        ("auv", "mixed"): Goal(0.09, 0.13, 0.012),
        ("drone", "all lost"): Goal(0.20, 0.25),
        ("drone", "mixed"): Goal(0.18, 0.25, 0.10),
    },
    LONG: {("auv", fault): Goal(0.035, 0.05) for fault in _SINGLE} | {("auv", "mixed"): Goal(0.05, 0.06)},
}
"""For the method ``full``, by the time without GNSS [s]."""
MOUNTING_GOALS = {"auv": 0.1, "drone": 0.3}
"""Largest error [deg] of the estimated mounting yaw, if the estimator does not know it."""
ALLOWANCE = 1.3
"""Factor on the limits of the error with such a mounting."""
