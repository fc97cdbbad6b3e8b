"""Noise models on a position that walks at random: what they find, what they must not do, and the text's switch."""

import copy
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2

from literal_switch import LiteralSwitch
from nav_pose_estimator.core.filter.measurement_noise import LARGEST_FACTOR, MODELS, InnovationAdaptive, enlarged
from nav_pose_estimator.core.numerics.snapshot import snapshot

LEARNING = [name for name, model in MODELS.items() if model.learns]
STEPS, WALK = 1500, 0.05
STATED = np.diag([1.0, 1.0, 4.0])


def white(rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((STEPS, 3)) * np.sqrt(STATED.diagonal())


def correlated(rng: np.random.Generator) -> np.ndarray:
    noise, decay = white(rng), np.exp(-1.0 / 30.0)
    for k in range(1, STEPS):
        noise[k] = decay * noise[k - 1] + np.sqrt(1.0 - decay**2) * noise[k]
    return noise


class Walk:
    """A Kalman filter of a position (3,) that walks at random, with errors drawn from its own model but for R."""

    def __init__(self, seed: int = 1, noise: Callable = white) -> None:
        rng = np.random.default_rng(seed)
        self.truth = np.cumsum(WALK * rng.standard_normal((STEPS, 3)), axis=0)
        self.measured = self.truth + noise(rng)

    def filtered(self, R_of: Callable, note: Callable, times: np.ndarray | None = None) -> tuple[float, float]:
        """NEES per degree of freedom and RMS error of the second half; ``R_of`` (z, HPH), ``note`` (t, z, z+, HPH)."""
        x, P, nees, errors = np.zeros(3), np.eye(3), [], []
        for k, y in enumerate(self.measured):
            P = P + WALK**2 * np.eye(3)
            z, HPH = x - y, P
            R = R_of(z, HPH)
            gain = np.linalg.solve(HPH + R, P).T
            x = x - gain @ z
            P = (np.eye(3) - gain) @ P @ (np.eye(3) - gain).T + gain @ R @ gain.T
            note(float(k) if times is None else times[k], z, x - y, HPH)
            error = x - self.truth[k]
            nees.append(error @ np.linalg.solve(P, error) / 3.0)
            errors.append(error)
        half = STEPS // 2
        return float(np.mean(nees[half:])), float(np.sqrt(np.mean(np.square(errors[half:]))))

    def by(self, model, stated: np.ndarray = STATED) -> tuple[float, float]:
        return self.filtered(
            lambda z, HPH: model.covariance(z, HPH, stated),
            lambda t, z, residual, HPH: model.note(t, z, residual, HPH, stated),
        )

    def by_switch(self, switch: LiteralSwitch) -> tuple[float, float]:
        return self.filtered(switch.next, lambda t, z, residual, HPH: switch.note(residual))


def mean_of(results: list[tuple[float, float]]) -> tuple[float, float]:
    return tuple(np.mean(results, axis=0))  # type: ignore[return-value]


def test_robust_variance_is_unbiased_for_gaussian_noise():
    kept, _ = quad(lambda x: min(x, 3.0) * chi2.pdf(x, 1), 0.0, 60.0, points=[3.0])
    assert pytest.approx(kept, abs=1e-3) == InnovationAdaptive._KEPT


@pytest.mark.parametrize("name", LEARNING)
def test_with_the_right_noise_nothing_much_changes(name: str):
    """GIVEN noise as stated THEN the filter is consistent and no worse than with a fixed R."""
    walks = [Walk(seed) for seed in range(4)]
    nees, error = mean_of([walk.by(MODELS[name]()) for walk in walks])
    _, reference = mean_of([walk.by(MODELS["fixed"]()) for walk in walks])
    assert 0.7 < nees < 1.2
    assert error < 1.05 * reference


@pytest.mark.parametrize("name", LEARNING)
def test_a_sensor_three_times_worse_than_it_states_is_found_out(name: str):
    """GIVEN a third of the deviation stated THEN the factor is about 9 and NEES about 1, where a fixed R has over 3."""
    walks = [Walk(seed) for seed in range(4)]
    models = [MODELS[name]() for _ in walks]
    nees, error = mean_of([w.by(model, STATED / 9.0) for w, model in zip(walks, models, strict=True)])
    fixed_nees, fixed_error = mean_of([walk.by(MODELS["fixed"](), STATED / 9.0) for walk in walks])
    assert 0.7 < nees < 1.4
    assert fixed_nees > 3.0
    assert error < fixed_error
    assert 6.0 < np.mean([model.factor for model in models]) < 16.0


@pytest.mark.parametrize("name", LEARNING)
def test_pessimistic_statements_are_kept(name: str):
    """GIVEN ten times the deviation stated THEN R stays at that, to the last bit."""
    model = MODELS[name]()
    Walk().by(model, 100.0 * STATED)
    np.testing.assert_array_equal(model.expected(STATED), STATED)


@pytest.mark.parametrize("name", LEARNING)
def test_R_is_never_below_the_stated_covariance(name: str):
    """GIVEN correlated axes of different factors THEN R less the stated one has no negative eigenvalue."""
    rng, model = np.random.default_rng(3), MODELS[name]()
    stated = np.array([[1.0, 0.9, 0.5], [0.9, 1.0, 0.6], [0.5, 0.6, 2.0]])
    for k in range(300):
        z, HPH = rng.standard_normal(3) * (0.1, 3.0, 30.0), np.diag(rng.random(3))
        R = model.covariance(z, HPH, stated)
        model.note(float(k), z, 0.9 * z, HPH, stated)
        assert np.linalg.eigvalsh(R - stated)[0] > -1e-12
        assert R.diagonal().max() <= LARGEST_FACTOR * 2.0 + 1e-9
    assert model.factor > 30.0


def test_outliers_do_not_open_the_robust_variance():
    """GIVEN one observation in fifty a hundred times off THEN R / R0 stays below 2."""
    rng, model = np.random.default_rng(5), InnovationAdaptive()
    factors = []
    for k in range(1000):
        z = rng.standard_normal(1) * (100.0 if k % 50 == 0 else 1.0)
        model.note(float(k), z, 0.0 * z, np.zeros((1, 1)), 2.0 * np.eye(1))
        factors.append(model.factor)
    assert np.mean(factors) < 2.0


@pytest.mark.parametrize("name", list(MODELS))
def test_correlated_errors_do_not_shrink_R_but_the_literal_switch_does(name: str):
    """GIVEN errors that last 30 epochs THEN models stay where fixed is; the switch believes small innovations."""
    walks = [Walk(seed, correlated) for seed in range(3)]
    fixed, _ = mean_of([walk.by(MODELS["fixed"]()) for walk in walks])
    nees, _ = mean_of([walk.by(MODELS[name]()) for walk in walks])
    switched, _ = mean_of([walk.by_switch(LiteralSwitch(STATED)) for walk in walks])
    assert nees < 1.03 * fixed
    assert switched > 3.0 * fixed


def test_first_rule_of_the_text_drifts_down_though_nothing_is_wrong():
    """E ln(1 + alpha) is -0.30 an epoch for three rows and a window of five: R falls by a quarter at every fix."""
    squares = np.random.default_rng(7).chisquare(3, (200_000, 5))
    assert np.log(squares[:, -1] / squares.mean(axis=1)).mean() == pytest.approx(-0.30, abs=0.01)
    switch = LiteralSwitch(STATED, "A")
    nees, _ = Walk().by_switch(switch)
    assert switch.R[0, 0] < 0.05 * STATED[0, 0]
    assert nees > 5.0


def test_the_switch_is_less_honest_than_its_second_rule_alone():
    walks = [Walk(seed) for seed in range(4)]
    switched, _ = mean_of([walk.by_switch(LiteralSwitch(STATED)) for walk in walks])
    second, _ = mean_of([walk.by_switch(LiteralSwitch(STATED, "B")) for walk in walks])
    robust, _ = mean_of([walk.by(InnovationAdaptive()) for walk in walks])
    assert switched > 1.2 * robust
    assert second < switched


@pytest.mark.parametrize("name", LEARNING)
def test_what_is_no_number_teaches_nothing(name: str):
    model, HPH = MODELS[name](), np.eye(3)
    model.note(0.0, np.ones(3), np.ones(3), HPH, STATED)
    before = copy.deepcopy(model)
    for bad in (np.full(3, np.nan), np.array([1.0, np.inf, 0.0]), np.full(3, 1e100)):
        model.covariance(bad, HPH, STATED)
        model.note(1.0, bad, bad, HPH, STATED)
        assert np.isfinite(model.expected(STATED)).all()
    assert before.expected(STATED)[2, 2] <= model.expected(STATED)[2, 2] <= LARGEST_FACTOR * STATED[2, 2]


@pytest.mark.parametrize("name", LEARNING)
def test_asking_changes_nothing_and_copies_are_independent(name: str):
    model = MODELS[name]()
    Walk().by(model, STATED / 9.0)
    reference = model.expected(STATED).copy()
    model.covariance(np.full(3, 50.0), np.eye(3), STATED)
    np.testing.assert_array_equal(model.expected(STATED), reference)
    for twin in (copy.deepcopy(model), snapshot(model)):
        for k in range(50):
            twin.note(STEPS + float(k), np.full(3, 40.0 * (-1.0) ** k), np.zeros(3), np.zeros((3, 3)), STATED)
        assert twin.factor != model.factor
    np.testing.assert_array_equal(model.expected(STATED), reference)


@pytest.mark.parametrize("name", LEARNING)
def test_after_a_pause_the_first_innovations_are_the_navigators(name: str):
    """GIVEN an hour without observations WHEN ten come that disagree THEN R stays, and with the next ones it grows."""
    model = MODELS[name]()
    model.note(0.0, np.zeros(1), np.zeros(1), np.zeros((1, 1)), np.eye(1))

    def disagree(k: int) -> float:
        z = np.array([20.0 * (-1.0) ** k])
        model.covariance(z, np.zeros((1, 1)), np.eye(1))
        model.note(3600.0 + k, z, z, np.zeros((1, 1)), np.eye(1))
        return model.factor

    assert max(disagree(k) for k in range(9)) == 1.0
    assert max(disagree(k) for k in range(9, 30)) > 2.0


def test_fewer_rows_leave_the_others_alone():
    model = InnovationAdaptive()
    for k in range(100):
        z = np.array([1.0, 1.0, 9.0]) * (-1.0) ** k
        model.note(float(k), z, 0.0 * z, np.zeros((3, 3)), np.eye(3))
    known = model.expected(np.eye(3))[2, 2]
    model.note(100.0, np.zeros(2), np.zeros(2), np.zeros((2, 2)), np.eye(2))
    assert model.expected(np.eye(2)).shape == (2, 2)
    assert model.expected(np.eye(3))[2, 2] == known > 5.0


def test_enlarging_keeps_what_is_off_the_diagonal():
    stated = np.array([[4.0, 1.0], [1.0, 9.0]])
    np.testing.assert_array_equal(enlarged(stated, np.array([2.0, 1.0])), [[8.0, 1.0], [1.0, 9.0]])
