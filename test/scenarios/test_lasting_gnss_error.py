"""A receiver whose error lasts: what the states for it are worth on a simulated flight."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from nav_pose_estimator.engine.navigator.filter_run import state_of
from nav_pose_estimator.engine.samples import GnssVelocity
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.faults import Shift
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import find_scenario, generate
from nav_pose_estimator.sim.sensors import Gnss
from told import Told, silence, tell

pytestmark = pytest.mark.compiled
SD, TAU = 1.5, 30.0  # m, s


@cache
def flight() -> Recording:
    gnss = Gnss(position_sd=(SD, SD, 2.5), position_tau=TAU, position_noise=(0.2, 0.2, 0.3))
    return generate(replace(find_scenario("laps"), gnss=gnss), 200.0, seed=2, imu_rate=50.0)


@cache
def fly(with_states: bool) -> Told:
    return tell(flight(), learner__enabled=False, gnss__error_states=with_states, gnss__delay_sd=0.0)


def test_sigma_is_that_of_the_place_and_not_of_the_fixes() -> None:
    """GIVEN positions that err by 1.5 m for half a minute THEN nearly all errors lie within 3 sigma with the states
    and are no larger; without, the filter is surer than it is right."""
    aided = {on: fly(on).between(60.0, 200.0) for on in (False, True)}
    ratios = {on: (fly(on).off / fly(on).sigma)[aided[on]] for on in aided}
    assert np.mean(ratios[True] < 3.0) > 0.97
    assert 0.3 < np.median(ratios[True]) < 1.5
    assert np.mean(ratios[False] < 3.0) < 0.9
    rms = {on: np.sqrt(np.mean(fly(on).off[aided[on]] ** 2)) for on in aided}
    assert rms[True] < 1.05 * rms[False]


def test_innovations_are_white_with_the_states() -> None:
    values = {on: fly(on).estimator.status().values for on in (False, True)}
    assert values[False]["innovation.gnss_position.lag_1"] > 0.5
    assert abs(values[True]["innovation.gnss_position.lag_1"]) < 0.2
    assert abs(values[True]["innovation.gnss_velocity.lag_1"]) < 0.2


def test_the_status_tells_what_lasts() -> None:
    """GIVEN an error of 1.5 m for 30 s, noise of 0.2 m and white velocities of 0.1 m/s THEN they are found, roughly."""
    values = fly(True).estimator.status().values
    assert SD <= values["gnss.error.position_sd"] < 2.0  # as the receiver states, the noise included
    assert 0.3 * TAU < values["gnss.error.position_tau"] < 60.0
    assert 0.1 < values["gnss.error.position_white_sd"] < 0.4
    assert values["gnss.error.velocity_sd"] < 0.4
    assert not any(name.startswith("gnss.error.") for name in fly(False).estimator.status().values)


def test_what_was_found_outlives_a_restart() -> None:
    told = fly(True)
    saved = state_of(told.estimator.sins.run)
    assert saved is not None
    assert saved.error_shares == told.estimator.sins.run.noise.error_shares != (1.0,) * 4
    assert type(saved).of(saved.arrays()).error_shares == saved.error_shares


def test_gnss_returns_without_a_jump() -> None:
    """GIVEN 20 s without GNSS WHEN it returns, its error another one THEN it is a correction, within sigma."""
    told = tell(flight(), *silence(120.0, 20.0), learner__enabled=False, gnss__error_states=True)
    assert told.resets[-1] == 0
    assert told.modes_between(125.0, 139.0) <= {Mode.COASTING, Mode.DEAD_RECKONING}
    assert told.modes_between(145.0, 200.0) == {Mode.AIDED}
    lost, back = told.between(120.0, 140.0), told.between(145.0, 200.0)
    for part in (lost, back):
        assert np.mean(told.off[part] < 3.0 * told.sigma[part]) > 0.97


def test_an_accuracy_that_is_stated_still_counts() -> None:
    """GIVEN a receiver that states 6 m WHEN its error is that large THEN sigma covers it: no state takes its place."""
    gnss = Gnss(position_sd=(0.0,) * 3, position_noise=(6.0, 6.0, 9.0))
    recording = generate(replace(find_scenario("laps"), gnss=gnss), 90.0, seed=3, imu_rate=50.0)
    told = tell(recording, learner__enabled=False, gnss__error_states=True)
    aided = told.between(40.0, 90.0)
    assert np.mean(told.off[aided] < 3.0 * told.sigma[aided]) > 0.97


def test_at_the_loss_the_position_is_that_of_the_fixes() -> None:
    """GIVEN velocities of the receiver that are 0.2 m/s off for a minute, and hold the position a metre off WHEN GNSS
    is lost THEN the outage begins where the fixes were."""
    gnss = Gnss(position_sd=(0.0, 0.0, 0.0), position_noise=(0.3, 0.3, 0.5))
    hover = generate(replace(find_scenario("hover"), gnss=gnss), 65.0, seed=2, imu_rate=50.0)
    told = tell(hover, Shift(GnssVelocity, 0.0, 1e9, (0.2, 0.0, 0.0)), *silence(60.0, 5.0), learner__enabled=False)
    lost = told.modes.index(Mode.DEAD_RECKONING)
    assert told.off[lost - 1] > 1.0
    assert told.off[lost] < 0.5
