"""The filters of a rehearsal: one that coasts, and one for each way through the outage, on the same time line.

All of them get the same IMU rows and the same observations, each of which is received, checked and decided about once:
by the sensors of the coasting navigator, whose doubts about the IMU also are those of all ways. A way differs from it
only by the advice of its guide. A noise model that learns follows the innovations of the last way. Checkpoints and
steps of the covariance are rarer than in flight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.filter.layout import COV_PERIOD, IMU_T, OUT_COLUMNS
from nav_pose_estimator.core.numerics.deep_copy import own_dictionary
from nav_pose_estimator.engine.navigator.branches import Branches
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.navigator.split_filter import Apply, SplitFilter
from nav_pose_estimator.engine.observation import FilterView, Kind, Observation
from nav_pose_estimator.engine.outage.epochs import joined_rows
from nav_pose_estimator.engine.outage.methods.coast import Coast
from nav_pose_estimator.engine.sensors.rest import Rest

_COVARIANCE_PERIOD = 0.1  # s at least: what rehearsals decide does not change (docs/speed.md)
_CHECKPOINT_PERIOD = 0.5  # s: seldom, since hardly an observation is late, and the filters then fit into the cache
COAST = Coast.name
ONE_WAY = Kind("one_way")
"""Observations of one way alone, by its guide."""


class OfOneWay(Observation):
    """An observation of one way alone; ``measured`` is the name of the way and that observation."""

    __slots__ = ()

    def __deepcopy__(self, memo: dict) -> OfOneWay:
        """A copy with an observation of its own, about which each copy decides for itself."""
        name, own = self.measured
        return OfOneWay(self.t, self.stamp_ns, self.kind, (name, own.__deepcopy__(memo)), arrival=self.arrival)


class Way(SplitFilter):
    """The filter of one way. ``nav`` and ``P`` are needed seldom: they follow its branches only at ``mix``."""

    def __init__(self, coasting: SplitFilter) -> None:
        """Begin as a copy of the filter ``coasting``."""
        super().__init__(coasting.constants, coasting._slots, coasting._period)
        self._hold(coasting.vector.copy())
        self.rows: list[np.ndarray] = []  # output rows since the last ``take_rows``

    def act(self, observation: Observation, apply: Apply) -> bool:
        """As ``SplitFilter.act``; what ends the branches acts on their mixture."""
        if observation.kind.whole:
            self.mix()
        return super().act(observation, apply)

    def mix(self) -> None:
        """Bring ``nav`` and ``P`` up to date."""
        if self.branches is not None:
            self.branches.mix_into(self.vector)

    def _follow(self, branches: Branches) -> None:
        """Nothing, until ``mix``."""

    def take_rows(self) -> np.ndarray:
        """Output rows (N, OUT_COLUMNS) since the last call."""
        rows, self.rows = self.rows, []
        return joined_rows(rows)


class FilterBank(SplitFilter):
    """The coasting filter and, in ``ways``, those of the ways; a way joins with the first advice of its guide."""

    def __init__(self, coasting: SplitFilter) -> None:
        """Continue the filter ``coasting``, which has no branches and is not to be used any more."""
        reach = (coasting._slots - 2) * coasting._period  # s, of its checkpoints into the past
        super().__init__(coasting.constants, math.ceil(reach / _CHECKPOINT_PERIOD) + 2, _CHECKPOINT_PERIOD)
        self._hold(coasting.vector)
        self.vector[memory.PERIOD] = _CHECKPOINT_PERIOD
        self.constants[COV_PERIOD] = max(self.constants[COV_PERIOD], _COVARIANCE_PERIOD)
        self.ways: dict[str, Way] = {}
        self.was_restarted = False
        """Whether the filter had to start again, without the ways."""
        self._newest = self.time  # s: rows up to here have been processed, and may be replayed

    def start(
        self, constants: np.ndarray, nav: np.ndarray, P: np.ndarray, origin: tuple[float, float, float] | None
    ) -> None:
        """Start again without ways."""
        super().start(constants, nav, P, origin)
        self.ways, self.was_restarted = {}, True

    def set_constants(self, constants: np.ndarray) -> None:
        """``SplitFilter.set_constants`` for each filter."""
        for one in (self, *self.ways.values()):
            SplitFilter.set_constants(one, constants)
            one.constants[COV_PERIOD] = max(constants[COV_PERIOD], _COVARIANCE_PERIOD)

    def carry(self, rows: np.ndarray, begin: int, end: int, due: float, out: np.ndarray) -> int:
        """``SplitFilter.carry`` for each filter; the ways keep the output rows that are not those of a replay."""
        stop = super().carry(rows, begin, end, due, out)
        is_new = stop > begin and rows[begin, IMU_T] > self._newest
        for way in self.ways.values():
            own = np.empty((end - begin, OUT_COLUMNS))
            way.carry(rows, begin, end, due, own)
            if is_new:
                way.rows.append(own[: stop - begin])
        if is_new:
            self._newest = float(rows[stop - 1, IMU_T])
        return stop

    def act(self, observation: Observation, apply: Apply) -> bool:
        """Apply an observation to the filters that it is meant for; the coasting one decides how it is used."""
        if observation.kind is ONE_WAY:
            name, own = observation.measured
            own.arrival = observation.arrival
            return self._act_on(name, own, apply)
        resting = observation.measured if observation.kind is Rest.kind else None
        changed = False
        if resting is None or COAST in resting:
            changed = super().act(observation, apply)
        for name, way in self.ways.items():
            if resting is None or name in resting:
                changed |= way.act(observation, apply)
        return changed

    def _act_on(self, name: str, observation: Observation, apply: Apply) -> bool:
        is_new = name not in self.ways
        if is_new:
            self.ways[name] = Way(self)
        changed = self.ways[name].act(observation, apply) or is_new
        if changed:
            for vector in self._vectors:  # no replay begins before this, and all filters have checkpoints in common
                memory.add_checkpoint(vector)
        return changed

    def views(self) -> Iterator[tuple[str, FilterView]]:
        """Name, nominal state and covariance of each filter."""
        yield COAST, self.view
        for name, way in self.ways.items():
            way.mix()
            yield name, way.view

    @property
    def _vectors(self) -> list[np.ndarray]:
        return [self.vector, *(vector for way in self.ways.values() for vector in way._vectors)]

    def restore_before(self, t: float) -> float:
        """Restore the last checkpoint of all filters before ``t`` [s]; returns their time then [s]."""
        for way in self.ways.values():
            way.restore_before(t)
        return super().restore_before(t)


class RestOfEach(Rest):
    """The sensor ``rest`` of a bank: the velocity of each filter may contradict rest."""

    def __init__(self, rest: Rest, bank: FilterBank) -> None:
        """Take over noise and counters of ``rest``."""
        own_dictionary(self).update(own_dictionary(rest))
        self._bank = bank

    def observe(self, mean_rate: np.ndarray, f: FilterView, stamp_ns: int) -> Observation | None:
        """As ``Rest.observe``, for each filter; ``measured`` are the names of those that are at rest."""
        seen = {name: Rest.observe(self, mean_rate, view, stamp_ns) for name, view in self._bank.views()}
        resting = {name: one for name, one in seen.items() if one is not None}
        return replace(next(iter(resting.values())), measured=frozenset(resting)) if resting else None


def without_gnss(sins: SinsEngine) -> SinsEngine:
    """A copy of the navigator ``sins`` that continues without GNSS, with a bank of filters."""
    twin = sins.snapshot()
    run = twin.run
    run.past.forget()  # no fix will make it go back
    run.start_up = run.start_up.afresh(run.parameters)  # nor will it align again; both would only be handed on
    bank = FilterBank(run.timeline.filter)
    run.timeline.filter, run.timeline.routine = bank, None
    run.rest = RestOfEach(run.rest, bank)
    return twin
