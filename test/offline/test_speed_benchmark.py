"""``benchmark speed``: what cannot be measured costs none of the other figures."""

import json
from pathlib import Path

import pytest

from nav_pose_estimator.offline.benchmarks.speed import figures, processes
from nav_pose_estimator.offline.benchmarks.speed.figures import Figure
from nav_pose_estimator.offline.command_line import main


def test_a_failure_is_named_and_the_rest_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """GIVEN a process that runs out of time WHEN speed is measured THEN it is named, the exit code is 1, and all other
    figures are in the file; replays longer than asked for are none of them."""
    for name in ("flight", "full_flight"):
        monkeypatch.setattr(figures, name, list)
    for name in ("navigator", "whole_estimator", "attitude", "learner", "pretrained"):
        monkeypatch.setattr(figures, name, lambda *_, name=name: [Figure(name, 1.0, "us", 2.0)])
    for name in ("without_numba", "bags", "outage_benchmark", "start_up"):
        monkeypatch.setattr(processes, name, lambda *_, name=name: [Figure(name, 3.0, "s", 2.0)])
    replayed = []

    def measured(options: list[str]) -> tuple[float, float, float]:
        replayed.append(Path(options[1]).name)
        raise RuntimeError("python said: out of time")

    monkeypatch.setattr(processes, "_measured", measured)
    monkeypatch.setattr(processes, "write_samples", lambda *_: None)
    assert main(["benchmark", "speed", "--longest", "60", "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "not measured: python said: out of time" in said.err
    assert "missed" in said.out
    content = json.loads((tmp_path / "out" / "speed.json").read_text())
    assert [one["what"] for one in content["figures"]][-2:] == ["outage_benchmark", "start_up"]
    assert content["left_out"] == ["python said: out of time"]
    assert replayed == ["flight_60"]
