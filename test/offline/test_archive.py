"""Many recordings at once: what is found, and what becomes of jobs that fail, die or are interrupted."""

import multiprocessing
import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from flight_bag import write_flight_bag
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive import resumed
from nav_pose_estimator.offline.archive.jobs import Failure, carry_out
from nav_pose_estimator.offline.archive.kept import KeptResults, key_of
from nav_pose_estimator.offline.archive.recordings import find
from nav_pose_estimator.offline.benchmarks.archive import cluster
from nav_pose_estimator.offline.benchmarks.outage import many_flights
from nav_pose_estimator.offline.benchmarks.outage.trials import Task, run_flight
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.logs.open_recording import read_sensors
from nav_pose_estimator.offline.training.flights import digest_of


def square(number: int) -> int:
    """A job that fails on negative numbers, breaks on zero, and kills its process on 13."""
    if number < 0:
        raise UserError(f"{number} is negative")
    if number == 13:
        os.kill(os.getpid(), signal.SIGKILL)
    return round(number**3 / number)


@pytest.mark.parametrize("processes", [1, 2])
def test_a_failed_job_costs_its_own_result(processes):
    outcomes = dict(carry_out(square, [3, -1, 0, 4], processes))
    assert (outcomes[0], outcomes[3]) == (9, 16)
    assert outcomes[1] == Failure("-1 is negative", expected=True)
    assert "ZeroDivisionError" in outcomes[2].why
    assert not outcomes[2].expected


def test_a_process_that_is_killed_takes_no_other_job_with_it():
    outcomes = dict(carry_out(square, [2, 13, 3, 4], processes=2))
    assert [outcomes[i] for i in (0, 2, 3)] == [4, 9, 16]
    assert isinstance(outcomes[1], Failure)
    assert "killed" in outcomes[1].why


def note_and_wait(note: Path) -> None:
    """A job that says which process does it, and takes long."""
    note.write_text(str(os.getpid()))
    time.sleep(600.0)


def carry_out_notes(notes: list[Path]) -> None:
    list(carry_out(note_and_wait, notes, processes=2))


def test_workers_end_when_the_command_is_killed(tmp_path: Path):
    """GIVEN two jobs under way WHEN the process that gave them out is killed THEN nobody works on."""
    notes = [tmp_path / "one", tmp_path / "two"]
    command = multiprocessing.get_context("spawn").Process(target=carry_out_notes, args=(notes,))
    command.start()
    wait_until(lambda: all(note.exists() and note.read_text() for note in notes))
    command.kill()
    command.join()
    wait_until(lambda: not any(is_alive(int(note.read_text())) for note in notes))


def wait_until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def is_alive(pid: int) -> bool:
    """Whether the process runs; one that has ended and that nobody has asked for its result does not."""
    try:
        return " Z " not in Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False


def test_jobs_go_to_the_workers_of_a_scheduler(tmp_path: Path):
    """GIVEN a Dask scheduler with two workers WHEN a job fails, or a worker is killed, THEN each has an outcome."""
    pytest.importorskip("distributed", reason="Dask is not installed here (requirements-cluster.txt)")
    for name in ("one", "two"):
        (tmp_path / name).write_text(name)
    jobs = [tmp_path / "one", tmp_path / "two"]
    with cluster.on_this_machine(2) as (address, pids):
        assert len(pids) == 2
        refused = dict(carry_out(read_sensors, jobs[:1], scheduler=address))
        os.kill(pids[0], signal.SIGKILL)
        outcomes = dict(carry_out(digest_of, jobs, scheduler=address))
    assert isinstance(refused[0], Failure)
    assert refused[0].expected
    assert outcomes == {number: digest_of(job) for number, job in enumerate(jobs)}


def test_folders_patterns_and_lists_stand_for_recordings(tmp_path: Path):
    bag = tmp_path / "north" / "flight_bag"
    bag.mkdir(parents=True)
    for name in ("north/flight_bag/metadata.yaml", "north/flight_bag/a.mcap", "north/b.ulg", "c.bin", "notes.md"):
        (tmp_path / name).touch()
    listing = tmp_path / "list.txt"
    listing.write_text("# the good ones\nc.bin\n\nnorth/*.ulg\n", encoding="utf-8")
    assert find([tmp_path]) == [tmp_path / "c.bin", tmp_path / "north/b.ulg", bag]
    assert find([bag, tmp_path / "north/*"]) == [bag, tmp_path / "north/b.ulg"]
    assert find([listing]) == [tmp_path / "c.bin", tmp_path / "north/b.ulg"]
    assert find([tmp_path / "missing_bag"]) == [tmp_path / "missing_bag"]


def test_lists_in_a_circle_are_an_error(tmp_path: Path):
    (tmp_path / "a.txt").write_text("b.txt\n")
    (tmp_path / "b.txt").write_text("a.txt\n")
    with pytest.raises(UserError, match=r"a\.txt is a list that lists itself"):
        find([tmp_path / "a.txt"])


def test_a_pattern_without_a_recording_is_an_error(tmp_path: Path):
    with pytest.raises(UserError, match="holds no recording"):
        find([tmp_path / "*.ulg"])


def test_kept_results_outlive_the_run_and_belong_to_their_input(tmp_path: Path):
    recording = tmp_path / "flight.ulg"
    recording.write_bytes(b"one")
    key = key_of(("outage", 30.0), [recording])
    KeptResults(tmp_path / "out").keep(key, {"error": 1.5})

    later = KeptResults(tmp_path / "out")
    assert later.take(key) == {"error": 1.5}
    recording.write_bytes(b"another")
    assert later.take(key_of(("outage", 30.0), [recording])) is None
    later.forget()
    assert later.take(key) is None


@pytest.fixture(scope="module")
def archive(tmp_path_factory) -> Path:
    """Two short flights and a folder that only looks like a bag."""
    folder = tmp_path_factory.mktemp("archive")
    write_flight_bag(folder / "one_bag", 90.0, imu_hz=50.0)
    shutil.copytree(folder / "one_bag", folder / "two_bag")
    (folder / "broken_bag").mkdir()
    (folder / "broken_bag" / "metadata.yaml").write_text("no bag\n", encoding="utf-8")
    return folder


def test_a_scheduler_is_asked_for_one_recording_too(archive, tmp_path, capsys):
    arguments = ["--scheduler", "nowhere", "--gnss-delay", "0", "--lengths", "10", "--out", str(tmp_path / "out")]
    assert main(["benchmark", "outage", str(archive / "one_bag"), *arguments]) == 2
    assert "scheduler" in capsys.readouterr().err


def measure(archive: Path, out: Path) -> int:
    options = ["--lengths", "10", "--every", "10", "--methods", "coast", "--gnss-delay", "0", "--out", str(out)]
    return main(["benchmark", "outage", str(archive), *options])


def test_a_folder_with_a_broken_recording_is_measured_without_it(archive, tmp_path, capsys):
    assert measure(archive, tmp_path / "out") == 0
    assert "broken_bag is left out" in capsys.readouterr().err
    table = (tmp_path / "out" / "outages.csv").read_text(encoding="utf-8")
    assert {line.split(",")[0] for line in table.splitlines()[1:]} == {"one_bag", "two_bag"}


def test_an_interrupted_run_goes_on_where_it_was(archive, tmp_path, capsys, monkeypatch):
    """GIVEN a run that ends after its second job WHEN it is started again THEN only the rest is done."""

    def interrupted(work, jobs, processes, scheduler):
        for number, outcome in carry_out(work, jobs, processes, scheduler):
            yield number, outcome
            if number == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr(resumed, "carry_out", interrupted)
    with pytest.raises(KeyboardInterrupt):
        many_flights.run_all(tasks_on(find([archive])), 1, "local", tmp_path / "out")
    monkeypatch.undo()

    left: list[Path] = []
    monkeypatch.setattr(many_flights, "run_flight", lambda tasks: left.append(tasks[0].bag) or run_flight(tasks))
    results = many_flights.run_all(tasks_on(find([archive])), 1, "local", tmp_path / "out")
    assert "1 of 3 jobs were finished" in capsys.readouterr().err
    assert [path.name for path in left] == ["broken_bag", "two_bag"]
    assert [result.bag for result in results] == ["one_bag", "two_bag"]
    assert not list(tmp_path.glob(".out*"))


def tasks_on(bags: list[Path]) -> list[Task]:
    return [Task(bag, "coast", (), (10.0,), every=10.0, gnss_delay="0") for bag in bags]
