"""Compiled processing of observations that are as expected; their sensors take the results afterwards."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.filter.layout import IMU_COLUMNS, OUT_COLUMNS, TIME
from nav_pose_estimator.core.routine import flight, table
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.fusion import Fusion
from nav_pose_estimator.engine.sensors.routine.kinds import RoutineKind

_NOTHING = [0.0] * (table.EVENT_COLUMNS - table.EVENT_ROWS)


class Leg(NamedTuple):
    """How far a stretch of routine flight got."""

    rows: int
    """Number of IMU rows that have been processed."""
    results: list[list[float]]
    """Results of the observations that have acted (``core.routine.table``)."""
    within: bool
    """Whether some observations of the filter's present time have acted and others have not."""
    unfinished: list[float] | None
    """Then the first result of these, which does not count in ``shift``; else None."""
    moves: list[tuple[int, np.ndarray]]
    """Changes of the sum (3,) [m], ENU, of all corrections of the position: rows before it, and the sum until then."""
    shift: np.ndarray
    """That sum in the end."""


class Routine:
    """Lets observations act on the filter in compiled code, as long as they are within the gates.

    ``kinds``: adapters by the names of observations. ``fusion`` processes all other observations and holds the gates.
    """

    def __init__(self, kinds: dict[str, RoutineKind], aiding: Aiding, fusion: Fusion) -> None:
        self._kinds, self._aiding, self._fusion = kinds, aiding, fusion

    def takes(self, o: Observation) -> bool:
        """Whether ``o`` may act here: its kind has an adapter, and GNSS is good unless ``o`` has a decision already."""
        return o.kind.name in self._kinds and (o.decision is not None or self._aiding.gnss_is_good(o.t))

    def act(self, vector: np.ndarray, observations: Sequence[Observation], t: float) -> list[list[float]]:
        """Let due ``observations`` act on a filter that stands at ``t`` [s], its covariance up to date.

        ``vector``: the filter (``core.filter.memory``). Returns the results of those that acted, which their sensors
        have taken; the observation that follows them is not as expected.
        """
        settings = self._settings()
        events = self._events(observations, [0] * len(observations), settings, t)
        results = np.empty((len(events), table.RESULT_COLUMNS))
        done = flight.act_now(vector, events, 0, len(events), 0, np.array(settings), results)
        return self._report_all(observations, results[:done])

    def fly_again(
        self, vector: np.ndarray, rows: tuple[np.ndarray, int, int], observations: Sequence[Observation]
    ) -> tuple[int, int]:
        """Replay the past with known ``observations``, most of which have a decision.

        ``rows`` as in ``fly``. Returns the numbers of rows and of observations that have been processed.
        """
        settings = self._settings()
        events = self._events(observations, [0] * len(observations), settings, float(vector[memory.NAV + TIME]))
        results = np.empty((len(events), table.RESULT_COLUMNS))
        out = np.empty((rows[2] - rows[1], OUT_COLUMNS))
        done, acted, _ = flight.fly(vector, *rows, False, events, np.array(settings), out, results)
        self._report_all(observations, results[:acted])
        return done, acted

    def fly(
        self,
        whole: tuple[np.ndarray, np.ndarray],
        rows: tuple[np.ndarray, int, int, bool],
        coming: tuple[Sequence[Observation], Sequence[int]],
        out: np.ndarray,
    ) -> Leg:
        """Call ``core.routine.flight.fly``; ``rows``: all IMU rows, ``begin``, ``end`` and ``is_followed``.

        ``whole``: the vector of the filter, and the sum (3,) [m], ENU, of all corrections of its position; ``coming``:
        observations, and for each the number of rows from ``begin`` on behind which it arrived.
        """
        vector, shift = whole
        settings = self._settings()
        events = self._events(*coming, settings, float(vector[memory.NAV + TIME]))
        results = np.empty((len(events), table.RESULT_COLUMNS))
        done, acted, where = flight.fly(vector, *rows, events, np.array(settings), out, results)
        sums = np.empty((acted + 1, 4))
        sums[0, 1:] = shift
        count, first = flight.sum_corrections(events, results, acted, *rows[:2], where == flight.AT_TIME, sums)
        reported = results[:acted].tolist()
        moves = [(int(ahead), sums[k, 1:]) for k, ahead in enumerate(sums[:count, 0].tolist())]
        unfinished = None if first < 0 else reported[first]
        return Leg(done, reported, where == flight.AT_TIME, unfinished, moves, sums[count, 1:] if count else shift)

    def is_calm(self, t: float) -> bool:
        """Whether all sensors leave their observations to the routine at ``t`` [s]."""
        settings = self._settings()
        return all(kind.prepare(settings, t) for kind in self._kinds.values())

    def report(self, observation: Observation, result: list[float], period: float | None = None) -> None:
        """Hand the ``result`` of an ``observation`` that has acted to its sensor.

        ``period`` [s]: time between fixes when it acted; None: the present one.
        """
        if observation.decision is None:
            self._kinds[observation.kind.name].done(observation, result, period)

    def _report_all(self, observations: Sequence[Observation], results: np.ndarray) -> list[list[float]]:
        reported: list[list[float]] = results.tolist()
        for observation, result in zip(observations, reported, strict=False):
            self.report(observation, result)
        return reported

    def _settings(self) -> list[float]:
        settings, aiding, gates = [0.0] * table.SETTINGS_SIZE, self._aiding, self._fusion.gates
        settings[: table.RETURN_AFTER] = aiding.fix_used, aiding.height_used, aiding.lost_after
        for rows in range(3):
            settings[table.SOFT + rows], settings[table.HARD + rows] = gates[rows]
        return settings

    def _events(
        self, observations: Sequence[Observation], behind: Sequence[int], settings: list[float], t: float
    ) -> np.ndarray:
        numbers: dict[str, int] = {}  # of observations that act for the first time
        events: list[float] = []
        for o, rows in zip(observations, behind, strict=True):
            name = o.kind.name
            kind = self._kinds.get(name)
            if name not in numbers:
                is_ready = kind is not None and kind.prepare(settings, t)
                numbers[name] = kind.number if kind is not None and is_ready else table.UNUSUAL
            number = numbers[name] if kind is None or o.decision is None else kind.again(o)
            events += (o.t, number, rows)
            events += _NOTHING if kind is None or number == table.UNUSUAL else kind.values(o)
        # numpy takes five times as long to make an array of a list
        packed = bytearray(struct.pack(f"{len(events)}d", *events))
        return np.frombuffer(packed).reshape(len(observations), table.EVENT_COLUMNS)


def warm_up(constants: np.ndarray) -> None:
    """Compile the kernels by calling them without rows and observations."""
    vector, rows = memory.make(constants, 2, math.inf), np.zeros((1, IMU_COLUMNS))
    events, results = np.empty((0, table.EVENT_COLUMNS)), np.empty((0, table.RESULT_COLUMNS))
    settings, out = np.zeros(table.SETTINGS_SIZE), np.empty((0, OUT_COLUMNS))
    flight.fly(vector, rows, 1, 1, False, events, settings, out, results)
    flight.act_now(vector, events, 0, 0, 0, settings, results)
    flight.sum_corrections(events, results, 0, rows, 1, False, np.zeros((1, 4)))


def moved(shift: np.ndarray, first: list[float], last: list[float]) -> np.ndarray:
    """``shift`` (3,) [m], ENU, plus the correction of the position from the ``first`` result to the ``last``."""
    before, after = first[table.RESULT_BEFORE : table.RESULT_AFTER], last[table.RESULT_AFTER :]
    return shift if before == after else shift + step_enu(before, after)
