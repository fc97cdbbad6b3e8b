"""Where the rules start."""

import numpy as np
import pytest

from nav_pose_estimator.core.learning.partition import (
    cluster_premises,
    fuzzifier,
    fuzzy_c_means,
    fuzzy_memberships,
    grid_premises,
    subtractive_centres,
)
from nav_pose_estimator.core.learning.takagi_sugeno import Premises, log_firing

CENTRES = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]])


@pytest.fixture
def blobs() -> np.ndarray:
    random = np.random.default_rng(1)
    return np.vstack([centre + 0.2 * random.normal(size=(60, 2)) for centre in CENTRES])


def nearest(found: np.ndarray) -> np.ndarray:
    return np.linalg.norm(found[:, None] - CENTRES, axis=-1).min(axis=0)


def test_grid_has_every_combination_and_neighbours_cross_at_one_half():
    points = np.array([[0.0, -1.0], [2.0, 1.0], [1.0, 0.5]])
    premises = grid_premises(points, 2, slope=2.0, width=1.0)
    assert {tuple(column) for column in premises.centre.T} == {(0.0, -1.0), (0.0, 1.0), (2.0, -1.0), (2.0, 1.0)}
    for j, middle in enumerate((1.0, 0.0)):
        bells = Premises(*(part[j : j + 1] for part in vars(premises).values()))
        np.testing.assert_allclose(np.exp(log_firing(bells, np.array([[middle]]))), 0.5, rtol=1e-12)


def test_fuzzy_c_means_finds_the_blobs(blobs):
    found = fuzzy_c_means(blobs, 3, np.random.default_rng(2))
    assert nearest(found).max() < 0.15


def test_fuzzy_c_means_repeats_with_its_generator(blobs):
    first, again = (fuzzy_c_means(blobs, 3, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_fuzzy_memberships_sum_to_one_also_on_a_centre(blobs):
    points = np.vstack([blobs, CENTRES])
    share = fuzzy_memberships(points, CENTRES, 2.0)
    np.testing.assert_allclose(share.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(share[-3:], np.eye(3), atol=1e-9)


def test_centres_stay_apart_in_ten_dimensions():
    """With the usual exponent 2 all centres fall on the mean of a ten-dimensional cloud."""
    points = np.random.default_rng(3).normal(size=(1000, 10))
    assert 1.0 < fuzzifier(points) < 1.25
    centres = fuzzy_c_means(points, 4, np.random.default_rng(4))
    distance = np.linalg.norm(centres[:, None] - centres, axis=-1)[np.triu_indices(4, 1)]
    assert distance.min() > 0.5


def test_subtractive_clustering_counts_the_blobs(blobs):
    found = subtractive_centres(blobs, 10)
    assert len(found) == 3
    assert nearest(found).max() < 0.3
    assert all((blobs == centre).all(axis=1).any() for centre in found)


def test_subtractive_clustering_gives_all_rules_when_none_is_rejected(blobs):
    assert len(subtractive_centres(blobs, 7, accept=0.0)) == 7


def test_widths_follow_the_clusters(blobs):
    premises = cluster_premises(blobs, CENTRES, slope=2.0, width=1.0)
    np.testing.assert_allclose(premises.width, 1.177 * 0.2 * np.sqrt(2.0), rtol=0.3)


@pytest.mark.parametrize("points", [np.zeros((20, 3)), np.repeat(np.eye(3), 5, axis=0)], ids=["equal", "three values"])
def test_points_that_coincide_still_give_bells(points):
    for centres in (fuzzy_c_means(points, 5, np.random.default_rng(6)), subtractive_centres(points, 5, accept=0.0)):
        premises = cluster_premises(points, centres, slope=2.0, width=1.0)
        assert np.isfinite(premises.centre).all()
        assert (premises.width > 0.0).all()
    assert (grid_premises(points, 2, slope=2.0, width=1.0).width > 0.0).all()
