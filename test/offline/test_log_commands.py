"""From a log on the desk to the report with one command; segments, clocks, several IMUs, conversion, benchmark."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.core.earth.gps_time import WEEK_S
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights import latency
from nav_pose_estimator.offline.flights.flight_window import flight_window
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.offline.logs.clock_fit import fit_clock
from nav_pose_estimator.offline.logs.gnss_time import ROLLOVER, rolled, utc_from_gps_week
from nav_pose_estimator.offline.logs.imu_choice import compare_imus
from nav_pose_estimator.offline.logs.open_recording import open_recording, prepared, read_sensors
from nav_pose_estimator.offline.logs.options import LogOptions
from nav_pose_estimator.offline.logs.segments import find_segments
from nav_pose_estimator.offline.logs.sensors import Gnss
from nav_pose_estimator.offline.replay.replay import replay
from small_logs import Flight, ardupilot, flight, px4, write

SECONDS = 75.0


@pytest.fixture(scope="module")
def flown() -> Flight:
    return flight(SECONDS, rate=100.0)


@pytest.fixture(scope="module")
def ulg(flown, tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("px4") / "flight.ulg", px4(flown).encode())


@pytest.fixture(scope="module")
def two_imus(flown, tmp_path_factory) -> Path:
    """ArduPilot's log whose first IMU has a gyroscope ten times noisier than the second."""
    log = ardupilot(flown, new=False, second_imu_noise=0.3)
    swapped = {"IMU": "IMU2", "IMU2": "IMU"}
    log.messages = [(t, i, swapped.get(name, name), values) for t, i, name, values in log.messages]
    return write(tmp_path_factory.mktemp("ardupilot") / "flight.bin", log.encode())


@pytest.fixture(scope="module")
def replayed(ulg, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("out") / "flight"
    assert main(["replay", str(ulg), "--outage", "55:10", "--out", str(out)]) == 0
    return out


# --- one command -----------------------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_replay_of_a_log_leaves_a_report_with_an_outage(replayed):
    summary = json.loads((replayed / "summary.json").read_text())
    assert summary["bag"] == "flight.ulg"
    assert summary["outages"][0]["status"] == "ok"
    assert summary["outages"][0]["end_error_m"] < 10.0
    assert summary["gnss_delay_s"] == pytest.approx(0.13)


@pytest.mark.compiled
def test_the_second_opinion_stands_beside_the_solution(replayed):
    """GIVEN an autopilot that believes to be ten metres further North, THEN report and summary say so."""
    opinion = json.loads((replayed / "summary.json").read_text())["second_opinion"]
    assert opinion["source"] == "PX4's own estimator"
    assert 9.0 < opinion["from_gnss_rms_m"] < 11.0
    assert 8.0 < opinion["from_solution_rms_m"] < 12.0
    assert opinion["inclination_rms_deg"] < 3.0
    report = (replayed / "report.html").read_text()
    assert "Second opinion, PX4&#x27;s own estimator" in report
    assert report.count('class="line d"') == 4  # one curve in the map, three in the attitude


@pytest.mark.compiled
def test_the_second_opinion_changes_nothing(ulg):
    recording = open_recording(ulg, LogOptions())
    with_opinion = replay(recording, Parameters(), [])
    recording.opinion = None
    without = replay(recording, Parameters(), [])
    np.testing.assert_array_equal(with_opinion.track.rows, without.track.rows)


@pytest.mark.compiled
def test_the_converted_bag_gives_the_same_solution(ulg, replayed, tmp_path, capsys):
    bag = tmp_path / "flight_bag"
    assert main(["convert", str(ulg), str(bag)]) == 0
    assert main(["convert", str(ulg), str(bag)]) == 2  # not over what is there
    assert main(["convert", str(ulg), str(bag), "--force"]) == 0
    assert main(["replay", str(bag), "--outage", "55:10", "--out", str(tmp_path / "out")]) == 0
    direct = np.loadtxt(replayed / "trajectory.tum")
    converted = np.loadtxt(tmp_path / "out" / "trajectory.tum")
    assert np.array_equal(direct[:, 0], converted[:, 0])
    np.testing.assert_allclose(converted, direct, atol=1e-5)
    assert main(["convert", str(bag), str(tmp_path / "again")]) == 2
    assert "is a bag already" in capsys.readouterr().err


def test_a_folder_of_logs_becomes_a_folder_of_bags(ulg, tmp_path, capsys):
    """GIVEN two logs, a damaged one and a bag WHEN the folder is converted twice THEN two bags are written once."""
    logs, bags = tmp_path / "logs", tmp_path / "bags"
    logs.mkdir()
    shutil.copy(ulg, logs / "one.ulg")
    shutil.copy(ulg, logs / "two.ulg")
    (logs / "empty.ulg").touch()
    (logs / "old_bag").mkdir()
    (logs / "old_bag" / "metadata.yaml").touch()
    assert main(["convert", str(logs), str(bags), "--jobs", "2"]) == 0
    said = capsys.readouterr()
    assert "2 bags written, 1 logs left out, 0 bags were there already" in said.out
    assert "empty.ulg is left out" in said.err
    assert sorted(path.name for path in bags.iterdir()) == ["one.json", "one_bag", "two.json", "two_bag"]

    assert main(["convert", str(logs), str(bags)]) == 2  # nothing is left but the damaged one
    assert "2 bags were there already" in capsys.readouterr().out

    (logs / "list.txt").write_text("gone.ulg\n")
    assert main(["convert", str(logs / "list.txt"), str(bags)]) == 2
    assert "gone.ulg is left out: " in capsys.readouterr().err
    assert main(["convert", str(bags), str(tmp_path / "again")]) == 2
    assert "holds bags only, no flight log" in capsys.readouterr().err


def test_every_sample_survives_the_conversion(two_imus, tmp_path):
    bag = tmp_path / "b_bag"
    assert main(["convert", str(two_imus), str(bag), "--imu", "2"]) == 0
    log, read = open_recording(two_imus, LogOptions(imu=2)), load(bag)
    assert (read.epoch_ns, read.duration) == (log.epoch_ns, log.duration)
    np.testing.assert_array_equal(read.imu.stamps_ns, log.imu.stamps_ns)
    np.testing.assert_array_equal(read.imu.gyro, log.imu.gyro)
    others = [[(type(s), s.stamp_ns) for s in found.samples if not isinstance(s, ImuBlock)] for found in (read, log)]
    assert others[0] == others[1]
    assert read.sidecar["gnss_latency_prior_s"] == pytest.approx(0.13)


@pytest.mark.compiled
def test_benchmark_takes_logs(ulg, tmp_path):
    out = tmp_path / "out"
    options = ["--lengths", "5", "--every", "5", "--first", "40", "--methods", "coast,hold", "--out", str(out)]
    assert main(["benchmark", "outage", str(ulg), *options]) == 0
    rows = list(csv.DictReader((out / "outages.csv").open()))
    assert {row["bag"] for row in rows} == {"flight.ulg"}
    assert {row["status"] for row in rows} == {"ok"}


def test_axes_of_a_log_are_known(ulg, tmp_path, capsys):
    config = write(tmp_path / "frd.yaml", "imu:\n  convention: frd\n")
    assert main(["replay", str(ulg), "--config", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "leave imu.convention at flu" in capsys.readouterr().err


# --- what is in it ---------------------------------------------------------------------------------------------------

WORDS = ("segments", "IMU 1", "GNSS", "magnetometer", "barometer", "airspeed", "range", "estimator", "clock")


def test_list_has_the_same_words_for_both_formats_and_for_bags(ulg, two_imus, tmp_path, capsys):
    assert main(["convert", str(ulg), str(tmp_path / "a_bag")]) == 0
    for path in (ulg, two_imus, tmp_path / "a_bag"):
        capsys.readouterr()
        assert main(["replay", str(path), "--list"]) == 0
        said = capsys.readouterr().out
        assert all(f"\n{word}" in said for word in WORDS), said
        assert "100 Hz" in said
        assert "satellites" in said


def test_list_needs_no_gnss(flown, tmp_path, capsys):
    path = write(tmp_path / "a.ulg", px4(flown, gnss=False).encode())
    assert main(["replay", str(path), "--list"]) == 0
    assert "GNSS: none (vehicle_gps_position or sensor_gps)" in capsys.readouterr().out


# --- several IMUs ----------------------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_the_imu_that_follows_gnss_best_is_recommended_and_used(two_imus):
    recording = open_recording(two_imus, LogOptions())
    assert compare_imus(recording, Parameters(), np.inf).best == 2
    used = prepared(recording, Parameters(), np.inf)
    assert used.imu_number == 2
    assert any(text.startswith("IMU 2 of 2 is used") for text in used.notices)
    early = prepared(open_recording(two_imus, LogOptions()), Parameters(), 15.0)
    assert early.imu_number == 1
    assert any("too little data to compare them" in text for text in early.notices)
    chosen = open_recording(two_imus, LogOptions(imu=1))
    assert prepared(chosen, Parameters(), np.inf) is chosen


# --- segments --------------------------------------------------------------------------------------------------------


def test_pieces_are_cut_at_gaps_and_between_armings():
    first, second = np.arange(0, 100_000_000, 10_000), np.arange(160_000_000, 300_000_000, 10_000)
    imu_us = np.concatenate([first, second])
    armed = [(20_000_000, 40_000_000), (60_000_000, 90_000_000), (200_000_000, 250_000_000)]
    found = find_segments(imu_us, armed, 1.0)
    assert [(piece.begin_us // 10**6, round(piece.armed)) for piece in found] == [(0, 20), (50, 30), (160, 50)]
    assert [piece.begin_us // 10**6 for piece in find_segments(imu_us, None, 1.0)] == [0, 160]
    assert len(find_segments(imu_us, [], 100.0)) == 1


def test_a_segment_is_replayed_by_itself(flown, tmp_path):
    """GIVEN a log with a pause of 20 s in all data, THEN --segment 2 begins after it."""
    log = ardupilot(flown)
    log.messages = [
        (t, i, name, values)
        for t, i, name, values in log.messages
        if not flown.imu_us[2000] < t < flown.imu_us[4000] and name != "ARM"
    ]
    path = write(tmp_path / "a.bin", log.encode())
    whole, second = open_recording(path, LogOptions()), open_recording(path, LogOptions(segment=2))
    assert any("holds 2 segments" in text for text in whole.notices)
    assert any("the IMU pauses once, 20.0 s" in text for text in whole.notices)
    assert second.duration == pytest.approx(SECONDS - 40.0, abs=0.1)
    assert second.imu.stamps_ns[0] - whole.epoch_ns == pytest.approx(40e9, abs=0.1e9)
    assert not any("pauses" in text for text in second.notices)


# --- clocks ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def slow_clock(tmp_path_factory) -> Path:
    """A board whose clock runs slow by a twelfth."""
    log = px4(flight(SECONDS, rate=100.0, clock=11.0 / 12.0)).encode()
    return write(tmp_path_factory.mktemp("clock") / "slow.ulg", log)


def test_a_wrong_clock_is_told_and_scaled(slow_clock):
    found = open_recording(slow_clock, LogOptions())
    assert found.duration == pytest.approx(SECONDS, abs=0.05)
    words = "runs 9.09 % slow: a second of it lasts 1.0909 s of GNSS time; its times were scaled"
    assert any(words in text for text in found.notices)
    rate = (len(found.fixes) - 1) / ((found.fixes[-1].stamp_ns - found.fixes[0].stamp_ns) * 1e-9)
    assert rate == pytest.approx(5.0, rel=1e-3)


def test_the_clock_of_the_log_is_left_alone_on_request(slow_clock):
    found = open_recording(slow_clock, LogOptions(clock="log"))
    assert found.duration == pytest.approx(SECONDS * 11.0 / 12.0, abs=0.2)
    assert any("--clock auto scales its times" in text for text in found.notices)


def test_a_good_clock_is_left_alone_to_the_nanosecond(ulg, flown):
    found = open_recording(ulg, LogOptions())
    np.testing.assert_array_equal(found.imu.stamps_ns - found.imu.stamps_ns[0], (flown.imu_us - flown.imu_us[0]) * 1000)
    assert not any("clock" in text for text in found.notices)


def test_the_clock_is_judged_before_an_outage_could_hide_the_data(flown, tmp_path):
    """GIVEN GNSS time that goes wrong after the first minute of fixes, THEN nothing changes before or after."""
    fixes = flown.gnss_us - flown.gnss_us[0]
    changed = Flight(**{**vars(flown), "utc_us": flown.utc_us + np.maximum(fixes - 61_000_000, 0) // 10})
    found = open_recording(write(tmp_path / "a.ulg", px4(changed).encode()), LogOptions())
    np.testing.assert_array_equal(found.imu.stamps_ns - found.imu.stamps_ns[0], (flown.imu_us - flown.imu_us[0]) * 1000)


def test_late_messages_and_pauses_do_not_move_the_clock(flown):
    """GIVEN ticks of 20 ms, every ninth message 0.4 s late and a pause of 20 s, THEN the rate is found to 500 ppm."""
    rate, index = 1.0832, np.arange(len(flown.gnss_us))
    shown = flown.utc_us - np.where(index % 9 == 0, 400_000, 0)
    log_us = np.round(flown.gnss_us / rate / 20_000).astype(np.int64) * 20_000
    keep = (flown.gnss_us < 30_000_000) | (flown.gnss_us > 50_000_000)
    count = int(keep.sum())
    gnss = Gnss(
        name="jittery",
        time_us=log_us[keep],
        position=np.zeros((count, 3)),
        has_fix=np.ones(count, bool),
        velocity=np.zeros((count, 3)),
        accuracy=np.ones((count, 3)),
        satellites=np.full(count, 9),
        utc_us=shown[keep],
    )
    fit = fit_clock(gnss, 0, 1 << 62)
    assert fit.jumps == 0
    assert fit.wrong
    assert fit.rate == pytest.approx(rate, abs=5e-4)


def test_fixes_of_an_outage_do_not_scale_the_times(slow_clock):
    """GIVEN an outage so early that the clock shows its error only in it, THEN auto leaves the times, and says so."""
    early = open_recording(slow_clock, LogOptions(until=8.0))
    assert early.duration == pytest.approx(SECONDS * 11.0 / 12.0, abs=0.2)
    assert any("--clock gnss scales its times" in text for text in early.notices)
    late = open_recording(slow_clock, LogOptions(until=40.0))
    assert late.duration == pytest.approx(SECONDS, abs=0.05)


def test_leap_seconds_that_a_receiver_learns_are_no_clock_error(flown, tmp_path):
    jump = np.where(np.arange(len(flown.utc_us)) > 100, -2_000_000, 0)
    changed = Flight(**{**vars(flown), "utc_us": flown.utc_us + jump})
    gnss = read_sensors(write(tmp_path / "a.ulg", px4(changed).encode())).receiver
    fit = fit_clock(gnss, 0, 1 << 62)
    assert fit.jumps == 1
    assert abs(fit.rate - 1.0) < 1e-5


def test_clock_gnss_needs_a_time(flown, tmp_path):
    changed = Flight(**{**vars(flown), "utc_us": np.zeros_like(flown.utc_us)})
    path = write(tmp_path / "a.ulg", px4(changed).encode())
    with pytest.raises(UserError, match="too few fixes with a time"):
        open_recording(path, LogOptions(clock="gnss"))
    assert open_recording(path, LogOptions()).imu.stamps_ns[0] > 10**18


def test_weeks_before_2010_have_rolled_over():
    week, of_week = np.array([2300, 2300 - ROLLOVER, 0]), np.array([1000, 1000, 5])
    utc = utc_from_gps_week(week, of_week)
    assert utc[0] == utc[1] == (315_964_800 + 2300 * WEEK_S + 1 - 18) * 10**6
    assert utc[2] == 0
    np.testing.assert_array_equal(rolled(utc[:1] - 2 * ROLLOVER * WEEK_S * 10**6), utc[:1])


def test_leap_seconds_of_the_day_are_taken_off():
    before, after = 1_483_228_800 - 100, 1_483_228_800 + 100  # around the end of 2016
    for utc, leap in ((before, 17), (after, 18)):
        gps = utc - 315_964_800 + leap
        found = utc_from_gps_week(np.array([gps // WEEK_S]), np.array([gps % WEEK_S * 1000]))
        assert found[0] == utc * 10**6


# --- latency ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rise", "expected"), [(1.0, 0.2), (1e-3, 0.13), (0.04, 0.165)])
def test_a_weak_estimate_of_the_latency_leans_on_the_autopilots_parameter(ulg, monkeypatch, rise, expected):
    """GIVEN 0.2 s from the data and 0.13 s by EKF2_GPS_DELAY, THEN the flatter the minimum the less the data count."""
    found = latency.Latency(0.2, rise, np.zeros(1), np.zeros(1), 70.0)
    monkeypatch.setattr(latency, "estimate", lambda *_: found)
    parameters, how = latency.choose(open_recording(ulg, LogOptions()), Parameters(), "auto", None, np.inf)
    assert parameters.gnss.delay == pytest.approx(expected, abs=0.012)
    assert "0.13 s by EKF2_GPS_DELAY" in how


def test_the_default_gap_is_that_of_the_parameters():
    assert LogOptions().max_gap == Parameters().imu.max_gap


def test_arming_bounds_the_flight(flown, tmp_path):
    """GIVEN a vehicle that shakes and moves in the log before arming, THEN the flight begins at arming."""
    recording = open_recording(write(tmp_path / "a.ulg", px4(flown).encode()), LogOptions())
    begin, end = recording.sidecar["armed_s"][0]
    assert begin == pytest.approx(5.5, abs=0.6)
    recording.velocities[:] = [replace(v, vel_enu=(5.0, 0.0, 0.0)) for v in recording.velocities]
    assert begin <= flight_window(recording)[0] < begin + 1.0
    assert flight_window(recording)[1] <= end + 1.0
    del recording.sidecar["armed_s"]
    assert flight_window(recording)[0] < 1.0
