"""The regression model behind the learned outage methods: velocity through the air, predicted from the IMU.

Read literally, the source text trains the network on the filter's own position corrections. As long as GNSS is good
these are noise and teach the network nothing. What can be learned is how the vehicle moves. Rotor drag, lift and
sideslip tie the velocity through the air, resolved in the body frame, to specific force, angular rate and attitude; the
wind, resolved in the level frame, does not depend on the attitude:

    C' v = g(f, w, u) + C' (w_mean + w(t))        u: the upward direction resolved in b                          (1)

The network g is trained on half-second means of aided flight, the mean wind w_mean jointly with it by least squares.
The predicted error of the navigator's velocity is then v - C g - w, exactly the increment of the position error that
the source text asks for, and its coefficient on the navigator's own velocity is one by construction, not by training.

The wind does not move a vehicle on wheels: with w = 0 eq. (1) contains the non-holonomic constraint, which is learned
like everything else. The wind is left out where the vehicle never moves sideways or up.

What g does not explain is stated as noise:

- The residuals are cross-validated: each block of time is predicted by a model that was not trained on it.
- The part that persists in the level frame is the change of the wind w(t), a first-order Gauss-Markov process that the
  filter goes on to estimate in the outage.
- The rest counts with its spectral density at low frequency, because half-second residuals are not independent.
- A short flight determines g poorly: the variance of its coefficients, projected on the present inputs, is added.

Sources: CN113777645A, claim 3 (inputs, network, training); P. Martin and E. Salaun, "The true role of accelerometer
feedback in quadrotor control", ICRA 2010 (rotor drag); M. Khaghani and J. Skaloud, "Autonomous vehicle dynamic
model-based navigation for small UAVs", Navigation 63(3), 2016 (vehicle dynamics as a sensor).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.learning.anfis import Anfis
from nav_pose_estimator.core.motion.epochs import BODY_VELOCITY, FORCE, PERIOD, VELOCITY, attitude, inputs
from nav_pose_estimator.core.motion.prediction_error import LASTING, doubt, hover_noise, low_frequency_density
from nav_pose_estimator.core.motion.prior import ALONE, UNKNOWN_WIND, Blend, MotionPrior, in_raw_inputs
from nav_pose_estimator.core.motion.wind import Weigh, axis_weights, mean_wind, track, wind_spread
from nav_pose_estimator.errors import UserError

Array = NDArray[np.float64]
Fit = Callable[[Array], "tuple[Law, Array]"]
"""Fits a model: epochs (N, COLUMNS) -> the law g of eq. (1) and the mean wind (2,) [m/s], East and North."""

_BLOCKS = 4  # blocks of time of the cross-validation
_RIDGE = 1e-3  # ridge penalty on standardised coefficients, per epoch
_WIND_RIDGE = 1e-2  # the same on the wind; strong, as without turns it is not observable beside the own mean velocity
_ITERATIONS = 20  # of the conjugate gradient
_FLOOR = 0.05**2  # m^2/s^2: smallest variance of a mean over one second
_CLEARLY = 0.9  # more rules are used only where they reduce the squared error to less than this fraction
_SLIPS = 0.002  # largest mean square of sideways or vertical over forward speed on wheels: a mount 2.5 degrees off
_MOVING = 1.0  # m^2/s^2: least mean square of the forward speed for that test
_GUIDED_TIME = 60.0  # s: least flight for that test, as a multirotor, too, may fly straight on for a while


class Law(Protocol):
    """The interface of g in eq. (1): an ``Anfis`` network, or a law of physics."""

    @property
    def rules(self) -> int: ...
    def predict(self, X: Array, /) -> Array: ...
    def novelty(self, X: Array, /) -> Array: ...


@dataclass(frozen=True)
class AirVelocityModel:
    """A fitted law with the wind and the noise that turn its output into an observation.

    ``wind_mean`` (2,): mean wind of the training window, East and North [m/s]. ``wind`` (2,): its present change, with
    covariance ``wind_cov`` (2, 2) and stationary variance ``wind_spread`` [m^2/s^2]. ``noise``, ``hover_noise`` (3,):
    variance of the residual's mean over one second, body axes [m^2/s^2]. ``parameter_cov`` (10, 10), larger with more
    inputs: covariance of a linear law's coefficients for unit noise. ``errors``: number of rules -> cross-validated
    mean squared error [m^2/s^2], or a lower bound of it.
    """

    network: Law
    wind_mean: Array
    wind: Array
    wind_cov: Array
    wind_spread: float
    noise: Array
    hover_noise: Array
    parameter_cov: Array
    errors: Mapping[int, float]
    target_square: float  # m^2/s^2: mean square of the training target

    def predict(self, epoch: Array) -> tuple[Array, float]:
        """Air velocity in b (3,) [m/s] at one epoch (COLUMNS,), and the factor on its noise (``doubt``)."""
        x = inputs(epoch[None])
        return self.network.predict(x)[0], float(self.doubt(x)[0])

    def doubt(self, x: Array) -> Array:
        """Factor (N,) on the noise at inputs (N, n): for extrapolation, and for poorly determined coefficients."""
        return np.asarray(doubt(self.network.novelty(x), x, self.parameter_cov))

    @property
    def is_guided(self) -> bool:
        """Whether the vehicle is guided by the ground (non-holonomic): it moves along its x axis, unmoved by wind."""
        return self.wind_spread == 0.0

    @property
    def rules(self) -> int:
        """Number of rules of the network that was chosen."""
        return self.network.rules

    def follow(self, epoch: Array) -> "AirVelocityModel":
        """The model with its wind updated by one more aided epoch (COLUMNS,)."""
        residual = _residuals(epoch[None], self.network, self.wind_mean)
        wind, cov, _ = track(attitude(epoch[None]), residual, self.noise, self.wind_spread, self.wind, self.wind_cov)
        return replace(self, wind=wind, wind_cov=cov)

    def state(self) -> dict[str, np.ndarray]:
        """Named arrays for a file; the inverse of ``from_state``."""
        if not isinstance(self.network, Anfis):
            raise UserError(
                "a drag law, or what an airframe file says, is not a network of this flight: there is nothing to save"
            )
        arrays = {f"network.{name}": value for name, value in self.network.state().items()}
        for name in _ARRAYS:
            arrays[name] = np.array(getattr(self, name), float)
        rules = sorted(self.errors)
        return arrays | {"errors": np.array([[r, self.errors[r]] for r in rules], float).reshape(-1, 2)}

    @classmethod
    def from_state(cls, state: Mapping[str, np.ndarray], added: int = 0) -> "AirVelocityModel":
        """The model that ``state()`` stored; ``added``: number of inputs that the method adds.

        Raises ``UserError`` for damaged parts, ``KeyError`` for a missing one.
        """
        network = Anfis.from_state(
            {k.removeprefix("network."): v for k, v in state.items() if k.startswith("network.")}
        )
        parts = {name: np.array(state[name], float) for name in _ARRAYS}
        _check_parts(network, parts, state["errors"], _INPUTS + added)
        fields = {name: float(value) if value.ndim == 0 else value for name, value in parts.items()}
        return cls(network, errors={int(r): float(e) for r, e in state["errors"]}, **fields)  # type: ignore[arg-type]


_INPUTS, _OUTPUTS = 9, 3
_ARRAYS = {
    "wind_mean": (2,),
    "wind": (2,),
    "wind_cov": (2, 2),
    "wind_spread": (),
    "parameter_cov": (_INPUTS + 1, _INPUTS + 1),
    "noise": (3,),
    "hover_noise": (3,),
    "target_square": (),
}
"""Parts of a saved model with their shapes; that of ``parameter_cov`` grows with the inputs that a method adds."""


def _check_parts(network: Anfis, parts: Mapping[str, Array], errors: Array, count: int) -> None:
    """Raise ``UserError`` for parts of a saved model that do not fit together or that no training yields."""
    expected = _ARRAYS | {"parameter_cov": (count + 1, count + 1)}
    shapes = [parts[name].shape == shape for name, shape in expected.items()]
    scaling = network.network.scaling
    fits = len(scaling.in_mean) == count and len(scaling.out_mean) == _OUTPUTS
    table = np.ndim(errors) == 2 and np.shape(errors)[1] == 2 and network.rules in errors[:, 0]
    if not (all(shapes) and fits and table):
        raise UserError("the parts of this outage model do not fit together")
    finite = all(np.isfinite(value).all() for value in [*parts.values(), errors])
    positive = (parts["noise"] > 0.0).all() and (parts["hover_noise"] > 0.0).all()
    if not (finite and positive and np.linalg.eigvalsh(parts["wind_cov"])[0] >= -1e-9 and parts["wind_spread"] >= 0.0):
        raise UserError("this outage model has implausible values")


def learn_air_velocity(
    epochs: Array, rules: tuple[int, ...] = (1,), weigh: Weigh = axis_weights, prior: MotionPrior | None = None
) -> AirVelocityModel:
    """Fit eq. (1) to aided epochs (N, COLUMNS) in order of time, N at least 100, or 8 with a ``prior``.

    ``rules``: numbers of rules to try; any but the first has to have a clearly smaller cross-validated error.
    ``weigh``: weights of the body axes in the estimate of the wind. While a ``prior`` has weight, the law is linear.
    """
    seconds = 0.0 if prior is None else prior.seconds(epochs)
    windless = is_guided(epochs)
    if prior is not None and seconds > 0.0:
        windless = windless or prior.is_guided
        fits: dict[int, Fit] = {1: partial(prior.fit, seconds=seconds, windless=windless, weigh=weigh)}
    else:
        fits = {count: partial(_fit, rules=count, windless=windless, weigh=weigh) for count in rules}
    errors, residual, fit = _cross_validated(epochs, fits)
    network, wind = fit(epochs)
    model = _begun(network, wind, epochs, residual, errors, None if windless else weigh)
    if prior is None or seconds == 0.0:
        return _with_noise(replace(model, parameter_cov=_parameter_cov(epochs)), epochs, residual)
    return _with_prior(model, epochs, residual, prior)


def with_law(epochs: Array, law: Law, windless: bool = False, weigh: Weigh = axis_weights) -> AirVelocityModel:
    """A given ``law`` on a flight of ``epochs`` (N, COLUMNS or more): only the wind and the noise are estimated."""
    left, wind = _residuals(epochs, law, np.zeros(2)), np.zeros(2)
    if not windless:
        nothing = np.zeros((len(epochs), 1))  # the law is fixed: its inputs explain no part of the wind
        wind = mean_wind(attitude(epochs), left, nothing, np.eye(1), _WIND_RIDGE, weigh)
    residual = left - _in_body(epochs, wind)
    errors = {law.rules: float(np.square(residual).mean())}
    return _with_noise(_begun(law, wind, epochs, residual, errors, None if windless else weigh), epochs, residual)


def wind_along(model: AirVelocityModel, epochs: Array) -> Array:
    """The wind (N, 2) [m/s], East and North, at every epoch of a flight, tracked with the ``model`` of that flight."""
    seen = _residuals(epochs, model.network, model.wind_mean)
    unknown = model.wind_spread * np.eye(2)
    _, _, expected = track(attitude(epochs), seen, model.noise, model.wind_spread, np.zeros(2), unknown)
    return np.asarray(model.wind_mean + expected)


def _begun(
    law: Law, wind: Array, epochs: Array, unseen: Array, errors: Mapping[int, float], weigh: Weigh | None
) -> AirVelocityModel:
    """A model whose noise and coefficient covariance are still to be set; ``weigh`` None: a vehicle without wind."""
    size = inputs(epochs[:1]).shape[1] + 1
    return AirVelocityModel(
        network=law,
        wind_mean=wind,
        wind=np.zeros(2),
        wind_cov=np.zeros((2, 2)),
        wind_spread=0.0 if weigh is None else wind_spread(attitude(epochs), unseen, weigh),
        noise=np.ones(3),
        hover_noise=np.ones(3),
        parameter_cov=np.zeros((size, size)),
        errors=errors,
        target_square=float(np.square(epochs[:, BODY_VELOCITY:VELOCITY]).mean()),
    )


def _with_prior(model: AirVelocityModel, epochs: Array, unseen: Array, prior: MotionPrior) -> AirVelocityModel:
    """The model with noise, wind and coefficient covariance of flight and prior, each weighted by its seconds."""
    seconds = prior.seconds(epochs)
    share = seconds / (seconds + len(epochs) * PERIOD)
    spread = 0.0 if model.is_guided else share * prior.wind_spread + (1.0 - share) * model.wind_spread
    cov = in_raw_inputs(prior.parameter_cov(epochs, seconds))
    z = np.column_stack([inputs(epochs), np.ones(len(epochs))])
    blend = Blend(
        unknown_wind=0.0 if model.is_guided else UNKNOWN_WIND * seconds / prior.worth,
        doubt=1.0 + LASTING * float(np.einsum("ni,ij,nj->n", z, cov, z).mean()),
        noise=prior.noise,
        share=share,
    )
    model = _with_noise(replace(model, wind_spread=spread, parameter_cov=cov), epochs, unseen, blend)
    if model.is_guided:
        return model
    mean_cov = seconds / prior.worth * prior.wind_cov(epochs, seconds, model.noise)
    return replace(model, wind_cov=model.wind_cov + mean_cov)


class DragLaw:
    """Linear rotor drag, the classical baseline: air velocity along body x and y is ``-1 / D`` times specific force.

    ``gain`` (2,): 1 / D [s] along body x and y. The predicted vertical velocity is zero.
    """

    rules = 1

    def __init__(self, gain: Array) -> None:
        self.gain = gain

    def predict(self, x: Array) -> Array:
        """Inputs (N, 9) -> air velocity in b (N, 3)."""
        return np.column_stack([-self.gain * x[:, :2], np.zeros(len(x))])

    def novelty(self, x: Array) -> Array:
        """Zero (N,): a law of physics holds everywhere."""
        return np.zeros(len(x))


def learn_drag(epochs: Array) -> AirVelocityModel:
    """Fit drag coefficients and wind to aided epochs (N, COLUMNS) by least squares: eq. (1) without a network."""
    unseen = _unseen_residuals(epochs, _fit_drag)
    law, wind = _fit_drag(epochs)
    errors = {1: float(np.square(unseen[:, :2]).mean())}
    model = _begun(law, wind, epochs, unseen, errors, axis_weights)
    target = float(np.square(epochs[:, BODY_VELOCITY : BODY_VELOCITY + 2]).mean())
    return _with_noise(replace(model, target_square=target), epochs, unseen)


def _fit_drag(epochs: Array) -> tuple[DragLaw, Array]:
    """Eq. (1) along body x and y with g = -f / D: unknowns 1 / D (2) and the wind (2)."""
    directions = attitude(epochs)[:, :2].transpose(0, 2, 1)
    count = len(epochs)
    design = np.zeros((2 * count, 4))
    for axis in range(2):
        rows = slice(axis * count, (axis + 1) * count)
        design[rows, axis] = -epochs[:, FORCE + axis]
        design[rows, 2:] = directions[:, axis]
    target = epochs[:, BODY_VELOCITY : BODY_VELOCITY + 2].T.ravel()
    solution = np.linalg.solve(design.T @ design + _RIDGE * count * np.eye(4), design.T @ target)
    return DragLaw(solution[:2]), solution[2:]


def is_guided(epochs: Array) -> bool:
    """Whether the vehicle moves along its x axis only, neither sideways nor up; anything that flies does not."""
    if len(epochs) * PERIOD < _GUIDED_TIME:
        return False
    ahead, sideways, upwards = np.square(epochs[:, BODY_VELOCITY:VELOCITY]).mean(axis=0)
    return bool(ahead > _MOVING and max(sideways, upwards) < _SLIPS * ahead)


def _parameter_cov(epochs: Array) -> Array:
    """Covariance (n + 1, n + 1) of a linear law's coefficients of (inputs, 1), for unit noise of a one-second mean."""
    x = inputs(epochs)
    spread = x.std(axis=0)
    scale = 1.0 / np.where(spread > 1e-9, spread, 1.0)
    z = np.column_stack([(x - x.mean(axis=0)) * scale, np.ones(len(x))])
    cov = np.linalg.inv(PERIOD * (z.T @ z + _RIDGE * len(x) * np.eye(z.shape[1])))
    standardised = np.diag([*scale, 1.0])
    standardised[:-1, -1] = -scale * x.mean(axis=0)
    return standardised.T @ cov @ standardised


def _fit(epochs: Array, rules: int, windless: bool, weigh: Weigh) -> tuple[Anfis, Array]:
    """Network and mean wind (2,). The wind is that of the linear model, which is solved for both jointly."""
    wind = np.zeros(2) if windless else _joint_wind(epochs, weigh)
    target = epochs[:, BODY_VELOCITY:VELOCITY] - _in_body(epochs, wind)
    network = Anfis(rules=rules, ridge=_RIDGE, partition="fcm", iterations=_ITERATIONS)
    return network.fit(inputs(epochs), target), wind


def _joint_wind(epochs: Array, weigh: Weigh) -> Array:
    """The wind (2,) of eq. (1) with a linear g: ridge least squares over the consequents of three axes and the wind."""
    x = inputs(epochs)
    spread = x.std(axis=0)
    z = np.column_stack([(x - x.mean(axis=0)) / np.where(spread > 1e-9, spread, 1.0), np.ones(len(x))])
    ridge = _RIDGE * len(x) * np.diag([*np.ones(x.shape[1]), 1e-2])
    return mean_wind(attitude(epochs), epochs[:, BODY_VELOCITY:VELOCITY], z, ridge, _WIND_RIDGE, weigh)


def _in_body(epochs: Array, wind: Array) -> Array:
    """A horizontal vector (2,) of n resolved in b at every epoch, (N, 3)."""
    return np.einsum("nij,i->nj", attitude(epochs)[:, :2], wind)


def _residuals(epochs: Array, network: Law, wind: Array) -> Array:
    """Residuals (N, 3) of eq. (1) [m/s] in b."""
    return epochs[:, BODY_VELOCITY:VELOCITY] - network.predict(inputs(epochs)) - _in_body(epochs, wind)


def _cross_validated(epochs: Array, fits: Mapping[int, Fit]) -> tuple[dict[int, float], Array, Fit]:
    """Mean squared error of each number of rules, and residuals (N, 3) and fit of the number that is used.

    The blocks that one rule predicts worst come first, and a number of rules is given up as soon as it cannot be
    clearly better any more. Its error is then a lower bound.
    """
    (first, used), *others = fits.items()
    residual = _unseen_residuals(epochs, used)
    errors = {first: float(np.square(residual).mean())}
    least, order = _CLEARLY * errors[first], _worst_first(residual)
    for count, fit in others:
        other = _unseen_residuals(epochs, fit, order, least)
        errors[count] = float(np.square(other).mean())
        if errors[count] < least:
            least, residual, used = errors[count], other, fit
    return errors, residual, used


def _blocks_of(epochs: Array) -> list[NDArray[np.intp]]:
    return np.array_split(np.arange(len(epochs)), _BLOCKS)


def _worst_first(residual: Array) -> list[int]:
    """Numbers of the blocks in the order of falling residuals."""
    squares = [float(np.square(residual[block]).sum()) for block in _blocks_of(residual)]
    return sorted(range(_BLOCKS), key=squares.__getitem__, reverse=True)


def _unseen_residuals(epochs: Array, fit: Fit, order: Sequence[int] = range(_BLOCKS), most: float = np.inf) -> Array:
    """Residuals (N, 3) of each block by a fit to the others; zeros from where their mean square exceeds ``most``."""
    blocks, residual = _blocks_of(epochs), np.zeros((len(epochs), 3))
    for k in order:
        if np.square(residual).mean() >= most:
            break
        residual[blocks[k]] = _residuals(epochs[blocks[k]], *fit(epochs[np.concatenate(blocks[:k] + blocks[k + 1 :])]))
    return residual


def _with_noise(model: AirVelocityModel, epochs: Array, unseen: Array, blend: Blend = ALONE) -> AirVelocityModel:
    """The model with its present wind, and with the noise that remains when the wind is tracked."""
    seen = _residuals(epochs, model.network, model.wind_mean)
    density = blend.doubt * blend.of(np.maximum(low_frequency_density(unseen), _FLOOR))
    C = attitude(epochs)
    nothing, unknown = np.zeros(2), (model.wind_spread + blend.unknown_wind) * np.eye(2)
    wind, cov, expected = track(C, seen, density, model.wind_spread, nothing, unknown)
    white = seen - np.einsum("nij,ni->nj", C[:, :2], expected)
    optimism = np.maximum(np.square(unseen).mean(axis=0) / np.maximum(np.square(seen).mean(axis=0), 1e-9), 1.0)
    noise = blend.of(np.maximum(low_frequency_density(white) * optimism, _FLOOR))
    return replace(model, wind=wind, wind_cov=cov, noise=noise, hover_noise=hover_noise(epochs, unseen))
