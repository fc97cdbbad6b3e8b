"""What rehearsals have shown outlives a process; numbers that no rehearsals give are refused."""

import math

import numpy as np
import pytest

from flown import Flight
from nav_pose_estimator.core.motion.air_velocity import learn_air_velocity
from nav_pose_estimator.core.motion.regimes import Decisions
from nav_pose_estimator.core.motion.wind import WIND_TIME
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.composed.resumption import arrays_of as left_behind
from nav_pose_estimator.engine.composed.resumption import resume
from nav_pose_estimator.engine.outage.rehearsal_arrays import arrays_of, take_over
from nav_pose_estimator.engine.outage.rehearsals import Rehearsals
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.errors import UserError
from told import flight


def shown() -> Rehearsals:
    rehearsals = Rehearsals()
    for i in range(4):
        way = {"anfis": 4.0 * i} if i else {}
        rehearsals.state.squares.append({"coast": 100.0 + i, **way})
        rehearsals.state.excess.append({"coast": -3.0, **way})
        rehearsals.state.surprises.append(0.5 + i)
    rehearsals.state.hover_excess.extend([{"coast": 400.0}, {"coast": 100.0, "anfis": 50.0}])
    rehearsals.state.decisions = Decisions(50.0, 2.0)
    return rehearsals


def test_the_next_process_knows_what_the_rehearsals_have_shown() -> None:
    first, second = shown(), Rehearsals()
    take_over(second.state, arrays_of(first.state))
    assert second.scores() == first.scores()
    assert second.spread() == first.spread()
    assert second.spread(hovering=True) == first.spread(hovering=True) != {}
    assert second.is_worse("coast", "anfis", 1.5)


@pytest.mark.parametrize(("travelled", "is_told"), [(0.0, True), (1e4, False)])
def test_a_file_of_an_earlier_version_tells_who_hovered_where_all_did(travelled: float, is_told: bool) -> None:
    """GIVEN a state without the rehearsals that hovered WHEN in all of them together the vehicle hardly moved THEN all
    of them hovered; else nobody knows which did."""
    arrays = {name: value for name, value in arrays_of(shown().state).items() if not name.startswith("hover")}
    arrays["decisions"] = np.array([travelled, 0.0])
    again = Rehearsals()
    take_over(again.state, arrays)
    assert again.spread(hovering=True) == (again.spread() if is_told else {})
    assert again.spread() != {}


SPOILED = {
    "shorter": ("squares.coast", lambda values: values[:-1]),
    "infinite": ("excess.anfis", lambda values: values + math.inf),
    "negative": ("surprises", lambda values: -values),
    "unknown": ("surprises", lambda values: values * math.nan),
    "decisions": ("decisions", lambda values: values[:1]),
    "hovering": ("hovering", lambda values: values - 1),
    "text": ("squares.anfis", lambda values: values.astype(str)),
}


@pytest.mark.parametrize("how", SPOILED)
def test_what_no_rehearsals_have_shown_is_refused(how: str) -> None:
    name, spoil = SPOILED[how]
    arrays = arrays_of(shown().state)
    arrays[name] = spoil(arrays[name])
    state = Rehearsals().state
    with pytest.raises(UserError, match="do not fit together"):
        take_over(state, arrays)
    assert (len(state.squares), state.decisions) == (0, Decisions())


@pytest.mark.compiled
@pytest.mark.parametrize(("gap", "is_kept"), [(20.0, True), (120.0, False)])
def test_flight_memory_goes_on_for_a_minute_and_the_wind_becomes_vaguer(gap: float, is_kept: bool) -> None:
    """GIVEN a process that has learned and rehearsed WHEN the next one begins 20 s later THEN it has model and
    rehearsals, and of the wind it is as sure as nobody can be who has not seen it; two minutes later it has neither."""
    first = PoseEstimator(Parameters(), attitude=False)
    recording = flight("multirotor_light", 20.0)
    for sample in recording.samples():
        first.feed(sample)
    model = learn_air_velocity(Flight(seconds=120.0).epochs())
    first.outage_aid.learner.state.model = model
    take_over(first.outage_aid.rehearsals.state, arrays_of(shown().state))
    arrays = left_behind(first)
    second = PoseEstimator(Parameters(), attitude=False)
    resume(second, arrays)
    second.feed(ImuSample(int(arrays["stamp_ns"]) + int(gap * 1e9), (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)))
    again, rehearsed = second.outage_aid.learner.state.model, second.outage_aid.rehearsals
    assert (again is not None) is is_kept
    assert rehearsed.count == (4 if is_kept else 0)
    if is_kept:
        decay = math.exp(-gap / WIND_TIME)
        np.testing.assert_allclose(again.wind, decay * model.wind)
        grown = decay**2 * model.wind_cov + (1.0 - decay**2) * model.wind_spread * np.eye(2)
        np.testing.assert_allclose(again.wind_cov, grown)
        assert np.trace(again.wind_cov) > np.trace(model.wind_cov)
