"""Warm-up: a short synthetic flight that calls all kernels of an engine, so that no sample waits for a compiler."""

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.engine.samples import (
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    Hypothesis,
    ImuSample,
    MagSample,
    MotionEvidence,
    PressureSample,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.engine.solutions import Mode, Output, Status

_STEP_NS = 20_000_000  # from one IMU sample to the next
_EPOCH_NS = 1_000_000_000  # stamp before the first sample
_LONGEST = 6000  # largest number of IMU samples at rest; the default parameters need 150 to align
_AIDED = 75  # IMU samples of aided flight before the outage
_UNAIDED = 100  # IMU samples of the outage
_GUIDED = 3  # further IMU samples of the outage, with evidence of the motion
_MOVING = 400  # IMU samples of a flight that begins in the air


class Engine(Protocol):
    """Interface of an engine that can be warmed up."""

    @property
    def mode(self) -> Mode: ...
    def feed(self, sample: Sample) -> list[Output]: ...
    def status(self) -> Status: ...
    def set_use_gnss(self, flag: bool) -> None: ...


def warm_up(make_engine: Callable[[], Engine]) -> None:
    """Run fresh engines through a start at rest, aided flight and an outage, and through a start in the air."""
    if not COMPILED:
        return
    at_rest = make_engine()
    left = _AIDED
    for step in range(1, _LONGEST):
        _feed(at_rest, _at_rest(step))
        left -= at_rest.mode is Mode.AIDED
        if left <= 0:
            break
    at_rest.set_use_gnss(False)
    for further in range(step + 1, step + 1 + _UNAIDED):
        _feed(at_rest, _at_rest(further))
    for guided in range(further + 1, further + 1 + _GUIDED):
        _feed(at_rest, [*_at_rest(guided), _evidence(guided)])
    at_rest.status()
    moving = make_engine()
    for step in range(1, _MOVING):
        _feed(moving, _in_motion(step))
    moving.status()


def _feed(engine: Engine, samples: list[Sample]) -> None:
    for sample in samples:
        engine.feed(sample)


def _at_rest(step: int) -> list[Sample]:
    """Samples at rest, level, facing East at 45 degrees North, with all sensors; no two IMU samples are equal."""
    stamp, wiggle = _EPOCH_NS + step * _STEP_NS, 1e-4 * math.sin(step)
    samples: list[Sample] = [ImuSample(stamp, (wiggle, -wiggle, wiggle), (10.0 * wiggle, wiggle, 9.806))]
    if step % 10 == 0:
        samples += [
            SatelliteCount(stamp, 30),
            GnssVelocity(stamp, (0.0, 0.0, 0.0)),
            GnssFix(stamp, math.radians(45.0), 0.0, 0.0, cov_enu=np.eye(3)),
            MagSample(stamp, (0.0, 2e-5, -4e-5)),
            PressureSample(stamp, 101_325.0),
            BodyVelocity(stamp, (0.0, 0.0, 0.0)),
        ]
    return samples


def _evidence(step: int) -> MotionEvidence:
    """Evidence of hovering or travelling in still air, on which the filter splits into branches and merges again."""
    zero = (0.0, 0.0, 0.0)
    hypotheses = Hypothesis("travel", 0.5, 4.0, (1.0, 1.0, 1.0)), Hypothesis("hover", 0.5, 0.1, None)
    stamp = _EPOCH_NS + step * _STEP_NS
    return MotionEvidence(
        stamp, 0.5, np.eye(3), zero, zero, zero, hypotheses, dwell=60.0, wind_cov=0.1 * np.eye(2), wind_spread=0.1
    )


def _in_motion(step: int) -> list[Sample]:
    """Samples of a motion to and fro along body x, which points North: the heading has to come from GNSS velocity."""
    stamp, t = _EPOCH_NS + step * _STEP_NS, step * _STEP_NS * 1e-9
    samples: list[Sample] = [ImuSample(stamp, (1e-4 * math.sin(step), 0.0, 0.0), (4.0 * math.cos(t), 0.0, 9.806))]
    if step % 10 == 0:
        north = 4.0 * (1.0 - math.cos(t)) / 6.4e6
        samples += [
            SatelliteCount(stamp, 30),
            GnssVelocity(stamp, (0.0, 4.0 * math.sin(t), 0.0)),
            GnssFix(stamp, math.radians(45.0) + north, 0.0, 0.0),
        ]
    return samples
