"""Overload control: reduces the work of a node that cannot keep up, in steps.

The first step pauses rehearsals and publishes results at a lower rate. The next steps average neighbouring IMU samples,
which preserves their sum and so what navigation integrates. Messages are dropped, and counted, only when they are too
old to be of use.
"""

from collections.abc import Callable

from nav_pose_estimator.engine.samples import ImuSample, Vector3
from nav_pose_estimator.ros.pace import Pace

HOPELESS = 3.0  # s: delay at which a node drops the waiting messages, once the last step is in force
_BEHIND = 0.25  # s: delay that counts as overload; shorter ones are bursts
_SETTLING = 1.0  # s: time for a step to take effect before the next one
_CALM = (10.0, 320.0)  # s without overload after which a step is taken back, at first and at most
_LONGEST_MEAN_NS = 20_000_000  # longest interval that one mean may span
_STEPS = 4  # number of steps; the last one averages up to eight samples
_SPARSE_RATE = 20.0  # Hz: rate of each kind of result under overload


class Overload:
    """Selects the step in force. ``on_change`` receives the old and the new step. Times [s] are of any steady clock."""

    def __init__(self, on_change: Callable[[int, int], None]) -> None:
        self._on_change = on_change
        self.step = 0
        self.group = 1  # number of IMU samples that are averaged into one
        self.lag = 0.0  # s: last delay
        self._late_at = 0.0  # s: time of the last overload
        self._changed, self._lag_then = -_SETTLING, 0.0  # s: time of the last review under overload, and its delay
        self._patience = _CALM[0]  # s without overload before the next step back; doubles with every new overload

    def note(self, lag: float, now: float) -> None:
        """Take account of a message that waited for ``lag`` [s], at the time ``now`` [s]."""
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
        """Whether the node is far behind although the last step is in force."""
        return self.step == _STEPS and self.lag > HOPELESS

    def look_back(self, now: float) -> None:
        """Take a step back after a long enough time without overload; must be called periodically."""
        if now - self._late_at > 1.0:
            self.lag = 0.0
        if self.step and now - max(self._late_at, self._changed) > self._patience:
            self._change(self.step - 1, 0.0, now)

    def sentence(self, lost: int) -> str:
        """Sentence for the user; empty without overload. ``lost``: number of messages lost so far."""
        if not self.step:
            return ""
        words = [
            f"OVERLOADED: this computer is too slow or too busy ({self.lag:.1f} s behind)",
            "rehearsals are paused",
        ]
        words.append(f"results come at {_SPARSE_RATE:g} Hz")
        if self.group > 1:
            words.append(f"{self.group} IMU samples are averaged into one")
        return ", ".join([*words, f"{lost} messages lost so far"])

    def _change(self, step: int, lag: float, now: float) -> None:
        before, self.step, self._changed, self._lag_then = self.step, step, now, lag
        self.group = 2 ** max(step - 1, 0)
        self._on_change(before, step)


class ImuGroups:
    """Averages IMU samples in groups. A sample describes the interval that ends at its stamp, and so does the mean.

    No mean spans more than ``_LONGEST_MEAN_NS``, because in a turn the direction of the force changes within the
    interval, which a mean cannot represent.
    """

    def __init__(self) -> None:
        self._group: list[ImuSample] = []
        self._newest_ns = 0  # stamp of the last sample, 0 before the first

    def __bool__(self) -> bool:
        """Whether there is an incomplete group."""
        return bool(self._group)

    def add(self, sample: ImuSample, size: int) -> ImuSample | None:
        """Mean of the group that ``sample`` completes; None while it is incomplete.

        A group is complete with ``size`` samples, or with fewer where one more would exceed the longest interval.
        """
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
        """Drop an incomplete group."""
        self._group, self._newest_ns = [], 0


def _mean(vectors: list[Vector3]) -> Vector3:
    x, y, z = (sum(axis) / len(vectors) for axis in zip(*vectors, strict=True))
    return x, y, z


class SparseResults:
    """Limits the rate of each kind of result to ``_SPARSE_RATE``."""

    def __init__(self) -> None:
        self._paces: dict[type, Pace] = {}

    def passes(self, kind: type, stamp_ns: int) -> bool:
        """Whether a result of ``kind`` is due at ``stamp_ns``."""
        return self._paces.setdefault(kind, Pace(_SPARSE_RATE)).is_due(stamp_ns)
