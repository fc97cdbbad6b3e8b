"""What comes out of an engine: solutions, events, and the words that say how things stand."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np


class Mode(Enum):
    """State of the navigator; the same words in topics, diagnostics, reports and logs."""

    WAITING_IMU = "WAITING_IMU"
    ALIGNING = "ALIGNING"
    NO_ORIGIN = "NO_ORIGIN"
    AIDED = "AIDED"
    COASTING = "COASTING"  # GNSS lost, other aids or learned models still bound the drift
    DEAD_RECKONING = "DEAD_RECKONING"  # nothing but the IMU
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
    """Something that happened: ``name`` is a counter on diagnostics (``imu.rejected.nan``), ``text`` one sentence.

    ``text`` is empty for events that are only counted.
    """

    stamp_ns: int
    name: str
    level: Level = Level.DEBUG
    text: str = ""
    data: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class AttitudeSolution:
    """Attitude ``q_nb`` (4,), covariance about n axes ``cov_n`` (3, 3) [rad^2], bias-corrected rate [rad/s]."""

    stamp_ns: int
    q_nb: np.ndarray
    cov_n: np.ndarray
    rate_b: np.ndarray
    accel_b: np.ndarray
    gyro_bias: np.ndarray


@dataclass(frozen=True, slots=True)
class NavSolution:
    """Navigation solution at one stamp. ``cov`` (15, 15) in the order of ``core.layout``, or None between its steps."""

    stamp_ns: int
    mode: Mode
    lat: float
    lon: float
    alt: float
    vel_n: np.ndarray  # (3,) m/s
    q_nb: np.ndarray  # (4,)
    rate_b: np.ndarray  # (3,) bias-corrected, rad/s
    force_b: np.ndarray  # (3,) bias-corrected specific force, m/s^2
    gyro_bias: np.ndarray
    accel_bias: np.ndarray
    cov: np.ndarray
    position_enu: np.ndarray  # (3,) m from the origin
    correction_enu: np.ndarray  # (3,) m: sum of all position resets, map -> odom
    reset_count: int


@dataclass(frozen=True, slots=True)
class NavBlock:
    """Solutions of consecutive IMU samples: ``stamps_ns`` (N,), ``rows`` (N, OUT_COLUMNS) of ``core.layout``."""

    stamps_ns: np.ndarray
    rows: np.ndarray
    mode: Mode
    reset_count: int
    correction_enu: np.ndarray


@dataclass(frozen=True, slots=True)
class OutageError:
    """What the network says in an outage: velocity error ENU [m/s], its covariance (3, 3), position error so far [m]."""

    stamp_ns: int
    dv_n: tuple[float, float, float]
    cov: np.ndarray
    dp_n: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class AttitudeBlock:
    """Attitudes of consecutive IMU samples: ``q_nb`` (N, 4), ``tilt_sd``, ``yaw_sd`` (N,) [rad], ``gyro_bias``."""

    stamps_ns: np.ndarray
    q_nb: np.ndarray
    tilt_sd: np.ndarray
    yaw_sd: np.ndarray
    gyro_bias: np.ndarray


@dataclass(frozen=True, slots=True)
class Status:
    """What a pilot wants to know, and every counter (``imu.rejected.nan`` -> 3)."""

    stamp_ns: int
    mode: Mode
    waiting_for: str  # one sentence while not AIDED, else empty
    seconds_coasting: float
    horizontal_sd: float  # m, now
    horizontal_sd_in_30_s: float  # m, if GNSS stays away
    gnss_refusal: str  # why the last fix was not used, else empty
    satellites: int | None
    counters: dict[str, int]
    values: dict[str, float]  # nis means, rates, delays ...


Output = NavSolution | NavBlock | AttitudeSolution | AttitudeBlock | OutageError | Event
