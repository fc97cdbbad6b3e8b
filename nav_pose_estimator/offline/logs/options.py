"""Options of every command that opens a flight log. Loads nothing that a ``--help`` would have to wait for."""

import argparse
import math
from dataclasses import dataclass

CLOCKS = ("auto", "log", "gnss")


@dataclass(frozen=True)
class LogOptions:
    """Which part of a log: ``imu`` and ``segment`` count from 1, None for the best IMU and for the whole log.

    ``clock``: ``log`` as it stands, ``gnss`` scaled to GNSS time, ``auto`` scaled where it is more than 1000 ppm off.
    ``max_gap`` [s]: an estimator starts again after a longer pause of the IMU. ``until`` [s since the first sample]:
    where the first outage begins; fixes after it do not decide whether the times are scaled.
    """

    imu: int | None = None
    segment: int | None = None
    clock: str = "auto"
    max_gap: float = 1.0  # the default of imu.max_gap
    until: float = math.inf


def add_options(parser: argparse.ArgumentParser) -> None:
    """``--imu``, ``--segment``, ``--clock``."""
    add = parser.add_argument
    add("--imu", type=int, metavar="N", help="of a log: which IMU, from 1 (default: that which follows GNSS best)")
    add("--segment", type=int, metavar="N", help="of a log: one arming or piece only, from 1 (default: the whole log)")
    add("--clock", choices=CLOCKS, default="auto", help="of a log: scale its times to GNSS time (auto: if 0.1 %% off)")


def options_of(
    arguments: argparse.Namespace, max_gap: float = LogOptions.max_gap, until: float = math.inf
) -> LogOptions:
    """The options that ``add_options`` has added; see :class:`LogOptions` for the others."""
    return LogOptions(arguments.imu, arguments.segment, arguments.clock, max_gap, until)
