"""The attitude filter over many samples at once: the same as sample by sample."""

import math

import numpy as np
import pytest

from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.attitude.together import feed_together
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuBlock, MagSample, NavigatorVelocity
from nav_pose_estimator.engine.solutions import AttitudeBlock, Event

STEP_NS = 5_000_000
EXCHANGE = 50  # IMU samples between two velocities


def imu(seconds: float) -> ImuBlock:
    """A vehicle that turns and sways, from ``STEP_NS`` on."""
    stamps = np.arange(1, round(seconds * 1e9) // STEP_NS + 1) * STEP_NS
    t, noise = stamps * 1e-9, np.random.default_rng(3).normal(0.0, 0.01, (2, len(stamps), 3))
    gyro = noise[0] + np.stack([0.2 * np.sin(t), 0.1 * np.cos(2.0 * t), 0.3 * np.ones_like(t)], axis=1)
    return ImuBlock(stamps, gyro, noise[1] + np.array([0.0, 0.0, 9.81]))


def fields(block: ImuBlock, disturbed: tuple[float, float]) -> list[tuple[int, MagSample]]:
    """A field every 20 IMU samples, which is far stronger between the times ``disturbed`` [s]."""
    out = []
    for place in range(20, len(block) + 1, 20):
        t = float(block.stamps_ns[place - 1]) * 1e-9
        factor, yaw = (4.0 if disturbed[0] <= t < disturbed[1] else 1.0), 0.3 * t
        field = (factor * 2e-5 * math.cos(yaw), -factor * 2e-5 * math.sin(yaw), -4e-5)
        out.append((place, MagSample(int(block.stamps_ns[place - 1]) + 1000, field)))
    return out


def velocities(block: ImuBlock) -> dict[int, NavigatorVelocity]:
    places = range(EXCHANGE, len(block) + 1, EXCHANGE)
    out = {}
    for place in places:
        stamp_ns, level = int(block.stamps_ns[place - 1]), (math.cos(0.1), 0.0, 0.0, math.sin(0.1))
        speed = (0.1 * place, 2.0, 0.0)
        out[place] = NavigatorVelocity(stamp_ns, speed, q_nb=level, heading_sd=0.05, tilt_sd=0.005)
    return out


def in_turn(engine: AttitudeEngine, block: ImuBlock, mags: dict, speeds: dict, begin: int, end: int) -> list:
    """Feed all that arrives behind the IMU samples ``begin`` to ``end``; a velocity comes before a field."""
    outputs, done = [], begin
    for place in sorted(place for place in {*mags, *speeds} if begin < place <= end):
        outputs += engine.feed(block.part(done, place))
        done = place
        if place in speeds:
            engine.feed(speeds[place])
        if place in mags:
            outputs += engine.feed(mags[place])
    return outputs


@pytest.mark.compiled
@pytest.mark.parametrize("kind", ["complementary", "two_stage"])
def test_many_samples_at_once_give_the_same_as_one_by_one(kind: str) -> None:
    """GIVEN IMU, velocities and a field that is disturbed for a while, some of them behind the same IMU sample WHEN a
    second of them is fed at once THEN attitudes, events and state are those of the samples in turn."""
    parameters = update(Parameters(), {"attitude.filter": kind})
    single, whole = AttitudeEngine(parameters), AttitudeEngine(parameters)
    block = imu(20.0)
    mags, speeds = dict(fields(block, (12.0, 15.0))), velocities(block)
    in_turn(single, block, mags, speeds, 0, 200)
    in_turn(whole, block, mags, speeds, 0, 200)
    expected, found = in_turn(single, block, mags, speeds, 200, 4000), []
    for begin in range(200, 4000, 200):
        inside = range(begin + 1, begin + 201)
        fields_now = [(place - begin, mags[place]) for place in inside if place in mags]
        speeds_now = {place - begin: speeds[place] for place in inside if place in speeds}
        outputs = feed_together(whole, block.part(begin, begin + 200), fields_now, speeds_now)
        assert outputs is not None
        found += outputs
    assert said(found) == said(expected)
    assert {event[1] for event in said(found)[1]} >= {"mag.disturbed", "mag.undisturbed", "mag.rejected.disturbed"}
    assert (whole.memory.state == single.memory.state).all()
    assert whole.status() == single.status()


@pytest.mark.compiled
def test_a_refused_field_leaves_all_as_it_was() -> None:
    """GIVEN a field that is not finite, or late, or the first one WHEN it comes with many samples THEN nothing has been
    done yet."""
    engine, block = AttitudeEngine(), imu(2.0)
    engine.feed(block.part(0, 200))
    assert feed_together(engine, block.part(200, 400), fields(block, (9.0, 9.0))[:5], {}) is None
    engine.feed(MagSample(int(block.stamps_ns[199]), (2e-5, 0.0, -4e-5)))
    before = engine.memory.state.copy()
    good, stamp = (2e-5, 0.0, -4e-5), int(block.stamps_ns[249])
    for refused in (MagSample(stamp, (math.nan, 0.0, 0.0)), MagSample(int(block.stamps_ns[199]), good)):
        assert feed_together(engine, block.part(200, 400), [(50, refused)], {}) is None
    assert feed_together(engine, block.part(100, 300), [], {}) is None  # the IMU's own time has been
    assert (engine.memory.state == before).all()
    assert feed_together(engine, block.part(200, 400), [(50, MagSample(stamp, good))], {}) is not None


def said(outputs: list) -> tuple[list, list]:
    """All rows, and the events by time and name."""
    blocks = [output for output in outputs if isinstance(output, AttitudeBlock)]
    events = [(one.stamp_ns, one.name, one.text) for one in outputs if isinstance(one, Event)]
    return np.concatenate([block.rows for block in blocks]).tolist(), events
