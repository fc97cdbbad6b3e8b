"""Does the IMU tell the motion that GNSS velocity tells? The evidence of a flight for the usual mistakes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from nav_pose_estimator.core.alignment import motion_history
from nav_pose_estimator.core.alignment.body_motion import BodyMotion
from nav_pose_estimator.core.alignment.motion_history import DEGREE
from nav_pose_estimator.engine.imu.agreement import MotionAgreement
from nav_pose_estimator.engine.imu.heading_monitor import HeadingMonitor
from nav_pose_estimator.engine.imu.latency_monitor import SHIFTS, LatencyMonitor
from nav_pose_estimator.engine.imu.plausibility import Finding, G
from nav_pose_estimator.engine.samples import Vector3

_GRAVITY = np.array([0.0, 0.0, G])  # m/s^2
_NOW = np.zeros(1)  # s
_WINDOW = 6  # s that are compared at a time ...
_EVERY = 3  # s
_LAG = 2  # s: by then the velocities of a window have arrived
_ONE_PLACE = 2.0  # m within which the fixes of a receiver that stands still scatter
_VELOCITY_GAP = 1.2  # s: between velocities further apart the change is not known
_SUSPICIOUS = 0.05  # misfit from which on it is asked whether a mistake explains it; recorded flights: median 0.02-0.09
_MEMORY = 0.93  # of the evidence, from one window to the next
_BETTER, _EVIDENCE = 0.35, 0.06
"""A mistake has to leave so little of the squared misfit, and to explain so much of it.

On sixteen recorded flights, with 0 and 0.2 s of ``gnss.delay``, at most 0.03 was explained by a mistake that left 0.4.
"""
_WINS, _WIN = 2.7, 0.01
"""... and to win three windows in a row: a blow is in two of them."""
_EXCITED, _FELT = 0.06, 0.5
"""Share of the force that is horizontal, and the misfit in parts of that, with which an IMU feels what GNSS tells."""
_UNREAL = 0.6  # of the force is horizontal for seconds: velocities in another unit
_CALM = 10  # windows in a row without misfit that end a wrong unit, which shows in every window of a flight
_ALIKE, _ALIKE_FLOOR = 1.3, 0.004  # mistakes that explain nearly as much cannot be told apart


class MotionCheck:
    """Squared misfits of the IMU as it is and of every mistake, with a fading memory. Not for the air only.

    On sixteen recorded flights the IMU as it is left 0.02 to 0.09 of the force unexplained (median), 0.30 at most; with
    the gyroscope in deg/s it is 0.3 to 0.9, and an inverted sign shows as soon as the vehicle turns and brakes.
    """

    def __init__(self) -> None:
        turns = motion_history.axis_rotations()
        self._gyros = np.concatenate([k * turns for k in (1.0, -1.0, DEGREE, -DEGREE)] + [turns[:1] / DEGREE])
        self._sums = np.zeros(2 * len(self._gyros))
        self._wins = np.zeros(len(self._sums))
        self._offset, self._least_motion = np.zeros(3), math.inf  # rad/s: rates of the calmest second, their unrest
        self._blamed: int | None = None
        self._calm = 0
        self.finding: Finding | None = None
        self.misfit = math.nan
        self.felt = False
        """Whether the IMU has lately felt the changes of velocity that GNSS reports."""
        self.felt_as_received = 0.0
        """By how much the squared misfit of velocities as received is below that of the corrected ones."""
        self.heading = HeadingMonitor()
        self.agreement = MotionAgreement()
        self.shakes = False
        """Whether the IMU vibrates so heavily that its impulses say little of the motion."""
        self.latency = LatencyMonitor()
        self.body = BodyMotion()
        """Whether a velocity in body axes is one."""
        self.forget_time()

    def forget_time(self) -> None:
        """The clock is another one: forget samples, keep what they have proved."""
        self._seconds: dict[int, motion_history.Second] = {}
        self._velocities: deque[tuple[float, Vector3]] = deque(maxlen=400)
        self._received: deque[tuple[float, Vector3]] = deque(maxlen=400)
        self._places: deque[tuple[float, float, float]] = deque(maxlen=400)
        self.heading.forget()
        self.agreement.forget_time()
        self.body.forget_time()

    def velocity(self, t: float, used: Vector3 | None, received: Vector3) -> None:
        """GNSS velocity ENU [m/s] valid at ``t`` [s]; one without a vertical component says nothing here.

        ``received``: as it came, where a mistake was undone to use it, or where it is not used (None).
        """
        for known, velocity in ((self._velocities, used), (self._received, received)):
            if velocity is not None and (not known or t > known[-1][0]) and all(map(math.isfinite, velocity)):
                known.append((t, velocity))

    def fix(self, t: float, east: float, north: float) -> None:
        """A position [m] from anywhere, valid at ``t`` [s]: without velocities it can still be seen to stay."""
        if not self._places or t > self._places[-1][0]:
            self._places.append((t, east, north))

    def second(self, k: int, rows: np.ndarray, gyro_bias: np.ndarray) -> None:
        """The IMU rows (N, 7) of the second that ends at ``k``, with one from before it.

        ``gyro_bias`` (3,) [rad/s] as far as the navigator knows it: that of a poor gyroscope is no mistake.
        """
        self._forget_before(k - _WINDOW - _LAG)
        whole = motion_history.second_of(rows, float(k - 1))
        if whole is not None:
            self._seconds[k] = whole
            self.heading.carry(k, whole.without(gyro_bias).angle)
            motion = motion_history.unrest(whole.angle)
            if motion < self._least_motion:
                self._offset, self._least_motion = whole.angle.sum(axis=0), motion
        if k % _EVERY == 0:
            self._compare(k - _LAG, gyro_bias)

    def _forget_before(self, k: int) -> None:
        """Drop what no window from the second that begins at ``k`` on looks at."""
        self._seconds.pop(k, None)
        for known in (self._velocities, self._received):
            while known and known[0][0] <= k - _VELOCITY_GAP:
                known.popleft()

    def _compare(self, end: int, gyro_bias: np.ndarray) -> None:
        seconds = [self._seconds.get(k) for k in range(end - _WINDOW + 1, end + 1)]
        forces, received = (_first(_forces(end, known)) for known in (self._velocities, self._received))
        known = [one for one in seconds if one is not None]
        if len(known) < _WINDOW:
            return
        self.body.compare(end - _WINDOW, [one.without(gyro_bias) for one in known], self._received)
        felt = self._feel(known, received, gyro_bias)
        if forces is None:
            if received is None and not self.shakes and self._stays(end):
                self.agreement.compare(self._as_they_are(known, gyro_bias), np.tile(_GRAVITY, (_WINDOW, 1)))
            return
        is_as_received = received is not None and np.array_equal(forces, received)
        self.misfit = felt if is_as_received else self._own_misfit(known, forces, gyro_bias)
        self.felt_as_received *= _MEMORY
        if received is not None:
            self.felt_as_received += self.misfit**2 - felt**2
        impulses = self._as_they_are(known, gyro_bias)
        self.heading.compare(end - _WINDOW, impulses, forces)
        if not self.shakes:
            self.agreement.compare(impulses, forces)
        if self.agreement.moves:
            self.latency.compare(impulses, _forces(end, self._received, SHIFTS))
        squares = np.full(len(self._sums), self.misfit**2)
        if self.misfit > _SUSPICIOUS or self._blamed is not None:
            all_of_them = motion_history.fit(known, forces, self._gyros)
            squares = np.concatenate([all_of_them.misfit, all_of_them.inverted_misfit]) ** 2
            squares[0] = self.misfit**2
        if self.agreement.only_imu_moves:
            return  # GNSS has told of no motion yet, and so of no mistake in the IMU's
        self._sums = _MEMORY * self._sums + squares
        self._wins = _MEMORY * self._wins + ((squares < _BETTER * squares[0]) & (squares[0] - squares > _WIN))
        self._calm = self._calm + 1 if self.misfit < _SUSPICIOUS else 0
        self._judge()

    def _as_they_are(self, known: list[motion_history.Second], gyro_bias: np.ndarray) -> np.ndarray:
        """Impulses (S, 3) [m/s] of the IMU as it is, in the axes of the window's beginning."""
        return motion_history.impulses([one.without(gyro_bias) for one in known], self._gyros[:1])[0]

    def _stays(self, end: int) -> bool:
        """Whether the fixes of the window, of which there are enough, lie in one place."""
        near = [place for place in self._places if end - _WINDOW <= place[0] <= end]
        if len(near) < _WINDOW or near[-1][0] - near[0][0] < _WINDOW - _VELOCITY_GAP:
            return False
        spread = np.ptp(np.array(near)[:, 1:], axis=0)
        return bool(spread.max() < _ONE_PLACE)

    def _feel(self, known: list[motion_history.Second], received: np.ndarray | None, gyro_bias: np.ndarray) -> float:
        """The misfit of the velocities as they were ``received``, NaN without; notes whether the IMU feels those."""
        if received is None:
            self.felt = False
            return math.nan
        excitation = math.sqrt(float(np.sum(received[:, :2] ** 2) / np.sum(received**2)))
        misfit = self._own_misfit(known, received, gyro_bias)
        self.felt = _EXCITED < excitation < _UNREAL and misfit < _FELT * excitation
        return misfit

    def _own_misfit(self, known: list[motion_history.Second], forces: np.ndarray, gyro_bias: np.ndarray) -> float:
        """Of the IMU as it is, or without one of the biases that its gyroscope may have; the best of them."""
        return motion_history.least_misfit(known, forces, (np.zeros(3), gyro_bias, self._offset), enough=_SUSPICIOUS)

    def _judge(self) -> None:
        sums = self._sums
        if self._blamed is not None:
            blamed, wrong_unit = sums[self._blamed], self._mistake(self._blamed)[1] != 1.0
            proved = sums[0] < _BETTER * blamed and blamed - sums[0] > _EVIDENCE
            if proved or (wrong_unit and self._calm >= _CALM):
                self._blamed, self.finding = None, None
            return
        best = int(np.argmin(sums))
        if self._wins[best] < _WINS or sums[best] > _BETTER * sums[0] or sums[0] - sums[best] < _EVIDENCE:
            return
        alike = np.flatnonzero(sums < _ALIKE * sums[best] + _ALIKE_FLOOR)
        self._blamed = min(alike.tolist(), key=self._unusual)
        text = (
            f"IMU and GNSS velocity contradict each other ({100.0 * self.misfit:.0f} % of the force unexplained): "
            f"{self._in_words(self._blamed)}"
        )
        self.finding = Finding("imu.implausible.motion", text)
        self._sums, self._wins = (
            np.zeros(len(sums)),
            np.zeros(len(sums)),
        )  # from here on it has to prove that it is well

    def _mistake(self, index: int) -> tuple[np.ndarray, float, bool]:
        """Axes (3, 3), scale and sign of the gyroscope, and whether the accelerometer is inverted."""
        inverted, h = divmod(index, len(self._gyros))
        matrix = self._gyros[h]
        size = float(np.abs(matrix).max())
        return matrix / size, size, bool(inverted)

    def _unusual(self, index: int) -> tuple[int, int]:
        """How many things have to be wrong for this mistake."""
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


def _forces(end: float, velocities: Iterable[tuple[float, Vector3]], late: np.ndarray = _NOW) -> np.ndarray | None:
    """(L, S, 3) m/s: what GNSS says of the specific force in each second of the window; None where it says nothing.

    ``late`` (L,) [s]: how much older the velocities are than their stamps.
    """
    ends = end + late
    begins = ends - _WINDOW
    least, most = begins.min() - _VELOCITY_GAP, ends.max() + _VELOCITY_GAP
    table = np.array([(t, *v) for t, v in velocities if least < t < most])
    if len(table) < 3 or not _covers(table[:, 0], begins, ends):
        return None
    times = begins[:, None] + np.arange(_WINDOW + 1.0)
    at_ends = np.stack([np.interp(times, table[:, 0], table[:, axis]) for axis in (1, 2, 3)], axis=-1)
    return at_ends[:, 1:] - at_ends[:, :-1] + _GRAVITY


def _covers(t: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> bool:
    """Whether velocities at ``t`` (N,) [s] tell the change from each of ``begins`` to ``ends`` (L,), without a gap."""
    if t[0] > begins.min() or t[-1] < ends.max():
        return False
    return float(np.diff(t).max()) <= _VELOCITY_GAP


def _first(forces: np.ndarray | None) -> np.ndarray | None:
    return None if forces is None else forces[0]


def _axes(matrix: np.ndarray) -> str:
    """Which published axes are the accelerometer's x, y, z: ``y, -x, z``."""
    return ", ".join(("-" if row.sum() < 0.0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in matrix)


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.array_equal(a, b))
