"""Benchmark ``beams``: drift of a vehicle without GNSS with failing beams of its Doppler sensor, in simulation."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import NamedTuple

from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.benchmarks.beams import report
from nav_pose_estimator.offline.benchmarks.beams.cases import CASES, USUAL_LENGTH
from nav_pose_estimator.offline.benchmarks.beams.methods import METHODS, TABLE
from nav_pose_estimator.offline.benchmarks.beams.summary import judged, summarise
from nav_pose_estimator.offline.benchmarks.beams.trial import Trial, run_seed
from nav_pose_estimator.offline.benchmarks.simulated import add_seeds, run_all, seeds, write_tables
from nav_pose_estimator.offline.benchmarks.tables import REPORT, chosen
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.output_folder import OutputFolder
from nav_pose_estimator.sim.beam_faults import PLANS

_GOAL_NAMES = ("case", "fault", "goal", "value", "limits", "outcome")


class Task(NamedTuple):
    """A recording with all faults and methods to run on it."""

    case: str
    seed: int
    faults: tuple[str, ...]
    methods: tuple[str, ...]
    length: float  # s
    mounting: float  # rad
    parameters: Parameters


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``benchmark beams``."""
    add = parser.add_argument
    add("--cases", default="all", metavar="C,...", help=f"of {', '.join(CASES)} (default: all)")
    add("--faults", default="all", metavar="F,...", help=f"of {', '.join(PLANS)} (default: all)")
    table = ",".join(TABLE)
    add("--methods", default=table, metavar="M,...", help=f"of {', '.join(METHODS)} (default: {table})")
    add_seeds(parser, "outages")
    add("--length", type=float, default=USUAL_LENGTH, metavar="S", help="time without GNSS (default: 600)")
    add("--mounting", type=float, default=0.0, metavar="DEG", help="unknown mounting yaw of the sensor (default: 0)")
    add("--config", type=Path, metavar="YAML", help="parameter file, as for the nodes; the benchmark sets the sensors")
    add("--out", type=Path, default=Path("beams_benchmark"), metavar="DIR", help="folder for tables and report")


def run(arguments: argparse.Namespace) -> int:
    """Try every method on every case with every fault, print the tables, write them."""
    tasks = _tasks(arguments)
    SinsEngine(tasks[0].parameters).warm_up()
    with OutputFolder(arguments.out, "beams benchmark", [arguments.config] if arguments.config else []) as folder:
        trials = run_all(_run_task, tasks, arguments.jobs)
        summaries = summarise(trials)
        goals = judged(summaries, arguments.length, arguments.mounting != 0.0)
        folder.mkdir()
        write_tables(folder, trials, summaries, goals, _GOAL_NAMES)
        report.write_report(folder / REPORT, summaries, goals)
    print(report.text_tables(summaries, goals))
    print(f"report: {arguments.out / REPORT}")
    return 0


def _tasks(arguments: argparse.Namespace) -> list[Task]:
    cases = chosen(arguments.cases, tuple(CASES), "--cases")
    faults = chosen(arguments.faults, tuple(PLANS), "--faults")
    methods = chosen(arguments.methods, tuple(METHODS), "--methods")
    if not 60.0 <= arguments.length <= 7200.0 or not -10.0 <= arguments.mounting <= 10.0:
        raise UserError("--length must lie between 60 and 7200 s, --mounting between -10 and 10 deg")
    parameters, mounting = load_parameters(arguments.config), math.radians(arguments.mounting)
    return [
        Task(case, seed, faults, methods, arguments.length, mounting, parameters)
        for case in cases
        for seed in seeds(arguments)
    ]


def _run_task(task: Task) -> list[Trial]:
    return run_seed(CASES[task.case], *task[1:])
