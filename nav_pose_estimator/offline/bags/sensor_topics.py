"""Conversion of samples to the topics of a bag, one per kind of sensor, with all messages of a topic at once."""

import math
from collections.abc import Callable

import numpy as np

from nav_pose_estimator.engine.samples import (
    Airspeed,
    BeamVelocitySample,
    DifferentialPressure,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    MagSample,
    PressureSample,
    RangeToGround,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.offline.bags import point_clouds
from nav_pose_estimator.offline.bags.cdr_packing import STAMP, pack
from nav_pose_estimator.offline.bags.writer import Messages

MAP_FRAME, BASE_FRAME, IMU_FRAME, GPS_FRAME, DVL_FRAME = "map", "base_link", "imu_link", "gps_link", "dvl_link"
_UNKNOWN_COUNT = 255  # value of MAVLink for an unknown count
_COV_UNKNOWN, _COV_KNOWN = 0, 3  # sensor_msgs/NavSatFix


def imu_topic(block: ImuBlock, arrivals_ns: np.ndarray, gyro_var: float = 0.0, accel_var: float = 0.0) -> Messages:
    """The topic ``/imu/data_raw``; variances per axis [(rad/s)^2, (m/s^2)^2] of one sample, zero for unknown."""
    kind = "sensor_msgs/msg/Imu"
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
    return Messages("/imu/data_raw", kind, arrivals_ns, pack(kind, len(block), fields))


def sensor_topics(timed: list[tuple[int, Sample]]) -> list[Messages]:
    """Topics of all sensors but the IMU, from ``timed``: (time of receipt [ns], sample) in order of receipt."""
    topics = []
    for sensor, topic, kind, rows in _SENSORS:
        chosen = [(arrival, sample) for arrival, sample in timed if type(sample) is sensor]
        if chosen:
            times = np.array([arrival for arrival, _ in chosen], np.int64)
            topics.append(Messages(topic, kind, times, rows(kind, [sample for _, sample in chosen])))
    return topics


def place_fields(place: np.ndarray) -> dict:
    """Fields of a NavSatFix; ``place`` (N, 3): latitude, longitude [deg], ellipsoid height [m]."""
    return {"latitude": place[:, 0], "longitude": place[:, 1], "altitude": place[:, 2]}


def _fixes(kind: str, fixes: list[GnssFix]) -> np.ndarray:
    place = np.array([(math.degrees(fix.lat), math.degrees(fix.lon), fix.alt) for fix in fixes])
    known = np.array([fix.cov_enu is not None for fix in fixes])
    cov = np.array([np.zeros((3, 3)) if fix.cov_enu is None else fix.cov_enu for fix in fixes])
    fields = {
        **_header(fixes, GPS_FRAME),
        **place_fields(place),
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


def _airspeeds(kind: str, samples: list[Airspeed]) -> np.ndarray:
    fields = {**_header(samples, BASE_FRAME), "twist.linear.x": [sample.speed for sample in samples]}
    return pack(kind, len(samples), fields)


def _differential_pressures(kind: str, samples: list[DifferentialPressure]) -> np.ndarray:
    fields = {**_header(samples, BASE_FRAME), "fluid_pressure": [sample.pressure for sample in samples]}
    return pack(kind, len(samples), fields)


def _ranges(kind: str, samples: list[RangeToGround]) -> np.ndarray:
    fields = {
        **_header(samples, BASE_FRAME),
        "field_of_view": [sample.field_of_view for sample in samples],
        "range": [sample.distance for sample in samples],
        "variance": [sample.sd**2 if sample.sd > 0.0 else 0.0 for sample in samples],
    }
    return pack(kind, len(samples), fields)


def _beams(kind: str, samples: list[BeamVelocitySample]) -> np.ndarray:
    directions = np.array([sample.directions for sample in samples])
    velocities = np.array([sample.velocities for sample in samples])
    return point_clouds.pack_beams([sample.stamp_ns for sample in samples], directions, velocities, DVL_FRAME)


def _header(samples: list, frame: str) -> dict:
    return {STAMP: [sample.stamp_ns for sample in samples], "header.frame_id": frame}


_Packer = Callable[[str, list], np.ndarray]
_SENSORS: tuple[tuple[type[Sample], str, str, _Packer], ...] = (
    (GnssFix, "/gps/fix", "sensor_msgs/msg/NavSatFix", _fixes),
    (GnssVelocity, "/gps/vel", "geometry_msgs/msg/TwistWithCovarianceStamped", _velocities),
    (SatelliteCount, "/gps/satellites", "std_msgs/msg/UInt32", _counts),
    (MagSample, "/imu/mag", "sensor_msgs/msg/MagneticField", _fields),
    (PressureSample, "/baro", "sensor_msgs/msg/FluidPressure", _pressures),
    (Airspeed, "/airspeed", "geometry_msgs/msg/TwistStamped", _airspeeds),
    (DifferentialPressure, "/differential_pressure", "sensor_msgs/msg/FluidPressure", _differential_pressures),
    (RangeToGround, "/range", "sensor_msgs/msg/Range", _ranges),
    (BeamVelocitySample, "/beam_velocity", point_clouds.KIND, _beams),
)
