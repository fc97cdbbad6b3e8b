"""The filter of a time line: a single one, or in an outage a bank of branches and their mixture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.filter.layout import OUT_COLUMNS, SOLUTION_SIZE, TIME
from nav_pose_estimator.engine.navigator.branches import Branches
from nav_pose_estimator.engine.observation import FilterView, Kind, Observation

MOTION = Kind("motion")
"""Observations that split the filter into branches and weight them; ``measured`` is a MotionEvidence."""

Apply = Callable[[Observation, FilterView], None]
"""Applies an observation to a filter that is at its time."""


class SplitFilter:
    """Nominal state ``nav`` and covariance ``P`` with checkpoints; the mixture of ``branches`` where there are any.

    ``vector`` is the argument of the kernels (``core.filter.memory``); ``nav``, ``P`` and ``constants`` are its views.
    """

    def __init__(self, constants: np.ndarray, slots: int, checkpoint_period: float) -> None:
        self._slots, self._period = slots, checkpoint_period
        self.branches: Branches | None = None
        self._united_by = 0  # arrival number of the observation that last ended branches
        self._hold(memory.make(constants, slots, checkpoint_period))

    def _hold(self, vector: np.ndarray) -> None:
        n = int(vector[memory.STATES])
        self.vector = vector
        self.nav = vector[memory.NAV : memory.CONSTANTS]
        self.constants = vector[memory.CONSTANTS : memory.ORIGIN]
        self.P = vector[memory.HEAD : memory.HEAD + n * n].reshape(n, n)
        self.view = FilterView(self.nav, self.P, self.constants)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy; its views refer to its own vector."""
        self.__dict__ = state
        self._hold(self.vector)

    def start(
        self, constants: np.ndarray, nav: np.ndarray, P: np.ndarray, origin: tuple[float, float, float] | None
    ) -> None:
        """Start without branches at ``nav``, ``P``; ``origin`` as in ``Timeline.start``."""
        place = self.vector[memory.ORIGIN : memory.STATES] if origin is None else origin
        fresh = memory.make(constants, self._slots, self._period)
        fresh[memory.ORIGIN : memory.STATES] = place
        fresh[memory.NAV : memory.CONSTANTS] = nav
        fresh[memory.HEAD : memory.HEAD + P.size] = P.ravel()
        self._hold(fresh)
        self.branches = None
        memory.add_checkpoint(fresh)

    def set_constants(self, constants: np.ndarray) -> None:
        """Replace the constants by others for the same states; branches keep theirs."""
        self.constants[:] = constants

    @property
    def time(self) -> float:
        """Time of the filter [s]."""
        return float(self.nav[TIME])

    def carry(self, rows: np.ndarray, begin: int, end: int, due: float, out: np.ndarray) -> int:
        """``memory.run_block`` over IMU rows, for each branch where there are any."""
        if self.branches is None:
            return memory.run_block(self.vector, rows, begin, end, due, out)
        stop = self.branches.run(rows, begin, end, due, out)
        self._follow(self.branches)
        return stop

    def complete(self, row: np.ndarray) -> np.ndarray:
        """The present solution (SOLUTION_SIZE,), of which ``row`` is the output row."""
        solution = np.empty(SOLUTION_SIZE)
        solution[:OUT_COLUMNS] = row
        memory.complete_solution(self.vector, solution)
        return solution

    # --- observations ------------------------------------------------------------------------------------------------

    def act(self, observation: Observation, apply: Apply) -> bool:
        """Apply an observation at its time; True where it split the filter or merged its branches."""
        before = self.branches
        if observation.kind is MOTION:
            if observation.arrival <= self._united_by:  # it is based on a solution that GNSS has corrected since
                return False
            if self.branches is None:
                self.branches = Branches(self.vector, self._slots, observation.measured)
            self.branches.decide(observation.measured)
            self._follow(self.branches)
        elif self.branches is None:
            apply(observation, self.view)
        elif observation.kind.whole:
            was = self.nav.copy()
            apply(observation, self.view)
            if not np.array_equal(was, self.nav):  # an absolute position: the mixture ``nav``, ``P`` continues alone
                self.branches, self._united_by = None, observation.arrival
                self.vector[memory.OLDEST] = 0.0
                self.vector[memory.NEWEST] = -1.0
                memory.add_checkpoint(self.vector)
        else:
            for view in self.branches.views:
                apply(observation, view)
            self._follow(self.branches)
        return self.branches is not before

    def _follow(self, branches: Branches) -> None:
        """Bring ``nav`` and ``P`` up to date after a change of the ``branches``."""
        branches.mix_into(self.vector)

    # --- checkpoints -------------------------------------------------------------------------------------------------

    @property
    def _vectors(self) -> list[np.ndarray]:
        return [self.vector] if self.branches is None else self.branches.vectors

    def restore_before(self, t: float) -> float:
        """Restore the last checkpoint before ``t`` [s]; returns the time of the filter then [s]."""
        if self.branches is not None:
            return self.branches.restore_before(t)
        memory.restore_before(self.vector, t)
        return self.time

    def renew_checkpoints(self) -> None:
        """Renew checkpoints of the present time, because the filter has been corrected since."""
        for vector in self._vectors:
            memory.renew_checkpoint(vector)

    def forget_before(self, t: float) -> float:
        """Drop checkpoints up to ``t`` [s] except the last of them; returns the time of the oldest one left [s]."""
        return min(memory.drop_before(vector, t) for vector in self._vectors)
