"""Random sequences of failures for endurance runs, of every sensor and every kind, reproducible by their seed."""

from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuSample,
    MagSample,
    PressureSample,
    SatelliteCount,
)
from nav_pose_estimator.sim.faults import Delay, Fault, Freeze, NotANumber, Redate, Shift, Stop, Thin
from nav_pose_estimator.sim.noise import stream

_SPIKES: dict[type, tuple[float, ...]] = {
    ImuSample: (20.0, -15.0, 10.0, 60.0, -80.0, 50.0),  # rad/s, m/s^2
    GnssFix: (400.0, -300.0, 100.0),  # m
    GnssVelocity: (30.0, -20.0, 10.0),  # m/s
    SatelliteCount: (-12.0,),
    MagSample: (2e-4, -1e-4, 3e-4),  # T
    PressureSample: (5e3,),  # Pa
}
SENSORS = tuple(_SPIKES)
KINDS = ("stop", "freeze", "nan", "spike", "delay", "rate", "time jump")
_IMU_LONGEST = 4.0  # s: longest failure of the IMU


@dataclass(frozen=True)
class Planned:
    """One failure: the names of its sensor and kind, and the fault that implements it."""

    sensor: str
    kind: str
    fault: Fault


def random_plan(seed: int, duration: float, every: float = 60.0, first: float = 90.0) -> list[Planned]:
    """Plan a failure about every ``every`` seconds, from ``first`` to ``duration`` - ``every`` [s].

    Pairs of sensor and kind are in random order; all of them occur before any is repeated. Failures last 0.5 to 20 s,
    those of the IMU at most 4 s; a spike lasts 0.1 s for the IMU, otherwise 0.2 s.
    """
    rng = stream(seed, "faults")
    pairs: list[tuple[type, str]] = []
    plan = []
    for start in np.arange(first, duration - every, every).tolist():
        if not pairs:
            pairs = [(sensor, kind) for sensor in SENSORS for kind in KINDS]
            rng.shuffle(pairs)  # type: ignore[arg-type]
        sensor, kind = pairs.pop()
        longest = _IMU_LONGEST if sensor is ImuSample else 20.0
        fault = _fault(sensor, kind, start + rng.uniform(0.0, 0.1 * every), rng.uniform(0.5, longest), rng)
        plan.append(Planned(sensor.__name__, kind, fault))
    return plan


def _fault(sensor: type, kind: str, start: float, length: float, rng: np.random.Generator) -> Fault:
    if kind == "spike":
        return Shift(sensor, start, 0.1 if sensor is ImuSample else 0.2, _SPIKES[sensor])
    if kind == "delay":
        return Delay(sensor, start, length, rng.uniform(0.05, 2.0))
    if kind == "rate":
        return Thin(sensor, start, length, int(rng.integers(2, 6)))
    if kind == "time jump":
        return Redate(sensor, start, length, float(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 3600.0)))
    plain: dict[str, type[Stop | Freeze | NotANumber]] = {"stop": Stop, "freeze": Freeze, "nan": NotANumber}
    return plain[kind](sensor, start, length)
