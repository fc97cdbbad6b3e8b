"""Particle swarm: a gradient-free optimiser of the premises (Kennedy & Eberhart 1995; Shi & Eberhart 1998)."""

from collections.abc import Callable, Iterator

import numpy as np

_INERTIA = (0.9, 0.4)  # inertia weight at the first and at the last iteration, linear in between
_PULL = 1.496  # acceleration coefficient towards a particle's own best and towards the swarm's best
_MAX_SPEED = 0.2  # largest speed per iteration, relative to the range of a coordinate


def particle_swarm(
    fitness: Callable[[np.ndarray], float],
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    particles: int,
    iterations: int,
    random: np.random.Generator,
) -> Iterator[tuple[np.ndarray, float]]:
    """Minimise ``fitness`` in the box [low, high]; yield the best point so far and its fitness at every iteration.

    ``start``, ``low``, ``high`` (n,). One particle begins at ``start``, so that the result is never worse; the others
    are distributed uniformly over the box. Particles are reflected at its walls. A fitness that is not finite counts as
    infinite.
    """
    span = high - low
    x = random.uniform(low, high, (particles, len(start)))
    x[0] = start
    v = random.uniform(-_MAX_SPEED, _MAX_SPEED, x.shape) * span
    own, own_value = x.copy(), np.full(particles, np.inf)
    for iteration in range(iterations):
        values = np.nan_to_num([fitness(particle) for particle in x], nan=np.inf, posinf=np.inf)
        better = values < own_value
        own[better], own_value[better] = x[better], values[better]
        leader = int(np.argmin(own_value))
        yield own[leader].copy(), float(own_value[leader])
        inertia = _INERTIA[0] + (_INERTIA[1] - _INERTIA[0]) * iteration / max(iterations - 1, 1)
        r1, r2 = random.uniform(size=(2, *x.shape))
        v = inertia * v + _PULL * (r1 * (own - x) + r2 * (own[leader] - x))
        v = np.clip(v, -_MAX_SPEED * span, _MAX_SPEED * span)
        x = x + v
        outside = (x < low) | (x > high)
        v[outside] *= -1.0
        x = np.clip(np.where(x < low, 2.0 * low - x, np.where(x > high, 2.0 * high - x, x)), low, high)
