"""Overload protection: how far a node is behind, and which work it leaves out; IMU samples are the last.

First rehearsals rest and results come less often. If that is not enough, neighbouring IMU samples are averaged: their
sum, which is what navigation integrates, stays the same. Only what is older than any use is dropped, and counted.
"""

from collections.abc import Callable

from nav_pose_estimator.engine.samples import ImuSample, Vector3
from nav_pose_estimator.ros.pace import Pace

HOPELESS = 3.0  # s: a node that is so far behind with the last step in force drops what waits
_BEHIND = 0.25  # s: more is no longer a burst
_SETTLING = 1.0  # s until a step has taken effect
_CALM = (10.0, 320.0)  # s without a delay until a step is taken back, at first and at most
_LONGEST_MEAN_NS = 20_000_000
_STEPS = 4  # the last one averages up to eight samples
_SPARSE_RATE = 20.0  # Hz


class Overload:
    """Which step is in force. ``on_change`` gets the old and the new one. Times are those of any clock [s]."""

    def __init__(self, on_change: Callable[[int, int], None]) -> None:
        self._on_change = on_change
        self.step = 0
        self.group = 1  # so many IMU samples are averaged into one
        self.lag = 0.0  # s, as last noted
        self._late_at = 0.0  # when it was last behind
        self._changed, self._lag_then = -_SETTLING, 0.0
        self._patience = _CALM[0]

    def note(self, lag: float, now: float) -> None:
        """A message had waited for ``lag`` seconds."""
        self.lag = lag
        if lag < _BEHIND:
            return
        self._late_at = now
        if now - self._changed < _SETTLING:
            return
        if self.step == 0:
            self._patience = min(2.0 * self._patience, _CALM[1])
            self._change(1, lag, now)
        elif lag > 0.8 * self._lag_then and self.step < _STEPS:
            self._change(self.step + 1, lag, now)
        else:
            self._changed, self._lag_then = now, lag

    @property
    def is_hopeless(self) -> bool:
        """Whether all that can be left out is, and the node is still far behind."""
        return self.step == _STEPS and self.lag > HOPELESS

    def look_back(self, now: float) -> None:
        """To be called now and then: takes a step back after a while without delay."""
        if now - self._late_at > 1.0:
            self.lag = 0.0
        if self.step and now - max(self._late_at, self._changed) > self._patience:
            self._change(self.step - 1, 0.0, now)

    def sentence(self, lost: int) -> str:
        """What a pilot reads of it; empty while the node keeps up. ``lost``: messages so far."""
        if not self.step:
            return ""
        words = [f"OVERLOADED: this computer is too slow or too busy ({self.lag:.1f} s behind)", "rehearsals rest"]
        words.append(f"results come at {_SPARSE_RATE:g} Hz")
        if self.group > 1:
            words.append(f"{self.group} IMU samples are averaged into one")
        return ", ".join([*words, f"{lost} messages lost so far"])

    def _change(self, step: int, lag: float, now: float) -> None:
        before, self.step, self._changed, self._lag_then = self.step, step, now, lag
        self.group = 2 ** max(step - 1, 0)
        self._on_change(before, step)


class ImuGroups:
    """Averages IMU samples in groups; a sample tells of the interval that ends at its stamp, and so does the mean.

    No mean spans more than 20 ms: in a turn the force changes its direction within it, and a mean does not tell.
    """

    def __init__(self) -> None:
        self._group: list[ImuSample] = []
        self._newest_ns = 0  # stamp of the last sample, 0 before the first

    def __bool__(self) -> bool:
        """Whether samples wait for others of their group."""
        return bool(self._group)

    def add(self, sample: ImuSample, size: int) -> ImuSample | None:
        """The mean of a group of ``size`` that ``sample`` completes, or of fewer that span enough; else None."""
        step_ns = sample.stamp_ns - self._newest_ns if self._newest_ns else 0
        self._newest_ns = sample.stamp_ns
        self._group.append(sample)
        longer_ns = sample.stamp_ns - self._group[0].stamp_ns + 2 * step_ns  # with one more
        if len(self._group) < size and longer_ns <= _LONGEST_MEAN_NS:
            return None
        group, self._group = self._group, []
        if len(group) == 1:
            return sample
        return ImuSample(sample.stamp_ns, _mean([s.gyro for s in group]), _mean([s.accel for s in group]))

    def forget(self) -> None:
        """Start again from no delay."""
        self._group, self._newest_ns = [], 0


def _mean(vectors: list[Vector3]) -> Vector3:
    x, y, z = (sum(axis) / len(vectors) for axis in zip(*vectors, strict=True))
    return x, y, z


class SparseResults:
    """Lets results of each kind pass at a low rate."""

    def __init__(self) -> None:
        self._paces: dict[type, Pace] = {}

    def passes(self, kind: type, stamp_ns: int) -> bool:
        """Whether one of ``kind`` is due."""
        return self._paces.setdefault(kind, Pace(_SPARSE_RATE)).is_due(stamp_ns)
