"""Detection of a frozen sensor: it repeats its last value for longer than its own statistics explain.

A live barometer has noise and rarely repeats a value exactly. How often it does depends on its resolution, its internal
filter, and whether the driver publishes values twice. The rate of repetition is learned from completed runs of equal
values, and a run that is improbable at this rate is suspect. A coarse sensor at a constant height may repeat a value
for long. The verdict therefore takes a time in proportion to the usual step between different values.
"""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.numerics.jit import kernel

_MEMORY = 300.0  # samples over which the rate of repetition is averaged
_PRIOR_REPEATS, _PRIOR_SAMPLES = 5.0, 10.0  # prior of that rate: half of ten values repeat
_KNOWN = 50.0  # samples before the rate is used
_SUSPECT, _FROZEN = math.log(1e-4), math.log(1e-9)  # log probabilities of a run that is suspect, or frozen
_LEAST_TIME = 2.0  # s: shortest run that counts as frozen ...
_TIME_PER_STEP = 30.0  # ... and s per unit of the usual step (for a height: per metre)
_STEP_SHARE = 0.05  # weight of the newest step in the mean step

LIVE, SUSPECT, FROZEN = 0, 1, 2
"""Verdicts on a value: usual; it may be old, because its run is improbable; frozen beyond doubt."""

# --- the state of a ``Frozen``: index of each quantity ---------------------------------------------------------------
_VALUE, _SINCE, _RUN = 0, 1, 2  # last value, s: time of the first of the equal values, repetitions so far
_REPEATS, _SAMPLES = 3, 4  # repetitions and samples in completed runs, faded
_STEP = 5  # mean step between different values
_VERDICT = 6


class Frozen:
    """The detector. It receives every value; ``verdict`` is that on the last one."""

    def __init__(self) -> None:
        self.state = np.array([math.nan, 0.0, 0.0, _PRIOR_REPEATS, _PRIOR_SAMPLES, math.nan, LIVE])
        """State of ``take_value``."""
        self.verdict: int = LIVE

    def note(self, t: float, value: float) -> None:
        """Add a ``value`` (height [m]) at ``t`` [s], in order of time."""
        self.verdict = take_value(self.state, t, value)


@kernel
def take_value(state, t, value):
    """Add a ``value`` at ``t`` [s]; returns the verdict on it."""
    if value == state[_VALUE]:
        state[_RUN] += 1.0
        _judge(state, t)
        return int(state[_VERDICT])
    if math.isfinite(state[_VALUE]):
        _learn(state, abs(value - state[_VALUE]))
    state[_VALUE], state[_SINCE], state[_RUN], state[_VERDICT] = value, t, 0.0, LIVE
    return LIVE


@kernel
def _learn(state, step):
    """Learn from a run that ended with a ``step``; one that was frozen is not typical of a live sensor."""
    state[_STEP] = step if math.isnan(state[_STEP]) else state[_STEP] + _STEP_SHARE * (step - state[_STEP])
    if state[_VERDICT] == FROZEN:
        return
    state[_REPEATS] += state[_RUN]
    state[_SAMPLES] += state[_RUN] + 1.0
    if state[_SAMPLES] > _MEMORY:
        state[_REPEATS], state[_SAMPLES] = state[_REPEATS] * _MEMORY / state[_SAMPLES], _MEMORY


@kernel
def _judge(state, t):
    if state[_SAMPLES] < _KNOWN or state[_VERDICT] == FROZEN:
        return
    likelihood = state[_RUN] * math.log(state[_REPEATS] / state[_SAMPLES])
    enough = max(_LEAST_TIME, _TIME_PER_STEP * state[_STEP])
    if likelihood < _FROZEN and t - state[_SINCE] > enough:
        state[_VERDICT] = FROZEN
    else:
        state[_VERDICT] = SUSPECT if likelihood < _SUSPECT else LIVE
