"""``benchmark speed``: what everything costs on this machine, beside the peers that are installed.

Times are CPU time of one thread, the best of several repetitions: what the work costs, not what else the machine did.
Replay and start-up are wall time, as a user waits for them; they need a machine that has nothing else to do.
"""

import argparse
import json
import platform
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from nav_pose_estimator.offline.benchmarks.speed.figures import Figure


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``benchmark speed``."""
    parser.add_argument(
        "--out", type=Path, default=Path("speed_benchmark"), metavar="DIR", help="folder for speed.json"
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure, print every figure beside its goal as it is known, and write speed.json."""
    from nav_pose_estimator.offline.output_folder import OutputFolder
    from nav_pose_estimator.offline.replay.files import plain, versions

    with OutputFolder(arguments.out, "speed benchmark") as folder:
        figures = _measure()
        machine = {"processor": platform.processor() or platform.machine(), "system": platform.platform()}
        content = {"figures": [asdict(f) for f in figures], "machine": machine, "versions": versions()}
        folder.mkdir()
        (folder / "speed.json").write_text(json.dumps(plain(content), indent=1) + "\n", encoding="utf-8")
    print(f"figures: {arguments.out / 'speed.json'}")
    return 0


def _measure() -> list[Figure]:
    """Every figure, printed as it is known."""
    from nav_pose_estimator.offline.benchmarks.speed import figures as speed_figures
    from nav_pose_estimator.offline.benchmarks.speed import processes

    flight, full = speed_figures.flight(), speed_figures.full_flight()
    figures: list[Figure] = []

    def note(more: list[Figure]) -> None:
        for figure in more:
            print(line(figure), flush=True)
        figures.extend(more)

    note(speed_figures.navigator(flight, full))
    note(processes.without_numba())
    note(speed_figures.whole_estimator(flight, full))
    note(speed_figures.attitude(flight))
    note(speed_figures.learner())
    note(speed_figures.pretrained())
    with TemporaryDirectory(prefix="nav_pose_estimator_") as scratch:
        note(processes.bags(Path(scratch), flight))
        note(processes.replays(Path(scratch)))
        note(processes.lengths(Path(scratch)))
        note(processes.outage_benchmark(Path(scratch)))
        note(processes.start_up(Path(scratch)))
    return figures


def line(figure: Figure) -> str:
    """One figure in words."""
    bound = "at most" if figure.better == "lower" else "at least"
    goal = "" if figure.goal is None else f"{bound} {figure.goal:g} {figure.unit}"
    return f"{figure.what:46}  {figure.value:9.3g} {figure.unit:12}  {goal:24} {figure.verdict}".rstrip()
