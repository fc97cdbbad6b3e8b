"""Attitude filter, navigator and learner composed: what the ``pose_estimator`` node and ``replay`` run."""

from __future__ import annotations

from typing import Any

import numpy as np

from nav_pose_estimator.core import layout as at
from nav_pose_estimator.engine.attitude import AttitudeEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, MagSample, NavigatorVelocity, Sample
from nav_pose_estimator.engine.sins import SinsEngine
from nav_pose_estimator.engine.solutions import Event, Mode, NavBlock, NavSolution, Output, Status

_VELOCITY_PERIOD_NS = 100_000_000


class PoseEstimator:
    """The three estimators with direct calls between them: the same exchanges that the nodes make over topics."""

    def __init__(self, parameters: Parameters | None = None, attitude: bool = True) -> None:
        """``attitude`` False leaves the attitude filter out (benchmarks that look at the position only)."""
        self.parameters = parameters or Parameters()
        self.sins = SinsEngine(self.parameters)
        self.attitude = AttitudeEngine(self.parameters) if attitude else None
        self._next_velocity_ns = 0

    def feed(self, sample: Sample) -> list[Output]:
        """Take one sample; returns solutions and events in order: attitude first, then navigation."""
        outputs: list[Output] = []
        if self.attitude is not None and isinstance(sample, (ImuSample, ImuBlock, MagSample)):
            # what the attitude filter says of the IMU the navigator says as well: told once
            outputs += [o for o in self.attitude.feed(sample) if not _is_imu_event(o)]
        solutions = self.sins.feed(sample)
        if self.attitude is not None:
            self._share_velocity(solutions)
        return outputs + solutions

    def _share_velocity(self, outputs: list[Output]) -> None:
        """Give the attitude filter the navigator's velocity, ten times a second."""
        for output in outputs:
            if isinstance(output, NavSolution):
                stamp, velocity = output.stamp_ns, output.vel_n
            elif isinstance(output, NavBlock):
                stamp, velocity = int(output.stamps_ns[-1]), output.rows[-1, at.OUT_VEL : at.OUT_QUAT]
            else:
                continue
            if stamp >= self._next_velocity_ns or stamp < self._next_velocity_ns - 10 * _VELOCITY_PERIOD_NS:
                self._next_velocity_ns = stamp + _VELOCITY_PERIOD_NS
                valid = output.mode is Mode.AIDED
                self.attitude.feed(NavigatorVelocity(stamp, tuple(np.asarray(velocity).tolist()), valid))

    @property
    def mode(self) -> Mode:
        """How things stand with the navigator."""
        return self.sins.mode

    @property
    def origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude [rad] and height [m] of the local frame."""
        return self.sins.origin

    def set_use_gnss(self, flag: bool) -> None:
        """Switch GNSS off and on again (outage drill)."""
        self.sins.set_use_gnss(flag)

    def status(self) -> Status:
        """The navigator's status."""
        return self.sins.status()

    def reset(self, stamp_ns: int, reason: str) -> list[Output]:
        """Start again."""
        self._next_velocity_ns = 0
        attitude = [] if self.attitude is None else self.attitude.reset(stamp_ns, reason)
        return attitude + self.sins.reset(stamp_ns, reason)

    def warm_up(self) -> None:
        """Compile every kernel now."""
        self.sins.warm_up()
        if self.attitude is not None:
            self.attitude.warm_up()

    def snapshot(self) -> Any:
        """Everything that changes, to be given to ``restore``."""
        attitude = None if self.attitude is None else self.attitude.snapshot()
        return self.sins.snapshot(), attitude, self._next_velocity_ns

    def restore(self, snapshot: Any) -> None:
        """Go back to an earlier ``snapshot``."""
        sins, attitude, self._next_velocity_ns = snapshot
        self.sins.restore(sins)
        if self.attitude is not None and attitude is not None:
            self.attitude.restore(attitude)


def _is_imu_event(output: Output) -> bool:
    return isinstance(output, Event) and output.name.startswith("imu.")
