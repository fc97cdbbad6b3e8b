"""Rests of a recording: the gyroscope bias, and with rests on six sides the errors of the accelerometer."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from nav_pose_estimator.core.numerics.units import STANDARD_GRAVITY
from nav_pose_estimator.engine.samples import ImuBlock

_WINDOW = 2.0  # s: length of the windows
_GYRO_SPREAD, _FORCE_SPREAD = 0.02, 0.35  # rad/s, m/s^2: largest standard deviation per axis at rest
_SLOWEST_TURN = 0.1  # rad/s: largest mean rate at rest
_OTHER_SIDE = math.radians(40.0)  # smallest angle between the forces on two sides
_SIDES = 6  # number of sides that the accelerometer's errors need


@dataclass(frozen=True)
class Rests:
    """Mean rates ``gyro`` (N, 3) [rad/s] and forces ``accel`` (N, 3) [m/s^2] of N windows of rest, IMU axes."""

    gyro: np.ndarray
    accel: np.ndarray

    @property
    def gyro_bias(self) -> np.ndarray | None:
        """Gyroscope bias (3,) [rad/s]; None without a rest."""
        return np.median(self.gyro, axis=0) if len(self.gyro) else None

    def sides(self) -> np.ndarray:
        """Mean forces (M, 3) [m/s^2], one for each clearly different attitude."""
        kept: list[np.ndarray] = []
        for force in self.accel:
            unit = force / np.linalg.norm(force)
            if all(unit @ (k / np.linalg.norm(k)) < math.cos(_OTHER_SIDE) for k in kept):
                kept.append(force)
        return np.array(kept).reshape(-1, 3)


def find_rests(imu: ImuBlock) -> Rests:
    """Find the windows without rotation and vibration."""
    t = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
    edges = np.searchsorted(t, np.arange(0.0, t[-1], _WINDOW))
    gyro, accel = [], []
    for begin, end in itertools.pairwise(edges):
        if end - begin < 10:
            continue
        w, f = imu.gyro[begin:end], imu.accel[begin:end]
        still = w.std(axis=0).max() < _GYRO_SPREAD and f.std(axis=0).max() < _FORCE_SPREAD
        if still and np.abs(w.mean(axis=0)).max() < _SLOWEST_TURN:
            gyro.append(w.mean(axis=0))
            accel.append(f.mean(axis=0))
    return Rests(np.array(gyro).reshape(-1, 3), np.array(accel).reshape(-1, 3))


def joined(parts: list[Rests]) -> Rests:
    """Join the rests of several recordings."""
    return Rests(np.concatenate([p.gyro for p in parts]), np.concatenate([p.accel for p in parts]))


def accelerometer_errors(sides: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Bias (3,) [m/s^2] and scale (3,) in ``f = (1 + scale) true + bias`` from six sides (M, 3); None with fewer.

    Source: the multi-position test of IEEE Std 1293, reduced to the errors that |f| = g makes observable.
    """
    if len(sides) < _SIDES:
        return None

    def misfit(x: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm((sides - x[:3]) / (1.0 + x[3:]), axis=1) - STANDARD_GRAVITY)

    x = least_squares(misfit, np.zeros(6)).x
    return x[:3], x[3:]
