"""The source text's way through an outage: positions composed of predictions, and what the filter does with them."""

from dataclasses import replace

import numpy as np
import pytest

from airframes import FORMS, MULTIROTOR, airframe
from flown import Flight
from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel
from nav_pose_estimator.core.motion.airframe import Beforehand
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.outage.methods.cnn_lstm import PRETRAINED
from nav_pose_estimator.engine.outage.methods.method import Flight as FlightSoFar
from nav_pose_estimator.engine.outage.methods.method import TrainingPlan
from nav_pose_estimator.engine.outage.methods.pseudo_gnss import ComposedFixes, PseudoGnss
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ComposedPosition, stamp_of
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.scenarios import generate

NOW, LOST = 10**18, 120  # ns; epochs
PLACE = (0.83, 0.15, 500.0)


@pytest.fixture(scope="module")
def epochs() -> np.ndarray:
    """A minute to learn from and half a minute to compose; the network's output is the velocity through the air."""
    rows = Flight(seconds=90.0).epochs()
    rows[:, me.POSITION :] = PLACE
    wind = np.einsum("nij,i->nj", me.attitude(rows)[:, :2], np.array(Flight.wind))
    return np.column_stack([rows, rows[:, me.BODY_VELOCITY : me.VELOCITY] - wind])


@pytest.fixture(scope="module")
def method() -> PseudoGnss:
    return PseudoGnss().knowing(Beforehand(MULTIROTOR, airframe(form=FORMS[0])))


@pytest.fixture(scope="module")
def guide(epochs, method) -> ComposedFixes:
    flown = epochs[:LOST]
    model = method.job(flown, TrainingPlan()).run().model
    return method.ways(FlightSoFar(flown, model))[PRETRAINED]


def composed(guide: ComposedFixes, epochs: np.ndarray, count: int) -> ComposedPosition:
    return guide.advise(NOW, epochs[: LOST + count]).samples[0]


def test_positions_are_the_sum_of_what_was_predicted(guide, epochs) -> None:
    """GIVEN a network that is right WHEN half a minute has passed THEN the composed position is where the vehicle is,
    within what it states."""
    said = composed(guide, epochs, 60)
    east, north, up = lla_to_enu(*said.position, *PLACE)
    there = me.PERIOD * epochs[LOST : LOST + 60, me.VELOCITY : me.FORCE].sum(axis=0)
    there += 0.5 * me.PERIOD * epochs[LOST - 1, me.VELOCITY : me.FORCE]
    missed = np.array([east, north, up]) - there
    cov = guide.composed(epochs[LOST : LOST + 60])[1]
    assert missed @ np.linalg.solve(cov, missed) < 16.0
    assert np.linalg.norm(missed) < 20.0


def test_the_covariance_grows_with_every_second(guide, epochs) -> None:
    """Also faster than the sum of independent errors alone: the wind's error is the same all the time."""
    variances = np.array([guide.composed(epochs[LOST : LOST + n])[1].diagonal() for n in (1, 10, 20, 40, 60)])
    assert (np.diff(variances, axis=0) > 0.0).all()
    sure = replace(guide, model=replace(guide.model, wind_cov=np.zeros((2, 2)), wind_spread=0.0))
    alone = [sure.composed(epochs[LOST : LOST + n])[1][0, 0] - 4.0 for n in (20, 40)]
    with_wind = [guide.composed(epochs[LOST : LOST + n])[1][0, 0] - 4.0 for n in (20, 40)]
    assert alone[1] == pytest.approx(2.0 * alone[0], rel=0.5)
    assert with_wind[1] / with_wind[0] > alone[1] / alone[0]


def test_repeated_positions_are_not_believed_as_independent(guide, epochs) -> None:
    """GIVEN errors that are one random walk WHEN forty positions came THEN together they count no more than three of
    the last one by itself."""
    information = sum(1.0 / composed(guide, epochs, n).cov[2, 2] for n in range(1, 41))
    first = 1.0 / composed(guide, epochs, 1).cov[2, 2]
    assert information < 5.0 * first


def test_nothing_is_composed_over_a_gap(guide, epochs) -> None:
    recent = np.delete(epochs[: LOST + 30], LOST + 10, axis=0)
    assert guide.advise(NOW, recent).samples == ()
    assert guide.advise(NOW, epochs[:LOST]).samples == ()
    assert guide.advise(NOW, epochs[LOST + 30 : LOST + 60]).samples == (), "its beginning is forgotten"


def test_it_coasts_where_rehearsals_say_so(epochs, method) -> None:
    class Worse:
        def is_worse(self, name: str, rival: str, ratio: float) -> bool:
            return rival == "coast"

    model = method.job(epochs[:LOST], TrainingPlan()).run().model
    assert isinstance(model.stacked, AirVelocityModel)
    assert method.choose(FlightSoFar(epochs[:LOST], model), Worse()) is None


# --- in the filter ---------------------------------------------------------------------------------------------------


def coasted(*positions: tuple[float, np.ndarray]) -> PoseEstimator:
    """45 s of flight, the last ten without GNSS; ``positions``: metres East of the truth with their variances."""
    recording = generate("multirotor_light", 45.0, seed=4, imu_rate=50.0)
    engine = PoseEstimator(update(Parameters(), {"learner.enabled": False}), attitude=False)
    for sample in recording.samples():
        stamp = stamp_of(sample)
        if stamp is not None and stamp - recording.start_ns >= 35_000_000_000 and engine.mode is Mode.AIDED:
            engine.set_use_gnss(False)
        engine.feed(sample)
    nav = engine.sins.run.settled.nav
    for offset, cov in positions:
        lon = float(nav[at.LON]) + offset / (6.4e6 * np.cos(nav[at.LAT]))
        stamp = recording.start_ns + round(44.9e9)
        engine.feed(ComposedPosition(stamp, (float(nav[at.LAT]), lon, float(nav[at.ALT])), cov))
    engine.feed(sample)
    return engine


@pytest.mark.compiled
def test_the_filter_takes_them_by_its_nominal_state_and_stays_denied() -> None:
    """GIVEN an outage WHEN a composed position lies near, far off, or is not finite THEN it corrects, is refused by the
    gate, is refused at the door; none of them ends the outage."""
    near = coasted((2.0, 25.0 * np.eye(3)))
    assert near.status().counters["composed.used"] == 1
    assert near.mode in (Mode.COASTING, Mode.DEAD_RECKONING)
    far = coasted((5000.0, 25.0 * np.eye(3)))
    assert far.status().counters["composed.rejected"] == 1
    broken = coasted((0.0, np.full((3, 3), np.nan)))
    assert broken.status().counters["composed.rejected.value"] == 1
    assert np.isfinite(broken.sins.run.settled.nav).all()
