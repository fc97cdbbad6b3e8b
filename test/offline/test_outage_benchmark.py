"""``benchmark outage`` on a small flight: rows, rules, causality, and equality with a replay of the same outage."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from flight_bag import write_flight_bag
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.offline.benchmarks.outage.trials import Task, run_task
from nav_pose_estimator.offline.benchmarks.speed.figures import Figure, best_time
from nav_pose_estimator.offline.benchmarks.speed.flight_messages import imu_bytes
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.outages import Outage
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.offline.replay.replay import replay
from nav_pose_estimator.ros.messages import from_bytes

COLUMNS = (
    "bag,method,length_s,start_s,end_error_m,rms_error_m,max_error_m,end_vertical_m,end_sigma_m,travelled_m,status,why"
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("flight")
    write_flight_bag(folder / "circles_bag", 120.0, imu_hz=50.0)
    sidecar = {"gnss_latency_est_s": 0.0, "flight_window_s": [12.0, 118.0], "bag": {"stamp_offset_s": 10**9}}
    (folder / "circles.json").write_text(json.dumps(sidecar))
    return folder / "circles_bag"


@pytest.fixture(scope="module")
def finished(bag, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("out")
    options = ["--lengths", "10,20", "--every", "10", "--methods", "coast,hold,const_velocity", "--out", str(out)]
    assert main(["benchmark", "outage", str(bag), *options]) == 0
    return out


def rows_of(folder: Path) -> list[dict]:
    with (folder / "outages.csv").open() as file:
        return list(csv.DictReader(file))


def test_the_table_has_its_columns_and_one_row_per_outage(finished):
    assert (finished / "outages.csv").read_text().splitlines()[0] == COLUMNS
    rows = rows_of(finished)
    starts = {
        m: [float(r["start_s"]) for r in rows if r["method"] == m and r["length_s"] == "10.0000"]
        for m in ("coast", "hold", "const_velocity")
    }
    assert starts["coast"] == starts["hold"] == starts["const_velocity"]
    first = starts["coast"][0]
    assert first == pytest.approx(12.0 + 60.0, abs=0.05)
    assert np.allclose(np.diff(starts["coast"]), 10.0)
    assert starts["coast"][-1] + 10.0 <= 118.0
    assert all(row["status"] == "ok" for row in rows)
    assert all(row["bag"] == "circles_bag" for row in rows)


def test_errors_are_those_of_the_geometry(finished):
    """On a circle of 50 m radius at 10 m/s the held position is at most 100 m away, and it knows no deviation."""
    rows = rows_of(finished)
    held = [r for r in rows if r["method"] == "hold" and r["length_s"] == "10.0000"]
    for row in held:
        assert float(row["end_error_m"]) == pytest.approx(2 * 50.0 * np.sin(0.2 * 9.5 / 2), abs=4.0)
        assert float(row["travelled_m"]) == pytest.approx(100.0, rel=0.15)
        assert row["end_sigma_m"] == "nan"
    coasting = [float(r["end_error_m"]) for r in rows if r["method"] == "coast" and r["length_s"] == "10.0000"]
    assert np.median(coasting) < 20.0


def test_the_other_files_are_there_and_self_contained(finished):
    summary = json.loads((finished / "summary.json").read_text())
    assert {s["method"] for s in summary["summaries"]} == {"coast", "hold", "const_velocity"}
    assert summary["flights"][0]["gnss_delay_s"] == 0.0
    assert (finished / "summary.csv").read_text().startswith("bag,method,length_s,outages,median_m")
    report = (finished / "report.html").read_text()
    assert "http" not in report
    assert report.count("<svg") == 3  # reliability, growth, map


def test_a_copy_in_an_outage_equals_a_replay_with_that_outage(bag):
    """The benchmark's shortcut (one aided pass, copies) is the honest thing: a replay with one real outage."""
    task = Task(bag, "coast", (), (20.0,), every=15.0, first=62.3)
    result = run_task(task)
    recording = load(bag)
    parameters = methods.apply(Parameters(), "coast")
    for errors in result.errors["coast", 20.0]:
        alone = replay(recording, parameters, [Outage(errors.start_s, 20.0)]).errors[0]
        assert errors.end_error_m == pytest.approx(alone.end_error_m, rel=1e-3, abs=1e-2)
        assert errors.end_sigma_m == pytest.approx(alone.end_sigma_m, rel=1e-3)


def test_outages_do_not_depend_on_each_other(bag):
    many = run_task(Task(bag, "coast", (), (10.0,), every=5.0))
    few = run_task(Task(bag, "coast", (), (10.0,), every=20.0))
    lookup = {round(e.start_s, 3): e.end_error_m for e in many.errors["coast", 10.0]}
    assert few.errors["coast", 10.0]
    for errors in few.errors["coast", 10.0]:
        assert lookup[round(errors.start_s, 3)] == errors.end_error_m


def test_what_comes_after_the_outage_changes_nothing(bag):
    """The last outages of a flight and of the same flight cut off behind them are equal."""
    recording = load(bag)
    full = run_task(Task(bag, "coast", (), (10.0,), every=10.0, first=60.0)).errors["coast", 10.0][0]
    assert full.start_s + 10.0 < recording.duration - 20.0
    assert np.isfinite(full.growth).all()
    assert full.after[-1] <= 10.0


def test_parameters_are_chosen_across_groups(bag, tmp_path, capsys):
    """GIVEN a sane and an absurd parameter file WHEN both flights are cross-validated THEN the sane one is flown."""
    sane, absurd = tmp_path / "sane.yaml", tmp_path / "absurd.yaml"
    for path, noise in ((sane, 5e-4), (absurd, 0.1)):
        path.write_text(f"/**:\n  ros__parameters:\n    imu.gyro_noise: {noise}\n")
    twin = tmp_path / "again_bag"
    shutil.copytree(bag, twin)
    shutil.copy(bag.with_name("circles.json"), tmp_path / "again.json")
    options = [
        "--lengths",
        "20",
        "--every",
        "20",
        "--methods",
        "coast",
        "--cross-validate",
        "--out",
        str(tmp_path / "o"),
    ]
    assert main(["benchmark", "outage", str(bag), str(twin), *options, "--candidates", str(absurd), str(sane)]) == 0
    said = capsys.readouterr().out
    assert said.count(f"{sane} (chosen on the other groups)") == 2
    assert str(absurd) not in said
    assert {row["bag"] for row in rows_of(tmp_path / "o")} == {"circles_bag", "again_bag"}
    # reliability of all and of each flight, then growth and map of each
    assert (tmp_path / "o" / "report.html").read_text().count("<svg") == 3 + 2 * 2


def test_an_outage_that_begins_in_doubt_is_counted_with_its_reason(bag, tmp_path, capsys):
    """GIVEN an outage that starts before the navigator has aligned THEN it is not judged, and the reason is told."""
    options = ["--lengths", "5", "--every", "30", "--first", "-12", "--methods", "coast", "--out", str(tmp_path)]
    assert main(["benchmark", "outage", str(bag), *options]) == 0
    first = rows_of(tmp_path)[0]
    assert first["status"] == "not_aided"
    assert first["why"]
    assert f"1 outages left out for all methods (not_aided: {first['why']})" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--candidates", "a.yaml"], "--cross-validate"),
        (["--methods", "coast,magic"], "magic"),
        (["--lengths", "ten"], "ten"),
        (["--every", "0"], "--every"),
        (["--lengths", "500"], "no outage fits"),
        (["--first", "9999"], "no outage fits"),
    ],
)
def test_wrong_use_ends_with_2(bag, tmp_path, capsys, options, word):
    defaults = ["--methods", "coast"] if "--methods" not in options else []
    assert main(["benchmark", "outage", str(bag), "--out", str(tmp_path), *defaults, *options]) == 2
    error = capsys.readouterr().err
    assert word in error
    assert "Traceback" not in error


def test_a_missing_bag_is_named_before_anything_runs(tmp_path, capsys):
    assert main(["benchmark", "outage", str(tmp_path / "gone"), "--methods", "coast", "--out", str(tmp_path)]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_two_processes_give_what_one_gives(bag, tmp_path):
    options = ["--lengths", "10", "--every", "20", "--methods", "coast,velocity_prior"]
    for jobs in ("1", "2"):
        assert main(["benchmark", "outage", str(bag), *options, "--jobs", jobs, "--out", str(tmp_path / jobs)]) == 0
    assert rows_of(tmp_path / "1") == rows_of(tmp_path / "2")


def test_figures_and_messages_of_the_speed_benchmark():
    assert Figure("a", 1.0, "us", 2.0).verdict == "met"
    assert Figure("a", 1.0, "x", 2.0, "higher").verdict == "missed"
    assert Figure("a", 1.0, "x").verdict == ""
    assert best_time(lambda: None) >= 0.0
    from nav_pose_estimator.engine.samples import ImuSample

    sample = ImuSample(10**18 + 123, (0.1, -0.2, 0.3), (1.0, 2.0, 9.8))
    assert from_bytes.imu(imu_bytes(sample)) == (sample,)
