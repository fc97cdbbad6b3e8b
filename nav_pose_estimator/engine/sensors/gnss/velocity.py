"""GNSS velocity as an observation of the filter."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import bias_noise, measurements
from nav_pose_estimator.core.filter.strapdown import note_gnss
from nav_pose_estimator.core.gnss.doubt import Doubt
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import GATED, LEFT_OUT, Decision, FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssVelocity, Vector3
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.gnss.innovation_record import InnovationRecord
from nav_pose_estimator.engine.sensors.gnss.reception import GnssReception
from nav_pose_estimator.engine.sensors.gnss.stated_accuracy import StatedAccuracy
from nav_pose_estimator.engine.sensors.sensor import Linearised, Sensor
from nav_pose_estimator.engine.solutions import Level

_SAME_MOTION = 1.0  # s: largest age of a velocity that is compared at a fix; the IMU gives the change over that time
_REFUSALS = (1.0, 0.0, 0.5)
"""Degree of rejection of a velocity, by the statuses of ``kalman.gated_correct``."""


class Misfit(NamedTuple):
    """Difference of the receiver's last velocity from the navigator's, after its update."""

    t: float  # s
    difference: list[float]  # (2,) or (3,) m/s: navigator minus receiver
    R: np.ndarray
    velocity: Vector3  # m/s, ENU


class GnssVelocitySensor(Sensor):
    """Two or three rows: East, North, and Up where it is measured. It is used only while fixes are."""

    kind = Kind("gnss_velocity", precedence=0, whole=True)  # before the fix of its epoch, which is tested with it

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal, reception: GnssReception) -> None:
        super().__init__(parameters, aiding, journal)
        self.reception = reception
        self.record = InnovationRecord()
        self._accuracy = StatedAccuracy("velocity")
        self.misfit: Misfit | None = None
        self._is_refused = False
        self.doubt = Doubt()

    @classmethod
    def noise_model(cls, parameters: Parameters) -> str:
        """The model of ``gnss.noise``."""
        return parameters.gnss.noise

    def set_parameters(self, parameters: Parameters) -> None:
        """Take a new lever arm."""
        self.lever = np.array(parameters.gnss.lever_arm)

    def observe(self, sample: GnssVelocity, t: float) -> Observation:
        """The observation of a velocity valid at ``t`` [s] that has passed the reception."""
        R = self.reception.velocity_noise(sample, in_filter=True)
        return Observation(t, sample.stamp_ns, self.kind, sample.vel_enu, R)

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """Gate it while fixes are used; a velocity alone does not end an outage."""
        if self._aiding.gnss_is_good(o.t):
            return GATED
        self._journal.count("gnss.rejected.velocity_without_position")
        self._remember(o, f)
        return LEFT_OUT

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """Two or three rows: velocity of the antenna."""
        assert o.stated_R is not None
        z, H = measurements.gnss_velocity(f.nav, len(f.P), np.array(o.measured), self.lever)
        measurements.see_gnss_error(z, H, f.nav, f.constants, measurements.VELOCITY)
        rows = rows_of(o)
        return z[:rows], H[:rows], o.stated_R[:rows, :rows]

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Count it; only the first of consecutive rejections is an event. ``refusal`` is about positions."""
        self._compare(o, float(z[0]), float(z[1]))
        self.record.add(nis, z, self.reception.fix_period, accepted=status != 0)
        self.doubt.velocity(o.t, _REFUSALS[status], nis / len(z), z.tolist())
        if status:
            if status == 2:
                self._journal.count("gnss.inflated.velocity")
            self._is_refused = False
            self._journal.count("gnss.used.velocity")
        elif self._is_refused:
            self._journal.count("gnss.rejected.velocity_innovation")
        else:
            text = "GNSS velocity not used: it disagrees with the filter"
            self._journal.say(o.stamp_ns, "gnss.rejected.velocity_innovation", Level.INFO, text)
            self._is_refused = True
        self._remember(o, f)

    def agrees(self, o: Observation, nis: float, z: list[float], left: list[float], period: float) -> None:
        """Same as ``note`` for an ``o`` that was used unchanged; ``left``: its residual, ``z``: its innovation."""
        assert o.stated_R is not None
        rows = rows_of(o)
        self._compare(o, z[0], z[1])
        self.record.add(nis, z[:rows], period)
        self.doubt.velocity(o.t, 0.0, nis / rows, z[:rows])
        self._is_refused = False
        self._journal.count("gnss.used.velocity")
        R = self._accuracy.lasting(o, o.stated_R[:rows, :rows], self.noise, self._journal)
        self.misfit = Misfit(o.t, left[:rows], R, o.measured)

    def misfit_at(self, t: float) -> Misfit | None:
        """``misfit`` where it is recent enough for a fix at ``t`` [s] and not mostly noise, else None."""
        last = None if self.reception.velocity_scatter.is_on else self.misfit
        return last if last is not None and 0.0 <= t - last.t <= _SAME_MOTION else None

    def _compare(self, o: Observation, east: float, north: float) -> None:
        """Compare the innovation with the residual of the velocity before it."""
        last = self.misfit
        if last is None or self.noise.learns:  # adaptive noise models estimate such noise themselves
            return
        assert o.stated_R is not None
        scatter = self.reception.velocity_scatter
        stated = max(o.stated_R[0, 0], o.stated_R[1, 1]) - scatter.sd**2
        stated = math.sqrt(max(stated, self.reception.least_velocity_sd**2))  # the noise may be newer than R
        before = last.difference
        scatter.change(o.t - last.t, east - before[0], north - before[1], stated)

    def _remember(self, o: Observation, f: FilterView) -> None:
        z, _, R = self.linearise(o, f)
        R = self._accuracy.lasting(o, R, self.noise, self._journal)
        self.misfit = Misfit(o.t, z.tolist(), R, o.measured)

    def settle(self, o: Observation, f: FilterView) -> None:
        """Identify the gyroscope bias's noise, and keep the velocity, while GNSS is good."""
        if self._aiding.gnss_is_good(o.t):
            bias_noise.observe(f.nav, f.P)
            note_gnss(f.nav)


def rows_of(o: Observation) -> int:
    """Number of rows: three where the vertical velocity is measured, else two."""
    return 3 if math.isfinite(o.measured[2]) else 2
