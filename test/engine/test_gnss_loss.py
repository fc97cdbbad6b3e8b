"""GNSS is lost: a filter that has been wrong about its velocity for seconds says so, and mends what it can."""

import math

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import state_count
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator import filter_setup
from nav_pose_estimator.engine.observation import FilterView, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.fusion import Fusion
from nav_pose_estimator.engine.sensors.gnss.receiver import Gnss, LossEvidence
from nav_pose_estimator.engine.sensors.gnss.velocity import Misfit

VELOCITY_SD, TILT_SD, CORRELATION = 0.2, math.radians(1.0), 0.9


def lost(misfit: float, position_misfit: float = 0.5) -> FilterView:
    """A filter at rest behind the loss, after ``misfit`` [m/s] to the East for three seconds."""
    parameters = Parameters()
    gnss = Gnss(parameters, Aiding(parameters.navigator.lost_after), Journal())
    nav = np.zeros(at.NAV_SIZE)
    nav[at.QUAT] = 1.0
    constants = filter_setup.constants(parameters, NoiseIdentification())
    P = 1e-6 * np.eye(state_count(constants))
    base = slice(at.BASE_STATES)
    P[base, base] = np.diag(np.repeat([TILT_SD, VELOCITY_SD, 0.5, 1e-3, 0.1], 3) ** 2)
    tilt, velocity = at.PHI + 1, at.DVEL
    P[tilt, velocity] = P[velocity, tilt] = CORRELATION * TILT_SD * VELOCITY_SD
    view = FilterView(nav, P, constants)
    evidence = LossEvidence(1.0, np.array([position_misfit, 0.0]), np.array([misfit, 0.0]))
    Fusion([gnss.loss], []).apply(Observation(0.0, 0, gnss.loss.kind, evidence), view)
    return view


def tilt_of(view: FilterView) -> float:
    """By which the vertical has moved [rad]."""
    return math.acos(min(quat_to_matrix(view.nav[at.QUAT : at.GYRO_BIAS])[2, 2], 1.0))


def test_a_velocity_that_was_off_for_seconds_is_put_right_with_the_tilt_behind_it() -> None:
    """GIVEN 2 m/s too much, the positions ahead as well THEN velocity and tilt move, and the tilt is less certain."""
    view = lost(2.0)
    assert view.nav[at.VEL] == pytest.approx(-2.0, abs=0.3)
    assert tilt_of(view) > math.radians(5.0)
    assert view.P[at.PHI + 1, at.PHI + 1] > 1.5**2 * TILT_SD**2
    assert view.P[at.DVEL, at.DVEL] > VELOCITY_SD**2


def test_a_receiver_that_was_wrong_draws_nothing_after_it_but_the_doubt_stays() -> None:
    """GIVEN positions behind, though the velocity was too fast THEN nothing but the position moves, and all is wide."""
    view = lost(2.0, position_misfit=-0.5)
    assert view.nav[at.VEL] == 0.0
    assert tilt_of(view) == pytest.approx(0.0, abs=1e-6)
    assert view.P[at.DVEL, at.DVEL] > 3.0**2 * VELOCITY_SD**2


@pytest.mark.parametrize("misfit", [0.0, 0.3, -0.6])
def test_what_a_receiver_may_have_in_common_for_so_long_changes_nothing(misfit: float) -> None:
    view = lost(misfit)
    assert view.nav[at.VEL] == 0.0
    assert view.P[at.DVEL, at.DVEL] == pytest.approx(VELOCITY_SD**2)


@pytest.mark.parametrize(("before", "last"), [(2.0, 2.0), (-2.0, 2.0), (2.0, -1.0)])
def test_the_last_second_counts_where_manoeuvres_would_hide_it(before: float, last: float) -> None:
    """GIVEN three seconds of velocities that are ``before`` m/s off, then ``last`` THEN the larger mean is what counts.

    A loss long after the last velocity knows of none."""
    parameters = Parameters()
    aiding = Aiding(parameters.navigator.lost_after)
    gnss = Gnss(parameters, aiding, Journal())
    for i in range(15):
        gnss.velocity.record.add(1.0, (before if i < 10 else last, 0.0), 0.2)
    gnss.velocity.misfit = Misfit(2.8, np.zeros(2), np.eye(2), [0.0, 0.0, 0.0])
    aiding.use_fix(2.8)
    expected = max((last, (2.0 * before + last) / 3.0), key=abs)
    assert gnss.loss_at(4.3, 0).measured.velocity[0] == pytest.approx(expected)
    aiding.use_fix(10.0)
    assert gnss.loss_at(11.5, 0).measured.velocity[0] == 0.0
