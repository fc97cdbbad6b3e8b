"""Positions that move while the vehicle stands, and pulls that a launch only seems to be."""

import pytest

from nav_pose_estimator.engine.sensors.gnss.other_motion import RestDrift

PER_SECOND = 5  # fixes


def after(ways: list[float], rests: bool = True, chance: float = 2.0) -> RestDrift:
    """The test after a second at each place [m] East."""
    drift = RestDrift()
    for t, east in enumerate(ways):
        for _ in range(PER_SECOND):
            drift.fix(east, 0.0, chance)
        drift.second(float(t), rests)
    return drift


def test_positions_that_converge_may_be_off_by_what_they_have_moved() -> None:
    """GIVEN a vehicle that stands WHEN its positions move by 30 m THEN sigma is about that, and the reason says so."""
    drift = after([3.0 * k for k in range(11)])
    assert drift.least_sd == pytest.approx(30.0, abs=6.0)
    assert "stood" in drift.reason


@pytest.mark.parametrize(
    ("ways", "rests"), [([0.3 * k for k in range(11)], True), ([3.0 * k for k in range(11)], False)]
)
def test_usual_wander_and_motion_are_none(ways: list[float], rests: bool) -> None:
    """GIVEN positions that wander by 3 m, or a vehicle that moves THEN nothing is in doubt."""
    assert not after(ways, rests).is_on


def test_a_receiver_that_states_large_errors_may_make_them() -> None:
    """GIVEN a receiver that states 5 m WHEN its positions wander by 15 m at rest THEN nothing is in doubt."""
    wander = [min(1.5 * k, 15.0) for k in range(20)]
    assert not after(wander, chance=2.5 * 5.0).is_on
    assert after(wander).is_on


def test_it_is_forgotten_after_some_time() -> None:
    """GIVEN positions that have moved WHEN they stay for half a minute THEN the doubt ends."""
    drift = after([10.0 * min(k, 2) for k in range(40)])
    assert not drift.is_on
