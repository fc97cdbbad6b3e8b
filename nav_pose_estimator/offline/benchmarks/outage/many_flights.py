"""Run of the benchmark on many recordings in parallel, with resumption, and without recordings that fail."""

import sys
from pathlib import Path
from typing import Any

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.jobs import LOCAL, Failure
from nav_pose_estimator.offline.archive.kept import KeptResults, key_of
from nav_pose_estimator.offline.archive.resumed import carry_on
from nav_pose_estimator.offline.benchmarks.outage.trials import FlightResult, Task, run_flight
from nav_pose_estimator.offline.sidecar import sidecar_path
from nav_pose_estimator.offline.terminal import note_left_out


def run_all(tasks: list[Task], processes: int, scheduler: str, out: Path) -> list[FlightResult]:
    """Results in the order of ``tasks``, without those of recordings that failed, which are reported.

    Results are stored beside ``out`` until the run is complete. Raises ``UserError`` if all recordings fail.
    """
    from tqdm import tqdm

    flights = _flights(tasks, processes)
    with tqdm(total=len(tasks), unit=" pass", disable=not sys.stderr.isatty()) as bar:
        if len(flights) == 1 and scheduler == LOCAL:
            return run_flight(flights[0], bar.update)
        kept, done = KeptResults(out), dict[int, Any]()
        keys = [key_of(flight, _read_by(flight[0])) for flight in flights]
        for number, outcome in carry_on(run_flight, flights, keys, kept, processes, scheduler):
            done[number] = outcome
            bar.update(len(flights[number]))
    results = _without_failed(flights, done)
    kept.forget()
    return results


def _without_failed(flights: list[list[Task]], done: dict[int, Any]) -> list[FlightResult]:
    failed = {flights[i][0].bag: done[i] for i in sorted(done) if isinstance(done[i], Failure)}
    for bag, failure in failed.items():
        note_left_out(bag.name, failure.why)
    good = [i for i in range(len(flights)) if flights[i][0].bag not in failed]
    if not good:
        raise UserError(f"none of the recordings can be used; the first: {next(iter(failed.values())).why}")
    return [result for i in good for result in done[i]]


def _flights(tasks: list[Task], processes: int) -> list[list[Task]]:
    """Groups of tasks with the same recording, unless that would leave processes without work."""
    together: dict[tuple[Path, Path | None], list[Task]] = {}
    for task in tasks:
        together.setdefault((task.bag, task.config), []).append(task)
    return list(together.values()) if len(together) >= processes else [[task] for task in tasks]


def _read_by(task: Task) -> list[Path]:
    """The files that the result of ``task`` depends on."""
    files = (task.bag, sidecar_path(task.bag), task.config, task.airframe)
    return [path for path in files if path is not None]
