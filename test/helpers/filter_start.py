"""Filters that start without an alignment: plain constants and a diagonal covariance."""

import itertools
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import BLOCKS, Block, GaussMarkov, enlarged, set_blocks
from nav_pose_estimator.core.filter.constants import make_constants

SUBSETS = [chosen for size in range(len(BLOCKS) + 1) for chosen in itertools.combinations(BLOCKS, size)]
"""All subsets of the optional blocks."""


def names(blocks: Iterable[Block]) -> str:
    """Name of a test for a subset of blocks."""
    return "+".join(block.name for block in blocks) or "none"


def plain_constants(blocks: Iterable[Block] = (), **changes: float) -> np.ndarray:
    """Constants of a filter with ``blocks``, which are random walks of 0.001 per root second."""
    numbers = {
        "gyro_noise": 2e-4,
        "accel_noise": 3e-3,
        "gyro_bias_sd": 4e-5,
        "gyro_bias_tau": 300.0,
        "accel_bias_sd": 5e-3,
        "accel_bias_tau": 300.0,
        "covariance_period": 0.02,
        "gap_dt": 0.5,
        "gap_rate_sd": 0.3,
        "gap_accel_sd": 2.0,
    }
    return make_constants(**(numbers | changes), blocks={block: GaussMarkov(1e-3) for block in blocks})


def initial_covariance(
    constants: np.ndarray,
    *,
    misalignment_sd: ArrayLike,
    velocity_sd: ArrayLike,
    position_sd: ArrayLike,
    gyro_bias_sd: ArrayLike,
    accel_bias_sd: ArrayLike,
    block_sd: Mapping[Block, float] | None = None,
) -> np.ndarray:
    """P (n, n) from deviations in SI units, one number or three, one per axis: East, North, Up or x, y, z."""
    sd = np.zeros(at.BASE_STATES)
    for start, value in (
        (at.PHI, misalignment_sd),
        (at.DVEL, velocity_sd),
        (at.DPOS, position_sd),
        (at.D_GYRO_BIAS, gyro_bias_sd),
        (at.D_ACCEL_BIAS, accel_bias_sd),
    ):
        sd[start : start + 3] = value
    base = constants.copy()
    set_blocks(base, ())
    return enlarged(np.diag(sd**2), base, constants, {block: sd**2 for block, sd in (block_sd or {}).items()})
