"""Least squares, the reduced objective and the conjugate gradient: each against what it must equal."""

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.optimize import minimize

from nav_pose_estimator.core.learning.conjugate_gradient import Iterate, Point, fletcher_reeves, strong_wolfe
from nav_pose_estimator.core.learning.hybrid_learning import (
    ReducedObjective,
    Validation,
    choose_ridge,
    learn_premises,
    ridge_least_squares,
    whitening,
)
from nav_pose_estimator.core.learning.takagi_sugeno import Premises, outputs


def problem(seed: int) -> ReducedObjective:
    """Two noisy functions of three inputs and five rules at random places."""
    random = np.random.default_rng(seed)
    inputs = random.normal(size=(3, 170))
    targets = np.stack([np.sin(2.0 * inputs[0]) + inputs[1] ** 2, np.tanh(inputs[1] * inputs[2])])
    shape = (3, 5)
    premises = Premises(random.normal(size=shape), random.uniform(0.8, 2.0, shape), random.uniform(0.9, 2.5, shape))
    return ReducedObjective(premises, inputs, targets + 0.05 * random.normal(size=targets.shape), 1e-3, 1e-2)


@pytest.fixture
def objective() -> ReducedObjective:
    return problem(11)


def rosenbrock(x: np.ndarray) -> tuple[float, np.ndarray]:
    a, b = x[1:] - x[:-1] ** 2, 1.0 - x[:-1]
    gradient = np.zeros_like(x)
    gradient[:-1] = -400.0 * x[:-1] * a - 2.0 * b
    gradient[1:] += 200.0 * a
    return float(100.0 * a @ a + b @ b), gradient


# --- least squares


def test_ridge_equals_the_augmented_least_squares():
    random = np.random.default_rng(1)
    design, targets = random.normal(size=(6, 40)), random.normal(size=(2, 40))
    wide = np.vstack([design.T, np.sqrt(40 * 1e-2) * np.eye(6)])
    expected = np.linalg.lstsq(wide, np.vstack([targets.T, np.zeros((6, 2))]), rcond=None)[0]
    np.testing.assert_allclose(ridge_least_squares(design, targets, 1e-2), expected, rtol=1e-10)


def test_singular_normal_equations_get_jitter():
    row = np.random.default_rng(2).normal(size=(1, 30))
    gram = np.vstack([row, row]) @ np.vstack([row, row]).T - 1e-12 * np.eye(2)
    white, jitter = whitening(gram)
    assert jitter > 0.0
    lower = np.linalg.inv(white)
    np.testing.assert_allclose(lower @ lower.T, gram, rtol=1e-6)
    assert whitening(np.eye(3))[1] == 0.0


def test_a_matrix_that_is_not_finite_is_an_error_and_no_endless_search_for_jitter():
    with pytest.raises(ValueError, match="not finite"):
        whitening(np.array([[1.0, 0.0], [0.0, np.nan]]))


def test_chosen_ridge_grows_with_noise():
    random = np.random.default_rng(5)
    design = random.normal(size=(40, 80))
    clean = (random.normal(size=(1, 40)) @ design) / 6.0
    ridges = [choose_ridge(design, clean + noise * random.normal(size=(1, 80))) for noise in (1e-4, 0.3, 3.0)]
    assert ridges == sorted(ridges)
    assert ridges[0] < ridges[-1]


# --- the reduced objective


def test_reduced_gradient_matches_central_differences(objective):
    random = np.random.default_rng(6)
    vector = objective.start + 0.1 * random.normal(size=len(objective.start))
    gradient, step = objective(vector)[1], 1e-5
    for index in range(len(vector)):
        change = np.zeros_like(vector)
        change[index] = step
        numeric = (objective(vector + change)[0] - objective(vector - change)[0]) / (2.0 * step)
        assert gradient[index] == pytest.approx(numeric, abs=1e-8)


def test_consequents_minimise_the_full_objective(objective):
    value, _ = objective(objective.start)
    best = objective.consequents(objective.start)

    def full(consequents: np.ndarray) -> float:
        residual = outputs(objective.premises, consequents, objective.inputs) - objective.targets
        return 0.5 * (np.sum(residual**2) / residual.shape[1] + objective.ridge * np.sum(consequents**2))

    assert full(best) == pytest.approx(value, rel=1e-12)
    random = np.random.default_rng(7)
    for _ in range(20):
        assert full(best + 1e-3 * random.normal(size=best.shape)) > value


def test_metric_is_the_damped_curvature_within_a_rule(objective):
    random = np.random.default_rng(8)
    solve = objective.metric(objective.start)
    metric = np.linalg.inv(np.array([solve(unit) for unit in np.eye(len(objective.start))]))
    damping = []
    for rule in range(objective.premises.rules):
        p = np.zeros((3, *objective.premises.centre.shape))
        p[:, :, rule] = random.normal(size=(3, 3))
        p = p.ravel()
        damping.append((p @ metric @ p - objective.curvature(objective.start, p)) / (p @ p))
    assert damping[0] > 0.0
    np.testing.assert_allclose(damping, damping[0], rtol=1e-6)


def test_gauss_newton_curvature_is_that_of_a_perfect_fit():
    """Where the residual is zero the Gauss-Newton matrix is the true second derivative."""
    random = np.random.default_rng(9)
    shape = (2, 3)
    premises = Premises(random.normal(size=shape), np.ones(shape), np.full(shape, 1.5))
    inputs, consequents = random.normal(size=(2, 150)), random.normal(size=(9, 1))
    exact = ReducedObjective(premises, inputs, outputs(premises, consequents, inputs), 1e-13, 0.0)
    p, step = random.normal(size=len(exact.start)), 1e-3
    values = [exact(exact.start + k * step * p)[0] for k in (-1, 0, 1)]
    numeric = (values[0] - 2.0 * values[1] + values[2]) / step**2
    assert exact.curvature(exact.start, p) == pytest.approx(numeric, rel=1e-3)


# --- conjugate gradient


def test_strong_wolfe_conditions_hold_for_any_first_trial():
    x = np.array([-1.2, 1.0, 0.3])
    value, gradient = rosenbrock(x)
    slope = -float(gradient @ gradient)
    for first in 10.0 ** np.arange(-8, 3):
        point = strong_wolfe(rosenbrock, Point(0.0, value, slope, x, gradient), -gradient, first, 1e-4, 0.4)
        assert point is not None
        assert point.value <= value + 1e-4 * point.step * slope
        assert abs(point.slope) <= 0.4 * abs(slope)


def test_line_search_steps_over_values_that_are_not_finite():
    def objective(x: np.ndarray) -> tuple[float, np.ndarray]:
        if x[0] > 2.0:
            return np.nan, np.full(1, np.nan)
        return float((x[0] - 1.5) ** 2), 2.0 * (x - 1.5)

    start = np.zeros(1)
    point = strong_wolfe(objective, Point(0.0, 2.25, -9.0, start, np.array([-3.0])), np.array([3.0]), 50.0, 1e-4, 0.4)
    assert point is not None
    assert abs(point.x[0] - 1.5) < 0.6


@pytest.mark.parametrize("with_metric", [False, True])
def test_every_direction_descends_and_every_step_lowers(objective, with_metric):
    extras = (objective.metric, objective.curvature) if with_metric else (None, None)
    iterates = list(itertools.islice(fletcher_reeves(objective, objective.start, *extras), 60))
    assert len(iterates) == 60
    assert all(iterate.slope < 0.0 for iterate in iterates)
    values = [objective(objective.start)[0]] + [iterate.value for iterate in iterates]
    assert all(after < before for before, after in itertools.pairwise(values))
    assert any(iterate.restarted == "" for iterate in iterates)


def test_quadratic_ends_in_as_many_steps_as_dimensions():
    random = np.random.default_rng(10)
    root = random.normal(size=(6, 6))
    matrix, target = root @ root.T + np.eye(6), random.normal(size=6)

    def quadratic(x: np.ndarray) -> tuple[float, np.ndarray]:
        return float(0.5 * x @ matrix @ x - target @ x), matrix @ x - target

    # The exact curvature makes every line search exact: then the method is linear conjugate gradient.
    search = fletcher_reeves(quadratic, np.zeros(6), None, lambda x, p: float(p @ matrix @ p))
    iterates = list(itertools.islice(search, 6))
    np.testing.assert_allclose(iterates[-1].x, np.linalg.solve(matrix, target), atol=1e-8)
    assert [iterate.restarted for iterate in iterates] == ["start"] + [""] * (len(iterates) - 1)


def test_metric_is_a_change_of_coordinates():
    """With a constant metric the iterates are those of the plain method in the coordinates where it is the identity."""
    scale = np.array([1.0, 30.0])

    def plain(x: np.ndarray) -> tuple[float, np.ndarray]:
        return rosenbrock(x)

    def scaled(z: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = rosenbrock(z / scale)
        return value, gradient / scale

    start = np.array([-1.2, 1.0])
    with_metric = fletcher_reeves(plain, start, lambda x: lambda g: g / scale**2)
    in_coordinates = fletcher_reeves(scaled, start * scale, lambda x: lambda g: g)
    for a, b in itertools.islice(zip(with_metric, in_coordinates, strict=True), 12):
        np.testing.assert_allclose(a.x, b.x / scale, rtol=1e-7)


def test_restart_period_is_kept():
    iterates = itertools.islice(fletcher_reeves(rosenbrock, np.array([-1.2, 1.0]), powell=np.inf, period=3), 13)
    assert [iterate.restarted for iterate in iterates][3:7:3] == ["period", "period"]


def test_rosenbrock_is_solved():
    *_, last = itertools.islice(fletcher_reeves(rosenbrock, np.array([-1.2, 1.0, -0.5, 0.8])), 500)
    np.testing.assert_allclose(last.x, 1.0, atol=1e-4)


def test_search_ends_at_a_minimum():
    assert list(fletcher_reeves(rosenbrock, np.ones(3))) == []


def after(iterates: Iterator[Iterate], count: int) -> float:
    return [iterate.value for iterate in itertools.islice(iterates, count)][-1]


def test_beats_gradient_descent_and_lbfgs_in_equal_iterations():
    """On eight problems: below steepest descent on each, below L-BFGS on the geometric mean."""
    to_descent, to_lbfgs = [], []
    for seed in range(8):
        objective = problem(seed)
        start, extras = objective.start, (objective.metric, objective.curvature)
        ours = after(fletcher_reeves(objective, start, *extras), 20)
        to_descent.append(ours / after(fletcher_reeves(objective, start, period=1), 20))
        options = {"maxiter": 20, "ftol": 1e-15, "gtol": 1e-12}
        to_lbfgs.append(ours / minimize(objective, start, jac=True, method="L-BFGS-B", options=options).fun)
    assert max(to_descent) < 1.0
    assert np.exp(np.mean(np.log(to_lbfgs))) < 0.95


# --- when learning stops


class Script:
    """Stands in for the objective: the training and validation error of step k are given."""

    evaluations = jittered = 0
    ridge = prior = 1.0

    def __init__(self, training: list[float], validation: list[float], rules: int = 2) -> None:
        self.training, self.validation = training, validation
        self.start = np.zeros(3 * rules)
        self.premises = Premises(np.zeros((1, rules)), np.ones((1, rules)), np.ones((1, rules)))

    def rmse(self, vector: np.ndarray) -> float:
        return self.training[round(vector[0])]

    def consequents(self, vector: np.ndarray) -> np.ndarray:
        return np.array([vector[0]])

    def steps(self):
        for k in range(1, len(self.training)):
            yield np.full_like(self.start, float(k))


def learn(script: Script, patience: int = 3, iterations: int = 50, tolerance: float = 1e-3):
    class Held(Validation):
        def rmse(self, premises: Premises, consequents: np.ndarray) -> float:
            return script.validation[round(consequents[0])]

    held = Held(np.zeros((1, 1)), np.zeros((1, 1))) if script.validation else None
    return learn_premises(script, script.steps(), held, iterations=iterations, patience=patience, tolerance=tolerance)


def test_early_stopping_keeps_the_best_validation():
    script = Script([1.0, 0.8, 0.6, 0.4, 0.3, 0.2, 0.1], [1.0, 0.7, 0.5, 0.6, 0.7, 0.8, 0.1])
    _, consequents, curve = learn(script)
    assert (consequents[0], curve.best, curve.stopped) == (2.0, 2, "validation")
    assert curve.validation == (1.0, 0.7, 0.5, 0.6, 0.7, 0.8)


def test_start_is_kept_when_learning_only_harms():
    _, consequents, curve = learn(Script([1.0, 0.8, 0.6, 0.4], [0.5, 0.6, 0.7, 0.8]))
    assert (consequents[0], curve.best) == (0.0, 0)


def test_last_step_is_kept_without_validation():
    _, consequents, curve = learn(Script([1.0, 0.8, 0.6], []), iterations=2)
    assert (consequents[0], curve.stopped, curve.validation) == (2.0, "iterations", ())


def test_learning_ends_when_nothing_is_gained():
    _, _, curve = learn(Script([1.0, 0.5, 0.4999, 0.4998, 0.4997, 0.1], []))
    assert (curve.stopped, len(curve.training)) == ("converged", 5)


def test_one_rule_has_no_premises_to_learn():
    _, _, curve = learn(Script([1.0, 0.5], [], rules=1))
    assert (curve.stopped, curve.best) == ("one rule", 0)
