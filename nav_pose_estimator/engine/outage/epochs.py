"""Reduces navigation solutions to half-second epochs, and keeps those of aided flight."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.motion.epochs import COLUMNS, PERIOD, TIME, epoch
from nav_pose_estimator.core.numerics.snapshot import SHARED
from nav_pose_estimator.engine.outage.methods.method import OutageMethod
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution
from nav_pose_estimator.errors import UserError

_PERIOD_NS = round(PERIOD * 1e9)
_LEAST_SHARE = 0.6  # an epoch with a smaller fraction of the usual number of IMU samples has a gap
_REMEMBERED = 600.0  # s of aided flight in memory
_LARGEST = 1e10  # largest plausible value of any column, which is the time [s]
_GOOD_HEADING = 0.2  # rad: largest standard deviation of the heading with which directions can be learned


class FinishedEpoch(NamedTuple):
    """``values`` (COLUMNS + K,) of an epoch, and whether it can be learned from: aided, complete, heading known."""

    values: np.ndarray
    is_good: bool


@dataclass
class EpochCollector:
    """Forms epochs from the rows of navigation solutions, with the columns that the method adds."""

    method: OutageMethod = field(default_factory=OutageMethod, metadata=SHARED)
    epochs: deque[np.ndarray] = field(default_factory=deque)  # the last ones, in any mode
    rows: list[np.ndarray] = field(default_factory=list)  # of the epoch under way
    before: np.ndarray = field(default_factory=lambda: np.empty((0, at.OUT_COLUMNS)))  # rows of the last epoch
    period: int = 0  # number of the epoch under way, counted from the zero of the stamps
    usual: float = 0.0  # usual number of rows in an epoch
    is_aided: bool = True  # whether the epoch under way has been aided throughout

    @property
    def recent(self) -> np.ndarray:
        """The last epochs, (up to the method's ``history``, COLUMNS or more)."""
        return np.array(self.epochs)

    def feed(self, output: NavBlock | NavSolution) -> FinishedEpoch | None:
        """Take a solution, in which only the last sample may end an epoch; returns the epoch when it does."""
        stamp, rows = last_stamp(output), solution_rows(output)
        if isinstance(output, NavBlock) and len(rows) > 1 and self._begins_with(output):
            # as sample by sample: the first sample begins an epoch, and the last one may already end it
            self.feed(replace(output, stamps_ns=output.stamps_ns[:1], rows=rows[:1]))
            return self.feed(replace(output, stamps_ns=output.stamps_ns[1:], rows=rows[1:]))
        self.rows.append(rows)
        self.is_aided &= output.mode is Mode.AIDED
        period = stamp // _PERIOD_NS
        if period == self.period:
            return None
        is_consecutive, self.period = period == self.period + 1, period
        rows = joined_rows(self.rows)
        is_aided, count = self.is_aided, len(rows)
        self.rows, self.is_aided = [], True
        before, self.before = self.before, rows if is_consecutive else rows[:0]
        if not is_consecutive:
            self.usual = 0.0
            return None
        is_good = is_aided and count >= _LEAST_SHARE * self.usual and rows[-1, at.OUT_VAR + 2] < _GOOD_HEADING**2
        self.usual = count if self.usual == 0.0 else self.usual + 0.05 * (count - self.usual)
        finished = epoch(stamp * 1e-9, rows)
        if self.method.adds_columns:
            added = self.method.columns(output, np.concatenate([before, rows]))
            finished = np.append(finished, added)
        self.epochs.append(finished)
        if len(self.epochs) > self.method.history:
            self.epochs.popleft()
        return FinishedEpoch(finished, bool(is_good))

    def _begins_with(self, block: NavBlock) -> bool:
        """Whether the first sample of ``block`` does not continue the epoch under way, after a start or a gap."""
        return not 0 <= int(block.stamps_ns[0]) // _PERIOD_NS - self.period <= 1


@dataclass
class FlightMemory:
    """The epochs (COLUMNS + K,) of the last ten minutes of aided flight; K is what the method adds."""

    epochs: deque[np.ndarray] = field(default_factory=lambda: deque(maxlen=round(_REMEMBERED / PERIOD)))

    def __len__(self) -> int:
        return len(self.epochs)

    @property
    def seconds(self) -> float:
        """Length of the flight in memory [s]."""
        return len(self.epochs) * PERIOD

    def add(self, one: np.ndarray) -> None:
        """Remember an epoch."""
        if self.epochs and len(self.epochs[-1]) != len(one):
            self.epochs.clear()  # epochs of a saved state that belong to another method
        self.epochs.append(one)

    def take_over(self, epochs: np.ndarray) -> None:
        """Begin with ``epochs`` (N, COLUMNS or more) of an earlier process. Raises ``UserError`` for bad ones."""
        if not (epochs.ndim == 2 and epochs.shape[1] >= COLUMNS and epochs.dtype.kind == "f"):
            raise UserError("its flight memory is not what it should be")
        if not (np.abs(epochs) < _LARGEST).all() or (np.diff(epochs[:, TIME]) <= 0.0).any():
            raise UserError("its flight memory is beyond what a vehicle can do")
        self.epochs.extend(epochs)

    def last(self, seconds: float) -> np.ndarray:
        """The epochs of the last ``seconds`` before the newest one, (N, COLUMNS or more)."""
        if not self.epochs:
            return np.empty((0, COLUMNS))
        epochs = np.array(self.epochs)
        before = np.flatnonzero(epochs[:, TIME] <= epochs[-1, TIME] - seconds)
        return epochs[before[-1] + 1 :] if len(before) else epochs


def last_stamp(output: NavBlock | NavSolution) -> int:
    """Stamp [ns] of the newest sample."""
    return output.stamp_ns if isinstance(output, NavSolution) else int(output.stamps_ns[-1])


def joined_rows(parts: Sequence[np.ndarray]) -> np.ndarray:
    """The rows of ``parts``, of which there is at least one, in one array."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def solution_rows(output: NavBlock | NavSolution) -> np.ndarray:
    """Output rows (N, OUT_COLUMNS) of ``core.filter.layout``."""
    return output.rows if isinstance(output, NavBlock) else output.values[None, : at.OUT_COLUMNS]
