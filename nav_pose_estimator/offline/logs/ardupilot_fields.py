"""Field map of ArduPilot DataFlash, Copter and Plane 3.x and 4.x. Body FRD, world NED.

Sources: LogStructure.h and Log.cpp of ArduPilot through its versions; https://ardupilot.org/copter/docs/logmessages.html.
"""

import numpy as np

from nav_pose_estimator.core.alignment.types import VERTICAL_SHARE
from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla
from nav_pose_estimator.core.numerics.axes import FRD_FLU
from nav_pose_estimator.core.numerics.rotation import quat_from_euler_many
from nav_pose_estimator.offline.flights.tracks import Reference, displacement_enu
from nav_pose_estimator.offline.logs import sensors
from nav_pose_estimator.offline.logs.formats.log_tables import LogTables, Table
from nav_pose_estimator.offline.logs.gnss_time import utc_from_gps_week
from nav_pose_estimator.offline.logs.opinion import opinion
from nav_pose_estimator.offline.logs.sensors import Array, Gnss, Imu, LogSensors, Series

RANGE_ERROR = 2.0
"""Standard deviation of a pseudorange [m]; that of the position is its product with the DOP. For logs without GPA."""
_FIX_3D = 3  # GPS.Status
_UNDEFINED_HDOP = 90.0  # receivers send 99.99 for unknown
_ARMED, _DISARMED = 10, 11  # EV.Id
_DOWN, _GOOD = 25, 4  # RFND.Orient: pitch 270 degrees; RFND.Stat
_STANDARD_CELSIUS = 15.0  # for sensors that do not measure the temperature
_GAS_CONSTANT, _SEA_LEVEL_DENSITY, _KELVIN = 287.05, 1.225, 273.15  # dry air [J/(kg K)], [kg/m^3]
_LATENCY = ("GPS_DELAY_MS", "GPS1_DELAY_MS", "EK3_VEL_DELAY", "EKF_VEL_DELAY")
_ESTIMATORS = {"XKF1": "EKF3", "NKF1": "EKF2", "EKF1": "EKF1"}
_VEHICLES = {"Copter": "multirotor", "Plane": "fixed wing", "Rover": "rover", "Sub": "submarine", "Blimp": "blimp"}


def ardupilot_sensors(log: LogTables) -> LogSensors:
    """The sensor data of the log."""
    gnss = [found for table in log.instances("GPS") if (found := _gnss(log, table)) is not None]
    receiver = max(gnss, key=lambda g: int(g.has_fix.sum()), default=None)
    return LogSensors(
        path=log.path,
        form=log.form,
        firmware=log.firmware,
        vehicle=next((kind for word, kind in _VEHICLES.items() if word in log.firmware), ""),
        imus=[imu for table in log.instances("IMU") if (imu := _imu(table)) is not None],
        gnss=gnss,
        others=[series for series in (_magnetometer(log), _barometer(log), _airspeed(log), _range(log)) if series],
        armed=_armed(log),
        opinion=_opinion(log, receiver),
        delay=sensors.known_delay(log.parameters, _LATENCY),
        antenna=_antenna(log),
        names=log.names,
        needs=("IMU", "GPS"),
        notices=log.notices,
        counters=log.counters,
    )


def _imu(table: Table) -> Imu | None:
    if not table.has("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"):
        return None
    gyro, accel = table.vector("GyrX", "GyrY", "GyrZ"), table.vector("AccX", "AccY", "AccZ")
    if table.units.get("GyrX", "").startswith("deg"):
        gyro = np.radians(gyro)
    name = f"IMU[{table.instance}]"
    imu = sensors.make_imu(name, table.time_us, gyro, accel)
    return imu if len(imu.time_us) > 1 and np.any(imu.accel) else None


def _gnss(log: LogTables, table: Table) -> Gnss | None:
    if not table.has("Status", "Lat", "Lng", "Alt"):
        return None
    latitude, longitude, height = table.number("Lat"), table.number("Lng"), table.number("Alt")
    has_fix = (table.number("Status") >= _FIX_3D) & ((latitude != 0.0) | (longitude != 0.0))
    speed, course = table.number("Spd"), np.radians(table.number("GCrs"))
    velocity = np.column_stack([speed * np.sin(course), speed * np.cos(course), -table.number("VZ")])
    accuracy, undulation = _accuracy(log, table)
    week, of_week = table.whole("GWk", "Week"), table.whole("GMS")
    if not table.has("GMS") and not table.has("TimeUS"):
        of_week = table.whole("TimeMS")  # old logs: time of week, not the clock of the log
    count = table.whole("NSats", default=-1)
    return Gnss(
        name=f"GPS[{table.instance}]",
        time_us=table.time_us,
        position=np.column_stack([np.radians(latitude), np.radians(longitude), height]),
        has_fix=has_fix,
        velocity=velocity,
        accuracy=accuracy,
        satellites=np.where(count == 255, -1, count),
        utc_us=utc_from_gps_week(week, of_week),
        undulation=undulation,
        sea_level=True,
    )


def _accuracy(log: LogTables, gps: Table) -> tuple[Array, float]:
    """Standard deviations (N, 3) by the GPA message of the same epoch, else by HDop; and the undulation [m]."""
    dilution = gps.number("HDop")
    horizontal = np.where((dilution > 0.0) & (dilution < _UNDEFINED_HDOP), RANGE_ERROR * dilution, np.nan)
    accuracy = np.column_stack([horizontal, VERTICAL_SHARE * horizontal, np.full(len(gps), np.nan)])
    gpa = next((table for table in log.instances("GPA") if table.instance == gps.instance), None)
    if gpa is None or not gpa.has("HAcc", "VAcc", "SAcc") or len(gpa) == 0:
        return accuracy, np.nan
    nearest = np.clip(np.searchsorted(gpa.time_us, gps.time_us, side="right") - 1, 0, None)
    later = np.minimum(nearest + 1, len(gpa) - 1)
    closer = np.abs(gpa.time_us[later] - gps.time_us) < np.abs(gpa.time_us[nearest] - gps.time_us)
    nearest = np.where(closer, later, nearest)
    stated = gpa.vector("HAcc", "VAcc", "SAcc")[nearest]
    beside = np.abs(gpa.time_us[nearest] - gps.time_us) < 1_000_000
    stated = np.where(beside[:, None] & (stated > 0.0) & (stated < 1e4), stated, np.nan)
    und = gpa.number("Und")
    return np.where(np.isfinite(stated), stated, accuracy), float(np.median(und)) if gpa.has("Und") else np.nan


def _magnetometer(log: LogTables) -> Series | None:
    """The first compass with data that are not zero, in milligauss with offsets applied."""
    for table in log.instances("MAG"):
        if table.has("MagX", "MagY", "MagZ"):
            scale = 1.0 if table.units.get("MagX") == "Gauss" else 1e-3
            found = sensors.magnetometer(table, table.vector("MagX", "MagY", "MagZ") * scale)
            if found is not None:
                return found
    return None


def _barometer(log: LogTables) -> Series | None:
    table = log.first("BARO")
    return sensors.barometer(table, table.number("Press")) if table is not None and table.has("Press") else None


def _airspeed(log: LogTables) -> Series | None:
    """True airspeed, from the equivalent airspeed ARSP.Airspeed and the density of the air at the barometer."""
    table, baro = log.first("ARSP"), log.first("BARO")
    if table is None or not table.has("Airspeed") or baro is None or not baro.has("Press"):
        return None
    pressure = np.interp(table.time_us, baro.time_us, baro.number("Press"))
    # outside temperature of the airspeed sensor if it has one; the barometer's is that of its own board
    celsius = table.number("Temp", default=0.0)
    celsius = np.where((celsius > -60.0) & (celsius < 60.0) & (celsius != 0.0), celsius, _STANDARD_CELSIUS)
    density = pressure / (_GAS_CONSTANT * (celsius + _KELVIN))
    speed = table.number("Airspeed")
    good = (speed >= 0.0) & (table.number("H", "Health", default=1.0) > 0.0) & (density > 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return sensors.airspeed(table, speed * np.sqrt(_SEA_LEVEL_DENSITY / density), good)


def _range(log: LogTables) -> Series | None:
    """The downward rangefinder; its distances with good status or, in old logs, that are not zero."""
    for table in log.instances("RFND"):
        distance = table.number("Dist", "Dist1")
        down = table.number("Orient", "Orient1", default=float(_DOWN)) == _DOWN
        good = down & (table.number("Stat", "Stat1", default=float(_GOOD)) == _GOOD) & (distance > 0.0)
        if good.any():
            return sensors.range_to_ground(table, distance, 0.0, np.full(len(table), np.nan), good)
    return None


def _armed(log: LogTables) -> list[tuple[int, int]] | None:
    """Armed intervals by ARM messages (since 4.0), else by the events 10 and 11; None if neither is logged."""
    table = log.first("ARM")
    if table is not None and table.has("ArmState"):
        return _closed(log, sensors.armed_spans(table.time_us, table.number("ArmState") > 0.0))
    table = log.first("EV")
    if table is None or not table.has("Id"):
        return None
    event = table.number("Id")
    arming = (event == _ARMED) | (event == _DISARMED)
    return _closed(log, sensors.armed_spans(table.time_us[arming], event[arming] == _ARMED)) if arming.any() else None


def _closed(log: LogTables, spans: list[tuple[int, int]] | None) -> list[tuple[int, int]] | None:
    """Armed intervals, of which the last one extends to the end of the log if there is no disarming."""
    imu = log.first("IMU")
    if spans and imu is not None and spans[-1][1] <= spans[-1][0]:
        spans[-1] = (spans[-1][0], max(int(imu.time_us.max()), spans[-1][0]))
    return spans


def _antenna(log: LogTables) -> tuple[float, float, float] | None:
    """Lever arm from the first IMU to the antenna, FLU [m]; None if the parameters do not contain it."""
    values = [
        log.parameters.get(f"GPS_POS1_{axis}", log.parameters.get(f"GPS1_POS_{axis}", 0.0))
        - log.parameters.get(f"INS_POS1_{axis}", 0.0)
        for axis in "XYZ"
    ]
    return tuple((np.array(values) * FRD_FLU).tolist()) if any(values) else None


def _opinion(log: LogTables, receiver: Gnss | None) -> Reference | None:
    """Attitude by ATT; position by the newest of the Kalman filters that was running."""
    attitude, turned = log.first("ATT"), None
    if attitude is not None and attitude.has("Roll", "Pitch", "Yaw"):
        angles = np.radians(attitude.vector("Roll", "Pitch", "Yaw"))
        turned = attitude.time_us, sensors.enu_flu_attitude(quat_from_euler_many(*angles.T))
    for name, words in _ESTIMATORS.items():
        table = log.first(name)
        if table is not None and table.has("PN", "PE", "PD", "VN", "VE", "VD"):
            placed = _place(log, table, receiver)
            return opinion(f"ArduPilot's {words}", placed, turned)
    return opinion("ArduPilot's own estimator", None, turned)


def _place(log: LogTables, table: Table, receiver: Gnss | None) -> tuple[Array, Array, Array] | None:
    """Times, positions and velocities. The origin is logged since 3.5 (ORGN); before, it is fitted to the fixes."""
    local = sensors.enu(table.vector("PN", "PE", "PD"))
    velocity = sensors.enu(table.vector("VN", "VE", "VD"))
    origin = _logged_origin(log)
    if origin is None and receiver is not None:
        origin = _fitted_origin(table.time_us, local, receiver)
    if origin is None:
        return None
    return table.time_us, np.stack(enu_to_lla(local, *origin), axis=-1), velocity


def _logged_origin(log: LogTables) -> tuple[float, float, float] | None:
    """The origin of the Kalman filter: ORGN of type 0."""
    for table in log.instances("ORGN"):
        if table.has("Lat", "Lng", "Alt") and np.all(table.number("Type", default=0.0) == 0.0):
            lat, lon, alt = (float(table.number(name)[-1]) for name in ("Lat", "Lng", "Alt"))
            if lat or lon:
                return float(np.radians(lat)), float(np.radians(lon)), alt
    return None


def _fitted_origin(time_us: Array, local: Array, receiver: Gnss) -> tuple[float, float, float] | None:
    fixes = receiver.has_fix & (receiver.time_us >= time_us[0]) & (receiver.time_us <= time_us[-1])
    if not fixes.any():
        return None
    start = receiver.position[fixes][0]
    there = np.stack([np.interp(receiver.time_us[fixes], time_us, local[:, i]) for i in range(3)], axis=-1)
    offset = np.median(displacement_enu(receiver.position[fixes], start) - there, axis=0)
    lat, lon, alt = enu_to_lla(offset, *start.tolist())
    return float(lat), float(lon), float(alt)
