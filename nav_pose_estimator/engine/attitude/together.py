"""Many IMU samples, and what the attitude filter takes between them, in few compiled calls."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.attitude.field import DISTURBED, NO_FIELD, disturbance
from nav_pose_estimator.engine.samples import ImuBlock, MagSample, NavigatorVelocity
from nav_pose_estimator.engine.solutions import AttitudeBlock, Output

Fields = Sequence[tuple[int, MagSample]]
"""Magnetometer samples, each with the number of IMU samples before it."""


def feed_together(
    engine: AttitudeEngine, imu: ImuBlock, fields: Fields, velocities: Mapping[int, NavigatorVelocity]
) -> list[Output] | None:
    """Feed the samples ``imu``, ``velocities`` by the number of IMU samples before them, and ``fields``.

    Of a field and a velocity behind the same IMU sample, the velocity comes first. Numbers and events are those of
    ``AttitudeEngine.feed`` for each sample; events of velocities are only counted. None, and nothing has changed, where
    a sample may be refused or may cause an event on arrival: all must then be fed one by one.
    """
    memory = engine.memory
    if memory.last_ns is None or not engine.field.passes(fields, imu.stamps_ns, memory):
        return None
    if not engine.input.accept_whole(imu):
        return None
    imu = engine.input.mounting.block(imu)
    apart = {place: sample for place, sample in fields if place == 0 or place in velocities}
    within = {place: sample for place, sample in fields if place not in apart}
    field, outputs, done = _in_body(engine, within, len(imu)), list[Output](), 0
    for end in sorted({*apart, *velocities, len(imu)}):
        while done < end:
            # while the field is disturbed, every sample of it causes an event
            rows = engine.run(imu.part(done, end), field[done:end], -1.0 if memory.disturbed else DISTURBED)
            outputs.append(AttitudeBlock(imu.stamps_ns[done : done + len(rows)], rows))
            done += len(rows)
            if done in within:
                outputs += [engine.note(event) for event in disturbance(within[done].stamp_ns, memory)]
        if end in velocities:
            engine.feed(velocities[end])
        if end in apart:
            outputs += engine.feed(apart[end])
    if fields:
        memory.mag_ns = fields[-1][1].stamp_ns
    return outputs


def _in_body(engine: AttitudeEngine, fields: Mapping[int, MagSample], count: int) -> np.ndarray:
    """Fields (count, 3) in b that follow each IMU sample, NaN for none; (0, 3) without any."""
    if not fields:
        return NO_FIELD
    in_body = np.full((count, 3), math.nan)
    for place, sample in fields.items():
        in_body[place - 1] = engine.field.in_body(sample)
    return in_body
