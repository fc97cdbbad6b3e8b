"""Command ``replay BAG``: options and output of :mod:`nav_pose_estimator.offline.replay.replay`."""

import argparse
import math
import os
import shutil
import sys
import time
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.import_time import without_garbage_collection
from nav_pose_estimator.offline.process_clock import seconds_since_start
from nav_pose_estimator.offline.terminal import aligned, printable

DESCRIPTION = (
    "Replay a rosbag2 or a flight log (PX4 ULog, ArduPilot DataFlash) through the pose estimator, take GNSS away for a "
    "while, and see how far the pose drifts."
)

_CONSEQUENCES = (".velocity_without_fix", ".before_imu", ".no_attitude_yet")  # refusals that another one explains


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``replay``."""
    from nav_pose_estimator.offline.logs.options import add_options

    parser.description = DESCRIPTION
    what = "rosbag2 (a folder, a .mcap or a .db3 file), PX4 .ulg, or ArduPilot .bin or .log"
    parser.add_argument("bag", type=Path, metavar="BAG|LOG", help=what)
    parser.add_argument("--config", type=Path, metavar="YAML", help="parameter file, as for the nodes")
    add = parser.add_argument
    add(
        "--outage",
        action="append",
        default=[],
        metavar="START:LENGTH",
        help="remove GNSS; seconds from the first stamp",
    )
    add("--outage-every", metavar="PERIOD:LENGTH", help="outages throughout the flight")
    add("--aid", metavar="NAME,...", help="use exactly these aids besides IMU and GNSS; none for no aid")
    add("--method", metavar="NAME", default="best", help="method for outages (default: best)")
    add("--airframe", type=Path, metavar="FILE", help="airframe file made by the command train")
    add("--gnss-delay", metavar="S", help="latency of the fixes in seconds, or auto to estimate it from the bag")
    add("--estimate-latency", action="store_true", help="estimate the latency of the fixes, print it and stop")
    add("--origin", metavar="LAT,LON,HEIGHT", help="origin of the local frame: degrees, metres above the ellipsoid")
    add("--remap", action="append", default=[], metavar="OURS:=THEIRS", help="/imu/data_raw:=/topic/in/the/bag")
    add_options(parser)
    add("--list", action="store_true", help="list the contents of the recording and stop")
    add("--rate", type=float, default=20.0, metavar="HZ", help="rows per second in the output files (default: 20)")
    add("--rerun", type=Path, metavar="FILE.rrd", help="also write a file for the Rerun viewer (needs rerun-sdk)")
    add("--out", type=Path, metavar="DIR", help="folder for report and data (default: NAME_replay)")


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises ``UserError`` for wrong options, unreadable recordings and unusable output folders."""
    with without_garbage_collection():
        from nav_pose_estimator.offline.bags.topic_map import parse_remaps
        from nav_pose_estimator.offline.flights import latency, methods, outages
        from nav_pose_estimator.offline.flights.config_file import load_parameters
        from nav_pose_estimator.offline.logs import open_recording  # noqa: F401  for ``_Plan``
        from nav_pose_estimator.offline.output_folder import OutputFolder
        from nav_pose_estimator.offline.replay import (  # noqa: F401  for ``_replay``
            beside,
            replay,
            report,
            rerun_file,
            solution_bag,
        )
        from nav_pose_estimator.offline.replay.files import REPORT
        from nav_pose_estimator.offline.replay.parameter_options import with_aids, with_origin
        from nav_pose_estimator.offline.sidecar import flight_name

    if not 0.0 < arguments.rate <= 1000.0:
        raise UserError("--rate must lie between 0 and 1000 Hz")
    wanted = [outages.parse_outage(text) for text in arguments.outage]
    every = outages.parse_outage_every(arguments.outage_every) if arguments.outage_every else None
    parameters = methods.apply(load_parameters(arguments.config), arguments.method, arguments.airframe)
    if arguments.aid is not None:
        parameters = with_aids(parameters, arguments.aid)
    if arguments.origin is not None:
        parameters = with_origin(parameters, arguments.origin)
    plan = _Plan(arguments, parameters, parse_remaps(arguments.remap), wanted, every)
    if arguments.list:
        from nav_pose_estimator.offline.logs.listing import describe

        print("\n".join(map(printable, describe(arguments.bag, plan.options, plan.remaps, parameters))))
        return 0
    if arguments.estimate_latency:
        recording = plan.load()
        print(latency.describe(latency.estimate(recording, parameters, _first(plan.outages(recording)))))
        return 0
    if arguments.rerun is not None:
        rerun_file.check(arguments.rerun)
    folder = arguments.out or Path(f"{flight_name(Path(os.path.realpath(arguments.bag)))}_replay")
    inputs = [path for path in (arguments.bag, arguments.config) if path is not None]
    with OutputFolder(folder, "replay", inputs) as work:  # before the work, so that an unusable folder costs no time
        recording = plan.load()
        wanted = plan.outages(recording)
        parameters, how = latency.choose(recording, parameters, arguments.gnss_delay, arguments.config, _first(wanted))
        print(printable(how))
        work.mkdir()
        result = _replay(recording, parameters, wanted, work, arguments.rate)
        if arguments.rerun is not None:
            rerun_file.write_rerun(arguments.rerun, result)
    print(f"report: {printable(str(folder / REPORT))}")
    if not len(result.track):
        why = result.status.waiting_for + _refused(result)
        raise UserError(f"the navigator never aligned, the estimate is empty. {why}")
    return 0


@dataclass(frozen=True)
class _Plan:
    """The options, checked as far as possible without the recording."""

    arguments: argparse.Namespace
    parameters: Any
    remaps: dict[str, str]
    wanted: list
    every: tuple[float, float] | None

    @property
    def options(self) -> Any:
        """Options for reading a flight log."""
        from nav_pose_estimator.offline.logs.options import options_of

        until = min(_first(self.wanted), self.every[0] if self.every else math.inf)
        return options_of(self.arguments, self.parameters.imu.max_gap, until)

    @property
    def _reads_often(self) -> bool:
        """Whether the samples are kept in memory, because the estimation of the latency reads them several times."""
        from nav_pose_estimator.offline.flights.latency import AUTO

        return self.arguments.estimate_latency or self.arguments.gnss_delay == AUTO

    def load(self) -> Any:
        """Read the recording."""
        from nav_pose_estimator.engine import first_run
        from nav_pose_estimator.offline.logs.open_recording import open_recording, prepared

        with _bar("reading", None) as bar:
            recording = open_recording(
                self.arguments.bag, self.options, self.remaps, bar.update, self.parameters, self._reads_often
            )
        try:
            recording = prepared(recording, self.parameters, _first(self.outages(recording)))
        finally:  # what is wrong with the recording may be the cause of what fails
            for text in recording.notices:
                print(f"note: {printable(text)}", file=sys.stderr)
        first_run.compile_kernels(lambda text: print(f"note: {text}", file=sys.stderr))
        return recording

    def outages(self, recording: Any) -> list:
        """The outages in order. Raises ``UserError`` for outages outside of the recording."""
        from nav_pose_estimator.offline.flights import outages

        wanted = list(self.wanted)
        if self.every is not None:
            wanted += outages.periodic(*self.every, first=self.every[0], end=recording.duration)
        wanted = outages.check_separate(wanted)
        late = [o for o in wanted if o.end > recording.duration]
        if late:
            raise UserError(
                f"the outage {late[0].start:g}:{late[0].length:g} ends after the recording ({recording.duration:.1f} s)"
            )
        return wanted


def _first(wanted: list) -> float:
    return min((outage.start for outage in wanted), default=math.inf)


def _replay(recording, parameters, wanted, folder: Path, rate: float) -> Any:
    """Replay, write all files, and return the result."""
    from nav_pose_estimator.offline.replay import files
    from nav_pose_estimator.offline.replay.beside import beside
    from nav_pose_estimator.offline.replay.replay import replay
    from nav_pose_estimator.offline.replay.report import write_report

    with _bar("replay", recording.imu_count) as bar:
        result = replay(recording, parameters, wanted, bar.update)
    bag = partial(_write_solution, folder / files.SOLUTION, result, min(rate, 10.0))
    with beside(bag) if len(result.track) else nullcontext():
        write_report(folder / files.REPORT, result)
        files.write_summary(folder / files.SUMMARY, result, seconds_since_start())
        files.write_tum(folder / files.TUM, result, rate)
        files.write_csv(folder / files.CSV, result, rate)
        _print_summary(result, seconds_since_start())
    return result


def _write_solution(path: Path, result: Any, rate: float) -> None:
    """Write the solution as a bag, in place of one that was begun."""
    from nav_pose_estimator.offline.replay.solution_bag import write_solution

    shutil.rmtree(path, ignore_errors=True)
    write_solution(path, result, rate)


def _refused(result) -> str:
    """A sentence on what was refused most often; empty if nothing was."""
    from nav_pose_estimator.engine.events import catalogue

    counters = {**result.status.counters, **result.recording.counters}
    causes = [(n, name) for name, n in counters.items() if ".rejected." in name and not name.endswith(_CONSEQUENCES)]
    most = sorted(causes, reverse=True)[:3]
    known = [(entry.meaning, name, count) for count, name in most if (entry := catalogue.find(name)) is not None]
    reasons = [f"{meaning} ({name}: {count} times)" for meaning, name, count in known]
    return f" Refused: {', '.join(reasons)}." if reasons else ""


def _print_summary(result, wall: float) -> None:
    """Print the result in a few lines."""
    from nav_pose_estimator.engine.solutions import Mode
    from nav_pose_estimator.offline.replay import second_opinion
    from nav_pose_estimator.offline.replay.report import OUTAGE_HEADER, mode_spans, outage_rows
    from nav_pose_estimator.offline.replay.warnings import warnings

    for warned in warnings(result):
        print(printable(warned.sentence), file=sys.stderr)
    spans = mode_spans(result)
    print("modes: " + (", ".join(f"{mode.value} from {start:.1f} s" for start, _, mode in spans[:12]) or "none"))
    if text := second_opinion.sentence(result):
        print(text)
    if result.status.waiting_for:
        print(f"waiting for: {result.status.waiting_for}")
    elif result.status.gnss_refusal and result.status.mode is not Mode.AIDED:
        print(f"GNSS is not used at the end: {result.status.gnss_refusal}")
    if result.errors:
        print("\n".join(aligned([OUTAGE_HEADER, *outage_rows(result)])))
    duration = result.recording.duration
    print(f"{duration:.0f} s in {wall:.2f} s, process start to report: {duration / wall:.0f} x real time ", end="")
    print(f"(estimator alone {duration / max(result.seconds, 1e-9):.0f} x)")


class _bar:
    """Progress bar on a terminal; otherwise tqdm is not imported, and nothing is shown."""

    def __init__(self, title: str, total: int | None) -> None:
        self._bar: Any = None
        self._pending = 0
        self._next = time.monotonic() + 0.3
        self._title, self._total = title, total

    def __enter__(self) -> "_bar":
        return self

    def update(self, count: int) -> None:
        """Advance by ``count`` IMU samples."""
        self._pending += count
        if self._pending < 4096 or not sys.stderr.isatty() or time.monotonic() < self._next:
            return
        if self._bar is None:
            from tqdm import tqdm

            self._bar = tqdm(desc=self._title, total=self._total, unit=" IMU", unit_scale=True, leave=False)
        self._bar.update(self._pending)
        self._pending = 0

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
