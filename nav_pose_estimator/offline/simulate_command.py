"""Command ``simulate OUT_BAG``: writes a simulated flight as a rosbag2."""

import argparse
from pathlib import Path

from nav_pose_estimator.errors import UserError

DESCRIPTION = "Write a rosbag2 with all sensor topics and /ground_truth/odom of a simulated flight or drive."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``simulate``."""
    parser.description = DESCRIPTION
    parser.add_argument("bag", type=Path, nargs="?", metavar="OUT_BAG", help="folder of the new bag")
    add = parser.add_argument
    add("--scenario", default="multirotor_outage", metavar="NAME", help="scenario (default: multirotor_outage)")
    add("--duration", type=float, metavar="S", help="length in seconds (default: that of the scenario)")
    add("--seed", type=int, default=0, metavar="N", help="the same seed gives the same flight (default: 0)")
    add("--imu", default="icm42688", metavar="GRADE", help="IMU and its errors (default: icm42688)")
    add("--imu-rate", type=float, metavar="HZ", help="IMU rate (default: that of the scenario)")
    add("--truth-rate", type=float, default=50.0, metavar="HZ", help="rate of /ground_truth/odom (default: 50)")
    add("--storage", choices=("mcap", "sqlite3"), default="mcap", help="file format (default: mcap)")
    add("--small", action="store_true", help="compress harder (mcap): slower, 10 %% smaller")
    add("--force", action="store_true", help="replace a bag that this command has written")
    add("--list", action="store_true", help="list scenarios and IMU grades, write nothing")


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises ``UserError`` for wrong options and an output that cannot be written."""
    from nav_pose_estimator.sim.scenarios import find_scenario, generate

    if arguments.list:
        print(_catalogue())
        return 0
    if arguments.bag is None:
        raise UserError("give the folder of the new bag, or --list to see what is available")
    from nav_pose_estimator.offline.bags.writer import FAST, SMALL, check_room
    from nav_pose_estimator.offline.simulated_bag import write_recording

    if not 0.1 <= arguments.truth_rate <= 4000.0:
        raise UserError("--truth-rate must lie between 0.1 and 4000 Hz")
    find_scenario(arguments.scenario)
    check_room(arguments.bag, arguments.force)  # before the simulation, not after it
    recording = generate(arguments.scenario, arguments.duration, arguments.seed, arguments.imu, arguments.imu_rate)
    level = SMALL if arguments.small else FAST
    write_recording(arguments.bag, recording, arguments.storage, arguments.force, arguments.truth_rate, level)
    print(
        f"{arguments.bag}: {recording.scenario}, {recording.truth.t[-1]:g} s, IMU {recording.imu_grade.name} "
        f"at {1.0 / recording.truth.dt:g} Hz, {len(recording.imu) + len(recording.others)} sensor messages"
    )
    return 0


def _catalogue() -> str:
    from nav_pose_estimator.sim.imu_grades import IMU_GRADES
    from nav_pose_estimator.sim.scenarios import SCENARIOS

    width = max(map(len, SCENARIOS))
    lines = [f"  {s.name:{width}}  {s.duration:5.0f} s  {s.description}" for s in SCENARIOS.values()]
    return "\n".join(["scenarios:", *lines, "IMU grades:", f"  {', '.join(IMU_GRADES)}"])
