"""Flight logs written from a simulated flight: PX4 ULog and ArduPilot DataFlash, of old and of new firmware."""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, MagSample, PressureSample, SatelliteCount
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate

BOOT_US = 12_000_000  # clock of the log when the flight begins
UTC_US = 1_700_000_000_000_000  # GNSS time at that moment
LATENCY_MS = 130.0
FRD = np.array([1.0, -1.0, -1.0])

# --- ULog ------------------------------------------------------------------------------------------------------------

ULOG_HEAD = b"ULog\x01\x12\x35\x01"
_ULOG_TYPES = {
    "uint64_t": "<u8",
    "int64_t": "<i8",
    "int32_t": "<i4",
    "uint32_t": "<u4",
    "float": "<f4",
    "double": "<f8",
    "uint8_t": "u1",
    "int8_t": "i1",
    "bool": "u1",
}


@dataclass
class Ulog:
    """Topics to be written; ``add`` takes times [µs] and columns with their ULog types."""

    parameters: dict[str, float] = field(default_factory=dict)
    topics: list[tuple[str, int, list[tuple[str, str]], np.ndarray]] = field(default_factory=list)

    def add(self, name: str, time_us, columns: dict[str, tuple[str, Sequence | np.ndarray]], multi_id: int = 0) -> None:
        """``columns``: (type, values) by name; values (N, 3) for a type such as ``float[3]``."""
        spec = [("uint64_t", "timestamp"), *((kind, column) for column, (kind, _) in columns.items())]
        dtype = []
        for kind, column in spec:
            base, _, size = kind.partition("[")
            shape = (int(size.rstrip("]")),) if size else ()
            dtype.append((column, _ULOG_TYPES[base], shape))
        rows = np.zeros(len(time_us), np.dtype(dtype))
        rows["timestamp"] = time_us
        for column, (_, values) in columns.items():
            rows[column] = values
        self.topics.append((name, multi_id, spec, rows))

    def encode(self) -> bytes:
        """The file."""
        parts = [ULOG_HEAD, struct.pack("<Q", BOOT_US), _ulog_message("B", bytes(40))]
        for name, spec in {name: spec for name, _, spec, _ in self.topics}.items():
            fields = "".join(f"{kind} {column};" for kind, column in spec)
            parts.append(_ulog_message("F", f"{name}:{fields}".encode()))
        parts.append(_ulog_key("I", "char[3] sys_name", b"PX4"))
        for key, value in self.parameters.items():
            parts.append(_ulog_key("P", f"float {key}", struct.pack("<f", value)))
        messages = []
        for number, (name, multi_id, _, rows) in enumerate(self.topics):
            parts.append(_ulog_message("A", struct.pack("<BH", multi_id, number) + name.encode()))
            size = rows.dtype.itemsize
            raw = rows.tobytes()
            for i, time_us in enumerate(rows["timestamp"].tolist()):
                body = struct.pack("<H", number) + raw[i * size : (i + 1) * size]
                messages.append((time_us, _ulog_message("D", body)))
        messages.sort(key=lambda item: item[0])
        return b"".join(parts) + b"".join(message for _, message in messages)


def _ulog_message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def _ulog_key(kind: str, key: str, value: bytes) -> bytes:
    return _ulog_message(kind, bytes([len(key)]) + key.encode() + value)


# --- DataFlash -------------------------------------------------------------------------------------------------------

_LETTERS = {
    "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d", "n": "4s", "N": "16s", "Z": "64s",
    "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B", "q": "q", "Q": "Q",
}  # fmt: skip
_FACTORS = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}


@dataclass
class DataFlash:
    """Messages to be written, with the values that a reader must return."""

    formats: dict[str, tuple[int, str, str]] = field(default_factory=dict)
    messages: list[tuple[float, int, str, tuple]] = field(default_factory=list)

    def define(self, name: str, letters: str, columns: str) -> None:
        """An FMT message."""
        kind = 128 if name == "FMT" else 129 + len(self.formats)
        self.formats[name] = (kind, letters, columns)

    def add(self, time_us: float, name: str, *values) -> None:
        """One message; ``time_us`` only orders it."""
        assert len(values) == len(self.formats[name][1]), name
        self.messages.append((time_us, len(self.messages), name, values))

    def _in_order(self):
        self.define_fmt()
        for name, (kind, letters, columns) in self.formats.items():
            length = 3 + struct.calcsize("<" + "".join(_LETTERS[c] for c in letters))
            yield "FMT", (kind, length, name, letters, columns)
        yield from ((name, values) for _, _, name, values in sorted(self.messages, key=lambda m: m[:2]))

    def define_fmt(self) -> None:
        if "FMT" not in self.formats:
            self.formats = {"FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"), **self.formats}

    def encode(self) -> bytes:
        """The binary file."""
        return b"".join(self._pack(name, values) for name, values in self._in_order())

    def _pack(self, name: str, values: tuple) -> bytes:
        kind, letters, _ = self.formats[name]
        packed = []
        for letter, value in zip(letters, values, strict=True):
            if letter in "nNZ":
                packed.append(str(value).encode())
            elif letter in "fd":
                packed.append(float(value))
            else:
                packed.append(round(float(value) * _FACTORS.get(letter, 1.0)))
        return bytes([0xA3, 0x95, kind]) + struct.pack("<" + "".join(_LETTERS[c] for c in letters), *packed)

    def text(self) -> str:
        """The same as a text log."""
        lines = []
        for name, values in self._in_order():
            letters = self.formats[name][1]
            texts = [
                str(v) if c in "nNZ" else repr(float(v)) if c in "fdcCeEL" else str(round(v))
                for c, v in zip(letters, values, strict=True)
            ]
            lines.append(", ".join([name, *texts]))
        return "\n".join(lines) + "\n"


# --- a flight --------------------------------------------------------------------------------------------------------


@dataclass
class Flight:
    """A simulated flight in the units of autopilot logs: FRD, NED, microseconds of the log's clock at reception."""

    recording: Recording
    imu_us: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    gnss_us: np.ndarray
    place: np.ndarray  # (M, 3) degrees, degrees, metres
    ned: np.ndarray  # (M, 3) m/s
    utc_us: np.ndarray  # (M,) of validity
    mag_us: np.ndarray
    gauss: np.ndarray
    baro_us: np.ndarray
    pascal: np.ndarray


def flight(seconds: float = 60.0, rate: float = 100.0, seed: int = 3, clock: float = 1.0) -> Flight:
    """``clock``: seconds of the log in a true second."""
    recording = generate("multirotor_outage", seconds, seed, "icm42688", rate)
    start = recording.start_ns

    def log_us(stamps) -> np.ndarray:
        true = (np.asarray(stamps, np.int64) - start) * 1e-3
        return np.round(BOOT_US + true * clock).astype(np.int64)

    def of(kind):
        return [timed for timed in recording.others if type(timed.sample) is kind]

    # all messages of one epoch of the receiver have the stamp of the fix
    fixes, velocities, mags, baros = of(GnssFix), of(GnssVelocity), of(MagSample), of(PressureSample)
    by_stamp = {timed.sample.stamp_ns: timed.sample for timed in velocities}
    fixes = [timed for timed in fixes if timed.sample.stamp_ns in by_stamp]
    v = np.array([by_stamp[timed.sample.stamp_ns].vel_enu for timed in fixes])
    late = round(LATENCY_MS * 1e6)
    place = [(math.degrees(f.sample.lat), math.degrees(f.sample.lon), f.sample.alt) for f in fixes]
    assert of(SatelliteCount)
    return Flight(
        recording=recording,
        imu_us=log_us(recording.imu.stamps_ns),
        gyro=recording.imu.gyro * FRD,
        accel=recording.imu.accel * FRD,
        gnss_us=log_us([f.sample.stamp_ns + late for f in fixes]),
        place=np.array(place),
        ned=np.column_stack([v[:, 1], v[:, 0], -v[:, 2]]),
        utc_us=np.array([UTC_US + (f.sample.stamp_ns - start) // 1000 for f in fixes], np.int64),
        mag_us=log_us([m.arrival_ns for m in mags]),
        gauss=np.array([m.sample.field for m in mags]) * FRD * 1e4,
        baro_us=log_us([b.arrival_ns for b in baros]),
        pascal=np.array([b.sample.pressure for b in baros]),
    )


def px4(flown: Flight, new: bool = True, imu: bool = True, gnss: bool = True) -> Ulog:
    """A log of PX4 1.15 (``new``) or 1.8."""
    log = Ulog({"EKF2_GPS_DELAY": LATENCY_MS, "MAV_TYPE": 2.0})
    if imu:
        log.add(
            "sensor_combined",
            flown.imu_us,
            {
                "gyro_rad": ("float[3]", flown.gyro),
                "accelerometer_timestamp_relative": ("int32_t", np.zeros(len(flown.imu_us))),
                "accelerometer_m_s2": ("float[3]", flown.accel),
            },
        )
    if gnss:
        log.add("vehicle_gps_position", flown.gnss_us, px4_gnss(flown, new))
    log.add("vehicle_magnetometer", flown.mag_us, {"magnetometer_ga": ("float[3]", flown.gauss)})
    log.add("vehicle_air_data", flown.baro_us, {"baro_pressure_pa": ("float", flown.pascal)})
    _px4_opinion(log, flown)
    every = np.arange(flown.imu_us[0], flown.imu_us[-1], 500_000)
    log.add("vehicle_status", every, {"arming_state": ("uint8_t", np.where(every > BOOT_US + 5_000_000, 2, 1))})
    return log


def px4_gnss(flown: Flight, new: bool) -> dict:
    """Columns of ``vehicle_gps_position``."""
    count, lat, lon, alt = len(flown.gnss_us), *flown.place.T
    if new:
        place = {
            "latitude_deg": ("double", lat),
            "longitude_deg": ("double", lon),
            "altitude_msl_m": ("double", alt - 46.0),
            "altitude_ellipsoid_m": ("double", alt),
        }
    else:
        place = {
            "lat": ("int32_t", np.round(lat * 1e7)),
            "lon": ("int32_t", np.round(lon * 1e7)),
            "alt": ("int32_t", np.round((alt - 46.0) * 1e3)),
            "alt_ellipsoid": ("int32_t", np.round(alt * 1e3)),
        }
    return {
        **place,
        "time_utc_usec": ("uint64_t", flown.utc_us),
        "s_variance_m_s": ("float", np.full(count, 0.3)),
        "eph": ("float", np.full(count, 1.2)),
        "epv": ("float", np.full(count, 2.0)),
        "vel_n_m_s": ("float", flown.ned[:, 0]),
        "vel_e_m_s": ("float", flown.ned[:, 1]),
        "vel_d_m_s": ("float", flown.ned[:, 2]),
        "fix_type": ("uint8_t", np.full(count, 3)),
        "vel_ned_valid": ("bool", np.ones(count)),
        "satellites_used": ("uint8_t", np.full(count, 14)),
    }


def _px4_opinion(log: Ulog, flown: Flight) -> None:
    """An estimate with an error of ten metres North."""
    truth = flown.recording.truth
    rows = np.arange(0, len(truth), 10)
    enu = truth.position_enu(flown.recording.origin)[rows]
    lat, lon, alt = flown.recording.origin
    count = len(rows)
    log.add(
        "vehicle_local_position",
        flown.imu_us[rows],
        {
            "ref_lat": ("double", np.full(count, math.degrees(lat))),
            "ref_lon": ("double", np.full(count, math.degrees(lon))),
            "ref_alt": ("float", np.full(count, alt - 46.0)),
            "x": ("float", enu[:, 1] + 10.0),
            "y": ("float", enu[:, 0]),
            "z": ("float", -enu[:, 2]),
            "vx": ("float", truth.v_n[rows, 1]),
            "vy": ("float", truth.v_n[rows, 0]),
            "vz": ("float", -truth.v_n[rows, 2]),
            "xy_valid": ("bool", np.ones(count)),
            "xy_global": ("bool", np.ones(count)),
        },
    )
    log.add("vehicle_attitude", flown.imu_us[rows], {"q": ("float[4]", _ned_frd(truth.q_nb[rows]))})


def _ned_frd(q_enu_flu: np.ndarray) -> np.ndarray:
    """Convert the attitude from FLU to ENU into FRD to NED, by matrices, unlike the code under test."""
    w, x, y, z = q_enu_flu.T
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    axes = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    turned = axes @ matrix @ np.diag(FRD)
    w = 0.5 * np.sqrt(np.maximum(1.0 + turned[:, 0, 0] + turned[:, 1, 1] + turned[:, 2, 2], 1e-12))
    x = (turned[:, 2, 1] - turned[:, 1, 2]) / (4.0 * w)
    y = (turned[:, 0, 2] - turned[:, 2, 0]) / (4.0 * w)
    z = (turned[:, 1, 0] - turned[:, 0, 1]) / (4.0 * w)
    return np.column_stack([w, x, y, z])


GPS_EPOCH_US, LEAP_US, WEEK_US = 315_964_800_000_000, 18_000_000, 604_800_000_000


def ardupilot(flown: Flight, new: bool = True, second_imu_noise: float | None = None) -> DataFlash:
    """A log of ArduCopter 4.x (``new``) or 3.3. A second IMU may be noisier than the first."""
    log = DataFlash()
    log.define("PARM", *(("QNff", "TimeUS,Name,Value,Default") if new else ("Nf", "Name,Value")))
    log.define("MSG", *(("QZ", "TimeUS,Message") if new else ("Z", "Message")))
    time = "TimeUS" if new else "TimeMS"
    q, scale = ("Q", 1.0) if new else ("I", 1e-3)
    version = "ArduCopter V4.3.7 (01234567)" if new else "APM:Copter V3.3 (01234567)"
    log.add(0, "MSG", *([BOOT_US, version] if new else [version]))
    name = "GPS1_DELAY_MS" if new else "EKF_VEL_DELAY"
    log.add(0, "PARM", *([BOOT_US, name, LATENCY_MS, 0.0] if new else [name, LATENCY_MS]))
    _imus(log, flown, new, q, time, scale, second_imu_noise)
    _gps(log, flown, new)
    log.define("MAG", q + ("B" if new else "") + "hhh", time + (",I" if new else "") + ",MagX,MagY,MagZ")
    for t, value in zip(flown.mag_us.tolist(), (flown.gauss * 1e3).tolist(), strict=True):
        log.add(t, "MAG", t * scale, *([0] if new else []), *value)
    log.define("BARO", q + ("B" if new else "") + "ff", time + (",I" if new else "") + ",Alt,Press")
    for t, value in zip(flown.baro_us.tolist(), flown.pascal.tolist(), strict=True):
        log.add(t, "BARO", t * scale, *([0] if new else []), 0.0, value)
    _estimates(log, flown, new, q, time, scale)
    if new:
        log.define("ARM", "QB", "TimeUS,ArmState")
        log.add(BOOT_US + 5e6, "ARM", BOOT_US + 5_000_000, 1)
    else:
        log.define("EV", "B", "Id")
        log.add(BOOT_US + 5e6, "EV", 10)
    return log


def _imus(log: DataFlash, flown: Flight, new: bool, q: str, time: str, scale: float, noise: float | None) -> None:
    axes = ",GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    log.define("IMU", q + ("B" if new else "") + "ffffff", time + (",I" if new else "") + axes)
    if noise is not None and not new:
        log.define("IMU2", q + "ffffff", time + axes)
    random = np.random.default_rng(5)
    for t, gyro, accel in zip(flown.imu_us.tolist(), flown.gyro, flown.accel, strict=True):
        log.add(t, "IMU", t * scale, *([0] if new else []), *gyro, *accel)
        if noise is not None:
            worse = gyro + noise * random.standard_normal(3)
            log.add(t, "IMU" if new else "IMU2", t * scale, *([1] if new else []), *worse, *accel)


def _gps(log: DataFlash, flown: Flight, new: bool) -> None:
    gps_us = flown.utc_us - GPS_EPOCH_US + LEAP_US
    if new:
        log.define("GPS", "QBBIHBcLLeffff", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw")
        log.define("GPA", "QBCCCC", "TimeUS,I,VDop,HAcc,VAcc,SAcc")
    else:
        log.define("GPS", "BIHBcLLeeEefI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T")
    for t, gnss, (lat, lon, alt), ned in zip(flown.gnss_us.tolist(), gps_us, flown.place, flown.ned, strict=True):
        week, ms = divmod(int(gnss) // 1000, WEEK_US // 1000)
        speed, course = math.hypot(ned[0], ned[1]), math.degrees(math.atan2(ned[1], ned[0])) % 360.0
        if new:
            log.add(t, "GPS", t, 0, 3, ms, week, 14, 0.7, lat, lon, alt, speed, course, ned[2], 0.0)
            log.add(t, "GPA", t, 0, 1.0, 1.2, 2.0, 0.3)
        else:
            log.add(t, "GPS", 3, ms, week, 14, 0.7, lat, lon, 0.0, alt, speed, course, ned[2], t / 1000)


def _estimates(log: DataFlash, flown: Flight, new: bool, q: str, time: str, scale: float) -> None:
    """An estimate with an error of ten metres North; an old log does not contain its origin."""
    name = "XKF1" if new else "EKF1"
    log.define(name, q + ("B" if new else "") + "ffffff", time + (",C" if new else "") + ",VN,VE,VD,PN,PE,PD")
    truth = flown.recording.truth
    enu = truth.position_enu(flown.recording.origin)
    for i in range(0, len(truth), 10):
        t = int(flown.imu_us[i])
        v, p = truth.v_n[i], enu[i]
        log.add(t, name, t * scale, *([0] if new else []), v[1], v[0], -v[2], p[1] + 10.0 * new, p[0], -p[2])
    if new:
        lat, lon, alt = flown.recording.origin
        log.define("ORGN", "QBLLe", "TimeUS,Type,Lat,Lng,Alt")
        log.add(BOOT_US, "ORGN", BOOT_US, 0, math.degrees(lat), math.degrees(lon), alt)


def write(path: Path, content: bytes | str) -> Path:
    """``content`` as a file."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path
