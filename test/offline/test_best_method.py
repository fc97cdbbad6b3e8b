"""What ``best`` is worth, end to end: on the shipped flight and on a real one; and what the names of methods mean."""

from functools import cache
from pathlib import Path

import pytest

from nav_pose_estimator.engine.outage.methods.registry import estimators
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import flatten
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.benchmarks.outage.trials import FlightResult, Task, run_task
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.outage_errors import OK

LENGTHS = (60.0, 100.0)


@cache
def flown(bag: Path, method: str) -> FlightResult:
    """Outages of 60 and 100 s after two and a half and three minutes of the flight."""
    return run_task(Task(bag, method, (), LENGTHS, every=35.0, first=130.0, gnss_delay="0"))


@pytest.mark.compiled
def test_best_beats_coasting_clearly_where_coasting_fails(repository: Path) -> None:
    """GIVEN the shipped multirotor flight with its good IMU WHEN GNSS is lost for 100 s, twice THEN ``best`` errs less
    than two thirds as much as coasting (about a third, when this was written)."""
    bag = repository / "bags" / "multirotor_outage"
    coast, best = (flown(bag, method).errors[method, 100.0] for method in ("coast", "best"))
    assert [e.status for e in best] == [OK] * len(best) == [OK] * len(coast)
    assert len(best) >= 2
    assert sum(e.end_error_m for e in best) < 0.67 * sum(e.end_error_m for e in coast)


@pytest.mark.compiled
@pytest.mark.parametrize("length", LENGTHS)
def test_best_says_how_far_off_it_may_be(repository: Path, length: float) -> None:
    """GIVEN the same outages WHEN ``best`` flies them THEN no error exceeds three sigma on the way or at the end, and
    sigma is a third of what coasting has to say."""
    bag = repository / "bags" / "multirotor_outage"
    coast, best = (flown(bag, method).errors[method, length] for method in ("coast", "best"))
    for learned, alone in zip(best, coast, strict=True):
        assert (learned.growth < 3.0 * learned.sigma).all()
        assert 1.0 < learned.end_sigma_m < 0.33 * alone.end_sigma_m


@pytest.mark.compiled
def test_best_is_no_regret_where_coasting_is_good(repository: Path) -> None:
    """GIVEN outages in which coasting with this IMU stays within ten metres (60 s) WHEN ``best`` flies them THEN it
    errs at most twice as much: a draw, not a win."""
    bag = repository / "bags" / "multirotor_outage"
    coast, best = (flown(bag, method).errors[method, 60.0] for method in ("coast", "best"))
    assert sum(e.end_error_m for e in best) < 2.0 * sum(e.end_error_m for e in coast)


@pytest.mark.compiled
def test_best_on_a_real_quadrotor(shared_data: Path) -> None:
    """GIVEN a recorded quadrotor flight WHEN GNSS is lost for 30 s THEN ``best`` ends nearer to the withheld GNSS than
    coasting, within three sigma, and the proof has looked at the GNSS that went in around the outage."""
    bag = shared_data / "flights" / "quad106_bag"
    if not bag.is_dir():
        pytest.skip("the flight quad106 is not here")
    results = {name: run_task(Task(bag, name, (), (30.0,), every=1e4, first=REAL_START)) for name in ("coast", "best")}
    ((coast,), (best,)) = (results[name].errors[name, 30.0] for name in ("coast", "best"))
    assert coast.status == best.status == OK
    assert best.end_error_m < coast.end_error_m
    assert best.end_error_m < 3.0 * best.end_sigma_m < 300.0
    assert results["best"].proof > 0


REAL_START = 160.0  # s of the flight


# --- names -----------------------------------------------------------------------------------------------------------


def test_every_method_that_is_there_is_one_that_the_estimator_knows() -> None:
    """Extrapolations, and values of ``learner.method`` that the schema accepts."""
    assert set(methods.available()) >= {"coast", "hold", "const_velocity", "velocity_prior", "drag", "anfis", "best"}
    for name in estimators():
        changed = flatten(methods.apply(Parameters(), name))
        assert changed["learner.enabled"]
        assert changed[methods.METHOD_PARAMETER] == name
        same = flatten(Parameters())
        assert {key for key in changed if changed[key] != same[key]} <= {methods.METHOD_PARAMETER}


def test_a_replay_uses_what_the_package_recommends() -> None:
    assert methods.apply(Parameters(), methods.BEST) == Parameters()


@pytest.mark.parametrize("name", ["magic", "hold"])
def test_a_method_that_is_no_estimator_cannot_be_applied(name: str) -> None:
    with pytest.raises(UserError, match=name):
        methods.apply(Parameters(), name)


def test_names_are_checked_and_come_back_once() -> None:
    assert methods.check(["best", "hold", "best", "coast"]) == ["best", "hold", "coast"]
    with pytest.raises(UserError, match="choose from"):
        methods.check(["coast", "magic"])
    with pytest.raises(UserError, match="only available in benchmark outage"):
        methods.check(["hold"], allow_extrapolations=False)


def test_extrapolations_go_on_from_coasting_which_is_flown_for_them() -> None:
    assert methods.passes(["best", "hold", "const_velocity"]) == [("best", ()), ("coast", ("hold", "const_velocity"))]
    assert methods.passes(["hold", "coast", "best"]) == [("coast", ("hold",)), ("best", ())]
    assert methods.passes(["best"]) == [("best", ())]
