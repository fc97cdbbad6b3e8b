"""Faults of single beams of a Doppler sensor, and random plans of such faults.

``start`` and ``length`` [s] refer to the time of arrival, as for all faults; beams are numbered from 0.
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
    """A fault of some beams; ``seed`` determines its random numbers."""

    sensor: type = BeamVelocitySample
    beams: tuple[int, ...] = EVERY
    seed: int = 0

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed:
        """The sample with changed velocities of the affected beams."""
        sample: Any = timed.sample
        values = np.array(sample.velocities, float)
        chosen = list(self.beams or range(len(values)))
        values[chosen] = self.wrong(values[chosen], number)
        return timed._replace(sample=replace(sample, velocities=values))

    @abstractmethod
    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        """Velocities (k,) [m/s] of the affected beams instead of ``values``, in sample ``number`` of the fault."""

    def draw(self, number: int) -> np.random.Generator:
        """Random generator of that sample alone, so that the fault does not depend on what precedes it."""
        return stream(self.seed, f"beam fault at {self.start:g}, {number}")


@dataclass(frozen=True)
class BeamOffset(BeamFault):
    """A constant error."""

    offset: float = 0.3  # m/s

    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        return values + self.offset


@dataclass(frozen=True)
class BeamScale(BeamFault):
    """A scale error, as caused by a wrong speed of sound or by a side lobe."""

    scale: float = 1.15

    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        return self.scale * values


@dataclass(frozen=True)
class BeamNoise(BeamFault):
    """Noise whose standard deviation grows by ``growth`` [m/s] with every sample."""

    growth: float = 0.001

    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        return values + self.growth * number * self.draw(number).standard_normal(len(values))


@dataclass(frozen=True)
class BeamOutliers(BeamFault):
    """Outliers in the fraction ``share`` of all values, with errors of +-``smallest`` to +-``largest`` [m/s]."""

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
    """The beams have no return: their values are NaN."""

    def wrong(self, values: np.ndarray, number: int) -> np.ndarray:
        return np.full(len(values), math.nan)


@dataclass(frozen=True)
class Stretch:
    """Interval [s] in which a plan puts its faults, and the quantities that scale them."""

    start: float
    length: float
    speed: float  # m/s: of the vehicle
    noise: float  # m/s: of a healthy beam
    rate: float  # Hz
    beams: int = 4


Plan = Callable[[Stretch, np.random.Generator], list[BeamFault]]


def _twice(one: Callable[[Stretch, float, float, int, float], BeamFault], seconds: float = 120.0) -> Plan:
    """Plan of a fault of a random beam in each half of the interval, for ``seconds`` or 40 % of it if that is less."""

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
    """Plan of the loss of the beams at ``offsets`` from a random one, for the middle half of the interval."""

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
    """Faults of 20 to 60 s, of random kind and beam, during two thirds of the interval."""
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
"""Plans by name."""


def plan(name: str, where: Stretch, seed: int) -> tuple[BeamFault, ...]:
    """The faults of the plan ``name``, reproducible by ``seed``."""
    return tuple(PLANS[name](where, stream(seed, f"beams: {name}")))
