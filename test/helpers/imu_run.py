"""The navigator's propagation loop on a separate state and covariance."""

import math

import numpy as np

from nav_pose_estimator.core.filter import memory


def run_imu(nav: np.ndarray, P: np.ndarray, constants: np.ndarray, rows: np.ndarray, out: np.ndarray) -> None:
    """Carry ``nav`` and ``P`` over IMU ``rows`` (N, 7) in place; ``out`` (N, OUT_COLUMNS) gets the state after each."""
    vector = memory.make(constants, slots=1, period=math.inf)
    covariance = slice(memory.HEAD, memory.HEAD + P.size)
    vector[memory.NAV : memory.CONSTANTS], vector[covariance] = nav, P.ravel()
    memory.add_checkpoint(vector)
    memory.run_block(vector, np.ascontiguousarray(rows), 0, len(rows), math.inf, out)
    nav[:], P[:] = vector[memory.NAV : memory.CONSTANTS], vector[covariance].reshape(P.shape)
