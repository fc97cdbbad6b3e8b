"""The network as a user sees it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nav_pose_estimator import Anfis
from nav_pose_estimator.core.learning.hybrid_learning import ridge_least_squares
from nav_pose_estimator.errors import UserError


def product_of_sines(samples: int, noise: float = 0.0, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    x = random.uniform(-3.0, 3.0, (samples, 2)) * [1.0, 100.0] + [0.0, 5000.0]
    y = np.stack([np.sin(x[:, 0]) * np.cos(x[:, 1] / 100.0), 1000.0 + 50.0 * x[:, 0] ** 2], axis=1)
    return x, y + noise * y.std(axis=0) * random.normal(size=y.shape)


def relative_error(model: Anfis, x: np.ndarray, y: np.ndarray) -> float:
    return float(np.sqrt(np.mean(((model.predict(x) - y) / y.std(axis=0)) ** 2)))


@pytest.fixture(scope="module")
def trained() -> Anfis:
    return Anfis(9).fit(*product_of_sines(400))


@pytest.mark.parametrize("partition", ["auto", "grid", "fcm", "subtractive"])
def test_learns_a_smooth_map_in_physical_units(partition):
    model = Anfis(9, partition=partition).fit(*product_of_sines(400))
    assert relative_error(model, *product_of_sines(400, seed=2)) < 0.03


def mackey_glass(interpolate: bool) -> tuple[np.ndarray, np.ndarray]:
    """1000 samples x(t-18), x(t-12), x(t-6), x(t) -> x(t+6) from t = 118 on; RK4, step 0.1, x(0) = 1.2, delay 17.

    Within a step the delayed value is interpolated, or held as in the classic generator.
    """
    x = np.zeros(12171)
    x[170] = 1.2
    for k in range(170, 12170):
        a = x[k - 170]
        c = x[k - 169] if interpolate else a
        drive = [0.2 * v / (1.0 + v**10) for v in (a, 0.5 * (a + c), c)]
        k1 = drive[0] - 0.1 * x[k]
        k2 = drive[1] - 0.1 * (x[k] + 0.05 * k1)
        k3 = drive[1] - 0.1 * (x[k] + 0.05 * k2)
        k4 = drive[2] - 0.1 * (x[k] + 0.1 * k3)
        x[k + 1] = x[k] + 0.1 / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    x, t = x[170::10], np.arange(118, 1118)
    return np.column_stack([x[t - 18], x[t - 12], x[t - 6], x[t]]), x[t + 6][:, None]


@pytest.mark.parametrize("interpolate", [False, True])
def test_mackey_glass_with_sixteen_rules(interpolate):
    x, y = mackey_glass(interpolate)
    model = Anfis(rules=16).fit(x[:500], y[:500])
    error = np.square(model.predict(x) - y)
    assert np.sqrt(error[:500].mean()) < 0.0013
    assert np.sqrt(error[500:].mean()) < 0.0020


def test_premise_learning_pays():
    x, y = product_of_sines(400)
    fixed, learnt = (Anfis(4, iterations=n).fit(x, y) for n in (0, 50))
    assert learnt.curve.training[0] == pytest.approx(fixed.curve.training[0])
    assert learnt.curve.training[-1] < 0.5 * fixed.curve.training[0]


def test_swarm_learns_too():
    x, y = product_of_sines(150)
    model = Anfis(4, premise_optimizer="pso", iterations=15).fit(x, y)
    assert model.curve.training[-1] < 0.8 * model.curve.training[0]


def test_swarm_against_conjugate_gradient_and_ridge():
    """GIVEN the same start THEN both fit what they have not seen far better than ridge, the gradient in fewer steps."""
    x, y = product_of_sines(150)
    ridge = Anfis(1).fit(x, y)
    swarm = Anfis(6, premise_optimizer="pso", iterations=25).fit(x, y)
    gradient = Anfis(6, iterations=25).fit(x, y)
    assert swarm.curve.training[0] == gradient.curve.training[0]
    other = product_of_sines(400, seed=2)
    errors = [relative_error(model, *other) for model in (gradient, swarm, ridge)]
    assert errors[0] < errors[1] < 0.5 * errors[2]
    assert gradient.curve.evaluations < 0.1 * swarm.curve.evaluations


def test_swarm_is_the_same_for_the_same_seed():
    x, y = product_of_sines(100)
    first, again, other = (Anfis(4, premise_optimizer="pso", iterations=5, seed=s).fit(x, y) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.predict(x), again.predict(x))
    assert not np.array_equal(first.predict(x), other.predict(x))


def test_one_rule_is_ridge_regression():
    x, y = product_of_sines(100, noise=0.3)
    model = Anfis(1, ridge=0.01).fit(x, y)
    z, t = (x - x.mean(axis=0)) / x.std(axis=0), (y - y.mean(axis=0)) / y.std(axis=0)
    theta = ridge_least_squares(np.vstack([z.T, np.ones(100)]), t.T, 0.01)
    expected = y.mean(axis=0) + y.std(axis=0) * (np.column_stack([z, np.ones(100)]) @ theta)
    np.testing.assert_allclose(model.predict(x), expected, rtol=1e-12)
    assert model.curve.stopped == "one rule"


def test_same_data_same_model():
    x, y = product_of_sines(120)
    first, again = (Anfis(5, iterations=10).fit(x, y).predict(x) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_early_stopping_keeps_the_model_that_predicts_validation_best():
    x, y = product_of_sines(90, noise=0.5)
    x_val, y_val = product_of_sines(300, seed=3)
    model = Anfis(9, iterations=60, ridge=1e-8, prior=0.0).fit(x, y, x_val, y_val)
    curve = model.curve
    assert curve.best == int(np.argmin(curve.validation))
    assert curve.stopped == "validation"
    scaled = np.sqrt(np.mean(((model.predict(x_val) - y_val) / y.std(axis=0)) ** 2))
    assert scaled == pytest.approx(min(curve.validation), rel=1e-9)


def test_one_prediction_equals_the_batch(trained):
    x, _ = product_of_sines(50, seed=4)
    rows = np.array([trained.predict_one(row) for row in x])
    np.testing.assert_allclose(rows, trained.predict(x), rtol=1e-11)


@given(arrays(float, (3, 2), elements=st.floats(allow_nan=False, allow_infinity=False)))
def test_any_finite_input_gives_finite_numbers(trained, x):
    y, novelty = trained.predict(x), trained.novelty(x)
    assert np.isfinite(y).all()
    assert np.isfinite(novelty).all()
    np.testing.assert_allclose([trained.predict_one(row) for row in x], y, rtol=1e-9)


def test_no_consequent_extrapolates_without_limit(trained):
    far = trained.predict(np.array([[1e9, -1e9], [1e12, -1e12]]))
    np.testing.assert_array_equal(far[0], far[1])


@pytest.mark.parametrize("rules", [1, 9])
def test_novelty_grows_away_from_the_data(rules):
    x, y = product_of_sines(500)
    model = Anfis(rules).fit(x, y)
    score = model.novelty(x)
    assert np.median(score) == pytest.approx(0.0, abs=1e-9)
    assert np.mean(score > 1.0) == pytest.approx(0.01, abs=0.003)
    ray = x.mean(axis=0) + np.linspace(2.0, 40.0, 20)[:, None] * x.std(axis=0)
    assert (np.diff(model.novelty(ray)) > 0.0).all()
    assert model.novelty(ray)[-1] > 1.5


def test_constant_columns_are_ignored():
    x, y = product_of_sines(200)
    wide = np.column_stack([x[:, 0], np.full(200, 7.0), x[:, 1]])
    flat = np.column_stack([y, np.full(200, -3.0)])
    model = Anfis(4, partition="fcm", iterations=5).fit(wide, flat)
    moved = wide + np.array([0.0, 1e5, 0.0])
    np.testing.assert_array_equal(model.predict(moved), model.predict(wide))
    np.testing.assert_allclose(model.predict(wide)[:, 2], -3.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("x", "y", "sentence"),
    [
        (np.ones((9, 2)), np.ones(9), r"Y must have the shape \(samples, columns\)"),
        (np.ones(9), np.ones((9, 1)), r"X must have the shape \(samples, columns\)"),
        (np.ones((9, 2)), np.ones((8, 1)), "X has 9 rows and Y has 8"),
        (np.ones((3, 2)), np.ones((3, 1)), "4 rules need at least 4 samples"),
        (np.ones((1, 2)), np.ones((1, 1)), "too few"),
        (np.zeros((0, 2)), np.zeros((0, 1)), "too few"),
        (np.zeros((9, 0)), np.zeros((9, 1)), r"X must have the shape"),
        ([["a", "b"]] * 9, np.ones((9, 1)), "X is not an array of numbers"),
        (np.full((9, 2), 1e300) * np.arange(9)[:, None], np.ones((9, 1)), "too large"),
        (None, np.ones((9, 1)), "belong together"),
    ],
)
def test_bad_samples_give_one_sentence(x, y, sentence):
    with pytest.raises(UserError, match=sentence):
        Anfis(4).fit(x, y)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_rows_that_are_not_finite_are_named(trained, bad):
    x, y = product_of_sines(50)
    x[[7, 9], 1] = bad
    for call in (lambda: Anfis(4).fit(x, y), lambda: trained.predict(x), lambda: trained.novelty(x)):
        with pytest.raises(UserError, match="X has 2 rows with values that are not finite, the first is row 7"):
            call()
    with pytest.raises(UserError, match="not finite"):
        trained.predict_one(x[7])


def test_validation_needs_both_parts_of_the_same_width():
    x, y = product_of_sines(50)
    with pytest.raises(UserError, match="X_val and Y_val belong together"):
        Anfis(4).fit(x, y, x)
    with pytest.raises(UserError, match="Y_val must have 2 columns, not 1"):
        Anfis(4).fit(x, y, x, y[:, :1])


def test_wrong_width_at_prediction(trained):
    with pytest.raises(UserError, match="X must have 2 columns, not 3"):
        trained.predict(np.ones((4, 3)))
    with pytest.raises(UserError, match="x must have the shape"):
        trained.predict_one(np.ones(3))


def test_untrained_model_says_so():
    for call in (lambda m: m.predict(np.ones((1, 2))), lambda m: m.novelty(np.ones((1, 2))), lambda m: m.state()):
        with pytest.raises(UserError, match="not trained"):
            call(Anfis())
    with pytest.raises(UserError, match="not trained"):
        Anfis().predict_one(np.ones(2))


@pytest.mark.parametrize(
    "option",
    [
        {"rules": 0},
        {"rules": 2.5},
        {"rules": True},
        {"partition": "kmeans"},
        {"premise_optimizer": "adam"},
        {"ridge": 0.0},
        {"ridge": np.nan},
        {"prior": -1.0},
        {"slope": 0.5},
        {"clip": np.inf},
        {"seed": -1},
    ],
    ids=str,
)
def test_bad_options_are_named(option):
    with pytest.raises(UserError, match=next(iter(option))):
        Anfis(**option)


def test_grid_needs_a_power():
    with pytest.raises(UserError, match=r"needs k\^2 rules; 5 is not such a power"):
        Anfis(5, partition="grid").fit(*product_of_sines(50))
