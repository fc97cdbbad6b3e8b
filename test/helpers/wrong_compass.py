"""Simulated flights with a magnetometer that is rotated, mirrored or near iron."""

import math
from dataclasses import replace

import numpy as np

from nav_pose_estimator.engine.samples import MagSample
from nav_pose_estimator.sim.recording import Recording

NO_IRON = (0.0, 0.0, 0.0)
MIRRORED = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
"""x and y swapped: not possible by mounting, but by a mistake in a driver."""
NONE_OF_THE_EARTH = ((0.0, 0.0, 0.0),) * 3


def turned(degrees: float) -> tuple[tuple[float, ...], ...]:
    """Matrix of a sensor that is rotated counter-clockwise about Up relative to the IMU."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)


def with_compass(recording: Recording, matrix, iron=NO_IRON) -> Recording:
    """The flight with ``matrix`` (3, 3) on every field and then ``iron`` (3,) [T] added."""
    M, h = np.array(matrix), np.array(iron)
    others = [
        timed._replace(sample=MagSample(timed.sample.stamp_ns, tuple((M @ timed.sample.field + h).tolist())))
        if isinstance(timed.sample, MagSample)
        else timed
        for timed in recording.others
    ]
    return replace(recording, others=others)
