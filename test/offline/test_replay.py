"""Replay from end to end: the files, the figures, equality with the engine fed by hand, and how bad input ends."""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from flight_bag import write_flight_bag
from nav_pose_estimator.core.filter.layout import OUT_COLUMNS, SOLUTION_SIZE
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssVelocity, ImuBlock
from nav_pose_estimator.engine.solutions import Mode, NavBlock
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights import latency, methods
from nav_pose_estimator.offline.flights.outages import Outage
from nav_pose_estimator.offline.flights.recording import Recording, load
from nav_pose_estimator.offline.flights.tracks import TrackRecorder
from nav_pose_estimator.offline.output_folder import MARK
from nav_pose_estimator.offline.page import live, svg
from nav_pose_estimator.offline.replay.replay import Record, replay
from nav_pose_estimator.offline.replay.report import mode_spans
from small_bags import COUNT, EPOCH_NS, FIX, count, fix, write_bag

SECONDS = 100.0
FILES = {"summary.json", "trajectory.tum", "estimate.csv", "report.html", "solution", MARK}
FILES |= {live.SCRIPT} if live.script() else set()


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "circles_bag"
    write_flight_bag(path, SECONDS, imu_hz=100.0)
    return path


@pytest.fixture(scope="module")
def finished(bag, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("out") / "circles"
    assert main(["replay", str(bag), "--method", "coast", "--outage", "60:15", "--out", str(out)]) == 0
    return out


def plain_recording(delay: float = 0.0, seconds: float = SECONDS) -> Recording:
    epoch = 10**18
    return Recording(Path("plain_bag"), samples(seconds, 100.0, 5.0, delay), epoch, seconds)


def test_biases_are_recorded_only_where_the_last_solution_is_that_of_the_last_sample():
    """GIVEN solutions that end before the last IMU sample, as before a gap WHEN biases are due THEN none are stored."""
    filter_ = SimpleNamespace(complete=lambda row: np.full(SOLUTION_SIZE, 4.0))
    run = SimpleNamespace(timeline=SimpleNamespace(running=True, filter=filter_))
    block = NavBlock(np.array([10, 20]) * 10**9, np.zeros((2, OUT_COLUMNS)), Mode.AIDED, 0, np.zeros(3))
    record = Record(0, TrackRecorder(0))
    record.note_biases(run, [block], 30 * 10**9)
    assert len(record.bias_history) == 0
    record.note_biases(run, [block], 20 * 10**9)
    assert record.bias_history.rows.tolist() == [[20.0] + [4.0] * 6 + [2.0] * 6]


# --- what it leaves behind -------------------------------------------------------------------------------------------


def test_all_files_are_there(finished):
    assert {path.name for path in finished.iterdir()} == FILES


def test_the_summary_tells_the_outage_and_proves_it_empty(finished):
    summary = json.loads((finished / "summary.json").read_text())
    (outage,) = summary["outages"]
    assert outage["start_s"] == 60.0
    assert outage["status"] == "ok"
    assert 0.0 < outage["end_error_m"] <= outage["max_error_m"] + 1e-9
    assert outage["travelled_m"] == pytest.approx(150.0, rel=0.05)
    assert summary["outage_proof"]["valid_inside_an_outage"] == 0
    assert summary["outage_proof"]["gnss_samples_fed"] > 100
    assert summary["not_finite_rows"] == 0
    assert summary["first_aided_s"] < 60.0
    assert [m["mode"] for m in summary["modes"]].count("DEAD_RECKONING") == 1
    assert summary["parameters"]["gnss.delay"] == 0.0
    assert {"nav_pose_estimator", "python", "numpy"} <= set(summary["versions"])


def test_trajectory_and_table_have_their_form(finished):
    lines = (finished / "trajectory.tum").read_text().splitlines()
    assert len(lines) > 1000
    assert all(len(line.split()) == 8 for line in lines)
    quaternions = np.array([line.split()[4:] for line in lines], float)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-6)
    stamps = [line.split()[0] for line in lines]
    assert stamps == sorted(stamps)
    with (finished / "estimate.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["mode"] for row in rows} >= {"AIDED", "DEAD_RECKONING"}
    assert np.isfinite([float(row["east_m"]) for row in rows]).all()
    assert max(abs(float(row["v_up_mps"])) for row in rows) < 3.0


def test_the_solution_bag_can_be_read(finished):
    with AnyReader([finished / "solution"]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        odometry = next(
            reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/odometry/filtered"
        )
    assert counts["/odometry/filtered"] > 500
    assert counts["/gps/filtered"] > 200
    assert counts["/diagnostics"] >= 3
    assert odometry.header.frame_id == "map"
    assert odometry.child_frame_id == "base_link"
    assert odometry.pose.covariance[0] > 0.0


def test_the_solution_bag_says_no_fix_in_the_outage(finished):
    with AnyReader([finished / "solution"]) as reader:
        fixes = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/gps/filtered"]
    statuses = [fix.status.status for fix in fixes]
    assert set(statuses) == {0, -1}
    assert 60 < statuses.count(-1) < 110  # fifteen seconds and the return, at 5 Hz
    assert all(fix.status.service == (1 if fix.status.status == 0 else 0) for fix in fixes)


def test_the_report_needs_nothing_from_outside(finished):
    text = (finished / "report.html").read_text()
    assert "http" not in text.replace("http-equiv", "")
    assert not re.search(r"<link|<img|@import|url\(", text)
    assert set(re.findall(r'src="([^"]*)"', text)) <= {live.SCRIPT}
    assert text.count("<svg") >= 8
    assert "NaN" not in text
    assert "prefers-color-scheme" in text
    for word in ("Outages", "Track", "Innovations", "Attitude", "Sensor biases", "Counters", "Parameters"):
        assert word in text


def test_a_replay_counts_from_the_origin_that_is_asked_for(bag, tmp_path):
    """GIVEN a flight WHEN it is replayed with an origin a hundredth of a degree further South THEN North is 1.1 km."""
    rows = {}
    for name, south in (("own", 0.0), ("south", 0.01)):
        origin = () if not south else ("--origin", f"{float(rows['own'][1]) - south},{rows['own'][2]},{rows['own'][3]}")
        assert main(["replay", str(bag), "--method", "coast", *origin, "--out", str(tmp_path / name)]) == 0
        rows[name] = (tmp_path / name / "estimate.csv").read_text().splitlines()[1].split(",")
    assert rows["own"][1:4] == rows["south"][1:4], "the place on Earth"
    assert float(rows["south"][5]) - float(rows["own"][5]) > 1000.0
    assert float(rows["south"][5]) == pytest.approx(1111.9, abs=1.0)


def test_a_second_run_replaces_the_first_but_nothing_else(bag, finished, tmp_path, capsys):
    command = ["replay", str(bag), "--method", "coast", "--out", str(finished)]
    stamp = (finished / "summary.json").stat().st_mtime_ns
    (tmp_path / "thesis.txt").write_text("years of work")
    assert main([*command[:-1], str(tmp_path)]) == 2
    assert "thesis.txt" in capsys.readouterr().err
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
    assert (finished / "summary.json").stat().st_mtime_ns == stamp


def test_the_table_is_printed(bag, tmp_path, capsys):
    assert main(["replay", str(bag), "--method", "coast", "--outage-every", "40:10", "--out", str(tmp_path / "o")]) == 0
    out = capsys.readouterr().out
    assert out.count(" ok\n") == 2
    assert "real time" in out
    assert "report.html" in out


def test_the_shipped_flight_replays_against_its_truth(repository, tmp_path):
    """What ``make demo`` does."""
    bag = repository / "bags" / "multirotor_outage"
    if not bag.is_dir():
        pytest.skip("the shipped bags are not here")
    options = ["--method", "coast", "--outage", "90:30", "--out", str(tmp_path / "demo")]
    assert main(["replay", str(bag), *options]) == 0
    summary = json.loads((tmp_path / "demo" / "summary.json").read_text())
    assert summary["reference"] == "ground truth"
    assert summary["outages"][0]["status"] == "ok"
    assert 0.0 < summary["outages"][0]["end_error_m"] < 200.0
    assert summary["not_finite_rows"] == 0
    assert not any("fitted" in text for text in summary["notices"])


# --- equality --------------------------------------------------------------------------------------------------------


def test_replay_equals_the_engine_fed_by_hand():
    recording = plain_recording(seconds=60.0)
    parameters = methods.apply(Parameters(), "coast")
    result = replay(recording, parameters, [])
    engine = PoseEstimator(parameters)
    tracks = TrackRecorder(recording.epoch_ns)
    for sample in recording.samples:
        for output in engine.feed(sample):
            if isinstance(output, NavBlock):
                tracks.add(output)
    by_hand = tracks.track()
    shared = np.isin(by_hand.t, result.track.t)
    assert shared.sum() > 0.9 * len(by_hand)
    mine = np.isin(result.track.t, by_hand.t[shared])
    np.testing.assert_array_equal(result.track.rows[mine][:, 1:17], by_hand.rows[shared][:, 1:17])


def test_two_runs_are_equal_bit_for_bit():
    recording = plain_recording(seconds=60.0)
    parameters = methods.apply(Parameters(), "coast")
    first, second = (replay(recording, parameters, [Outage(40.0, 10.0)]) for _ in range(2))
    np.testing.assert_array_equal(first.track.rows, second.track.rows)
    assert first.errors[0].end_error_m == second.errors[0].end_error_m


# --- latency ---------------------------------------------------------------------------------------------------------


def test_a_later_receiver_is_found_to_be_later_by_that_much(monkeypatch):
    """On steady circles a latency looks almost like a turned heading: the estimate is off, but equally for both."""
    monkeypatch.setattr(latency, "COARSE", np.array([0.0, 0.2, 0.4]))
    parameters = methods.apply(Parameters(), "coast")
    punctual, late = (latency.estimate(plain_recording(delay, 70.0), parameters) for delay in (0.0, 0.22))
    assert late.delay - punctual.delay == pytest.approx(0.22, abs=0.01)
    assert abs(punctual.delay) < 0.05


def test_a_weak_minimum_is_called_weak():
    trials = np.array([0.1, 0.2, 0.3])
    clear = latency.Latency(0.2, 0.25, trials, np.array([0.3, 0.2, 0.3]), 100.0)
    flat = latency.Latency(0.2, 0.001, trials, np.array([0.2, 0.2, 0.2]), 100.0)
    assert not clear.weak
    assert "weak" not in latency.describe(clear)
    assert flat.weak
    assert "weak minimum" in latency.describe(flat)
    assert latency.Latency(0.2, float("nan"), trials, trials, 100.0).weak


def test_latency_looks_only_at_data_before_the_first_outage(monkeypatch):
    monkeypatch.setattr(latency, "COARSE", np.array([0.1, 0.4]))
    monkeypatch.setattr(latency, "RESOLUTION", 0.05)
    recording = plain_recording(0.1)
    parameters = methods.apply(Parameters(), "coast")
    honest = latency.estimate(recording, parameters, until=50.0)
    late = [_spoiled(s) if _last_stamp(s) >= 10**18 + 50 * 10**9 else s for s in recording.samples]
    spoiled = latency.estimate(Recording(recording.path, late, 10**18, SECONDS), parameters, until=50.0)
    np.testing.assert_array_equal(honest.innovations, spoiled.innovations)
    with pytest.raises(UserError, match="less than 20 s"):
        latency.estimate(recording, Parameters(), until=10.0)


def _spoiled(sample):
    return replace(sample, vel_enu=(99.0, 99.0, 99.0)) if isinstance(sample, GnssVelocity) else sample


def _last_stamp(sample) -> int:
    return int(sample.stamps_ns[-1]) if isinstance(sample, ImuBlock) else sample.stamp_ns


def test_where_the_latency_comes_from(tmp_path):
    recording, p = plain_recording(), Parameters()
    assert latency.choose(recording, p, "0.15", None, 50.0)[0].gnss.delay == 0.15
    assert "default" in latency.choose(recording, p, None, None, 50.0)[1]
    recording.sidecar = {"gnss_latency_est_s": 0.3}
    assert latency.choose(recording, p, None, None, 50.0)[0].gnss.delay == 0.3
    configured = update(p, {"gnss.delay": 0.05})
    assert latency.choose(recording, configured, None, tmp_path / "c.yaml", 50.0)[0].gnss.delay == 0.05
    with pytest.raises(UserError, match="write seconds, or auto"):
        latency.choose(recording, p, "soon", None, 50.0)


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--outage", "95:30"], "ends after the recording"),
        (["--outage", "50:20", "--outage", "60:5"], "overlap"),
        (["--outage", "abc"], "START:LENGTH"),
        (["--method", "magic"], "does not exist"),
        (["--aid", "sextant"], "sextant"),
        (["--config", "missing.yaml"], "missing.yaml"),
        (["--remap", "/gps/fix:=/nothing"], "/nothing"),
        (["--gnss-delay", "x"], "auto"),
        (["--gnss-delay", "7"], "maximum"),
        (["--rate", "0"], "--rate"),
        (["--origin", "47.4,8.5"], "latitude,longitude,height"),
        (["--origin", "94,8,500"], "maximum"),
        (["--colour"], "--colour"),
    ],
)
def test_wrong_use_is_one_sentence_and_exit_code_2(bag, tmp_path, capsys, options, word):
    assert main(["replay", str(bag), "--out", str(tmp_path / "o"), *options]) == 2
    error = capsys.readouterr().err
    assert word in error
    assert "Traceback" not in error
    assert error.strip().count("\n") == 0


def test_a_parameter_that_does_not_exist_is_named(bag, tmp_path, capsys):
    config = tmp_path / "c.yaml"
    config.write_text("/**:\n  ros__parameters:\n    gnss:\n      dealy: 0.1\n")
    assert main(["replay", str(bag), "--config", str(config), "--out", str(tmp_path / "o")]) == 2
    assert "gnss.delay" in capsys.readouterr().err


def test_a_bag_without_imu_is_refused(tmp_path, capsys):
    path = write_bag(tmp_path / "b", [(EPOCH_NS, "/gps/fix", FIX, fix(EPOCH_NS)), (EPOCH_NS, "/n", COUNT, count())])
    assert main(["replay", str(path), "--out", str(tmp_path / "o")]) == 2
    assert "/gps/fix (sensor_msgs/msg/NavSatFix)" in capsys.readouterr().err


def test_a_bag_that_never_aligns_is_bad_input_and_still_gets_its_report(tmp_path, capsys):
    recording = load(_bag_of_imu_only(tmp_path))
    result = replay(recording, Parameters(), [])
    assert len(result.track) == 0
    assert (waiting := result.status.waiting_for)
    assert main(["replay", str(recording.path), "--out", str(tmp_path / "o")]) == 2
    told = capsys.readouterr()
    assert "waiting for" in told.out
    assert told.err.splitlines()[-1] == f"replay: the navigator never aligned, the estimate is empty. {waiting}"
    written = {path.name for path in (tmp_path / "o").iterdir()}
    assert {"report.html", "summary.json", "trajectory.tum", "estimate.csv"} <= written


def _bag_of_imu_only(tmp_path) -> Path:
    from small_bags import IMU, imu

    times = range(EPOCH_NS, EPOCH_NS + 5 * 10**9, 10**7)
    return write_bag(tmp_path / "imu_only", [(t, "/imu/data_raw", IMU, imu(t)) for t in times])


def test_a_gap_shows_as_a_new_alignment():
    recording = plain_recording(seconds=60.0)
    gap = (10**18 + 30 * 10**9, 10**18 + 35 * 10**9)
    recording.samples = [s for s in recording.samples if not gap[0] < _last_stamp(s) < gap[1]]
    result = replay(recording, methods.apply(Parameters(), "coast"), [])
    spans = mode_spans(result)
    realigning = [(start, end) for start, end, mode in spans if mode is Mode.ALIGNING and start > 20.0]
    assert len(realigning) == 1
    assert realigning[0][0] == pytest.approx(35.0, abs=0.2)
    assert np.isfinite(result.track.rows).all()


def test_zero_stamps_are_named(tmp_path):
    from small_bags import IMU, imu

    messages = [(EPOCH_NS + i * 10**7, "/imu/data_raw", IMU, imu(0)) for i in range(100)]
    with pytest.raises(UserError, match="stamp zero"):
        load(write_bag(tmp_path / "zero", messages))


# --- drawing ---------------------------------------------------------------------------------------------------------


def test_thinning_keeps_the_extremes():
    x = np.arange(100_000.0)
    y = np.zeros(100_000)
    y[54_321], y[77_777] = 5.0, -3.0
    _, thin_y = svg.thin(x, y)
    assert len(thin_y) <= svg.MAX_POINTS + 2
    assert thin_y.max() == 5.0
    assert thin_y.min() == -3.0


def test_ticks_are_round_and_inside():
    assert svg.ticks(0.0, 10.0, 5) == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert svg.ticks(3.0, 3.0) == [3.0]
    for low, high in ((-0.013, 0.021), (1e5, 1.2e6), (-7.0, -1.0)):
        values = svg.ticks(low, high)
        assert 3 <= len(values) <= 12
        assert min(values) >= low - 1e-9
        assert max(values) <= high + 1e-9


def test_a_line_is_interrupted_where_there_is_no_number():
    plot = svg.Plot("s", "m")
    plot.line(np.arange(6.0), np.array([0.0, 1.0, np.nan, np.nan, 1.0, 2.0]), "a", "error")
    text = plot.render()
    (line,) = re.findall(r'<path class="line a" d="([^"]*)"', text)
    assert line.count("M") == 2
    assert "nan" not in text
