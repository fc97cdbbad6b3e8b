"""Detection of a frozen sensor: it repeats its last value for longer than its own statistics explain.

A live barometer has noise and rarely repeats a value exactly. How often it does depends on its resolution, its internal
filter, and whether the driver publishes values twice. The rate of repetition is learned from completed runs of equal
values, and a run that is improbable at this rate is suspect. A coarse sensor at a constant height may repeat a value
for long. The verdict therefore takes a time in proportion to the usual step between different values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_MEMORY = 300.0  # samples over which the rate of repetition is averaged
_PRIOR_REPEATS, _PRIOR_SAMPLES = 5.0, 10.0  # prior of that rate: half of ten values repeat
_KNOWN = 50.0  # samples before the rate is used
_SUSPECT, _FROZEN = math.log(1e-4), math.log(1e-9)  # log probabilities of a run that is suspect, or frozen
_LEAST_TIME = 2.0  # s: shortest run that counts as frozen ...
_TIME_PER_STEP = 30.0  # ... and s per unit of the usual step (for a height: per metre)
_STEP_SHARE = 0.05  # weight of the newest step in the mean step


@dataclass(eq=False)
class Frozen:
    """The detector. It receives every value; ``is_suspect`` and ``is_frozen`` are its verdicts on the last one."""

    is_suspect: bool = field(default=False, init=False)
    """Whether the present run of equal values is improbable: the value may be old."""
    is_frozen: bool = field(default=False, init=False)
    """Whether the sensor is frozen beyond doubt."""
    _value: float = field(default=math.nan, init=False)
    _since: float = field(default=0.0, init=False)  # s: time of the first of the equal values
    _run: int = field(default=0, init=False)  # repetitions in the present run
    _repeats: float = field(default=_PRIOR_REPEATS, init=False)  # repetitions in completed runs, faded
    _samples: float = field(default=_PRIOR_SAMPLES, init=False)  # samples in completed runs, faded
    _step: float = field(default=math.nan, init=False)  # mean step between different values

    def note(self, t: float, value: float) -> None:
        """Add a ``value`` (height [m]) at ``t`` [s], in order of time."""
        if value == self._value:
            self._run += 1
            self._judge(t)
            return
        if math.isfinite(self._value):
            self._learn(abs(value - self._value))
        self._value, self._since, self._run = value, t, 0
        self.is_suspect = self.is_frozen = False

    def _learn(self, step: float) -> None:
        """Learn from a run that ended with a ``step``; one that was frozen is not typical of a live sensor."""
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
