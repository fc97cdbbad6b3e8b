"""The command line: which command does what, and how errors end.

A command is a module with ``add_arguments(parser)`` and ``run(arguments) -> int``; it is imported when it is called.
Exit codes: 0 done, 2 wrong use or bad input (one sentence on stderr), 1 anything else.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module

from nav_pose_estimator import __version__
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline import process_clock  # noqa: F401  loaded first: it dates the start of the process

PROGRAM = "nav_pose_estimator"
COMMANDS = {
    "replay": ("nav_pose_estimator.offline.replay_command", "run a rosbag2 through the estimator, with GNSS outages"),
    "benchmark": ("nav_pose_estimator.offline.benchmark_command", "outages over many bags, attitude, speed"),
    "simulate": ("nav_pose_estimator.offline.simulate_command", "write a rosbag2 of a simulated flight with its truth"),
}
NODES = {
    "attitude_node": "attitude from IMU and magnetometer",
    "sins_node": "strapdown navigator with its Kalman filter",
    "anfis_node": "learns to bridge GNSS outages",
    "pose_estimator": "the three nodes in one process",
    "synthetic_sensors": "publishes synthetic IMU and GNSS",
}
OK, FAILED, WRONG_USE = 0, 1, 2


def main(arguments: Sequence[str]) -> int:
    """Run one command; returns the exit code."""
    name = arguments[0] if arguments else ""
    if name in NODES:
        return _run_node(name, list(arguments[1:]))
    if name in ("-h", "--help"):
        print(_overview())
        return OK
    if name == "--version":
        print(f"{PROGRAM} {__version__}")
        return OK
    if name not in COMMANDS:
        what = f"there is no command {name!r}" if name else "a command is missing"
        print(f"{PROGRAM}: {what}; choose from {', '.join([*COMMANDS, *NODES])}", file=sys.stderr)
        return WRONG_USE
    return run_command(name, list(arguments[1:]))


def run_command(name: str, arguments: list[str]) -> int:
    """Run one of ``COMMANDS``; every error that the user can mend becomes one line and exit code 2."""
    parser = argparse.ArgumentParser(prog=f"{PROGRAM} {name}")
    try:
        module = import_module(COMMANDS[name][0])
        module.add_arguments(parser)
        return int(module.run(parser.parse_args(arguments)) or OK)
    except UserError as error:
        print(f"{PROGRAM} {name}: {error}", file=sys.stderr)
        return WRONG_USE
    except KeyboardInterrupt:
        print(f"{PROGRAM} {name}: interrupted", file=sys.stderr)
        return FAILED
    except BrokenPipeError:  # the reader of our output has gone, as in "replay ... | head"
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except SystemExit as stop:  # argparse: 0 after --help, 2 after wrong use
        return stop.code if isinstance(stop.code, int) else FAILED


def replay_main() -> None:
    """Entry point of the installed executable ``replay``."""
    sys.exit(run_command("replay", sys.argv[1:]))


def benchmark_main() -> None:
    """Entry point of the installed executable ``benchmark``."""
    sys.exit(run_command("benchmark", sys.argv[1:]))


def simulate_main() -> None:
    """Entry point of the installed executable ``simulate``."""
    sys.exit(run_command("simulate", sys.argv[1:]))


def _run_node(name: str, arguments: list[str]) -> int:
    try:
        module = import_module(f"nav_pose_estimator.nodes.{name}")
    except ModuleNotFoundError as error:
        if (error.name or "").startswith(PROGRAM):
            raise
        print(f"{PROGRAM} {name}: needs ROS 2, but {error.name} is not installed", file=sys.stderr)
        return WRONG_USE
    return int(module.main(arguments) or OK)


def _overview() -> str:
    width = max(map(len, [*COMMANDS, *NODES])) + 2
    lines = [f"usage: {PROGRAM} COMMAND ...", "", "on recordings:"]
    lines += [f"  {name.ljust(width)}{text}" for name, (_, text) in COMMANDS.items()]
    lines += ["", "nodes (ROS 2 arguments follow):"]
    lines += [f"  {name.ljust(width)}{text}" for name, text in NODES.items()]
    return "\n".join([*lines, "", f"{PROGRAM} COMMAND --help tells the rest."])
