"""What the benchmarks in simulation share: the words of an option, seeds on several cores, and their tables."""

import argparse
import csv
import json
import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.jobs import Failure, carry_out

TRIALS, SUMMARY_CSV, SUMMARY_JSON, REPORT = "trials.csv", "summary.csv", "summary.json", "report.html"
Task = TypeVar("Task")
Trial = TypeVar("Trial")


def add_seeds(parser: argparse.ArgumentParser, what: str) -> None:
    """The options that say how many of ``what`` are simulated, in how many processes."""
    add = parser.add_argument
    add("--seeds", type=int, default=10, metavar="N", help=f"simulated {what} of each (default: 10)")
    add("--first-seed", type=int, default=0, metavar="N", help="seed of the first one (default: 0)")
    add("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")


def seeds(arguments: argparse.Namespace) -> range:
    """The seeds to simulate. Raises ``UserError`` for numbers that make no sense."""
    if arguments.seeds < 1 or arguments.first_seed < 0 or arguments.jobs < 1:
        raise UserError("--seeds and --jobs must be 1 or more, --first-seed 0 or more")
    return range(arguments.first_seed, arguments.first_seed + arguments.seeds)


def chosen(text: str, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    """The names of an option's ``text``, each once; all that are ``known`` for the word all. Raises ``UserError``."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if names == ("all",):
        return known
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise UserError(f"{option} {text!r}: there are {', '.join(known)}, or all")
    return names


def run_all(work: Callable[[Task], list[Trial]], tasks: Sequence[Task], jobs: int) -> list[Trial]:
    """What ``work``, a function of a module, gives for each of ``tasks``, in their order; ``jobs`` processes.

    A task that fails is named and left out. Raises ``UserError`` where none has succeeded.
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
    """Trials and summaries, rows of one dataclass each, as CSV; summaries and goals, whose columns have names, as JSON.

    ``left_out``: what of the trials does not fit into a cell.
    """
    from nav_pose_estimator.offline.replay.files import plain

    _write_csv(folder / TRIALS, trials, left_out)
    _write_csv(folder / SUMMARY_CSV, summaries, ())
    content = {
        "summaries": [asdict(row) for row in summaries],
        "goals": [dict(zip(goal_names, row, strict=True)) for row in goals],
    }
    (folder / SUMMARY_JSON).write_text(json.dumps(plain(content), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _write_csv(path: Path, rows: Sequence[Any], left_out: Collection[str]) -> None:
    names = [item.name for item in fields(rows[0]) if item.name not in left_out]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for row in rows:
            values = [getattr(row, name) for name in names]
            writer.writerow([f"{value:.5g}" if isinstance(value, float) else value for value in values])


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table as Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
