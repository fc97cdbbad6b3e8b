"""Each driver's parameter file against messages as that driver sends them: the navigator gets aided, honestly."""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped

from driver_types import GPS_FIX, GPSRAW, NAV_PVT, SENSOR_COMBINED, SENSOR_GPS, STORE, make, sent
from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, update
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuSample,
    MagSample,
    PressureSample,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.engine.solutions import Event, Mode, NavSolution
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.ros import inputs
from nav_pose_estimator.ros.messages import message_table
from nav_pose_estimator.ros.messages.sample_messages import TOPICS, to_message
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import SCENARIOS, generate

Drive = Callable[[Sample], Iterator[tuple[str, Any]]]
FLU_TO_FRD = np.array([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def flight() -> Recording:
    return generate("laps", duration=100.0, seed=3, imu_rate=50.0)


def plain(sample: Sample) -> Iterator[tuple[str, Any]]:
    yield TOPICS[type(sample)][0], to_message(sample)


def mavros(sample: Sample) -> Iterator[tuple[str, Any]]:
    """No covariances, no vertical velocity, a count of 255 now and then, IMU covariances that are no noise."""
    for topic, message in plain(sample):
        if isinstance(sample, ImuSample):
            message.angular_velocity_covariance[::4] = 1.2e-7
            message.linear_acceleration_covariance[::4] = 9e-8
        elif isinstance(sample, GnssFix):
            message.position_covariance[:] = 0.0
            message.position_covariance[0] = -1.0
            message.position_covariance_type = 0
        elif isinstance(sample, GnssVelocity):
            linear = message.twist.twist.linear
            message = TwistStamped(header=message.header)
            message.twist.linear.x, message.twist.linear.y = linear.x, linear.y
        elif isinstance(sample, SatelliteCount) and message.data % 16 == 0:
            message.data = 255
        yield topic, message


def ublox(sample: Sample) -> Iterator[tuple[str, Any]]:
    """Diagonal covariances, an angular part marked -1, the count in NavPVT."""
    for topic, message in plain(sample):
        if isinstance(sample, GnssVelocity):
            message.twist.covariance[21] = -1.0
        elif isinstance(sample, GnssFix):
            message.position_covariance_type = 2
        elif isinstance(sample, SatelliteCount):
            message = sent(make(NAV_PVT, num_sv=sample.count, fix_type=3, i_tow=1))
        yield topic, message


class GpsUmd:
    """One GPSFix for position, velocity and count, errors at 95 %; it comes on three topics that are one."""

    def __init__(self) -> None:
        self.fix: GnssFix | None = None
        self.velocity: GnssVelocity | None = None

    def __call__(self, sample: Sample) -> Iterator[tuple[str, Any]]:
        if isinstance(sample, GnssFix):
            self.fix = sample
        elif isinstance(sample, GnssVelocity):
            self.velocity = sample
        elif isinstance(sample, SatelliteCount):
            message = self.message(sample.count)
            yield from ((topic, message) for topic in ("gps/satellites", "gps/vel", "gps/fix"))
        else:
            yield from plain(sample)

    def message(self, count: int) -> Any:
        east, north, up = self.velocity.vel_enu
        stamp = STORE.types["builtin_interfaces/msg/Time"](*divmod(self.fix.stamp_ns, 10**9))
        return sent(
            make(
                GPS_FIX,
                header=STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id="gps"),
                status=make("gps_msgs/msg/GPSStatus", status=0, satellites_used=count),
                latitude=math.degrees(self.fix.lat),
                longitude=math.degrees(self.fix.lon),
                altitude=self.fix.alt,
                track=math.degrees(math.atan2(east, north)) % 360.0,
                speed=math.hypot(east, north),
                climb=up,
                err_speed=0.2,
                err_climb=0.3,
            )
        )


class Px4:
    """FRD, NED, microseconds, single precision, one SensorGps; no magnetometer, no barometer."""

    def __init__(self, gps: str = SENSOR_GPS) -> None:
        self.gps = gps
        self.fix: GnssFix | None = None
        self.velocity: GnssVelocity | None = None

    def __call__(self, sample: Sample) -> Iterator[tuple[str, Any]]:
        if isinstance(sample, ImuSample):
            yield (
                "imu/data_raw",
                sent(
                    make(
                        SENSOR_COMBINED,
                        timestamp=sample.stamp_ns // 1000,
                        gyro_rad=(np.array(sample.gyro) * FLU_TO_FRD).astype(np.float32),
                        accelerometer_m_s2=(np.array(sample.accel) * FLU_TO_FRD).astype(np.float32),
                    )
                ),
            )
        elif isinstance(sample, GnssFix):
            self.fix = sample
        elif isinstance(sample, GnssVelocity):
            self.velocity = sample
        elif isinstance(sample, SatelliteCount):
            message = self.message(sample.count)
            yield from ((topic, message) for topic in ("gps/satellites", "gps/vel", "gps/fix"))

    def message(self, count: int) -> Any:
        east, north, up = self.velocity.vel_enu
        lat, lon, height = math.degrees(self.fix.lat), math.degrees(self.fix.lon), self.fix.alt
        if self.gps == SENSOR_GPS:
            where = {"latitude_deg": lat, "longitude_deg": lon, "altitude_ellipsoid_m": height}
        else:
            where = {"lat": round(lat * 1e7), "lon": round(lon * 1e7), "alt_ellipsoid": round(height * 1e3)}
        return sent(
            make(
                self.gps,
                timestamp=self.fix.stamp_ns // 1000,
                fix_type=3,
                eph=0.9,
                epv=1.5,
                vel_n_m_s=north,
                vel_e_m_s=east,
                vel_d_m_s=-up,
                vel_ned_valid=True,
                s_variance_m_s=0.2,
                satellites_used=count,
                **where,
            )
        )


def fly(
    parameters: Parameters, flight: Recording, drive: Drive
) -> tuple[PoseEstimator, list[NavSolution], list[Event]]:
    """The flight through the driver's messages and the adapters that the parameters choose."""
    chosen = message_table.sources(parameters)
    adapters = {source.topic: source.adapter for source in chosen}
    engine, solutions, events = PoseEstimator(parameters), [], []
    for sample in flight.samples(blocks=False):
        for topic, message in drive(sample):
            for item in adapters[topic](message):
                outputs = [item] if isinstance(item, Event) else engine.feed(item)
                solutions += [o for o in outputs if isinstance(o, NavSolution)]
                events += [o for o in outputs if isinstance(o, Event)]
    return engine, solutions, events


@pytest.mark.parametrize(
    ("name", "make_drive"),
    [
        ("mavros", lambda: mavros),
        ("ublox", lambda: ublox),
        ("gps_umd", GpsUmd),
        ("px4", Px4),
        ("px4", lambda: Px4("px4_msgs/msg/SensorGps114")),
    ],
    ids=["mavros", "ublox", "gps_umd", "px4", "px4_1_14"],
)
def test_a_flight_as_the_driver_sends_it_is_aided(repository: Path, flight, name, make_drive):
    parameters = load_parameters(repository / "config" / f"driver_{name}.yaml")
    # the simulated receiver has no latency, whatever the driver of this name has
    delayed = flight_with_delay(flight, parameters.gnss.delay)
    engine, solutions, events = fly(parameters, delayed, make_drive())
    assert solutions[-1].mode is Mode.AIDED, engine.status()
    assert not [event for event in events if ".rejected" in event.name and event.name.startswith(("imu", "gnss.pos"))]
    last = solutions[-1]
    where = lla_to_enu(last.lat, last.lon, last.alt, *flight.origin)
    i = int(np.searchsorted(flight.imu.stamps_ns, last.stamp_ns))
    truth = flight.truth
    true = lla_to_enu(truth.lat[i], truth.lon[i], truth.alt[i], *flight.origin)
    assert math.dist(where[:2], true[:2]) < 4.0
    assert math.degrees(angle_between(last.q_nb, truth.q_nb[i])) < 10.0


@pytest.mark.parametrize(
    ("name", "make_drive"),
    [("mavros", lambda: mavros), ("ublox", lambda: ublox), ("px4", Px4)],
    ids=["mavros", "ublox", "px4"],
)
def test_fixes_stamped_in_the_past_are_refused_with_a_sentence_about_clocks(repository, flight, name, make_drive):
    """GIVEN a driver whose clock is 30 s behind WHEN it publishes fixes THEN none is used, and the pilot reads why."""
    parameters = load_parameters(repository / "config" / f"driver_{name}.yaml")
    drive = make_drive()

    def behind(sample: Sample) -> Iterator[tuple[str, Any]]:
        late = isinstance(sample, (GnssFix, GnssVelocity, SatelliteCount)) and sample.stamp_ns
        return drive(replace(sample, stamp_ns=sample.stamp_ns - 30 * 10**9) if late else sample)

    engine, solutions, events = fly(parameters, flight, behind)
    assert solutions == []
    status = engine.status()
    assert status.counters["gnss.rejected.age"] > 100
    assert re.fullmatch(
        r"its stamps are 30\.\d s behind the IMU's: clocks that are not synchronised", status.gnss_refusal
    )
    assert any("behind the IMU's" in event.text for event in events)


def test_a_gpsraw_gives_the_count_of_mavros_with_its_stamp():
    source = message_table.SATELLITES.source(update(Parameters(), {"gnss.gate.satellite_source": "gpsraw"}))
    assert source.adapter(sent(make(GPSRAW, satellites_visible=11)))[0].count == 11
    assert source.adapter(sent(make(GPSRAW, satellites_visible=255)))[0].count is None


def flight_with_delay(flight: Recording, delay: float) -> Recording:
    """The same flight with GNSS stamps ``delay`` later than the fixes were valid."""
    return generate(_with_latency(delay), duration=flight.truth.t[-1], seed=flight.seed, imu_rate=1.0 / flight.truth.dt)


def _with_latency(delay: float):
    story = SCENARIOS["laps"]
    return replace(story, gnss=replace(story.gnss, latency=delay))


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    return 2.0 * math.acos(min(abs(float(a @ b)), 1.0))


def test_mavros_gives_no_vertical_velocity_and_unknown_counts(repository):
    parameters = load_parameters(repository / "config" / "driver_mavros.yaml")
    adapters = {source.topic: source.adapter for source in message_table.sources(parameters)}
    ((topic, message),) = mavros(GnssVelocity(1, (3.0, 4.0, 5.0)))
    (velocity,) = adapters[topic](message)
    assert velocity.vel_enu[:2] == (3.0, 4.0)
    assert math.isnan(velocity.vel_enu[2])
    ((topic, message),) = mavros(SatelliteCount(None, 16))
    assert adapters[topic](message)[0].count is None


@pytest.mark.parametrize(
    ("name", "package", "topic"),
    [
        ("ublox", "ublox_msgs", "gps/satellites"),
        ("gps_umd", "gps_msgs", "gps/fix"),
        ("px4", "px4_msgs", "imu/data_raw"),
    ],
)
def test_a_missing_message_package_is_named_with_its_cure(repository, name, package, topic):
    pytest.importorskip("rclpy")
    try:
        __import__(package)
        pytest.skip(f"{package} is installed here")
    except ImportError:
        pass
    parameters = load_parameters(repository / "config" / f"driver_{name}.yaml")
    chosen = message_table.sources(parameters)
    source = next(item for item in chosen if item.topic == topic)
    with pytest.raises(ParameterError, match=f"{package} is not installed here; install ros-jazzy-"):
        inputs.message_class(source)


def test_magnetometer_and_barometer_pass_as_they_are(repository):
    for sample in (MagSample(5, (1e-5, 0.0, 0.0)), PressureSample(5, 95e3, 4.0)):
        ((_, message),) = mavros(sample)
        assert message.header.stamp.nanosec == 5
