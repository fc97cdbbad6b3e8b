"""Half-second epochs of the true motion, in the form in which the outage learning receives them."""

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.sim.scenarios import generate

SECONDS = 150.0


def epochs_of(scenario: str, seed: int, seconds: float = SECONDS) -> np.ndarray:
    """Epochs (N, COLUMNS) of a moving vehicle, with a velocity sigma of 3 cm/s."""
    truth = generate(scenario, seconds, seed, "perfect", imu_rate=50.0).truth
    rows = np.zeros((len(truth), at.OUT_COLUMNS))
    rows[:, at.OUT_QUAT : at.OUT_QUAT + 4] = truth.q_nb
    rows[:, at.OUT_VEL : at.OUT_VEL + 3] = truth.v_n
    rows[:, at.OUT_FORCE : at.OUT_FORCE + 3] = truth.accel
    rows[:, at.OUT_RATE : at.OUT_RATE + 3] = truth.gyro
    epochs = np.array([me.epoch(truth.t[i + 24], rows[i : i + 25]) for i in range(25 * 40, len(rows) - 25, 25)])
    noise = 0.03 * np.random.default_rng(seed).standard_normal((len(epochs), 3))
    epochs[:, me.BODY_VELOCITY : me.VELOCITY] += noise
    return epochs
