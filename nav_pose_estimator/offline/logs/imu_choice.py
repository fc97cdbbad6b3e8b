"""Selection of one of several IMUs: the one with the smallest velocity innovations of the navigator."""

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.flights import latency
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.logs.log_flight import LogRecording

CLEARLY = 0.9
"""Ratio of its innovations to those of the first IMU below which another IMU is selected."""


@dataclass(frozen=True)
class ImuComparison:
    """RMS of the velocity innovations [m/s] with each IMU, NaN where the filter did not start; the best, from 1."""

    innovations: tuple[float, ...]
    best: int


def compare_imus(recording: LogRecording, parameters: Parameters, until: float) -> ImuComparison | None:
    """Run the navigator with each IMU over the data before ``until`` [s]; None if there are too few data."""
    assert recording.log is not None
    delay = float(recording.sidecar.get(latency.PRIOR, parameters.gnss.delay))
    found = []
    for number in range(1, len(recording.log.imus) + 1):
        try:
            other = recording if number == recording.imu_number else recording.with_imu(number)
            found.append(latency.velocity_innovations(other, parameters, delay, until))
        except UserError:
            found.append(math.nan)
    usable = np.array([value if math.isfinite(value) else math.inf for value in found])
    if not np.isfinite(usable).any():
        return None
    best = int(np.argmin(usable))
    best = best if not usable[best] > CLEARLY * usable[0] else 0
    return ImuComparison(tuple(found), best + 1)


def with_best_imu(recording: Recording, parameters: Parameters, until: float) -> Recording:
    """The recording with the best IMU of its log before ``until`` [s]; unchanged if there is no choice."""
    if not isinstance(recording, LogRecording) or recording.log is None or recording.options.imu is not None:
        return recording
    imus = recording.log.imus
    if len(imus) < 2:
        return recording
    found = compare_imus(recording, parameters, until)
    if found is None:
        recording.notices.append(
            f"IMU 1 of {len(imus)} is used (--imu N takes another): too little data to compare them"
        )
        return recording
    chosen = recording if found.best == recording.imu_number else recording.with_imu(found.best)
    values = ", ".join(f"{value:.2f} m/s with {imu.name}" for value, imu in zip(found.innovations, imus, strict=True))
    chosen.notices.append(
        f"IMU {found.best} of {len(imus)} is used (--imu N takes another): "
        f"GNSS velocities differ from the predicted ones by {values}"
    )
    return chosen
