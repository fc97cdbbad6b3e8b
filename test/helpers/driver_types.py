"""Messages of drivers that are not part of ROS itself, with all their fields, without the drivers' packages.

The fields are those of px4_msgs (1.15 and, as SensorGps114, 1.14), gps_msgs, ublox_msgs, mavros_msgs,
marine_acoustic_msgs, dvl_msgs and geographic_msgs, so that an adapter that reads a field that a driver does not send
fails in the tests.
"""

from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SENSOR_COMBINED, SENSOR_GPS = "px4_msgs/msg/SensorCombined", "px4_msgs/msg/SensorGps"
AIRSPEED, DIFFERENTIAL_PRESSURE = "px4_msgs/msg/Airspeed", "px4_msgs/msg/DifferentialPressure"
VEHICLE_ODOMETRY, VEHICLE_LOCAL_POSITION = "px4_msgs/msg/VehicleOdometry", "px4_msgs/msg/VehicleLocalPosition"
GPSINPUT = "mavros_msgs/msg/GPSINPUT"
DVL, A50 = "marine_acoustic_msgs/msg/Dvl", "dvl_msgs/msg/DVL"
GEOPOINT = "geographic_msgs/msg/GeoPointStamped"
GPS_FIX, NAV_PVT, GPSRAW = "gps_msgs/msg/GPSFix", "ublox_msgs/msg/NavPVT", "mavros_msgs/msg/GPSRAW"

_GPS_TAIL = """
float32 s_variance_m_s
float32 c_variance_rad
uint8 fix_type
float32 eph
float32 epv
float32 hdop
float32 vdop
int32 noise_per_ms
uint16 automatic_gain_control
uint8 jamming_state
int32 jamming_indicator
uint8 spoofing_state
float32 vel_m_s
float32 vel_n_m_s
float32 vel_e_m_s
float32 vel_d_m_s
float32 cog_rad
bool vel_ned_valid
int32 timestamp_time_relative
uint64 time_utc_usec
uint8 satellites_used
float32 heading
float32 heading_offset
float32 heading_accuracy
float32 rtcm_injection_rate
uint8 selected_rtcm_instance
"""
_STAMPS = "uint64 timestamp\nuint64 timestamp_sample\nuint32 device_id\n"
DEFINITIONS = {
    SENSOR_COMBINED: """
uint64 timestamp
float32[3] gyro_rad
uint32 gyro_integral_dt
int32 accelerometer_timestamp_relative
float32[3] accelerometer_m_s2
uint32 accelerometer_integral_dt
uint8 accelerometer_clipping
uint8 gyro_clipping
uint8 accel_calibration_count
uint8 gyro_calibration_count
""",
    SENSOR_GPS: _STAMPS
    + "float64 latitude_deg\nfloat64 longitude_deg\nfloat64 altitude_msl_m\nfloat64 altitude_ellipsoid_m"
    + _GPS_TAIL,
    AIRSPEED: "uint64 timestamp\nuint64 timestamp_sample\nfloat32 indicated_airspeed_m_s\nfloat32 true_airspeed_m_s\n"
    "float32 air_temperature_celsius\nfloat32 confidence",
    DIFFERENTIAL_PRESSURE: _STAMPS + "float32 differential_pressure_pa\nfloat32 temperature\nuint32 error_count",
    "px4_msgs/msg/SensorGps114": _STAMPS + "int32 lat\nint32 lon\nint32 alt\nint32 alt_ellipsoid" + _GPS_TAIL,
    "gps_msgs/msg/GPSStatus": """
std_msgs/Header header
uint16 satellites_used
int32[] satellite_used_prn
uint16 satellites_visible
int32[] satellite_visible_prn
int32[] satellite_visible_z
int32[] satellite_visible_azimuth
int32[] satellite_visible_snr
int16 status
uint16 motion_source
uint16 orientation_source
uint16 position_source
""",
    DVL: """
std_msgs/Header header
uint8 velocity_mode
uint8 dvl_type
geometry_msgs/Vector3 velocity
float64[9] velocity_covar
float64 altitude
float64 course_gnd
float64 speed_gnd
uint8 num_good_beams
float32 sound_speed
bool beam_ranges_valid
bool beam_velocities_valid
geometry_msgs/Vector3[4] beam_unit_vec
float64[4] range
float32[4] range_covar
float32[4] beam_quality
float32[4] beam_velocity
float32[4] beam_velocity_covar
""",
    "geographic_msgs/msg/GeoPoint": "float64 latitude\nfloat64 longitude\nfloat64 altitude",
    GEOPOINT: "std_msgs/Header header\ngeographic_msgs/GeoPoint position\n",
    "dvl_msgs/msg/DVLBeam": """
int64 id
float64 velocity
float64 distance
float64 rssi
float64 nsd
bool valid
""",
    A50: """
std_msgs/Header header
float64 time
geometry_msgs/Vector3 velocity
float64 fom
float64 altitude
dvl_msgs/DVLBeam[] beams
bool velocity_valid
int64 status
string form
""",
    GPS_FIX: """
std_msgs/Header header
gps_msgs/GPSStatus status
float64 latitude
float64 longitude
float64 altitude
float64 track
float64 speed
float64 climb
float64 pitch
float64 roll
float64 dip
float64 time
float64 gdop
float64 pdop
float64 hdop
float64 vdop
float64 tdop
float64 err
float64 err_horz
float64 err_vert
float64 err_track
float64 err_speed
float64 err_climb
float64 err_time
float64 err_pitch
float64 err_roll
float64 err_dip
float64[9] position_covariance
uint8 position_covariance_type
""",
    NAV_PVT: """
uint32 i_tow
uint16 year
uint8 month
uint8 day
uint8 hour
uint8 min
uint8 sec
uint8 valid
uint32 t_acc
int32 nano
uint8 fix_type
uint8 flags
uint8 flags2
uint8 num_sv
int32 lon
int32 lat
int32 height
int32 h_msl
uint32 h_acc
uint32 v_acc
int32 vel_n
int32 vel_e
int32 vel_d
int32 g_speed
int32 heading
uint32 s_acc
uint32 head_acc
uint16 p_dop
uint8[6] reserved1
int32 head_veh
int16 mag_dec
uint16 mag_acc
""",
    GPSRAW: """
std_msgs/Header header
uint8 fix_type
int32 lat
int32 lon
int32 alt
uint16 eph
uint16 epv
uint16 vel
uint16 cog
uint8 satellites_visible
int32 alt_ellipsoid
uint32 h_acc
uint32 v_acc
uint32 vel_acc
int32 hdg_acc
uint16 yaw
uint8 dgps_numch
uint32 dgps_age
""",
    GPSINPUT: """
std_msgs/Header header
uint8 fix_type
uint8 gps_id
uint16 ignore_flags
uint32 time_week_ms
uint16 time_week
int32 lat
int32 lon
float32 alt
float32 hdop
float32 vdop
float32 vn
float32 ve
float32 vd
float32 speed_accuracy
float32 horiz_accuracy
float32 vert_accuracy
uint8 satellites_visible
uint16 yaw
""",
    VEHICLE_ODOMETRY: """
uint64 timestamp
uint64 timestamp_sample
uint8 pose_frame
float32[3] position
float32[4] q
uint8 velocity_frame
float32[3] velocity
float32[3] angular_velocity
float32[3] position_variance
float32[3] orientation_variance
float32[3] velocity_variance
uint8 reset_counter
int8 quality
""",
    VEHICLE_LOCAL_POSITION: """
uint64 timestamp
uint64 timestamp_sample
bool xy_valid
bool z_valid
bool v_xy_valid
bool v_z_valid
float32 x
float32 y
float32 z
float32[2] delta_xy
uint8 xy_reset_counter
float32 delta_z
uint8 z_reset_counter
float32 vx
float32 vy
float32 vz
float32 z_deriv
float32[2] delta_vxy
uint8 vxy_reset_counter
float32 delta_vz
uint8 vz_reset_counter
float32 ax
float32 ay
float32 az
float32 heading
float32 heading_var
float32 unaided_heading
float32 delta_heading
uint8 heading_reset_counter
bool heading_good_for_control
float32 tilt_var
bool xy_global
bool z_global
uint64 ref_timestamp
float64 ref_lat
float64 ref_lon
float32 ref_alt
bool dist_bottom_valid
float32 dist_bottom
float32 dist_bottom_var
float32 delta_dist_bottom
uint8 dist_bottom_reset_counter
uint8 dist_bottom_sensor_bitfield
float32 eph
float32 epv
float32 evh
float32 evv
bool dead_reckoning
float32 vxy_max
float32 vz_max
float32 hagl_min
float32 hagl_max_z
float32 hagl_max_xy
""",
}
STORE = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in DEFINITIONS.items():
    STORE.register(get_types_from_msg(_text, _name))


def make(kind: str, **values: Any) -> Any:
    """A message with every field of ``kind``: ``values``, zero elsewhere; a field that does not exist is an error."""
    fields = {name: _zero(*shape) for name, shape in STORE.fielddefs[kind][1]}
    unknown = set(values) - set(fields)
    assert not unknown, f"{kind} has no field {unknown}"
    return STORE.types[kind](**{**fields, **values})


def sent(message: Any) -> Any:
    """``message`` as it arrives: through its serialized bytes, so in the precision of its fields."""
    kind = message.__msgtype__
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, kind), kind)


def _zero(node: Any, description: Any) -> Any:
    """The empty value of one field; ``node`` says whether it is a number, a message or an array."""
    if node.name == "NAME":
        return make(description)
    if node.name == "BASE":
        name = description[0]
        return "" if name == "string" else False if name == "bool" else 0.0 if name.startswith("float") else 0
    (kind, inner), length = description
    if kind.name == "NAME":
        return [make(inner) for _ in range(length if node.name == "ARRAY" else 0)]
    return np.zeros(length if node.name == "ARRAY" else 0, dtype=np.dtype(inner[0]))
