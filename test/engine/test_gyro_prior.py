"""The prior of the gyroscope's scale factors is taken back: the filter is as if it had started with a wide one."""

import numpy as np

from filter_start import initial_covariance, plain_constants
from nav_pose_estimator.core.alignment.gyro_evidence import SIZE, GyroEvidence
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX
from nav_pose_estimator.core.filter.kalman import correct
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.observation import FilterView
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.gyroscope.prior import SCALES, WIDE
from nav_pose_estimator.engine.sensors.gyroscope.watch import Second

NARROW = 0.01
CONSTANTS = plain_constants([GYRO_MATRIX])
OWN = GYRO_MATRIX.states(CONSTANTS).start + SCALES


def start(scale_sd: float) -> FilterView:
    """A filter whose scale factors have this deviation, whose misalignments stay narrow, and that has turned."""
    P = initial_covariance(
        CONSTANTS,
        misalignment_sd=0.02,
        velocity_sd=0.1,
        position_sd=1.0,
        gyro_bias_sd=1e-3,
        accel_bias_sd=0.05,
        block_sd={GYRO_MATRIX: NARROW},
    )
    P[OWN, OWN] = scale_sd**2
    turned = np.eye(len(P))
    turned[at.PHI : at.PHI + 3, OWN] = -np.diag([0.3, 0.2, 1.5])  # rad about each axis
    turned[at.DVEL : at.DVEL + 3, at.PHI : at.PHI + 3] = np.array([[0, -9.8, 2.0], [9.8, 0, -1.0], [-2.0, 1.0, 0]])
    nav = np.zeros(at.NAV_SIZE)
    nav[at.QUAT] = 1.0
    return FilterView(nav, turned @ P @ turned.T, CONSTANTS)


def observe(f: FilterView) -> None:
    """Small velocity errors, so that corrections of the attitude stay linear."""
    H = np.zeros((3, len(f.P)))
    H[:, at.DVEL : at.DVEL + 3] = np.eye(3)
    correct(*f, np.array([2e-4, -3e-4, 1e-4]), H, 0.01 * np.eye(3))


def test_the_release_is_that_of_a_filter_that_started_wide() -> None:
    """GIVEN filters of narrow and of wide prior with the same observation WHEN the narrow one is released
    THEN states and covariance of both are equal."""
    narrow, wide = start(NARROW), start(WIDE)
    observe(narrow)
    observe(wide)
    evidence = GyroEvidence()
    evidence.variance = NARROW**2
    prior = PoseEstimator(Parameters(), attitude=False).sins.run.gyro_matrix
    prior.settle(prior.observe(evidence, 0.0, 0), narrow)
    np.testing.assert_allclose(narrow.P, wide.P, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(narrow.nav, wide.nav, rtol=1e-4, atol=1e-7)
    assert np.linalg.eigvalsh(narrow.P)[0] > 0.0


def test_a_prior_that_is_wide_already_is_left_alone() -> None:
    """GIVEN a filter with a wide prior WHEN the release of a narrow one arrives late THEN nothing changes."""
    wide = start(WIDE)
    before = wide.P.copy()
    evidence = GyroEvidence()
    evidence.variance = NARROW**2
    prior = PoseEstimator(Parameters(), attitude=False).sins.run.gyro_matrix
    prior.settle(prior.observe(evidence, 0.0, 0), wide)
    assert np.array_equal(wide.P, before)
    assert not wide.nav[GYRO_MATRIX.estimates].any()


def test_a_doubt_outlives_a_reset() -> None:
    """GIVEN a gyroscope in doubt WHEN the navigator starts again THEN the doubt stays, and the prior is released."""
    sins = PoseEstimator(Parameters(), attitude=False).sins
    seconds = [
        Second(np.full(SIZE, mean), NARROW**2 * share * np.eye(SIZE), np.zeros(3), 1.0)
        for mean, share in ((0.0, 1.0), (0.05, 0.5))
    ]
    released = [sins.run.gyro_watch.second(second, sins.journal, 0) for second in seconds]
    assert released == [False, True]
    sins.reset(0, "test")
    assert "gyroscope" in sins.status().doubt
    assert sins.run.gyro_watch.second(seconds[0], sins.journal, 0)
    assert sins.status().counters["imu.gyroscope.doubted"] == 1
