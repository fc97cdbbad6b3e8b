"""Inference of a convolutional-recurrent network (CNN-LSTM) in numpy: from one second of IMU data to the motion.

    z = (x - input_mean) / input_scale                                        x: (STEPS, C) at 50 Hz
    a_d = relu(sum_k z[t - k d] W_dk + b_d)        dilations d = 1, 2, 4, 8 of the same second                   (1)
    m = relu([a_1 a_2 a_4 a_8] M + b_m), its mean over POOL steps                                                (2)
    h = LSTM(m), its last state                                                                                  (3)
    y = output_mean + output_scale (h H + b_h + mean(z) L)        L: linear bypass                               (4)

The network is trained by ``offline.training``. Here it is data: 12 500 numbers in named arrays, checked before use.

Sources: M. Feng et al. (Chongqing University of Posts and Telecommunications), a method to keep positions precise in
complex surroundings, Chinese patent application published on 22 March 2024, steps 21 and 22 (pseudo-GNSS from dilated
convolutions and an LSTM); S. Hochreiter and J. Schmidhuber, "Long short-term memory", Neural Computation 9(8), 1997.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.errors import UserError

Array = NDArray[np.float64]

STEPS, POOL = 50, 5
DILATIONS, KERNEL = (1, 2, 4, 8), 3
FEATURES, MIXED, HIDDEN = 16, 32, 32
# sigmoid(x) = (1 + tanh(x / 2)) / 2: with these factors one call of tanh evaluates all four gates.
_HALVED = np.repeat([0.5, 0.5, 0.5, 1.0], HIDDEN)
_LARGEST_WEIGHT = 1e3  # weights beyond this limit are refused: no training produces them


@dataclass(frozen=True)
class ConvLstm:
    """Weights for C input channels and O outputs. Order of the LSTM's gates: input, forget, output, cell."""

    input_mean: Array  # (C,)
    input_scale: Array  # (C,)
    output_mean: Array  # (O,)
    output_scale: Array  # (O,)
    conv_weight: Array  # (4, KERNEL C, FEATURES), the newest sample's rows first
    conv_bias: Array  # (4, FEATURES)
    mix_weight: Array  # (4 FEATURES, MIXED)
    mix_bias: Array  # (MIXED,)
    lstm_input: Array  # (MIXED, 4 HIDDEN)
    lstm_hidden: Array  # (HIDDEN, 4 HIDDEN)
    lstm_bias: Array  # (4 HIDDEN,)
    head_weight: Array  # (HIDDEN, O)
    head_bias: Array  # (O,)
    linear: Array  # (C, O)

    @property
    def channels(self) -> int:
        """Number C of input channels."""
        return len(self.input_mean)

    @property
    def outputs(self) -> int:
        """Number O of outputs."""
        return len(self.output_mean)

    def predict(self, window: Array) -> Array:
        """Eq. (1) to (4) of one ``window`` (STEPS, C), the newest sample last: (O,) in physical units."""
        z = (window - self.input_mean) / self.input_scale
        reach = (KERNEL - 1) * DILATIONS[-1]
        padded = np.zeros((reach + STEPS, self.channels))
        padded[reach:] = z
        seen = np.empty((STEPS, len(DILATIONS) * FEATURES))
        for i, dilation in enumerate(DILATIONS):
            shifted = [padded[reach - k * dilation : reach - k * dilation + STEPS] for k in range(KERNEL)]
            seen[:, i * FEATURES : (i + 1) * FEATURES] = np.hstack(shifted) @ self.conv_weight[i] + self.conv_bias[i]
        np.maximum(seen, 0.0, out=seen)
        mixed = np.maximum(seen @ self.mix_weight + self.mix_bias, 0.0)
        h = self._last_state(mixed.reshape(-1, POOL, MIXED).mean(axis=1))
        y = h @ self.head_weight + self.head_bias + z.mean(axis=0) @ self.linear
        return np.asarray(self.output_mean + self.output_scale * y)

    def _last_state(self, steps: Array) -> Array:
        """Eq. (3), (N, MIXED) -> (HIDDEN,)."""
        driven, recurrent = (steps @ self.lstm_input + self.lstm_bias) * _HALVED, self.lstm_hidden * _HALVED
        h, c = np.zeros(HIDDEN), np.zeros(HIDDEN)
        for row in driven:
            gates = np.tanh(row + h @ recurrent)
            opened = 0.5 + 0.5 * gates[: 3 * HIDDEN]
            c = opened[HIDDEN : 2 * HIDDEN] * c + opened[:HIDDEN] * gates[3 * HIDDEN :]
            h = opened[2 * HIDDEN :] * np.tanh(c)
        return h

    def state(self) -> dict[str, np.ndarray]:
        """Named arrays for a file, in single precision: ``from_state`` gives the same network."""
        return {name: np.asarray(value, np.float32) for name, value in vars(self).items()}

    @classmethod
    def from_state(cls, state: Mapping[str, np.ndarray]) -> "ConvLstm":
        """The network of ``state()``; ``UserError`` where arrays are missing, of a wrong shape or implausible."""
        channels, outputs = (len(np.atleast_1d(state.get(name, ()))) for name in ("input_mean", "output_mean"))
        expected = shapes(channels, outputs)
        for name, shape in expected.items():
            if name not in state or np.shape(state[name]) != shape or state[name].dtype.kind != "f":
                raise UserError(f"this is not a network of convolutions and LSTM: {name} is missing or does not fit")
            if not (np.abs(state[name]) <= _LARGEST_WEIGHT).all():  # false for NaN
                raise UserError(f"the weights {name} of this network are implausibly large or not finite")
        if not (np.concatenate([state["input_scale"], state["output_scale"]]) > 0.0).all():
            raise UserError("the scales of this network are not positive")
        return cls(**{name: np.asarray(state[name], float) for name in expected})


def shapes(channels: int, outputs: int) -> dict[str, tuple[int, ...]]:
    """Shape of every array of a network."""
    views = len(DILATIONS)
    all_shapes = (
        *((channels,), (channels,), (outputs,), (outputs,)),
        *((views, KERNEL * channels, FEATURES), (views, FEATURES)),
        *((views * FEATURES, MIXED), (MIXED,)),
        *((MIXED, 4 * HIDDEN), (HIDDEN, 4 * HIDDEN), (4 * HIDDEN,)),
        *((HIDDEN, outputs), (outputs,), (channels, outputs)),
    )
    return dict(zip((item.name for item in fields(ConvLstm)), all_shapes, strict=True))


def untrained(scales: Mapping[str, Array], seed: int) -> ConvLstm:
    """Network with random weights (He, Glorot): the start of a training, and the control to compare a trained one with.

    ``scales``: input_mean, input_scale (C,), output_mean, output_scale (O,).
    """
    random = np.random.default_rng(seed)
    arrays = {}
    for name, shape in shapes(len(scales["input_mean"]), len(scales["output_mean"])).items():
        if name in scales:
            arrays[name] = np.asarray(scales[name], float)
        elif len(shape) == 1 or name == "conv_bias" or name == "linear":
            arrays[name] = np.zeros(shape)
        else:
            gain = 2.0 if name in ("conv_weight", "mix_weight") else 1.0
            arrays[name] = random.normal(0.0, np.sqrt(gain / shape[-2]), shape)
    arrays["lstm_bias"][HIDDEN : 2 * HIDDEN] = 1.0  # forget gate open at the start, so that the cell keeps its state
    # rounded as in a file, so that the same seed gives the same network as one that was stored and loaded
    return ConvLstm(**{name: np.asarray(np.float32(value), float) for name, value in arrays.items()})
