"""What goes wrong with single beams of a Doppler sensor, and random plans of it.

``start`` and ``length`` [s] count in time of arrival, as for all faults; beams are numbered from 0.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nav_pose_estimator.engine.samples import BeamVelocitySample, Sample
from nav_pose_estimator.sim.faults import Fault
from nav_pose_estimator.sim.noise import stream
from nav_pose_estimator.sim.sensors import Timed

EVERY: tuple[int, ...] = ()
"""All beams."""


@dataclass(frozen=True)
class BeamFault(Fault):
    """A failure of some beams; ``seed`` draws what is random in it."""

    sensor: type = BeamVelocitySample
    beams: tuple[int, ...] = EVERY
    seed: int = 0

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed:
        """The sample with the changed beams; nothing else of it changes."""
        sample: Any = timed.sample
        values = np.array(sample.velocities, float)
        chosen = list(self.beams or range(len(values)))
        values[chosen] = self.wrong(values[chosen], number)
        return timed._replace(sample=replace(sample, velocities=values))

    @abstractmethod
    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        """What the beams say instead of ``values`` (k,) [m/s] in the ``number``-th sample of the failure."""

    def draw(self, number: int) -> np.random.Generator:
        """Random numbers of that sample alone: a failure is the same whatever came before it."""
        return stream(self.seed, f"beam fault at {self.start:g}, {number}")


@dataclass(frozen=True)
class BeamOffset(BeamFault):
    """A constant error."""

    offset: float = 0.3  # m/s

    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        return values + self.offset


@dataclass(frozen=True)
class BeamScale(BeamFault):
    """A wrong scale, as of a wrong speed of sound or a false side lobe."""

    scale: float = 1.15

    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        return self.scale * values


@dataclass(frozen=True)
class BeamNoise(BeamFault):
    """Noise whose deviation grows by ``growth`` [m/s] with every sample."""

    growth: float = 0.001

    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        return values + self.growth * number * self.draw(number).standard_normal(len(values))


@dataclass(frozen=True)
class BeamOutliers(BeamFault):
    """Single wrong values on the part ``share`` of all: off by ``smallest`` to ``largest`` [m/s], either sign."""

    share: float = 0.08
    smallest: float = 0.1
    largest: float = 1.0

    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        random = self.draw(number)
        hit = random.random(len(values)) < self.share
        size = random.uniform(self.smallest, self.largest, len(values)) * random.choice((-1.0, 1.0), len(values))
        return values + np.where(hit, size, 0.0)


@dataclass(frozen=True)
class BeamsLost(BeamFault):
    """The beams see nothing."""

    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        return np.full(len(values), math.nan)


@dataclass(frozen=True)
class Stretch:
    """Where a plan puts its faults [s], and what they are measured by."""

    start: float
    length: float
    speed: float  # m/s: of the vehicle
    noise: float  # m/s: of a healthy beam
    rate: float  # Hz
    beams: int = 4


Plan = Callable[[Stretch, np.random.Generator], list[BeamFault]]


def _twice(one: Callable[[Stretch, float, float, int, float], BeamFault], seconds: float = 120.0) -> Plan:
    """The fault on a random beam in each half of the stretch, for ``seconds`` or two fifths of the stretch."""

    def plan(where: Stretch, random: np.random.Generator) -> list[BeamFault]:
        length = min(seconds, 0.4 * where.length)
        latest = 0.5 * where.length - length
        return [
            one(where, where.start + half * 0.5 * where.length + random.uniform(0.0, latest), length,
                int(random.integers(where.beams)), float(random.choice((-1.0, 1.0))))
            for half in (0, 1)
        ]  # fmt: skip

    return plan


def _lost(offsets: tuple[int, ...]) -> Plan:
    """Beams at ``offsets`` from a random one are gone for the middle half of the stretch."""

    def plan(where: Stretch, random: np.random.Generator) -> list[BeamFault]:
        first = int(random.integers(where.beams))
        beams = tuple(sorted((first + offset) % where.beams for offset in offsets))
        return [BeamsLost(start=where.start + 0.25 * where.length, length=0.5 * where.length, beams=beams)]

    return plan


def _bias(where: Stretch, start: float, length: float, beam: int, sign: float) -> BeamFault:
    return BeamOffset(start=start, length=length, beams=(beam,), offset=sign * 0.2 * where.speed)


def _scale(where: Stretch, start: float, length: float, beam: int, sign: float) -> BeamFault:
    return BeamScale(start=start, length=length, beams=(beam,), scale=1.0 + sign * 0.15)


def _noise(where: Stretch, start: float, length: float, beam: int, sign: float) -> BeamFault:
    growth = 30.0 * where.noise / (length * where.rate)
    return BeamNoise(start=start, length=length, beams=(beam,), seed=beam, growth=growth)


def _all_lost(where: Stretch, start: float, length: float, beam: int, sign: float) -> BeamFault:
    return BeamsLost(start=start, length=length)


def _one_lost(where: Stretch, start: float, length: float, beam: int, sign: float) -> BeamFault:
    return BeamsLost(start=start, length=length, beams=(beam,))


def _small_bias(where: Stretch, random: np.random.Generator) -> list[BeamFault]:
    beam, sign = int(random.integers(where.beams)), float(random.choice((-1.0, 1.0)))
    start, length = where.start + 0.25 * where.length, 0.5 * where.length
    return [BeamOffset(start=start, length=length, beams=(beam,), offset=sign * 0.03 * where.speed)]


def _outliers(where: Stretch, random: np.random.Generator) -> list[BeamFault]:
    seed, sizes = int(random.integers(2**31)), (0.1 * where.speed, 0.6 * where.speed)
    return [BeamOutliers(start=where.start, length=where.length, seed=seed, smallest=sizes[0], largest=sizes[1])]


def _mixed(where: Stretch, random: np.random.Generator) -> list[BeamFault]:
    """Episodes of 20 to 60 s with a fault of a random kind on a random beam, two thirds of the time."""
    faults: list[BeamFault] = []
    now = where.start
    while now < where.start + where.length - 20.0:
        length = min(float(random.uniform(20.0, 60.0)), where.start + where.length - now)
        one = (_bias, _scale, _noise, _one_lost)[int(random.integers(4))]
        faults.append(one(where, now, length, int(random.integers(where.beams)), float(random.choice((-1.0, 1.0)))))
        now += 1.5 * length
    return faults


PLANS: dict[str, Plan] = {
    "none": lambda where, random: [],
    "bias": _twice(_bias),
    "small bias": _small_bias,
    "scale": _twice(_scale),
    "noise": _twice(_noise),
    "outliers": _outliers,
    "two neighbours lost": _lost((0, 1)),
    "two opposite lost": _lost((0, 2)),
    "three lost": _lost((0, 1, 2)),
    "all lost": _twice(_all_lost, 60.0),
    "mixed": _mixed,
}
"""What happens to the beams within a stretch, by name."""


def plan(name: str, where: Stretch, seed: int) -> tuple[BeamFault, ...]:
    """The faults of the plan ``name``; the same seed gives the same."""
    return tuple(PLANS[name](where, stream(seed, f"beams: {name}")))
