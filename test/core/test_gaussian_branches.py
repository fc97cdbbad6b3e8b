"""Mixtures of navigators: the error between two of them, and the one Gaussian that several make together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import memory as filter_memory
from nav_pose_estimator.core.filter.kalman import inject
from nav_pose_estimator.core.filter.mixture import blend_rows, error_between, merge, with_wind
from nav_pose_estimator.core.filter.strapdown import write_output
from nav_pose_estimator.core.numerics.rotation import quat_from_euler, quat_to_matrix

SIZES = (15, 17, 24, 26)
ESTIMATED = [*range(at.TIME)]  # everything that an observation may correct


def navigator(lat: float = 0.8, lon: float = 0.2, yaw: float = 2.0, pitch: float = -0.1) -> np.ndarray:
    """A moving vehicle with biases, wind and gyro matrix."""
    nav = np.zeros(at.NAV_SIZE)
    nav[at.LAT : at.VEL] = lat, lon, 300.0
    nav[at.VEL : at.VEL + 3] = 4.0, -7.0, 1.5
    nav[at.QUAT : at.QUAT + 4] = quat_from_euler(0.2, pitch, yaw)
    nav[at.GYRO_BIAS : at.WIND] = 0.01, -0.02, 0.005, 0.1, -0.05, 0.2
    nav[at.WIND : at.GYRO_MATRIX] = 1.0, -2.0
    nav[at.GYRO_MATRIX : at.TIME] = 1e-3 * np.arange(9)
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
    n=st.sampled_from(SIZES),
    seed=st.integers(0, 10**6),
    turn=st.floats(0.0, 3.1),
    lat=st.floats(-1.5, 1.5),
    lon=st.sampled_from([0.2, -3.0, np.pi - 1e-7, -np.pi]),
    yaw=st.floats(-np.pi, np.pi),
)
def test_injecting_the_error_between_two_navigators_gives_the_other(n, seed, turn, lat, lon, yaw) -> None:
    """GIVEN two navigators, up to half a turn and some hundred metres apart, also across the date line
    WHEN the error between them is taken out of one THEN it is the other, to a micrometre per metre."""
    random = np.random.default_rng(seed)
    nav = navigator(lat, lon, yaw)
    other = nav.copy()
    apart = small_errors(n, random)
    axis = random.standard_normal(3)
    apart[:3] = turn * axis / np.linalg.norm(axis)
    inject(other, apart)
    back = other.copy()
    inject(back, error_between(nav, other, n))
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
    np.testing.assert_allclose(error_between(nav, flipped, 15), 0.0, atol=1e-15)


@pytest.mark.parametrize("n", SIZES)
def test_a_mixture_has_the_moments_of_its_members(n: int) -> None:
    """GIVEN three weighted Gaussians about one vehicle WHEN merged THEN mean and covariance are those of the mixture.

    Closed form in the error state of the strongest member, where the members are vectors.
    """
    random = np.random.default_rng(n)
    weights = np.array([0.2, 0.5, 0.3])
    truth = navigator()
    errors = np.stack([small_errors(n, random, 1e-3) for _ in weights])
    navs, Ps = np.stack([truth.copy() for _ in weights]), np.stack([random_covariance(n, random) for _ in weights])
    for nav, error in zip(navs, errors, strict=True):
        inject(nav, error)
    nav, P = merge(navs, Ps, weights)

    mean = weights @ errors
    found = error_between(nav, truth, n)  # the error of the truth were the mixture true
    np.testing.assert_allclose(found, mean, atol=1e-6)
    away = errors - mean
    expected = np.einsum("k,kij->ij", weights, Ps) + np.einsum("k,ki,kj->ij", weights, away, away)
    np.testing.assert_allclose(P, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("n", SIZES)
def test_a_mixture_has_the_moments_of_drawn_samples(n: int) -> None:
    """GIVEN members some metres and degrees apart WHEN 40 000 vehicles are drawn from them
    THEN their mean error about the merged state is nought and their covariance is the merged one."""
    random = np.random.default_rng(10 + n)
    weights = np.array([0.35, 0.65])
    errors = np.stack([small_errors(n, random, 0.05) for _ in weights])
    navs = np.stack([navigator() for _ in weights])
    for nav, error in zip(navs, errors, strict=True):
        inject(nav, error)
    Ps = np.stack([1e-4 * random_covariance(n, random) for _ in weights])
    nav, P = merge(navs, Ps, weights)

    drawn = np.empty((40_000, n))
    for row, k in enumerate(random.choice(2, len(drawn), p=weights)):
        drawn[row, 0] = k
    members = drawn[:, 0].astype(int)
    for k in range(2):
        own = members == k
        centre = error_between(navs[k], nav, n)
        drawn[own] = centre + random.standard_normal((own.sum(), n)) @ np.linalg.cholesky(Ps[k]).T
    sd = np.sqrt(np.diag(P))
    assert np.all(np.abs(drawn.mean(axis=0)) < 5.0 * sd / np.sqrt(len(drawn)) + 1e-4 * sd)
    np.testing.assert_allclose(np.cov(drawn.T) / np.outer(sd, sd), P / np.outer(sd, sd), atol=0.04)


def test_one_member_is_left_as_it_is() -> None:
    random = np.random.default_rng(1)
    nav, P = navigator(), random_covariance(17, random)
    merged_nav, merged_P = merge(nav[None], P[None], np.ones(1))
    np.testing.assert_allclose(merged_nav, nav, rtol=1e-15)
    np.testing.assert_array_equal(merged_P, P)


def test_the_integrators_memory_is_the_strongest_members() -> None:
    navs = np.stack([navigator(), navigator()])
    navs[:, at.TIME :] = [[1.0], [2.0]]
    nav, _ = merge(navs, np.stack([np.eye(15)] * 2), np.array([0.3, 0.7]))
    np.testing.assert_array_equal(nav[at.TIME :], navs[1, at.TIME :])


@pytest.mark.parametrize("n", [15, 24])
def test_the_wind_block_comes_and_goes_without_a_trace(n: int) -> None:
    """GIVEN a covariance with or without gyro matrix WHEN the wind block is put in THEN it stands behind the base
    states, correlated with nothing, and taking it out gives the same bits."""
    P = random_covariance(n, np.random.default_rng(n))
    cov = np.array([[2.5, 0.3], [0.3, 1.5]])
    wider = with_wind(P, cov)
    wind = slice(at.BASE_STATES, at.BASE_STATES + at.WIND_STATES)
    np.testing.assert_array_equal(wider[wind, wind], cov)
    assert not wider[wind, : at.BASE_STATES].any()
    assert not wider[wind, at.BASE_STATES + at.WIND_STATES :].any()
    np.testing.assert_array_equal(wider[: at.BASE_STATES, : at.BASE_STATES], P[: at.BASE_STATES, : at.BASE_STATES])
    np.testing.assert_array_equal(mixed(navigator()[None], wider[None], np.ones(1))[1], P)


def mixed(navs: np.ndarray, Ps: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nominal state and covariance of a filter without wind block that has become the mixture of some with it."""
    n = Ps.shape[1]
    branches = np.stack([filter_memory.make(np.zeros(at.CONSTANTS_SIZE), n, 1, 1.0) for _ in navs])
    branches[:, filter_memory.NAV : filter_memory.CONSTANTS] = navs
    branches[:, filter_memory.HEAD : filter_memory.HEAD + n * n] = Ps.reshape(len(Ps), -1)
    trunk = filter_memory.make(np.zeros(at.CONSTANTS_SIZE), n - at.WIND_STATES, 1, 1.0)
    filter_memory.mix(branches, weights, trunk)
    P = trunk[filter_memory.HEAD : filter_memory.HEAD + (n - at.WIND_STATES) ** 2]
    return trunk[filter_memory.NAV : filter_memory.CONSTANTS], P.reshape(n - at.WIND_STATES, -1)


@pytest.mark.parametrize("n", [15, 24])
def test_a_filter_becomes_the_mixture_of_its_branches(n: int) -> None:
    """GIVEN branches with a wind block WHEN mixed into a filter without THEN that is their mixture."""
    random = np.random.default_rng(6)
    navs = np.stack([navigator(), navigator(yaw=1.6)])
    Ps = np.stack([with_wind(random_covariance(n, random), 2.0) for _ in navs])
    weights = np.array([0.3, 0.7])
    nav, P = merge(navs, Ps, weights)
    others = [*range(at.BASE_STATES), *range(at.BASE_STATES + at.WIND_STATES, len(P))]
    mixed_nav, mixed_P = mixed(navs, Ps, weights)
    np.testing.assert_array_equal(mixed_nav, nav)
    np.testing.assert_array_equal(mixed_P, P[np.ix_(others, others)])


def rows_of(navs: np.ndarray, Ps: np.ndarray) -> np.ndarray:
    """Output rows (K, 1, OUT_COLUMNS) of navigators."""
    rows = np.empty((len(navs), 1, at.OUT_COLUMNS))
    for nav, P, out in zip(navs, Ps, rows, strict=True):
        write_output(nav, P, out, 0)
    return rows


@pytest.mark.parametrize("lon", [0.2, np.pi - 1e-7])
def test_blended_rows_are_the_row_of_the_mixture(lon: float) -> None:
    """GIVEN two members some metres apart, also on both sides of the date line
    WHEN their output rows are blended THEN position, velocity, attitude and variances are the mixture's."""
    random = np.random.default_rng(5)
    weights = np.array([0.4, 0.6])
    navs = np.stack([navigator(lon=lon), navigator(lon=lon)])
    inject(navs[1], np.r_[0.02, -0.01, 0.03, 1.0, -2.0, 0.1, -6.0, 3.0, 1.0, np.zeros(6)])
    Ps = np.stack([random_covariance(15, random) for _ in weights])
    out = np.empty((1, at.OUT_COLUMNS))
    blend_rows(rows_of(navs, Ps), weights, 0, 1, out)
    expected = rows_of(*(part[None] for part in merge(navs, Ps, weights)))[0]
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
    inject(navs[1], np.r_[0.04, np.zeros(14)])
    out = np.empty((1, at.OUT_COLUMNS))
    blend_rows(rows_of(navs, np.zeros((2, 15, 15))), np.array([0.5, 0.5]), 0, 1, out)
    np.testing.assert_allclose(out[0, at.OUT_VAR : at.OUT_VAR + 3], [0.02**2, 0.0, 0.0], atol=1e-9)
