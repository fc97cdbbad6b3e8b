"""What is said of the motion in an outage, method by method, from what was learned before it."""

from dataclasses import replace

import numpy as np
import pytest

from flown import Flight
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import learn_air_velocity
from nav_pose_estimator.engine.outage.methods.method import Flight as FlightSoFar
from nav_pose_estimator.engine.outage.methods.method import Guide
from nav_pose_estimator.engine.outage.methods.registry import estimators
from nav_pose_estimator.engine.samples import MotionEvidence, VelocityError

NOW = 10**18


class Untried:
    """No rehearsal has rejected anything."""

    def is_worse(self, name: str, rival: str, ratio: float) -> bool:
        return False


def guide_of(method: str, epochs: np.ndarray, model=None) -> Guide:
    return estimators()[method].choose(FlightSoFar(epochs, model), Untried())


def said(guide: Guide, recent: np.ndarray, external=None) -> tuple[MotionEvidence | None, VelocityError | None]:
    """The one piece of evidence, if there is one, and the velocity error."""
    advice = guide.advise(NOW, recent, external)
    assert len(advice.samples) <= 1
    return (advice.samples[0] if advice.samples else None), advice.velocity_error


@pytest.fixture(scope="module")
def epochs() -> np.ndarray:
    return Flight(seconds=200.0, hover=0.3).epochs()


@pytest.fixture(scope="module")
def model(epochs):
    return learn_air_velocity(epochs)


def test_best_weighs_travelling_against_hovering(epochs, model) -> None:
    """GIVEN a multirotor that hovers now and then WHEN asked THEN both hypotheses are there, their probabilities sum
    to one, the hover holds the velocity tighter, and the network guides the traveller alone. A hover that goes on
    keeps its place."""
    evidence, error = said(guide_of("best", epochs, model), epochs[-4:])
    travel, hover = evidence.hypotheses
    assert (travel.name, hover.name) == ("travel", "hover")
    assert travel.probability + hover.probability == pytest.approx(1.0)
    assert hover.velocity_var < 0.2 * travel.velocity_var
    assert np.isfinite([travel.log_likelihood, hover.log_likelihood]).all()
    air, doubt = model.predict(epochs[-1])
    np.testing.assert_array_equal(evidence.air_velocity, air)
    assert travel.velocity_time is None  # with a network the usual speed tells the regimes apart, no more
    assert hover.velocity_time is not None
    assert travel.air_corrects
    assert hover.air_noise is not None
    assert not hover.air_corrects
    assert hover.place_var is None
    assert hover.lasting.place_var < 0.1 * travel.place_var
    assert travel.lasting is None
    np.testing.assert_allclose(travel.air_noise, doubt * model.noise / me.PERIOD)
    np.testing.assert_allclose(evidence.wind, model.wind_mean + model.wind)
    np.testing.assert_allclose(evidence.wind_mean, model.wind_mean)
    assert evidence.stamp_ns == NOW
    assert error is not None


def test_the_velocity_error_is_estimate_minus_prediction(epochs, model) -> None:
    """GIVEN a navigator that is 3 m/s off WHEN the network is asked THEN it sees these 3 m/s, within its noise."""
    drifted = epochs[-4:].copy()
    C = me.attitude(drifted)
    drifted[:, me.VELOCITY] += 3.0
    drifted[:, me.BODY_VELOCITY : me.VELOCITY] += 3.0 * C[:, 0]
    guide = guide_of("anfis", epochs, model)
    evidence, error = said(guide, drifted)
    _, before = said(guide, epochs[-4:])
    np.testing.assert_allclose(np.subtract(error.dv_n, before.dv_n), [3.0, 0.0, 0.0], atol=1e-9)
    assert np.abs(np.array(before.dv_n)[:2]).max() < 1.0
    assert np.linalg.eigvalsh(error.cov).min() > 0.0
    assert [h.name for h in evidence.hypotheses] == ["travel"]
    assert evidence.hypotheses[0].velocity_var is None


def test_the_velocity_prior_expects_the_speed_of_the_last_half_minute(epochs) -> None:
    slow = epochs.copy()
    slow[-60:, me.VELOCITY : me.VELOCITY + 2] = [2.0, 0.0]
    evidence, error = said(guide_of("velocity_prior", slow), slow[-4:])
    (only,) = evidence.hypotheses
    assert only.velocity_var == pytest.approx(2.0, rel=0.05)  # 4 m^2/s^2 over two components
    assert only.air_noise is None
    assert evidence.air_velocity is None
    assert error is None


def test_a_vehicle_at_rest_has_a_prior_that_is_no_certainty(epochs) -> None:
    still = epochs.copy()
    still[:, me.VELOCITY : me.FORCE] = 0.0
    evidence, _ = said(guide_of("velocity_prior", still), still[-4:])
    assert evidence.hypotheses[0].velocity_var > 0.0


@pytest.mark.parametrize("method", ["anfis", "anfis_linear", "drag"])
def test_a_method_of_a_network_says_nothing_without_one(epochs, method: str) -> None:
    assert said(guide_of(method, epochs), epochs[-4:]) == (None, None)


def test_of_two_laws_the_one_in_less_doubt_guides(epochs, model) -> None:
    """GIVEN a network and the usual drag WHEN no rehearsal tells which is better THEN that with the smaller noise
    guides; rehearsals overrule it."""

    class Network(Untried):
        def is_worse(self, name: str, rival: str, ratio: float) -> bool:
            return (name, rival) == ("regimes", "network")

    vague = replace(model, noise=100.0 * model.noise)
    assert not guide_of("best", epochs, model).is_usual
    assert guide_of("best", epochs, vague).is_usual
    assert not estimators()["best"].choose(FlightSoFar(epochs, vague), Network()).is_usual


def test_a_fixed_wing_is_never_said_to_hover(epochs, model) -> None:
    """GIVEN a flight that was never slow WHEN asked THEN there is one hypothesis; without a network it says that
    flights are local, and nothing of the velocity."""
    fast = epochs.copy()
    fast[:, me.VELOCITY] += 30.0
    with_network, _ = said(guide_of("best", fast, model), fast[-4:])
    assert [h.name for h in with_network.hypotheses] == ["travel"]
    without, error = said(guide_of("best", fast), fast[-4:])
    (travel,) = without.hypotheses
    assert (travel.velocity_var, travel.air_noise, error) == (None, None, None)
    assert travel.place_var > 30.0**2


def test_a_guided_vehicle_is_not_said_to_hover_nor_to_have_a_usual_speed(epochs, model) -> None:
    """GIVEN a vehicle that goes where its nose points WHEN asked THEN only the network speaks: a car at constant speed
    is as calm as one that has stopped."""
    guided = replace(model, wind_spread=0.0, wind_cov=np.zeros((2, 2)))
    evidence, _ = said(guide_of("best", epochs, guided), epochs[-4:])
    (only,) = evidence.hypotheses
    assert only.velocity_var is None
    assert only.air_noise is not None


def test_a_fresh_prediction_from_outside_stands_in_for_the_network(epochs, model) -> None:
    """GIVEN no network here WHEN another process says how wrong the velocity is THEN that counts, if it is fresh."""
    guide = guide_of("best", epochs)
    newest = epochs[-1]
    fresh = VelocityError(NOW - 400_000_000, (1.0, -2.0, 0.0), np.diag([0.1, 0.2, 0.3]))
    evidence, error = said(guide, epochs[-4:], fresh)
    expected = me.attitude(newest[None])[0].T @ (newest[me.VELOCITY : me.FORCE] - np.array(fresh.dv_n))
    np.testing.assert_allclose(evidence.air_velocity, expected)
    assert error is None  # it is not this process's to tell
    old = VelocityError(NOW - 1_100_000_000, fresh.dv_n, fresh.cov)
    np.testing.assert_array_equal(said(guide, epochs[-4:], old)[0].air_velocity, guide.model.predict(newest)[0])
    own = guide_of("best", epochs, model)
    np.testing.assert_array_equal(said(own, epochs[-4:], fresh)[0].air_velocity, said(own, epochs[-4:])[0].air_velocity)


def test_activity_speaks_for_travelling_and_quiet_for_hovering(epochs, model) -> None:
    """GIVEN the statistics of a flight WHEN the vehicle accelerates, or not THEN the likelihoods take sides."""
    guide = guide_of("best", epochs, model)

    def ratio(force: float) -> float:
        recent = epochs[-4:].copy()
        recent[:, me.ATTITUDE : me.BODY_VELOCITY] = np.eye(3).ravel()
        recent[:, me.FORCE : me.FORCE + 2] = [force, 0.0]
        travel, hover = said(guide, recent)[0].hypotheses
        return travel.log_likelihood - hover.log_likelihood

    assert ratio(2.5) > 0.5
    assert ratio(0.05) < -0.5
