"""Initial partition of a fuzzy network's input space: grid, subtractive clustering, fuzzy c-means.

Points are standardised inputs (N, n). A grid of k bells per input has k^n rules: feasible for four inputs, not for ten
(at least 1024 rules). Clustering places any number of rules where the data are.
"""

import itertools
import math

import numpy as np

from nav_pose_estimator.core.learning.takagi_sugeno import Premises

_HALF_WIDTH = math.sqrt(2.0 * math.log(2.0))  # half width at half height of a Gaussian over its deviation: 1.177
_LEAST_SPREAD = 0.05  # floor of a cluster's standard deviation along an input, for clusters of equal values
_MOST_POINTS = 4000  # points used by subtractive clustering, whose cost is quadratic; more are thinned out
_ROWS = 500  # rows of the distance matrix that are computed at a time


def grid_premises(points: np.ndarray, per_input: int, slope: float, width: float) -> Premises:
    """``per_input`` bells per input, evenly from the smallest to the largest value; one rule per combination.

    With ``width`` 1 neighbouring bells cross at 1/2 (Jang 1993). Each rule has its own bells, which learn
    independently.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    axes = np.linspace(low, high, per_input) if per_input > 1 else 0.5 * (low + high)[None, :]
    centre = np.array(list(itertools.product(*axes.T))).T
    half = np.maximum(high - low, _LEAST_SPREAD) / (2.0 * max(per_input - 1, 1))
    return Premises(centre, np.tile(width * half[:, None], centre.shape[1]), np.full_like(centre, slope))


def cluster_premises(points: np.ndarray, centres: np.ndarray, slope: float, width: float) -> Premises:
    """One rule per row of ``centres`` (R, n), as wide along every input as the points that belong to it.

    a = ``width`` 1.177 sigma sqrt(n): the half width of the cluster, times sqrt(n) because n bells are multiplied.
    """
    exponent = fuzzifier(points)
    weight = fuzzy_memberships(points, centres, exponent) ** exponent
    square = weight.T @ np.square(points) - 2.0 * centres * (weight.T @ points)
    variance = square / weight.sum(axis=0)[:, None] + np.square(centres)
    spread = np.sqrt(np.maximum(variance, _LEAST_SPREAD**2))
    bell = width * _HALF_WIDTH * math.sqrt(points.shape[1]) * spread
    return Premises(centres.T.copy(), bell.T.copy(), np.full(bell.T.shape, slope))


def fuzzifier(points: np.ndarray) -> float:
    """Exponent of fuzzy c-means: 2, or less where 2 would make all centres collapse to the mean (many inputs).

    With l the largest eigenvalue of the mean of d d' / |d|^2, d a point minus the mean, the centres stay distinct for
    exponents below 1 / (1 - 2 l) (Yu, Cheng & Huang 2004). The middle between 1 and that limit is used.
    """
    away = points - points.mean(axis=0)
    away = away / np.maximum(np.sqrt(np.square(away).sum(axis=1)), 1e-12)[:, None]
    largest = float(np.linalg.eigvalsh(away.T @ away / len(away))[-1])
    return 2.0 if largest >= 0.5 else min(2.0, 1.0 + max(largest / (1.0 - 2.0 * largest), 0.01))


def fuzzy_memberships(points: np.ndarray, centres: np.ndarray, exponent: float) -> np.ndarray:
    """Memberships (N, R) of ``points`` in the clusters at ``centres``; rows sum to 1 (Bezdek 1981)."""
    log = np.log(np.maximum(_square_distances(points, centres), 1e-24)) / (1.0 - exponent)
    memberships = np.exp(log - log.max(axis=1, keepdims=True))
    memberships /= memberships.sum(axis=1, keepdims=True)
    return memberships


def fuzzy_c_means(points: np.ndarray, clusters: int, random: np.random.Generator, iterations: int = 100) -> np.ndarray:
    """Centres (clusters, n) by fuzzy c-means (Bezdek 1981), initialised by k-means++, until they no longer move."""
    if clusters == 1:
        return points.mean(axis=0)[None]
    exponent = fuzzifier(points)
    centres = _spread_out(points, clusters, random)
    for _ in range(iterations):
        weight = fuzzy_memberships(points, centres, exponent) ** exponent
        moved = (weight.T @ points) / np.maximum(weight.sum(axis=0), 1e-300)[:, None]
        rest = np.abs(moved - centres).max() < 1e-5
        centres = moved
        if rest:
            break
    return centres


def subtractive_centres(
    points: np.ndarray, most: int, radius: float = 0.5, accept: float = 0.5, reject: float = 0.15
) -> np.ndarray:
    """At most ``most`` centres (R, n) by subtractive clustering (Chiu 1994): points with many neighbours.

    ``radius`` is the range of influence of a centre, relative to the range of the data. After each centre the potential
    around it is reduced over 1.5 radii. The search ends early when the largest remaining potential is below ``reject``
    times the first one.
    """
    points = points[:: -(-len(points) // _MOST_POINTS)]
    span = np.ptp(points, axis=0)
    unit = points / np.where(span > 0.0, span, 1.0) / radius
    potential = np.zeros(len(unit))
    for start in range(0, len(unit), _ROWS):
        potential += np.exp(-4.0 * _square_distances(unit, unit[start : start + _ROWS])).sum(axis=1)
    chosen: list[int] = []
    first = potential.max()
    while len(chosen) < most:
        best = int(np.argmax(potential))
        height = potential[best] / first
        if chosen and height < accept:
            apart = math.sqrt(_square_distances(unit[best : best + 1], unit[chosen]).min())
            if height < reject:
                break
            if apart + height < 1.0:
                potential[best] = 0.0
                continue
        chosen.append(best)
        taken = np.exp(-4.0 / 1.5**2 * _square_distances(unit, unit[best : best + 1])[:, 0])
        potential = potential - potential[best] * taken
    return points[chosen]


def _square_distances(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    cross = points @ centres.T
    square = np.square(points).sum(axis=1)[:, None] + np.square(centres).sum(axis=1) - 2.0 * cross
    return np.maximum(square, 0.0)


def _spread_out(points: np.ndarray, clusters: int, random: np.random.Generator) -> np.ndarray:
    """k-means++ (Arthur & Vassilvitskii 2007): each centre is drawn with the squared distance to those before."""
    centres = points[random.integers(len(points))][None, :]
    while len(centres) < clusters:
        weight = _square_distances(points, centres).min(axis=1)
        total = weight.sum()
        share = weight / total if total > 0.0 else np.full(len(points), 1.0 / len(points))
        centres = np.vstack([centres, points[random.choice(len(points), p=share)]])
    return centres
