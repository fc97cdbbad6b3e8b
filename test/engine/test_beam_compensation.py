"""The network that predicts the errors of faulty beams: what it learns and when it answers."""

from copy import deepcopy

import numpy as np
import pytest

from nav_pose_estimator.engine.sensors.beams.anfis_compensator import AnfisCompensator, NoiseTrace
from nav_pose_estimator.engine.sensors.beams.compensation import COMPENSATORS, BeamEvidence

SD = 0.0112
VARIANCE = np.full(4, SD**2)
SECOND = np.array([False, True, False, False])
NONE = np.zeros(4, bool)


def healthy(rng: np.random.Generator) -> np.ndarray:
    return SD * rng.standard_normal(4)


def trained(name: str, seconds: float = 400.0) -> AnfisCompensator:
    """After so long with GNSS at 2 Hz and sound beams."""
    compensator, rng = COMPENSATORS[name](), np.random.default_rng(5)
    assert isinstance(compensator, AnfisCompensator)
    for t in np.arange(0.0, seconds, 0.5):
        compensator.learn(BeamEvidence(float(t), healthy(rng), VARIANCE, NONE))
    return compensator


@pytest.fixture(scope="module")
def swarm() -> AnfisCompensator:
    return trained("anfis")


def answer(compensator: AnfisCompensator, error: float, flagged: np.ndarray = SECOND, messages: int = 20):
    """Innovation, predicted error and variance of the second beam after ``messages`` that were off by ``error``."""
    copy, rng = deepcopy(compensator), np.random.default_rng(6)
    for k in range(messages):
        innovation = healthy(rng) + np.where(flagged, error, 0.0)
        predicted, variance = copy.predict(BeamEvidence(400.0 + 0.5 * k, innovation, VARIANCE, flagged))
    return innovation[1], predicted[1], variance[1]


@pytest.mark.parametrize("name", ["anfis", "anfis_frcg", "anfis_linear"])
@pytest.mark.parametrize("error", [-0.3, 0.1, 0.3, 1.0])
def test_predicts_errors_that_it_has_only_rehearsed(name: str, error: float, swarm: AnfisCompensator) -> None:
    _, predicted, variance = answer(swarm if name == "anfis" else trained(name), error)
    assert predicted == pytest.approx(error, abs=3.0 * SD + 0.05 * abs(error))
    assert variance > SD**2  # never better than the innovation that it is made of


def test_the_swarm_improves_on_the_rules_where_they_started(swarm: AnfisCompensator) -> None:
    curve = swarm.model.curve
    assert curve is not None
    assert curve.validation[curve.best] < curve.validation[0]


def test_no_answer_before_training_for_sound_beams_and_for_what_is_strange(swarm: AnfisCompensator) -> None:
    assert np.isnan(answer(AnfisCompensator(), 0.3)[1])
    predicted, _ = deepcopy(swarm).predict(BeamEvidence(400.0, np.full(4, 0.3), VARIANCE, SECOND))
    assert np.isnan(predicted[[0, 2, 3]]).all()
    assert np.isnan(answer(swarm, 1e4)[1])


def test_no_answer_unless_most_beams_are_sound(swarm: AnfisCompensator) -> None:
    """GIVEN two faulty beams of four THEN they may as well be the navigator's drift."""
    two = np.array([True, True, False, False])
    assert np.isnan(answer(swarm, 0.3, flagged=two)[1])


def test_lost_beams_are_neither_learnt_nor_answered(swarm: AnfisCompensator) -> None:
    copy = deepcopy(swarm)
    before = copy.figures()["beams.compensation.samples"]
    lost = np.array([np.nan, 0.0, 0.0, 0.0])
    copy.learn(BeamEvidence(401.0, lost, VARIANCE, NONE))
    assert copy.figures()["beams.compensation.samples"] == before + 3
    predicted, variance = copy.predict(BeamEvidence(402.0, lost, VARIANCE, np.array([True, False, False, False])))
    assert np.isnan(predicted[0])
    assert np.isnan(variance[0])


def test_another_number_of_beams_begins_anew(swarm: AnfisCompensator) -> None:
    copy = deepcopy(swarm)
    predicted, _ = copy.predict(BeamEvidence(401.0, np.array([0.0, 0.3, 0.0]), VARIANCE[:3], SECOND[:3]))
    assert predicted.shape == (3,)


def test_same_messages_same_network_and_a_copy_is_independent(swarm: AnfisCompensator) -> None:
    again = trained("anfis")
    assert answer(again, 0.2) == answer(swarm, 0.2)
    copy, rng = deepcopy(swarm), np.random.default_rng(8)
    before = answer(swarm, 0.2)
    for k in range(2000):
        copy.learn(BeamEvidence(400.0 + 0.5 * k, 3.0 * healthy(rng), 9.0 * VARIANCE, NONE))
    assert answer(swarm, 0.2) == before
    assert answer(copy, 0.2) != before


def test_noise_trace_finds_the_noise() -> None:
    trace, rng = NoiseTrace.of(VARIANCE), np.random.default_rng(9)
    for _ in range(300):
        believed = trace.add(np.array([1.0, 3.0, 10.0, np.nan]) * SD * rng.standard_normal(4))
    np.testing.assert_allclose(believed[:3] / SD**2, (1.0, 9.0, 100.0), rtol=0.5)
    assert np.isnan(believed[3])
