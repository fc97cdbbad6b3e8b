"""Forced GNSS outages: their definition, the removal of GNSS samples, and an independent check of the removal.

An outage [start, end) is in seconds from the bag's first stamp. A GNSS sample belongs to it if its time of validity,
stamp minus latency, is inside. Thus a fix that was measured before the outage and arrives in its first tenths of a
second is used, as with a real receiver, and one that was measured inside and arrives after its end is not.
"""

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample, SatelliteCount
from nav_pose_estimator.errors import UserError

GNSS_SAMPLES = (GnssFix, GnssVelocity, SatelliteCount)


class BadOutage(UserError):
    """An impossible outage. The text is for the user."""


class GnssLeak(AssertionError):
    """GNSS from inside an outage would have reached an estimator, which is a defect of this package."""


@dataclass(frozen=True, slots=True, order=True)
class Outage:
    """An outage of ``length`` [s] from ``start`` [s since the bag's first stamp]."""

    start: float
    length: float

    @property
    def end(self) -> float:
        return self.start + self.length

    def contains(self, t: np.ndarray) -> np.ndarray:
        """Whether the times ``t`` (N,) [s since the bag's first stamp] are inside: (N,) bool."""
        return (t >= self.start) & (t < self.end)


def parse_outage(text: str) -> Outage:
    """Parse ``START:LENGTH`` in seconds."""
    start, length = _two_numbers(text, "--outage", "START:LENGTH")
    if start < 0.0:
        raise BadOutage(f"--outage {text}: the start must not be negative")
    return Outage(start, length)


def parse_outage_every(text: str) -> tuple[float, float]:
    """Parse ``PERIOD:LENGTH`` in seconds; the period must be longer than the outage."""
    period, length = _two_numbers(text, "--outage-every", "PERIOD:LENGTH")
    if period <= length:
        raise BadOutage(f"--outage-every {text}: the period must be longer than the outage")
    return period, length


def _two_numbers(text: str, option: str, form: str) -> tuple[float, float]:
    first, mark, second = text.partition(":")
    try:
        values = float(first), float(second)
    except ValueError:
        mark = ""
        values = 0.0, 0.0
    if not mark or not all(abs(value) < 1e9 for value in values):  # false for NaN and infinity
        raise BadOutage(f"{option} {text!r}: write {form} in seconds, for example 120:30")
    if values[1] <= 0.0:
        raise BadOutage(f"{option} {text}: the length must be positive")
    return values


def periodic(period: float, length: float, first: float, end: float) -> list[Outage]:
    """Outages of ``length`` every ``period`` [s] from ``first`` on that end by ``end``."""
    count = int((end - length - first) / period + 1e-9) + 1 if end - length >= first else 0
    return [Outage(first + i * period, length) for i in range(count)]


def check_separate(outages: Iterable[Outage]) -> list[Outage]:
    """The outages in order of time. Raises ``BadOutage`` where two of them overlap."""
    ordered = sorted(outages)
    for before, after in pairwise(ordered):
        if after.start < before.end:
            raise BadOutage(
                f"the outages {before.start:g}:{before.length:g} and {after.start:g}:{after.length:g} overlap"
            )
    return ordered


class _Clock:
    """Latest stamp so far, which is the time of a sample without a header."""

    def __init__(self) -> None:
        self.now_ns = 0

    def advance(self, sample: Sample) -> None:
        stamp = int(sample.stamps_ns[-1]) if isinstance(sample, ImuBlock) else sample.stamp_ns
        if stamp is not None and stamp > self.now_ns:
            self.now_ns = stamp


class GnssRemoval:
    """Removes everything that GNSS measured inside the outages from a stream of samples.

    A satellite count without a header is removed with its fix, and also if it arrives inside an outage, because a count
    that precedes its fix would otherwise pass on information from inside.
    """

    def __init__(self, outages: list[Outage], epoch_ns: int, delay: float) -> None:
        """``epoch_ns`` is the bag's first stamp, ``delay`` [s] the latency of the fixes."""
        self._starts = [epoch_ns + round(outage.start * 1e9) for outage in outages]
        self._ends = [epoch_ns + round(outage.end * 1e9) for outage in outages]
        self._delay_ns = round(delay * 1e9)
        self._last_removed = False
        self._clock = _Clock()
        self.removed: Counter[type] = Counter()

    def keep(self, sample: Sample) -> bool:
        """Whether ``sample`` may be used; ``removed`` counts the others by type."""
        self._clock.advance(sample)
        if not isinstance(sample, GNSS_SAMPLES):
            return True
        if isinstance(sample, SatelliteCount):
            stamp = self._clock.now_ns if sample.stamp_ns is None else sample.stamp_ns
            inside = self._last_removed or self._inside(stamp) or self._inside(stamp - self._delay_ns)
        else:
            inside = self._inside(sample.stamp_ns - self._delay_ns)
            if isinstance(sample, GnssFix):
                self._last_removed = inside
        if inside:
            self.removed[type(sample)] += 1
        return not inside

    def filter(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """The samples that may be used."""
        return (sample for sample in samples if self.keep(sample))

    def _inside(self, time_ns: int) -> bool:
        index = bisect_right(self._starts, time_ns) - 1
        return index >= 0 and time_ns < self._ends[index]


class OutageProof:
    """Checks every input sample of an estimator, independently of the removal.

    ``check`` raises :class:`GnssLeak` for GNSS that was valid inside an outage. ``seen`` counts the GNSS samples.
    """

    def __init__(self, outages: list[Outage], epoch_ns: int, delay: float) -> None:
        self._bounds = [(epoch_ns + round(o.start * 1e9), epoch_ns + round(o.end * 1e9)) for o in outages]
        self._delay_ns = round(delay * 1e9)
        self._clock = _Clock()
        self._last_fix_ns: int | None = None
        self.seen = 0
        self.closest_ns: int | None = None

    def check(self, sample: Sample) -> None:
        """Raise ``GnssLeak`` if ``sample`` contains data that GNSS measured inside an outage."""
        self._clock.advance(sample)
        if not isinstance(sample, GNSS_SAMPLES):
            return
        self.seen += 1
        for time_ns in self._times_of(sample):
            for start, end in self._bounds:
                distance = max(start - time_ns, time_ns - end + 1)
                if distance <= 0:
                    kind, late = type(sample).__name__, (time_ns - start) * 1e-9
                    raise GnssLeak(f"a {kind} valid {late:.3f} s after the start of an outage reached the estimator")
                self.closest_ns = distance if self.closest_ns is None else min(self.closest_ns, distance)

    def _times_of(self, sample: GnssFix | GnssVelocity | SatelliteCount) -> list[int]:
        if isinstance(sample, SatelliteCount):
            if sample.stamp_ns is not None:
                return [sample.stamp_ns]
            # without a header it is at most as old as its fix, and at most as new as the last stamp
            return [self._clock.now_ns] + ([] if self._last_fix_ns is None else [self._last_fix_ns])
        valid = sample.stamp_ns - self._delay_ns
        if isinstance(sample, GnssFix):
            self._last_fix_ns = valid
        return [valid]

    def summary(self) -> dict[str, float | int | None]:
        """Result of the check, for the files of a run."""
        closest = None if self.closest_ns is None else self.closest_ns * 1e-9
        return {"gnss_samples_fed": self.seen, "valid_inside_an_outage": 0, "closest_s": closest}
