"""``replay --rerun FILE.rrd``: what the viewer gets, read back with the package's own tool."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from nav_pose_estimator.offline.command_line import main


@pytest.fixture
def hover(repository) -> str:
    """A short shipped flight."""
    return str(repository / "bags" / "hover_sqlite3")


def told(path: Path, home: Path, *command: str) -> str:
    """What ``rerun rrd COMMAND`` says of the file. In a home of its own it sends nothing."""
    environment = dict(os.environ, HOME=str(home))
    call = [sys.executable, "-m", "rerun_cli", "rrd", *command, str(path)]
    return subprocess.run(call, env=environment, capture_output=True, text=True, check=True, timeout=300).stdout


@pytest.mark.compiled
def test_a_replay_is_there_to_be_seen(hover, tmp_path) -> None:
    """GIVEN rerun-sdk WHEN a flight is replayed into a file THEN paths, vehicle, errors and modes are in it."""
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    file = tmp_path / "hover.rrd"
    assert main(["replay", hover, "--outage", "12:5", "--out", str(tmp_path / "out"), "--rerun", str(file)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hover.rrd", "out"]
    told(file, tmp_path, "verify")
    text = told(file, tmp_path, "print", "-vvv")
    for entity in ("world/estimate", "world/reference", "world/outage_0", "world/vehicle", "horizontal/error", "mode"):
        assert f"entity_path: /{entity}" in text, entity
    errors = text.split("entity_path: /vertical/error", 1)[1].split("entity_path:", 1)[0]
    values = [float(value) for value in re.findall(r"\[(-?\d+\.\d+(?:e-?\d+)?)\]", errors)]
    assert len(values) > 50
    assert 0.0 < max(map(abs, values)) < 10.0
    assert "DEAD_RECKONING" in text


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("flight.bin", "--rerun writes a file that ends with .rrd, not 'flight.bin'"),
        ("nowhere/flight.rrd", "does not exist"),
        ("folder.rrd", "folder.rrd is a folder"),
    ],
)
def test_a_file_that_cannot_be_is_told_before_the_work(hover, tmp_path, capsys, name, sentence) -> None:
    (tmp_path / "folder.rrd").mkdir()
    assert main(["replay", hover, "--out", str(tmp_path / "out"), "--rerun", str(tmp_path / name)]) == 2
    assert sentence in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["folder.rrd"]


def test_without_rerun_the_cure_is_told(hover, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["replay", hover, "--out", str(tmp_path / "out"), "--rerun", str(tmp_path / "flight.rrd")]) == 2
    assert capsys.readouterr().err == ("replay: --rerun needs the Python package rerun-sdk: pip install rerun-sdk\n")
