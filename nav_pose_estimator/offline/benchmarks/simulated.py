"""Common functions of the benchmarks in simulation: seeds on several cores, and output files."""

import argparse
import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.jobs import Failure, carry_out
from nav_pose_estimator.offline.benchmarks.tables import SUMMARY_CSV, SUMMARY_JSON, TRIALS, write_csv
from nav_pose_estimator.offline.json_file import write_json

_FLOATS = ".5g"
Task = TypeVar("Task")
Trial = TypeVar("Trial")


def add_seeds(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the options for the number of simulated ``what`` and of processes."""
    add = parser.add_argument
    add("--seeds", type=int, default=10, metavar="N", help=f"simulated {what} of each (default: 10)")
    add("--first-seed", type=int, default=0, metavar="N", help="seed of the first one (default: 0)")
    add("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")


def seeds(arguments: argparse.Namespace) -> range:
    """The seeds to simulate. Raises ``UserError`` for numbers out of range."""
    if arguments.seeds < 1 or arguments.first_seed < 0 or arguments.jobs < 1:
        raise UserError("--seeds and --jobs must be 1 or more, --first-seed 0 or more")
    return range(arguments.first_seed, arguments.first_seed + arguments.seeds)


def run_all(work: Callable[[Task], list[Trial]], tasks: Sequence[Task], jobs: int) -> list[Trial]:
    """Results of ``work``, a function at module level, for each of ``tasks`` in their order, with ``jobs`` processes.

    A task that fails is reported and left out. Raises ``UserError`` if none succeeds.
    """
    from tqdm import tqdm

    done: dict[int, Any] = {}
    with tqdm(total=len(tasks), unit=" seed", disable=not sys.stderr.isatty()) as bar:
        for number, outcome in carry_out(work, tasks, jobs):
            done[number] = outcome
            bar.update()
    failed = [done[number] for number in sorted(done) if isinstance(done[number], Failure)]
    if len(failed) == len(tasks):
        raise UserError(f"nothing could be simulated: {failed[0].why}")
    for failure in failed:
        print(f"note: a simulation is left out: {failure.why}", file=sys.stderr)
    return [trial for number in sorted(done) if not isinstance(done[number], Failure) for trial in done[number]]


def write_tables(
    folder: Path,
    trials: Sequence[Any],
    summaries: Sequence[Any],
    goals: Sequence[Sequence[str]],
    goal_names: Sequence[str],
    left_out: Collection[str] = (),
) -> None:
    """Write trials and summaries, rows of one dataclass each, as CSV; summaries and goals with column names as JSON.

    ``left_out``: fields of the trials that do not fit into a cell.
    """
    write_csv(folder / TRIALS, trials, _FLOATS, left_out)
    write_csv(folder / SUMMARY_CSV, summaries, _FLOATS)
    content = {
        "summaries": [asdict(row) for row in summaries],
        "goals": [dict(zip(goal_names, row, strict=True)) for row in goals],
    }
    write_json(folder / SUMMARY_JSON, content)
