"""Field map of PX4 ULog, firmware 1.5 to 1.16. Body FRD, world NED, microseconds.

Sources: msg/ of PX4-Autopilot through its versions. Where a field changed its name, the newer one comes first.
"""

import numpy as np

from nav_pose_estimator.core.earth.atmosphere import height_pressure
from nav_pose_estimator.core.numerics.axes import FRD_FLU
from nav_pose_estimator.offline.flights.tracks import Reference, shift
from nav_pose_estimator.offline.logs import sensors
from nav_pose_estimator.offline.logs.formats.log_tables import LogTables, Table, rising
from nav_pose_estimator.offline.logs.opinion import opinion
from nav_pose_estimator.offline.logs.sensors import Array, Gnss, Imu, LogSensors, Series

_ARMED = 2  # vehicle_status.arming_state
_FIX_3D, _EXTRAPOLATED = 3, 8
_INVALID_RELATIVE = 0x7FFFFFFF
_DOWN = 25  # distance_sensor.orientation: pitch 270 degrees
_FIRST_SENSOR, _LAST_SENSOR = 1, 3  # airspeed_validated.airspeed_source; others are synthetic
_ALL_SAMPLES = 0.9  # fraction of the time that the delta angles of a complete vehicle_imu cover
_TYPES = {1: "fixed wing", 2: "quadrotor", 3: "coaxial", 4: "helicopter", 10: "rover", 13: "hexarotor", 14: "octorotor"}
_TYPES |= dict.fromkeys(range(19, 26), "VTOL")


def px4_sensors(log: LogTables) -> LogSensors:
    """The sensor data of the log."""
    gnss = [
        found for name in ("vehicle_gps_position", "sensor_gps") for t in log.instances(name) if (found := _gnss(t))
    ]
    receiver = max(gnss, key=lambda g: int(g.has_fix.sum()), default=None)
    undulation = receiver.undulation if receiver is not None else np.nan
    antenna = [log.parameters.get(f"EKF2_GPS_POS_{axis}", 0.0) for axis in "XYZ"]
    lever = tuple((np.array(antenna) * FRD_FLU).tolist())
    return LogSensors(
        path=log.path,
        form=log.form,
        firmware=log.firmware,
        vehicle=_TYPES.get(round(log.parameters.get("MAV_TYPE", 0.0)), ""),
        imus=_imus(log),
        gnss=gnss,
        others=[series for series in (_magnetometer(log), _barometer(log), *_air(log), _range(log)) if series],
        armed=_armed(log),
        opinion=_opinion(log, 0.0 if np.isnan(undulation) else undulation),
        delay=sensors.known_delay(log.parameters, ["EKF2_GPS_DELAY"]),
        antenna=lever if any(antenna) else None,
        names=log.names,
        needs=("sensor_combined", "vehicle_gps_position or sensor_gps"),
        notices=log.notices,
        counters=log.counters,
    )


def _imus(log: LogTables) -> list[Imu]:
    """``sensor_combined`` first, then every ``vehicle_imu`` that was logged at its full rate."""
    combined = [_combined(table) for table in log.instances("sensor_combined")]
    others = [_integrated(table) for table in log.instances("vehicle_imu")]
    return [imu for imu in (*combined, *others) if imu is not None and len(imu.time_us) > 1]


def _combined(table: Table) -> Imu | None:
    if not table.has("gyro_rad[0]", "accelerometer_m_s2[0]"):
        return None
    clipped = table.number("accelerometer_clipping", default=0.0) + table.number("gyro_clipping", default=0.0)
    relative = table.whole("accelerometer_timestamp_relative")
    valid = (relative != _INVALID_RELATIVE) & rising(table.time_us)
    table, relative, clipped = table.select(valid), relative[valid], clipped[valid]
    gyro, accel = table.vector("gyro_rad"), table.vector("accelerometer_m_s2")
    # both are interpolated to the older of the two stamps, so that no later sample is needed
    time_us = table.time_us + np.minimum(relative, 0)
    if np.any(relative):
        gyro, accel = _at(time_us, table.time_us, gyro), _at(time_us, table.time_us + relative, accel)
    return sensors.make_imu("sensor_combined", time_us, gyro, accel, clipped)


def _at(wanted_us: Array, time_us: Array, values: Array) -> Array:
    return np.stack([np.interp(wanted_us, time_us, values[:, i]) for i in range(3)], axis=-1)


def _integrated(table: Table) -> Imu | None:
    """A ``vehicle_imu`` whose delta angles cover the flight; one that was logged at 2 Hz lacks most of them."""
    table = table.select(rising(table.time_us))
    if len(table) < 2 or not table.has("delta_angle[0]", "delta_velocity[0]", "delta_angle_dt", "delta_velocity_dt"):
        return None
    gyro_us, accel_us = table.number("delta_angle_dt"), table.number("delta_velocity_dt")
    if not np.median(gyro_us) > _ALL_SAMPLES * np.median(np.diff(table.time_us)):
        return None
    clipped = table.number("delta_velocity_clipping", default=0.0) + table.number("delta_angle_clipping", default=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        gyro = table.vector("delta_angle") / (gyro_us * 1e-6)[:, None]
        accel = table.vector("delta_velocity") / (accel_us * 1e-6)[:, None]
    stamps = table.whole("timestamp_sample") if table.has("timestamp_sample") else table.time_us
    stamps = stamps if np.all(stamps > 0) else table.time_us
    return sensors.make_imu(f"vehicle_imu {table.instance}", stamps, gyro, accel, clipped)


def _gnss(table: Table) -> Gnss | None:
    if not (table.has("lat", "lon", "alt") or table.has("latitude_deg", "longitude_deg")) or not table.has("fix_type"):
        return None
    scale = 1.0 if table.has("latitude_deg") else 1e-7
    millimetres = 1.0 if table.has("altitude_msl_m") else 1e-3
    sea_level = table.number("altitude_msl_m", "alt") * millimetres
    ellipsoid = table.number("altitude_ellipsoid_m", "alt_ellipsoid") * millimetres
    known = np.isfinite(ellipsoid) & (ellipsoid != 0.0)
    latitude, longitude = table.number("latitude_deg", "lat") * scale, table.number("longitude_deg", "lon") * scale
    kind = table.number("fix_type")
    has_fix = (kind >= _FIX_3D) & (kind < _EXTRAPOLATED)
    usable = bool(known[has_fix].all()) and bool(has_fix.any())
    velocity = sensors.enu(table.vector("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"))
    velocity[table.number("vel_ned_valid", default=1.0) == 0.0] = np.nan
    count = table.whole("satellites_used", default=255)
    return Gnss(
        name=f"{table.name} {table.instance}" if table.instance else table.name,
        time_us=table.time_us,
        position=np.column_stack([np.radians(latitude), np.radians(longitude), ellipsoid if usable else sea_level]),
        has_fix=has_fix & np.isfinite(latitude) & np.isfinite(longitude),
        velocity=velocity,
        # s_variance_m_s is, despite its name, the standard deviation of the speed in m/s
        accuracy=np.stack([_positive(table.number(name)) for name in ("eph", "epv", "s_variance_m_s")], axis=-1),
        satellites=np.where(count == 255, -1, count),
        utc_us=table.whole("time_utc_usec"),
        undulation=float(np.median((ellipsoid - sea_level)[has_fix])) if usable else np.nan,
        sea_level=not usable,
    )


def _positive(values: Array) -> Array:
    return np.where((values > 0.0) & (values < 1e4), values, np.nan)


def _magnetometer(log: LogTables) -> Series | None:
    """The calibrated field of the sensor that the autopilot uses; up to PX4 1.7 a part of ``sensor_combined``."""
    table = log.first("vehicle_magnetometer")
    if table is not None and table.has("magnetometer_ga[0]"):
        return sensors.magnetometer(table, table.vector("magnetometer_ga"))
    old = log.first("sensor_combined")
    if old is not None and old.has("magnetometer_ga[0]", "magnetometer_timestamp_relative"):
        time_us, good = _relative(old, "magnetometer_timestamp_relative")
        return sensors.magnetometer(old.select(good), old.vector("magnetometer_ga")[good], time_us[good])
    return None


def _barometer(log: LogTables) -> Series | None:
    table = log.first("vehicle_air_data")
    if table is not None and table.has("baro_pressure_pa"):
        return sensors.barometer(table, table.number("baro_pressure_pa"))
    old = log.first("sensor_combined")
    if old is not None and old.has("baro_alt_meter", "baro_timestamp_relative"):
        time_us, good = _relative(old, "baro_timestamp_relative")
        height = old.number("baro_alt_meter")[good]
        return sensors.barometer(old.select(good), np.asarray(height_pressure(height)), time_us[good])
    table = log.first("sensor_baro")
    return sensors.barometer(table, table.number("pressure")) if table is not None and table.has("pressure") else None


def _relative(table: Table, offset: str) -> tuple[Array, Array]:
    """Times of a sensor inside ``sensor_combined``, and which rows contain a new measurement of it."""
    relative = table.whole(offset)
    time_us = table.time_us + relative
    return time_us, (relative != _INVALID_RELATIVE) & np.concatenate([[True], np.diff(time_us) > 0])


def _air(log: LogTables) -> list[Series | None]:
    """Airspeed of the sensor, or its differential pressure.

    ``airspeed_validated`` may be ground speed minus wind, which is derived from GNSS. It is only used if the sensor
    itself was not logged, and only with values that are marked as from a sensor.
    """
    table = log.first("airspeed")
    if table is not None and table.has("true_airspeed_m_s"):
        speed = table.number("true_airspeed_m_s")
        good = table.number("confidence", default=1.0) > 0.0
        return [sensors.airspeed(table, speed, good)]
    table = log.first("airspeed_validated")
    if table is not None and table.has("true_airspeed_m_s"):
        source = table.number("airspeed_source", "selected_airspeed_index")
        of_a_sensor = (source >= _FIRST_SENSOR) & (source <= _LAST_SENSOR)
        return [sensors.airspeed(table, table.number("true_airspeed_m_s"), of_a_sensor)]
    table = log.first("differential_pressure")
    if table is not None:
        return [
            sensors.differential_pressure(
                table, table.number("differential_pressure_pa", "differential_pressure_raw_pa")
            )
        ]
    return []


def _range(log: LogTables) -> Series | None:
    """The downward rangefinder, within its own limits."""
    for table in log.instances("distance_sensor"):
        distance = table.number("current_distance")
        down = table.number("orientation", default=float(_DOWN)) == _DOWN
        low, high = table.number("min_distance", default=0.0), table.number("max_distance", default=np.inf)
        good = down & (distance > low) & (distance < high) & (table.number("signal_quality", default=-1.0) != 0.0)
        variance = table.number("variance")
        deviation = np.sqrt(np.where(variance > 0.0, variance, np.nan))
        view = float(np.nan_to_num(np.median(table.number("h_fov", default=0.0))))
        if good.any():
            return sensors.range_to_ground(table, distance, view, deviation, good)
    return None


def _armed(log: LogTables) -> list[tuple[int, int]] | None:
    for name, value in (("vehicle_status", "arming_state"), ("actuator_armed", "armed")):
        table = log.first(name)
        if table is not None and table.has(value):
            armed = table.number(value) == (_ARMED if value == "arming_state" else 1)
            return sensors.armed_spans(table.time_us, armed)
    return None


def _opinion(log: LogTables, undulation: float) -> Reference | None:
    """Position and attitude by PX4's own estimator; its heights are above sea level."""
    attitude = log.first("vehicle_attitude")
    turned = None
    if attitude is not None and attitude.has("q[0]", "q[3]"):
        quaternions = attitude.vector("q[0]", "q[1]", "q[2]", "q[3]")
        turned = attitude.time_us, sensors.enu_flu_attitude(quaternions)
    for table in (log.first("vehicle_local_position"), log.first("vehicle_global_position")):
        if table is not None and (placed := _place(table, undulation)) is not None:
            return opinion("PX4's own estimator", (table.time_us, *placed), turned)
    return opinion("PX4's own estimator", None, turned)


def _place(table: Table, undulation: float) -> tuple[Array, Array] | None:
    """Positions (N, 3) and velocities ENU (N, 3); NaN where the estimator marks them as invalid. None if all are."""
    if table.name == "vehicle_local_position" and table.has("x", "ref_lat", "ref_lon", "ref_alt", "xy_global"):
        start = np.column_stack([np.radians(table.vector("ref_lat", "ref_lon")), table.number("ref_alt")])
        position = shift(start, sensors.enu(table.vector("x", "y", "z")))
        good = (table.number("xy_global") > 0.0) & (table.number("xy_valid", default=1.0) > 0.0)
        velocity = sensors.enu(table.vector("vx", "vy", "vz"))
    elif table.name == "vehicle_global_position" and table.has("lat", "lon", "alt"):
        position = np.column_stack([np.radians(table.vector("lat", "lon")), table.number("alt")])
        good = table.number("lat_lon_valid", default=1.0) > 0.0
        velocity = sensors.enu(table.vector("vel_n", "vel_e", "vel_d"))
    else:
        return None
    good = good & np.isfinite(position).all(axis=1)
    position[:, 2] += undulation
    position[~good] = np.nan
    return (position, velocity) if good.any() else None
