"""Many IMU samples, and what the attitude filter takes between them, in few compiled calls."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from nav_pose_estimator.core.attitude import navigator_aid
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.attitude.field import DISTURBED, NO_FIELD, disturbance
from nav_pose_estimator.engine.attitude.memory import judge_velocity
from nav_pose_estimator.engine.samples import ImuBlock, MagSample, NavigatorVelocity
from nav_pose_estimator.engine.solutions import AttitudeBlock, Output

Fields = Sequence[tuple[int, MagSample]]
"""Magnetometer samples, each with the number of IMU samples before it."""


def feed_together(
    engine: AttitudeEngine, imu: ImuBlock, fields: Fields, velocities: Mapping[int, NavigatorVelocity]
) -> list[Output] | None:
    """Feed the samples ``imu``, ``velocities`` by the number of IMU samples before them, and ``fields``.

    Whether a field or a velocity comes first behind an IMU sample makes no difference. Numbers and events are those of
    ``AttitudeEngine.feed`` for each sample; events of velocities are only counted. None, and nothing has changed, where
    a sample may be refused or may cause an event on arrival, and without compiled kernels: all must then be fed one by
    one.
    """
    memory = engine.memory
    if memory.last_ns is None or not engine.field.passes(fields, imu.stamps_ns, memory):
        return None
    if any(one.q_nb is None for one in velocities.values()) or not engine.input.accept_whole(imu):
        return None
    imu = engine.input.mounting.block(imu)
    outputs: list[Output] = []
    if fields and fields[0][0] == 0:
        outputs += engine.feed(fields[0][1])
    arrivals = {place: sample for place, sample in fields if place > 0}
    behind, aids = _judged(engine, velocities)
    field, done = _in_body(engine, arrivals, len(imu)), 0
    while done < len(imu):
        limit = -1.0 if memory.disturbed else DISTURBED  # while the field is disturbed, each sample causes an event
        first = int(behind.searchsorted(done))
        rows = engine.run(imu.part(done, None), field[done:], limit, behind[first:] - done, aids[first:])
        outputs.append(AttitudeBlock(imu.stamps_ns[done : done + len(rows)], rows))
        done += len(rows)
        if done in arrivals:
            outputs += [engine.note(event) for event in disturbance(arrivals[done].stamp_ns, memory)]
    if fields:
        memory.mag_ns = fields[-1][1].stamp_ns
    return outputs


def _judged(engine: AttitudeEngine, velocities: Mapping[int, NavigatorVelocity]) -> tuple[np.ndarray, np.ndarray]:
    """Indices (M,) of the IMU samples after which the navigator aids the filter, and its aids (M, SIZE)."""
    behind, aids = [], []
    for place, velocity in velocities.items():
        events, aid = judge_velocity(velocity, engine.memory)
        for event in events:
            engine.note(event)
        if aid is not None:
            behind.append(place - 1)
            aids.append(aid)
    return np.array(behind, np.int64), np.array(aids).reshape(-1, navigator_aid.SIZE)


def _in_body(engine: AttitudeEngine, fields: Mapping[int, MagSample], count: int) -> np.ndarray:
    """Fields (count, 3) in b that follow each IMU sample, NaN for none; (0, 3) without any."""
    if not fields:
        return NO_FIELD
    in_body = np.full((count, 3), math.nan)
    for place, sample in fields.items():
        in_body[place - 1] = engine.field.in_body(sample)
    return in_body
