"""``convert LOG OUT_BAG``: a flight log as a rosbag2 (mcap) with the topics that the nodes subscribe to."""

import argparse
import json
import sys
from pathlib import Path

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.logs.options import add_options, options_of

DESCRIPTION = "Write a flight log (PX4 ULog, ArduPilot DataFlash) as a rosbag2 (mcap), which every tool of ROS reads."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``convert``."""
    parser.description = DESCRIPTION
    parser.add_argument("log", type=Path, metavar="LOG", help="PX4 .ulg, or ArduPilot .bin or .log")
    parser.add_argument("bag", type=Path, metavar="OUT_BAG", help="folder of the new bag")
    add_options(parser)
    parser.add_argument("--force", action="store_true", help="replace an existing bag")


def run(arguments: argparse.Namespace) -> int:
    """Carry the command out. Raises ``UserError`` for what the user can mend."""
    from nav_pose_estimator.engine.parameters import Parameters
    from nav_pose_estimator.offline.bags.writer import check_room
    from nav_pose_estimator.offline.logs.log_flight import LogRecording
    from nav_pose_estimator.offline.logs.open_recording import open_recording, prepared

    beside = sidecar_path(arguments.bag)
    check_room(arguments.bag, arguments.force)
    if beside.exists() and not arguments.force:
        raise UserError(f"{beside} exists already; choose another name or give --force")
    recording = open_recording(arguments.log, options_of(arguments))
    if not isinstance(recording, LogRecording):
        raise UserError(f"{arguments.log} is a bag already")
    recording = prepared(recording, Parameters(), float("inf"))
    count = write_log_bag(arguments.bag, recording, arguments.force)
    for text in recording.notices:
        print(f"note: {text}", file=sys.stderr)
    print(f"{arguments.bag}: {recording.duration:.1f} s, {count} sensor messages")
    return 0


def sidecar_path(bag: Path) -> Path:
    """NAME.json beside NAME_bag, where replay and benchmark look for what is known of a flight."""
    return bag.with_name(bag.name.removesuffix("_bag") + ".json")


def write_log_bag(path: Path, recording, force: bool = False) -> int:
    """Write the samples of a log's recording, and NAME.json with what its parameters say: the number of messages."""
    from nav_pose_estimator.engine.samples import ImuBlock
    from nav_pose_estimator.offline.bags.sensor_topics import imu_topic, sensor_topics
    from nav_pose_estimator.offline.bags.writer import write_bag

    block, timed, arrival = recording.imu, [], recording.epoch_ns
    for sample in recording.samples:
        if not isinstance(sample, ImuBlock):
            arrival = arrival if sample.stamp_ns is None else sample.stamp_ns  # a count comes with its fix
            timed.append((arrival, sample))
    notes = {"source": recording.path.name, "firmware": recording.log.firmware}
    write_bag(path, [imu_topic(block, block.stamps_ns), *sensor_topics(timed)], force=force, notes=notes)
    sidecar = {"source": recording.path.name, "log_form": recording.log.form, **recording.sidecar}
    sidecar_path(path).write_text(json.dumps(sidecar, indent=1) + "\n", encoding="utf-8")
    return len(block) + len(timed)
