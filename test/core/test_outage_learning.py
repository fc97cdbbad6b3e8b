"""The network of the outage: on flights whose law of motion is known, and on data of which nothing can be learned."""

from dataclasses import fields

import numpy as np
import pytest

from flown import DRAG, Flight, drive
from nav_pose_estimator.core.learning.anfis import Anfis
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, learn_air_velocity, learn_drag
from nav_pose_estimator.errors import UserError

LEARN = {"network": learn_air_velocity, "drag": learn_drag}


def prediction_errors(model: AirVelocityModel, epochs: np.ndarray) -> np.ndarray:
    """Velocity over ground in b (N, 3) less what model and its wind say of it, the wind followed epoch by epoch."""
    errors = []
    for one in epochs:
        C = me.attitude(one[None])[0]
        air, _ = model.predict(one)
        errors.append(one[me.BODY_VELOCITY : me.VELOCITY] - air - C[:2].T @ (model.wind_mean + model.wind))
        model = model.follow(one)
    return np.array(errors)


@pytest.fixture(scope="module")
def models() -> dict[str, AirVelocityModel]:
    """What is learned of one and the same flight."""
    epochs = Flight().epochs()
    return {name: learn(epochs) for name, learn in LEARN.items()}


@pytest.mark.parametrize("name", LEARN)
def test_law_and_wind_of_a_known_flight_are_found(name: str, models) -> None:
    """GIVEN five minutes with linear drag in a steady wind WHEN learned THEN the wind is right to 0.3 m/s, and on
    another flight the air velocity is right within the noise that is stated for it."""
    model = models[name]
    np.testing.assert_allclose(model.wind_mean + model.wind, Flight.wind, atol=0.3)
    other = Flight(seed=7, seconds=100.0).epochs()
    errors = prediction_errors(model, other)
    horizontal = errors[:, :2]
    # white noise of 0.05 m/s^2 is 0.1 to 0.14 m/s of air velocity
    assert np.sqrt(np.mean(horizontal**2)) < 0.3
    stated = model.noise / me.PERIOD
    assert (np.square(errors).mean(axis=0) < 1.5 * stated + 2.0 * model.wind_cov[0, 0])[:2].all()


def test_the_drag_coefficients_are_found(models) -> None:
    np.testing.assert_allclose(1.0 / models["drag"].network.gain, DRAG, rtol=0.06)


@pytest.mark.parametrize("name", LEARN)
def test_the_stated_noise_is_that_of_flights_not_trained_on(name: str) -> None:
    """GIVEN a force noise so large that the law is vague WHEN learned THEN on an unseen flight the normalised error is
    about one: neither twice as good nor twice as bad as stated."""
    model = LEARN[name](Flight(noise=0.4).epochs())
    errors = prediction_errors(model, Flight(noise=0.4, seed=9, seconds=200.0).epochs())
    ratio = np.square(errors[:, :2]).mean(axis=0) / (model.noise[:2] / me.PERIOD + model.wind_cov[0, 0])
    assert (ratio > 0.3).all()
    assert (ratio < 2.0).all()


def test_residuals_that_persist_count_for_more() -> None:
    """GIVEN two flights with equally large residuals, white in one, lasting seconds in the other WHEN learned
    THEN the noise of a mean over one second is larger for the lasting ones."""

    def flight(lasting: bool) -> np.ndarray:
        epochs = Flight().epochs()
        random = np.random.default_rng(3)
        white = random.normal(0.0, 0.6, (len(epochs) + 8, 2))
        slow = np.array([white[i : i + 8].sum(axis=0) for i in range(len(epochs))]) / np.sqrt(8.0)
        epochs[:, me.BODY_VELOCITY : me.BODY_VELOCITY + 2] += slow if lasting else white[: len(epochs)]
        return epochs

    white, lasting = (learn_drag(flight(kind)) for kind in (False, True))
    assert (lasting.noise[:2] > 2.0 * white.noise[:2]).all()


def two_regimes(air: np.ndarray) -> np.ndarray:
    """Drag that is four times as strong backwards as forwards: no linear law."""
    return -np.where(air[:, :2] > 0.0, 0.2, 0.8) * air[:, :2]


def test_more_rules_are_taken_only_where_they_are_needed() -> None:
    """GIVEN a linear law and one with two regimes WHEN one and two rules are tried THEN one, and two, win."""
    linear = learn_air_velocity(Flight(seconds=150.0).epochs(), (1, 2))
    assert linear.rules == 1
    assert set(linear.errors) == {1, 2}
    bent = learn_air_velocity(Flight(seconds=250.0, drag=two_regimes).epochs(), (1, 2))
    assert bent.rules > 1
    assert bent.errors[bent.rules] < 0.9 * bent.errors[1]


def test_the_errors_are_of_blocks_that_were_not_trained_on() -> None:
    """GIVEN targets of which nothing can be known WHEN many rules are tried THEN none seems to explain anything."""
    epochs = Flight(seconds=100.0).epochs()
    random = np.random.default_rng(2)
    epochs[:, me.BODY_VELOCITY : me.VELOCITY] = random.normal(0.0, 3.0, (len(epochs), 3))
    model = learn_air_velocity(epochs, (1, 3))
    assert min(model.errors.values()) > 0.95 * model.target_square
    assert model.rules == 1


# --- on wheels -------------------------------------------------------------------------------------------------------


def test_a_car_is_known_by_not_slipping_and_knows_no_wind() -> None:
    """GIVEN a vehicle that goes where its nose points WHEN learned THEN it is guided, there is no wind, and the
    velocity sideways and up is known to a decimetre per second on another drive."""
    model = learn_air_velocity(drive())
    assert model.is_guided
    np.testing.assert_array_equal([*model.wind_mean, *model.wind, *model.wind_cov.ravel()], 0.0)
    errors = prediction_errors(model, drive(seed=4))
    assert np.sqrt(np.mean(errors[:, 1:] ** 2)) < 0.1
    assert (model.noise[1:] < 0.05 * model.noise[0]).all()


def test_what_flies_is_not_guided(models) -> None:
    """GIVEN a multirotor, or an aircraft that flies nose first in a wind WHEN learned THEN neither is guided."""
    assert not models["network"].is_guided
    assert not learn_air_velocity(drive(wind=(4.0, 2.0))).is_guided


# --- wind ------------------------------------------------------------------------------------------------------------


def test_a_change_of_the_wind_is_known_at_the_end_of_the_training() -> None:
    """GIVEN a wind that veers slowly WHEN learned THEN mean and change together are the wind of today."""
    model = learn_air_velocity(
        Flight(change=lambda t: np.column_stack([1.5 * np.sin(t / 60.0), 0.0 * t]), noise=0.1).epochs()
    )
    today = Flight.wind[0] + 1.5 * np.sin(300.0 / 60.0)
    assert (model.wind_mean + model.wind)[0] == pytest.approx(today, abs=3.0 * np.sqrt(model.wind_cov[0, 0]) + 0.1)
    assert abs(today - model.wind_mean[0]) > 0.8  # it has changed
    assert model.wind_spread > 0.2


def test_following_one_epoch_moves_nothing_but_the_wind(models) -> None:
    model = models["network"]
    one = Flight(seed=3, wind=(5.0, 0.0)).epochs()[100]
    after = model.follow(one)
    assert not np.array_equal(after.wind, model.wind)
    for item in fields(model):
        if item.name not in ("wind", "wind_cov"):
            assert getattr(after, item.name) is getattr(model, item.name)


# --- strange inputs and strange data ---------------------------------------------------------------------------------


def test_a_strange_input_is_worth_little(models) -> None:
    """GIVEN a network WHEN an input like the training's comes THEN its noise is nearly as stated; far away,
    at least ten times that."""
    epochs = Flight(seed=8).epochs()
    usual = [models["network"].predict(one)[1] for one in epochs]
    assert 1.0 <= np.median(usual) < 2.0
    strange = epochs[50].copy()
    strange[me.FORCE : me.POSITION] += 60.0
    assert models["network"].predict(strange)[1] > 10.0
    assert models["drag"].predict(strange)[1] == 1.0  # a law of physics holds everywhere


def test_what_a_short_flight_teaches_is_worth_less() -> None:
    """GIVEN thirty seconds, two and ten minutes of the same flying WHEN learned THEN the fewer there were, the more
    noise a prediction is given for coefficients that are not known yet."""
    other = Flight(seed=8, seconds=60.0).epochs()
    doubt = []
    for seconds in (30.0, 120.0, 600.0):
        model = learn_air_velocity(Flight(seconds=seconds).epochs())
        doubt.append(np.median([model.predict(one)[1] for one in other]))
    assert doubt[0] > 1.5 * doubt[1] > 1.5 * doubt[2] > 1.5


def test_the_errors_of_the_first_minutes_are_as_large_as_stated() -> None:
    """GIVEN forty seconds of flight WHEN what was learned is asked about another flight THEN the errors, which
    last, are within three deviations of what is stated for the mean over ten seconds, nearly always."""
    inside = []
    for seed in range(12):
        model = learn_air_velocity(Flight(seconds=40.0, noise=0.3, seed=seed).epochs())
        epochs = Flight(seconds=100.0, noise=0.3, seed=100 + seed).epochs()
        for ten in np.split(epochs, 10):
            C = me.attitude(ten)
            wrong, stated = np.zeros(2), 0.0
            for one, attitude in zip(ten, C, strict=True):
                air, factor = model.predict(one)
                wrong += (one[me.VELOCITY : me.VELOCITY + 2] - (attitude @ air)[:2] - Flight.wind) / len(ten)
                stated += factor * float(model.noise[:2].mean()) / len(ten)
            inside.append(np.abs(wrong).max() < 3.0 * np.sqrt(stated / 10.0))
    assert np.mean(inside) > 0.95


def test_noise_of_a_hover_that_was_never_flown_is_a_guess_that_real_hovers_replace() -> None:
    """GIVEN a flight without and one with hovers WHEN learned THEN the guess is at least 1 m/s, and the known noise
    less than that."""
    never, often = (learn_air_velocity(Flight(hover=share).epochs()) for share in (0.0, 0.4))
    assert (never.hover_noise > 1.0).all()
    assert (often.hover_noise < never.hover_noise).all()


@pytest.mark.parametrize("name", LEARN)
@pytest.mark.parametrize("what", ["at rest", "one number", "tiny"])
def test_poor_data_give_a_poor_model_and_no_crash(name: str, what: str) -> None:
    """GIVEN no motion, one and the same row, or the least that is trained on WHEN learned THEN every number is finite
    and no noise is nought."""
    epochs = Flight(seconds=40.0).epochs()
    if what == "at rest":
        epochs[:, me.BODY_VELOCITY : me.FORCE] = 0.0
    elif what == "one number":
        epochs[:, me.ATTITUDE :] = epochs[0, me.ATTITUDE :]
    model = LEARN[name](epochs)
    assert (model.noise > 0.0).all()
    assert (model.hover_noise > 0.0).all()
    assert np.isfinite([*model.noise, *model.wind, *model.wind_mean, *model.wind_cov.ravel(), model.wind_spread]).all()
    air, factor = model.predict(epochs[5])
    assert np.isfinite([*air, factor]).all()
    assert np.isfinite(model.follow(epochs[6]).wind).all()


# --- the model as arrays ---------------------------------------------------------------------------------------------


def test_a_model_is_the_same_after_a_trip_through_arrays() -> None:
    epochs = Flight(seconds=120.0).epochs()
    model = learn_air_velocity(epochs, (2,))
    again = AirVelocityModel.from_state(model.state())
    for item in fields(model):
        if item.name != "network":
            np.testing.assert_array_equal(getattr(again, item.name), getattr(model, item.name))
    assert again.rules == model.rules == 2
    for one in epochs[::20]:
        np.testing.assert_array_equal(again.predict(one)[0], model.predict(one)[0])
        assert again.predict(one)[1] == model.predict(one)[1]
        np.testing.assert_array_equal(again.follow(one).wind, model.follow(one).wind)
    assert again.state().keys() == model.state().keys()


def test_a_drag_law_is_nothing_to_save(models) -> None:
    with pytest.raises(UserError, match="not a network of this flight"):
        models["drag"].state()


@pytest.mark.parametrize("change", ["missing", "shape", "nan", "negative", "errors", "inputs"])
def test_arrays_that_are_no_model_are_refused(models, change: str) -> None:
    """GIVEN the arrays of a model WHEN one is missing, misshapen or senseless THEN they are refused, not flown with."""
    state = models["network"].state()
    if change == "missing":
        del state["noise"]
    elif change == "shape":
        state["wind_mean"] = np.zeros(3)
    elif change == "nan":
        state["wind"] = np.array([np.nan, 0.0])
    elif change == "negative":
        state["noise"] = np.array([0.1, -0.1, 0.1])
    elif change == "errors":
        state["errors"] = np.zeros(3)
    else:
        other = Anfis(1).fit(np.random.default_rng(1).normal(size=(50, 4)), np.ones((50, 3)) * np.arange(50)[:, None])
        state = {k: v for k, v in state.items() if not k.startswith("network.")}
        state |= {f"network.{name}": value for name, value in other.state().items()}
    with pytest.raises(KeyError if change == "missing" else UserError):
        AirVelocityModel.from_state(state)
