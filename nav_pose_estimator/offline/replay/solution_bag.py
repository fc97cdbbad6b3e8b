"""The solution of a replay as a rosbag2 (mcap), so that every ROS tool can show it."""

import math
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.filter.layout import OUT_RATE
from nav_pose_estimator.core.numerics.rotation import quat_conjugate_many, quat_rotate_many
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.offline.flights.tracks import displacement_enu
from nav_pose_estimator.offline.replay.files import decimate, modes_at
from nav_pose_estimator.offline.replay.replay import ReplayResult

ODOMETRY, FIX, STATUS = "/odometry/filtered", "/gps/filtered", "/diagnostics"
FRAMES = ("map", "base_link")
_UNKNOWN, _APPROXIMATED = 0, 2  # sensor_msgs/NavSatFix: nothing or the diagonal of the covariance is known
_STATUS_LEVEL = {"AIDED": 0, "COASTING": 1, "REACQUIRING": 1}


def write_solution(path: Path, result: ReplayResult, rate_hz: float) -> None:
    """Write Odometry (map to base_link), NavSatFix and one DiagnosticArray for each change of the mode."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    messages = [*_odometry(result, store, rate_hz), *_fixes(result, store, rate_hz), *_status(result, store)]
    messages.sort(key=lambda item: item[0])
    kinds = {ODOMETRY: "nav_msgs/msg/Odometry", FIX: "sensor_msgs/msg/NavSatFix"}
    kinds[STATUS] = "diagnostic_msgs/msg/DiagnosticArray"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for stamp, topic, message in messages:
            writer.write(connections[topic], stamp, store.serialize_cdr(message, kinds[topic]))


def _header(store, stamp: int, frame: str):
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _stamps(result: ReplayResult, t: np.ndarray) -> list[int]:
    return (np.round(t * 1e9).astype(np.int64) + result.recording.epoch_ns).tolist()


def _odometry(result: ReplayResult, store, rate_hz: float):
    """(stamp, topic, message): pose in map, twist in base_link as REP-105 and nav_msgs ask for."""
    types = store.types
    track = decimate(result.track, rate_hz)
    if len(track) == 0:
        return
    origin = np.array(result.origin or track.position[0])
    enu = displacement_enu(track.position, origin).tolist()
    velocity = quat_rotate_many(quat_conjugate_many(track.q_nb), track.velocity).tolist()
    rates, quaternions = track.rows[:, OUT_RATE : OUT_RATE + 3].tolist(), track.q_nb.tolist()
    variances = np.column_stack([track.sd("position"), track.sd("attitude"), track.sd("velocity")]) ** 2
    point, vector = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Vector3"]
    make_pose, quaternion = types["geometry_msgs/msg/Pose"], types["geometry_msgs/msg/Quaternion"]
    for i, stamp in enumerate(_stamps(result, track.t)):
        w, x, y, z = quaternions[i]
        pose_cov, twist_cov = np.zeros(36), np.zeros(36)
        pose_cov[::7] = variances[i, :6]
        twist_cov[:21:7] = variances[i, 6:]
        pose = make_pose(point(*enu[i]), quaternion(x=x, y=y, z=z, w=w))
        twist = types["geometry_msgs/msg/Twist"](vector(*velocity[i]), vector(*rates[i]))
        yield (
            stamp,
            ODOMETRY,
            types["nav_msgs/msg/Odometry"](
                header=_header(store, stamp, FRAMES[0]),
                child_frame_id=FRAMES[1],
                pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, pose_cov),
                twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, twist_cov),
            ),
        )


def _fixes(result: ReplayResult, store, rate_hz: float):
    track = decimate(result.track, min(rate_hz, 5.0))
    variances = track.sd("position") ** 2
    status = store.types["sensor_msgs/msg/NavSatStatus"]
    aided, denied = status(status=0, service=1), status(status=-1, service=0)
    moments = zip(_stamps(result, track.t), modes_at(result, track.t), strict=True)
    for i, (stamp, mode) in enumerate(moments):
        lat, lon, alt = track.position[i].tolist()
        message = store.types["sensor_msgs/msg/NavSatFix"](
            header=_header(store, stamp, FRAMES[1]),
            status=aided if mode is Mode.AIDED else denied,
            latitude=math.degrees(lat),
            longitude=math.degrees(lon),
            altitude=alt,
            position_covariance=np.diag(variances[i]).ravel(),
            position_covariance_type=_UNKNOWN if mode is Mode.EXPIRED else _APPROXIMATED,
        )
        yield stamp, FIX, message


def _status(result: ReplayResult, store):
    types = store.types
    for t, mode in result.record.modes:
        stamp = round(t * 1e9) + result.recording.epoch_ns
        status = types["diagnostic_msgs/msg/DiagnosticStatus"](
            level=_STATUS_LEVEL.get(mode.value, 2),
            name="navigator",
            message=mode.value,
            hardware_id="",
            values=[types["diagnostic_msgs/msg/KeyValue"](key="mode", value=mode.value)],
        )
        header = _header(store, stamp, "")
        yield stamp, STATUS, types["diagnostic_msgs/msg/DiagnosticArray"](header=header, status=[status])
