"""Does a sensor repeat its last value for longer than it ever would?

A live barometer has noise, so it rarely repeats a value to the digit. How often it does depends on its resolution, on
the filter in it and on how often a driver sends the same value again. That share is learned from the runs that have
ended, and a run that it makes improbable is suspected. A coarse sensor at a constant height may repeat a value for
long, so a verdict takes time in proportion to the steps in which its values change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_MEMORY = 300.0  # samples
_PRIOR_REPEATS, _PRIOR_SAMPLES = 5.0, 10.0  # half of the values repeat, as long as nothing is known
_KNOWN = 50.0  # samples by which the share is known
_SUSPECT, _FROZEN = math.log(1e-4), math.log(1e-9)  # probability of a run
_LEAST_TIME = 2.0  # s of one value before it counts as frozen ...
_TIME_PER_STEP = 30.0  # ... and s for each unit (of a height: metre) of the usual step
_STEP_SHARE = 0.05  # of the newest step in the usual one


@dataclass(eq=False)
class Frozen:
    """Tell it every value; ``is_suspect`` and ``is_frozen`` speak of the last one."""

    is_suspect: bool = field(default=False, init=False)
    """The value has been repeated more often than by chance: it may be old."""
    is_frozen: bool = field(default=False, init=False)
    """It is repeated beyond doubt."""
    _value: float = field(default=math.nan, init=False)
    _since: float = field(default=0.0, init=False)  # s
    _run: int = field(default=0, init=False)
    _repeats: float = field(default=_PRIOR_REPEATS, init=False)
    _samples: float = field(default=_PRIOR_SAMPLES, init=False)
    _step: float = field(default=math.nan, init=False)  # of the values where they change, a mean

    def note(self, t: float, value: float) -> None:
        """A ``value`` (height [m]) of the time ``t`` [s], increasing."""
        if value == self._value:
            self._run += 1
            self._judge(t)
            return
        if math.isfinite(self._value):
            self._learn(abs(value - self._value))
        self._value, self._since, self._run = value, t, 0
        self.is_suspect = self.is_frozen = False

    def _learn(self, step: float) -> None:
        """A run has ended with a ``step``. One that was judged to be frozen says nothing of a sound sensor."""
        self._step = step if math.isnan(self._step) else self._step + _STEP_SHARE * (step - self._step)
        if self.is_frozen:
            return
        self._repeats, self._samples = self._repeats + self._run, self._samples + self._run + 1.0
        if self._samples > _MEMORY:
            self._repeats, self._samples = self._repeats * _MEMORY / self._samples, _MEMORY

    def _judge(self, t: float) -> None:
        if self._samples < _KNOWN:
            return
        likelihood = self._run * math.log(self._repeats / self._samples)
        self.is_suspect = likelihood < _SUSPECT
        enough = max(_LEAST_TIME, _TIME_PER_STEP * self._step)
        self.is_frozen = self.is_frozen or (likelihood < _FROZEN and t - self._since > enough)
