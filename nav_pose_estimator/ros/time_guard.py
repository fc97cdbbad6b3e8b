"""Time that starts again: a bag that loops, a simulation that restarts, a clock set back.

A single stamp that goes back proves nothing: one message can be damaged, GNSS stamps can lie in the past. IMU stamps
that go back three times in a row do. What arrived meanwhile is held and passed on after the reset, so that the new run
loses nothing and its results equal those of a first run.
"""

from dataclasses import dataclass

from nav_pose_estimator.engine.samples import ImuSample, Sample, stamp_of

_PROOF = 3  # IMU samples in a row
_PATIENCE = 64  # samples held at most
_IN_FLIGHT = 1000  # samples that may still come from before a jump of the clock


@dataclass(frozen=True, slots=True)
class Admission:
    """What to feed now, in order; ``back_s`` > 0: time went back so far, reset the engine first."""

    samples: tuple[Sample, ...]
    back_s: float = 0.0


_NOTHING = Admission(())


class TimeGuard:
    """Watches the stamps on their way into an engine. Needs no clock."""

    def __init__(self, max_regression_ns: int) -> None:
        self._limit = max_regression_ns
        self.newest_ns = 0
        self._ahead_ns = 0  # of a leap that nothing has continued yet
        self._held: list[Sample] = []
        self._imu_held = 0
        self._expected = 0  # for how many samples a single IMU stamp that goes back is proof enough

    def expect_restart(self) -> None:
        """The clock itself jumped back (/clock): the first IMU stamp that goes back is proof enough."""
        self._expected = _IN_FLIGHT

    def admit(self, sample: Sample) -> Admission:
        """What ``sample`` leads to."""
        stamp = stamp_of(sample)
        is_imu = isinstance(sample, ImuSample) and sample.stamp_ns > 0
        # without a stamp there is nothing to judge, but the sample keeps its place behind what is held
        limit = 0 if self._expected and is_imu else self._limit
        back = self.newest_ns - stamp > limit if stamp and stamp > 0 else bool(self._held)
        self._expected = max(self._expected - 1, 0)
        if not back:
            if is_imu and stamp:
                self._advance(stamp)
            if not self._held:
                return Admission((sample,))
            return self._release(sample) if is_imu else self._hold(sample, False)
        return self._restart(sample) if is_imu and limit == 0 else self._hold(sample, is_imu)

    def forget(self) -> None:
        """Start from nothing."""
        self.newest_ns = self._ahead_ns = self._imu_held = self._expected = 0
        self._held.clear()

    def _advance(self, stamp: int) -> None:
        """A leap ahead counts when a second stamp continues it: one alone is a damaged stamp."""
        if stamp - self.newest_ns <= self._limit or not self.newest_ns or 0 < stamp - self._ahead_ns <= self._limit:
            self.newest_ns = max(stamp, self.newest_ns)
        else:
            self._ahead_ns = stamp

    def _hold(self, sample: Sample, is_imu: bool) -> Admission:
        if is_imu and self._imu_held + 1 >= _PROOF:
            return self._restart(sample)
        if len(self._held) >= _PATIENCE:
            return self._release(sample)
        self._held.append(sample)
        self._imu_held += is_imu
        return _NOTHING

    def _release(self, sample: Sample) -> Admission:
        """Time goes on: what was held is late or damaged, and the engine says so."""
        samples = (*self._held, sample)
        self._held.clear()
        self._imu_held = 0
        return Admission(samples)

    def _restart(self, sample: Sample) -> Admission:
        samples = (*self._held, sample)
        stamps = [stamp for stamp in map(stamp_of, samples) if stamp]
        back = (self.newest_ns - min(stamps)) * 1e-9
        self.forget()
        self.newest_ns = max((s.stamp_ns for s in samples if isinstance(s, ImuSample)), default=0)
        return Admission(samples, back)
