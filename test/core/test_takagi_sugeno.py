"""The layers against their definitions and against finite differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nav_pose_estimator.core.learning.takagi_sugeno import (
    Premises,
    log_firing,
    normalise_firing,
    outputs,
    pack,
    predict_row,
)

N_INPUTS, RULES, OUTPUTS, SAMPLES = 3, 4, 2, 50


@pytest.fixture
def premises() -> Premises:
    random = np.random.default_rng(1)
    shape = (N_INPUTS, RULES)
    return Premises(random.normal(size=shape), random.uniform(0.5, 2.0, shape), random.uniform(0.8, 3.0, shape))


@pytest.fixture
def inputs() -> np.ndarray:
    return np.random.default_rng(2).normal(size=(N_INPUTS, SAMPLES))


@pytest.fixture
def consequents() -> np.ndarray:
    return np.random.default_rng(3).normal(size=(RULES * (N_INPUTS + 1), OUTPUTS))


def test_layers_match_their_definitions(premises, inputs, consequents):
    u = np.abs((inputs[:, None] - premises.centre[:, :, None]) / premises.width[:, :, None])
    mu = 1.0 / (1.0 + u ** (2.0 * premises.slope[:, :, None]))
    w = mu.prod(axis=0)
    wn = w / w.sum(axis=0)
    h = np.einsum("ijo,jk->oik", consequents.reshape(RULES, -1, OUTPUTS), np.vstack([inputs, np.ones(SAMPLES)]))
    np.testing.assert_allclose(log_memberships(premises, inputs), np.log(mu), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(log_firing(premises, inputs), np.log(w), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(outputs(premises, consequents, inputs), (wn * h).sum(axis=1), rtol=1e-11)


def test_vector_and_back(premises):
    again = premises.with_vector(premises.vector())
    for name in ("centre", "width", "slope"):
        np.testing.assert_allclose(getattr(again, name), getattr(premises, name), rtol=1e-14)


def test_slopes_of_the_bells_match_central_differences(premises, inputs):
    slopes = slopes_of(premises, inputs)
    vector, step = premises.vector(), 1e-6
    for index in range(len(vector)):
        change = np.zeros_like(vector)
        change[index] = step
        above = log_memberships(premises.with_vector(vector + change), inputs)
        below = log_memberships(premises.with_vector(vector - change), inputs)
        kind, bell = divmod(index, N_INPUTS * RULES)
        numeric = ((above - below) / (2.0 * step)).reshape(-1, SAMPLES)[bell]
        np.testing.assert_allclose(slopes[kind].reshape(-1, SAMPLES)[bell], numeric, atol=1e-8, rtol=1e-7)


def test_slope_by_the_centre_is_zero_at_the_centre(premises):
    inputs = premises.centre[:, :1].copy()
    slopes = slopes_of(premises, inputs)
    assert np.isfinite(slopes).all()
    np.testing.assert_array_equal(slopes[0, :, 0, 0], 0.0)


def log_memberships(premises: Premises, inputs: np.ndarray) -> np.ndarray:
    """ln mu (n, R, N): the firing strengths of networks with one input each."""
    one_input = [Premises(*(part[j : j + 1] for part in vars(premises).values())) for j in range(len(inputs))]
    return np.stack([log_firing(one, inputs[j : j + 1]) for j, one in enumerate(one_input)])


def slopes_of(premises: Premises, inputs: np.ndarray) -> np.ndarray:
    slopes = np.empty((3, *premises.centre.shape, inputs.shape[1]))
    np.testing.assert_array_equal(log_firing(premises, inputs, slopes), log_firing(premises, inputs))
    return slopes * premises.scales[..., None]


def test_hundred_memberships_do_not_underflow():
    shape = (100, 2)
    premises = Premises(np.zeros(shape), np.full(shape, 0.05), np.full(shape, 5.0))
    premises.centre[:, 1] = 0.5
    inputs = np.full((100, 1), 3.9)
    assert np.exp(log_firing(premises, inputs)).max() == 0.0  # the plain product is lost
    np.testing.assert_allclose(normalise_firing(log_firing(premises, inputs))[:, 0], [0.0, 1.0], atol=1e-12)


@given(arrays(float, (N_INPUTS, 7), elements=st.floats(-1e6, 1e6)))
def test_normalised_firing_sums_to_one(inputs):
    random = np.random.default_rng(5)
    shape = (N_INPUTS, RULES)
    premises = Premises(random.normal(size=shape), random.uniform(0.05, 50.0, shape), random.uniform(0.51, 9.0, shape))
    firing = normalise_firing(log_firing(premises, inputs))
    assert (firing >= 0.0).all()
    np.testing.assert_allclose(firing.sum(axis=0), 1.0, rtol=1e-12)


@given(arrays(float, N_INPUTS, elements=st.floats(-1e9, 1e9)))
def test_one_row_equals_the_layers(x):
    random = np.random.default_rng(7)
    shape = (N_INPUTS, RULES)
    premises = Premises(random.normal(size=shape), random.uniform(0.01, 20.0, shape), random.uniform(0.51, 20.0, shape))
    consequents = random.normal(size=(RULES * (N_INPUTS + 1), OUTPUTS))
    mean, gain = random.normal(size=N_INPUTS), np.array([2.0, 0.5, 0.0])
    out_mean, out_scale = random.normal(size=OUTPUTS), np.array([3.0, 0.1])
    y = np.empty(OUTPUTS)
    assert predict_row(pack(premises, consequents, 4.0, mean, gain, out_mean, out_scale), x, y)
    z = np.clip((x - mean) * gain, -4.0, 4.0)[:, None]
    expected = out_mean + out_scale * outputs(premises, consequents, z)[:, 0]
    np.testing.assert_allclose(y, expected, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_row_refuses_what_is_not_finite(premises, consequents, bad):
    packed = pack(premises, consequents, 4.0, np.zeros(3), np.ones(3), np.zeros(2), np.ones(2))
    assert not predict_row(packed, np.array([0.0, bad, 0.0]), np.empty(2))
