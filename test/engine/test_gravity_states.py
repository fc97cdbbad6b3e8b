"""Gravity as a state of the filter: off by default; on, it stays small and level flight does not pretend to know it."""

from functools import cache

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import GRAVITY
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.scenarios import generate

pytestmark = pytest.mark.compiled
SD = 0.01  # m/s^2


@cache
def flown(has_gravity: bool) -> PoseEstimator:
    """A minute of a multirotor that hardly tilts."""
    parameters = update(Parameters(), {"learner.enabled": False, "navigator.gravity_states": has_gravity})
    engine = PoseEstimator(parameters, attitude=False)
    for sample in generate("multirotor_light", 60.0, seed=4, imu_rate=50.0).samples():
        engine.feed(sample)
    assert engine.mode is Mode.AIDED
    return engine


def test_it_is_off_by_default() -> None:
    assert not Parameters().navigator.gravity_states
    assert not GRAVITY.is_in(flown(False).sins.run.settled.constants)


def test_the_filter_has_three_states_more() -> None:
    with_it, without = (flown(flag).sins.run.settled for flag in (True, False))
    assert len(with_it.P) == len(without.P) + 3
    assert np.linalg.eigvalsh(with_it.P).min() > -1e-12


def test_level_flight_cannot_tell_gravity_from_a_bias() -> None:
    """GIVEN a minute of nearly level flight WHEN gravity is a state THEN its deviation is still nearly what it was,
    its estimate within it, and its error goes with that of the vertical accelerometer bias."""
    settled = flown(True).sins.run.settled
    states = GRAVITY.states(settled.constants)
    variances = settled.P.diagonal()[states]
    assert variances[2] > (0.8 * SD) ** 2
    assert (np.abs(settled.nav[GRAVITY.estimates]) < 3.0 * SD).all()
    up, bias = states.start + 2, at.D_ACCEL_BIAS + 2
    correlation = settled.P[up, bias] / np.sqrt(settled.P[up, up] * settled.P[bias, bias])
    assert abs(correlation) > 0.3


def test_the_pose_hardly_differs() -> None:
    """GIVEN gravity as it is modelled WHEN it is a state THEN position and velocity are the same to centimetres."""
    with_it, without = (flown(flag).sins.run.settled.nav for flag in (True, False))
    np.testing.assert_allclose(with_it[at.VEL : at.QUAT], without[at.VEL : at.QUAT], atol=0.05)
    assert abs(with_it[at.ALT] - without[at.ALT]) < 0.1
