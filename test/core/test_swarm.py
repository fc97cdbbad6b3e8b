"""The particle swarm."""

import numpy as np
import pytest

from nav_pose_estimator.core.learning.swarm import particle_swarm

LOW, HIGH = np.full(3, -2.0), np.full(3, 2.0)


def run(fitness, start, iterations=60):
    random = np.random.default_rng(3)
    return list(particle_swarm(fitness, start, LOW, HIGH, particles=20, iterations=iterations, random=random))


def many_minima(x: np.ndarray) -> float:
    return float(np.sum(x**2 - 2.0 * np.cos(3.0 * np.pi * x)))


def test_finds_the_lowest_of_many_minima():
    best, _ = run(many_minima, np.full(3, 1.9), 150)[-1]
    np.testing.assert_allclose(best, 0.0, atol=0.02)


def test_never_worse_than_the_start_and_never_rising():
    start = np.array([0.01, 0.0, 0.0])
    values = [value for _, value in run(many_minima, start)]
    assert values[0] <= many_minima(start)
    assert values == sorted(values, reverse=True)


def test_particles_stay_in_the_box():
    def inside(x: np.ndarray) -> float:
        assert (x >= LOW).all()
        assert (x <= HIGH).all()
        return float(x.sum())  # pulls into a corner

    best, _ = run(inside, np.zeros(3))[-1]
    np.testing.assert_allclose(best, LOW, atol=0.05)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_fitness_that_is_not_finite_is_worst(bad):
    best, value = run(lambda x: bad if x[0] > 0.0 else float((x**2).sum()), np.full(3, -1.0))[-1]
    assert best[0] <= 0.0
    assert value < 0.1


def test_same_generator_same_result():
    first, again = (run(many_minima, np.ones(3))[-1] for _ in range(2))
    np.testing.assert_array_equal(first[0], again[0])
