"""The network of convolutions and LSTM in numpy: what JAX computes, and no array that does not fit."""

from importlib.util import find_spec

import numpy as np
import pytest

from formula_network import formula_network, formula_window
from nav_pose_estimator.core.learning.conv_lstm import ConvLstm, shapes, untrained
from nav_pose_estimator.errors import UserError

BY_JAX = [-0.389126151, -0.147584573, 0.033548849, 0.134212884, 0.176023801, 0.200916487]
"""What ``offline.training.network.forward`` says of the formula network and window, in double precision."""


def test_the_output_is_what_jax_has_computed() -> None:
    np.testing.assert_allclose(formula_network().predict(formula_window()), BY_JAX, atol=1e-6)


@pytest.mark.skipif(find_spec("jax") is None, reason="JAX is not installed here (make train-setup)")
@pytest.mark.parametrize(("channels", "outputs"), [(9, 6), (6, 9)])
def test_numpy_and_jax_agree(channels: int, outputs: int) -> None:
    """GIVEN windows by chance WHEN both compute THEN they differ by less than 1e-6."""
    import jax

    from nav_pose_estimator.offline.training.network import forward

    network = formula_network(channels, outputs)
    windows = np.random.default_rng(3).normal(size=(20, 50, channels))
    with jax.enable_x64(True):
        by_jax = np.asarray(forward({name: value.astype(float) for name, value in network.state().items()}, windows))
    np.testing.assert_allclose([network.predict(one) for one in windows], by_jax, atol=1e-6)


def test_the_newest_sample_counts_and_what_came_before_the_window_does_not() -> None:
    network, window = formula_network(), formula_window()
    changed = window.copy()
    changed[-1] += 1.0
    assert np.abs(network.predict(changed) - network.predict(window)).max() > 1e-3


def test_a_network_is_the_same_after_a_trip_through_arrays() -> None:
    network = formula_network()
    again = ConvLstm.from_state(network.state())
    np.testing.assert_array_equal(again.predict(formula_window()), network.predict(formula_window()))


SPOILT = {
    "input_mean": np.zeros(8, np.float32),
    "conv_weight": np.zeros((4, 27, 15), np.float32),
    "head_bias": np.full(6, np.nan, np.float32),
    "mix_bias": np.full(32, 1e30, np.float32),
    "lstm_bias": np.zeros(128, np.int32),
    "input_scale": np.zeros(9, np.float32),
    "linear": None,
}


@pytest.mark.parametrize("name", SPOILT)
def test_weights_that_do_not_fit_are_refused(name: str) -> None:
    arrays = formula_network().state()
    if SPOILT[name] is None:
        del arrays[name]
    else:
        arrays[name] = SPOILT[name]
    with pytest.raises(UserError, match="network"):
        ConvLstm.from_state(arrays)


def test_the_control_is_the_same_each_time_and_of_the_same_shape() -> None:
    scales = {
        name: getattr(formula_network(), name) for name in ("input_mean", "input_scale", "output_mean", "output_scale")
    }
    one, other = untrained(scales, 1), untrained(scales, 1)
    assert {name: value.shape for name, value in one.state().items()} == shapes(9, 6)
    np.testing.assert_array_equal(one.predict(formula_window()), other.predict(formula_window()))
    assert np.abs(one.predict(formula_window()) - untrained(scales, 2).predict(formula_window())).max() > 1e-3
