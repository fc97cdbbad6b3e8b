"""Whatever ends a run, its folder holds the old results or all of the new ones, and nobody else's files are touched."""

import json
import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline import output_folder
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.output_folder import MARK, OutputFolder
from nav_pose_estimator.offline.page import live
from nav_pose_estimator.offline.replay import command, files, solution_bag

FILES = {"summary.json", "trajectory.tum", "estimate.csv", "report.html", "solution", MARK}
BESIDE = {live.SCRIPT} if live.script() else set()  # where plotly is installed
FILES |= BESIDE


@pytest.fixture
def finished(bag, tmp_path) -> Path:
    out = tmp_path / "out" / "result"
    assert replay(bag, out) == 0
    return out


def replay(bag: Path, out: Path, *options: str) -> int:
    return main(["replay", str(bag), "--method", "coast", "--out", str(out), *options])


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def write(folder: Path, text: str) -> None:
    folder.mkdir()
    for name in "abc":
        (folder / name).write_text(text)


# --- who may be replaced ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--outage", "900:30"], "ends after the recording"),
        (["--remap", "/gps/fix:=/nothing"], "/nothing"),
        (["--gnss-delay", "x"], "auto"),
        (["--rate", "0"], "--rate"),
    ],
)
def test_a_wrong_argument_leaves_earlier_results(bag, finished, capsys, options, words):
    before = content(finished)
    assert replay(bag, finished, *options) == 2
    assert words in capsys.readouterr().err
    assert content(finished) == before
    assert os.listdir(finished.parent) == [finished.name]


def test_a_mistyped_bag_leaves_earlier_results(finished, capsys):
    before = content(finished)
    assert replay(finished.parent / "typo_bag", finished) == 2
    assert "typo_bag" in capsys.readouterr().err
    assert content(finished) == before


def test_a_second_replay_replaces_the_first(bag, finished):
    before = json.loads((finished / "summary.json").read_text())
    assert replay(bag, finished, "--outage", "20:5") == 0
    after = json.loads((finished / "summary.json").read_text())
    assert (len(before["outages"]), len(after["outages"])) == (0, 1)
    assert {path.name for path in finished.iterdir()} == FILES
    assert os.listdir(finished.parent) == [finished.name]


@pytest.mark.parametrize("out", [".", "solution", "solution/.."])
def test_a_folder_that_holds_the_input_is_refused(finished, capsys, out):
    before = content(finished)
    assert replay(finished / "solution", finished / out) == 2
    assert "holds the input 'solution'" in capsys.readouterr().err
    assert content(finished) == before


@pytest.mark.parametrize("place", ["notes.txt", "solution/notes.txt", "solution/deep/er/notes.txt"])
def test_files_of_others_stop_a_replay(bag, finished, capsys, place):
    note = finished / place
    note.parent.mkdir(parents=True, exist_ok=True)
    note.write_text("years of work")
    before = content(finished)
    assert replay(bag, finished) == 2
    assert "notes.txt" in capsys.readouterr().err
    assert content(finished) == before


def test_a_stranger_of_the_same_name_is_not_replaced(bag, tmp_path, capsys):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "summary.json").write_text("{}")
    assert replay(bag, mine) == 2
    assert "not from an earlier replay" in capsys.readouterr().err
    assert (mine / "summary.json").read_text() == "{}"


def test_results_of_another_command_are_not_replaced(tmp_path, bag, finished, capsys):
    before = content(finished)
    options = ["--methods", "coast", "--lengths", "5", "--first", "8", "--every", "5", "--gnss-delay", "0"]
    assert main(["benchmark", "outage", str(bag), *options, "--out", str(finished)]) == 2
    assert "not from an earlier outage benchmark" in capsys.readouterr().err
    assert content(finished) == before
    out = tmp_path / "benchmark"
    for _ in range(2):
        assert main(["benchmark", "outage", str(bag), *options, "--out", str(out)]) == 0
    assert {p.name for p in out.iterdir()} == {
        "outages.csv",
        "summary.csv",
        "summary.json",
        "report.html",
        MARK,
        *BESIDE,
    }


def test_force_deletes_only_what_simulate_has_written(tmp_path, capsys):
    robot = tmp_path / "robot"
    robot.mkdir()
    (robot / "robot.yaml").write_text("arm: 7")
    simulate = ["simulate", "--scenario", "at_rest", "--duration", "2", "--force"]
    assert main([*simulate, str(robot)]) == 2
    assert "robot.yaml" in capsys.readouterr().err
    assert main([*simulate, str(tmp_path / "bag")]) == 0
    assert main([*simulate, str(tmp_path / "bag"), "--seed", "3"]) == 0
    (tmp_path / "bag" / "robot.yaml").write_text("arm: 7")
    assert main([*simulate, str(tmp_path / "bag")]) == 2
    assert (tmp_path / "bag" / "robot.yaml").read_text() == (robot / "robot.yaml").read_text() == "arm: 7"


def test_the_current_folder_is_refused(bag, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert replay(bag, Path()) == 2
    assert "current folder" in capsys.readouterr().err
    assert replay(bag, Path("result")) == 0


def test_a_link_keeps_pointing_at_the_results(bag, finished, tmp_path):
    link = tmp_path / "latest"
    link.symlink_to(finished)
    assert replay(bag, link) == 0
    assert link.is_symlink()
    assert {path.name for path in link.iterdir()} == FILES


# --- two at once -----------------------------------------------------------------------------------------------------


def test_a_second_run_into_one_folder_is_refused(tmp_path):
    with OutputFolder(tmp_path / "out", "replay") as work:
        with pytest.raises(UserError, match="another run is writing"), OutputFolder(tmp_path / "out", "replay"):
            pass
        write(work, "first")
    assert (tmp_path / "out" / "a").read_text() == "first"
    assert os.listdir(tmp_path) == ["out"]


def test_what_came_into_the_folder_meanwhile_stays_and_the_results_too(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    folder = OutputFolder(out, "replay")
    write(folder.__enter__(), "new")
    (out / "thesis").write_text("years of work")
    with pytest.raises(UserError, match=r"thesis.*new results are in .*out_1"):
        folder.__exit__(None, None, None)
    assert (out / "thesis").read_text() == "years of work"
    assert (tmp_path / "out_1" / "a").read_text() == "new"


# --- full disk -------------------------------------------------------------------------------------------------------


def fails_after(function: Callable, error: OSError) -> Callable:
    """``function``, after which the disk is full."""

    def failing(*arguments, **options):
        function(*arguments, **options)
        raise error

    return failing


STEPS = [(command, "_print_summary")] + [(files, name) for name in ("write_summary", "write_tum", "write_csv")]
STEPS += [(solution_bag, "write_solution"), (output_folder, "_write_mark")]


@pytest.mark.parametrize(("module", "step"), STEPS, ids=[step for _, step in STEPS])
def test_a_full_disk_leaves_the_earlier_results(bag, finished, monkeypatch, capsys, module, step):
    before = content(finished)
    full = OSError(28, "No space left on device")
    monkeypatch.setattr(module, step, fails_after(getattr(module, step), full))
    assert replay(bag, finished) == 2
    assert capsys.readouterr().err.endswith("No space left on device; nothing was changed\n")
    assert content(finished) == before
    assert os.listdir(finished.parent) == [finished.name]


def test_a_failing_rename_brings_the_earlier_results_back(tmp_path, monkeypatch):
    out = tmp_path / "out"
    for text, expected in (("old", None), ("new", PermissionError)):
        renames = []

        def rename(source, target, renames=renames, expected=expected):
            renames.append(source)
            if expected is not None and len(renames) == 2:
                raise expected(13, "Permission denied", str(target))
            os.replace(source, target)

        monkeypatch.setattr(output_folder.os, "rename", rename)
        if expected is None:
            with OutputFolder(out, "replay") as work:
                write(work, text)
        else:
            with pytest.raises(expected), OutputFolder(out, "replay") as work:
                write(work, text)
    assert (out / "a").read_text() == "old"
    assert os.listdir(tmp_path) == ["out"]


# --- killed ----------------------------------------------------------------------------------------------------------

SLOW_WRITER = """
import os, sys, time
from pathlib import Path
from nav_pose_estimator.offline.output_folder import OutputFolder
for round in range(10**6):
    with OutputFolder(Path(sys.argv[1]), "replay") as work:
        work.mkdir()
        for name in "abc":
            (work / name).write_text(str(round))
    print(round, flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_signal_leaves_one_complete_set(tmp_path, number):
    """Twelve writers end at seeded moments; the next one clears up what was left."""
    out, generator = tmp_path / "out", random.Random(int(number))
    for _ in range(12):
        with subprocess.Popen(
            [sys.executable, "-c", SLOW_WRITER, str(out)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            for _ in range(generator.randrange(20)):
                writer.stdout.readline()
            for _ in range(generator.randrange(20_000)):  # less than a round
                pass
            writer.send_signal(number)
            assert writer.wait(30) in (-number, 128 + number)  # between two rounds, or inside one
        with OutputFolder(tmp_path / "out", "replay") as work:  # also after a kill between two names
            texts = {(out / name).read_text() for name in "abc"}
            assert len(texts) == 1
            write(work, "mine")
        assert os.listdir(tmp_path) == ["out"]
