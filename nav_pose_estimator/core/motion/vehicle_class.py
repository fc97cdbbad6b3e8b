"""Classification of the vehicle from its motion: a probability of each class by Bayes' rule.

Each class relates motion to attitude in its own way. With the velocity v in b (x forward, y left, z up), the upward
direction u in b and the specific force f:

    multirotor   thrust acts along z: it tilts towards where it accelerates (u), and only drag acts along x and y; it
                 moves in any direction, fast or slow, and is as level as a boat when flown gently
    fixed wing   fast along x at a small angle of attack; it banks in coordinated turns, with no lateral specific force
    wheels       move along x, climb only as the road does, and stay level: f shows their accelerations
    boat         moves along x with some drift and does not climb; it stays level: f shows its accelerations

The deviations from these relations have normal densities, whose scales are those of everyday mechanics. They give a
likelihood of each epoch under way. Epochs of the same manoeuvre are not independent: each counts as a twentieth of a
draw, and none can decide alone, for a gust or a landing fits no class.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion.epochs import BODY_VELOCITY, FORCE, PERIOD, VELOCITY, attitude

Array = NDArray[np.float64]

MULTIROTOR, FIXED_WING, WHEELS, BOAT = "multirotor", "fixed_wing", "wheels", "boat"
CLASSES = (MULTIROTOR, FIXED_WING, WHEELS, BOAT)
FLYING = (MULTIROTOR, FIXED_WING)
UNKNOWN = "unknown"
_CERTAIN = 0.95  # least probability of a class that is taken as known
_AGAINST = 0.9  # the motion speaks against a class whose posterior over prior probability is below this
_UNDER_WAY = 2.0  # m/s: least speed of an epoch that counts; slower, the vehicle may be carried by hand
_DRAW = 10.0  # s of motion that count as one independent draw, for a vehicle keeps its style for a while
_MOST = 4.0  # largest log likelihood ratio of two classes from one epoch
_USUAL = {MULTIROTOR: 0.48, FIXED_WING: 0.34, WHEELS: 0.12, BOAT: 0.06}
"""Prior probability of each class: most users fly drones."""


def classify(epochs: Array) -> str:
    """The class of a vehicle from aided epochs (N, COLUMNS or more), N may be zero; ``UNKNOWN`` where in doubt."""
    return likely_class(class_probabilities(epochs))


def likely_class(probability: Mapping[str, float]) -> str:
    """The class that has almost all of the ``probability``; ``UNKNOWN`` where none has."""
    likely = max(probability, key=lambda name: probability[name])
    return likely if probability[likely] >= _CERTAIN else UNKNOWN


def is_unlike(vehicle_class: str, epochs: Array) -> bool:
    """Whether the motion of epochs (N, COLUMNS or more) makes this class less probable than it was a priori."""
    return class_probabilities(epochs)[vehicle_class] < _AGAINST * _USUAL[vehicle_class]


def class_probabilities(epochs: Array) -> dict[str, float]:
    """Probability of each class after aided epochs (N, COLUMNS or more) in order of time; N may be zero."""
    v = epochs[:, BODY_VELOCITY:VELOCITY]
    likelihood = _log_likelihoods(epochs[np.square(v).sum(axis=1) > _UNDER_WAY**2])
    L = np.array([likelihood[name] for name in CLASSES])
    L = np.maximum(L, L.max(axis=0) - _MOST) if L.size else L
    evidence = np.log([_USUAL[name] for name in CLASSES]) + L.sum(axis=1) * PERIOD / _DRAW
    weight = np.exp(evidence - evidence.max())
    return dict(zip(CLASSES, (weight / weight.sum()).tolist(), strict=True))


def _log_likelihoods(epochs: Array) -> dict[str, Array]:
    """Log likelihood (N,) of each epoch, by class.

    Means and deviations are of velocity [m/s] and specific force [m/s^2] in b, climb [m/s] and the upward direction in
    b; they were set by hand on recorded flights. A multirotor's force along x and y is its drag, 0.25 1/s times the
    velocity.
    """
    vx, vy, vz = epochs[:, BODY_VELOCITY:VELOCITY].T
    fx, fy, climb = epochs[:, FORCE], epochs[:, FORCE + 1], epochs[:, VELOCITY + 2]
    ux, uy, _ = attitude(epochs)[:, 2].T
    v = np.sqrt(vx**2 + vy**2 + vz**2)
    level = _normal(ux, 0.07) + _normal(uy, 0.05) + _normal(fx, 1.5) + _normal(fy, 1.5)
    leaning = _normal(ux, 0.2) + _normal(uy, 0.2)
    leaning += _normal(fx + 0.25 * vx, 0.12 * np.abs(vx) + 0.4) + _normal(fy + 0.25 * vy, 0.12 * np.abs(vy) + 0.4)
    banking = _normal(ux - 0.07, 0.15) + _normal(uy, 0.35) + _normal(fx - 0.7, 1.5) + _normal(fy, 0.7)
    any_way = _normal(vx, 7.0) + _normal(vy, 0.7 * v + 0.3) + _normal(vz + ux * vx + uy * vy, 0.15 * v + 0.4)
    fast = _normal(vx - 18.0, 6.0) + _normal(vy, 0.2 * v + 0.3) + _normal(vz + 0.06 * v, 0.08 * v + 0.3)
    along = 0.04 * v + 0.1  # m/s: cross-axis velocity of a mount two degrees off
    rolling = _normal(vx, 12.0) + _normal(vy, along) + _normal(vz, along) + _normal(climb, 0.07 * v + 0.1)
    afloat = _normal(vx - 3.0, 4.0) + _normal(vy, 0.15 * v + 0.2) + _normal(vz, 0.05 * v + 0.15) + _normal(climb, 0.2)
    return {
        MULTIROTOR: leaning + _either(any_way + _normal(climb, 2.0), afloat),
        FIXED_WING: _either(fast + _normal(climb, 2.0) + banking, rolling + level, 0.9),
        WHEELS: rolling + level,
        BOAT: afloat + level,
    }


def _either(one: Array, other: Array, share: float = 0.5) -> Array:
    """Log density of a mixture of two log densities, the first with weight ``share``."""
    return np.asarray(np.logaddexp(math.log(share) + one, math.log(1.0 - share) + other))


def _normal(deviation: Array, sd: Array | float) -> Array:
    return np.asarray(-0.5 * (deviation / sd) ** 2 - np.log(sd))
