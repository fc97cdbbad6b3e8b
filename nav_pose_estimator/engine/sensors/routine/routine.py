"""Observations that are as expected act in compiled code; their sensors are told afterwards."""

from __future__ import annotations

import math
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


class Coming(NamedTuple):
    """An observation that arrived ``behind`` so many IMU rows of a stretch."""

    behind: int
    observation: Observation


class Leg(NamedTuple):
    """How far a stretch of routine flight got."""

    rows: int
    """IMU rows that are done."""
    results: list[list[float]]
    """Of the observations that have acted (``core.routine.table``)."""
    within: bool
    """Whether observations of the time at which the filter stands have acted and others have not."""


class Routine:
    """The way into the filter for observations that it expects.

    ``kinds`` by the names of observations; ``fusion`` is the way for all others and knows the gates.
    """

    def __init__(self, kinds: dict[str, RoutineKind], aiding: Aiding, fusion: Fusion) -> None:
        self._kinds, self._aiding, self._fusion = kinds, aiding, fusion

    def takes(self, o: Observation) -> bool:
        """Whether there may be a way for ``o``: of its kind there is, and what is new is expected only beside GNSS."""
        return o.kind.name in self._kinds and (o.decision is not None or self._aiding.gnss_is_good(o.t))

    def act(self, vector: np.ndarray, observations: Sequence[Observation], t: float) -> list[list[float]]:
        """Let ``observations`` act that are due, on a filter that stands at ``t`` [s], its covariance up to date.

        ``vector`` is the filter (``core.filter.memory``). Returns the results of those that did, of which their sensors
        have heard; the one that follows them is unusual.
        """
        settings = self._settings()
        events = self._events([Coming(0, o) for o in observations], settings, t)
        results = np.empty((len(events), table.RESULT_COLUMNS))
        done = flight.act_now(vector, events, 0, len(events), 0, np.array(settings), results)
        return self._told(observations, results[:done])

    def fly_again(
        self, vector: np.ndarray, rows: tuple[np.ndarray, int, int], observations: Sequence[Observation]
    ) -> tuple[int, int]:
        """Fly the past once more, with ``observations`` that are known, most of which have been decided about.

        ``rows`` as in ``fly``. Returns how many rows and how many observations are done.
        """
        settings = self._settings()
        events = self._events([Coming(0, o) for o in observations], settings, float(vector[memory.NAV + TIME]))
        results = np.empty((len(events), table.RESULT_COLUMNS))
        out = np.empty((rows[2] - rows[1], OUT_COLUMNS))
        done, acted, _ = flight.fly(vector, *rows, False, events, np.array(settings), out, results)
        self._told(observations, results[:acted])
        return done, acted

    def fly(
        self, vector: np.ndarray, rows: tuple[np.ndarray, int, int, bool], coming: Sequence[Coming], out: np.ndarray
    ) -> Leg:
        """``core.routine.flight.fly``: ``rows`` are all IMU rows, ``begin``, ``end`` and ``is_followed``."""
        settings = self._settings()
        events = self._events(coming, settings, float(vector[memory.NAV + TIME]))
        results = np.empty((len(events), table.RESULT_COLUMNS))
        done, acted, where = flight.fly(vector, *rows, events, np.array(settings), out, results)
        return Leg(done, results[:acted].tolist(), where == flight.AT_TIME)

    def is_calm(self, t: float) -> bool:
        """Whether every sensor leaves its observations to the routine at ``t`` [s]."""
        settings = self._settings()
        return all(kind.prepare(settings, t) for kind in self._kinds.values())

    def tell(self, observation: Observation, result: list[float], period: float | None = None) -> None:
        """Let the sensor of an ``observation`` that has acted know its ``result``.

        At that time fixes came every ``period`` [s], None: as often as now.
        """
        if observation.decision is None:
            self._kinds[observation.kind.name].done(observation, result, period)

    def _told(self, observations: Sequence[Observation], results: np.ndarray) -> list[list[float]]:
        told: list[list[float]] = results.tolist()
        for observation, result in zip(observations, told, strict=False):
            self.tell(observation, result)
        return told

    def _settings(self) -> list[float]:
        settings, aiding, gates = [0.0] * table.SETTINGS_SIZE, self._aiding, self._fusion.gates
        settings[: table.RETURN_AFTER] = aiding.fix_used, aiding.height_used, aiding.lost_after
        for rows in range(3):
            settings[table.SOFT + rows], settings[table.HARD + rows] = gates[rows]
        return settings

    def _events(self, coming: Sequence[Coming], settings: list[float], t: float) -> np.ndarray:
        ready: dict[str, bool] = {}
        events = []
        for behind, o in coming:
            name = o.kind.name
            kind = self._kinds.get(name)
            if kind is not None and name not in ready:
                ready[name] = kind.prepare(settings, t)
            number = table.UNUSUAL
            if kind is not None and o.decision is not None:
                number = kind.again(o)
            elif kind is not None and ready[name]:
                number = kind.number
            values = _NOTHING if kind is None or number == table.UNUSUAL else kind.values(o)
            events.append([o.t, number, behind, *values])
        return np.array(events).reshape(len(events), table.EVENT_COLUMNS)


def warm_up(constants: np.ndarray) -> None:
    """Compile the kernels: fly over no row, past no observation."""
    vector, rows = memory.make(constants, 2, math.inf), np.zeros((1, IMU_COLUMNS))
    events, results = np.empty((0, table.EVENT_COLUMNS)), np.empty((0, table.RESULT_COLUMNS))
    settings, out = np.zeros(table.SETTINGS_SIZE), np.empty((0, OUT_COLUMNS))
    flight.fly(vector, rows, 1, 1, False, events, settings, out, results)
    flight.act_now(vector, events, 0, 0, 0, settings, results)


def moved(shift: np.ndarray, first: list[float], last: list[float]) -> np.ndarray:
    """``shift`` (3,) [m] and what observations from the ``first`` result to the ``last`` have moved the filter by."""
    before, after = first[table.RESULT_BEFORE : table.RESULT_AFTER], last[table.RESULT_AFTER :]
    return shift if before == after else shift + step_enu(np.array(before), np.array(after))
