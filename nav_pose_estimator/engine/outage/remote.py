"""The learner for a navigator in another process: odometry in, predicted drift out.

Navigation solutions are reassembled from odometry, biases, origin and IMU. What the topics do not carry is stated
conservatively: the standard deviation of the accelerometer bias is its steady-state value, and cross-covariances
between groups of states are zero, except those of position and attitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla
from nav_pose_estimator.core.filter.layout import BASE_STATES, D_ACCEL_BIAS, D_GYRO_BIAS, DPOS, DVEL, PHI
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.imu.input import ImuInput
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.outage.learner import OutageLearner
from nav_pose_estimator.engine.outage.methods.method import Guide, TrainingResult
from nav_pose_estimator.engine.outage.pilot import OutagePilot, Train
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuSample, Vector3
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavSolution, PredictedDrift, Status


@dataclass(frozen=True, slots=True)
class OdometrySample:
    """A nav_msgs/Odometry: position in odom [m], attitude, velocity [m/s] and angular rate [rad/s] in b; covariances
    (6, 6) in the order of the message."""

    stamp_ns: int
    position: Vector3
    q_nb: tuple[float, float, float, float]
    velocity_b: Vector3
    rate_b: Vector3
    pose_cov: np.ndarray
    twist_cov: np.ndarray


class NavigatorWatch:
    """Collects the topics of a navigator and forms a solution for each odometry, once all inputs are known."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.origin: tuple[float, float, float] | None = None
        self.gyro_bias: np.ndarray | None = None
        self.accel_bias: np.ndarray | None = None
        self.denied = True  # until the navigator says that GNSS aids it
        self.reset()

    def reset(self) -> None:
        """Forget the stream of samples, but keep origin and biases."""
        self._door = ImuInput(self._parameters.imu)
        self._forces: list[Vector3] = []
        self._last_ns = 0

    @property
    def waiting_for(self) -> str:
        """The topic that is still missing; empty when none is."""
        missing = (
            ("the origin of the navigator", self.origin is None),
            ("the navigator's biases", self.gyro_bias is None or self.accel_bias is None),
            ("odometry/filtered", self._last_ns == 0),
        )
        return next((name for name, is_missing in missing if is_missing), "")

    def imu(self, sample: ImuSample) -> list[Event]:
        """Keep a specific force until the next odometry."""
        events: list[Event] = []
        for item in self._door.accept(sample):
            if isinstance(item, Event):
                events.append(item)
            else:
                self._forces.append(item.accel)
        return events

    def odometry(self, sample: OdometrySample) -> NavSolution | None:
        """The solution at ``sample``; None while an input is missing, or for a stamp that is not newer.

        Its specific force is the mean since the last odometry, as of an integrating accelerometer.
        """
        is_newer, self._last_ns = sample.stamp_ns > self._last_ns, max(sample.stamp_ns, self._last_ns)
        forces, self._forces = self._forces, []
        if not (is_newer and forces) or self.origin is None or self.gyro_bias is None or self.accel_bias is None:
            return None
        q_nb, position = np.array(sample.q_nb), np.array(sample.position)
        C_nb = quat_to_matrix(q_nb)
        lat, lon, alt = (float(x) for x in enu_to_lla(position, *self.origin))
        return NavSolution.of(
            stamp_ns=sample.stamp_ns,
            mode=Mode.DEAD_RECKONING if self.denied else Mode.AIDED,
            lat=lat,
            lon=lon,
            alt=alt,
            vel_n=C_nb @ np.array(sample.velocity_b),
            q_nb=q_nb,
            rate_b=np.array(sample.rate_b),
            force_b=np.mean(forces, axis=0) - self.accel_bias,
            gyro_bias=self.gyro_bias.copy(),
            accel_bias=self.accel_bias.copy(),
            cov=self._covariance(sample, C_nb),
            position_enu=position,
            correction_enu=np.zeros(3),
            reset_count=0,
        )

    def _covariance(self, sample: OdometrySample, C_nb: np.ndarray) -> np.ndarray:
        P, pose, twist = np.zeros((BASE_STATES, BASE_STATES)), sample.pose_cov, sample.twist_cov
        P[DPOS : DPOS + 3, DPOS : DPOS + 3] = pose[:3, :3]
        P[PHI : PHI + 3, PHI : PHI + 3] = pose[3:, 3:]
        P[DPOS : DPOS + 3, PHI : PHI + 3] = -pose[:3, 3:]
        P[PHI : PHI + 3, DPOS : DPOS + 3] = -pose[3:, :3]
        P[DVEL : DVEL + 3, DVEL : DVEL + 3] = C_nb @ twist[:3, :3] @ C_nb.T
        P[D_GYRO_BIAS : D_GYRO_BIAS + 3, D_GYRO_BIAS : D_GYRO_BIAS + 3] = twist[3:, 3:]
        accel = slice(D_ACCEL_BIAS, D_ACCEL_BIAS + 3)
        P[accel, accel] = self._parameters.imu.accel_bias_sd**2 * np.eye(3)
        return P


class RemoteLearner:
    """Learns from the solutions that another node publishes, and predicts its drift in outages."""

    def __init__(self, parameters: Parameters, train: Train | None = None) -> None:
        """``train`` runs training jobs, whose results come back through ``accept``."""
        self.watch = NavigatorWatch(parameters)
        self._pilot = OutagePilot(parameters.learner, train)

    def feed(self, sample: ImuSample | OdometrySample) -> list[PredictedDrift | Event]:
        """Take a sample; returns predicted drift and events."""
        if isinstance(sample, ImuSample):
            return list(self.watch.imu(sample))
        solution = self.watch.odometry(sample)
        finished = None if solution is None else self._pilot.collect(solution)
        if solution is None or finished is None:
            return []
        self._pilot.learn(finished)
        if solution.mode not in DENIED:
            return []
        drift = self._pilot.advise(solution.stamp_ns, self._choose).drift
        if self._pilot.state.guide is None:
            return [Event(solution.stamp_ns, "outage.no_model")]
        return [] if drift is None else [drift]

    def _choose(self) -> Guide | None:
        """The model alone: the navigator itself combines its prediction with other knowledge of the motion."""
        flight = self._pilot.flight()
        return None if flight is None else self.learner.method.model_alone(flight)

    def accept(self, result: TrainingResult) -> None:
        """Take the result of a training."""
        self._pilot.accept(result)

    @property
    def learner(self) -> OutageLearner:
        """The learner, which holds the model."""
        return self._pilot.learner

    @property
    def mode(self) -> Mode:
        """WAITING_IMU without a navigator, ALIGNING while there is no model, AIDED with one."""
        if self.watch.waiting_for:
            return Mode.WAITING_IMU
        return Mode.ALIGNING if self.learner.state.model is None else Mode.AIDED

    def status(self) -> Status:
        """Why the model is not used (``waiting_for``) and its scores (``values``)."""
        missing, learned = self.watch.waiting_for, self.learner.state
        reason = learned.reason if learned.model is None else ""
        return Status(
            stamp_ns=0,
            mode=self.mode,
            waiting_for=f"waiting for {missing}" if missing else reason,
            seconds_coasting=0.0,
            horizontal_sd=np.nan,
            horizontal_sd_in_30_s=np.nan,
            gnss_refusal="",
            satellites=None,
            counters={},
            values=self.learner.scores(),
        )

    def reset(self, stamp_ns: int, reason: str) -> list[Event]:
        """Forget the flight; the model stays until the next training replaces it."""
        self.watch.reset()
        self._pilot.reset()
        return [Event(stamp_ns, "outage.reset", Level.WARN, f"the learner restarts: {reason}")]

    def warm_up(self) -> None:
        """Nothing: the training process compiles the network, and this one finds it in the cache on disk."""

    def set_parameters(self, parameters: Parameters) -> None:
        """Nothing: no parameter of the learner is mutable in flight."""
