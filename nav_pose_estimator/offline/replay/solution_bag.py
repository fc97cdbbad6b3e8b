"""Output of a replay's solution as a rosbag2 (mcap) for ROS tools."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.filter.layout import OUT_RATE
from nav_pose_estimator.core.numerics.rotation import quat_conjugate_many, quat_rotate_many
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.offline.bags.cdr_packing import pack, typestore
from nav_pose_estimator.offline.bags.writer import Messages, write_new
from nav_pose_estimator.offline.flights.tracks import Track, displacement_enu
from nav_pose_estimator.offline.replay.files import decimated, modes_at
from nav_pose_estimator.offline.replay.replay import ReplayResult

ODOMETRY, FIX, STATUS = "/odometry/filtered", "/gps/filtered", "/diagnostics"
FRAMES = ("map", "base_link")
FIX_HZ = 5.0
"""Largest rate of the fixes [Hz]."""
_UNKNOWN, _APPROXIMATED = 0, 2  # sensor_msgs/NavSatFix: nothing or the diagonal of the covariance is known
_STATUS_LEVEL = {"AIDED": 0, "COASTING": 1, "REACQUIRING": 1}


def write_solution(path: Path, result: ReplayResult, rate_hz: float) -> None:
    """Write Odometry (map to base_link), NavSatFix and one DiagnosticArray for each change of the mode."""
    write_new(path, _stretches(result, rate_hz))


def _stretches(result: ReplayResult, rate_hz: float) -> Iterator[list[Messages]]:
    """Yield the messages of all topics in parts that are consecutive in time."""
    status, done = _status(result), 0
    poses, fixes = (decimated(result.track, rate) for rate in (rate_hz, min(rate_hz, FIX_HZ)))
    for pose, fix in zip(poses, fixes, strict=True):
        topics = [make(result, part) for make, part in ((_odometry, pose), (_fixes, fix)) if len(part)]
        if topics:
            last = max(int(topic.times_ns[-1]) for topic in topics)
            due = int(np.searchsorted(status.times_ns, last, side="right"))
            yield [*topics, *_part(status, done, due)]
            done = due
    yield _part(status, done, len(status.times_ns))


def _part(messages: Messages, begin: int, end: int) -> list[Messages]:
    """Part of ``messages`` from ``begin`` to ``end``; empty if there are none."""
    part = replace(messages, times_ns=messages.times_ns[begin:end], payloads=messages.payloads[begin:end])
    return [part] if end > begin else []


def _stamps(result: ReplayResult, t: np.ndarray) -> np.ndarray:
    return np.round(t * 1e9).astype(np.int64) + result.recording.epoch_ns


def _odometry(result: ReplayResult, track: Track) -> Messages:
    """Pose in map and twist in base_link, in accordance with REP-105 and nav_msgs."""
    stamps = _stamps(result, track.t)
    origin = np.array(result.origin or result.track.position[0])
    velocity = quat_rotate_many(quat_conjugate_many(track.q_nb), track.velocity)
    pose_cov, twist_cov = np.zeros((2, len(track), 36))
    pose_cov[:, :15:7], pose_cov[:, 21::7] = track.sd("position") ** 2, track.sd("attitude") ** 2
    twist_cov[:, :15:7] = track.sd("velocity") ** 2
    fields = {
        "header.stamp": stamps,
        "header.frame_id": FRAMES[0],
        "child_frame_id": FRAMES[1],
        "pose.pose.position": displacement_enu(track.position, origin),
        "pose.pose.orientation": track.q_nb[:, [1, 2, 3, 0]],
        "pose.covariance": pose_cov,
        "twist.twist.linear": velocity,
        "twist.twist.angular": track.rows[:, OUT_RATE : OUT_RATE + 3],
        "twist.covariance": twist_cov,
    }
    kind = "nav_msgs/msg/Odometry"
    return Messages(ODOMETRY, kind, stamps, pack(kind, len(track), fields))


def _fixes(result: ReplayResult, track: Track) -> Messages:
    stamps, modes = _stamps(result, track.t), modes_at(result, track.t)
    aided = np.array([mode is Mode.AIDED for mode in modes], dtype=bool)
    covariance = np.zeros((len(track), 9))
    covariance[:, ::4] = track.sd("position") ** 2
    fields = {
        "header.stamp": stamps,
        "header.frame_id": FRAMES[1],
        "status.status": np.where(aided, 0, -1),
        "status.service": aided.astype(int),
        "latitude": np.degrees(track.position[:, 0]),
        "longitude": np.degrees(track.position[:, 1]),
        "altitude": track.position[:, 2],
        "position_covariance": covariance,
        "position_covariance_type": [_UNKNOWN if mode is Mode.EXPIRED else _APPROXIMATED for mode in modes],
    }
    kind = "sensor_msgs/msg/NavSatFix"
    return Messages(FIX, kind, stamps, pack(kind, len(track), fields))


def _status(result: ReplayResult) -> Messages:
    store, kind = typestore(), "diagnostic_msgs/msg/DiagnosticArray"
    types, stamps, payloads = store.types, [], []
    # in order of time, also after a clock that went back
    for t, mode in sorted(result.record.modes, key=lambda change: change[0]):
        stamp = round(t * 1e9) + result.recording.epoch_ns
        status = types["diagnostic_msgs/msg/DiagnosticStatus"](
            level=_STATUS_LEVEL.get(mode.value, 2),
            name="navigator",
            message=mode.value,
            hardware_id="",
            values=[types["diagnostic_msgs/msg/KeyValue"](key="mode", value=mode.value)],
        )
        time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
        stamps.append(stamp)
        payloads.append(bytes(store.serialize_cdr(types[kind](header=header, status=[status]), kind)))
    return Messages(STATUS, kind, np.array(stamps, np.int64), payloads)
