"""Table of all inputs of the estimators: topic, message types, the parameter that selects one, and its conversion.

Nodes subscribe, and bags are read, by this table. Another driver is one more ``MessageType``, another sensor one more
``Input``. All subscriptions are best effort (:mod:`nav_pose_estimator.ros.qos`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import (
    Airspeed,
    BeamVelocitySample,
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    MagSample,
    PressureSample,
    RangeToGround,
    Sample,
    SatelliteCount,
    SetOrigin,
    SetPose,
)
from nav_pose_estimator.ros.messages import beams, convert, from_bytes, gps_umd, px4, satellites
from nav_pose_estimator.ros.messages.convert import Adapter, Converted

NONE = "none"
"""Value of a selecting parameter that disables the input."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Conversion of many messages at once: ``convert`` receives ``cdr.columns`` of ``fields``.

    It returns None where the messages must be converted one by one.
    """

    fields: tuple[str, ...]
    convert: Callable[[dict[str, np.ndarray]], ImuBlock | list[Converted] | None]


@dataclass(frozen=True, slots=True)
class MessageType:
    """A message type of an input: ``choice`` is its value of the input's parameter, ``name`` is package/msg/Name."""

    choice: str
    name: str
    convert: Adapter
    from_bytes: Callable[[bytes], Converted] | None = None
    columns: Columns | None = None


@dataclass(frozen=True, slots=True)
class Source:
    """One input as selected by the parameters: topic, type and conversion.

    ``from_bytes``, if any, converts serialized messages with the same results as ``adapter``. ``parameter`` is the one
    that selected the type, if there are several.
    """

    topic: str
    type: str
    adapter: Callable[[Any], tuple[Any, ...]]  # samples and events
    from_bytes: Callable[[bytes], Converted] | None = None
    columns: Columns | None = None
    parameter: str = ""


@dataclass(frozen=True)
class Input:
    """An input with its relative ``topic``; the first of ``types`` is the default, if there is one.

    ``parameter`` (dotted) selects among several types. ``adjust`` adapts the conversion to further parameters. In a bag
    without ``topic``, another topic with one of these types is used if it is the only one and its name contains one of
    ``words``; () admits any name, None admits none.
    """

    topic: str
    sample: type[Sample]
    types: tuple[MessageType, ...]
    parameter: str = ""
    adjust: Callable[[Adapter, Parameters], Adapter] | None = None
    words: tuple[str, ...] | None = None

    def choice(self, parameters: Parameters) -> str:
        """Value of the input's parameter; the choice of its only type if there is no parameter."""
        return str(attrgetter(self.parameter)(parameters)) if self.parameter else self.types[0].choice

    def source(self, parameters: Parameters, type_name: str = "") -> Source | None:
        """The source of ``type_name``, by default of the selected type; None if the input is disabled."""
        choice = self.choice(parameters)
        kind = next((t for t in self.types if (t.name == type_name if type_name else t.choice == choice)), None)
        if kind is None or choice == NONE:
            return None
        adapter = kind.convert if self.adjust is None else self.adjust(kind.convert, parameters)
        if adapter is kind.convert:
            return Source(self.topic, kind.name, adapter, kind.from_bytes, kind.columns, self.parameter)
        return Source(self.topic, kind.name, adapter, parameter=self.parameter)


def _as_the_driver_fills_it(adapter: Adapter, parameters: Parameters) -> Adapter:
    if parameters.ros.input.velocity_frame == "ned" and adapter in (convert.twist, convert.twist_with_covariance):
        adapter = convert.from_ned(adapter)
    return adapter if parameters.ros.input.vertical_velocity else convert.without_vertical(adapter)


def _in_map(adapter: Adapter, parameters: Parameters) -> Adapter:
    return lambda message: convert.set_pose(message, parameters.ros.frames.map)


IMU = Input(
    "imu/data_raw",
    ImuSample,
    (
        MessageType(
            "imu",
            "sensor_msgs/msg/Imu",
            convert.imu,
            from_bytes.imu,
            Columns(tuple(name.removesuffix("[0]") for name in from_bytes.IMU_FIELDS), from_bytes.imu_block),
        ),
        MessageType("px4", "px4_msgs/msg/SensorCombined", px4.imu),
    ),
    parameter="ros.input.imu",
    words=(),
)
SATELLITES = Input(
    "gps/satellites",
    SatelliteCount,
    (
        MessageType("uint32", "std_msgs/msg/UInt32", satellites.from_uint32),
        MessageType("gpsfix", "gps_msgs/msg/GPSFix", satellites.from_gpsfix),
        MessageType("gpsraw", "mavros_msgs/msg/GPSRAW", satellites.from_gpsraw),
        MessageType("navpvt", "ublox_msgs/msg/NavPVT", satellites.from_navpvt),
        MessageType("px4", "px4_msgs/msg/SensorGps", px4.satellites),
    ),
    parameter="gnss.gate.satellite_source",
    words=("satellites", "gpsfix", "gps1/raw", "navpvt"),
)
VELOCITY = Input(
    "gps/vel",
    GnssVelocity,
    (
        MessageType(
            "twist_with_covariance",
            "geometry_msgs/msg/TwistWithCovarianceStamped",
            convert.twist_with_covariance,
            columns=Columns(from_bytes.VELOCITY_FIELDS, from_bytes.gnss_velocities),
        ),
        MessageType("twist", "geometry_msgs/msg/TwistStamped", convert.twist),
        MessageType("gpsfix", "gps_msgs/msg/GPSFix", gps_umd.velocity),
        MessageType("px4", "px4_msgs/msg/SensorGps", px4.velocity),
    ),
    parameter="ros.input.velocity",
    adjust=_as_the_driver_fills_it,
    words=("gps_vel", "gps/vel", "fix_velocity", "gnss/vel"),
)
FIX = Input(
    "gps/fix",
    GnssFix,
    (
        MessageType(
            "navsatfix",
            "sensor_msgs/msg/NavSatFix",
            convert.nav_sat_fix,
            columns=Columns(from_bytes.FIX_FIELDS, from_bytes.fixes),
        ),
        MessageType("gpsfix", "gps_msgs/msg/GPSFix", gps_umd.fix),
        MessageType("px4", "px4_msgs/msg/SensorGps", px4.fix),
    ),
    parameter="ros.input.fix",
    words=(),
)
MAGNETOMETER = Input(
    "imu/mag",
    MagSample,
    (
        MessageType(
            "magnetic_field",
            "sensor_msgs/msg/MagneticField",
            convert.magnetic_field,
            columns=Columns(("magnetic_field",), from_bytes.magnetic_fields),
        ),
    ),
    words=(),
)
AIRSPEED = Input(
    "airspeed",
    Airspeed,
    (
        MessageType("twist", "geometry_msgs/msg/TwistStamped", convert.airspeed),
        MessageType("float32", "std_msgs/msg/Float32", convert.airspeed_number),
        MessageType("px4", "px4_msgs/msg/Airspeed", px4.airspeed),
        MessageType("differential_pressure", "sensor_msgs/msg/FluidPressure", convert.differential_pressure),
        MessageType("px4_differential_pressure", "px4_msgs/msg/DifferentialPressure", px4.differential_pressure),
    ),
    parameter="ros.input.airspeed",
    words=("airspeed", "diff_press", "differential_press"),
)
BAROMETER = Input(
    "baro",
    PressureSample,
    (
        MessageType(
            "fluid_pressure",
            "sensor_msgs/msg/FluidPressure",
            convert.fluid_pressure,
            columns=Columns(("fluid_pressure", "variance"), from_bytes.pressures),
        ),
    ),
    words=(),
)
BODY_VELOCITY = Input(
    "body_velocity",
    BodyVelocity,
    (MessageType("twist_with_covariance", "geometry_msgs/msg/TwistWithCovarianceStamped", convert.body_velocity),),
)
BEAM_VELOCITY = Input(
    "beam_velocity",
    BeamVelocitySample,
    (
        MessageType("dvl", "marine_acoustic_msgs/msg/Dvl", beams.dvl),
        MessageType("a50", "dvl_msgs/msg/DVL", beams.a50),
        MessageType("pointcloud2", "sensor_msgs/msg/PointCloud2", beams.point_cloud),
    ),
    parameter="aids.beam_velocity_source",
)
RANGE = Input("range", RangeToGround, (MessageType("range", "sensor_msgs/msg/Range", convert.range_to_ground),))
SET_POSE = Input(
    "set_pose",
    SetPose,
    (MessageType("pose", "geometry_msgs/msg/PoseWithCovarianceStamped", convert.set_pose),),
    adjust=_in_map,
)
SET_ORIGIN = Input(
    "set_origin",
    SetOrigin,
    (
        MessageType("navsatfix", "sensor_msgs/msg/NavSatFix", convert.origin_fix),
        MessageType("geopoint", "geographic_msgs/msg/GeoPointStamped", convert.origin_point),
    ),
    parameter="ros.input.set_origin",
)

GNSS = (SATELLITES, VELOCITY, FIX)
"""The GNSS inputs, in the order of their samples from one message: the satellite count is needed to judge the fix."""
INPUTS = (
    IMU,
    *GNSS,
    MAGNETOMETER,
    AIRSPEED,
    BAROMETER,
    BODY_VELOCITY,
    BEAM_VELOCITY,
    RANGE,
    SET_POSE,
    SET_ORIGIN,
)


def sources(parameters: Parameters, inputs: tuple[Input, ...] = INPUTS) -> list[Source]:
    """Sources of the enabled ones of ``inputs``."""
    return [source for one in inputs if (source := one.source(parameters)) is not None]
