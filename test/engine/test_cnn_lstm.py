"""The network trained on other flights in flight: used where it helps, left out where it does not; early regimes."""

from dataclasses import replace

import numpy as np
import pytest

from airframes import FIXED_WING, FORMS, MULTIROTOR, airframe
from flown import Flight
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.airframe import Beforehand
from nav_pose_estimator.core.motion.windows import window
from nav_pose_estimator.engine.outage.methods import cnn_lstm
from nav_pose_estimator.engine.outage.methods.anfis import NETWORK
from nav_pose_estimator.engine.outage.methods.best import Best
from nav_pose_estimator.engine.outage.methods.cnn_lstm import PRETRAINED, CnnLstm, Untrained, WithoutNetwork
from nav_pose_estimator.engine.outage.methods.method import Flight as FlightSoFar
from nav_pose_estimator.engine.outage.methods.method import TrainingPlan
from nav_pose_estimator.engine.solutions import Mode, NavBlock
from nav_pose_estimator.errors import UserError

NOW = 10**18


class Told:
    """Rehearsals that say: ``worse`` names the ways that were worse than any rival."""

    def __init__(self, *worse: str) -> None:
        self.worse = worse

    def is_worse(self, name: str, rival: str, ratio: float) -> bool:
        return name in self.worse


def beforehand(vehicle_class: str = MULTIROTOR, is_one: bool = True, form: str | None = FORMS[0]) -> Beforehand:
    return Beforehand(vehicle_class, airframe(vehicle_class, is_one, form))


def flight_with(outputs: np.ndarray, epochs: np.ndarray, method: CnnLstm) -> FlightSoFar:
    """A flight whose network says ``outputs`` (N, 3), trained on."""
    wide = np.column_stack([epochs, outputs])
    return FlightSoFar(wide, method.job(wide, TrainingPlan()).run().model)


@pytest.fixture(scope="module")
def epochs() -> np.ndarray:
    """The drag is so noisy that the flight by itself learns little."""
    return Flight(seconds=60.0, noise=2.0).epochs()


@pytest.fixture(scope="module")
def air(epochs) -> np.ndarray:
    """The velocity through the air."""
    return epochs[:, me.BODY_VELOCITY : me.VELOCITY] - np.einsum(
        "nij,i->nj", me.attitude(epochs)[:, :2], np.array(Flight.wind)
    )


def test_a_network_that_knows_is_flown_with(epochs, air) -> None:
    """GIVEN a network whose output is the truth WHEN GNSS is lost THEN it guides, and its prediction is nearer."""
    method = CnnLstm().knowing(Beforehand(MULTIROTOR, airframe(form=FORMS[0]), worth=0.0))
    flight = flight_with(air, epochs, method)
    assert flight.model.gain > 2.0
    guide = method.choose(flight, Told())
    said = guide.advise(NOW, flight.epochs[-4:]).samples[0].air_velocity
    plain = method.ways(flight)[NETWORK].advise(NOW, flight.epochs[-4:]).samples[0].air_velocity
    assert np.linalg.norm(said - air[-1]) < np.linalg.norm(plain - air[-1])


@pytest.mark.parametrize("worse", [(PRETRAINED, "regimes"), (PRETRAINED, NETWORK)])
def test_rehearsals_overrule_it(epochs, air, worse) -> None:
    """GIVEN a network that looked good WHEN rehearsals say otherwise THEN the flight's own law guides, or the usual."""
    method = CnnLstm().knowing(beforehand())
    flight = flight_with(air, epochs, method)
    guide = method.choose(flight, Told(*worse))
    assert isinstance(guide, WithoutNetwork)
    assert guide.is_usual == (NETWORK in worse)  # the usual drag is no network
    assert guide.advise(NOW, flight.epochs[-4:]).samples[0].air_velocity is not None


def test_a_network_that_knows_nothing_is_left_out_before_any_rehearsal(epochs) -> None:
    """GIVEN outputs by chance WHEN trained THEN blocks not trained on show that they do not help."""
    method = CnnLstm().knowing(Beforehand(MULTIROTOR, airframe(form=FORMS[0]), worth=0.0))
    chance = np.random.default_rng(8).normal(0.0, 5.0, (len(epochs), 3))
    flight = flight_with(chance, epochs, method)
    assert flight.model.gain < 1.0
    assert isinstance(method.choose(flight, Told()), WithoutNetwork)
    assert isinstance(method.model_alone(flight), WithoutNetwork)


def test_without_the_network_it_says_what_best_says(epochs) -> None:
    """GIVEN the same flight WHEN cnn_lstm leaves its network out THEN its evidence is that of ``best``, bit for bit."""
    known = beforehand()
    method, best = CnnLstm().knowing(known), Best().knowing(known)
    flight = flight_with(np.zeros((len(epochs), 3)), epochs, method)
    model = best.job(epochs, TrainingPlan()).run().model
    ours = method.choose(flight, Told(PRETRAINED)).advise(NOW, flight.epochs[-4:])
    theirs = best.choose(FlightSoFar(epochs, model), Told()).advise(NOW, epochs[-4:])
    assert ours.samples[0].air_velocity == theirs.samples[0].air_velocity
    assert ours.samples[0].hypotheses == theirs.samples[0].hypotheses


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", [CnnLstm, Untrained])
def test_the_network_adds_a_velocity_to_every_epoch(kind, form) -> None:
    rows = np.random.default_rng(2).normal(size=(120, at.OUT_COLUMNS))
    rows[:, at.OUT_T], rows[:, at.OUT_QUAT : at.OUT_QUAT + 4] = np.arange(120) / 100.0, (1.0, 0.0, 0.0, 0.0)
    output = NavBlock(np.arange(120), rows, Mode.AIDED, 0, np.zeros(3))
    method = kind().knowing(beforehand(form=form))
    added = method.columns(output, rows)
    assert added.shape == (3,)
    weights = airframe(form=form).network.weights
    said = weights.predict(window(rows)[:, : weights.channels])[:3]
    assert np.allclose(added, said) == (kind is CnnLstm)


def test_a_saved_model_is_what_the_flight_taught(epochs, air) -> None:
    """GIVEN a model without a prior WHEN saved and loaded THEN it flies without the network until the next training."""
    method = CnnLstm().knowing(Beforehand(MULTIROTOR, airframe(form=FORMS[0]), worth=0.0))
    flight = flight_with(air, epochs, method)
    again = method.load(flight.model.state())
    assert again.stacked is None
    loaded = replace(flight, model=again.follow(flight.epochs[-1]))
    assert isinstance(method.choose(loaded, Told()), WithoutNetwork)
    assert set(method.ways(loaded)) == {"regimes", NETWORK}
    assert method.scores(again)["learner.network_gain"] == 0.0


# --- what is known before the flight ---------------------------------------------------------------------------------


def test_where_nothing_is_known_the_usual_motion_helps_and_training_waits() -> None:
    assert (Best().least_flight, Best().least_training) == (4.0, 20.0)
    assert Best().beforehand.prior is None


def test_a_class_gives_regimes_from_the_first_seconds_on() -> None:
    """GIVEN the class alone, as a parameter, WHEN asked THEN there is something to go by after 4 s; training waits."""
    method = Best().knowing(Beforehand(MULTIROTOR))
    assert (method.least_flight, method.least_training) == (4.0, 20.0)
    young = Flight(seconds=4.0).epochs()
    assert [one.name for one in method.choose(FlightSoFar(young), Told()).advise(NOW, young).samples[0].hypotheses] == [
        "travel",
        "hover",
    ]


def test_a_wing_that_taxies_does_not_hover() -> None:
    """GIVEN a fixed wing that stands WHEN its class is known THEN nothing says that it hovers."""
    still = Flight(seconds=20.0, speed=0.1, wind=(0.0, 0.0)).epochs()
    wing, unknown = (
        [one.name for one in method.choose(FlightSoFar(still), Told()).advise(NOW, still).samples[0].hypotheses]
        for method in (Best().knowing(Beforehand(FIXED_WING)), Best())
    )
    assert "hover" in unknown
    assert "hover" not in wing


def test_a_wing_at_rest_is_not_learned_from_while_the_archive_counts() -> None:
    """GIVEN a minute on the runway and ten seconds of flight WHEN trained THEN only the flight counts, or the archive's
    law would take the speed of its cruise for wind; without an archive, and once it has faded, everything counts."""
    epochs = Flight(seconds=300.0, speed=15.0).epochs()
    epochs[1:120, me.BODY_VELOCITY : me.FORCE] = 0.0  # behind the first, in which the filter was still settling
    known = Beforehand(FIXED_WING, airframe(FIXED_WING))
    np.testing.assert_array_equal(known.flown(epochs[:140]), epochs[120:140])
    assert len(known.flown(epochs[:120])) == 0
    assert len(Beforehand(FIXED_WING).flown(epochs[:140])) == 140
    assert len(known.flown(epochs)) == len(epochs)


@pytest.mark.parametrize(("vehicle_class", "is_one", "expected"), [
    (FIXED_WING, False, True), (FIXED_WING, True, True), (MULTIROTOR, False, False), (MULTIROTOR, True, True),
])  # fmt: skip
def test_other_multirotors_say_nothing_of_this_one(vehicle_class, is_one, expected) -> None:
    known = Beforehand(vehicle_class, airframe(vehicle_class, is_one))
    assert (known.prior is not None) == expected
    assert Best().knowing(known).least_training == (4.0 if expected else 20.0)
    assert replace(known, worth=0.0).prior is None


@pytest.mark.parametrize(
    ("is_one", "seconds", "expected"), [(False, 400.0, 100.0), (True, 400.0, 300.0), (True, 200.0, 200.0)]
)
def test_flights_of_the_same_aircraft_count_more(is_one, seconds, expected) -> None:
    """GIVEN an archive WHEN it is of this very aircraft THEN it is worth three times as much, at most what it holds."""
    known = airframe(FIXED_WING, is_one)
    prior = Beforehand(FIXED_WING, replace(known, archive=replace(known.archive, seconds=seconds))).prior
    assert prior is not None
    assert prior.worth == expected


def test_the_control_needs_the_same_file() -> None:
    with pytest.raises(UserError, match=f"{cnn_lstm.Untrained.name} flies with a trained network"):
        Untrained().knowing(Beforehand(MULTIROTOR))
