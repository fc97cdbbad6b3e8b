"""A simulated recording as a rosbag2: sensor topics as drivers publish them, and the ground truth."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.numerics.rotation import quat_conjugate_many, quat_rotate_many
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    MagSample,
    PressureSample,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.offline.bags.cdr_packing import STAMP, pack
from nav_pose_estimator.offline.bags.writer import FAST, MCAP, Messages, write_bag
from nav_pose_estimator.ros.messages.message_table import IMU, INPUTS
from nav_pose_estimator.sim.imu_grades import ImuGrade
from nav_pose_estimator.sim.recording import Recording

TRUTH_HZ = 50.0
MAP_FRAME, BASE_FRAME, IMU_FRAME, GPS_FRAME = "map", "base_link", "imu_link", "gps_link"
_UNKNOWN_COUNT = 255  # MAVLink's word for it
_COV_UNKNOWN, _COV_KNOWN = 0, 3  # sensor_msgs/NavSatFix


def write_recording(
    path: Path,
    recording: Recording,
    storage: str = MCAP,
    force: bool = False,
    truth_hz: float = TRUTH_HZ,
    level: int = FAST,
) -> None:
    """Write ``recording`` as the rosbag2 ``path``. Raises ``UserError``."""
    notes = {
        "scenario": recording.scenario,
        "seed": str(recording.seed),
        "imu": recording.imu_grade.name,
        "duration_s": f"{recording.truth.t[-1]:g}",
    }
    write_bag(path, messages(recording, truth_hz), storage, force, level, notes)


def messages(recording: Recording, truth_hz: float = TRUTH_HZ) -> list[Messages]:
    """All topics of the bag. ``/ground_truth/origin`` is where the axes of ``/ground_truth/odom`` meet."""
    topics = [_origin(recording), _imu(recording)]
    inputs = {one.sample: one for one in INPUTS}
    for sensor, rows in _PACKERS.items():
        chosen = [timed for timed in recording.others if type(timed.sample) is sensor]
        if chosen:
            times = np.array([timed.arrival_ns for timed in chosen], np.int64)
            topic, kind = f"/{inputs[sensor].topic}", inputs[sensor].types[0].name
            topics.append(Messages(topic, kind, times, rows(kind, [timed.sample for timed in chosen])))
    return [*topics, _truth(recording, truth_hz)]


def _origin(recording: Recording) -> Messages:
    kind, start = "sensor_msgs/msg/NavSatFix", np.array([recording.start_ns], np.int64)
    lat, lon, alt = recording.origin
    place = [[math.degrees(lat), math.degrees(lon), alt]]
    fields = {STAMP: start, "header.frame_id": MAP_FRAME, **_place(np.array(place)), "status.service": 1}
    return Messages("/ground_truth/origin", kind, start, pack(kind, 1, fields), latched=True)


def _imu(recording: Recording) -> Messages:
    kind, block, n = IMU.types[0].name, recording.imu, len(recording.imu)
    gyro_var, accel_var = _sample_variances(recording.imu_grade, recording.truth.dt)
    absent = np.zeros(9)
    absent[0] = -1.0  # REP-145: no orientation
    fields = {
        STAMP: block.stamps_ns,
        "header.frame_id": IMU_FRAME,
        "orientation.w": 1.0,
        "orientation_covariance": absent,
        "angular_velocity": block.gyro,
        "angular_velocity_covariance": (gyro_var * np.eye(3)).ravel(),
        "linear_acceleration": block.accel,
        "linear_acceleration_covariance": (accel_var * np.eye(3)).ravel(),
    }
    return Messages(f"/{IMU.topic}", kind, recording.imu_arrivals_ns, pack(kind, n, fields))


def _sample_variances(grade: ImuGrade, dt: float) -> tuple[float, float]:
    """Variances of one sample: white noise and rounding; zero (unknown) for a perfect IMU."""
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
    """To so many binary places (14: 0.06 mm, 28: 4e-9 rad), because noise beyond them does not compress."""
    return np.round(values * 2.0**bits) / 2.0**bits


def _fixes(kind: str, fixes: list[GnssFix]) -> np.ndarray:
    place = np.array([(math.degrees(fix.lat), math.degrees(fix.lon), fix.alt) for fix in fixes])
    known = np.array([fix.cov_enu is not None for fix in fixes])
    cov = np.array([np.zeros((3, 3)) if fix.cov_enu is None else fix.cov_enu for fix in fixes])
    fields = {
        **_header(fixes, GPS_FRAME),
        **_place(place),
        "status.status": [fix.status for fix in fixes],
        "status.service": 1,
        "position_covariance": cov.reshape(-1, 9),
        "position_covariance_type": np.where(known, _COV_KNOWN, _COV_UNKNOWN),
    }
    return pack(kind, len(fixes), fields)


def _velocities(kind: str, samples: list[GnssVelocity]) -> np.ndarray:
    cov = np.zeros((len(samples), 6, 6))
    for i, sample in enumerate(samples):
        if sample.cov_enu is not None:
            cov[i, :3, :3] = sample.cov_enu
    fields = {
        **_header(samples, MAP_FRAME),
        "twist.twist.linear": [sample.vel_enu for sample in samples],
        "twist.covariance": cov.reshape(-1, 36),
    }
    return pack(kind, len(samples), fields)


def _counts(kind: str, samples: list[SatelliteCount]) -> np.ndarray:
    return pack(kind, len(samples), {"data": [_UNKNOWN_COUNT if s.count is None else s.count for s in samples]})


def _fields(kind: str, samples: list[MagSample]) -> np.ndarray:
    values = {**_header(samples, IMU_FRAME), "magnetic_field": [sample.field for sample in samples]}
    return pack(kind, len(samples), values)


def _pressures(kind: str, samples: list[PressureSample]) -> np.ndarray:
    fields = {
        **_header(samples, IMU_FRAME),
        "fluid_pressure": [sample.pressure for sample in samples],
        "variance": [sample.variance or 0.0 for sample in samples],
    }
    return pack(kind, len(samples), fields)


def _header(samples: list, frame: str) -> dict:
    return {STAMP: [sample.stamp_ns for sample in samples], "header.frame_id": frame}


def _place(place: np.ndarray) -> dict:
    """``place`` (N, 3): degrees, degrees, metres."""
    return {"latitude": place[:, 0], "longitude": place[:, 1], "altitude": place[:, 2]}


_Packer = Callable[[str, list], np.ndarray]
_PACKERS: dict[type[Sample], _Packer] = {
    GnssFix: _fixes,
    GnssVelocity: _velocities,
    SatelliteCount: _counts,
    MagSample: _fields,
    PressureSample: _pressures,
}
"""Sensors of a simulated recording; topics and types are the defaults of the message table."""
