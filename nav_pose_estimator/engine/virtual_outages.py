"""No regret: outages are rehearsed while GNSS is good, and help that did not help in rehearsal is not used.

Every minute two copies of the navigator fly half a minute without GNSS on the live data: one coasts, one is helped by
the priors. Afterwards both are compared with the aided navigator. Only the past decides about the next outage.
"""

from __future__ import annotations

import copy
from collections import deque

import numpy as np

from nav_pose_estimator.core import layout as at
from nav_pose_estimator.engine.habits import Habits
from nav_pose_estimator.engine.modes import DENIED
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    Sample,
    SatelliteCount,
    SetPose,
)
from nav_pose_estimator.engine.sins import SinsEngine
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution, Output
from nav_pose_estimator.engine.timeline import step_enu

_LENGTH_NS = 30_000_000_000
_PERIOD_NS = 60_000_000_000
_KEPT = 6  # rehearsals that count
_CLEARLY = 4.0  # ratio of squared errors: coasting grows with the cube of time, so a draw at 30 s is a loss at 60 s
_FROM_GNSS = (GnssFix, GnssVelocity, SatelliteCount, SetPose)


class VirtualOutages:
    """Rehearsals of an outage and what they say of the priors."""

    def __init__(self) -> None:
        self._coasting: SinsEngine | None = None
        self._helped: SinsEngine | None = None
        self._habits: Habits | None = None
        self._latest: NavBlock | NavSolution | None = None  # of the helped copy
        self._waiting: list[ImuSample] = []  # IMU samples that the copies get as one block: a tenth of the work
        self._next_ns = 0
        self._until_ns = 0
        self._squares: deque[tuple[float, float]] = deque(maxlen=_KEPT)  # errors coasting and helped, m^2

    def copy(self) -> VirtualOutages:
        """An independent copy, running rehearsals included."""
        twin = copy.copy(self)
        twin._coasting = self._coasting and self._coasting.snapshot()
        twin._helped = self._helped and self._helped.snapshot()
        twin._habits = self._habits and self._habits.copy()
        twin._squares = self._squares.copy()
        twin._waiting = self._waiting.copy()
        return twin

    @property
    def rehearsals(self) -> int:
        """Number of finished rehearsals that count."""
        return len(self._squares)

    @property
    def priors_help(self) -> bool:
        """True unless the rehearsals say that coasting does clearly better."""
        return sum(helped for _, helped in self._squares) <= _CLEARLY * sum(coasting for coasting, _ in self._squares)

    def feed(self, sample: Sample) -> None:
        """Hand a sample to the copies; nothing that comes from GNSS reaches them."""
        if self._coasting is None or self._helped is None or isinstance(sample, _FROM_GNSS):
            return
        if isinstance(sample, ImuSample):
            self._waiting.append(sample)
            return
        self._catch_up()
        self._fly(sample)

    def step(self, stamp_ns: int, sins: SinsEngine, habits: Habits) -> None:
        """Called several times a second behind ``feed``: start, help, or judge."""
        self._catch_up()
        if sins.mode is not Mode.AIDED or self._has_restarted():
            self._stop()
        elif self._helped is None or self._coasting is None or self._habits is None:
            if stamp_ns >= self._next_ns or stamp_ns < self._next_ns - _PERIOD_NS:
                self._start(stamp_ns, sins, habits)
        elif stamp_ns >= self._until_ns:
            truth = sins.nominal_state()
            self._squares.append((_squared_error(self._coasting, truth), _squared_error(self._helped, truth)))
            self._stop()
        elif self._latest is not None:
            for prior in self._habits.feed(self._latest):
                self._helped.feed(prior)

    def _has_restarted(self) -> bool:
        """A gap in the IMU data makes the copies align again, for which they lack GNSS."""
        return self._coasting is not None and self._coasting.mode not in (*DENIED, Mode.AIDED)

    def _catch_up(self) -> None:
        """Fly the copies up to the last IMU sample."""
        if self._waiting:
            stamps = np.array([sample.stamp_ns for sample in self._waiting])
            gyro = np.array([sample.gyro for sample in self._waiting])
            accel = np.array([sample.accel for sample in self._waiting])
            self._waiting.clear()
            self._fly(ImuBlock(stamps, gyro, accel))

    def _fly(self, sample: Sample) -> None:
        if self._coasting is not None and self._helped is not None:
            self._coasting.feed(sample)
            self._latest = last_solution(self._helped.feed(sample)) or self._latest

    def _start(self, stamp_ns: int, sins: SinsEngine, habits: Habits) -> None:
        self._coasting, self._helped, self._habits = sins.snapshot(), sins.snapshot(), habits.copy()
        self._latest = None
        self._until_ns, self._next_ns = stamp_ns + _LENGTH_NS, stamp_ns + _PERIOD_NS

    def _stop(self) -> None:
        self._coasting = self._helped = self._habits = self._latest = None
        self._waiting.clear()


def _squared_error(engine: SinsEngine, truth: np.ndarray) -> float:
    east, north, _ = step_enu(truth[at.LAT : at.VEL], engine.nominal_state())
    return float(east**2 + north**2)


def last_solution(outputs: list[Output]) -> NavBlock | NavSolution | None:
    """The last navigation solution among ``outputs``."""
    return next((o for o in reversed(outputs) if isinstance(o, (NavBlock, NavSolution))), None)
