"""Sensor data of a flight log in the frames and units of this package, with times of the log's clock."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.numerics.axes import FRD_FLU, Q_FRD_FLU, Q_NED_ENU
from nav_pose_estimator.core.numerics.rotation import quat_multiply_many, quat_normalize_many
from nav_pose_estimator.engine.samples import (
    Airspeed,
    DifferentialPressure,
    MagSample,
    PressureSample,
    RangeToGround,
    Sample,
)
from nav_pose_estimator.offline.flights.tracks import Reference
from nav_pose_estimator.offline.logs.formats.log_tables import Table, rising

Array = np.ndarray
GAUSS = 1e-4  # T
_LONGEST_DELAY = 1000.0  # ms: largest plausible latency
_LARGEST_HPA = 2000.0  # smaller pressures are in hPa
_PRESSURES = 1000.0, 120_000.0  # Pa: smallest and largest pressure of a working sensor
_EARLY = 0.7  # intervals: an equal message that comes sooner is a repetition, where its own time is not known
FIX, NO_FIX = 0, -1  # sensor_msgs/NavSatStatus


@dataclass(frozen=True)
class Imu:
    """One IMU: ``time_us`` (N,) int64 rising, ``gyro`` (N, 3) [rad/s], ``accel`` (N, 3) [m/s^2] specific force, FLU."""

    name: str
    time_us: Array
    gyro: Array
    accel: Array
    clipped: int = 0  # samples that the autopilot marked as out of range

    def rate(self) -> float:
        """Samples a second [Hz]."""
        return 1e6 / float(np.median(np.diff(self.time_us))) if len(self.time_us) > 1 else 0.0


@dataclass(frozen=True)
class Gnss:
    """One receiver with N messages; unknown values are NaN (satellites -1, time 0)."""

    name: str
    time_us: Array  # (N,) int64, clock of the log
    position: Array  # (N, 3) latitude, longitude [rad], height [m]
    has_fix: Array  # (N,) bool, three-dimensional
    velocity: Array  # (N, 3) ENU [m/s]
    accuracy: Array  # (N, 3) standard deviations: horizontal [m], vertical [m], speed [m/s]
    satellites: Array  # (N,) int
    utc_us: Array  # (N,) int64
    undulation: float = np.nan  # ellipsoid height minus height above sea level [m]
    sea_level: bool = False  # heights are above mean sea level, because no others are logged


@dataclass(frozen=True)
class Series:
    """Data of one other sensor: each row of ``values`` (N, k), with its stamp, is a sample of ``kind``."""

    name: str
    kind: type[Sample]
    time_us: Array
    values: Array

    def rate(self) -> float:
        """Samples a second [Hz]."""
        return 1e6 / max(float(np.median(np.diff(self.time_us))), 1.0) if len(self.time_us) > 1 else 0.0


@dataclass
class LogSensors:
    """Sensor data of one log. ``opinion``: the autopilot's own estimate, with times in seconds of the log.

    ``armed`` is None if the log does not record arming. ``delay``: latency of the fixes [s] by the log's parameters,
    and the name of the parameter. ``needs``: the messages that contain IMU and GNSS data.
    """

    path: Path
    form: str
    firmware: str
    vehicle: str
    imus: list[Imu]
    gnss: list[Gnss]
    others: list[Series]
    armed: list[tuple[int, int]] | None = None
    opinion: Reference | None = None
    delay: tuple[float, str] | None = None
    antenna: tuple[float, float, float] | None = None  # from the IMU, FLU [m]
    names: list[str] = field(default_factory=list)
    needs: tuple[str, str] = ("", "")  # the messages that hold IMU data, and GNSS
    notices: list[str] = field(default_factory=list)
    counters: Counter[str] = field(default_factory=Counter)

    @property
    def receiver(self) -> Gnss | None:
        """The receiver with the most fixes, the first of equals."""
        return max(self.gnss, key=lambda g: int(g.has_fix.sum()), default=None)


def known_delay(parameters: dict[str, float], names: Iterable[str]) -> tuple[float, str] | None:
    """Latency of the fixes [s] by the first of the parameters [ms] that is set, and its name."""
    found = ((parameters[name] * 1e-3, name) for name in names if 0.0 < parameters.get(name, 0.0) < _LONGEST_DELAY)
    return next(found, None)


def make_imu(name: str, time_us: Array, gyro_frd: Array, accel_frd: Array, clipped: Array | None = None) -> Imu:
    """Create an IMU from FRD columns, without rows that are not finite or not newer than the previous ones."""
    good = rising(time_us) & np.isfinite(gyro_frd).all(axis=1) & np.isfinite(accel_frd).all(axis=1)
    count = 0 if clipped is None else int(np.count_nonzero(clipped[good] > 0))
    return Imu(name, time_us[good], gyro_frd[good] * FRD_FLU, accel_frd[good] * FRD_FLU, count)


def magnetometer(table: Table, field_gauss: Array, time_us: Array | None = None) -> Series | None:
    """Samples of the field in FRD [gauss], without zero vectors; None if there are none."""
    time_us = table.time_us if time_us is None else time_us
    values = field_gauss * GAUSS * FRD_FLU
    return _series(table.name, MagSample, time_us, values, np.any(values != 0.0, axis=1))


def barometer(table: Table, pressure: Array, time_us: Array | None = None) -> Series | None:
    """Samples of the static pressure in Pa, or in hPa as from older PX4."""
    time_us = table.time_us if time_us is None else time_us
    pascal = np.where(pressure < _LARGEST_HPA, pressure * 100.0, pressure)
    return _series(
        table.name, PressureSample, time_us, pascal[:, None], (pascal > _PRESSURES[0]) & (pascal < _PRESSURES[1])
    )


def airspeed(table: Table, true_airspeed: Array, good: Array) -> Series | None:
    """Samples of the true airspeed [m/s]."""
    return _series(table.name, Airspeed, table.time_us, true_airspeed[:, None], good)


def differential_pressure(table: Table, pressure: Array) -> Series | None:
    """Samples of the differential pressure of a pitot tube [Pa]."""
    return _series(table.name, DifferentialPressure, table.time_us, pressure[:, None], pressure != 0.0)


def range_to_ground(
    table: Table, distance: Array, field_of_view: float, deviation: Array, good: Array
) -> Series | None:
    """Samples of the distance of a downward rangefinder [m]."""
    values = np.column_stack([distance, np.full(len(distance), field_of_view), deviation])
    return _series(table.name, RangeToGround, table.time_us, values, good & np.isfinite(distance), columns=1)


def _series(
    name: str, kind: type, time_us: Array, values: Array, good: Array, columns: int | None = None
) -> Series | None:
    good = good & rising(time_us) & np.isfinite(values[:, :columns]).all(axis=1)
    return Series(name, kind, time_us[good], values[good]) if good.any() else None


def sample(series: Series, stamp_ns: int, row: list[float]) -> Sample:
    """Sample of one row of a series."""
    return _MAKERS[series.kind](stamp_ns, row)


_MAKERS: dict[type[Sample], Callable[[int, list[float]], Sample]] = {
    MagSample: lambda stamp, row: MagSample(stamp, (row[0], row[1], row[2])),
    PressureSample: lambda stamp, row: PressureSample(stamp, row[0]),
    Airspeed: lambda stamp, row: Airspeed(stamp, row[0]),
    DifferentialPressure: lambda stamp, row: DifferentialPressure(stamp, row[0]),
    RangeToGround: lambda stamp, row: RangeToGround(stamp, *row),
}


def enu(ned: Array) -> Array:
    """Convert (N, 3) from North-East-Down to East-North-Up."""
    return np.column_stack([ned[:, 1], ned[:, 0], -ned[:, 2]])


def enu_flu_attitude(q_ned_frd: Array) -> Array:
    """Convert quaternions (N, 4), scalar first, of FRD to NED to those of FLU to ENU."""
    q = quat_normalize_many(q_ned_frd)
    return quat_multiply_many(quat_multiply_many(Q_NED_ENU, q), Q_FRD_FLU)


def fresh(gnss: Gnss) -> tuple[Gnss, int]:
    """The receiver without messages that only repeat the previous one, and their number."""
    same = np.zeros(len(gnss.time_us), bool)
    known = gnss.utc_us > 0
    if len(same) > 1:
        content = np.column_stack([gnss.position, np.nan_to_num(gnss.velocity)])
        alike = (content[1:] == content[:-1]).all(axis=1) & gnss.has_fix[1:] & gnss.has_fix[:-1]
        timed = known[1:] & known[:-1]
        early = np.diff(gnss.time_us) < _EARLY * np.median(np.diff(gnss.time_us))
        same[1:] = alike & np.where(timed, gnss.utc_us[1:] == gnss.utc_us[:-1], early)
    keep = ~same & rising(gnss.time_us)
    parts = {name: getattr(gnss, name)[keep] for name in PER_MESSAGE}
    return Gnss(gnss.name, **parts, undulation=gnss.undulation, sea_level=gnss.sea_level), int((~keep).sum())


PER_MESSAGE = ("time_us", "position", "has_fix", "velocity", "accuracy", "satellites", "utc_us")


def armed_spans(time_us: Array, armed: Array) -> list[tuple[int, int]] | None:
    """Spans (from, to) in which ``armed`` (N,) bool holds, in order of time; None without messages."""
    if len(time_us) == 0:
        return None
    order = np.argsort(time_us, kind="stable")
    time_us, armed = time_us[order], armed[order].astype(np.int8)
    edges = np.diff(armed, prepend=0, append=0)
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    last = len(time_us) - 1
    pairs = zip(starts.tolist(), ends.tolist(), strict=True)
    return [(int(time_us[begin]), int(time_us[min(end, last)])) for begin, end in pairs]
