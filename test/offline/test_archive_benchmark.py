"""``benchmark archive``: what it says of costs that are known, and that it watches and kills real processes."""

import json
from pathlib import Path

import pytest

from nav_pose_estimator.offline import simulated_bag
from nav_pose_estimator.offline.benchmarks.archive import benchmark
from nav_pose_estimator.offline.benchmarks.archive.watched import Cost, Kill, run
from nav_pose_estimator.offline.command_line import main

SHORT = ["simulate", "--scenario", "multirotor_light", "--duration", "5"]


@pytest.fixture
def known_costs(monkeypatch) -> list[bytes]:
    """No flight is simulated or flown: every command costs what it says here, and writes the next of the results."""
    results = [b"same"] * 20

    def fake(options, kept: Path, kill: Kill | None = None, workers=()) -> Cost:
        names = next(Path(option) for option in options if option.endswith(".txt"))
        count = len(names.read_text().splitlines())
        (names.parent / "a.airframe").write_bytes(results.pop(0))
        if "--jobs" in options:
            return Cost(1.0, {11: 0.4 * count, 12: 0.5 * count}, elapsed=10.0)
        return Cost(1.0 * count, memory=200.0, elapsed=2.0 * count)

    monkeypatch.setattr(simulated_bag, "write_recording", lambda *ignored: None)
    monkeypatch.setattr(benchmark, "run_watched", fake)
    return results


def figures(out: Path) -> dict:
    assert main(["benchmark", "archive", "--flights", "4,8", "--seconds", "120", "--out", str(out)]) == 0
    return json.loads((out / "archive.json").read_text())


def test_the_efficiency_counts_what_no_worker_makes_shorter(known_costs, tmp_path, capsys) -> None:
    """GIVEN flights of 1 s each WHEN two workers share eight of them THEN the busier one and the main process count."""
    said = figures(tmp_path / "out")
    assert said["efficiency"] == pytest.approx(8.0 / (2.0 * (1.0 + 4.0)))
    assert list(said["lost_s"].values()) == pytest.approx([1.0, 0.8, 0.2])
    assert 8.0 + sum(said["lost_s"].values()) == pytest.approx(2.0 * (1.0 + 4.0))
    assert said["efficiency_by_the_clock"] == pytest.approx(16.0 / (2.0 * 10.0))
    assert [row["one_more_s"] for row in said["growth"]] == [None, 1.0]
    assert said["same_with_workers"]
    assert said["same_without_a_worker"]
    assert said["same_when_resumed"]
    assert "efficiency 80 %" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "name", "words"),
    [(2, "same_with_workers", "; ANOTHER RESULT"), (3, "same_without_a_worker", "a worker killed: ANOTHER RESULT")],
)
def test_another_result_is_said(command, name, words, known_costs, tmp_path, capsys) -> None:
    """GIVEN workers that give something else than one process, or a command that loses something with a worker, WHEN
    measured THEN the benchmark says so."""
    known_costs[command] = b"another"
    assert not figures(tmp_path / "out")[name]
    assert words in capsys.readouterr().out


def test_a_command_is_watched(tmp_path) -> None:
    """GIVEN a command WHEN watched THEN it has cost time and memory; one that fails is an error with its words."""
    cost = run([*SHORT, str(tmp_path / "bag")], tmp_path / "kept")
    assert cost.main > 0.0
    assert cost.memory > 10.0
    assert cost.longest == cost.total == cost.main
    with pytest.raises(RuntimeError, match="exists"):
        run([*SHORT, str(tmp_path / "bag")], tmp_path / "kept")
    with pytest.raises(RuntimeError, match="before it could be disturbed"):
        run([*SHORT, "--force", str(tmp_path / "bag")], tmp_path / "kept", Kill(1))


@pytest.mark.parametrize("wrong", [["--flights", "two"], ["--flights", "2"], ["--workers", "1"], ["--seconds", "5"]])
def test_bad_use_is_one_sentence(wrong: list[str], tmp_path, capsys) -> None:
    assert main(["benchmark", "archive", *wrong, "--out", str(tmp_path / "out")]) == 2
    assert wrong[0] in capsys.readouterr().err
