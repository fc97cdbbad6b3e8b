"""Adaptive-network-based fuzzy inference system (ANFIS): a nonlinear regression small enough to train in flight.

    model = Anfis(rules=4).fit(X, Y, X_val, Y_val)
    model.predict(X)

The network is in ``takagi_sugeno``, its initial partition in ``partition``, its training in ``hybrid_learning``.
"""

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, fields
from numbers import Integral, Real
from typing import Any

import numpy as np

from nav_pose_estimator.core.learning import partition as partitions
from nav_pose_estimator.core.learning.hybrid_learning import (
    LearningCurve,
    ReducedObjective,
    Validation,
    frcg_steps,
    learn_premises,
    swarm_steps,
)
from nav_pose_estimator.core.learning.takagi_sugeno import (
    Premises,
    log_firing,
    outputs,
    pack,
    predict_row,
    predict_rows,
    strongest_firing,
)
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.errors import UserError

_FAR = 1e6  # standard deviations: inputs further away do not increase the novelty


@dataclass(frozen=True)
class Scaling:
    """Standardisation stored with the model: z = (x - in_mean) in_gain, clipped; y = out_mean + out_scale o.

    An input that was constant in training has gain 0 and is ignored.
    """

    in_mean: np.ndarray
    in_gain: np.ndarray
    out_mean: np.ndarray
    out_scale: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, y: np.ndarray) -> "Scaling":
        """From training samples ``x`` (N, n) and ``y`` (N, m)."""
        with np.errstate(over="ignore", invalid="ignore"):
            in_mean, in_sd, out_mean, out_sd = x.mean(axis=0), x.std(axis=0), y.mean(axis=0), y.std(axis=0)
        if not np.isfinite(np.concatenate([in_mean, in_sd, out_mean, out_sd])).all():
            raise UserError("the samples are too large for 64-bit floating point: rescale them")
        varies = in_sd > 1e-12 * np.abs(in_mean)
        gain = np.where(varies, 1.0 / np.where(varies, in_sd, 1.0), 0.0)
        return cls(in_mean, gain, out_mean, np.where(out_sd > 1e-12 * np.abs(out_mean), out_sd, 1.0))

    def inputs(self, x: np.ndarray, clip: float) -> np.ndarray:
        """Standardised and transposed: (N, n) -> (n, N)."""
        with np.errstate(over="ignore"):
            z = np.multiply(x - self.in_mean, self.in_gain, out=np.zeros_like(x), where=self.in_gain > 0.0)
        return np.ascontiguousarray(np.clip(z, -clip, clip).T)

    def targets(self, y: np.ndarray) -> np.ndarray:
        """Standardised and transposed: (N, m) -> (m, N)."""
        return np.ascontiguousarray(((y - self.out_mean) / self.out_scale).T)


@dataclass(frozen=True)
class Network:
    """A trained network: everything that a prediction needs. ``consequents`` (R (n + 1), m).

    ``familiar`` (2,): median and 1st percentile of ``strength`` over the training samples.
    """

    premises: Premises
    consequents: np.ndarray
    scaling: Scaling
    clip: float
    familiar: np.ndarray

    def predict(self, x: np.ndarray) -> np.ndarray:
        """(N, n) -> (N, m)."""
        y = outputs(self.premises, self.consequents, self.scaling.inputs(x, self.clip))
        return self.scaling.out_mean + self.scaling.out_scale * y.T

    def novelty(self, x: np.ndarray) -> np.ndarray:
        """(N, n) -> (N,), see ``Anfis.novelty``."""
        median, rare = self.familiar
        return (median - strength(self.premises, self.scaling, x)) / (median - rare)

    def packed(self) -> np.ndarray:
        """As one flat array for ``predict_row``."""
        return pack(self.premises, self.consequents, self.clip, *vars(self.scaling).values())


def strength(premises: Premises, scaling: Scaling, x: np.ndarray) -> np.ndarray:
    """Log firing strength per input of the strongest rule, (N, n) -> (N,): max_i ln(w_i) / n, of unclipped inputs."""
    return log_firing(premises, scaling.inputs(x, _FAR)).max(axis=0) / x.shape[1]


@dataclass
class Anfis:
    """First-order Takagi-Sugeno network with generalised bells, trained by hybrid learning.

    Parameters
    ----------
    rules : number of rules. One rule is ridge regression.
    partition : where the rules start: ``grid`` (k bells per input, needs k^n rules), ``fcm`` (fuzzy c-means),
        ``subtractive`` (clustering), ``auto``: a grid where the number of rules allows it, else fuzzy c-means.
    premise_optimizer : ``frcg`` (Fletcher-Reeves conjugate gradient) or ``pso`` (particle swarm, much slower).
    iterations : steps of the premise optimiser; 0 keeps the initial premises.
    patience, tolerance : learning ends after ``patience`` steps without a better validation error, or in which the
        training error fell by less than the fraction ``tolerance``.
    ridge, prior : weights rho on the consequents and kappa on the movement of the premises (``hybrid_learning`` eq. 1).
        None: chosen from the training data (``hybrid_learning.ReducedObjective``).
    slope, width : initial b of the bells, and their initial width as a multiple of the partition's.
    clip : standardised inputs are clipped to +-clip, which bounds the extrapolation.
    seed : of fuzzy c-means and of the swarm; the same data and seed give the same model.

    All errors are ``UserError`` with one sentence.
    """

    rules: int = 4
    _: KW_ONLY
    partition: str = "auto"
    premise_optimizer: str = "frcg"
    iterations: int = 60
    patience: int = 8
    tolerance: float = 1e-4
    ridge: float | None = None
    prior: float | None = None
    slope: float = 0.8
    width: float = 4.0
    clip: float = 4.0
    seed: int = 0
    curve: LearningCurve | None = field(default=None, init=False, repr=False, compare=False)
    """Learning curve of the last training."""

    def __post_init__(self) -> None:
        _check_options(self)
        self._network: Network | None = None
        self._packed = np.empty(0)
        self._sizes = (-1, -1)  # inputs, outputs

    @property
    def network(self) -> Network:
        """The trained network. ``UserError`` before training."""
        if self._network is None:
            raise UserError("the model is not trained yet: call fit first")
        return self._network

    @network.setter
    def network(self, network: Network) -> None:
        self._network, self._packed = network, network.packed()
        self._sizes = len(network.scaling.in_mean), len(network.scaling.out_mean)

    @property
    def trained(self) -> bool:
        return self._network is not None

    def fit(
        self, X: np.ndarray, Y: np.ndarray, X_val: np.ndarray | None = None, Y_val: np.ndarray | None = None
    ) -> "Anfis":
        """Train from scratch on ``X`` (N, n) and ``Y`` (N, m) in physical units; return self.

        With ``X_val`` (K, n) and ``Y_val`` (K, m) the premises that predict these best are kept. Take them from another
        period of time: neighbours of training samples do not reveal overfitting.
        """
        x, y = _samples(X, Y)
        if self.rules > len(x):
            raise UserError(f"{self.rules} rules need at least {self.rules} samples, not {len(x)}")
        scaling = Scaling.of(x, y)
        premises = self._partition(scaling.inputs(x, self.clip).T)
        return self._learn(premises, scaling, x, y, X_val, Y_val)

    def predict(self, X: np.ndarray) -> np.ndarray:
        """``X`` (N, n) -> (N, m), physical units. Where kernels are compiled one row costs microseconds."""
        if COMPILED and isinstance(X, np.ndarray) and X.dtype == np.float64 and X.shape[1:] == self._sizes[:1]:
            Y = np.empty((len(X), self._sizes[1]))
            if predict_rows(self._packed, np.array(X, order="C"), Y):
                return Y
        return self.network.predict(_matrix(X, "X", len(self.network.scaling.in_mean)))

    def predict_one(self, x: np.ndarray) -> np.ndarray:
        """One sample (n,) -> (m,): the same as a row of ``predict``."""
        x = np.array(x, float)
        if x.shape != self._sizes[:1]:
            raise UserError(f"x must have the shape {self.network.scaling.in_mean.shape}, not {x.shape}")
        y = np.empty(self._sizes[1])
        if not predict_row(self._packed, x, y):
            raise UserError("x has a value that is not finite")
        return y

    def novelty(self, X: np.ndarray) -> np.ndarray:
        """Distance of samples (N, n) from the training data, (N,): 0 at their median, 1 at their rarest 1 %.

        Above 1 the network extrapolates. The score is the log firing strength of the best matching rule.
        """
        if COMPILED and isinstance(X, np.ndarray) and X.dtype == np.float64 and X.shape == (1, self._sizes[0]):
            median, rare = self.network.familiar.tolist()
            firing = strongest_firing(self._packed, X[0], _FAR)
            if firing > -math.inf:  # not for NaN
                return np.array([(median - firing / X.shape[1]) / (median - rare)])
        return self.network.novelty(_matrix(X, "X", len(self.network.scaling.in_mean)))

    def state(self) -> dict[str, np.ndarray]:
        """Options and trained network as named arrays, for a file; ``from_state`` restores the model bit for bit."""
        network = self.network
        arrays = {
            f"option.{name}": np.array(np.nan if value is None else value) for name, value in self._options().items()
        }
        arrays |= {f"premises.{name}": value for name, value in vars(network.premises).items()}
        arrays |= {f"scaling.{name}": value for name, value in vars(network.scaling).items()}
        return arrays | {"consequents": network.consequents, "familiar": network.familiar}

    @classmethod
    def from_state(cls, state: Mapping[str, np.ndarray]) -> "Anfis":
        """The model of ``state()``; ``UserError`` where parts are missing or inconsistent."""
        try:
            options: dict[str, Any] = {}
            for item in fields(cls):
                if item.init:
                    value = state[f"option.{item.name}"].item()
                    options[item.name] = None if value != value else value
            model = cls(**options)
            premises = Premises(*(state[f"premises.{item.name}"] for item in fields(Premises)))
            scaling = Scaling(*(state[f"scaling.{item.name}"] for item in fields(Scaling)))
            network = Network(premises, state["consequents"], scaling, model.clip, state["familiar"])
            _check_network(network)
        except (KeyError, AttributeError, ValueError, TypeError) as error:
            raise UserError(f"this is not the state of an Anfis model: {error}") from None
        model.network = network
        return model

    def _options(self) -> dict[str, object]:
        return {item.name: getattr(self, item.name) for item in fields(self) if item.init}

    def _partition(self, points: np.ndarray) -> Premises:
        inputs = points.shape[1]
        per_input = round(self.rules ** (1.0 / inputs))
        is_grid = per_input**inputs == self.rules
        if self.partition == "grid" and not is_grid:
            raise UserError(f"a grid on {inputs} inputs needs k^{inputs} rules; {self.rules} is not such a power")
        if self.partition == "grid" or (self.partition == "auto" and is_grid):
            return partitions.grid_premises(points, per_input, self.slope, self.width)
        if self.partition == "subtractive":
            centres = partitions.subtractive_centres(points, self.rules, accept=0.0)
        else:
            centres = partitions.fuzzy_c_means(points, self.rules, np.random.default_rng(self.seed))
        return partitions.cluster_premises(points, centres, self.slope, self.width)

    def _learn(
        self,
        premises: Premises,
        scaling: Scaling,
        x: np.ndarray,
        y: np.ndarray,
        X_val: np.ndarray | None,
        Y_val: np.ndarray | None,
    ) -> "Anfis":
        validation = None
        if X_val is not None or Y_val is not None:
            x_val, y_val = _samples(X_val, Y_val, "_val", (x.shape[1], y.shape[1]))
            validation = Validation(scaling.inputs(x_val, self.clip), scaling.targets(y_val))
        objective = ReducedObjective(premises, scaling.inputs(x, self.clip), scaling.targets(y), self.ridge, self.prior)
        steps = frcg_steps(objective)
        if self.premise_optimizer == "pso":
            random = np.random.default_rng(self.seed)
            steps = swarm_steps(objective, validation, iterations=self.iterations, random=random)
        premises, consequents, self.curve = learn_premises(
            objective,
            steps,
            validation,
            iterations=self.iterations,
            patience=self.patience,
            tolerance=self.tolerance,
        )
        familiar = np.percentile(strength(premises, scaling, x), [50.0, 1.0])
        familiar[1] = min(familiar[1], familiar[0] - 1e-6)
        self.network = Network(premises, consequents, scaling, self.clip, familiar)
        return self


_CHOICES = {"partition": ("auto", "grid", "fcm", "subtractive"), "premise_optimizer": ("frcg", "pso")}
_WHOLE = {"rules": 1, "iterations": 0, "patience": 1, "seed": 0}
_ABOVE = {"ridge": 0.0, "slope": 0.5, "width": 0.0, "clip": 0.0}
_FROM = {"tolerance": 0.0, "prior": 0.0}
_OPTIONAL = ("ridge", "prior")


def _check_options(model: Anfis) -> None:
    for name, choices in _CHOICES.items():
        if getattr(model, name) not in choices:
            raise UserError(f"{name} must be one of {', '.join(choices)}, not {getattr(model, name)!r}")
    for name, least in _WHOLE.items():
        value = getattr(model, name)
        if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
            raise UserError(f"{name} must be a whole number of at least {least}, not {value!r}")
    for name, limit in (_ABOVE | _FROM).items():
        value = getattr(model, name)
        if value is None and name in _OPTIONAL:
            continue
        number = isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
        if not number or value < limit or (value == limit and name in _ABOVE):
            raise UserError(f"{name} must be a number {'above' if name in _ABOVE else 'from'} {limit:g}, not {value!r}")


def _matrix(values: np.ndarray, name: str, columns: int | None = None) -> np.ndarray:
    """``values`` as a matrix of finite float64 with one row per sample; ``UserError`` if they are not."""
    try:
        matrix = np.asarray(values, float)
    except (TypeError, ValueError):
        raise UserError(f"{name} is not an array of numbers") from None
    if matrix.ndim != 2 or matrix.shape[1] == 0:
        raise UserError(f"{name} must have the shape (samples, columns), not {matrix.shape}: one row per sample")
    if columns is not None and matrix.shape[1] != columns:
        raise UserError(f"{name} must have {columns} columns, not {matrix.shape[1]}")
    bad = np.flatnonzero(~np.isfinite(matrix).all(axis=1))
    if len(bad):
        raise UserError(f"{name} has {len(bad)} rows with values that are not finite, the first is row {bad[0]}")
    return matrix


def _samples(
    X: np.ndarray | None, Y: np.ndarray | None, suffix: str = "", columns: tuple[int | None, int | None] = (None, None)
) -> tuple[np.ndarray, np.ndarray]:
    if X is None or Y is None:
        raise UserError(f"X{suffix} and Y{suffix} belong together: give both or none")
    x, y = _matrix(X, f"X{suffix}", columns[0]), _matrix(Y, f"Y{suffix}", columns[1])
    if len(x) != len(y):
        raise UserError(f"X{suffix} has {len(x)} rows and Y{suffix} has {len(y)}")
    if len(x) < (1 if suffix else 2):
        raise UserError(f"{len(x)} samples in X{suffix} are too few")
    return x, y


def _check_network(network: Network) -> None:
    """``ValueError`` when the arrays of a stored network do not fit together or are not finite."""
    scaling, premises = network.scaling, network.premises
    (n, rules), m = premises.centre.shape, len(scaling.out_mean)
    shapes = {(n, rules): vars(premises).values(), (n,): (scaling.in_mean, scaling.in_gain)}
    shapes |= {(rules * (n + 1), m): (network.consequents,)}
    arrays = [(array, shape) for shape, group in shapes.items() for array in group]
    arrays += [(scaling.out_mean, (m,)), (scaling.out_scale, (m,)), (network.familiar, (2,))]
    if any(array.shape != shape or array.dtype != np.float64 for array, shape in arrays):
        raise ValueError("its arrays do not fit together")
    if not all(np.isfinite(array).all() for array, _ in arrays):
        raise ValueError("it has numbers that are not finite")
    if not (
        (premises.width > 0.0).all() and (premises.slope >= 0.5).all() and network.familiar[0] > network.familiar[1]
    ):
        raise ValueError("it has numbers out of range")
