"""Writing of a simulated recording as a rosbag2, with the sensor topics of drivers and the ground truth."""

import math
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.numerics.rotation import quat_conjugate_many, quat_rotate_many
from nav_pose_estimator.offline.bags.cdr_packing import STAMP, pack
from nav_pose_estimator.offline.bags.sensor_topics import (
    BASE_FRAME,
    MAP_FRAME,
    imu_topic,
    place_fields,
    sensor_topics,
)
from nav_pose_estimator.offline.bags.writer import FAST, MCAP, Messages, write_bag
from nav_pose_estimator.sim.imu_grades import ImuGrade
from nav_pose_estimator.sim.recording import Recording

TRUTH_HZ = 50.0  # default rate of the true motion


def write_recording(
    path: Path,
    recording: Recording,
    storage: str = MCAP,
    force: bool = False,
    truth_hz: float = TRUTH_HZ,
    level: int = FAST,
) -> None:
    """Write ``recording`` as the rosbag2 ``path``. Raises ``UserError`` as ``write_bag``."""
    notes = {
        "scenario": recording.scenario,
        "seed": str(recording.seed),
        "imu": recording.imu_grade.name,
        "duration_s": f"{recording.truth.t[-1]:g}",
    }
    write_bag(path, messages(recording, truth_hz), storage, force, level, notes)


def messages(recording: Recording, truth_hz: float = TRUTH_HZ) -> list[Messages]:
    """All topics of the bag. ``/ground_truth/origin`` is the origin of the frame of ``/ground_truth/odom``."""
    timed = [(item.arrival_ns, item.sample) for item in recording.others]
    variances = _sample_variances(recording.imu_grade, recording.truth.dt)
    imu = imu_topic(recording.imu, recording.imu_arrivals_ns, *variances)
    return [_origin(recording), imu, *sensor_topics(timed), _truth(recording, truth_hz)]


def _origin(recording: Recording) -> Messages:
    kind, start = "sensor_msgs/msg/NavSatFix", np.array([recording.start_ns], np.int64)
    lat, lon, alt = recording.origin
    place = [[math.degrees(lat), math.degrees(lon), alt]]
    fields = {STAMP: start, "header.frame_id": MAP_FRAME, **place_fields(np.array(place)), "status.service": 1}
    return Messages("/ground_truth/origin", kind, start, pack(kind, 1, fields), latched=True)


def _sample_variances(grade: ImuGrade, dt: float) -> tuple[float, float]:
    """Variances of one sample by white noise and rounding: rate [(rad/s)^2], force [(m/s^2)^2]; zero means unknown."""
    return (
        grade.gyro_noise**2 / dt + grade.gyro_resolution**2 / 12.0,
        grade.accel_noise**2 / dt + grade.accel_resolution**2 / 12.0,
    )


def _truth(recording: Recording, rate: float) -> Messages:
    kind, truth = "nav_msgs/msg/Odometry", recording.truth
    rows = slice(None, None, max(round(1.0 / (truth.dt * rate)), 1))
    stamps = recording.imu_data.block.stamps_ns[rows]
    q_nb = truth.q_nb[rows]
    fields = {
        STAMP: stamps,
        "header.frame_id": MAP_FRAME,
        "child_frame_id": BASE_FRAME,
        "pose.pose.position": _rounded(truth.position_enu(recording.origin)[rows], 14),
        "pose.pose.orientation": _rounded(q_nb[:, [1, 2, 3, 0]], 28),
        "twist.twist.linear": _rounded(quat_rotate_many(quat_conjugate_many(q_nb), truth.v_n[rows]), 14),
        "twist.twist.angular": _rounded(truth.gyro[rows], 18),
    }
    return Messages("/ground_truth/odom", kind, stamps, pack(kind, len(stamps), fields))


def _rounded(values: np.ndarray, bits: int) -> np.ndarray:
    """``values`` rounded to ``bits`` binary places (14: 0.06 mm, 28: 4e-9 rad), for a better compression of the bag."""
    return np.round(values * 2.0**bits) / 2.0**bits
