"""Real flight logs, where they are at hand, against the bags that were made from them by other means."""

from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import MagSample, PressureSample, SatelliteCount
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.offline.flights.tracks import displacement_enu
from nav_pose_estimator.offline.logs.open_recording import open_recording, read_sensors
from nav_pose_estimator.offline.logs.options import LogOptions

# log, bag, IMU, whether the bag's heights are above sea level where the log has those above the ellipsoid
PAIRS = (
    ("px4_3dr1.ulg", "px4_3dr1_bag", 1, -27.318),
    ("px4_tropic.ulg", "px4_quad_tropic_bag", 1, 45.047),
    ("ardupilot_log171.bin", "quad_log171_bag", 2, 0.0),
)


@pytest.fixture(scope="module")
def logs(shared_data) -> Path:
    folder = shared_data / "logs"
    if not folder.is_dir():
        pytest.skip("the real flight logs are not here (set NAV_POSE_SHARED to the folder that holds data/)")
    return folder


@pytest.mark.parametrize(("log", "bag", "imu", "undulation"), PAIRS)
def test_a_log_and_the_bag_made_from_it_hold_the_same_flight(logs, log, bag, imu, undulation):
    found = open_recording(logs / log, LogOptions(imu=imu))
    known = load(logs.parent / "flights" / bag)
    assert found.duration == pytest.approx(known.duration, abs=1e-6)
    assert found.imu_count == known.imu_count
    off = np.abs((found.imu.stamps_ns - found.epoch_ns) - (known.imu.stamps_ns - known.epoch_ns))
    assert np.percentile(off, 99.9) < 1000
    # px4_tropic: two accelerometer samples of 15843 have a stamp of their own, which the bag does not know
    assert np.percentile(np.abs(found.imu.gyro - known.imu.gyro), 99.9) < 1e-6
    np.testing.assert_allclose(found.imu.accel, known.imu.accel, atol=1e-6)
    mine, theirs = ([fix for fix in r.fixes if fix.status >= 0] for r in (found, known))
    assert len(mine) == len(theirs)
    places = (np.array([(fix.lat, fix.lon, fix.alt) for fix in fixes]) for fixes in (mine, theirs))
    apart = displacement_enu(*places)
    np.testing.assert_allclose(apart, np.tile([0.0, 0.0, undulation], (len(apart), 1)), atol=2e-3)
    mine, theirs = (np.array([v.vel_enu for v in r.velocities]) for r in (found, known))
    np.testing.assert_allclose(mine, theirs, atol=1e-6)
    for kind, number in ((MagSample, "field"), (PressureSample, "pressure")):
        mine, theirs = (np.array([getattr(s, number) for s in r.samples if type(s) is kind]) for r in (found, known))
        np.testing.assert_allclose(mine, theirs, rtol=1e-6, atol=1e-12)
    assert {s.count for s in known.samples if type(s) is SatelliteCount} <= {
        s.count for s in found.samples if type(s) is SatelliteCount
    }


def test_a_log_without_gnss_says_so(logs):
    with pytest.raises(BagError, match=r"no GNSS \(vehicle_gps_position or sensor_gps\)"):
        open_recording(logs / "px4_appended.ulg", LogOptions())


def test_the_sensors_of_six_seconds_at_rest_are_read(logs):
    found = read_sensors(logs / "px4_small.ulg")
    assert found.vehicle == "VTOL"
    assert [imu.name for imu in found.imus] == ["sensor_combined"]  # three vehicle_imu at 2 Hz are none
    assert found.receiver.has_fix.all()


@pytest.mark.compiled
def test_the_autopilots_own_estimate_is_read_in_our_axes(logs, tmp_path):
    """GIVEN a clean flight of PX4 1.8, THEN its own estimate and ours agree while GNSS is good."""
    from json import loads

    assert main(["replay", str(logs / "px4_3dr1.ulg"), "--out", str(tmp_path / "out")]) == 0
    opinion = loads((tmp_path / "out" / "summary.json").read_text())["second_opinion"]
    assert opinion["from_gnss_rms_m"] < 0.5
    assert opinion["from_solution_rms_m"] < 1.0
    assert opinion["inclination_rms_deg"] < 1.5
    assert opinion["heading_rms_deg"] < 6.0


def test_a_flight_that_calibrates_nothing_says_what_is_missing(logs, tmp_path, capsys):
    """GIVEN a flight that turns a lot, but not about all axes, THEN it is not blamed for too small angles."""
    assert main(["calibrate", str(logs / "px4_3dr1.ulg"), "--out", str(tmp_path / "mag.yaml")]) == 2
    error = capsys.readouterr().err
    assert "the hard iron is known to" in error
    assert "less than" not in error
