"""When the estimators of one process exchange data, and what the navigator passes to the attitude filter."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.imu_checks import stays_in_period
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, NavigatorVelocity
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution

_PERIOD_NS = 250_000_000
_GOOD_TILT = 0.05  # rad: about what manoeuvres cost the attitude filter on its own


@dataclass
class ExchangeClock:
    """The estimators exchange data at the first IMU sample of every quarter second, whatever the block size."""

    period: int = 0  # number of the quarter of a second in which the last IMU sample fell

    def pieces(self, block: ImuBlock) -> Iterator[tuple[int, int]]:
        """Where to cut: behind each sample at which the estimators talk. Blocks so give what single samples give."""
        count = len(block)
        if stays_in_period(block.stamps_ns, self.period, _PERIOD_NS):
            return iter([(0, count)])
        periods = block.stamps_ns // _PERIOD_NS
        ends = np.flatnonzero(periods[1:] != periods[:-1]) + 2
        cuts = [0, *([1] if periods[0] != self.period else []), *ends.tolist(), count]
        if cuts[-2] >= count:
            del cuts[-2]
        return itertools.pairwise(cuts)

    def talks_behind(self, block: ImuBlock) -> bool:
        """Whether ``is_due`` will be true of it."""
        return int(block.stamps_ns[-1]) // _PERIOD_NS != self.period

    def is_due(self, sample: ImuSample | ImuBlock) -> bool:
        """Whether the estimators talk behind ``sample``."""
        stamp = sample.stamp_ns if isinstance(sample, ImuSample) else int(sample.stamps_ns[-1])
        before, self.period = self.period, stamp // _PERIOD_NS
        return self.period != before


def navigator_velocity(output: NavBlock | NavSolution) -> NavigatorVelocity:
    """The navigator's newest velocity and attitude, for the attitude filter."""
    if isinstance(output, NavSolution):
        stamp, velocity, q_nb, variances = output.stamp_ns, output.vel_n, output.q_nb, np.diag(output.cov)[:3]
    else:
        stamp, last = int(output.stamps_ns[-1]), output.rows[-1]
        velocity, q_nb = last[at.OUT_VEL : at.OUT_QUAT], last[at.OUT_QUAT : at.OUT_RATE]
        variances = last[at.OUT_VAR : at.OUT_VAR + 3]
    is_aided = output.mode is Mode.AIDED
    tilt_sd, heading_sd = math.sqrt(max(variances[0], variances[1])), math.sqrt(variances[2])
    is_valid = is_aided or tilt_sd < _GOOD_TILT
    return NavigatorVelocity(
        stamp,
        tuple(velocity.tolist()),
        is_valid,
        tuple(q_nb.tolist()),
        drifting=not is_aided,
        heading_sd=heading_sd,
        tilt_sd=tilt_sd,
    )
