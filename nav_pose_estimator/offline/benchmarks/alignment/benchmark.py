"""``benchmark alignment``: how fast and how honestly the heading is found, by noise model, in simulation."""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import asdict, fields
from pathlib import Path

from nav_pose_estimator.core.filter.measurement_noise import MODELS
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.benchmarks.alignment import report
from nav_pose_estimator.offline.benchmarks.alignment.cases import CASES, CONDITIONS
from nav_pose_estimator.offline.benchmarks.alignment.summary import Summary, judged, summarise
from nav_pose_estimator.offline.benchmarks.alignment.trial import Trial, run_trials
from nav_pose_estimator.offline.benchmarks.simulated import chosen, run_all
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.output_folder import OutputFolder

TRIALS, SUMMARY_CSV, SUMMARY_JSON, REPORT = "trials.csv", "summary.csv", "summary.json", "report.html"
_TRACES = ("t", "heading_deg")
Task = tuple[str, str, int, tuple[str, ...], Parameters]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``benchmark alignment``."""
    add = parser.add_argument
    add("--cases", default="ship,drone", metavar="C,...", help=f"of {', '.join(CASES)} (default: ship,drone)")
    add("--conditions", default="all", metavar="C,...", help=f"of {', '.join(CONDITIONS)} (default: all)")
    add("--methods", default="all", metavar="M,...", help=f"noise, of {', '.join(MODELS)} (default: all)")
    add("--seeds", type=int, default=10, metavar="N", help="simulated alignments of each (default: 10)")
    add("--first-seed", type=int, default=0, metavar="N", help="seed of the first one (default: 0)")
    add("--config", type=Path, metavar="YAML", help="parameters, as the nodes take them; noises are the benchmark's")
    add("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")
    add("--out", type=Path, default=Path("alignment_benchmark"), metavar="DIR", help="folder for tables and report")


def run(arguments: argparse.Namespace) -> int:
    """Align every case under every condition, print the tables, write them and the plots."""
    tasks = _tasks(arguments)
    SinsEngine(tasks[0][-1]).warm_up()
    with OutputFolder(arguments.out, "alignment benchmark", [arguments.config] if arguments.config else []) as folder:
        trials = list(run_all(_run_task, tasks, arguments.jobs))
        summaries = summarise(trials)
        folder.mkdir()
        _write_tables(folder, trials, summaries)
        report.write_report(folder / REPORT, trials, summaries)
    print(report.text_table(summaries))
    print(f"report: {arguments.out / REPORT}")
    return 0


def _tasks(arguments: argparse.Namespace) -> list[Task]:
    cases = chosen(arguments.cases, tuple(CASES), "--cases")
    conditions = chosen(arguments.conditions, tuple(CONDITIONS), "--conditions")
    methods = chosen(arguments.methods, tuple(MODELS), "--methods")
    if arguments.seeds < 1 or arguments.first_seed < 0 or arguments.jobs < 1:
        raise UserError("--seeds and --jobs must be 1 or more, --first-seed 0 or more")
    parameters = load_parameters(arguments.config)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    return [(case, name, seed, methods, parameters) for case in cases for name in conditions for seed in seeds]


def _run_task(task: Task) -> list[Trial]:
    case, condition, seed, methods, parameters = task
    return run_trials(CASES[case], condition, seed, methods, parameters)


def _write_tables(folder: Path, trials: list[Trial], summaries: list[Summary]) -> None:
    names = [item.name for item in fields(Trial) if item.name not in _TRACES]
    _write_csv(folder / TRIALS, names, [[getattr(trial, name) for name in names] for trial in trials])
    names = [item.name for item in fields(Summary)]
    _write_csv(folder / SUMMARY_CSV, names, [[getattr(row, name) for name in names] for row in summaries])
    from nav_pose_estimator.offline.replay.files import plain

    goals = [
        dict(zip(("case", "condition", "goal", "value", "limits", "outcome"), r, strict=True))
        for r in judged(summaries)
    ]
    content = {"summaries": [asdict(row) for row in summaries], "goals": goals}
    (folder / SUMMARY_JSON).write_text(json.dumps(plain(content), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _write_csv(path: Path, header: list[str], rows: list[list]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([f"{value:.5g}" if isinstance(value, float) else value for value in row] for row in rows)
