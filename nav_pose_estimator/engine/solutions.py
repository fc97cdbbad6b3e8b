"""Output of the engines: solutions, events, modes and status."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from nav_pose_estimator.core.attitude import layout as head
from nav_pose_estimator.core.filter import layout as at


class Mode(Enum):
    """Mode of the navigator; the same words in topics, diagnostics, reports and logs."""

    WAITING_IMU = "WAITING_IMU"
    ALIGNING = "ALIGNING"
    NO_ORIGIN = "NO_ORIGIN"
    AIDED = "AIDED"
    COASTING = "COASTING"  # GNSS lost; other aids or learned models still bound the drift
    DEAD_RECKONING = "DEAD_RECKONING"  # on the IMU alone
    EXPIRED = "EXPIRED"  # unaided for longer than the allowed time
    REACQUIRING = "REACQUIRING"  # GNSS is back and being checked


class Level(Enum):
    """Severity of an event."""

    DEBUG = 0
    INFO = 1
    WARN = 2
    ERROR = 3


@dataclass(frozen=True, slots=True)
class Event:
    """An event: ``name`` is its counter on diagnostics (``imu.rejected.nan``), ``text`` one sentence for the user.

    ``text`` is empty for events that are only counted.
    """

    stamp_ns: int
    name: str
    level: Level = Level.DEBUG
    text: str = ""
    data: dict[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class AttitudeSolution:
    """Attitude at one stamp. ``values`` (HEAD_SIZE,) of ``core.attitude.layout``; the properties are views of it.

    To be treated as frozen, like ``NavSolution``.
    """

    stamp_ns: int
    values: np.ndarray

    @property
    def q_nb(self) -> np.ndarray:
        """(4,) scalar first."""
        return self.values[head.QUAT : head.QUAT + 4]

    @property
    def cov_n(self) -> np.ndarray:
        """(3, 3) covariance about n axes, rad^2."""
        return self.values[head.COV : head.COV + 9].reshape(3, 3)

    @property
    def rate_b(self) -> np.ndarray:
        """(3,) bias-corrected angular rate, rad/s."""
        return self.values[head.RATE : head.RATE + 3]

    @property
    def accel_b(self) -> np.ndarray:
        """(3,) specific force, m/s^2."""
        return self.values[head.FORCE : head.FORCE + 3]

    @property
    def gyro_bias(self) -> np.ndarray:
        """(3,) rad/s."""
        return self.values[head.BIAS : head.BIAS + 3]


@dataclass(slots=True)
class NavSolution:
    """Navigation solution at one stamp. ``values`` (SOLUTION_SIZE,) of ``layout``; the properties are views of it.

    Hundreds are created per second and few are read, so nothing is unpacked in advance. To be treated as frozen;
    freezing it would cost a fifth of the navigator's time per sample.
    """

    stamp_ns: int
    mode: Mode
    values: np.ndarray
    correction_enu: np.ndarray  # (3,) m: sum of all position resets, map -> odom
    reset_count: int

    @classmethod
    def of(
        cls,
        stamp_ns: int,
        mode: Mode,
        *,
        correction_enu: np.ndarray,
        reset_count: int = 0,
        **parts: np.ndarray | float,
    ) -> "NavSolution":
        """A solution from its ``parts``, named like the properties; missing ones are zero.

        The variances of its output row are those of ``cov``.
        """
        solution = cls(stamp_ns, mode, np.zeros(at.SOLUTION_SIZE), correction_enu, reset_count)
        for i, name in enumerate(("lat", "lon", "alt")):
            solution.values[at.OUT_POS + i] = parts.pop(name, 0.0)
        for name, value in parts.items():
            getattr(solution, name)[:] = value
        solution.values[at.OUT_VAR : at.OUT_COLUMNS] = np.diag(solution.cov)[: at.OUT_COLUMNS - at.OUT_VAR]
        return solution

    @property
    def lat(self) -> float:
        """Latitude, rad."""
        return float(self.values[at.OUT_POS])

    @property
    def lon(self) -> float:
        """Longitude, rad."""
        return float(self.values[at.OUT_POS + 1])

    @property
    def alt(self) -> float:
        """Height above the ellipsoid, m."""
        return float(self.values[at.OUT_POS + 2])

    @property
    def vel_n(self) -> np.ndarray:
        """(3,) m/s."""
        return self.values[at.OUT_VEL : at.OUT_QUAT]

    @property
    def q_nb(self) -> np.ndarray:
        """(4,) scalar first."""
        return self.values[at.OUT_QUAT : at.OUT_RATE]

    @property
    def rate_b(self) -> np.ndarray:
        """(3,) bias-corrected angular rate, rad/s."""
        return self.values[at.OUT_RATE : at.OUT_FORCE]

    @property
    def force_b(self) -> np.ndarray:
        """(3,) bias-corrected specific force, m/s^2."""
        return self.values[at.OUT_FORCE : at.OUT_VAR]

    @property
    def gyro_bias(self) -> np.ndarray:
        """(3,) rad/s."""
        return self.values[at.SOLUTION_BIASES : at.SOLUTION_BIASES + 3]

    @property
    def accel_bias(self) -> np.ndarray:
        """(3,) m/s^2."""
        return self.values[at.SOLUTION_BIASES + 3 : at.SOLUTION_ENU]

    @property
    def position_enu(self) -> np.ndarray:
        """(3,) m from the origin."""
        return self.values[at.SOLUTION_ENU : at.SOLUTION_COV]

    @property
    def cov(self) -> np.ndarray:
        """(15, 15) covariance of the last covariance step, in the order of ``core.filter.layout``."""
        return self.values[at.SOLUTION_COV :].reshape(at.BASE_STATES, at.BASE_STATES)


@dataclass(slots=True)
class NavBlock:
    """Solutions of consecutive IMU samples: ``stamps_ns`` (N,), ``rows`` (N, OUT_COLUMNS) of ``core.filter.layout``.

    To be treated as frozen, like ``NavSolution``: each correction of the position begins a new one.
    """

    stamps_ns: np.ndarray
    rows: np.ndarray
    mode: Mode
    reset_count: int
    correction_enu: np.ndarray


@dataclass(frozen=True, slots=True)
class PredictedDrift:
    """The network's prediction in an outage: velocity error ENU [m/s], covariance (3, 3), position error so far [m]."""

    stamp_ns: int
    dv_n: tuple[float, float, float]
    cov: np.ndarray
    dp_n: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class AttitudeBlock:
    """Attitudes of consecutive IMU samples: ``stamps_ns`` (N,) and ``rows`` (N, BLOCK_COLUMNS)."""

    stamps_ns: np.ndarray
    rows: np.ndarray

    @property
    def q_nb(self) -> np.ndarray:
        """(N, 4) scalar first."""
        return self.rows[:, head.BLOCK_QUAT : head.BLOCK_QUAT + 4]

    @property
    def tilt_sd(self) -> np.ndarray:
        """(N,) rad."""
        return np.sqrt(self.rows[:, head.BLOCK_TILT_VAR])

    @property
    def yaw_sd(self) -> np.ndarray:
        """(N,) rad."""
        return np.sqrt(self.rows[:, head.BLOCK_YAW_VAR])

    @property
    def gyro_bias(self) -> np.ndarray:
        """(N, 3) rad/s."""
        return self.rows[:, head.BLOCK_BIAS : head.BLOCK_BIAS + 3]


@dataclass(frozen=True, slots=True)
class Status:
    """Status for the operator, with all counters (``imu.rejected.nan`` -> 3)."""

    stamp_ns: int
    mode: Mode
    waiting_for: str  # what is missing, one sentence; empty where nothing is
    seconds_coasting: float
    horizontal_sd: float  # m, now
    horizontal_sd_in_30_s: float  # m, predicted without GNSS
    gnss_refusal: str  # why the last fix was not used, else empty
    satellites: int | None
    counters: dict[str, int]
    values: dict[str, float]  # NIS means, noise factors, delays ...
    doubt: str = ""  # why the solution is less certain than usual, one clause
    held_by: str = ""  # aids other than GNSS that bound the drift


Output = NavSolution | NavBlock | AttitudeSolution | AttitudeBlock | PredictedDrift | Event
