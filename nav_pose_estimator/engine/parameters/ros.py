"""Parameters of the ROS boundary: message types, frames, rates. Plain data; replay ignores what it does not need."""

from dataclasses import dataclass, field

from nav_pose_estimator.engine.parameters.schema import ParameterError, param

READ_BY_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Prefixes of parameters that rclpy itself reads; they are in the same files but not in this tree."""
GEOID_UNKNOWN = -1000.0
"""Value of ``autopilot_geoid`` that is not set."""
_LOWEST_GEOID = -110.0  # m: below the lowest geoid height on Earth (-107 m)


@dataclass(frozen=True)
class InputParameters:
    """The message type on each input topic, as the driver publishes it; that of gps/satellites is in ``gnss.gate``."""

    imu: str = param("imu", "", "imu/data_raw: sensor_msgs/Imu or px4_msgs/SensorCombined", choices=("imu", "px4"))
    fix: str = param(
        "navsatfix",
        "",
        "gps/fix: sensor_msgs/NavSatFix, gps_msgs/GPSFix or px4_msgs/SensorGps",
        choices=("navsatfix", "gpsfix", "px4"),
    )
    velocity: str = param(
        "twist_with_covariance",
        "",
        "gps/vel: geometry_msgs/TwistWithCovarianceStamped or TwistStamped (ENU), gps_msgs/GPSFix, px4_msgs/SensorGps",
        choices=("twist_with_covariance", "twist", "gpsfix", "px4", "none"),
    )
    velocity_frame: str = param("enu", "", "World axes of a twist on gps/vel", choices=("enu", "ned"))
    vertical_velocity: bool = param(True, "", "The driver fills the vertical velocity of gps/vel (MAVROS does not)")
    airspeed: str = param(
        "twist",
        "",
        "airspeed: true airspeed [m/s] as geometry_msgs/TwistStamped (x), std_msgs/Float32 or px4_msgs/Airspeed; or"
        " differential pressure [Pa] as sensor_msgs/FluidPressure or px4_msgs/DifferentialPressure",
        choices=("twist", "float32", "px4", "differential_pressure", "px4_differential_pressure"),
    )
    set_origin: str = param(
        "navsatfix",
        "",
        "set_origin: sensor_msgs/NavSatFix or geographic_msgs/GeoPointStamped; heights above the ellipsoid",
        choices=("navsatfix", "geopoint"),
    )
    queue: int = param(200, "", "Messages kept per input while the node is busy", 1, 1000)
    relieve: bool = param(True, "", "Leave out work while the node cannot keep up; false: it is simply late")
    max_stamp_regression: float = param(
        1.0, "s", "Stamps that go back by more, three times in a row, are a new run (bag loop): reset", 0.1, 3600.0
    )


@dataclass(frozen=True)
class FrameParameters:
    """Frame names of REP-105."""

    map: str = param("map", "", "World frame that absorbs the jumps")
    odom: str = param("odom", "", "World frame in which base_link moves without jumps")
    base_link: str = param("base_link", "", "Body frame, FLU")
    publish_tf: bool = param(False, "", "Publish map -> odom -> base_link on /tf (needs tf2_msgs)")

    def __post_init__(self) -> None:
        """``ParameterError`` for frames that are not told apart by their names."""
        names = self.map, self.odom, self.base_link
        if not all(names) or len(set(names)) < len(names):
            raise ParameterError("ros.frames: map, odom and base_link need three different names")


@dataclass(frozen=True)
class OutputParameters:
    """Rates of the published results, and the output to an autopilot."""

    odometry_rate: float = param(
        100.0, "Hz", "Highest rate of odometry/filtered and tf; 0: with every IMU sample", 0.0, 2000.0
    )
    velocity_slew: float = param(
        5.0,
        "m/s^2",
        "odometry/filtered: corrections enter the twist at this rate, and what is left of them is in"
        " its covariance; 0: at once",
        0.0,
        1000.0,
    )
    attitude_rate: float = param(0.0, "Hz", "Highest rate of imu/data; 0: with every IMU sample", 0.0, 2000.0)
    fix_rate: float = param(5.0, "Hz", "Highest rate of gps/filtered; 0: with every IMU sample", 0.0, 2000.0)
    bias_rate: float = param(1.0, "Hz", "Highest rate of the bias topics; 0: with every IMU sample", 0.0, 2000.0)
    diagnostics_period: float = param(1.0, "s", "Time between two messages on /diagnostics and ~/status", 0.1, 60.0)
    autopilot: str = param(
        "none",
        "",
        "Who gets the pose: mavros (autopilot/odometry), mavros_gps (autopilot/gps_input: for ArduPilot a receiver of"
        " type 14), px4 (fmu/in/vehicle_visual_odometry over uXRCE-DDS); see docs/autopilot.md",
        choices=("none", "mavros", "mavros_gps", "px4"),
    )
    autopilot_when: str = param(
        "denied",
        "",
        "Send only while GNSS is denied, or also while it aids the navigator; never when EXPIRED",
        choices=("denied", "always"),
    )
    autopilot_rate: float = param(
        30.0, "Hz", "Rate of messages to the autopilot; it may refuse fewer than 5", 5.0, 200.0
    )
    autopilot_dry_run: bool = param(False, "", "Log once a second what the autopilot would get; send nothing")
    autopilot_geoid: float = param(
        GEOID_UNKNOWN,
        "m",
        "Height of the geoid (EGM96) above the WGS84 ellipsoid where you fly, since autopilots count heights from the"
        " sea; -1000: not known",
        GEOID_UNKNOWN,
        100.0,
    )
    autopilot_gps_id: int = param(1, "", "mavros_gps: which of ArduPilot's receivers this is, from 0", 0, 3)

    @property
    def knows_geoid(self) -> bool:
        """Whether ``autopilot_geoid`` is set."""
        return self.autopilot_geoid > _LOWEST_GEOID


@dataclass(frozen=True)
class ModelParameters:
    """File of the trained model of anfis_node."""

    file: str = param("", "", "File of the model: read at start where it exists, written by ~/save_model; empty: none")
    save_after_training: bool = param(False, "", "Write the file after every training whose result is adopted")


@dataclass(frozen=True)
class StateParameters:
    """File of the saved state from which a node continues after a restart in flight."""

    file: str = param(
        "",
        "",
        "File of the navigator's state (pose_estimator, sins_node), written in flight and read at the start: a restart"
        " within a minute continues from there, a later one keeps the origin; empty: none",
    )
    period: float = param(1.0, "s", "Time between two states on disk", 0.1, 60.0)


@dataclass(frozen=True)
class RosParameters:
    """All parameters of the ROS boundary."""

    input: InputParameters = field(default_factory=InputParameters)
    frames: FrameParameters = field(default_factory=FrameParameters)
    output: OutputParameters = field(default_factory=OutputParameters)
    model: ModelParameters = field(default_factory=ModelParameters)
    state: StateParameters = field(default_factory=StateParameters)
