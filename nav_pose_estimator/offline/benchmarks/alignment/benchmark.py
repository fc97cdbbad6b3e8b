"""Benchmark ``alignment``: convergence and consistency of the heading in simulation, by noise model."""

from __future__ import annotations

import argparse
from pathlib import Path

from nav_pose_estimator.core.filter.measurement_noise import MODELS
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.offline.benchmarks.alignment import report
from nav_pose_estimator.offline.benchmarks.alignment.cases import CASES, CONDITIONS
from nav_pose_estimator.offline.benchmarks.alignment.summary import judged, summarise
from nav_pose_estimator.offline.benchmarks.alignment.trial import Trial, run_trials
from nav_pose_estimator.offline.benchmarks.simulated import add_seeds, run_all, seeds, write_tables
from nav_pose_estimator.offline.benchmarks.tables import REPORT, chosen
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.output_folder import OutputFolder

_GOAL_NAMES = ("case", "condition", "goal", "value", "limits", "outcome")
_TRACES = ("t", "heading_deg")
Task = tuple[str, str, int, tuple[str, ...], Parameters]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``benchmark alignment``."""
    add = parser.add_argument
    add("--cases", default="ship,drone", metavar="C,...", help=f"of {', '.join(CASES)} (default: ship,drone)")
    names = ", ".join(CONDITIONS).replace("%", "%%")
    add("--conditions", default="all", metavar="C,...", help=f"of {names} (default: all)")
    add("--methods", default="all", metavar="M,...", help=f"noise, of {', '.join(MODELS)} (default: all)")
    add_seeds(parser, "alignments")
    add("--config", type=Path, metavar="YAML", help="parameter file, as for the nodes; the benchmark sets the noises")
    add("--out", type=Path, default=Path("alignment_benchmark"), metavar="DIR", help="folder for tables and report")


def run(arguments: argparse.Namespace) -> int:
    """Align every case under every condition, print the tables, write them and the plots."""
    tasks = _tasks(arguments)
    SinsEngine(tasks[0][-1]).warm_up()
    with OutputFolder(arguments.out, "alignment benchmark", [arguments.config] if arguments.config else []) as folder:
        trials = run_all(_run_task, tasks, arguments.jobs)
        summaries = summarise(trials)
        folder.mkdir()
        write_tables(folder, trials, summaries, judged(summaries), _GOAL_NAMES, _TRACES)
        report.write_report(folder / REPORT, trials, summaries)
    print(report.text_table(summaries))
    print(f"report: {arguments.out / REPORT}")
    return 0


def _tasks(arguments: argparse.Namespace) -> list[Task]:
    cases = chosen(arguments.cases, tuple(CASES), "--cases")
    conditions = chosen(arguments.conditions, tuple(CONDITIONS), "--conditions")
    methods = chosen(arguments.methods, tuple(MODELS), "--methods")
    parameters = load_parameters(arguments.config)
    return [
        (case, name, seed, methods, parameters) for case in cases for name in conditions for seed in seeds(arguments)
    ]


def _run_task(task: Task) -> list[Trial]:
    case, condition, seed, methods, parameters = task
    return run_trials(CASES[case], condition, seed, methods, parameters)
