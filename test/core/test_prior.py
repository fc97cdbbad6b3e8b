"""What flights of the past say: worth most while this one is young, nothing once it has shown how it moves."""

from dataclasses import replace

import numpy as np
import pytest

from flown import Flight, drive
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import learn_air_velocity, wind_along, with_law
from nav_pose_estimator.core.motion.prior import MotionPrior, PriorLaw, in_raw_inputs, regressors


def prior_of(*flights: np.ndarray, **options) -> MotionPrior:
    """An archive of these epochs, each flight's own wind removed."""
    gram, moment, count = 0.0, 0.0, 0
    for epochs in flights:
        wind = wind_along(learn_air_velocity(epochs), epochs)
        target = epochs[:, me.BODY_VELOCITY : me.VELOCITY]
        target = target - np.einsum("nij,ni->nj", me.attitude(epochs)[:, :2], wind)
        z = regressors(epochs)
        gram, moment, count = gram + z.T @ z, moment + z.T @ target, count + len(z)
    return MotionPrior(gram / count, moment / count, np.full(3, 0.05), 0.01, **options)


@pytest.fixture(scope="module")
def prior() -> MotionPrior:
    """Two flights of the same aircraft in other winds."""
    return prior_of(Flight(wind=(-4.0, 1.0), seed=11).epochs(), Flight(wind=(0.0, 5.0), seed=12).epochs())


def drift(model, ahead: np.ndarray) -> float:
    """Horizontal error [m] of dead reckoning with the model through epochs (N, COLUMNS)."""
    air = np.array([model.predict(one)[0] for one in ahead])
    ground = np.einsum("nij,nj->ni", me.attitude(ahead)[:, :2], air) + model.wind_mean + model.wind
    return float(np.linalg.norm(me.PERIOD * (ground - ahead[:, me.VELOCITY : me.VELOCITY + 2]).sum(axis=0)))


@pytest.mark.parametrize("seconds", [4.0, 10.0, 20.0])
def test_a_young_flight_is_helped_by_flights_in_other_winds(prior: MotionPrior, seconds: float) -> None:
    """GIVEN a few seconds of flight WHEN an outage of half a minute begins THEN with the archive dead reckoning ends
    nearer than without by far, and within what the model states of it."""
    epochs = Flight(seed=3).epochs()
    young, ahead = epochs[: round(seconds / me.PERIOD)], epochs[round(seconds / me.PERIOD) :][:60]
    helped = learn_air_velocity(young, prior=prior)
    assert drift(helped, ahead) < 0.5 * drift(learn_air_velocity(young), ahead)
    sd_wind = np.sqrt(helped.wind_cov[0, 0] + helped.wind_cov[1, 1] + 2.0 * helped.wind_spread)
    doubt = np.mean([helped.predict(one)[1] for one in ahead]) * helped.noise[:2].sum()
    assert drift(helped, ahead) < 3.0 * np.hypot(30.0 * sd_wind, np.sqrt(30.0 * doubt))


def test_it_fades_with_motion_to_exactly_what_the_flight_says(prior: MotionPrior) -> None:
    """GIVEN more motion than it lasts WHEN trained THEN every number is as without a prior."""
    epochs = Flight(seed=3).epochs()
    assert prior.seconds(epochs[:0]) == 30.0
    assert 0.0 < prior.seconds(epochs[:200]) < prior.seconds(epochs[:100]) < 30.0
    assert prior.seconds(epochs[:400]) == 0.0
    with_it, without = learn_air_velocity(epochs[:400], prior=prior), learn_air_velocity(epochs[:400])
    for name in ("wind", "wind_mean", "wind_cov", "noise", "hover_noise", "parameter_cov"):
        np.testing.assert_array_equal(getattr(with_it, name), getattr(without, name))


def test_standing_still_does_not_fade_it(prior: MotionPrior) -> None:
    waits = Flight(seed=3).epochs()
    waits[:, me.VELOCITY : me.FORCE] = 0.0
    assert prior.seconds(waits) == 30.0


def test_an_archive_of_another_aircraft_is_overruled(prior: MotionPrior) -> None:
    """GIVEN an archive whose aircraft has half the drag WHEN this one has flown for two minutes THEN dead reckoning is
    nearly as good as without it: no regret for long."""
    other = prior_of(Flight(drag=lambda air: -np.array((0.175, 0.25)) * air[:, :2], seed=13).epochs())
    epochs = Flight(seed=3).epochs()
    misled, own = learn_air_velocity(epochs[:240], prior=other), learn_air_velocity(epochs[:240])
    assert drift(misled, epochs[240:300]) < drift(own, epochs[240:300]) + 5.0


def test_it_lowers_the_doubt_about_the_law(prior: MotionPrior) -> None:
    young = Flight(seed=3).epochs()[:20]
    z = np.append(me.inputs(young[-1:])[0], 1.0)
    helped, alone = learn_air_velocity(young, prior=prior), learn_air_velocity(young)
    assert z @ helped.parameter_cov @ z < z @ alone.parameter_cov @ z


def test_the_doubt_is_the_same_in_scaled_and_in_raw_inputs(prior: MotionPrior) -> None:
    epochs = Flight(seed=3).epochs()[:20]
    cov = prior.parameter_cov(epochs, 30.0)
    z, raw = regressors(epochs)[-1], np.append(me.inputs(epochs[-1:])[0], 1.0)
    assert raw @ in_raw_inputs(cov) @ raw == pytest.approx(z @ cov @ z, rel=1e-6)


def test_strange_inputs_are_strange(prior: MotionPrior) -> None:
    """GIVEN the law of an archive WHEN it sees a usual flight and a loop THEN the novelty tells them apart."""
    law = PriorLaw(prior.coefficients, prior.gram)
    usual = me.inputs(Flight(seed=14).epochs())
    loop = usual[:1].copy()
    loop[0, 2], loop[0, 8] = -20.0, -1.0
    assert np.median(law.novelty(usual)) < 0.3
    assert (law.novelty(usual) < 1.0).mean() > 0.95
    assert law.novelty(loop)[0] > 2.0


def test_a_guided_vehicle_has_no_wind_from_the_start() -> None:
    """GIVEN an archive of cars WHEN a car has driven for ten seconds THEN there is no wind in its model, which without
    the archive only a minute shows."""
    prior = replace(prior_of(drive(seed=5)), is_guided=True)
    young = drive(seed=6)[:20]
    assert learn_air_velocity(young, prior=prior).is_guided
    assert not learn_air_velocity(young).is_guided


def test_a_law_from_elsewhere_finds_the_wind_of_the_flight(prior: MotionPrior) -> None:
    epochs = Flight(seed=4, wind=(3.0, 2.0)).epochs()
    model = with_law(epochs, PriorLaw(prior.coefficients, prior.gram))
    np.testing.assert_allclose(model.wind_mean + model.wind, (3.0, 2.0), atol=0.3)
    np.testing.assert_allclose(wind_along(model, epochs)[50:].mean(axis=0), (3.0, 2.0), atol=0.3)
