"""Body velocity: velocity over ground in a sensor's own axes (Doppler log, optical flow, wheels)."""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np

from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.layout import DVEL, VEL
from nav_pose_estimator.engine.imu.mounting import rotation_from_rpy
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.number_checks import is_covariance, is_within
from nav_pose_estimator.engine.observation import GATED, LEFT_OUT, Decision, FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import BodyVelocity
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised
from nav_pose_estimator.engine.sensors.velocity_doubt import VelocityDoubt
from nav_pose_estimator.engine.solutions import Level

_LARGEST_SPEED = 1e3  # m/s: a larger component is rejected
_UNPROVEN = 0.5  # deviation of a velocity that no motion has confirmed yet, relative to its possible error
_UNMEASURED = 1e6  # (m/s)^2: variance of an axis that is not measured


class _Measured(NamedTuple):
    velocity: np.ndarray  # (3,) in b, m/s
    lever: np.ndarray  # (3,) sensor from the IMU in b, m
    is_proven: bool  # whether motion has confirmed the sensor when it arrived


class BodyVelocitySensor(Aid):
    """Three rows: velocity in b of the point at the sensor's lever arm, at its time of validity.

    While GNSS is good, it is left out until motion has confirmed it.
    """

    kind = Kind("body_velocity", holds=True)
    sample, family = BodyVelocity, "body_velocity"
    bounds_drift = True
    _reported_fault = ""  # the fault that was reported last
    is_proven = True
    """Whether motion has confirmed the sensor's axes, as far as that can be tested."""
    possible_error = 0.0
    """Possible error of its velocities, relative to the speed, as far as that can be tested."""

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        super().__init__(parameters, aiding, journal)
        self.doubt = VelocityDoubt()
        self._before, self._variance_before = np.zeros(2), 0.0  # horizontal velocity [m/s] before an update

    def take_over(self, before: Self) -> None:
        """Keep the doubt over an IMU gap."""
        self.doubt = before.doubt

    @classmethod
    def noise_model(cls, parameters: Parameters) -> str:
        """The model of ``aids.body_velocity_noise``."""
        return parameters.aids.body_velocity_noise

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise, delay and mounting."""
        aids = parameters.aids
        self._enabled, self._delay, self._floor = aids.body_velocity, aids.body_velocity_delay, aids.body_velocity_sd**2
        self._lever = np.array(aids.body_velocity_lever)
        self._axes = rotation_from_rpy(aids.body_velocity_rpy)

    def observe(self, sample: BodyVelocity, t: float) -> Observation | None:
        """The observation of a velocity with at least one finite axis."""
        if not self._enabled:
            return None
        finite = [value for value in sample.velocity if not math.isnan(value)]
        if not finite or not is_within(finite, _LARGEST_SPEED):
            return self._refuse()
        known = sample.cov is not None and is_covariance(sample.cov, 3)
        if sample.cov is not None and not known:
            self._journal.count("body_velocity.covariance.flawed")
        R = np.array(sample.cov, float) if known else np.diag([self._floor] * 3)
        R[np.diag_indices(3)] = np.maximum(np.diag(R), self._floor)
        for axis in range(3):
            if not math.isfinite(sample.velocity[axis]):
                R[axis, axis] = _UNMEASURED
        velocity = self._axes @ np.nan_to_num(np.array(sample.velocity, float))
        R = self._axes @ R @ self._axes.T
        is_proven = self.is_proven or sample.is_learned
        if not is_proven and not self.noise.learns:
            R[np.diag_indices(3)] += (_UNPROVEN * self.possible_error) ** 2 * float(velocity @ velocity)
        measured = _Measured(velocity, self._lever, is_proven)
        return Observation(self.time_of(t), sample.stamp_ns, self.kind, measured, R)

    def in_body(self, sample: BodyVelocity) -> np.ndarray | None:
        """The velocity (3,) [m/s] of a sample in b; None where an axis is not measured or out of range."""
        if not is_within(sample.velocity, _LARGEST_SPEED):
            return None
        return self._axes @ np.array(sample.velocity, float)

    def time_of(self, t: float) -> float:
        """Time of validity [s] of a velocity stamped ``t`` [s]."""
        return t - self._delay

    def refuse_axes(self, fault: str, stamp_ns: int) -> bool:
        """Reject a velocity that contradicts the IMU. Returns True when a new ``fault`` has been established.

        ``fault``: one clause for the user, empty while no fault is established.
        """
        self._refuse("axes")
        if not fault or fault == self._reported_fault:
            return False
        self._reported_fault = fault
        text = f"body velocity not used: {fault}; set aids.body_velocity_rpy, or the driver right"
        self._journal.say(stamp_ns, "body_velocity.implausible", Level.ERROR, text)
        return True

    def figures(self) -> dict[str, float]:
        """Status: estimated noise variance relative to the stated one."""
        return {"body_velocity.noise.factor": self.noise.factor}

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """Gate it; an unconfirmed velocity is left out while GNSS is good, which needs no help."""
        if not o.measured.is_proven and self._aiding.gnss_is_good(o.t):
            self._journal.count("body_velocity.unproven")
            return LEFT_OUT
        self._before, self._variance_before = f.nav[VEL : VEL + 2].copy(), _horizontal_variance(f)
        return GATED

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Count the outcome, and report the first change of velocity that the IMU did not measure."""
        super().note(o, f, z, status, nis)
        size = math.hypot(*z.tolist())
        if self._aiding.gnss_is_good(o.t):
            self.doubt.learn(size)
            return
        change, removed = f.nav[VEL : VEL + 2] - self._before, self._variance_before - _horizontal_variance(f)
        if self.doubt.update(o.t, change, removed, size, is_refused=not status):
            self._journal.say(o.stamp_ns, "body_velocity.unfelt", Level.WARN, f"{self.reason}; sigma grows")

    @property
    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        jump = self.doubt.jump
        return f"the body velocity changed by {jump:.1f} m/s or more, which the IMU did not feel" if jump else ""

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """Three rows, C^T v + w x l."""
        assert o.stated_R is not None
        return *measurements.body_velocity(f.nav, len(f.P), o.measured.velocity, o.measured.lever), o.stated_R


def _horizontal_variance(f: FilterView) -> float:
    """Sum of the variances [(m/s)^2] of the horizontal velocity."""
    return float(f.P[DVEL, DVEL] + f.P[DVEL + 1, DVEL + 1])
