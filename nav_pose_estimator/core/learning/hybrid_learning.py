"""Hybrid learning: consequents by least squares, premises by conjugate gradient on the reduced objective.

    E(v, Theta) = 1/(2 N) ||Phi(v) Theta - T||^2 + rho/2 ||Theta||^2 + kappa/2 ||v - v0||^2 / dim v            (1)

The consequents Theta enter linearly. They are eliminated: E*(v) = min_Theta E(v, Theta) (variable projection, Golub &
Pereyra 1973), and the gradient of E* is the partial gradient of E at the best Theta. So every evaluation is a forward
pass with least squares and a backward pass with the gradient, as in Jang's hybrid rule (1993) and in CN113777645A
(claim 3). The conjugate gradient nevertheless minimises one fixed function; with alternating passes the function would
change at every step. All quantities are standardised.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nav_pose_estimator.core.learning.conjugate_gradient import fletcher_reeves
from nav_pose_estimator.core.learning.swarm import particle_swarm
from nav_pose_estimator.core.learning.takagi_sugeno import (
    Premises,
    design_matrix,
    log_firing,
    normalise_firing,
    outputs,
    with_one,
)

_METRIC_DAMPING = 0.1  # damping of the metric, relative to its mean diagonal
_METRIC_SAMPLES = 2  # smallest number of samples per premise parameter for the metric
_PARTICLES = 24  # size of the swarm
_PRIOR = 0.05  # default prior, relative to sigma^2 dim v / N (see ``ReducedObjective``)
_RIDGES = 10.0 ** np.arange(-9, 0)  # candidates of ``choose_ridge``
_CAUTION = 1.4  # factor on the degrees of freedom in GCV: plain GCV (factor 1) tends to choose too small a ridge


def whitening(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """(W, jitter) with W matrix W' = I: the inverse of the lower Cholesky factor of a symmetric matrix.

    Jitter, a multiple of the mean diagonal, is added to the diagonal: 0, and where rounding has made the matrix
    indefinite 1e-14, 1e-12, ... Raises ``ValueError`` for a matrix that is not finite.
    """
    jitter, scale = 0.0, max(float(np.trace(matrix)) / len(matrix), 1e-300)
    if not np.isfinite(scale):
        raise ValueError("the matrix is not finite")
    while True:
        try:
            return np.linalg.inv(np.linalg.cholesky(matrix + jitter * scale * np.eye(len(matrix)))), jitter
        except np.linalg.LinAlgError:
            jitter = max(100.0 * jitter, 1e-14)


def ridge_least_squares(design: np.ndarray, targets: np.ndarray, ridge: float) -> np.ndarray:
    """Theta (P, m) that minimises 1/(2 N) ||Phi Theta - T||^2 + ridge/2 ||Theta||^2, by Cholesky.

    ``design`` (P, N) is Phi transposed, ``targets`` (m, N). The regressors of a fuzzy network are always nearly
    collinear (the normalised strengths sum to 1); ``ridge`` > 0 makes the solution unique.
    """
    return _ridge(design, targets, ridge)[0]


def _ridge(design: np.ndarray, targets: np.ndarray, ridge: float) -> tuple[np.ndarray, np.ndarray, float]:
    white, jitter = whitening(_normal_matrix(design, ridge))
    return white.T @ (white @ (design @ targets.T / targets.shape[1])), white, jitter


def _normal_matrix(design: np.ndarray, ridge: float) -> np.ndarray:
    matrix = design @ design.T
    matrix /= design.shape[1]
    matrix.flat[:: len(matrix) + 1] += ridge
    return matrix


def choose_ridge(design: np.ndarray, targets: np.ndarray) -> float:
    """The ridge among 1e-9, 1e-8 ... 0.1 with the smallest generalised cross-validation (GCV) error.

    GCV = RSS / N / (1 - 1.4 df / N)^2 (Golub, Heath & Wahba 1979; the factor: Cummins, Filloon & Nychka 2001), from one
    eigendecomposition for all candidates.
    """
    samples = targets.shape[1]
    values, vectors = np.linalg.eigh(_normal_matrix(design, 0.0))
    values = np.maximum(values, 0.0)
    moments = vectors.T @ (design @ targets.T) / samples

    def error(ridge: float) -> float:
        residual = targets - (vectors @ (moments / (values + ridge)[:, None])).T @ design
        freedom = 1.0 - _CAUTION * float(np.sum(values / (values + ridge))) / samples
        return float(np.mean(np.square(residual))) / max(freedom, 1e-3) ** 2

    return float(min(_RIDGES, key=error))


@dataclass(frozen=True)
class _Pass:
    """Intermediate results of one evaluation: the linear problem at ``vector``, and derivatives on demand."""

    vector: np.ndarray
    premises: Premises
    inputs: np.ndarray  # (n, N)
    extended: np.ndarray  # (n + 1, N)
    targets: np.ndarray  # (m, N)
    buffer: np.ndarray  # (3, n, R, N) for ``slopes``
    has_slopes: bool  # whether ``buffer`` holds them already
    firing: np.ndarray  # (R, N)
    design: np.ndarray  # (P, N)
    consequents: np.ndarray  # (P, m)
    white: np.ndarray  # (P, P) ``whitening`` of the normal equations
    residual: np.ndarray  # (m, N)

    @cached_property
    def slopes(self) -> np.ndarray:
        """d ln mu / d v divided by ``scales``, (3, n, R, N)."""
        if not self.has_slopes:
            with np.errstate(all="ignore"):
                log_firing(self.premises, self.inputs, self.buffer)
        return self.buffer

    @property
    def by_rule(self) -> np.ndarray:
        """``slopes`` as (R, 3 n, N)."""
        return self.slopes.reshape(-1, *self.firing.shape).transpose(1, 0, 2)

    @cached_property
    def scales(self) -> np.ndarray:
        """Factor (3 n, R) on ``slopes``."""
        return self.premises.scales.reshape(-1, len(self.firing))

    @cached_property
    def influence(self) -> np.ndarray:
        """d y / d ln w_i = wn_i (h_i - y), (R, m, N), with h_i the consequent of rule i."""
        rules, terms = len(self.firing), len(self.extended)
        h = self.consequents.reshape(rules, terms, -1).transpose(0, 2, 1) @ self.extended
        return self.firing[:, None, :] * (h - (self.residual + self.targets))


class ReducedObjective:
    """E*(v) of equation (1) and its gradient, for ``fletcher_reeves`` or any other minimiser.

    ``premises`` are the initial v0; ``inputs`` (n, N) and ``targets`` (m, N) are standardised. ``ridge`` None: chosen
    by ``choose_ridge`` at the start. ``prior`` None: 0.05 sigma^2 dim v / N, with sigma the initial residuals'
    deviation. Without the factor 0.05, a change of the premises by one would cost as much as one standard deviation of
    the initial residuals; learning leaves smaller ones. ``evaluations`` and ``jittered`` (evaluations whose normal
    equations needed jitter) are counters.
    """

    def __init__(
        self, premises: Premises, inputs: np.ndarray, targets: np.ndarray, ridge: float | None, prior: float | None
    ) -> None:
        self.premises = premises
        self.inputs, self.targets = np.ascontiguousarray(inputs), np.ascontiguousarray(targets)
        self.extended = with_one(self.inputs)
        self.start = premises.vector()
        self.evaluations = self.jittered = 0
        self._last: _Pass | None = None
        self._slopes = np.empty((3, *premises.centre.shape, self.inputs.shape[1]))  # of the last evaluation
        design = design_matrix(normalise_firing(log_firing(premises, self.inputs)), self.extended)
        self.ridge = choose_ridge(design, self.targets) if ridge is None else ridge
        if prior is None:
            residual = ridge_least_squares(design, self.targets, self.ridge).T @ design - self.targets
            prior = _PRIOR * float(np.mean(np.square(residual))) * len(self.start) / self.targets.shape[1]
        self.prior = prior

    def __call__(self, vector: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient at ``vector`` (3 n R,); infinite where numbers overflow."""
        last = self._at(vector, with_slopes=True)
        if last is None:
            return np.inf, np.zeros_like(vector)
        push = np.einsum("imk,mk->ik", last.influence, last.residual) / last.residual.shape[1]
        move = vector - self.start
        pull = last.scales * (last.by_rule @ push[:, :, None])[:, :, 0].T
        gradient = pull.ravel() + self.prior / len(move) * move
        return self._value(last.residual, last.consequents, move), gradient

    def value(self, vector: np.ndarray) -> float:
        """The value at ``vector`` without the gradient, for the swarm."""
        last = self._at(vector)
        return np.inf if last is None else self._value(last.residual, last.consequents, vector - self.start)

    def _value(self, residual: np.ndarray, consequents: np.ndarray, move: np.ndarray) -> float:
        fit = np.vdot(residual, residual) / residual.shape[1]
        return 0.5 * float(
            fit + self.ridge * np.vdot(consequents, consequents) + self.prior / len(move) * np.vdot(move, move)
        )

    def _pass(self, vector: np.ndarray) -> _Pass:
        last = self._at(vector)
        assert last is not None
        return last

    def _at(self, vector: np.ndarray, with_slopes: bool = False) -> _Pass | None:
        """The evaluation at ``vector``, reused if it was the last one; None where numbers overflow."""
        if self._last is None or not np.array_equal(self._last.vector, vector):
            self._last = self._evaluate(vector, with_slopes)
        return self._last

    def _evaluate(self, vector: np.ndarray, with_slopes: bool) -> _Pass | None:
        self.evaluations += 1
        premises = self.premises.with_vector(vector)
        with np.errstate(all="ignore"):
            firing = normalise_firing(log_firing(premises, self.inputs, self._slopes if with_slopes else None))
            if not np.isfinite(firing.sum()):
                return None
            design = design_matrix(firing, self.extended)
            consequents, white, jitter = _ridge(design, self.targets, self.ridge)
        self.jittered += jitter > 0.0
        residual = consequents.T @ design - self.targets
        layers = self._slopes, with_slopes, firing, design, consequents, white, residual
        return _Pass(vector.copy(), premises, self.inputs, self.extended, self.targets, *layers)

    def consequents(self, vector: np.ndarray) -> np.ndarray:
        """The best consequents (R (n + 1), m) at ``vector``."""
        return self._pass(vector).consequents

    def rmse(self, vector: np.ndarray) -> float:
        """Root mean square of the standardised residuals at ``vector``."""
        return float(np.sqrt(np.mean(np.square(self._pass(vector).residual))))

    def metric(self, vector: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The function g -> M^-1 g, with M the damped block-diagonal Gauss-Newton matrix of E* at ``vector``.

        With J = d y / d v at fixed consequents, M = J' (I - Phi (Phi'Phi + N rho I)^-1 Phi') J / N + damping (Kaufman
        1975). Blocks that couple different rules are omitted. An approximation is sufficient, so many samples are
        thinned out.
        """
        last = self._pass(vector)
        step = max(1, self.targets.shape[1] // (_METRIC_SAMPLES * len(vector)))
        design = last.design[:, ::step]
        white = last.white if step == 1 else whitening(_normal_matrix(design, self.ridge))[0]
        by_rule = last.by_rule[..., ::step] * last.scales.T[:, :, None]
        rules, size, samples = by_rule.shape
        blocks = np.zeros((rules, size, size))
        for influence in last.influence[..., ::step].transpose(1, 0, 2):
            jacobian = by_rule * influence[:, None, :]
            moments = design @ jacobian.reshape(rules * size, samples).T / samples
            explained = (white @ moments).T.reshape(rules, size, -1)
            blocks += jacobian @ jacobian.transpose(0, 2, 1) / samples - explained @ explained.transpose(0, 2, 1)
        mean = max(np.trace(blocks, axis1=1, axis2=2).sum(), 0.0) / len(vector)
        blocks += (_METRIC_DAMPING * mean + self.prior / len(vector) + 1e-300) * np.eye(size)
        inverse = np.linalg.inv(blocks)
        return lambda gradient: np.einsum("rij,jr->ir", inverse, gradient.reshape(size, rules)).ravel()

    def curvature(self, vector: np.ndarray, direction: np.ndarray) -> float:
        """p' M p along ``direction`` p, with the full undamped Gauss-Newton matrix M of all samples."""
        last = self._pass(vector)
        push = ((last.scales * direction.reshape(last.scales.shape)).T[:, None, :] @ last.by_rule)[:, 0]
        change = np.einsum("imk,ik->mk", last.influence, push)
        explained = last.white @ (last.design @ change.T) / change.shape[1]
        square = np.vdot(change, change) / change.shape[1] - np.vdot(explained, explained)
        return float(square) + self.prior / len(vector) * float(direction @ direction)


@dataclass(frozen=True)
class LearningCurve:
    """Record of a training: RMS errors relative to the targets' standard deviation; entry 0 is before the first step.

    ``best`` is the entry that was kept, ``stopped`` the reason for the end: "one rule", "iterations", "converged" or
    "validation". ``jittered`` counts evaluations whose normal equations needed jitter.
    """

    training: tuple[float, ...]
    validation: tuple[float, ...]
    best: int
    stopped: str
    evaluations: int
    jittered: int
    ridge: float
    prior: float


@dataclass(frozen=True)
class Validation:
    """Standardised validation samples, which are not trained on: ``inputs`` (n, N), ``targets`` (m, N)."""

    inputs: np.ndarray
    targets: np.ndarray

    def rmse(self, premises: Premises, consequents: np.ndarray) -> float:
        """Root mean square of the standardised residuals."""
        return float(np.sqrt(np.mean(np.square(outputs(premises, consequents, self.inputs) - self.targets))))


def frcg_steps(objective: ReducedObjective) -> Iterator[np.ndarray]:
    """Premise vectors by Fletcher-Reeves in the Gauss-Newton metric."""
    for iterate in fletcher_reeves(objective, objective.start, objective.metric, objective.curvature):
        yield iterate.x


def swarm_steps(
    objective: ReducedObjective,
    validation: Validation | None,
    *,
    iterations: int,
    random: np.random.Generator,
) -> Iterator[np.ndarray]:
    """Premise vectors by particle swarm. The fitness is the validation error, or the objective without validation.

    Search box about the start: centres +-1 (one deviation of the input), ln a +-1, softplus^-1(b - 1/2) +-2.
    """
    reach = np.repeat([1.0, 1.0, 2.0], len(objective.start) // 3)

    def fitness(vector: np.ndarray) -> float:
        value = objective.value(vector)
        if validation is None or not np.isfinite(value):
            return value
        return validation.rmse(objective.premises.with_vector(vector), objective.consequents(vector))

    low, high = objective.start - reach, objective.start + reach
    for vector, _ in particle_swarm(
        fitness, objective.start, low, high, particles=_PARTICLES, iterations=iterations, random=random
    ):
        yield vector


def learn_premises(
    objective: ReducedObjective,
    steps: Iterator[np.ndarray],
    validation: Validation | None,
    *,
    iterations: int,
    patience: int,
    tolerance: float,
) -> tuple[Premises, np.ndarray, LearningCurve]:
    """Follow ``steps`` and keep the best: by the validation error where there is one, else the last.

    Ends after ``iterations``, when the validation error has not improved for ``patience`` steps, or when the training
    error has fallen by less than the fraction ``tolerance`` over ``patience`` steps. Returns premises, consequents,
    curve.
    """
    best, best_at, stopped = objective.start, 0, "iterations"
    training, scores = [objective.rmse(best)], []
    if validation:
        scores.append(validation.rmse(objective.premises, objective.consequents(best)))
    if objective.premises.rules == 1:  # a single rule always has strength 1, so its bells do not affect the output
        iterations, stopped = 0, "one rule"
    for vector in itertools.islice(steps, iterations):
        training.append(objective.rmse(vector))
        if validation:
            scores.append(validation.rmse(objective.premises.with_vector(vector), objective.consequents(vector)))
        if not validation or scores[-1] < scores[best_at]:
            best, best_at = vector, len(training) - 1
        stopped = _stop_reason(training, best_at, patience, tolerance)
        if stopped != "iterations":
            break
    if stopped == "iterations" and len(training) <= iterations:
        stopped = "converged"  # the optimiser found no further descent
    consequents = objective.consequents(best)
    counts = objective.evaluations, objective.jittered, objective.ridge, objective.prior
    curve = LearningCurve(tuple(training), tuple(scores), best_at, stopped, *counts)
    return objective.premises.with_vector(best), consequents, curve


def _stop_reason(training: list[float], best_at: int, patience: int, tolerance: float) -> str:
    if len(training) - 1 - best_at >= patience:
        return "validation"
    if len(training) > patience and training[-1] > (1.0 - tolerance) * training[-1 - patience]:
        return "converged"
    return "iterations"
