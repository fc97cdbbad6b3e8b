"""The exchange of data between the estimators of one process: its clock, and the navigator's velocity."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.imu_checks import next_exchange
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, NavigatorVelocity
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution, Output

_PERIOD_NS = 250_000_000
_GOOD_TILT = 0.05  # rad: about the tilt error that manoeuvres cause in the attitude filter alone


@dataclass
class ExchangeClock:
    """The estimators exchange data at the first IMU sample of every quarter second, whatever the block size.

    With ``periods`` other than 1, only every second, third ... exchange counts, numbered from the zero of the stamps,
    and any exchange after a gap.
    """

    period: int = 0  # number of the quarter of a second in which the last IMU sample fell

    def pieces(self, block: ImuBlock, periods: int = 1) -> Iterator[tuple[int, int]]:
        """Cuts a block behind each sample at which data are exchanged, so that blocks give what single samples give."""
        stamps, begin, period = block.stamps_ns, 0, self.period
        while begin < len(stamps):
            end = min(next_exchange(stamps, begin, period, _PERIOD_NS, periods) + 1, len(stamps))
            yield begin, end
            begin, period = end, int(stamps[end - 1]) // _PERIOD_NS

    def is_due(self, sample: ImuSample | ImuBlock, periods: int = 1) -> bool:
        """Whether the estimators exchange data behind ``sample``; advances the clock."""
        before, self.period = self.period, newest_stamp(sample) // _PERIOD_NS
        return self.period // periods != before // periods or abs(self.period - before) > 1


def newest_stamp(sample: ImuSample | ImuBlock) -> int:
    """Stamp [ns] of the last IMU sample."""
    return sample.stamp_ns if isinstance(sample, ImuSample) else int(sample.stamps_ns[-1])


def navigator_velocity(outputs: Iterable[Output], after_ns: int, at_ns: int) -> NavigatorVelocity | None:
    """The navigator's velocity and attitude at the IMU sample of ``at_ns``, for the attitude filter.

    None where ``outputs`` have none, as where the navigator has refused that sample, or where ``at_ns`` is not later
    than ``after_ns``, the last exchange.
    """
    found: tuple[NavBlock | NavSolution, int] | None = None
    for output in outputs if at_ns > after_ns else ():
        if isinstance(output, NavSolution) and output.stamp_ns == at_ns:
            found = output, 0
        elif isinstance(output, NavBlock):
            row = int(output.stamps_ns.searchsorted(at_ns))
            if row < len(output.stamps_ns) and output.stamps_ns[row] == at_ns:
                found = output, row
    return None if found is None else _velocity(*found)


def _velocity(output: NavBlock | NavSolution, row: int) -> NavigatorVelocity:
    if isinstance(output, NavSolution):
        stamp, velocity, q_nb = output.stamp_ns, output.vel_n.tolist(), output.q_nb.tolist()
        variances = np.diag(output.cov)[:3].tolist()
    else:
        stamp, last = int(output.stamps_ns[row]), output.rows[row].tolist()
        velocity, q_nb = last[at.OUT_VEL : at.OUT_QUAT], last[at.OUT_QUAT : at.OUT_RATE]
        variances = last[at.OUT_VAR : at.OUT_VAR + 3]
    is_aided = output.mode is Mode.AIDED
    tilt_sd, heading_sd = math.sqrt(max(variances[0], variances[1])), math.sqrt(variances[2])
    is_valid = is_aided or tilt_sd < _GOOD_TILT
    return NavigatorVelocity(
        stamp,
        tuple(velocity),
        is_valid,
        tuple(q_nb),
        drifting=not is_aided,
        heading_sd=heading_sd,
        tilt_sd=tilt_sd,
    )
