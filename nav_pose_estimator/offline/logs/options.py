"""Options of every command that opens a flight log. Loads nothing that a ``--help`` would have to wait for."""

import argparse
from dataclasses import dataclass

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.imu import ImuParameters

CLOCKS = ("auto", "log", "gnss")


@dataclass(frozen=True)
class LogOptions:
    """Which part of a log: ``imu`` and ``segment`` count from 1, None for the best IMU and for the whole log.

    ``clock``: ``log`` as it stands, ``gnss`` scaled to GNSS time, ``auto`` scaled where it is more than 1000 ppm off.
    ``max_gap`` [s]: an estimator starts again after a longer pause of the IMU.
    """

    imu: int | None = None
    segment: int | None = None
    clock: str = "auto"
    max_gap: float = ImuParameters().max_gap


def add_options(parser: argparse.ArgumentParser) -> None:
    """``--imu``, ``--segment``, ``--clock``."""
    add = parser.add_argument
    add("--imu", type=int, metavar="N", help="of a log: which IMU, from 1 (default: that which follows GNSS best)")
    add("--segment", type=int, metavar="N", help="of a log: one arming or piece only, from 1 (default: the whole log)")
    add("--clock", choices=CLOCKS, default="auto", help="of a log: scale its times to GNSS time (auto: if 0.1 %% off)")


def options_of(arguments: argparse.Namespace, parameters: Parameters | None = None) -> LogOptions:
    """The options that ``add_options`` has added."""
    max_gap = (parameters or Parameters()).imu.max_gap
    return LogOptions(arguments.imu, arguments.segment, arguments.clock, max_gap)
