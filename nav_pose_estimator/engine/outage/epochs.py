"""From navigation solutions to half-second epochs, and the memory of those flown with good GNSS."""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import replace

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.motion.epochs import ACTIVITY_EPOCHS, COLUMNS, PERIOD, epoch
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution

_PERIOD_NS = round(PERIOD * 1e9)
_LEAST_SHARE = 0.6  # of the usual number of IMU samples: an epoch with fewer has a gap
_GOOD_HEADING = 0.2  # rad: with a worse one nothing can be learned of directions


class EpochCollector:
    """Collects the rows of navigation solutions; ``recent`` are the last epochs, whatever the mode."""

    def __init__(self) -> None:
        self.recent: deque[np.ndarray] = deque(maxlen=ACTIVITY_EPOCHS)
        self._rows: list[np.ndarray] = []
        self._period = 0
        self._usual = 0.0
        self._aided = True

    def copy(self) -> EpochCollector:
        """An independent copy."""
        twin = copy.copy(self)
        twin.recent, twin._rows = self.recent.copy(), list(self._rows)
        return twin

    def feed(self, output: NavBlock | NavSolution) -> tuple[np.ndarray, bool] | None:
        """Take a solution whose last sample may end an epoch; returns (epoch, worth learning from) when it does."""
        stamp, rows = last_stamp(output), solution_rows(output)
        if isinstance(output, NavBlock) and len(rows) > 1 and self._begins_with(output):
            # as sample by sample: the first one is where collecting begins, the last one may end an epoch already
            self.feed(replace(output, stamps_ns=output.stamps_ns[:1], rows=rows[:1]))
            return self.feed(replace(output, stamps_ns=output.stamps_ns[1:], rows=rows[1:]))
        self._rows.append(rows)
        self._aided &= output.mode is Mode.AIDED
        period = stamp // _PERIOD_NS
        if period == self._period:
            return None
        consecutive, self._period = period == self._period + 1, period
        rows = np.concatenate(self._rows)
        finished = epoch(stamp * 1e-9, rows)
        aided, count = self._aided, len(rows)
        self._rows.clear()
        self._aided = True
        if not consecutive:
            self._usual = 0.0
            return None
        good = aided and count >= _LEAST_SHARE * self._usual and rows[-1, at.OUT_VAR + 2] < _GOOD_HEADING**2
        self._usual = count if self._usual == 0.0 else self._usual + 0.05 * (count - self._usual)
        self.recent.append(finished)
        return finished, bool(good)

    def _begins_with(self, block: NavBlock) -> bool:
        """Whether the first sample of ``block`` does not continue what has been collected: a start, or a gap."""
        return not 0 <= int(block.stamps_ns[0]) // _PERIOD_NS - self._period <= 1


class FlightMemory:
    """The epochs (N, COLUMNS) of the last ten minutes of aided flight."""

    def __init__(self, seconds: float = 600.0) -> None:
        self._epochs: deque[np.ndarray] = deque(maxlen=round(seconds / PERIOD))

    def __len__(self) -> int:
        return len(self._epochs)

    @property
    def seconds(self) -> float:
        """How much flight is remembered."""
        return len(self._epochs) * PERIOD

    def add(self, one: np.ndarray) -> None:
        """Remember an epoch."""
        self._epochs.append(one)

    def last(self, seconds: float) -> np.ndarray:
        """The epochs of the last ``seconds`` before the newest one, (N, COLUMNS)."""
        if not self._epochs:
            return np.empty((0, COLUMNS))
        newest = self._epochs[-1][0]
        count = next((i for i, e in enumerate(reversed(self._epochs)) if e[0] <= newest - seconds), len(self._epochs))
        return np.array(list(self._epochs)[len(self._epochs) - count :]).reshape(-1, COLUMNS)

    def copy(self) -> FlightMemory:
        """An independent copy."""
        twin = copy.copy(self)
        twin._epochs = self._epochs.copy()
        return twin


def last_stamp(output: NavBlock | NavSolution) -> int:
    """Stamp [ns] of the newest sample."""
    return output.stamp_ns if isinstance(output, NavSolution) else int(output.stamps_ns[-1])


def solution_rows(output: NavBlock | NavSolution) -> np.ndarray:
    """Output rows (N, OUT_COLUMNS) of ``core.filter.layout``."""
    return output.rows if isinstance(output, NavBlock) else output.values[None, : at.OUT_COLUMNS]
