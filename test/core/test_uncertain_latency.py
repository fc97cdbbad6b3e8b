"""The latency of GNSS as a consider parameter: it is in the covariance of solutions, not in that of the filter."""

import math

import numpy as np

from filter_start import plain_constants
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.filter.strapdown import note_gnss

N = at.BASE_STATES


def solution_after(delay_sd: float, velocity: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Solution (SOLUTION_SIZE,) at rest after a GNSS observation at ``velocity``, and P of the filter."""
    constants = plain_constants(gnss_delay_sd=delay_sd)
    vector = memory.make(constants, 2, math.inf)
    nav = vector[memory.NAV : memory.CONSTANTS]
    nav[at.QUAT], nav[at.LAT] = 1.0, 0.8
    nav[at.VEL : at.VEL + 3] = velocity
    note_gnss(nav)
    nav[at.VEL : at.VEL + 3] = 0.0  # the vehicle stops in an outage: the displacement stays
    P = vector[memory.HEAD : memory.HEAD + N * N]
    P[:] = np.diag(np.arange(1.0, N + 1.0)).ravel()
    rows, solution = np.zeros((2, at.IMU_COLUMNS)), np.zeros(at.SOLUTION_SIZE)
    memory.run_sample(vector, rows, 1, solution, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 9.81)
    return solution, P.reshape(N, N).copy()


def test_the_displacement_by_the_latency_is_added_to_the_solution_only() -> None:
    """GIVEN an uncertain latency WHEN a solution is written THEN row and covariance have its displacement, P not."""
    sure, P_sure = solution_after(0.0, (10.0, -4.0, 2.0))
    unsure, P_unsure = solution_after(0.25, (10.0, -4.0, 2.0))
    np.testing.assert_array_equal(P_unsure, P_sure)
    away = 0.25 * np.array([10.0, -4.0, 2.0])
    added = (unsure - sure)[at.SOLUTION_COV :].reshape(N, N)
    expected = np.zeros((N, N))
    expected[at.DPOS : at.DPOS + 3, at.DPOS : at.DPOS + 3] = np.outer(away, away)
    np.testing.assert_allclose(added, expected, atol=1e-12)
    variances = (unsure - sure)[at.OUT_VAR : at.OUT_COLUMNS]
    np.testing.assert_allclose(variances, expected.diagonal()[:9], atol=1e-12)
