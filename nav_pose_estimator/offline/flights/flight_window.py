"""Time window of the flight within a recording, and the starts of a benchmark's outages in it."""

import numpy as np

from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.offline.flights.outages import Outage, periodic
from nav_pose_estimator.offline.flights.recording import Recording

SHORT_FLIGHT = 300.0  # s
FIRST, FIRST_OF_SHORT = 160.0, 60.0  # s after the flight begins: time to align, to calibrate and to learn
ARMED = "armed_s"
"""Key in NAME.json of a flight log: intervals in which the vehicle was armed [s since the first stamp]."""
MOVING = 1.5  # m/s: horizontal speed that counts as flight
SHAKING = 0.5  # m/s^2: standard deviation of the specific force within a second that counts as running motors


def flight_window(recording: Recording) -> tuple[float, float]:
    """Start and end of the flight [s since the first stamp], from NAME.json or else by motion and vibration.

    If a flight log records arming, the flight is limited to the armed time.
    """
    known = recording.sidecar.get("flight_window_s")
    if known is not None:
        start, end = (recording.seconds_of_log(value) for value in known)
        return max(start, 0.0), min(end, recording.duration)
    seconds = np.unique(np.concatenate([_moving_seconds(recording), _shaking_seconds(recording)]))
    seconds = _armed(recording, seconds)
    if len(seconds) == 0:
        return 0.0, recording.duration
    return float(seconds[0]), float(min(seconds[-1] + 1.0, recording.duration))


def outage_starts(
    window: tuple[float, float], lengths: list[float], every: float, first: float | None, last: float = np.inf
) -> dict[float, list[Outage]]:
    """Outages by length that begin from ``first`` to ``last`` [s] after the start of the flight, and end within it."""
    if first is None:
        first = FIRST_OF_SHORT if window[1] - window[0] < SHORT_FLIGHT else FIRST
    latest = window[0] + last
    return {
        length: [one for one in periodic(every, length, window[0] + first, window[1]) if one.start <= latest]
        for length in lengths
    }


def _armed(recording: Recording, seconds: np.ndarray) -> np.ndarray:
    """Those of ``seconds`` (N,) in which the vehicle was armed; all of them where arming is not recorded."""
    spans = recording.sidecar.get(ARMED)
    if not isinstance(spans, list) or not all(isinstance(span, list) and len(span) == 2 for span in spans):
        return seconds
    inside = np.zeros(len(seconds), bool)
    for begin, end in spans:
        inside |= (seconds >= begin) & (seconds <= end)
    return seconds[inside] if inside.any() else seconds


def _moving_seconds(recording: Recording) -> np.ndarray:
    stamps = [v.stamp_ns for v in recording.velocities if np.hypot(*v.vel_enu[:2]) > MOVING]
    return (np.array(stamps, np.int64) - recording.epoch_ns) // 10**9


def _shaking_seconds(recording: Recording) -> np.ndarray:
    blocks = [s for s in recording.samples if isinstance(s, ImuBlock)]
    force = np.linalg.norm(np.concatenate([block.accel for block in blocks]), axis=1)
    second = (np.concatenate([block.stamps_ns for block in blocks]) - recording.epoch_ns) // 10**9
    good = np.isfinite(force) & (second >= 0)
    force, second = force[good], second[good]
    if len(second) == 0 or second.max() > 10**6:
        return np.empty(0, np.int64)
    count = np.maximum(np.bincount(second), 1)
    mean = np.bincount(second, force) / count
    variance = np.bincount(second, (force - mean[second]) ** 2) / count
    return np.flatnonzero(variance > SHAKING**2)
