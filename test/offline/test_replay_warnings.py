"""What a replay warns of stands on the terminal and in summary.json: once a kind, with count, first time and cure."""

import json
from pathlib import Path

import pytest

from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights.recording import load
from small_bags import EPOCH_NS, IMU, flight, imu, write_bag

STEP_NS = 20_000_000


def with_stamps(change) -> list:
    return [(t, topic, kind, imu(change(t)) if kind == IMU else m) for t, topic, kind, m in flight(4.0)]


def replay(bag: Path, out: Path, capsys) -> tuple[list[str], dict]:
    assert main(["replay", str(bag), "--method", "coast", "--out", str(out)]) == 2  # four seconds do not align
    *lines, last = capsys.readouterr().err.splitlines()
    assert last.startswith("replay: the navigator never aligned")
    return lines, json.loads((out / "summary.json").read_text())


def test_repeated_stamps_are_one_line_with_count_time_and_cure(tmp_path, capsys):
    """GIVEN a driver whose clock steps by 20 ms at 100 Hz THEN every second sample is refused and one line says so."""
    bag = write_bag(tmp_path / "bag", with_stamps(lambda t: t // STEP_NS * STEP_NS))
    lines, summary = replay(bag, tmp_path / "out", capsys)
    (line,) = [line for line in lines if "imu.rejected.duplicate" in line]
    assert line.startswith("warning: two IMU samples have the stamp")
    assert "200 times, first at 0.0 s" in line
    assert "cure: the driver sends samples twice or stamps coarsely" in line
    (told,) = [warned for warned in summary["warnings"] if warned["name"] == "imu.rejected.duplicate"]
    assert told["count"] == summary["counters"]["imu.rejected.duplicate"] == 200
    assert (told["level"], told["first_s"]) == ("WARN", 0.0)


def test_a_clock_that_stands_is_named_before_anything_else_fails(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", with_stamps(lambda t: EPOCH_NS + (t - EPOCH_NS) // 10**9))
    assert any("repeat a stamp: the clock of the driver stands" in text for text in load(bag).notices)
    assert main(["replay", str(bag), "--outage", "2:1", "--out", str(tmp_path / "out")]) == 2
    assert "the clock of the driver stands still" in capsys.readouterr().err


def test_each_kind_has_one_line_and_comes_in_order_of_time(tmp_path, capsys):
    """GIVEN a gap and a clock that goes back THEN each is told once, first things first."""

    def change(t: int) -> int:
        seconds = (t - EPOCH_NS) * 1e-9
        return t + 10**10 if 1.0 < seconds < 2.0 else t

    lines, summary = replay(write_bag(tmp_path / "bag", with_stamps(change)), tmp_path / "out", capsys)
    names = [warned["name"] for warned in summary["warnings"]]
    assert {"imu.gap", "imu.clock_jump"} <= set(names)
    assert len(names) == len(set(names))
    for name in names:
        assert sum(f"({name}: " in line for line in lines) == 1
    times = [warned["first_s"] for warned in summary["warnings"]]
    assert times == sorted(times)


@pytest.mark.parametrize("outage", [[], ["--outage", "2:1"]])
def test_a_good_recording_and_an_outage_on_request_warn_of_nothing(tmp_path, mcap_bag, capsys, outage):
    main(["replay", str(mcap_bag), "--method", "coast", "--out", str(tmp_path / "out"), *outage])
    assert [line for line in capsys.readouterr().err.splitlines() if line.startswith(("warning", "error"))] == []


def test_a_recording_that_ends_without_gnss_says_why(bag, tmp_path, capsys):
    arguments = ["replay", str(bag), "--method", "coast", "--out", str(tmp_path / "out")]
    assert main([*arguments, "--outage", "20:9.5"]) == 0
    assert "\nGNSS is not used at the end: " in capsys.readouterr().out
    assert main(arguments) == 0
    assert "GNSS is not used" not in capsys.readouterr().out
