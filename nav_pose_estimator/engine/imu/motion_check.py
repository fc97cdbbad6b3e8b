"""Consistency of IMU and GNSS velocity in flight, and the search for the integration mistake that explains a misfit."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from nav_pose_estimator.core.alignment import motion_history
from nav_pose_estimator.core.alignment.body_motion import BodyMotion
from nav_pose_estimator.core.alignment.motion_history import ANGLE, DEGREE
from nav_pose_estimator.core.alignment.velocity_history import GAP, VelocityHistory
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.imu.agreement import MotionAgreement
from nav_pose_estimator.engine.imu.heading_monitor import HeadingMonitor
from nav_pose_estimator.engine.imu.latency_monitor import SHIFTS, LatencyMonitor
from nav_pose_estimator.engine.imu.plausibility import Finding, G
from nav_pose_estimator.engine.samples import Vector3

_AS_PUBLISHED = np.eye(3)
_WINDOW = 6  # s: length of a window
_EVERY = 3  # s from the beginning of one window to the next
_LAG = 2  # s after its end at which a window is evaluated, when its velocities have arrived
_ONE_PLACE = 2.0  # m: scatter of the fixes of a receiver at rest
_SUSPICIOUS = 0.05  # misfit above which mistakes are tested; the median of recorded flights is 0.02 to 0.09
_MEMORY = 0.93  # forgetting factor of the evidence from one window to the next
_BETTER, _EVIDENCE = 0.35, 0.06
"""A mistake must reduce the sum of the squared misfits to less than this fraction, and by at least this amount.

On sixteen recorded flights, with 0 and 0.2 s of ``gnss.delay``, no mistake reduced it by more than 0.03 or to less than
0.4 of it.
"""
_WINS, _WIN = 2.7, 0.01
"""A mistake must win about three consecutive windows (faded count), each by this squared misfit; a shock is in two."""
_WINS_OF_TWO = 1.8
"""The same, about two windows, where the filter's estimate of the gyroscope's scale contradicts its rates as well."""
_WINS_OF_A_SUSPECT = 0.9  # the same, one window, for a mistake that is suspected but not named
_EXCITED, _AGREES = 0.06, 0.5
"""Smallest horizontal fraction of the force, and largest misfit relative to it, with which IMU and GNSS agree."""
_UNREAL = 0.6  # horizontal fraction of the force over a window above which the velocities have a wrong unit
_CALM = 10  # consecutive windows without misfit that end a finding of a wrong unit; it affects all windows
_ALIKE, _ALIKE_FLOOR = 1.3, 0.004  # factor and floor within which two mistakes explain the data equally well


class MotionCheck:
    """Squared misfits of the IMU as it is and of every mistake, with a fading memory; for flight and ground alike.

    On sixteen recorded flights the IMU as it is left 0.02 to 0.09 of the force unexplained (median), 0.30 at most; with
    the gyroscope in deg/s it is 0.3 to 0.9, and an inverted sign shows as soon as the vehicle turns and brakes.
    """

    def __init__(self) -> None:
        turns = motion_history.axis_rotations()
        self._gyros = np.concatenate([k * turns for k in (1.0, -1.0, DEGREE, -DEGREE)] + [turns[:1] / DEGREE])
        self._sums = np.zeros(2 * len(self._gyros))
        self._wins = np.zeros(len(self._sums))
        self._offset, self._least_motion = np.zeros(3), math.inf  # rad/s: rates of the calmest second, their unrest
        self._established: int | None = None
        self._calm = 0
        self.finding: Finding | None = None
        self.suspects = False
        """Whether a mistake has won a window with all the evidence that a finding needs."""
        self.filter_contradicts = False
        """Whether the filter's estimate of the gyroscope's scale contradicts its rates, to be set from outside."""
        self.misfit = math.nan
        self.imu_agrees = False
        """Whether the IMU measured the velocity changes that GNSS reports, in the last window."""
        self.as_received_reduction = 0.0
        """Reduction of the squared misfit by using the velocities as received instead of the corrected ones."""
        self.heading = HeadingMonitor()
        self.agreement = MotionAgreement()
        self.shakes = False
        """Whether the IMU vibrates so heavily that its impulses do not show the motion."""
        self.latency = LatencyMonitor()
        self.body = BodyMotion()
        """The test of a body velocity against the IMU."""
        self.forget_time()

    def forget_time(self) -> None:
        """The clock changed: forget the samples, keep established findings."""
        self._seconds: dict[int, np.ndarray] = {}
        self._velocities, self._received = VelocityHistory(), VelocityHistory()
        self._positions: deque[tuple[float, float, float]] = deque(maxlen=400)
        self.heading.forget()
        self.agreement.forget_time()
        self.latency.forget_time()
        self.body.forget_time()

    def velocity(self, t: float, used: Vector3 | None, received: Vector3) -> None:
        """Add a GNSS velocity ENU [m/s] valid at ``t`` [s]; one without a vertical component is ignored.

        ``used``: as the navigator uses it, None where it does not. ``received``: as the receiver sent it, before a
        mistake in it was corrected.
        """
        if used is not None and math.isfinite(sum(used)):
            self._velocities.add(t, *used)
        if math.isfinite(sum(received)):
            self._received.add(t, *received)

    def angles(self, k: int) -> np.ndarray | None:
        """Integrated rates (BINS, 3) [rad] of the second that ends at ``k``, one of the last eight; None if unknown."""
        second = self._seconds.get(k)
        return None if second is None else second[ANGLE]

    def fix(self, t: float, east: float, north: float) -> None:
        """Add a position [m] in any level frame, valid at ``t`` [s]; it shows rest where velocities are missing."""
        if not self._positions or t > self._positions[-1][0]:
            self._positions.append((t, east, north))

    def second(self, k: int, rows: np.ndarray, gyro_bias: np.ndarray) -> None:
        """Process the IMU rows (N, 7) of the second that ends at ``k``, the first one from before it.

        ``gyro_bias`` (3,) [rad/s] is the navigator's estimate; the large bias of a poor gyroscope is no mistake.
        """
        self._seconds.pop(k - _WINDOW - _LAG, None)
        whole = motion_history.second_of(rows, float(k - 1))
        if whole is not None:
            self._seconds[k] = whole
            self.heading.add_rotation(k, whole[ANGLE], gyro_bias)
            motion = motion_history.unrest(whole[ANGLE])
            if motion < self._least_motion:
                self._offset, self._least_motion = whole[ANGLE].sum(axis=0), motion
        if k % _EVERY == 0:
            self._forget_before(k - _WINDOW - _LAG)
            self._compare(k - _LAG, gyro_bias)

    def _forget_before(self, k: int) -> None:
        """Drop GNSS data that no window from second ``k`` on needs."""
        while self._positions and self._positions[0][0] < k:
            self._positions.popleft()
        self._velocities.forget_before(k - GAP)
        self._received.forget_before(k - GAP)

    def _compare(self, end: int, gyro_bias: np.ndarray) -> None:
        now = np.array([float(end)])
        forces, received = (_first(known.forces(now, _WINDOW, G)) for known in (self._velocities, self._received))
        if not all(k in self._seconds for k in range(end - _WINDOW + 1, end + 1)):
            return
        seconds = np.array([self._seconds[k] for k in range(end - _WINDOW + 1, end + 1)])
        biases = np.array([np.zeros(3), gyro_bias, self._offset])  # candidates for that of the gyroscope
        impulses = motion_history.impulses(seconds, gyro_bias, _AS_PUBLISHED)
        self.body.compare(end - _WINDOW, seconds, gyro_bias, impulses, self._received.rows())
        received_misfit = self._misfit_of_received(seconds, received, biases)
        if forces is None:
            if received is None and not self.shakes and self._rests(end):
                self.agreement.compare(impulses, np.tile([0.0, 0.0, G], (_WINDOW, 1)))
            return
        is_as_received = received is not None and np.array_equal(forces, received)
        self.misfit = received_misfit if is_as_received else _own_misfit(seconds, forces, biases)
        self.as_received_reduction *= _MEMORY
        if received is not None:
            self.as_received_reduction += self.misfit**2 - received_misfit**2
        self.heading.compare(end - _WINDOW, impulses, forces)
        if not self.shakes:
            self.agreement.compare(impulses, forces)
        if self.agreement.moves:
            self.latency.compare(impulses, self._received.forces(end + SHIFTS, _WINDOW, G))
        if self.agreement.only_imu_moves:
            return  # GNSS has reported no motion yet, so a misfit is no evidence of a mistake of the IMU
        self._weigh(seconds, forces)

    def _weigh(self, seconds: np.ndarray, forces: np.ndarray) -> None:
        """Add the evidence of a window for and against every mistake."""
        self._sums, self._wins, own = _MEMORY * self._sums, _MEMORY * self._wins, self.misfit**2
        if self.misfit > _SUSPICIOUS or self._established is not None:
            candidates = motion_history.fit(seconds, forces, self._gyros)
            squares = np.concatenate([candidates.misfit, candidates.inverted_misfit]) ** 2
            squares[0] = own
            self._sums += squares
            self._wins += (squares < _BETTER * own) & (own - squares > _WIN)
        else:
            self._sums += own  # evidence for and against no mistake
        self._calm = self._calm + 1 if self.misfit < _SUSPICIOUS else 0
        self._judge()

    def _rests(self, end: int) -> bool:
        """Whether there are enough fixes in the window and all lie in one place."""
        near = [place for place in self._positions if end - _WINDOW <= place[0] <= end]
        if len(near) < _WINDOW or near[-1][0] - near[0][0] < _WINDOW - GAP:
            return False
        spread = np.ptp(np.array(near)[:, 1:], axis=0)
        return bool(spread.max() < _ONE_PLACE)

    def _misfit_of_received(self, seconds: np.ndarray, received: np.ndarray | None, biases: np.ndarray) -> float:
        """Misfit of the velocities as ``received``, NaN without them; sets ``imu_agrees``."""
        if received is None:
            self.imu_agrees = False
            return math.nan
        excitation = float(motion_history.horizontal_share(received))
        misfit = _own_misfit(seconds, received, biases)
        self.imu_agrees = _EXCITED < excitation < _UNREAL and misfit < _AGREES * excitation
        return misfit

    def _judge(self) -> None:
        sums = self._sums
        if self._established is not None:
            established, wrong_unit = sums[self._established], self._mistake(self._established)[1] != 1.0
            proved = sums[0] < _BETTER * established and established - sums[0] > _EVIDENCE
            if proved or (wrong_unit and self._calm >= _CALM):
                self._established, self.finding = None, None
            return
        best = int(np.argmin(sums))
        gain = sums[0] - sums[best] if sums[best] < _BETTER * sums[0] else 0.0
        needed = _WIN if self.filter_contradicts else _EVIDENCE
        self.suspects = bool(gain > needed and self._wins[best] > _WINS_OF_A_SUSPECT)
        if gain < _EVIDENCE or self._wins[best] < (_WINS_OF_TWO if self.filter_contradicts else _WINS):
            return
        alike = np.flatnonzero(sums < _ALIKE * sums[best] + _ALIKE_FLOOR)
        self._established = min(alike.tolist(), key=self._complexity)
        text = (
            f"IMU and GNSS velocity contradict each other ({100.0 * self.misfit:.0f} % of the force unexplained): "
            f"{self._in_words(self._established)}"
        )
        self.finding = Finding("imu.implausible.motion", text)
        self._sums, self._wins = (
            np.zeros(len(sums)),
            np.zeros(len(sums)),
        )  # the finding ends when new evidence contradicts it

    def _mistake(self, index: int) -> tuple[np.ndarray, float, bool]:
        """A mistake: signed axes (3, 3) and scale of the gyroscope, and whether the accelerometer is inverted."""
        inverted, h = divmod(index, len(self._gyros))
        matrix = self._gyros[h]
        size = float(np.abs(matrix).max())
        return matrix / size, size, bool(inverted)

    def _complexity(self, index: int) -> tuple[int, int]:
        """Number of single errors that this mistake combines: of equal explanations the simplest is chosen."""
        matrix, size, inverted = self._mistake(index)
        plain = _same(np.abs(matrix), np.eye(3))
        flips = min(int((np.diag(matrix) < 0.0).sum()), 1) if plain else 2
        return flips + (size != 1.0) + inverted, index

    def _in_words(self, index: int) -> str:
        matrix, size, inverted = self._mistake(index)
        wrong = []
        if size < 1.0:
            wrong.append("the gyroscope is probably in deg/s instead of rad/s")
        elif size > 1.0:
            wrong.append("the gyroscope's rates are probably converted to rad/s twice")
        if _same(matrix, -np.eye(3)):
            wrong.append("the gyroscope's sign is probably inverted")
        elif not _same(matrix, np.eye(3)):
            wrong.append("gyroscope and accelerometer probably have different axes (gyroscope " + _axes(matrix) + ")")
        if inverted:
            wrong.append("the accelerometer's sign is probably inverted")
        return ", and ".join(wrong)


def _own_misfit(seconds: np.ndarray, forces: np.ndarray, biases: np.ndarray) -> float:
    """Misfit of the IMU as published: the smallest over the candidate gyroscope ``biases`` (K, 3) [rad/s]."""
    return float(motion_history.least_misfit(seconds, forces, biases, _SUSPICIOUS))


def warm_up() -> None:
    """Compile the kernels: two windows of a vehicle that brakes and turns."""
    check, zero = MotionCheck(), np.zeros(3)
    rows = np.zeros((11, at.IMU_COLUMNS))
    rows[:, at.IMU_ACCEL + 2] = G
    for k in range(1, 2 * _WINDOW + 1):
        rows[:, at.IMU_T], rows[:, at.IMU_ACCEL] = k + np.linspace(-1.0, 0.0, len(rows)), 4.0 * math.cos(k)
        check.heading.attitude(k, np.array([1.0, 0.0, 0.0, 0.0]))
        check.velocity(float(k), (4.0 * math.sin(k), 0.0, 0.0), (4.0 * math.sin(k), 0.0, 0.0))
        check.second(k, rows, zero)


def _first(forces: np.ndarray | None) -> np.ndarray | None:
    return None if forces is None else forces[0]


def _axes(matrix: np.ndarray) -> str:
    """The gyroscope's published axes along the accelerometer's x, y, z, as in ``y, -x, z``."""
    return ", ".join(("-" if row.sum() < 0.0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in matrix)


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.array_equal(a, b))
