"""Detection of time that starts again: a bag that loops, a simulation that restarts, a clock that is set back.

A single earlier stamp is not sufficient evidence, because one message can be damaged, and GNSS stamps can lie in the
past. Three consecutive IMU stamps are. The samples received meanwhile are held and passed on after the reset, so that
the new run is complete and its results equal those of a first run.
"""

from dataclasses import dataclass

from nav_pose_estimator.engine.samples import ImuSample, Sample, stamp_of

_PROOF = 3  # consecutive earlier IMU stamps that establish a restart
_MAX_HELD = 64  # largest number of samples that are held
_IN_FLIGHT = 1000  # samples after a jump of the clock among which its first effect is expected


@dataclass(frozen=True, slots=True)
class Admission:
    """Samples to feed now, in order. ``back_s`` > 0: time went back by that much [s]; reset the engine first."""

    samples: tuple[Sample, ...]
    back_s: float = 0.0


_NOTHING = Admission(())


class TimeGuard:
    """Checks the stamps of the samples before they enter an engine. It reads no clock.

    Stamps are earlier if they lie more than ``max_regression_ns`` before the newest IMU stamp.
    """

    def __init__(self, max_regression_ns: int) -> None:
        self._limit = max_regression_ns
        self.newest_ns = 0
        self._ahead_ns = 0  # stamp of a leap ahead that no second stamp has confirmed yet
        self._held: list[Sample] = []
        self._imu_held = 0  # number of IMU samples among the held ones
        self._expected = 0  # number of samples for which a single earlier IMU stamp is sufficient evidence

    def expect_restart(self) -> None:
        """Note that the clock itself (/clock) jumped back: the first earlier IMU stamp is sufficient evidence."""
        self._expected = _IN_FLIGHT

    def admit(self, sample: Sample) -> Admission:
        """Decide which samples to feed after ``sample`` was received."""
        stamp = stamp_of(sample)
        is_imu = isinstance(sample, ImuSample) and sample.stamp_ns > 0
        # a sample without a stamp cannot be judged, but keeps its place in the order behind the held ones
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
        """Forget all stamps and held samples."""
        self.newest_ns = self._ahead_ns = self._imu_held = self._expected = 0
        self._held.clear()

    def _advance(self, stamp: int) -> None:
        """Advance the newest stamp. A leap ahead counts once a second stamp confirms it; a single one is damaged."""
        if stamp - self.newest_ns <= self._limit or not self.newest_ns or 0 < stamp - self._ahead_ns <= self._limit:
            self.newest_ns = max(stamp, self.newest_ns)
        else:
            self._ahead_ns = stamp

    def _hold(self, sample: Sample, is_imu: bool) -> Admission:
        if is_imu and self._imu_held + 1 >= _PROOF:
            return self._restart(sample)
        if len(self._held) >= _MAX_HELD:
            return self._release(sample)
        self._held.append(sample)
        self._imu_held += is_imu
        return _NOTHING

    def _release(self, sample: Sample) -> Admission:
        """Pass on the held samples: there was no restart, and the engine reports them as late or damaged."""
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
