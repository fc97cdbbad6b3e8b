"""Sensor failures as filters on a stream of samples; they compose, because each takes a stream and returns one.

``start`` and ``length`` [s] refer to the time of arrival since the start of the recording.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.engine.samples import (
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuSample,
    MagSample,
    PressureSample,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.sim.sensors import Timed

VALUES: dict[type, tuple[str, ...]] = {
    ImuSample: ("gyro", "accel"),
    GnssFix: ("lat", "lon", "alt"),
    GnssVelocity: ("vel_enu",),
    SatelliteCount: ("count",),
    MagSample: ("field",),
    PressureSample: ("pressure",),
    BodyVelocity: ("velocity",),
}
"""Fields with the measured values of a sample, which failures change."""


@dataclass(frozen=True)
class Fault(ABC):
    """A failure of one kind of sensor, from ``start`` for ``length`` seconds."""

    sensor: type
    start: float = 0.0
    length: float = math.inf

    def __call__(self, stream: list[Timed], start_ns: int) -> list[Timed]:
        """The stream with this failure, in order of arrival; other sensors are unchanged."""
        first = start_ns + self.start * 1e9
        last = first + self.length * 1e9
        out: list[Timed] = []
        healthy: Sample | None = None
        number = 0
        for timed in stream:
            if type(timed.sample) is not self.sensor:
                out.append(timed)
            elif first <= timed.arrival_ns < last:
                if (changed := self.spoil(timed, healthy, number)) is not None:
                    out.append(changed)
                number += 1
            else:
                healthy = timed.sample
                out.append(timed)
        return sorted(out, key=lambda timed: timed.arrival_ns)

    @abstractmethod
    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        """What arrives instead of the ``number``-th sample of the failure; ``healthy`` is the last sample before it."""


@dataclass(frozen=True)
class Stop(Fault):
    """No samples arrive."""

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        return None


@dataclass(frozen=True)
class Freeze(Fault):
    """The last good values are repeated with new stamps."""

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        if healthy is None:
            return timed
        return _with(timed, {name: getattr(healthy, name) for name in VALUES[self.sensor]})


@dataclass(frozen=True)
class NotANumber(Fault):
    """All values are NaN; a satellite count is unknown."""

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        return _with(timed, {name: _nan(getattr(timed.sample, name)) for name in VALUES[self.sensor]})


@dataclass(frozen=True)
class Shift(Fault):
    """``offset`` is added, in m East-North-Up to a position, otherwise in the unit of the sample (IMU: gyro, accel)."""

    offset: tuple[float, ...] = (0.0, 0.0, 0.0)

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        sample: Any = timed.sample
        if isinstance(sample, GnssFix):
            return _with(timed, moved(sample, self.offset))
        changes, rest = {}, list(self.offset)
        for name in VALUES[self.sensor]:
            value = getattr(sample, name)
            if isinstance(value, tuple):
                changes[name] = tuple(a + b for a, b in zip(value, rest, strict=False))
                rest = rest[len(value) :] or [0.0] * 3
            else:
                changes[name] = value + type(value)(rest[0])
        return _with(timed, changes)


@dataclass(frozen=True)
class Creep(Fault):
    """The position error grows by ``step`` (East, North, Up) [m] with every fix, as by a slow spoofer."""

    sensor: type = GnssFix
    step: tuple[float, float, float] = (0.2, 0.0, 0.0)

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        sample: Any = timed.sample
        return _with(timed, moved(sample, tuple(number * value for value in self.step)))


@dataclass(frozen=True)
class Redate(Fault):
    """Stamps are wrong by ``seconds``, while samples arrive in time: the clock jumps, and later jumps back."""

    seconds: float = 10.0

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        sample: Any = timed.sample
        if sample.stamp_ns is None:
            return timed
        return _with(timed, {"stamp_ns": sample.stamp_ns + round(self.seconds * 1e9)})


@dataclass(frozen=True)
class SetCount(Fault):
    """The receiver reports ``count`` satellites, while its fixes continue."""

    sensor: type = SatelliteCount
    count: int | None = 3

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        return _with(timed, {"count": self.count})


@dataclass(frozen=True)
class Delay(Fault):
    """Samples arrive later by ``delay`` [s] with correct stamps; samples after the failure may overtake them."""

    delay: float = 0.3

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        return timed._replace(arrival_ns=timed.arrival_ns + round(self.delay * 1e9))


@dataclass(frozen=True)
class Thin(Fault):
    """Only every ``keep_every``-th sample arrives, which reduces the rate."""

    keep_every: int = 2

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        return timed if number % self.keep_every == 0 else None


def apply(stream: list[Timed], faults: tuple[Fault, ...], start_ns: int) -> list[Timed]:
    """``stream`` with all ``faults``, applied in their order."""
    for fault in faults:
        stream = fault(stream, start_ns)
    return stream


def _with(timed: Timed, changes: dict[str, Any]) -> Timed:
    return timed._replace(sample=replace(timed.sample, **changes))


def _nan(value: Any) -> Any:
    if isinstance(value, tuple):
        return (math.nan,) * len(value)
    return None if isinstance(value, int) or value is None else math.nan


def moved(fix: GnssFix, offset: tuple[float, ...]) -> dict[str, Any]:
    """Position fields of ``fix`` moved by ``offset`` (East, North, Up) [m]."""
    R_M, R_N = radii(fix.lat)
    return {
        "lat": fix.lat + offset[1] / (R_M + fix.alt),
        "lon": fix.lon + offset[0] / ((R_N + fix.alt) * math.cos(fix.lat)),
        "alt": fix.alt + offset[2],
    }
