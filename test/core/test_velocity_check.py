"""Axes of GNSS velocities: proved by the displacement between fixes, never by a receiver that still converges."""

import math

import numpy as np
import pytest

from nav_pose_estimator.core.gnss.velocity_check import VelocityCheck
from nav_pose_estimator.core.gnss.velocity_mistakes import NED, TURNED
from nav_pose_estimator.core.gnss.velocity_steps import StepMaker, own_velocity, take_fix, take_velocity

EARTH, LAT = 6.371e6, 0.8
PERIOD = 0.2  # s


def follow(
    check: VelocityCheck, positions: np.ndarray, velocities: np.ndarray, start: float = 0.0, sd: float = 0.0
) -> float:
    """Fixes at ``positions`` (n, 2) m East, North with ``velocities`` (n, 2) m/s; returns the time after."""
    for k, ((east, north), (v_east, v_north)) in enumerate(zip(positions, velocities, strict=True)):
        t = start + k * PERIOD
        check.velocity(t, v_east, v_north, 0.1)
        check.fix(t, LAT + north / EARTH, east / (EARTH * math.cos(LAT)), 10.0, sd)
    return start + len(positions) * PERIOD


def travel(seconds: float, velocity: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 2) m and velocities (n, 2) m/s of a straight path."""
    t = np.arange(0.0, seconds, PERIOD)
    return np.outer(t, velocity), np.tile(velocity, (len(t), 1))


def test_honest_velocities_are_never_suspected() -> None:
    """GIVEN a path at 5 m/s WHEN the velocities are its own THEN nothing is proved against them."""
    check = VelocityCheck()
    follow(check, *travel(30.0, (3.0, 4.0)))
    assert not check.fault
    assert not check.suspect


@pytest.mark.parametrize(("velocities", "fault"), [((4.0, -1.0), NED), ((-4.0, -1.0), TURNED)])
def test_wrong_axes_are_proved(velocities: tuple[float, float], fault: str) -> None:
    """GIVEN a path at 4 m/s WHEN North and East are exchanged, or the axes turned, THEN it is proved, and which."""
    check = VelocityCheck()
    positions, _ = travel(30.0, (-1.0, 4.0))
    follow(check, positions, np.tile(velocities, (len(positions), 1)))
    assert check.fault == fault


@pytest.mark.parametrize(("sd", "suspected"), [(0.5, True), (4.0, False)])
def test_a_receiver_that_converges_proves_nothing(sd: float, suspected: bool) -> None:
    """GIVEN a receiver that drifts by 7 m against its own velocity WHEN it states how far it may be off
    THEN its axes are suspected only where the drift is many times that."""
    check = VelocityCheck()
    positions, _ = travel(4.0, (2.0, -0.8))
    follow(check, positions, np.tile((-1.4, 0.5), (len(positions), 1)), sd=sd)
    assert check.suspect is suspected


def test_positions_that_are_dragged_do_not_accuse_velocities_that_were_sound() -> None:
    """GIVEN velocities that have led where positions went WHEN positions leave them in flight THEN no axes are blamed:
    a driver does not turn them in flight."""
    check = VelocityCheck()
    positions, velocities = travel(60.0, (3.0, 4.0))
    positions[200:] += np.outer(np.arange(len(positions) - 200) * PERIOD, (-4.0, 1.0))
    follow(check, positions, velocities)
    assert not check.fault


def test_a_velocity_of_nearly_nothing_is_in_no_wrong_axes() -> None:
    """GIVEN a vehicle at rest whose live velocities say so WHEN the positions of a receiver that has just been switched
    on converge by 30 m THEN the velocities are not accused."""
    check = VelocityCheck()
    t = np.arange(0.0, 20.0, PERIOD)
    velocities = np.random.default_rng(2).normal(0.0, 0.05, (len(t), 2))
    follow(check, np.outer(30.0 * np.exp(-t / 5.0), (0.8, -0.6)), velocities)
    assert not check.fault
    assert not check.suspect


def test_a_suspicion_ends_where_nothing_moves() -> None:
    """GIVEN one step against the axes WHEN the vehicle then stands THEN the suspicion does not outlast the stand."""
    check = VelocityCheck()
    positions, _ = travel(2.2, (2.0, -0.8))
    after = follow(check, positions, np.tile((-1.4, 0.5), (len(positions), 1)))
    assert check.suspect
    rest = np.tile(positions[-1], (90, 1))
    follow(check, rest, np.zeros_like(rest), start=after)
    assert not check.suspect


@pytest.mark.parametrize(("period", "dense"), [(0.2, True), (5.0, False)])
def test_a_sum_over_sparse_velocities_says_nothing_of_clocks(period: float, dense: bool) -> None:
    """Between them the vehicle may have turned: no clock is to be blamed for that."""
    maker, steps = StepMaker(), []
    for k in range(30):
        t, east = k * period, 0.15 + k * period * 8.0 / (6.371e6 * math.cos(0.8))
        take_velocity(maker.state, maker.velocities, t, 8.0, 0.0, 0.0)
        own = own_velocity(maker.state, maker.velocities, t)
        if take_fix(maker.state, maker.velocities, own, t, 0.8, east, 1.0):
            steps.append(maker.end(t, 0.8, east))
    assert steps
    assert all(step.dense is dense for step in steps)


@pytest.mark.parametrize("is_noise", [True, False])
def test_what_looked_late_before_noise_was_known_is_no_lateness(is_noise: bool) -> None:
    """GIVEN velocities that will be proved late in a moment WHEN it turns out that they scatter THEN that evidence is
    dropped."""
    t = np.arange(0.0, 20.0, PERIOD)
    ways = np.column_stack([np.zeros(len(t)), 80.0 * (1.0 - np.cos(0.25 * t))])
    said = np.column_stack([np.zeros(len(t)), 20.0 * np.sin(0.25 * (t - 1.0))])
    proof, check = VelocityCheck(), VelocityCheck()
    ends = (
        k for k in range(len(t)) if follow(proof, ways[k : k + 1], said[k : k + 1], float(t[k])) and proof.late.delay
    )
    end = next(ends)
    follow(check, ways[:end], said[:end])
    if is_noise:
        check.expect_walk(0.5)
    follow(check, ways[end : end + 5], said[end : end + 5], float(t[end]))
    assert bool(check.late.delay) is not is_noise
