"""Options of all commands that open flight logs. The module imports nothing that would delay ``--help``."""

import argparse
import math
from dataclasses import dataclass

CLOCKS = ("auto", "log", "gnss")


@dataclass(frozen=True)
class LogOptions:
    """Part of a log: ``imu`` and ``segment`` count from 1; None for the best IMU and the whole log.

    ``clock``: ``log`` for the log's times, ``gnss`` for times scaled to GNSS time, ``auto`` to scale only if the error
    exceeds 1000 ppm. ``max_gap`` [s]: longest gap of the IMU without a restart of the estimator. ``until`` [s since the
    first sample]: begin of the first outage; later fixes do not affect the scaling.
    """

    imu: int | None = None
    segment: int | None = None
    clock: str = "auto"
    max_gap: float = 1.0  # the default of imu.max_gap
    until: float = math.inf


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options ``--imu``, ``--segment`` and ``--clock``."""
    add = parser.add_argument
    add("--imu", type=int, metavar="N", help="of a log: number of the IMU, from 1 (default: the best match to GNSS)")
    add("--segment", type=int, metavar="N", help="of a log: one arming or piece only, from 1 (default: the whole log)")
    add("--clock", choices=CLOCKS, default="auto", help="of a log: scale its times to GNSS time (auto: if 0.1 %% off)")


def options_of(
    arguments: argparse.Namespace, max_gap: float = LogOptions.max_gap, until: float = math.inf
) -> LogOptions:
    """Values of the options of ``add_options``; :class:`LogOptions` describes the others."""
    return LogOptions(arguments.imu, arguments.segment, arguments.clock, max_gap, until)
