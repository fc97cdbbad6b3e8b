"""Command ``convert LOG OUT_BAG``: writes a flight log as a rosbag2 (mcap) with the topics of the nodes."""

import argparse
import json
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.logs.options import LogOptions, add_options, options_of
from nav_pose_estimator.offline.output_file import write_whole
from nav_pose_estimator.offline.terminal import note_left_out, printable

DESCRIPTION = "Write a flight log (PX4 ULog, ArduPilot DataFlash) as a rosbag2 (mcap), which every tool of ROS reads."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``convert``."""
    parser.description = DESCRIPTION
    what = "PX4 .ulg, or ArduPilot .bin or .log; a folder, list (.txt) or pattern stands for many"
    parser.add_argument("log", type=Path, metavar="LOG", help=what)
    parser.add_argument("bag", type=Path, metavar="OUT_BAG", help="folder of the new bag; of many: that holds them")
    add_options(parser)
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes for many logs (default: 1)")
    parser.add_argument("--force", action="store_true", help="replace an existing bag")


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises ``UserError`` for wrong options, unreadable logs and an output that cannot be written."""
    from nav_pose_estimator.offline.archive.recordings import find

    logs = find([arguments.log])
    if logs != [arguments.log]:
        return _convert_all(logs, arguments)
    print(_convert(_Job(arguments.log, arguments.bag, options_of(arguments), arguments.force)))
    return 0


@dataclass(frozen=True)
class _Job:
    log: Path
    bag: Path
    options: LogOptions
    force: bool


def _convert_all(logs: list[Path], arguments: argparse.Namespace) -> int:
    """Convert logs to bags NAME_bag in one folder; existing bags are of an earlier run, and are kept."""
    from nav_pose_estimator.offline.archive.jobs import Failure, carry_out

    if arguments.jobs < 1:
        raise UserError("--jobs must be at least 1")
    jobs = [
        _Job(log, arguments.bag / f"{log.stem}_bag", options_of(arguments), arguments.force)
        for log in logs
        if not _is_bag(log)
    ]
    if not jobs:
        raise UserError(f"{arguments.log} holds bags only, no flight log")
    names = Counter(job.bag for job in jobs)
    if twins := [job.log.name for job in jobs if names[job.bag] > 1]:
        raise UserError(f"{twins[0]} and another log would become the same bag: convert them one by one")
    due = [job for job in jobs if job.force or not job.bag.exists()]
    failed = 0
    for number, outcome in carry_out(_convert, due, arguments.jobs):
        if isinstance(outcome, Failure):
            failed += 1
            note_left_out(due[number].log.name, outcome.why)
        else:
            print(outcome, flush=True)
    print(f"{len(due) - failed} bags written, {failed} logs left out, {len(jobs) - len(due)} bags were there already")
    return 0 if failed < len(due) or not due else 2


def _is_bag(path: Path) -> bool:
    """Whether ``path`` is a bag; False if it is damaged or missing, which is reported when it is read."""
    from nav_pose_estimator.offline.logs.open_recording import log_form

    try:
        return path.exists() and log_form(path) is None
    except UserError:
        return False


def _convert(job: _Job) -> str:
    """Write one bag; return a sentence for the user. Raises ``UserError`` for a failure."""
    from nav_pose_estimator.engine.parameters import Parameters
    from nav_pose_estimator.offline.bags.writer import check_room
    from nav_pose_estimator.offline.logs.log_flight import LogRecording
    from nav_pose_estimator.offline.logs.open_recording import open_recording, prepared
    from nav_pose_estimator.offline.sidecar import sidecar_path

    beside = sidecar_path(job.bag)
    check_room(job.bag, job.force)
    if beside.exists() and not job.force:
        raise UserError(f"{beside} exists already; choose another name or give --force")
    recording = open_recording(job.log, job.options)
    if not isinstance(recording, LogRecording):
        raise UserError(f"{job.log} is a bag already")
    recording = prepared(recording, Parameters(), float("inf"))
    count = write_log_bag(job.bag, recording, job.force)
    for text in recording.notices:
        print(f"note: {printable(text)}", file=sys.stderr)
    return f"{job.bag}: {recording.duration:.1f} s, {count} sensor messages"


def write_log_bag(path: Path, recording, force: bool = False) -> int:
    """Write the samples of a log's recording, and NAME.json with data from its parameters; return the message count."""
    from nav_pose_estimator.engine.samples import ImuBlock
    from nav_pose_estimator.offline.bags.sensor_topics import imu_topic, sensor_topics
    from nav_pose_estimator.offline.bags.writer import write_bag
    from nav_pose_estimator.offline.sidecar import sidecar_path

    block, timed, arrival = recording.imu, [], recording.epoch_ns
    for sample in recording.samples:
        if not isinstance(sample, ImuBlock):
            arrival = arrival if sample.stamp_ns is None else sample.stamp_ns  # a count comes with its fix
            timed.append((arrival, sample))
    notes = {"source": recording.path.name, "firmware": recording.log.firmware}
    write_bag(path, [imu_topic(block, block.stamps_ns), *sensor_topics(timed)], force=force, notes=notes)
    sidecar = {"source": recording.path.name, "log_form": recording.log.form, **recording.sidecar}
    write_whole(sidecar_path(path), json.dumps(sidecar, indent=1) + "\n")
    return len(block) + len(timed)
