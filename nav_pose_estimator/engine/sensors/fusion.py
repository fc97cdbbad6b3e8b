"""Measurement updates of the navigator's filter: by any sensor, with any number of rows and any noise model.

Observations that their sensor expects take a compiled short cut with identical results (``engine.sensors.routine``).
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.core.filter import bias_noise
from nav_pose_estimator.core.filter.blocks import GNSS_ERROR
from nav_pose_estimator.core.filter.error_state import inject
from nav_pose_estimator.core.filter.kalman import ACCEPTED, correct, gated_correct
from nav_pose_estimator.core.filter.layout import ALT, DPOS, DVEL, LAT, LON, PHI, VEL
from nav_pose_estimator.core.filter.vertical_channel import gated_height
from nav_pose_estimator.engine.observation import Decision, FilterView, Observation, Use
from nav_pose_estimator.engine.sensors.sensor import Linearised, Sensor

_RESET_VELOCITY_SD = (0.3, 0.3, 0.5)  # m/s: standard deviation of a velocity after a reset, ENU
# Bounds of variances that ``_widen`` enlarges: beyond 10 deg the linear error model fails, beyond 100 m/s and 10 km
# nothing is known.
_LARGEST_TILT_VAR = math.radians(10.0) ** 2
_LARGEST_VELOCITY_VAR, _LARGEST_POSITION_VAR = 100.0**2, 1e4**2
_MOTION = (DPOS, DPOS + 1, DPOS + 2, DVEL, DVEL + 1)
Gates = list[tuple[float, float]]
"""(soft, hard) bounds of the normalised innovation squared for 1, 2, 3 ... rows."""


class Fusion:
    """Applies observations: their sensor decides, the filter is updated, and sensor and noise model are notified."""

    def __init__(self, sensors: Iterable[Sensor], gates: Gates) -> None:
        self._sensors = {sensor.kind.name: sensor for sensor in sensors}
        self.gates = gates

    def apply(self, o: Observation, f: FilterView) -> None:
        """Apply ``o`` to a filter that is at its time, with its covariance up to date."""
        sensor = self._sensors[o.kind.name]
        first = o.decision is None
        if o.decision is None:
            o.decision = sensor.decide(o, f)
        if o.decision.use is Use.WIDENING:
            self._lose(sensor, o, o.decision, f)
            return
        if o.decision.widening != 1.0:
            _widen(f.P, o.decision.widening)
        if o.decision.use not in (Use.LEFT_OUT, Use.DOUBTED):
            self._correct(sensor, o, o.decision, f, first)
        elif sensor.noise.learns:
            z, H, stated = sensor.linearise(o, f)
            sensor.noise_ahead_of(o).note(o.t, z, None, H @ f.P @ H.T, stated)
        if any(o.decision.least_sd):
            horizontal, vertical, speed = o.decision.least_sd
            for state, sd in zip(_MOTION, (horizontal, horizontal, vertical, speed, speed), strict=True):
                if sd > 0.0:
                    f.P[state, state] = max(f.P[state, state], sd**2)
        sensor.settle(o, f)

    def _lose(self, sensor: Sensor, o: Observation, decision: Decision, f: FilterView) -> None:
        """Enlarge the covariance and move the position; the evidence may correct the filter once more."""
        f.P[:] *= decision.reference * bias_noise.overstatement(f.nav)
        error = np.zeros(len(f.P))
        error[DPOS : DPOS + 2] = -np.array(decision.shift)
        inject(f.nav, f.constants, error)
        _widen(f.P, decision.widening)
        if decision.once_more:
            correct(*f, *sensor.linearise(o, f))

    def _correct(self, sensor: Sensor, o: Observation, decision: Decision, f: FilterView, first: bool) -> None:
        z, H, R = sensor.linearise(o, f)
        stated, HPH = R, R
        if sensor.noise.learns:
            HPH = H @ f.P @ H.T
            R = sensor.noise_ahead_of(o).covariance(z, HPH, stated)
        status, nis = ACCEPTED, math.nan
        if decision.use is Use.RESET:
            _reset(f, z, R, decision.velocity)
        elif decision.use is Use.UNGATED:
            correct(*f, z, H, R)
        else:
            status, nis = self._behind_the_gate(sensor, f, (z, H, R))
        if first:
            sensor.note(o, f, z, status, nis)
        if sensor.noise.learns:
            residual = sensor.linearise(o, f)[0] if status else None
            sensor.noise.note(o.t, z, residual, HPH, stated)

    def _behind_the_gate(self, sensor: Sensor, f: FilterView, observation: Linearised) -> tuple[int, float]:
        z, H, R = observation
        soft, hard = self.gates[len(z) - 1]
        if sensor.vertical_only:
            return gated_height(*f, float(z[0]), float(R[0, 0]), soft, hard)
        return gated_correct(*f, z, H, R, soft, soft if sensor.all_or_nothing else hard)


def _widen(P: np.ndarray, factor: float) -> None:
    """Multiply the covariance of attitude, velocity and position by ``factor``, within bounds for repeated use.

    The covariance of the biases is unchanged.
    """
    for start, most in ((PHI, _LARGEST_TILT_VAR), (DVEL, _LARGEST_VELOCITY_VAR), (DPOS, _LARGEST_POSITION_VAR)):
        states = slice(start, start + 3)
        factors = np.sqrt(np.clip(most / P.diagonal()[states], 1.0, factor))
        P[states, :] *= factors[:, None]
        P[:, states] *= factors


def _reset(f: FilterView, z: np.ndarray, R: np.ndarray, velocity: tuple[float, ...]) -> None:
    """Set position (and velocity where known) to the fix, with its noise as covariance and no correlations."""
    nav, P, _ = f
    r_m, r_n = radii(nav[LAT])
    nav[LON] -= z[0] / ((r_n + nav[ALT]) * math.cos(nav[LAT]))
    nav[LAT] -= z[1] / (r_m + nav[ALT])
    if len(z) == 3:
        nav[ALT] -= z[2]
    _decorrelate(P, DPOS, np.asarray(R))
    if GNSS_ERROR.is_in(f.constants):
        _tie_to_lasting_error(f, len(z))
    for axis, value in enumerate(velocity):
        if math.isfinite(value):
            nav[VEL + axis] = value
            _decorrelate(P, DVEL + axis, np.array([[_RESET_VELOCITY_SD[axis] ** 2]]))


def _tie_to_lasting_error(f: FilterView, rows: int) -> None:
    """After a reset to a fix less its estimated correlated error, the position has the error of that estimate."""
    own, first = slice(DPOS, DPOS + rows), GNSS_ERROR.states(f.constants).start
    R, error = f.P[own, own].copy(), slice(first, first + rows)
    f.P[own, :] = f.P[error, :]
    f.P[:, own] = f.P[:, error]
    f.P[own, own] += R


def _decorrelate(P: np.ndarray, start: int, R: np.ndarray) -> None:
    end = start + len(R)
    P[start:end, :] = 0.0
    P[:, start:end] = 0.0
    P[start:end, start:end] = R
