"""Where map has its zero: fixed by parameter, set in flight, or the first trusted position."""

import math

import numpy as np
import pytest

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, update
from nav_pose_estimator.engine.samples import Sample, SetOrigin
from nav_pose_estimator.engine.solutions import Event, NavSolution
from nav_pose_estimator.sim.scenarios import HOME
from pieces import one_by_one
from told import flight

pytestmark = pytest.mark.compiled
PLACE = math.degrees(HOME.lat) + 0.01, math.degrees(HOME.lon) - 0.02, 450.0  # 1.9 km off
FIXED = dict(zip(("origin.latitude", "origin.longitude", "origin.height"), PLACE, strict=True))
RADIANS = math.radians(PLACE[0]), math.radians(PLACE[1]), PLACE[2]


def fly(samples: list[Sample], **values: float) -> tuple[PoseEstimator, list]:
    engine = PoseEstimator(update(Parameters(), values), attitude=False)
    return engine, [output for sample in one_by_one(samples) for output in engine.feed(sample)]


def solutions(outputs: list) -> list[NavSolution]:
    return [output for output in outputs if isinstance(output, NavSolution)]


def test_a_fixed_origin_is_the_zero_of_the_pose():
    """GIVEN an origin by parameter WHEN the vehicle flies THEN poses count from there, and nothing else changes."""
    samples = list(flight("multirotor_light", 30.0).samples())
    engine, fixed = fly(samples, **FIXED)
    _, free = fly(samples)
    assert engine.origin == RADIANS
    last = solutions(fixed)[-1]
    np.testing.assert_allclose(last.position_enu, lla_to_enu(last.lat, last.lon, last.alt, *RADIANS), atol=1e-6)
    assert [s.values[:26].tolist() for s in solutions(fixed)] == [s.values[:26].tolist() for s in solutions(free)]


@pytest.mark.parametrize("left_out", FIXED)
def test_half_an_origin_is_refused(left_out):
    """GIVEN two of the three numbers THEN one sentence says which one is missing."""
    values = {name: value for name, value in FIXED.items() if name != left_out}
    with pytest.raises(ParameterError, match=f"{left_out} is missing"):
        PoseEstimator(update(Parameters(), values))


def moved_at(seconds: float, place: tuple[float, float, float]) -> list[Sample]:
    recording = flight("multirotor_light", 30.0)
    samples = list(recording.samples())
    stamp = recording.start_ns + int(seconds * 1e9)
    at = next(i for i, s in enumerate(samples) if hasattr(s, "stamps_ns") and s.stamps_ns[-1] > stamp)
    return [*samples[:at], SetOrigin(0, *place), *samples[at:]]


def test_an_origin_set_in_flight_moves_map_and_not_odom():
    """GIVEN a flight WHEN set_origin comes THEN the pose counts from there, odom goes on without a step, the vehicle
    stays where it is on Earth, and the reset is counted once."""
    engine, outputs = fly(moved_at(20.0, RADIANS))
    assert engine.origin == RADIANS
    path = solutions(outputs)
    odom = np.array([s.position_enu - s.correction_enu for s in path])
    steps = np.linalg.norm(np.diff(odom, axis=0), axis=1)
    moves = np.linalg.norm(np.diff([s.position_enu for s in path], axis=0), axis=1)
    assert moves.max() > 1000.0, "map has moved"
    assert steps.max() < 0.5, "odom has not"
    assert path[-1].reset_count == path[0].reset_count + 1
    _, others = fly(list(flight("multirotor_light", 30.0).samples()))
    assert [s.values[:26].tolist() for s in path] == [s.values[:26].tolist() for s in solutions(others)]


def test_an_origin_that_was_set_outlives_a_restart():
    """GIVEN an origin set before the first position WHEN the navigator starts again THEN the axes stay."""
    engine, _ = fly(moved_at(0.5, RADIANS))
    engine.reset(flight("multirotor_light", 30.0).start_ns + 31 * 10**9, "a test")
    assert engine.origin == RADIANS


@pytest.mark.parametrize(
    ("place", "name"),
    [((math.nan, 0.1, 0.0), "value"), ((3.0, 0.1, 0.0), "value"), ((0.1, 0.1, 0.0), "far")],
)
def test_an_origin_that_cannot_be_one_is_refused(place, name):
    engine, outputs = fly(moved_at(20.0, place))
    assert [o.name for o in outputs if isinstance(o, Event) and "set_origin" in o.name] == [
        f"set_origin.rejected.{name}"
    ]
    assert engine.origin is not None
    assert math.dist(engine.origin[:2], (HOME.lat, HOME.lon)) < 1e-4


def test_a_fixed_origin_on_another_continent_is_told():
    engine, outputs = fly(list(flight("multirotor_light", 30.0).samples()), **{**FIXED, "origin.longitude": 151.2})
    assert [o.name for o in outputs if isinstance(o, Event)].count("origin.far") == 1
    assert engine.origin is not None
