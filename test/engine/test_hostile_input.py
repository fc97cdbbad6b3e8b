"""Whatever arrives, in whatever order: no engine raises, and every output is finite."""

import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.samples import (
    AttitudeSample,
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    MagSample,
    NavigatorVelocity,
    PressureSample,
    Sample,
    SatelliteCount,
    SetOrigin,
    SetPose,
    VelocityError,
)
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.sim.scenarios import generate

ENGINES = [SinsEngine, AttitudeEngine, PoseEstimator]

# --- what drivers have been seen to send, and worse ------------------------------------------------------------------
wild = st.sampled_from(
    [math.nan, math.inf, -math.inf, 0.0, -0.0, -1.0, 5e-324, 1e-9, 1e30, -1e30, 1.8e308 / 10, 1.7976931348623157e308]
)


def number(usual: float) -> st.SearchStrategy[float]:
    """Mostly of the usual size, sometimes anything."""
    return st.one_of(st.floats(-usual, usual), st.floats(-usual, usual), st.floats(-usual, usual), wild)


def vector(usual: float, size: int = 3) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*[number(usual)] * size)


def matrix(size: int, usual: float) -> st.SearchStrategy[np.ndarray]:
    full = st.lists(number(usual), min_size=size * size, max_size=size * size).map(
        lambda values: np.array(values).reshape(size, size)
    )
    diagonal = st.lists(number(usual), min_size=size, max_size=size).map(np.diag)
    return st.one_of(diagonal, full)


def cov(size: int) -> st.SearchStrategy[np.ndarray | None]:
    return st.one_of(st.none(), matrix(size, 10.0))


# seconds after the last stamp: on time, twice the same, back, ahead, absurd
steps = st.one_of(
    st.floats(0.0, 0.05), st.floats(0.0, 0.3), st.sampled_from([0.0, -0.02, -0.5, -10.0, 0.9, 1.2, 5.0, 1e4, -1e4])
)
stamps = st.one_of(steps, steps, steps, st.sampled_from([None, 0, -5, 2**62, 1]))

SAMPLES = {
    ImuSample: st.builds(ImuSample, st.just(0), vector(5.0), vector(20.0)),
    GnssFix: st.builds(GnssFix, st.just(0), number(1.6), number(3.2), number(500.0), st.integers(-2, 2), cov(3)),
    GnssVelocity: st.builds(GnssVelocity, st.just(0), vector(20.0), cov(3)),
    SatelliteCount: st.builds(SatelliteCount, st.just(0), st.one_of(st.none(), st.integers(0, 2**32 - 1))),
    MagSample: st.builds(MagSample, st.just(0), vector(6e-5)),
    PressureSample: st.builds(PressureSample, st.just(0), number(1e5), st.one_of(st.none(), number(10.0))),
    BodyVelocity: st.builds(BodyVelocity, st.just(0), vector(10.0), cov(3)),
    SetPose: st.builds(SetPose, st.just(0), vector(100.0), vector(1.0, 4), cov(6)),
    SetOrigin: st.builds(SetOrigin, st.just(0), number(1.6), number(3.2), number(500.0)),
    AttitudeSample: st.builds(AttitudeSample, st.just(0), vector(1.0, 4), cov(3)),
    NavigatorVelocity: st.builds(
        NavigatorVelocity,
        st.just(0),
        vector(10.0),
        st.booleans(),
        st.one_of(st.none(), vector(1.0, 4)),
        st.booleans(),
        number(0.1),
        number(0.01),
    ),
    VelocityError: st.builds(VelocityError, st.just(0), vector(5.0), matrix(3, 5.0)),
}
messages = st.lists(st.tuples(st.one_of(*SAMPLES.values()), stamps), max_size=60)


def stamped(sample: Sample, stamp_ns: int) -> Sample:
    values = {item.name: getattr(sample, item.name) for item in fields(sample)}
    return type(sample)(**values | {"stamp_ns": stamp_ns})


def timed(drawn: list, start_ns: int) -> list[Sample]:
    """The drawn samples on a time line that begins at ``start_ns``."""
    now, out = start_ns, []
    for sample, step in drawn:
        if isinstance(step, float):
            now += round(step * 1e9)
            out.append(stamped(sample, now))
        else:
            allowed = step is not None or isinstance(sample, SatelliteCount)
            out.append(stamped(sample, step if allowed else now))
    return out


# --- engines in every state ------------------------------------------------------------------------------------------
FLIGHT = generate("multirotor_outage", duration=40.0, seed=3, imu_rate=100.0)


@dataclass(frozen=True)
class Beginning:
    """An engine that has flown for a while; kept out of failure reports, which would print all of it."""

    make: type
    snapshot: Any = field(repr=False)
    now_ns: int

    def engine(self) -> Any:
        engine = self.make()
        engine.restore(self.snapshot)
        return engine


@pytest.fixture(scope="module", params=[0.0, 1.5, 30.0], ids=["new", "levelling", "flying"])
def age(request: pytest.FixtureRequest) -> float:
    return request.param


@pytest.fixture(scope="module", params=ENGINES, ids=lambda make: make.__name__)
def beginning(request: pytest.FixtureRequest, age: float) -> Beginning:
    engine, now = request.param(), FLIGHT.start_ns
    for sample in FLIGHT.samples():
        now = int(sample.stamps_ns[-1]) if isinstance(sample, ImuBlock) else now
        if now > FLIGHT.start_ns + age * 1e9:
            break
        engine.feed(sample)
    return Beginning(request.param, engine.snapshot(), now)


def check_numbers(outputs: list) -> None:
    """Every number of every solution is finite."""
    for output in outputs:
        if isinstance(output, Event):
            continue
        for item in fields(output):
            value = getattr(output, item.name)
            if isinstance(value, (float, np.ndarray)):
                assert np.isfinite(value).all(), (type(output).__name__, item.name, value)


@given(messages)
@settings(max_examples=40)
def test_no_sequence_of_messages_breaks_an_engine(beginning: Beginning, drawn: list) -> None:
    """GIVEN an engine in any state WHEN any messages arrive THEN it neither raises nor gives NaN."""
    engine = beginning.engine()
    for sample in timed(drawn, beginning.now_ns):
        check_numbers(engine.feed(sample))
        engine.status()
