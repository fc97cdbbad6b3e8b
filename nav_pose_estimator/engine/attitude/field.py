"""Magnetometer input of the attitude filter: calibration, mounting, and events of disturbances."""

import math
from collections.abc import Sequence
from types import ModuleType

import numpy as np

from nav_pose_estimator.core.alignment.levelling import LARGEST_FIELD
from nav_pose_estimator.core.attitude import layout as at
from nav_pose_estimator.core.attitude.magnetic_field import field_anomaly
from nav_pose_estimator.engine.attitude.memory import Memory
from nav_pose_estimator.engine.number_checks import is_within
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import MagSample, Vector3
from nav_pose_estimator.engine.sensors.magnetic.field_calibration import FieldCalibration
from nav_pose_estimator.engine.solutions import Event, Level

NO_FIELD = np.empty((0, 3))
DISTURBED, _UNDISTURBED = 0.45, 0.05
"""Anomalies of the field (relative square) at which a disturbance begins and ends."""
_STALE_NS = 500_000_000  # a field further from the IMU's time is not used


class FieldInput:
    """Takes magnetometer samples for one attitude filter."""

    def __init__(self, parameters: Parameters, kernels: ModuleType) -> None:
        self._enabled, self._kernels = parameters.aids.magnetometer, kernels
        self._calibration = FieldCalibration(parameters)

    def take(self, sample: MagSample, memory: Memory) -> list[Event]:
        """Pass one sample to the filter of ``memory``; returns the events of a rejection or a disturbance."""
        stamp = sample.stamp_ns
        if not self._enabled:
            return [Event(stamp, "mag.ignored")]
        if not all(map(math.isfinite, sample.field)):
            return [Event(stamp, "mag.rejected.nan")]
        if not is_within(sample.field, LARGEST_FIELD):
            return [Event(stamp, "mag.rejected.value")]
        if memory.last_ns is None:
            return [Event(stamp, "mag.rejected.no_attitude_yet")]
        if memory.mag_ns is not None and stamp <= memory.mag_ns:
            return [Event(stamp, "mag.rejected.stamp")]
        if abs(stamp - memory.last_ns) > _STALE_NS:
            text = f"a magnetic field is {(stamp - memory.last_ns) * 1e-9:+.1f} s from the IMU's time; not used"
            return [Event(memory.last_ns, "mag.rejected.stale", Level.WARN, text)]
        memory.mag_ns = stamp
        self._kernels.add_magnetic_field(memory.state, *self._calibration.in_body(sample.field))
        return disturbance(stamp, memory)

    def passes(self, samples: Sequence[tuple[int, MagSample]], stamps_ns: np.ndarray, memory: Memory) -> bool:
        """Whether ``take`` would refuse none of ``samples`` and set no heading at once; changes nothing.

        They come with their place: the number of IMU samples before them, whose stamps are ``stamps_ns`` (N,). False
        for two of them behind the same IMU sample.
        """
        newest, last_place = memory.mag_ns, -1
        if samples and memory.state[at.FIELD_H] == 0.0:
            return False
        for place, sample in samples:
            stamp, imu_ns = sample.stamp_ns, int(stamps_ns[place - 1]) if place else memory.last_ns
            is_late = newest is not None and stamp <= newest
            if not self._enabled or is_late or place <= last_place or not is_within(sample.field, LARGEST_FIELD):
                return False
            if imu_ns is None or abs(stamp - imu_ns) > _STALE_NS:
                return False
            newest, last_place = stamp, place
        return True

    def in_body(self, sample: MagSample) -> Vector3:
        """The field of one sample, calibrated and in body axes."""
        return self._calibration.in_body(sample.field)

    def many_in_body(self, mag: np.ndarray) -> np.ndarray:
        """Fields ``mag`` (N, 3), calibrated and in body axes; (0, 3) where the magnetometer is not used.

        Fields beyond ``LARGEST_FIELD`` become NaN.
        """
        if not self._enabled:
            return NO_FIELD
        fields = np.array(mag, dtype=float)
        fields[np.abs(fields) > LARGEST_FIELD] = np.nan
        return np.column_stack(self._calibration.in_body(tuple(fields.T)))


def disturbance(stamp: int, memory: Memory) -> list[Event]:
    """Events of the begin and end of a disturbance, and one for every disturbed sample."""
    anomaly = field_anomaly(memory.state)
    events = [Event(stamp, "mag.rejected.disturbed")] if anomaly > DISTURBED else []
    if anomaly > DISTURBED and not memory.disturbed:
        memory.disturbed = True
        text = "the magnetic field is disturbed: heading by gyroscope alone"
        return [*events, Event(stamp, "mag.disturbed", Level.WARN, text)]
    if anomaly < _UNDISTURBED and memory.disturbed:
        memory.disturbed = False
        return [Event(stamp, "mag.undisturbed", Level.INFO, "the magnetic field is undisturbed again")]
    return events
