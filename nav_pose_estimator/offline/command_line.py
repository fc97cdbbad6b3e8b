"""Command line: imports only the module of the given command, and reports every failure in one sentence.

Exit codes: 0 success, 2 wrong use or bad input, 1 any other failure, 130 interrupted. ``NAV_POSE_DEBUG=1`` prints
tracebacks. A command on recordings is a module with ``add_arguments(parser)`` and ``run(arguments) -> int``; a node is
a module with ``main(arguments)``, which receives the ROS arguments unchanged.
"""

import argparse
import os
import shutil
import sys
import textwrap
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from io import TextIOWrapper
from typing import NoReturn

from nav_pose_estimator import __version__
from nav_pose_estimator.errors import UserError, described, unknown
from nav_pose_estimator.offline.ending_signals import interruptible
from nav_pose_estimator.offline.terminal import printable

PROGRAM = "nav_pose_estimator"
DONE, FAILED, WRONG_USE, INTERRUPTED = 0, 1, 2, 130
_FILE_ERRORS = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, PermissionError)


@dataclass(frozen=True)
class Command:
    """A command: its module, a summary in one line, and examples for the help."""

    module: str
    summary: str
    examples: tuple[str, ...]

    @property
    def is_node(self) -> bool:
        """Whether the command is a node, which has ROS arguments instead of options."""
        return self.module.startswith("nodes.")


_ROS_EXAMPLE = "--ros-args --params-file config/nav_pose_estimator.yaml -r imu/data_raw:=/imu"
COMMANDS = {
    "replay": Command(
        "offline.replay.command",
        "replay a rosbag2 or a flight log, take GNSS away, see how far the pose drifts",
        (
            "replay my_flight --outage 90:30",
            "replay flight.ulg --outage-every 60:30 --out out/my_flight",
            "replay flight.bin --list",
        ),
    ),
    "convert": Command(
        "offline.logs.convert_command",
        "write a flight log (PX4 ULog, ArduPilot DataFlash) as a rosbag2",
        ("convert flight.ulg out/flight_bag", "convert flight.bin out/flight_bag --segment 2 --imu 1"),
    ),
    "calibrate": Command(
        "offline.calibration.command",
        "find hard iron, soft iron and mounting of the magnetometer from recordings",
        ("calibrate turned_by_hand --out config/magnetometer.yaml",),
    ),
    "train": Command(
        "offline.training.command",
        "learn from recorded flights what helps in the first minutes of the next one",
        (
            "train archive/*.ulg --out my_wing.airframe",
            "train archive/ --out my_quad.airframe --one-aircraft --network",
        ),
    ),
    "simulate": Command(
        "offline.simulate_command",
        "write a rosbag2 of a simulated flight with its true motion",
        ("simulate out/flight --scenario multirotor_outage --duration 300 --seed 1 --imu icm42688",),
    ),
    "benchmark": Command(
        "offline.benchmarks.command",
        "compare methods over many outages, attitude filters, or measure speed",
        (
            "benchmark outage flights/*_bag --lengths 10,30,60 --methods coast,hold,best --out out/outages",
            "benchmark attitude trials/*.npz --methods complementary,two_stage --out out/attitude",
            "benchmark speed --out out/speed",
            "benchmark archive --what train --flights 8,16,32 --out out/archive",
        ),
    ),
    "warm_up": Command(
        "offline.replay.warm_up_command",
        "compile the numeric kernels now instead of at the first start",
        ("warm_up",),
    ),
    "attitude_node": Command(
        "nodes.attitude_node", "node: orientation from gyroscope, accelerometer, magnetometer", (_ROS_EXAMPLE,)
    ),
    "sins_node": Command(
        "nodes.sins_node", "node: strapdown navigator and Kalman filter with GNSS gate", (_ROS_EXAMPLE,)
    ),
    "anfis_node": Command("nodes.anfis_node", "node: learns to predict the errors of an outage", (_ROS_EXAMPLE,)),
    "pose_estimator": Command("nodes.pose_estimator", "the three nodes in one process", (_ROS_EXAMPLE,)),
    "synthetic_sensors": Command(
        "nodes.synthetic_sensors", "node: publishes simulated sensors in wall or simulated time", ("--ros-args",)
    ),
}


class _Parser(argparse.ArgumentParser):
    """Parser that reports an error in one sentence instead of printing the usage."""

    def error(self, message: str) -> NoReturn:
        if message.endswith("expected one argument"):  # also for --origin -33.9,151.2,40
            message += "; one that begins with a minus is given as --option=-VALUE"
        raise UserError(f"{message} (see {self.prog} --help)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``nav_pose_estimator COMMAND ...``; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given and given[0] in COMMANDS:
        return run_command(given[0], given[1:])
    return _guard(PROGRAM, partial(_without_command, given))


def run_command(name: str, arguments: Sequence[str] | None = None) -> int:
    """Run a command by its name; return the exit code."""
    # the matrices are small, so that several threads would only wait for each other, above all on a busy computer
    for library in ("OPENBLAS", "MKL", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    given = list(sys.argv[1:] if arguments is None else arguments)
    command = COMMANDS[name]
    return _guard(name, partial(_run_node if command.is_node else _run_offline, name, command, given))


def _without_command(given: list[str]) -> int:
    parser = _Parser(
        prog=PROGRAM,
        usage=f"{PROGRAM} COMMAND ...",
        description="Pose estimation for drones that lose GNSS.",
        epilog=_command_list() + f"\n\n{PROGRAM} COMMAND --help says more.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    parser.add_argument("command", nargs="?", help=argparse.SUPPRESS)
    name = parser.parse_known_args(given)[0].command
    if name is None:
        parser.print_help(sys.stderr)
        return WRONG_USE
    raise UserError(unknown("command", name, COMMANDS))


def _command_list() -> str:
    width = max(map(len, COMMANDS))
    return "commands:\n" + "\n".join(f"  {name:{width}}  {command.summary}" for name, command in COMMANDS.items())


def _run_offline(name: str, command: Command, given: list[str]) -> int:
    module = import_module(f"{PROGRAM}.{command.module}")
    parser = _parser(name, command)
    module.add_arguments(parser)
    if parser.description:  # the formatter leaves lines as they are, for the sake of the examples
        parser.description = textwrap.fill(parser.description, max(shutil.get_terminal_size().columns - 2, 20))
    with interruptible():
        return module.run(parser.parse_args(given)) or DONE


def _run_node(name: str, command: Command, given: list[str]) -> int:
    mine, ros = _split_ros(given)
    parser = _parser(name, command)
    parser.usage = f"{parser.prog} [--ros-args ROS ARGUMENTS]"
    parser.description = f"{command.summary}. All parameters: docs/parameters.md."
    unknown = parser.parse_known_args(mine)[1]
    if unknown:
        raise UserError(f"{unknown[0]!r} is not an option of a node; arguments for ROS go after --ros-args")
    try:
        module = import_module(f"{PROGRAM}.{command.module}")
    except ModuleNotFoundError:
        if find_spec("rclpy") is not None:
            raise
        raise UserError(
            "this node needs ROS 2 Jazzy, but rclpy is missing: source /opt/ros/jazzy/setup.bash, or run "
            "'make setup' and use .venv/bin/python"
        ) from None
    return module.main(ros) or DONE


def _split_ros(given: list[str]) -> tuple[list[str], list[str]]:
    """Split ``given`` into own arguments, and those of ROS from ``--ros-args`` to ``--`` or the end, unchanged."""
    mine: list[str] = []
    ros: list[str] = []
    inside = False
    for argument in given:
        inside = inside or argument == "--ros-args"
        (ros if inside else mine).append(argument)
        inside = inside and argument != "--"
    return mine, ros


def _parser(name: str, command: Command) -> argparse.ArgumentParser:
    examples = "\n".join(
        f"  {PROGRAM} {text if text.startswith(name) else f'{name} {text}'}" for text in command.examples
    )
    return _Parser(
        prog=f"{PROGRAM} {name}",
        epilog=f"examples:\n{examples}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _guard(name: str, action: Callable[[], int]) -> int:
    """Run ``action``; return its exit code, or print one sentence on stderr for an exception and return its code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a character that the terminal lacks must not end a run
    try:
        return action()
    except UserError as error:
        return _complain(name, str(error), WRONG_USE)
    except _FILE_ERRORS as error:
        return _complain(name, f"{error.filename}: {error.strerror}", WRONG_USE)
    except KeyboardInterrupt:
        return _complain(name, "interrupted", INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader of the output has ended
        return FAILED
    except Exception as error:
        return _complain(name, f"{_describe(error)} (NAV_POSE_DEBUG=1 shows where)", FAILED)


def _describe(error: Exception) -> str:
    if isinstance(error, ModuleNotFoundError) and not (error.name or "").startswith(PROGRAM):
        return (
            f"the Python package {error.name} is not installed for {sys.executable}, see requirements.txt; "
            "'make demo' and 'make setup' install it for .venv/bin/python"
        )
    return f"failed: {described(error)}"


def _complain(name: str, text: str, code: int) -> int:
    if os.environ.get("NAV_POSE_DEBUG", "0") not in ("", "0"):
        traceback.print_exc()
    print(f"{name}: {printable(text)}", file=sys.stderr)
    return code


# entry points of the executables in lib/nav_pose_estimator
attitude_node = partial(run_command, "attitude_node")
sins_node = partial(run_command, "sins_node")
anfis_node = partial(run_command, "anfis_node")
pose_estimator = partial(run_command, "pose_estimator")
synthetic_sensors = partial(run_command, "synthetic_sensors")
simulate = partial(run_command, "simulate")
replay = partial(run_command, "replay")
convert = partial(run_command, "convert")
calibrate = partial(run_command, "calibrate")
train = partial(run_command, "train")
benchmark = partial(run_command, "benchmark")
warm_up = partial(run_command, "warm_up")
