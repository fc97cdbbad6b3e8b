"""The optional blocks: any subset of them makes a filter, and its states lie where the table says."""

import numpy as np
import pytest
from exact_motion import survey, times_of

from filter_start import SUBSETS, initial_covariance, names, plain_constants
from imu_run import run_imu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.filter.blocks import BLOCKS, GRAVITY, GYRO_MATRIX, WIND, blocks_of, state_count, with_block
from nav_pose_estimator.core.filter.error_state import error_between, inject
from nav_pose_estimator.core.filter.kalman import correct
from nav_pose_estimator.core.filter.strapdown import flush_covariance

every_subset = pytest.mark.parametrize("blocks", SUBSETS, ids=names)


def start_covariance(constants: np.ndarray) -> np.ndarray:
    return initial_covariance(
        constants,
        misalignment_sd=(0.01, 0.01, 0.1),
        velocity_sd=0.3,
        position_sd=2.0,
        gyro_bias_sd=1e-3,
        accel_bias_sd=0.05,
        block_sd=dict.fromkeys(BLOCKS, 0.01),
    )


def test_the_table_covers_its_part_of_the_nominal_state_without_gap_or_overlap() -> None:
    places = np.concatenate([np.arange(at.NAV_SIZE)[block.estimates] for block in BLOCKS])
    np.testing.assert_array_equal(places, np.arange(at.WIND, at.TIME))
    assert len(places) == at.OPTIONAL_STATES
    constants = np.concatenate([np.arange(at.CONSTANTS_SIZE)[part] for b in BLOCKS for part in (b.psd, b.rate)])
    assert len(set(constants.tolist())) == 2 * at.OPTIONAL_STATES


@every_subset
def test_states_lie_behind_each_other_in_the_order_of_the_table(blocks) -> None:
    constants = plain_constants(blocks)
    n = state_count(constants)
    states = [np.arange(n)[block.states(constants)] for block in blocks_of(constants)]
    assert blocks_of(constants) == blocks
    assert n == at.BASE_STATES + sum(block.size for block in blocks)
    np.testing.assert_array_equal(np.concatenate([np.arange(at.BASE_STATES), *states]), np.arange(n))
    assert all(constants[block.index] == -1.0 for block in BLOCKS if block not in blocks)


@every_subset
def test_every_choice_of_blocks_flies(blocks) -> None:
    """GIVEN a filter of these blocks WHEN it flies with positions THEN P is symmetric and positive definite, the noise
    of every block is in it, and what the filter lacks stays zero."""
    constants = plain_constants(blocks)
    n = state_count(constants)
    nav, P = survey().nav(0.0), start_covariance(constants)
    before = P.copy()
    rows = survey().imu_rows(times_of(2.0, 50.0))
    out = np.empty((len(rows), at.OUT_COLUMNS))
    H = np.zeros((3, n))
    H[:, at.DPOS : at.DPOS + 3] = np.eye(3)
    for i in range(0, len(rows), 25):
        run_imu(nav, P, constants, rows[i : i + 25], out[i : i + 25])
        flush_covariance(nav, P, constants)
        assert np.isfinite(correct(nav, P, constants, np.array([0.3, -0.2, 0.1]), H, np.eye(3)))
    scale = 1.0 / np.sqrt(np.diag(P))
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P * np.outer(scale, scale)).min() > 0.0
    for block in blocks:
        if block not in (GYRO_MATRIX, GRAVITY):  # these are observed
            own = block.states(constants)
            np.testing.assert_allclose(np.diag(P - before)[own], 2.0 * 1e-6, rtol=1e-6)
    for block in BLOCKS:
        if block not in blocks:
            assert not nav[block.estimates].any()


@every_subset
def test_an_error_goes_into_the_estimates_of_its_block_and_comes_back(blocks) -> None:
    constants = plain_constants(blocks)
    nav = survey().nav(1.0)
    other = nav.copy()
    error = 1e-3 * np.random.default_rng(1).normal(size=state_count(constants))
    inject(other, constants, error)
    for block in BLOCKS:
        missing = error[block.states(constants)] if block in blocks else np.zeros(block.size)
        np.testing.assert_allclose((other - nav)[block.estimates], missing, atol=1e-15)
    inject(other, constants, error_between(nav, other, constants))
    np.testing.assert_allclose(error_between(nav, other, constants), 0.0, atol=1e-8)
    np.testing.assert_allclose(other[at.GYRO_BIAS : at.TIME], nav[at.GYRO_BIAS : at.TIME], atol=1e-15)


def test_an_error_of_another_size_is_refused() -> None:
    """GIVEN a filter with a block WHEN an error comes without its states THEN nothing is read behind its end."""
    nav = survey().nav(1.0)
    with pytest.raises(ValueError, match="states of the filter"):
        inject(nav, plain_constants([BLOCKS[1]]), np.zeros(at.BASE_STATES))
    np.testing.assert_array_equal(nav, survey().nav(1.0))


@pytest.mark.parametrize(
    ("blocks", "block"),
    [(blocks, block) for blocks in SUBSETS for block in BLOCKS if block not in blocks],
    ids=lambda value: names(value) if isinstance(value, tuple) else value.name,
)
def test_a_block_is_put_in_at_its_place(blocks, block) -> None:
    """GIVEN a filter without a block WHEN it gets it THEN it is the filter made with it, and P has not moved."""
    constants = plain_constants(blocks)
    root = np.random.default_rng(2).normal(size=(state_count(constants),) * 2)
    P, cov = root @ root.T, 2.0 * np.eye(block.size) + 0.5
    wider, larger = with_block(constants, P, block, cov)
    assert blocks_of(wider) == tuple(b for b in BLOCKS if b in (*blocks, block))
    own = block.states(wider)
    np.testing.assert_array_equal(larger[own, own], cov)
    kept = np.delete(np.arange(len(larger)), own)
    np.testing.assert_array_equal(larger[np.ix_(kept, kept)], P)
    assert not larger[own][:, kept].any()


@every_subset
def test_a_checkpoint_holds_every_block(blocks) -> None:
    """GIVEN a filter with a checkpoint WHEN everything changes and it goes back THEN it is as it was."""
    constants = plain_constants(blocks)
    vector = memory.make(constants, slots=2, period=1.0)
    n = state_count(constants)
    head = memory.HEAD + n * n
    vector[memory.NAV : memory.CONSTANTS] = survey().nav(1.0)
    vector[memory.HEAD : head] = start_covariance(constants).ravel()
    for block in blocks:
        vector[memory.NAV : memory.CONSTANTS][block.estimates] = 0.25
    memory.add_checkpoint(vector)
    before = vector[:head].copy()
    vector[memory.NAV : memory.CONSTANTS] += 1.0
    vector[memory.HEAD : head] = 7.0
    memory.restore_before(vector, 5.0)
    np.testing.assert_array_equal(vector[:head], before)


def test_a_size_says_nothing_of_the_blocks() -> None:
    """GIVEN two filters of 24 states or so that differ in their blocks WHEN corrected THEN each moves its own."""
    assert state_count(plain_constants([GYRO_MATRIX])) == 24
    others = [block for block in BLOCKS if block.name in ("dvl", "depth")]
    assert state_count(plain_constants(others)) == 24
    nav = survey().nav(0.0)
    inject(nav, plain_constants(others), np.full(24, 1e-3))
    assert not nav[GYRO_MATRIX.estimates].any()
    assert not nav[WIND.estimates].any()
