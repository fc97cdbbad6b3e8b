"""Observations of the filter, and the decisions that are made about them once.

A sample becomes an observation when it arrives. It is applied to each branch of the filter when that reaches its time,
and again whenever the past is replayed. The decision (use it or not, its reference) is made at the first application.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray


class FilterView(NamedTuple):
    """The filter, or one branch of it: nominal state, covariance (n, n), constants (``core.filter.layout``)."""

    nav: Array
    P: Array
    constants: Array


@dataclass(frozen=True, slots=True)
class Kind:
    """Properties of one sensor's observations that the time line needs.

    ``name`` is the family of its counters (``height.used``). Observations of equal time are applied in the order of
    ``precedence``, then of arrival. ``whole``: it is applied to the merged filter and not to each branch, because it is
    absolute information; the branches end with it. ``quiet``: it never changes the mode. ``holds``: it changes the mode
    only where nothing else has bounded the drift.
    """

    name: str
    precedence: int = 5
    whole: bool = False
    quiet: bool = False
    holds: bool = False


class Use(Enum):
    """How an observation is used."""

    LEFT_OUT = 0
    GATED = 1  # update behind the gate on its NIS
    UNGATED = 2  # update without a gate
    RESET = 3  # the position is set to the observation
    WIDENING = 4  # the covariance is multiplied by ``Decision.reference``, and the position moves by ``Decision.shift``
    DOUBTED = 5  # the sensor itself adds to the covariance; no state is corrected


class Row(NamedTuple):
    """One row of an observation that is used: its number, its variance, and the offset of the measurement."""

    number: int
    variance: float
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Decision:
    """Decision at the first application of an observation; a replay of the past repeats it.

    ``reference``: the sensor's reference at that time (offset of a barometer [m], of a compass [rad]), or its standard
    deviation (water surface [m]). ``velocity`` (3,) [m/s], ENU: set by a reset, NaN where unknown. ``widening``: factor
    on the covariance of the motion before the update. ``least_sd``: floors, after the update, of the standard
    deviations of the position [m], horizontal and vertical, and of the horizontal velocity [m/s]. ``rows``: the rows in
    use of a sensor that tests each row by itself. ``change`` (3,) [m/s^2]: rate of change of the velocity at the
    sensor, b. ``shift`` [m]: East and North. ``once_more``: apply the stored measurement again after the widening.
    """

    use: Use
    reference: float = math.nan
    velocity: tuple[float, ...] = ()
    widening: float = 1.0
    least_sd: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rows: tuple[Row, ...] = ()
    change: Array | None = None
    shift: tuple[float, float] = (0.0, 0.0)
    once_more: bool = False


LEFT_OUT, GATED, UNGATED = Decision(Use.LEFT_OUT), Decision(Use.GATED), Decision(Use.UNGATED)


@dataclass(slots=True)
class Observation:
    """One observation at its time of validity ``t`` [s since the engine's epoch].

    ``measured``, of a type of the sensor's choice, and ``stated_R`` (m, m), the noise that the sensor states, are never
    written to. ``arrival`` numbers observations in the order of their arrival. ``behind``: it is known ahead of the IMU
    row of its time, and yet acts behind that row. ``rows_ahead``: while it waits with IMU rows in a stretch, how many
    of these arrived before it.
    """

    t: float
    stamp_ns: int
    kind: Kind
    measured: Any
    stated_R: Array | None = None
    arrival: int = 0
    decision: Decision | None = None
    behind: bool = False
    rows_ahead: int = 0

    @property
    def key(self) -> tuple[float, int, int]:
        """Sort key of the order in which observations are applied."""
        return (self.t, self.kind.precedence, self.arrival)

    def __deepcopy__(self, _memo: dict) -> Observation:
        """A shallow copy suffices: only ``decision`` changes, and it is replaced as a whole."""
        given = self.t, self.stamp_ns, self.kind, self.measured, self.stated_R
        return Observation(*given, self.arrival, self.decision, self.behind)
