"""Training of the network of ``core.learning.conv_lstm`` with JAX and optax, on recorded flights.

There are two forms. ``velocity``: the inputs are f, w and the upward direction, the outputs the air velocity in b and
the logarithm of its variance; the loss is the squared error at first, then the likelihood. ``increments``, as in the
source: the inputs are f and w, the outputs dp, dtheta and dv of the second, with Huber losses, that of the attitude on
the logarithm of SO(3):

    L = rho(dp - dp*) + rho(Log(Exp(dtheta)' Exp(dtheta*))) + rho(dv - dv*)                                      (1)

each divided by the standard deviation of its kind. The wind of each flight is subtracted from velocities and dp,
because it would be learned otherwise.

Source: M. Feng et al. (see ``core.learning.conv_lstm``), steps 21 and 22.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.learning.conv_lstm import (
    DILATIONS,
    HIDDEN,
    KERNEL,
    MIXED,
    POOL,
    STEPS,
    ConvLstm,
    untrained,
)
from nav_pose_estimator.core.motion.airframe import VELOCITY
from nav_pose_estimator.errors import UserError

Array = NDArray[np.float64]

_BATCH, _RATE, _DECAY, _DROPOUT = 128, 2e-3, 1e-2, 0.1
_SQUARED = 0.3  # of the steps by squared error, before the variance is learned, too
_FORCE_BIAS, _RATE_BIAS, _TILT = 0.1, 0.01, 0.015  # m/s^2, rad/s, rad
_FORCE_NOISE, _RATE_NOISE = 0.05, 0.005  # m/s^2, rad/s
_LOG_VARIANCE = 8.0  # the logarithm stays within +- this, in squares of the deviation of the velocity
_SCALES = ("input_mean", "input_scale", "output_mean", "output_scale")


@dataclass(frozen=True)
class Examples:
    """``windows`` (N, STEPS, C), ``velocity`` (N, 3) through the air [m/s], ``increments`` (N, 9): in still air."""

    windows: NDArray[np.float32]
    velocity: NDArray[np.float32]
    increments: NDArray[np.float32]


@dataclass(frozen=True)
class Recipe:
    """``form`` of ``airframe.FORMS``; ``turned``: whether examples are rotated about the vertical body axis."""

    form: str = VELOCITY
    steps: int = 2500
    turned: bool = False
    seed: int = 0


def check_available() -> None:
    """Raise ``UserError``, with the remedy, if JAX or optax is not installed."""
    try:
        import jax  # noqa: F401
        import optax  # noqa: F401
    except ImportError:
        raise UserError(
            "--network trains with JAX and optax, which are not installed here: run 'make train-setup', then "
            "'NAV_POSE_VENV=.venv-train tools/in_environment.sh python -m nav_pose_estimator train ...'"
        ) from None


def train(examples: Examples, recipe: Recipe, progress: Callable[[int], Any] = lambda _: None) -> ConvLstm:
    """Train a network, reproducible by its seed. ``progress`` receives the number of steps just completed."""
    import jax
    import optax

    random = np.random.default_rng(recipe.seed)
    start = untrained(_scales(examples, recipe), recipe.seed).state()
    scales = {name: start.pop(name) for name in _SCALES}
    optimiser = optax.adamw(optax.cosine_decay_schedule(_RATE, recipe.steps), weight_decay=_DECAY)
    state = optimiser.init(start)

    def loss(weights: Any, batch: Any, keep: Any, share: Any) -> Any:
        output = forward(weights | scales, batch[0], keep)
        if recipe.form == VELOCITY:
            return _likelihood(output, batch[1], scales, share)
        return _huber_increments(output, batch[1], scales)

    @jax.jit
    def step(weights: Any, state: Any, batch: Any, keep: Any, share: Any) -> Any:
        gradient = jax.grad(loss)(weights, batch, keep, share)
        updates, state = optimiser.update(gradient, state, weights)
        return optax.apply_updates(weights, updates), state

    weights = start
    for i in range(recipe.steps):
        batch = _batch(examples, recipe, random)
        keep = (random.random((_BATCH, MIXED)) > _DROPOUT).astype(np.float32) / (1.0 - _DROPOUT)
        weights, state = step(weights, state, batch, keep, np.float32(i >= _SQUARED * recipe.steps))
        progress(1)
    trained = {name: np.asarray(value) for name, value in weights.items()} | scales
    if not all(np.isfinite(value).all() for value in trained.values()):
        raise UserError("the training diverged: the recordings hold values that no vehicle has")
    return ConvLstm.from_state(trained)


def forward(weights: Any, windows: Any, keep: Any = None) -> Any:
    """``ConvLstm.predict`` of a batch (B, STEPS, C) in JAX, differentiable; ``keep`` (B, MIXED) drops features."""
    import jax.numpy as jnp

    z = (windows - weights["input_mean"]) / weights["input_scale"]
    reach = (KERNEL - 1) * DILATIONS[-1]
    padded = jnp.pad(z, ((0, 0), (reach, 0), (0, 0)))
    seen = []
    for i, dilation in enumerate(DILATIONS):
        shifted = [padded[:, reach - k * dilation : reach - k * dilation + STEPS] for k in range(KERNEL)]
        seen.append(jnp.concatenate(shifted, axis=2) @ weights["conv_weight"][i] + weights["conv_bias"][i])
    features = jnp.maximum(jnp.concatenate(seen, axis=2), 0.0)
    mixed = jnp.maximum(features @ weights["mix_weight"] + weights["mix_bias"], 0.0)
    pooled = mixed.reshape(len(windows), -1, POOL, MIXED).mean(axis=2)
    if keep is not None:
        pooled = pooled * keep[:, None]
    h = c = jnp.zeros((len(windows), HIDDEN))
    for i in range(pooled.shape[1]):
        h, c = _lstm_step(weights, pooled[:, i], h, c)
    y = h @ weights["head_weight"] + weights["head_bias"] + z.mean(axis=1) @ weights["linear"]
    return weights["output_mean"] + weights["output_scale"] * y


def _lstm_step(weights: Any, x: Any, h: Any, c: Any) -> tuple[Any, Any]:
    import jax
    import jax.numpy as jnp

    gates = x @ weights["lstm_input"] + h @ weights["lstm_hidden"] + weights["lstm_bias"]
    entered, kept, shown = jnp.split(jax.nn.sigmoid(gates[:, : 3 * HIDDEN]), 3, axis=1)
    c = kept * c + entered * jnp.tanh(gates[:, 3 * HIDDEN :])
    return shown * jnp.tanh(c), c


def _likelihood(output: Any, velocity: Any, scales: Any, share: Any) -> Any:
    """Mean squared error for ``share`` 0, negative logarithm of a normal density for 1, velocities in deviations."""
    import jax.numpy as jnp

    square = ((output[:, :3] - velocity) / scales["output_scale"][:3]) ** 2
    log_variance = jnp.clip(output[:, 3:] - 2.0 * jnp.log(scales["output_scale"][:3]), -_LOG_VARIANCE, _LOG_VARIANCE)
    density = 0.5 * (square * jnp.exp(-log_variance) + log_variance)
    return jnp.mean((1.0 - share) * square + share * density)


def _huber_increments(output: Any, truth: Any, scales: Any) -> Any:
    """Eq. (1)."""
    import jax.numpy as jnp
    import optax

    sd = scales["output_scale"]
    wrong = jnp.einsum("nji,njk->nik", _rotation(output[:, 3:6]), _rotation(truth[:, 3:6]))
    left = jnp.concatenate([output[:, :3] - truth[:, :3], logarithm(wrong), output[:, 6:] - truth[:, 6:]], axis=1)
    return jnp.mean(optax.huber_loss(left / sd))


def _rotation(vector: Any) -> Any:
    """Exp of rotation vectors (N, 3), (N, 3, 3): I + sin(a)/a K + (1 - cos(a))/a^2 K^2, smooth at zero."""
    import jax.numpy as jnp

    angle = jnp.sqrt((vector**2).sum(axis=1) + 1e-12)[:, None, None]
    x, y, z = vector.T
    zero = jnp.zeros_like(x)
    K = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    return jnp.eye(3) + jnp.sin(angle) / angle * K + (1.0 - jnp.cos(angle)) / angle**2 * (K @ K)


def logarithm(C: Any) -> Any:
    """Log of rotation matrices (N, 3, 3) as rotation vectors (N, 3), for less than half a turn."""
    import jax.numpy as jnp

    axis = 0.5 * jnp.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], axis=1)
    sine = jnp.sqrt((axis**2).sum(axis=1) + 1e-12)
    angle = jnp.arctan2(sine, 0.5 * (jnp.trace(C, axis1=1, axis2=2) - 1.0))
    return axis * (angle / sine)[:, None]


def _scales(examples: Examples, recipe: Recipe) -> dict[str, Array]:
    """Means and standard deviations of inputs and outputs."""
    windows = _inputs(examples.windows, recipe)
    flat = windows.reshape(-1, windows.shape[2]).astype(float)
    target = examples.velocity if recipe.form == VELOCITY else examples.increments
    mean, sd = target.mean(axis=0, dtype=float), np.maximum(target.std(axis=0, dtype=float), 1e-3)
    if recipe.form == VELOCITY:
        mean, sd = np.append(mean, 2.0 * np.log(sd)), np.append(sd, np.ones(3))
    return {
        "input_mean": flat.mean(axis=0),
        "input_scale": np.maximum(flat.std(axis=0), 1e-3),
        "output_mean": mean,
        "output_scale": sd,
    }


def _inputs(windows: NDArray[np.float32], recipe: Recipe) -> NDArray[np.float32]:
    return windows if recipe.form == VELOCITY else windows[:, :, :6]


def _batch(examples: Examples, recipe: Recipe, random: np.random.Generator) -> tuple[Any, Any]:
    """A random batch, with random errors of IMU and attitude."""
    chosen = random.integers(0, len(examples.windows), _BATCH)
    x = examples.windows[chosen].astype(np.float32)
    y = (examples.velocity if recipe.form == VELOCITY else examples.increments)[chosen].astype(np.float32)
    if recipe.turned:
        x, y = _turned(x, random_turn := random.uniform(-np.pi, np.pi, _BATCH)), _turned(y, random_turn)
    sd = np.repeat([_FORCE_BIAS, _RATE_BIAS, _TILT], 3)
    x = x + sd * random.standard_normal((_BATCH, 1, 9))
    x[:, :, :6] += np.repeat([_FORCE_NOISE, _RATE_NOISE], 3) * random.standard_normal((_BATCH, STEPS, 6))
    return _inputs(x.astype(np.float32), recipe), y


def _turned(values: Any, angle: Array) -> Any:
    """Vectors in the last axis, rotated about body z by ``angle`` (B,), because a multirotor has no preferred side."""
    shape = (-1,) + (1,) * (values.ndim - 2)
    c, s = np.cos(angle).reshape(shape), np.sin(angle).reshape(shape)
    turned = values.copy()
    for i in range(0, values.shape[-1], 3):
        x, y = values[..., i], values[..., i + 1]
        turned[..., i], turned[..., i + 1] = c * x - s * y, s * x + c * y
    return turned


def with_progress(what: str, examples: Examples, recipe: Recipe) -> ConvLstm:
    """``train`` with a progress bar."""
    from tqdm import tqdm

    with tqdm(total=recipe.steps, unit=" step", desc=what, disable=not sys.stderr.isatty()) as bar:
        return train(examples, recipe, bar.update)
