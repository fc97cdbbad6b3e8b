"""The learner's schedule: when it trains, when a result counts, and which models are not flown with."""

from dataclasses import replace

import numpy as np
import pytest

from flown import Flight
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.engine.outage import model_file
from nav_pose_estimator.engine.outage.learner import TAKE_OVER, OutageLearner
from nav_pose_estimator.engine.outage.methods.anfis import NetworkTraining
from nav_pose_estimator.engine.outage.methods.drag import DragTraining
from nav_pose_estimator.engine.outage.methods.method import TrainingJob, TrainingResult
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.errors import UserError


@pytest.fixture(scope="module")
def epochs() -> np.ndarray:
    return Flight(seconds=200.0).epochs()


SCHEDULE = [20.0, 30.0, 45.0, 67.5, 97.5, 127.5, 157.5, 187.5]  # s


def learner_of(**parameters) -> OutageLearner:
    return OutageLearner(replace(LearnerParameters(), **({"method": "anfis_linear"} | parameters)))


def fly(learner: OutageLearner, epochs: np.ndarray, train: bool = True) -> list[TrainingJob]:
    """Tell the learner of the epochs; its jobs are done at once."""
    jobs = []
    for one in epochs:
        job = learner.learn(one)
        if job is not None:
            jobs.append(job)
            if train:
                learner.accept(job.run())
    return jobs


def test_it_trains_as_soon_as_there_is_enough_and_then_every_period(epochs) -> None:
    """GIVEN a flight of 200 s WHEN a training is due every 30 THEN it trains at 20 s, while the flight is young
    whenever it has grown by half, then every 30 s."""
    jobs = fly(learner_of(period=30.0), epochs)
    assert [job.until for job in jobs] == SCHEDULE
    assert [len(job.epochs) for job in jobs] == [round(t / me.PERIOD) for t in SCHEDULE]


def test_the_window_limits_what_is_trained_on(epochs) -> None:
    jobs = fly(learner_of(window=60.0), epochs)
    assert {len(job.epochs) for job in jobs[3:]} == {120}
    np.testing.assert_array_equal(jobs[-1].epochs, epochs[255:375])


def test_too_little_flight_is_no_training_and_says_why(epochs) -> None:
    learner = learner_of()
    assert fly(learner, epochs[:30]) == []
    assert learner.state.reason == "only 15 s of flight with GNSS have been seen, 20 are needed"
    assert learner.state.model is None
    with pytest.raises(UserError, match=r"there is no model yet: only 15 s"):
        learner.arrays()


@pytest.mark.parametrize("method", ["coast", "velocity_prior"])
def test_methods_without_a_network_do_not_train(epochs, method: str) -> None:
    learner = learner_of(method=method)
    assert fly(learner, epochs) == []
    assert learner.state.memory.seconds == 200.0


@pytest.mark.parametrize("after", [0.0, 3.0])
def test_a_result_counts_five_seconds_after_its_data_whenever_it_came(epochs, after: float) -> None:
    """GIVEN a training at 20 s WHEN its result comes at once or 3 s later THEN the model is there at 25 s, the same."""
    reference, learner, waiting = learner_of(), learner_of(), []
    for one in epochs[:59]:
        if (job := reference.learn(one)) is not None:
            reference.accept(job.run())
        if (job := learner.learn(one)) is not None:
            waiting.append(job)
        if waiting and one[me.TIME] >= waiting[0].until + after:
            learner.accept(waiting.pop().run())
        assert (learner.state.model is None) == (one[me.TIME] < 20.0 + TAKE_OVER)
    np.testing.assert_array_equal(learner.state.model.wind, reference.state.model.wind)
    predicted, expected = (one.state.model.predict(epochs[58])[0] for one in (learner, reference))
    np.testing.assert_array_equal(predicted, expected)


def test_the_wind_of_a_new_model_is_brought_up_to_the_present(epochs) -> None:
    """GIVEN a model of data up to 20 s WHEN it is taken over at 25 s THEN it has followed the ten epochs since."""
    learner = learner_of()
    (job,) = fly(learner, epochs[:50])
    model = job.run().model
    for one in epochs[40:50]:
        model = model.follow(one)
    np.testing.assert_array_equal(learner.state.model.wind, model.wind)
    np.testing.assert_array_equal(learner.state.model.wind_cov, model.wind_cov)


def test_a_result_that_never_comes_holds_up_nothing(epochs) -> None:
    learner = learner_of()
    assert len(fly(learner, epochs, train=False)) == len(SCHEDULE)
    assert learner.state.model is None


def useless(epochs: np.ndarray) -> np.ndarray:
    """The same flight with a velocity that has nothing to do with what the IMU feels."""
    spoiled = epochs.copy()
    random = np.random.default_rng(3)
    spoiled[:, me.BODY_VELOCITY : me.VELOCITY] = random.normal(0.0, 3.0, (len(epochs), 3))
    return spoiled


def test_a_model_that_explains_nothing_is_not_used_and_says_so(epochs) -> None:
    """GIVEN a good model WHEN a training finds that nothing can be explained any more THEN there is no model."""
    learner = learner_of(window=60.0, period=30.0)
    fly(learner, epochs[:100])
    assert learner.state.model is not None
    later = useless(epochs)
    fly(learner, later[100:])
    assert learner.state.model is None
    assert "explains only" in learner.state.reason
    assert learner.state.trainings >= 4


def test_it_is_the_chosen_network_that_has_to_explain(epochs) -> None:
    """GIVEN one rule that was chosen and explains too little, two that just do but were not chosen THEN no model."""
    job = NetworkTraining(epochs[:100], (1,))
    model = job.run().model
    model = replace(model, errors={1: 0.95 * model.target_square, 2: 0.88 * model.target_square})
    learner = learner_of()
    fly(learner, epochs[:100], train=False)
    learner.accept(TrainingResult(model, job.until))
    fly(learner, epochs[100:120], train=False)
    assert learner.state.trainings == 1
    assert learner.state.model is None
    assert learner.state.reason == "the network explains only 5 % of the motion"


def test_that_a_vehicle_does_not_slip_is_worth_knowing(epochs) -> None:
    """GIVEN a guided vehicle of whose speed ahead the network explains nothing WHEN trained THEN the model is used."""
    job = NetworkTraining(epochs[:100], (1,))
    model = job.run().model
    model = replace(model, wind_spread=0.0, errors={1: 0.95 * model.target_square})
    learner = learner_of()
    fly(learner, epochs[:100], train=False)
    learner.accept(TrainingResult(model, job.until))
    fly(learner, epochs[100:120], train=False)
    assert learner.state.model is not None


def test_more_rules_are_searched_for_at_the_first_and_every_fourth_training(epochs) -> None:
    jobs = fly(learner_of(method="anfis", rules=3, period=20.0), epochs, train=False)
    assert len(jobs) > 8
    assert [job.rules for job in jobs] == [(1, 2, 3) if n % 4 == 0 else (1,) for n in range(len(jobs))]
    assert {job.rules for job in fly(learner_of(rules=3), epochs, train=False)} == {(1,)}


def test_the_drag_method_trains_the_law_of_drag(epochs) -> None:
    learner = learner_of(method="drag")
    jobs = fly(learner, epochs[:100])
    assert jobs
    assert all(isinstance(job, DragTraining) for job in jobs)
    assert "learner.error_rms.1" in learner.scores()
    with pytest.raises(UserError, match="nothing to save"):
        learner.arrays()


def test_a_clock_that_went_back_does_not_stop_the_training(epochs) -> None:
    learner = learner_of()
    fly(learner, epochs)
    earlier = epochs.copy()
    earlier[:, me.TIME] -= 10_000.0
    assert len(fly(learner, earlier[:100])) >= 1


def test_a_model_survives_a_file_and_the_next_training_replaces_it(epochs, tmp_path) -> None:
    """GIVEN a model in a file WHEN a fresh learner loads it THEN it predicts the same, until it has trained itself."""
    learner = learner_of()
    fly(learner, epochs)
    model_file.save_arrays(tmp_path / "model", learner.arrays())
    fresh = learner_of()
    fresh.load(model_file.load_arrays(tmp_path / "model"))
    assert fresh.state.reason == ""
    np.testing.assert_array_equal(fresh.state.model.predict(epochs[7])[0], learner.state.model.predict(epochs[7])[0])
    loaded = fresh.state.model.network
    fly(fresh, epochs[:49])
    assert fresh.state.model.network is loaded
    fly(fresh, epochs[49:50])
    assert fresh.state.model.network is not loaded


@pytest.mark.parametrize("damage", ["missing", "nan"])
def test_a_damaged_model_is_refused_and_the_old_one_stays(epochs, damage: str) -> None:
    learner = learner_of()
    fly(learner, epochs[:100])
    arrays, model = learner.arrays(), learner.state.model
    if damage == "missing":
        del arrays["wind_spread"]
    else:
        arrays["noise"] = np.full(3, np.nan)
    with pytest.raises(UserError, match="outage model"):
        learner.load(arrays)
    assert learner.state.model is model


def test_a_copy_lives_its_own_life(epochs) -> None:
    learner = learner_of()
    fly(learner, epochs[:100])
    twin, model = learner.copy(), learner.state.model
    fly(twin, epochs[100:200])
    assert learner.state.model is model
    assert learner.state.memory.seconds == 50.0
    assert twin.state.trainings > learner.state.trainings == 3


def test_the_scores_tell_how_much_was_seen_and_how_well_it_is_explained(epochs) -> None:
    learner = learner_of()
    assert learner.scores() == {"learner.flight_s": 0.0, "learner.trainings": 0.0}
    fly(learner, epochs)
    scores = learner.scores()
    assert scores["learner.flight_s"] == 200.0
    assert scores["learner.trainings"] == len(SCHEDULE)
    assert scores["learner.error_rms.1"] < 0.3 * scores["learner.target_rms"]
    assert {"learner.noise.x", "learner.noise.y", "learner.noise.z"} <= scores.keys()
