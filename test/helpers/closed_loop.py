"""Errors of the strapdown navigator with the data of an ideal IMU."""

from typing import NamedTuple

import numpy as np

from imu_run import run_imu
from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as L
from nav_pose_estimator.core.filter.blocks import set_blocks
from nav_pose_estimator.core.numerics.rotation import quat_conjugate_many, quat_multiply_many
from nav_pose_estimator.sim.trajectories import Truth
from rotations import rotation_vectors


class Errors(NamedTuple):
    """Norms of the errors after each sample (N - 1,): m, m/s, rad."""

    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray


def navigate(truth: Truth, gyro: np.ndarray | None = None, accel: np.ndarray | None = None) -> Errors:
    """Start on the truth and integrate the truth's IMU, or another one (N, 3), without any correction."""
    gyro = truth.gyro if gyro is None else gyro
    accel = truth.accel if accel is None else accel
    nav = np.zeros(L.NAV_SIZE)
    nav[L.LAT], nav[L.LON], nav[L.ALT], nav[L.TIME] = truth.lat[0], truth.lon[0], truth.alt[0], truth.t[0]
    nav[L.VEL : L.VEL + 3], nav[L.QUAT : L.QUAT + 4] = truth.v_n[0], truth.q_nb[0]
    nav[L.PREV_RATE : L.PREV_RATE + 3], nav[L.PREV_FORCE : L.PREV_FORCE + 3] = gyro[0], accel[0]
    constants = np.zeros(L.CONSTANTS_SIZE)
    constants[L.COV_PERIOD], constants[L.GAP_DT] = 1e9, 1.0
    set_blocks(constants, ())
    out = np.empty((len(truth) - 1, L.OUT_COLUMNS))
    run_imu(nav, np.zeros((15, 15)), constants, np.column_stack([truth.t, gyro, accel])[1:], out)

    origin = (truth.lat[0], truth.lon[0], truth.alt[0])
    there = lla_to_enu(*out[:, L.OUT_POS : L.OUT_POS + 3].T, *origin)
    true = lla_to_enu(truth.lat[1:], truth.lon[1:], truth.alt[1:], *origin)
    turn = quat_multiply_many(out[:, L.OUT_QUAT : L.OUT_QUAT + 4], quat_conjugate_many(truth.q_nb[1:]))
    return Errors(
        np.linalg.norm(there - true, axis=1),
        np.linalg.norm(out[:, L.OUT_VEL : L.OUT_VEL + 3] - truth.v_n[1:], axis=1),
        np.linalg.norm(rotation_vectors(turn), axis=1),
    )
