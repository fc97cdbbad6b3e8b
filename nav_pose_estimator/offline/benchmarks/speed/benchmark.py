"""Benchmark ``speed``: computing time on this machine, compared with installed peers.

Times are CPU times of one thread, the smallest of several repetitions, which excludes other load of the machine. Replay
and start-up are wall times, as a user experiences them, and need an otherwise idle machine.
"""

import argparse
import platform
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from nav_pose_estimator.offline.benchmarks.speed.figures import Figure


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``benchmark speed``."""
    parser.add_argument(
        "--out", type=Path, default=Path("speed_benchmark"), metavar="DIR", help="folder for speed.json"
    )
    parser.add_argument(
        "--longest", type=float, default=7200.0, metavar="S", help="leave out replays of longer flights (default: 7200)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure, print every figure with its goal, and write speed.json.

    Figures that cannot be measured are reported and left out; the exit code is 1 then.
    """
    from nav_pose_estimator.offline.json_file import versions, write_json
    from nav_pose_estimator.offline.output_folder import OutputFolder

    with OutputFolder(arguments.out, "speed benchmark") as folder:
        figures, left_out = _measure(arguments.longest)
        machine = {"processor": platform.processor() or platform.machine(), "system": platform.platform()}
        measured = {"figures": [asdict(f) for f in figures], "left_out": left_out}
        content = measured | {"machine": machine, "versions": versions()}
        folder.mkdir()
        write_json(folder / "speed.json", content)
    print(f"figures: {arguments.out / 'speed.json'}")
    return 1 if left_out else 0


def _measure(longest: float) -> tuple[list[Figure], list[str]]:
    """All figures, printed as they are measured, and reasons for missing ones. ``longest`` [s]: longest flight."""
    from nav_pose_estimator.offline.benchmarks.speed import figures as speed_figures
    from nav_pose_estimator.offline.benchmarks.speed import processes

    flight, full = speed_figures.flight(), speed_figures.full_flight()
    figures: list[Figure] = []
    left_out: list[str] = []

    def note(measure: Callable[[], list[Figure]]) -> None:
        try:
            more = measure()
        except (RuntimeError, OSError, subprocess.TimeoutExpired) as error:  # hours of other figures are not lost
            left_out.append(str(error))
            print(f"not measured: {error}", file=sys.stderr, flush=True)
            return
        for figure in more:
            print(line(figure), flush=True)
        figures.extend(more)

    note(lambda: speed_figures.navigator(flight, full))
    note(processes.without_numba)
    note(lambda: speed_figures.whole_estimator(flight, full))
    note(lambda: speed_figures.attitude(flight))
    note(speed_figures.learner)
    note(speed_figures.pretrained)
    with TemporaryDirectory(prefix="nav_pose_estimator_") as name:
        scratch = Path(name)
        note(lambda: processes.bags(scratch, flight))
        for seconds in processes.REPLAYED:
            if seconds <= longest:
                note(partial(processes.replays, scratch, seconds))
        note(lambda: processes.lengths(scratch, longest))
        note(lambda: processes.outage_benchmark(scratch))
        note(lambda: processes.start_up(scratch))
    return figures, left_out


def line(figure: Figure) -> str:
    """A figure as a line of text."""
    bound = "at most" if figure.better == "lower" else "at least"
    goal = "" if figure.goal is None else f"{bound} {figure.goal:g} {figure.unit}"
    return f"{figure.what:46}  {figure.value:9.3g} {figure.unit:12}  {goal:24} {figure.verdict}".rstrip()
