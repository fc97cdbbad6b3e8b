"""Mixtures of navigators: the error between two of them, and the one Gaussian that several make together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filter_start import SUBSETS, names, plain_constants
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import memory as filter_memory
from nav_pose_estimator.core.filter.blocks import BLOCKS, GYRO_MATRIX, WIND, state_count, with_block
from nav_pose_estimator.core.filter.error_state import error_between, inject
from nav_pose_estimator.core.filter.mixture import blend_rows, merge
from nav_pose_estimator.core.filter.strapdown import write_output
from nav_pose_estimator.core.numerics.rotation import quat_from_euler, quat_to_matrix

CHOICES = ((), (WIND,), (GYRO_MATRIX,), BLOCKS)
BASE = plain_constants()
ESTIMATED = [*range(at.TIME)]  # everything that an observation may correct


def navigator(lat: float = 0.8, lon: float = 0.2, yaw: float = 2.0, pitch: float = -0.1) -> np.ndarray:
    """A moving vehicle with biases and estimates of every block."""
    nav = np.zeros(at.NAV_SIZE)
    nav[at.LAT : at.VEL] = lat, lon, 300.0
    nav[at.VEL : at.VEL + 3] = 4.0, -7.0, 1.5
    nav[at.QUAT : at.QUAT + 4] = quat_from_euler(0.2, pitch, yaw)
    nav[at.GYRO_BIAS : at.WIND] = 0.01, -0.02, 0.005, 0.1, -0.05, 0.2
    nav[at.WIND : at.GYRO_MATRIX] = 1.0, -2.0
    nav[at.GYRO_MATRIX : at.TIME] = 1e-3 * np.arange(at.TIME - at.GYRO_MATRIX)
    return nav


def small_errors(n: int, random: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    """Errors (n,) as large as hypotheses drift apart in a minute: 0.1 rad, 3 m/s, 100 m."""
    sd = np.full(n, 0.01)
    sd[at.PHI : at.DVEL], sd[at.DVEL : at.DPOS], sd[at.DPOS : at.D_GYRO_BIAS] = 0.1, 3.0, 100.0
    return scale * sd * random.standard_normal(n)


def random_covariance(n: int, random: np.random.Generator) -> np.ndarray:
    root = random.standard_normal((n, n)) * 0.1
    return root @ root.T + 0.01 * np.eye(n)


@settings(max_examples=60)
@given(
    blocks=st.sampled_from(CHOICES),
    seed=st.integers(0, 10**6),
    turn=st.floats(0.0, 3.1),
    lat=st.floats(-1.5, 1.5),
    lon=st.sampled_from([0.2, -3.0, np.pi - 1e-7, -np.pi]),
    yaw=st.floats(-np.pi, np.pi),
)
def test_injecting_the_error_between_two_navigators_gives_the_other(blocks, seed, turn, lat, lon, yaw) -> None:
    """GIVEN two navigators, up to half a turn and some hundred metres apart, also across the date line
    WHEN the error between them is taken out of one THEN it is the other, to a micrometre per metre."""
    random, constants = np.random.default_rng(seed), plain_constants(blocks)
    n = state_count(constants)
    nav = navigator(lat, lon, yaw)
    other = nav.copy()
    apart = small_errors(n, random)
    axis = random.standard_normal(3)
    apart[:3] = turn * axis / np.linalg.norm(axis)
    inject(other, constants, apart)
    back = other.copy()
    inject(back, constants, error_between(nav, other, constants))
    # metres across the date line are a full turn of longitude: compare directions
    np.testing.assert_allclose(np.exp(1j * back[at.LON]), np.exp(1j * nav[at.LON]), atol=1e-13, rtol=0)
    kept = [i for i in ESTIMATED if i != at.LON and not at.QUAT <= i < at.QUAT + 4]
    np.testing.assert_allclose(back[kept], nav[kept], atol=1e-9, rtol=1e-12)
    np.testing.assert_allclose(
        quat_to_matrix(back[at.QUAT : at.QUAT + 4]), quat_to_matrix(nav[at.QUAT : at.QUAT + 4]), atol=1e-9
    )


def test_a_quaternion_of_the_other_sign_is_the_same_attitude() -> None:
    nav, flipped = navigator(), navigator()
    flipped[at.QUAT : at.QUAT + 4] *= -1.0
    np.testing.assert_allclose(error_between(nav, flipped, BASE), 0.0, atol=1e-15)


@pytest.mark.parametrize("blocks", CHOICES, ids=names)
def test_a_mixture_has_the_moments_of_its_members(blocks) -> None:
    """GIVEN three weighted Gaussians about one vehicle WHEN merged THEN mean and covariance are those of the mixture.

    Closed form in the error state of the strongest member, where the members are vectors.
    """
    constants = plain_constants(blocks)
    n = state_count(constants)
    random = np.random.default_rng(n)
    weights = np.array([0.2, 0.5, 0.3])
    truth = navigator()
    errors = np.stack([small_errors(n, random, 1e-3) for _ in weights])
    navs, Ps = np.stack([truth.copy() for _ in weights]), np.stack([random_covariance(n, random) for _ in weights])
    for nav, error in zip(navs, errors, strict=True):
        inject(nav, constants, error)
    nav, P = merge(navs, Ps, constants, weights)

    mean = weights @ errors
    found = error_between(nav, truth, constants)  # the error of the truth were the mixture true
    np.testing.assert_allclose(found, mean, atol=1e-6)
    away = errors - mean
    expected = np.einsum("k,kij->ij", weights, Ps) + np.einsum("k,ki,kj->ij", weights, away, away)
    np.testing.assert_allclose(P, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("blocks", CHOICES, ids=names)
def test_a_mixture_has_the_moments_of_drawn_samples(blocks) -> None:
    """GIVEN members some metres and degrees apart WHEN 40 000 vehicles are drawn from them
    THEN their mean error about the merged state is nought and their covariance is the merged one."""
    constants = plain_constants(blocks)
    n = state_count(constants)
    random = np.random.default_rng(10 + n)
    weights = np.array([0.35, 0.65])
    errors = np.stack([small_errors(n, random, 0.05) for _ in weights])
    navs = np.stack([navigator() for _ in weights])
    for nav, error in zip(navs, errors, strict=True):
        inject(nav, constants, error)
    Ps = np.stack([1e-4 * random_covariance(n, random) for _ in weights])
    nav, P = merge(navs, Ps, constants, weights)

    drawn = np.empty((40_000, n))
    for row, k in enumerate(random.choice(2, len(drawn), p=weights)):
        drawn[row, 0] = k
    members = drawn[:, 0].astype(int)
    for k in range(2):
        own = members == k
        centre = error_between(navs[k], nav, constants)
        drawn[own] = centre + random.standard_normal((own.sum(), n)) @ np.linalg.cholesky(Ps[k]).T
    sd = np.sqrt(np.diag(P))
    assert np.all(np.abs(drawn.mean(axis=0)) < 5.0 * sd / np.sqrt(len(drawn)) + 1e-4 * sd)
    np.testing.assert_allclose(np.cov(drawn.T) / np.outer(sd, sd), P / np.outer(sd, sd), atol=0.04)


def test_one_member_is_left_as_it_is() -> None:
    random = np.random.default_rng(1)
    nav, P = navigator(), random_covariance(17, random)
    merged_nav, merged_P = merge(nav[None], P[None], plain_constants([WIND]), np.ones(1))
    np.testing.assert_allclose(merged_nav, nav, rtol=1e-15)
    np.testing.assert_array_equal(merged_P, P)


def test_the_integrators_memory_is_the_strongest_members() -> None:
    navs = np.stack([navigator(), navigator()])
    navs[:, at.TIME :] = [[1.0], [2.0]]
    nav, _ = merge(navs, np.stack([np.eye(15)] * 2), BASE, np.array([0.3, 0.7]))
    np.testing.assert_array_equal(nav[at.TIME :], navs[1, at.TIME :])


def mixed(navs: np.ndarray, Ps: np.ndarray, constants: np.ndarray, trunk_constants: np.ndarray, weights: np.ndarray):
    """Nominal state and covariance of a filter that has become the mixture of some with more blocks."""
    n, m = state_count(constants), state_count(trunk_constants)
    branches = np.stack([filter_memory.make(constants, 1, 1.0) for _ in navs])
    branches[:, filter_memory.NAV : filter_memory.CONSTANTS] = navs
    branches[:, filter_memory.HEAD : filter_memory.HEAD + n * n] = Ps.reshape(len(Ps), -1)
    trunk = filter_memory.make(trunk_constants, 1, 1.0)
    filter_memory.mix(branches, weights, trunk)
    P = trunk[filter_memory.HEAD : filter_memory.HEAD + m * m]
    return trunk[filter_memory.NAV : filter_memory.CONSTANTS], P.reshape(m, m)


@pytest.mark.parametrize("blocks", [choice for choice in SUBSETS if WIND not in choice], ids=names)
def test_a_filter_splits_and_becomes_the_mixture_of_its_branches(blocks) -> None:
    """GIVEN a filter of any blocks WHEN its branches get a wind block THEN that is tied to nothing, and what the filter
    becomes is their mixture without it; of a single branch, the same bits as before."""
    constants = plain_constants(blocks)
    random = np.random.default_rng(6)
    before = [random_covariance(state_count(constants), random) for _ in range(2)]
    cov = np.array([[2.5, 0.3], [0.3, 1.5]])
    split = [with_block(constants, P, WIND, cov) for P in before]
    wider, Ps = split[0][0], np.stack([P for _, P in split])
    wind = WIND.states(wider)
    others = np.delete(np.arange(Ps.shape[1]), wind)
    np.testing.assert_array_equal(Ps[0][wind, wind], cov)
    assert not Ps[0][wind][:, others].any()
    np.testing.assert_array_equal(mixed(navigator()[None], Ps[:1], wider, constants, np.ones(1))[1], before[0])

    navs, weights = np.stack([navigator(), navigator(yaw=1.6)]), np.array([0.3, 0.7])
    nav, P = merge(navs, Ps, wider, weights)
    mixed_nav, mixed_P = mixed(navs, Ps, wider, constants, weights)
    np.testing.assert_array_equal(mixed_nav, nav)
    np.testing.assert_array_equal(mixed_P, P[np.ix_(others, others)])


def rows_of(navs: np.ndarray, Ps: np.ndarray) -> np.ndarray:
    """Output rows (K, 1, OUT_COLUMNS) of navigators."""
    rows = np.empty((len(navs), 1, at.OUT_COLUMNS))
    for nav, P, out in zip(navs, Ps, rows, strict=True):
        write_output(nav, np.zeros(at.CONSTANTS_SIZE), P, out, 0)
    return rows


@pytest.mark.parametrize("lon", [0.2, np.pi - 1e-7])
def test_blended_rows_are_the_row_of_the_mixture(lon: float) -> None:
    """GIVEN two members some metres apart, also on both sides of the date line
    WHEN their output rows are blended THEN position, velocity, attitude and variances are the mixture's."""
    random = np.random.default_rng(5)
    weights = np.array([0.4, 0.6])
    navs = np.stack([navigator(lon=lon), navigator(lon=lon)])
    inject(navs[1], BASE, np.r_[0.02, -0.01, 0.03, 1.0, -2.0, 0.1, -6.0, 3.0, 1.0, np.zeros(6)])
    Ps = np.stack([random_covariance(15, random) for _ in weights])
    out = np.empty((1, at.OUT_COLUMNS))
    blend_rows(rows_of(navs, Ps), weights, 0, 1, out)
    expected = rows_of(*(part[None] for part in merge(navs, Ps, BASE, weights)))[0]
    apart = (out - expected)[0]
    apart[at.OUT_POS + 1] = np.angle(np.exp(1j * apart[at.OUT_POS + 1]))
    assert np.abs(apart[at.OUT_POS : at.OUT_POS + 2]).max() * 6.4e6 < 1e-3  # m
    np.testing.assert_allclose(apart[at.OUT_POS + 2 : at.OUT_QUAT], 0.0, atol=1e-9)
    np.testing.assert_allclose(apart[at.OUT_QUAT : at.OUT_RATE], 0.0, atol=1e-5)
    np.testing.assert_allclose(out[0, at.OUT_VAR :], expected[0, at.OUT_VAR :], rtol=3e-4)
    assert np.pi >= out[0, at.OUT_POS + 1] >= -np.pi


def test_the_blended_misalignment_variance_is_about_the_level_axes() -> None:
    """GIVEN two members that differ by a tilt only WHEN blended THEN the spread is in the variance of that tilt."""
    navs = np.stack([navigator(yaw=1.5, pitch=0.0), navigator(yaw=1.5, pitch=0.0)])
    inject(navs[1], BASE, np.r_[0.04, np.zeros(14)])
    out = np.empty((1, at.OUT_COLUMNS))
    blend_rows(rows_of(navs, np.zeros((2, 15, 15))), np.array([0.5, 0.5]), 0, 1, out)
    np.testing.assert_allclose(out[0, at.OUT_VAR : at.OUT_VAR + 3], [0.02**2, 0.0, 0.0], atol=1e-9)
