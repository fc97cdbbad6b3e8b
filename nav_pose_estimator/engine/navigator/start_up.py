"""Start-up: input and result of the alignment before the filter runs, poses set from outside, warm-up of kernels."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from nav_pose_estimator.core.alignment.aligner import Aligner
from nav_pose_estimator.core.alignment.types import Alignment, AlignmentSettings, FixNoise, KnownBiases
from nav_pose_estimator.core.attitude.compass_swing import CompassSwing
from nav_pose_estimator.core.beams import delay
from nav_pose_estimator.core.beams.judge import BeamJudge
from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla, lla_to_enu
from nav_pose_estimator.core.filter import bias_noise, measurements
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import state_count
from nav_pose_estimator.core.filter.kalman import correct, gated_correct
from nav_pose_estimator.core.filter.strapdown import note_gnss
from nav_pose_estimator.core.filter.vertical_channel import gated_height
from nav_pose_estimator.core.gnss import unfelt_change
from nav_pose_estimator.core.numerics.deep_copy import deep_copy, own_dictionary
from nav_pose_estimator.engine.continuation.warm_start import WarmStart
from nav_pose_estimator.engine.imu import motion_check
from nav_pose_estimator.engine.number_checks import is_covariance, is_within
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import AttitudeSample, GnssFix, SetPose
from nav_pose_estimator.engine.sensors.gnss.innovation_record import beyond_chance
from nav_pose_estimator.engine.sensors.gnss.stated_accuracy import excessive_sd
from nav_pose_estimator.engine.sensors.magnetic import turn_check
from nav_pose_estimator.engine.sensors.magnetometer import level_field
from nav_pose_estimator.engine.sensors.routine import routine

_POSE_FLOOR = np.r_[[0.3**2] * 3, [math.radians(0.5) ** 2] * 3]  # m^2, rad^2: smallest variances of a pose from outside
_FAR = 1e3  # m: a pose further from the navigator is rejected (or 10 standard deviations, whichever is larger)
_FLAT = 1e5  # m: distance from the origin up to which the flat local frame is valid
_FARTHEST = 1e6  # m: a pose beyond this distance is invalid
POSE_REFUSALS = {
    "no_origin": "a pose can be set only while the navigator runs",
    "value": "its position, orientation or covariance is invalid",
    "stamp": "it has no stamp",
    "far": "it is more than a kilometre and ten deviations from where the navigator is",
}
_UNSTATED_TILT_SD = 0.1  # rad: standard deviation of the tilt of an attitude without covariance
_STANDARD_SD = 100.0  # m: standard deviation of a pressure altitude as a height above the ellipsoid (weather, geoid)
_UNKNOWN_HEIGHT_SD = 2000.0  # m: standard deviation of an unknown height
_SAME_EPOCH = 0.05  # s: a fix and a velocity closer than this are of one epoch


class StartUp:
    """The alignment and its inputs: pairs each fix with the velocity of its epoch."""

    def __init__(self, parameters: Parameters, noise: FixNoise, known: KnownBiases | None = None) -> None:
        """``noise``: models of the receiver; ``known``: biases of the IMU from a navigator that has just ended."""
        self.known_biases, self._noise = known, noise
        self._use_mag = parameters.aids.magnetometer
        settings = {name: getattr(parameters.alignment, name) for name in AlignmentSettings.shared()}
        self.aligner = Aligner(
            AlignmentSettings(
                gyro_noise=parameters.imu.gyro_noise,
                accel_noise=parameters.imu.accel_noise,
                declination=parameters.aids.declination,
                lever_arm=parameters.gnss.lever_arm,
                known=known,
                **settings,
            ),
            noise,
        )
        self.warm_start: WarmStart | None = None  # start from a saved state, where there is one
        self._pending_fix: tuple[float, GnssFix, np.ndarray] | None = None
        self._velocities: deque[tuple[float, tuple, np.ndarray]] = deque(maxlen=10)
        self.time = 0.0
        self.standard_height = math.nan  # m: of the last pressure, for a receiver that gives no height

    def __deepcopy__(self, memo: dict) -> StartUp:
        """A copy; it shares a completed aligner, which no longer changes."""
        if self.aligner.is_complete:
            memo[id(self.aligner)] = self.aligner
        twin: StartUp = object.__new__(StartUp)
        twin.__dict__ = deep_copy(own_dictionary(self), memo)
        return twin

    def afresh(self, parameters: Parameters) -> StartUp:
        """A fresh start-up at the same time."""
        twin = StartUp(parameters, self._noise, self.known_biases)
        twin.time, twin.warm_start = self.time, self.warm_start
        return twin

    def imu(self, row: np.ndarray) -> None:
        """Process one IMU row [t, gyro, accel] in body axes."""
        self.time = float(row[at.IMU_T])
        self.aligner.imu(self.time, row[at.IMU_GYRO : at.IMU_ACCEL], row[at.IMU_ACCEL :])
        if self.warm_start is not None:
            self.warm_start.imu(row)

    def mag(self, t: float, field: tuple[float, float, float]) -> None:
        """Add a magnetic field in b [T] at ``t`` [s]."""
        if self._use_mag and all(map(math.isfinite, field)):
            self.aligner.compass.add(t, np.array(field))

    def attitude(self, t: float, sample: AttitudeSample) -> None:
        """Add an attitude of the attitude filter at ``t`` [s], whose tilt improves a levelling in motion."""
        variance = _UNSTATED_TILT_SD**2 if sample.cov_n is None else float(np.max(np.diag(sample.cov_n)[:2]))
        self.aligner.outside.add(t, sample.q_nb, math.sqrt(max(variance, 0.0)))

    def fix(self, t: float, sample: GnssFix, R: np.ndarray) -> None:
        """Add a valid fix at ``t`` [s]; it is passed on with the velocity of its epoch, or alone if there is none."""
        if self._pending_fix is not None:
            self._hand_on(None, None)
        self._pending_fix = (t, sample, R)
        near = self._near(t)
        if near is not None:
            self._hand_on(near[1], near[2])

    def velocity(self, t: float, vel_enu: tuple, R: np.ndarray) -> None:
        """Add a velocity valid at ``t`` [s]."""
        self._velocities.append((t, vel_enu, R))
        if self._pending_fix is not None and abs(self._pending_fix[0] - t) < _SAME_EPOCH:
            self._hand_on(vel_enu, R)

    def result(self) -> Alignment | None:
        """The completed alignment with position, or the warm start from a saved state, or None."""
        result = self.aligner.result()
        if result is not None and result.has_position:
            return result
        return None if self.warm_start is None else self.warm_start.result(self.aligner)

    def contradiction(self, start: Alignment) -> str:
        """Why ``start`` is impossible for the vehicle of the saved state, one clause; empty if it is possible.

        The saved state is dropped with this first result.
        """
        warm, self.warm_start = self.warm_start, None
        if warm is None:
            return ""
        place = tuple(start.nav[at.LAT : at.VEL].tolist())
        return warm.contradiction(start.t, place, math.sqrt(start.P[at.DPOS, at.DPOS]))

    @property
    def has_attitude(self) -> bool:
        """Whether only the position is missing."""
        return self.aligner.result() is not None

    def waiting_for(self, gnss_refusal: str) -> str:
        """What the alignment is waiting for, one sentence for the user."""
        why = self.aligner.waiting_for()
        return f"{why} (GNSS: {gnss_refusal})" if gnss_refusal else why

    def _near(self, t: float) -> tuple[float, tuple, np.ndarray] | None:
        return next((v for v in reversed(self._velocities) if abs(v[0] - t) < _SAME_EPOCH), None)

    def _hand_on(self, vel_enu: tuple | None, velocity_R: np.ndarray | None) -> None:
        if self._pending_fix is None:
            return
        t, fix, R = self._pending_fix
        self._pending_fix = None
        velocity_sd = 0.0 if velocity_R is None else float(math.sqrt(velocity_R[0, 0]))
        height, height_sd = fix.alt, 0.0
        if math.isnan(height):
            known = math.isfinite(self.standard_height)
            height, height_sd = (self.standard_height, _STANDARD_SD) if known else (0.0, _UNKNOWN_HEIGHT_SD)
        position_sd = float(math.sqrt(R[0, 0]))
        self.aligner.gnss(t, fix.lat, fix.lon, height, vel_enu, position_sd, velocity_sd, height_sd)


def is_far(place: Sequence[float], origin: tuple[float, float, float]) -> bool:
    """Whether ``place`` [rad, rad, m] is too far from an origin for its flat local frame."""
    lat, lon, alt = place
    return math.hypot(*lla_to_enu(lat, lon, alt, *origin)[:2]) > _FLAT


def pose_refusal(sample: SetPose, here: np.ndarray | None, sd: float) -> str:
    """Why a pose given from outside is not used, a key of ``POSE_REFUSALS``; empty if it is.

    ``here`` (3,): position of the running navigator in the local frame [m], None if it does not run; ``sd`` [m]: its
    horizontal standard deviation.
    """
    if here is None:
        return "no_origin"
    if sample.stamp_ns <= 0:
        return "stamp"
    norm = math.hypot(*sample.q_nb)
    known = sample.cov is None or is_covariance(sample.cov, 6)
    if not (is_within(sample.position_enu, _FARTHEST) and 0.9 < norm < 1.1 and known):
        return "value"
    return "far" if math.dist(sample.position_enu[:2], here[:2]) > max(_FAR, 10.0 * sd) else ""


def set_pose(nav: np.ndarray, P: np.ndarray, sample: SetPose, origin: tuple[float, float, float]) -> None:
    """Write a pose given from outside to ``nav`` and ``P``; a missing covariance means 1 m and 3 deg.

    The stated standard deviations have floors of 0.3 m and 0.5 deg.
    """
    nav[at.LAT : at.VEL] = [float(x) for x in enu_to_lla(sample.position_enu, *origin)]
    nav[at.QUAT : at.GYRO_BIAS] = np.array(sample.q_nb) / np.linalg.norm(sample.q_nb)
    cov = np.diag([1.0] * 3 + [math.radians(3.0) ** 2] * 3) if sample.cov is None else np.array(sample.cov, float)
    cov[np.diag_indices(6)] = np.maximum(cov.diagonal(), _POSE_FLOOR)
    for start, block in ((at.DPOS, cov[:3, :3]), (at.PHI, cov[3:, 3:])):
        P[start : start + 3, :] = 0.0
        P[:, start : start + 3] = 0.0
        P[start : start + 3, start : start + 3] = block


def warm_up(constants: np.ndarray) -> None:
    """Call once, on harmless numbers, the kernels of observations and checks that the warm-up flight omits."""
    nav = np.zeros(at.NAV_SIZE)
    nav[at.QUAT] = 1.0
    states = state_count(constants)
    P = np.eye(states)
    zero = np.zeros(3)
    for z, H in (
        measurements.gnss_position(nav, states, 0.0, 0.0, 0.0, zero),
        measurements.gnss_velocity(nav, states, zero, zero),
        measurements.body_velocity(nav, states, zero, zero),
        measurements.height(nav, states, 0.0),
        measurements.magnetic_heading(nav, states, 0.0, 1.0, 0.0, 0.0),
        measurements.horizontal_velocity(nav, states, 0.0, 0.0),
        measurements.zero_velocity(nav, states),
        measurements.airspeed(nav, states, 0, 0, 1.0),
        measurements.height_in_water(nav, states, 0, 0.0),
        measurements.beam_velocities(nav, states, (0, -1), np.eye(3), zero, zero, zero, True),
    ):
        R = np.eye(len(z))
        gated_correct(nav, P, constants, z, H, R, 10.0, 100.0)
        correct(nav, P, constants, z, H, R)
    routine.warm_up(constants)
    BeamJudge().judge(z, H, P, np.ones(len(z)), True)  # of the beams, the last of them
    delay.add_delay(np.zeros(4), z, H, nav)
    delay.velocity_change(delay.no_past(), nav, P, 0.0, zero, True, 0)
    delay.velocity_at(nav, zero)
    gated_height(nav, P, constants, 0.0, 1.0, 10.0, 100.0)
    motion_check.warm_up()
    turn_check.warm_up()
    means = np.ones((unfelt_change.SPANS, unfelt_change.COLUMNS))
    unfelt_change.UnfeltChange().find(means)
    unfelt_change.add_second(means, 0, np.ones((2, 4)), np.ones((1, 4)), 0.0, 0.0, 0.0)
    beyond_chance(np.ones((1, 2)))
    excessive_sd(np.ones((1, 2)), 1.0, False)
    field, to_body = level_field(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    CompassSwing(1.0).add(to_body, field, 1.0)
    bias_noise.begin(nav, constants)
    bias_noise.observe(nav, P)
    note_gnss(nav)
    bias_noise.overstatement(nav)
