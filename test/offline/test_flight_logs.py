"""Flight logs of four kinds of firmware hold one simulated flight: the samples that come out are those that went in."""

from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import (
    Airspeed,
    MagSample,
    PressureSample,
    RangeToGround,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.flights.tracks import Reference, displacement_enu
from nav_pose_estimator.offline.logs.open_recording import open_recording, read_sensors
from nav_pose_estimator.offline.logs.options import LogOptions
from small_logs import LATENCY_MS, UTC_US, Flight, ardupilot, flight, px4, px4_gnss, write

KINDS = {
    "px4_new.ulg": lambda flown: px4(flown, new=True).encode(),
    "px4_old.ulg": lambda flown: px4(flown, new=False).encode(),
    "ardupilot_new.bin": lambda flown: ardupilot(flown, new=True).encode(),
    "ardupilot_old.BIN": lambda flown: ardupilot(flown, new=False).encode(),
    "ardupilot_new.log": lambda flown: ardupilot(flown, new=True).text(),
}


@pytest.fixture(scope="module")
def flown() -> Flight:
    return flight(30.0)


@pytest.fixture(scope="module", params=KINDS)
def log(request, flown, tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("logs") / request.param, KINDS[request.param](flown))


@pytest.fixture(scope="module")
def recording(log) -> Recording:
    return open_recording(log, LogOptions())


def of(recording: Recording, kind: type) -> list:
    return [sample for sample in recording.samples if type(sample) is kind]


# --- the samples -----------------------------------------------------------------------------------------------------


def test_the_imu_is_that_of_the_flight(recording, flown):
    assert recording.imu_count == len(flown.imu_us)
    np.testing.assert_allclose(recording.imu.gyro, flown.recording.imu.gyro, atol=1e-6)
    np.testing.assert_allclose(recording.imu.accel, flown.recording.imu.accel, atol=1e-5)
    seconds = (recording.imu.stamps_ns - recording.imu.stamps_ns[0]) * 1e-9
    np.testing.assert_allclose(seconds, (flown.imu_us - flown.imu_us[0]) * 1e-6, atol=1.1e-3)  # old logs: milliseconds


def test_positions_and_velocities_are_those_of_the_receiver(recording, flown):
    place = np.array([(fix.lat, fix.lon, fix.alt) for fix in recording.fixes])
    assert all(fix.status == 0 for fix in recording.fixes)
    given = np.column_stack([np.radians(flown.place[:, :2]), flown.place[:, 2]])
    assert np.abs(displacement_enu(place, given)).max() < 0.02
    enu = np.column_stack([flown.ned[:, 1], flown.ned[:, 0], -flown.ned[:, 2]])
    found = np.array([velocity.vel_enu for velocity in recording.velocities])
    assert np.abs(found - enu).max() < 0.012  # old logs: speed and course in hundredths


def test_accuracy_is_a_deviation_as_the_receiver_states_it(recording, log):
    fix, velocity = recording.fixes[0], recording.velocities[0]
    if log.name == "ardupilot_old.BIN":  # only HDop
        assert np.sqrt(fix.cov_enu[0, 0]) == pytest.approx(1.4)
        assert velocity.cov_enu is None
    else:
        np.testing.assert_allclose(np.sqrt(np.diag(fix.cov_enu)), [1.2, 1.2, 2.0], rtol=1e-6)
        np.testing.assert_allclose(np.sqrt(np.diag(velocity.cov_enu)), 0.3, rtol=1e-6)
    assert {sample.count for sample in of(recording, SatelliteCount)} == {14}


def test_the_other_sensors_come_in_si_units_and_our_axes(recording, flown):
    field = np.array([sample.field for sample in of(recording, MagSample)])
    np.testing.assert_allclose(field, flown.gauss * [1e-4, -1e-4, -1e-4], atol=6e-8)  # DataFlash: whole milligauss
    pressure = np.array([sample.pressure for sample in of(recording, PressureSample)])
    np.testing.assert_allclose(pressure, flown.pascal, rtol=1e-6)


def test_stamps_are_utc_and_samples_in_order(recording):
    assert abs(recording.imu.stamps_ns[0] / 1e3 - UTC_US) < 0.3e6  # the latency of the fixes is part of it
    stamps = [int(getattr(s, "stamps_ns", [getattr(s, "stamp_ns", None)])[0] or 0) for s in recording.samples]
    known = np.array([stamp for stamp in stamps if stamp])
    assert np.all(np.diff(known) >= 0)


def test_the_latency_of_the_autopilots_parameters_is_kept(recording):
    assert recording.sidecar["gnss_latency_prior_s"] == pytest.approx(LATENCY_MS * 1e-3)


def test_the_autopilots_estimate_is_no_sample(recording, flown, log):
    """GIVEN an autopilot whose estimate lies ten metres off, THEN it is a reference beside the samples, never one."""
    opinion = recording.opinion
    assert isinstance(opinion, Reference)
    assert not isinstance(opinion, Sample)
    truth = flown.recording.truth
    there = np.column_stack([np.interp(opinion.t, truth.t, column) for column in (truth.lat, truth.lon, truth.alt)])
    apart = np.median(displacement_enu(opinion.position, there), axis=0)
    # an old log does not tell the origin: it is fitted to the fixes, and then the estimate lies on them
    tolerance = 0.5 if log.name != "ardupilot_old.BIN" else 3.0
    np.testing.assert_allclose(apart, [0.0, 0.0 if log.name == "ardupilot_old.BIN" else 10.0, 0.0], atol=tolerance)


def test_px4s_attitude_is_turned_to_our_axes(flown, tmp_path):
    opinion = open_recording(write(tmp_path / "a.ulg", px4(flown).encode()), LogOptions()).opinion
    truth = flown.recording.truth.q_nb[::10][: len(opinion.t)]
    agreement = np.abs(np.sum(opinion.q_nb * truth, axis=1))
    assert agreement.min() > 1.0 - 1e-6


# --- what the firmware may do ----------------------------------------------------------------------------------------


def test_two_hertz_of_vehicle_imu_are_never_used(flown, tmp_path):
    """GIVEN vehicle_imu at 2 Hz (the default of PX4) and one at the full rate, THEN only the latter counts."""
    log = px4(flown)
    for multi_id, rows in ((0, slice(None, None, 50)), (1, slice(None))):
        count = len(flown.imu_us[rows])
        log.add(
            "vehicle_imu",
            flown.imu_us[rows],
            {
                "delta_angle": ("float[3]", flown.gyro[rows] * 0.01),
                "delta_velocity": ("float[3]", flown.accel[rows] * 0.01),
                "delta_angle_dt": ("uint32_t", np.full(count, 10_000)),
                "delta_velocity_dt": ("uint32_t", np.full(count, 10_000)),
            },
            multi_id,
        )
    path = write(tmp_path / "a.ulg", log.encode())
    assert [imu.name for imu in read_sensors(path).imus] == ["sensor_combined", "vehicle_imu 1"]
    other = open_recording(path, LogOptions(imu=2))
    np.testing.assert_allclose(other.imu.gyro, flown.recording.imu.gyro, atol=1e-5)


def test_an_accelerometer_with_a_stamp_of_its_own_is_brought_to_the_gyroscopes(flown, tmp_path):
    """GIVEN accelerometer samples taken 4 ms before the gyroscope's, THEN a ramp of force is found where it was."""
    log = px4(flown, imu=False)
    count = len(flown.imu_us)
    force = np.column_stack([np.linspace(0.0, 10.0, count), np.zeros(count), np.full(count, -9.8)])
    columns = {"gyro_rad": ("float[3]", flown.gyro), "accelerometer_m_s2": ("float[3]", force)}
    columns["accelerometer_timestamp_relative"] = ("int32_t", np.full(count, -4000))
    log.add("sensor_combined", flown.imu_us, columns)
    found = open_recording(write(tmp_path / "a.ulg", log.encode()), LogOptions()).imu
    np.testing.assert_allclose(found.accel[:, 0], force[:, 0], atol=1e-5)
    np.testing.assert_allclose(np.diff(found.stamps_ns), 1e7, atol=1e3)
    # at the older stamp the gyroscope lies between two samples, both of which had been there by then
    between = flown.recording.imu.gyro[:-1] * 0.4 + flown.recording.imu.gyro[1:] * 0.6
    np.testing.assert_allclose(found.gyro[1:], between, atol=1e-4)


def test_repeated_messages_zero_fields_and_hectopascals(flown, tmp_path):
    log = px4(flown, gnss=False)
    log.topics = [topic for topic in log.topics if topic[0] not in ("vehicle_magnetometer", "vehicle_air_data")]
    twice = np.repeat(np.arange(len(flown.gnss_us)), 2)
    columns = {name: (kind, np.asarray(values)[twice]) for name, (kind, values) in px4_gnss(flown, True).items()}
    log.add("vehicle_gps_position", flown.gnss_us[twice] + np.tile([0, 40_000], len(flown.gnss_us)), columns)
    field = flown.gauss.copy()
    field[::2] = 0.0
    log.add("vehicle_magnetometer", flown.mag_us, {"magnetometer_ga": ("float[3]", field)})
    log.add("sensor_baro", flown.baro_us, {"pressure": ("float", flown.pascal / 100.0)})
    found = open_recording(write(tmp_path / "a.ulg", log.encode()), LogOptions())
    assert len(found.fixes) == len(flown.gnss_us)
    assert found.counters["log.gnss_repeated"] == len(flown.gnss_us)
    assert len(of(found, MagSample)) == len(flown.mag_us) // 2
    np.testing.assert_allclose([s.pressure for s in of(found, PressureSample)], flown.pascal, rtol=1e-6)


def test_a_slow_imu_is_told(tmp_path):
    path = write(tmp_path / "slow.bin", ardupilot(flight(30.0, rate=25.0)).encode())
    assert any("25 Hz: too slow" in text for text in open_recording(path, LogOptions()).notices)


def test_the_units_that_a_log_describes_count(flown, tmp_path):
    """GIVEN gauss as floating point with a multiplier in FMTU, THEN they are no milligauss times milligauss."""
    log = ardupilot(flown)
    log.messages = [message for message in log.messages if message[2] != "MAG"]
    log.define("UNIT", "QbZ", "TimeUS,Id,Label")
    log.define("MULT", "Qbd", "TimeUS,Id,Mult")
    log.define("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
    log.define("MAG", "QBfff", "TimeUS,I,MagX,MagY,MagZ")
    log.add(0, "UNIT", 0, ord("G"), "Gauss")
    log.add(0, "MULT", 0, ord("A"), 0.1)
    log.define_fmt()
    log.add(0, "FMTU", 0, log.formats["MAG"][0], "s#GGG", "F-AAA")
    for t, value in zip(flown.mag_us.tolist(), (flown.gauss * 10.0).tolist(), strict=True):
        log.add(t, "MAG", t, 0, *value)
    found = open_recording(write(tmp_path / "a.bin", log.encode()), LogOptions())
    field = np.array([sample.field for sample in of(found, MagSample)])
    np.testing.assert_allclose(field, flown.gauss * [1e-4, -1e-4, -1e-4], atol=1e-10)


# --- what may be missing ---------------------------------------------------------------------------------------------


def test_a_log_without_gnss_says_which_topic_is_missing(flown, tmp_path):
    path = write(tmp_path / "a.ulg", px4(flown, gnss=False).encode())
    with pytest.raises(BagError, match=r"no GNSS \(vehicle_gps_position or sensor_gps\).*sensor_combined"):
        open_recording(path, LogOptions())


def test_a_log_without_imu_says_which_topic_is_missing(flown, tmp_path):
    path = write(tmp_path / "a.ulg", px4(flown, imu=False).encode())
    with pytest.raises(BagError, match=r"no IMU data \(sensor_combined\)"):
        open_recording(path, LogOptions())


def test_a_log_without_parameters_arming_and_estimates_still_flies(flown, tmp_path):
    """GIVEN a Plane's log without arming messages, parameters, MSG, compass, barometer, THEN the flight is read."""
    log = ardupilot(flown)
    log.messages = [message for message in log.messages if message[2] in ("IMU", "GPS")]
    found = open_recording(write(tmp_path / "a.bin", log.encode()), LogOptions())
    assert found.imu_count == len(flown.imu_us)
    assert len(found.fixes) == len(flown.gnss_us)
    assert found.opinion is None
    assert "gnss_latency_prior_s" not in found.sidecar


def test_an_imu_or_a_segment_that_is_not_there(flown, tmp_path):
    path = write(tmp_path / "a.bin", ardupilot(flown, second_imu_noise=0.1).encode())
    with pytest.raises(BagError, match=r"has no IMU 3; choose from 1 IMU\[0\], 2 IMU\[1\]"):
        open_recording(path, LogOptions(imu=3))
    with pytest.raises(BagError, match="has no segment 2; there are 1"):
        open_recording(path, LogOptions(segment=2))


# --- airspeed and range ----------------------------------------------------------------------------------------------


def test_airspeed_and_range_of_px4(flown, tmp_path):
    """GIVEN a sensor's airspeed and two rangefinders, THEN the true airspeed and the beam that looks down are taken."""
    log, count = px4(flown), len(flown.baro_us)
    log.add("airspeed", flown.baro_us, {"true_airspeed_m_s": ("float", np.full(count, 17.5))})
    for multi_id, orientation, distance in ((0, 0, 3.0), (1, 25, 8.0)):
        columns = {
            "current_distance": ("float", np.full(count, distance)),
            "min_distance": ("float", np.full(count, 0.2)),
            "max_distance": ("float", np.full(count, 40.0)),
            "variance": ("float", np.full(count, 0.04)),
            "signal_quality": ("int8_t", np.where(np.arange(count) % 2, 100, 0)),
            "orientation": ("uint8_t", np.full(count, orientation)),
        }
        log.add("distance_sensor", flown.baro_us, columns, multi_id)
    found = open_recording(write(tmp_path / "a.ulg", log.encode()), LogOptions())
    assert [(s.speed, np.isnan(s.sd)) for s in of(found, Airspeed)] == [(17.5, True)] * count
    ranges = of(found, RangeToGround)
    assert len(ranges) == count // 2  # those without a signal are none
    assert (ranges[0].distance, ranges[0].sd) == (8.0, pytest.approx(0.2))


def test_ground_speed_minus_wind_is_no_airspeed(flown, tmp_path):
    """GIVEN a validated airspeed that PX4 made of GNSS for the first half, THEN only the sensor's half is taken."""
    log, count = px4(flown), len(flown.baro_us)
    half = np.arange(count) < count // 2
    columns = {
        "true_airspeed_m_s": ("float", np.full(count, 15.0)),
        "selected_airspeed_index": ("int8_t", np.where(half, 0, 1)),
    }
    log.add("airspeed_validated", flown.baro_us, columns)
    found = open_recording(write(tmp_path / "a.ulg", log.encode()), LogOptions())
    assert len(of(found, Airspeed)) == count - count // 2


def test_airspeed_of_ardupilot_is_made_true_by_the_density(flown, tmp_path):
    """GIVEN 20 m/s of equivalent airspeed in air of 0.81 times the density at sea level, THEN it flies 22.2 m/s."""
    log = ardupilot(flown)
    log.messages = [message for message in log.messages if message[2] != "BARO"]
    log.define("ARSP", "QBfff", "TimeUS,I,Airspeed,DiffPress,Temp")
    log.define("RFND", "QBfBB", "TimeUS,Instance,Dist,Stat,Orient")
    pressure = 0.81 * 1.225 * 287.05 * 288.15
    for t in flown.baro_us.tolist():
        log.add(t, "BARO", t, 0, 0.0, pressure)
        log.add(t, "ARSP", t, 0, 20.0, 200.0, 15.0)
        log.add(t, "RFND", t, 0, 6.5, 4, 25)
        log.add(t, "RFND", t, 1, 2.5, 4, 0)
    found = open_recording(write(tmp_path / "a.bin", log.encode()), LogOptions())
    assert of(found, Airspeed)[5].speed == pytest.approx(20.0 / 0.9, rel=1e-4)
    assert {sample.distance for sample in of(found, RangeToGround)} == {6.5}
