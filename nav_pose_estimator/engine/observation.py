"""An observation on its way into the filter, and what was decided about it when it first acted.

A sample becomes an observation when it arrives. It acts on every branch of the filter when that has
reached its time, and again whenever the past is replayed. Decisions (use it or not, and its reference) are made once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
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
    """What the time line must know about the observations of one sensor.

    ``name`` is the family of its counters (``height.used``). Observations of equal time act in the order of
    ``precedence``, then of arrival. ``whole``: it acts on the filter as a whole and not on each branch, because it
    carries information that no hypothesis has; the branches end with it. ``quiet``: it never changes the mode.
    ``holds``: it changes the mode only where nothing has bounded the drift.
    """

    name: str
    precedence: int = 5
    whole: bool = False
    quiet: bool = False
    holds: bool = False


class Use(Enum):
    """What is done with an observation."""

    LEFT_OUT = 0
    GATED = 1  # behind the gate on its normalised innovation
    UNGATED = 2
    RESET = 3  # the position is put on the observation, whatever the filter thought
    WIDENING = 4  # the covariance grows by ``Decision.reference``, and the position moves by ``Decision.shift``
    DOUBTED = 5  # the sensor itself adds to the covariance; nothing is corrected


class Row(NamedTuple):
    """One row of an observation that is used: its number, its variance, and what is subtracted from the measurement."""

    number: int
    variance: float
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided when an observation first acted; a replay of the past repeats it.

    ``reference`` is what the sensor's zero stood at (offset of a barometer [m], of a compass [rad]), or how well it is
    known (surface of the water [m]). ``velocity`` (3,) [m/s], ENU, is what a reset also puts right, NaN where unknown.
    ``widening`` multiplies the covariance of the motion first; the deviations of the position [m], horizontal and
    vertical, and of the horizontal velocity [m/s] are afterwards at least ``least_sd``. ``rows``: those that are used,
    of a sensor that judges each row on its own. ``change`` (3,): of the velocity at the sensor, b [m/s^2]. ``shift``
    [m]: East and North. ``once_more``: what the sensor has kept corrects the filter behind the widening.
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

    ``measured`` and ``stated_R`` (m, m), the noise that the sensor states, are the sensor's own business and never
    written to. ``arrival`` counts observations in the order in which they came.
    """

    t: float
    stamp_ns: int
    kind: Kind
    measured: Any
    stated_R: Array | None = None
    arrival: int = 0
    decision: Decision | None = None

    @property
    def key(self) -> tuple[float, int, int]:
        """The order in which observations act."""
        return (self.t, self.kind.precedence, self.arrival)

    def __deepcopy__(self, _memo: dict) -> Observation:
        """All but the decision never changes, and that is replaced as a whole."""
        return replace(self)
