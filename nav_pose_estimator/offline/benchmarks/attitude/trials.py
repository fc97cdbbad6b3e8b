"""Recorded motions with optical truth, modifications of them, and the error measure of the BROAD benchmark.

Laidig, Caruso, Cereatti, Seel: BROAD - A Benchmark for Robust Inertial Orientation Estimation. Data 6(7):72, 2021.
"""

import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.numerics.rotation import quat_conjugate_many, quat_multiply_many
from nav_pose_estimator.errors import UserError

Array = np.ndarray
_COLD_START = 1.0  # s of rest that remain in a cold start
_BIAS = np.radians((0.5, -0.5, 0.5))  # rad/s: added gyroscope bias
_SLOWER = 3  # number of samples that are averaged to one


@dataclass(frozen=True)
class Trial:
    """One motion: ``gyro`` [rad/s], ``accel`` [m/s^2], ``mag`` (N, 3), truth ``q_ref`` (N, 4) body to ENU, NaN unknown.

    ``judged`` (N,): samples that are evaluated; ``rate`` [Hz].
    """

    name: str
    rate: float
    gyro: Array
    accel: Array
    mag: Array
    q_ref: Array
    judged: Array

    @property
    def t(self) -> Array:
        """Times (N,) [s]."""
        return np.arange(len(self.gyro)) / self.rate


@dataclass(frozen=True)
class Rmse:
    """Root mean squares over the judged samples of one trial, rad."""

    inclination: float
    heading: float
    total: float


def load_trial(path: Path) -> Trial:
    """Read an npz with gyr, acc, mag, quat, movement, fs and, if there, name; ``UserError`` for anything else."""
    try:
        with np.load(path) as data:
            fields = {key: data[key] for key in ("gyr", "acc", "mag", "quat", "movement", "fs")}
            name = str(data["name"]) if "name" in data else path.stem
    except KeyError as error:
        raise UserError(f"{path} has no array {error.args[0].split()[0]}: it is not an attitude trial") from None
    except (ValueError, zipfile.BadZipFile, EOFError):
        raise UserError(f"{path} is not an npz file") from None
    gyro, accel, mag, q_ref = (fields[key].astype(float) for key in ("gyr", "acc", "mag", "quat"))
    n, rate = len(gyro), float(fields["fs"])
    shapes = (gyro.shape, accel.shape, mag.shape, q_ref.shape, fields["movement"].shape)
    if shapes != ((n, 3), (n, 3), (n, 3), (n, 4), (n,)) or not rate > 0.0:
        raise UserError(f"{path}: the arrays' shapes {shapes} do not fit together, or fs {rate:g} is not positive")
    return Trial(name, rate, gyro, accel, mag, q_ref, fields["movement"].astype(bool))


def errors(q_est: Array, q_ref: Array) -> tuple[Array, Array, Array]:
    """Inclination, heading and total error (N,) [rad] of ``q_est`` (N, 4) against ``q_ref`` (N, 4).

    The error is a rotation in the earth frame, dq = q_est (x) conj(q_ref). The heading error is its rotation about the
    vertical, the inclination the remaining rotation about a horizontal axis.
    """
    dq = quat_multiply_many(q_est, quat_conjugate_many(q_ref))
    w, x, y, z = np.moveaxis(dq, -1, 0)
    inclination = 2.0 * np.arcsin(np.clip(np.hypot(x, y), 0.0, 1.0))
    heading = 2.0 * np.abs(np.arctan2(np.abs(z), np.abs(w)))
    return inclination, heading, 2.0 * np.arccos(np.clip(np.abs(w), 0.0, 1.0))


def rmse(q_est: Array, trial: Trial) -> Rmse:
    """Root mean squares over judged samples with a truth. A NaN in the estimate is a failure: the result is NaN."""
    use = trial.judged & ~np.isnan(trial.q_ref).any(axis=1)
    parts = errors(q_est[use], trial.q_ref[use])
    return Rmse(*(float(np.sqrt(np.mean(part**2))) for part in parts))


def cold_start(trial: Trial) -> Trial:
    """Without the rest before the motion except one second, so that the bias cannot be estimated before."""
    first = max(0, int(np.flatnonzero(trial.judged)[0] - _COLD_START * trial.rate))
    arrays = ("gyro", "accel", "mag", "q_ref", "judged")
    return replace(trial, **{name: getattr(trial, name)[first:] for name in arrays})


def cold_start_with_bias(trial: Trial) -> Trial:
    """A cold start of a gyroscope that is off by 0.5 deg/s on each axis."""
    cold = cold_start(trial)
    return replace(cold, gyro=cold.gyro + _BIAS)


def third_of_the_rate(trial: Trial) -> Trial:
    """Means of three samples each, stamped with the last of them."""
    n = len(trial.gyro) // _SLOWER * _SLOWER
    means = {k: getattr(trial, k)[:n].reshape(-1, _SLOWER, 3).mean(axis=1) for k in ("gyro", "accel", "mag")}
    last = {k: getattr(trial, k)[_SLOWER - 1 : n : _SLOWER] for k in ("q_ref", "judged")}
    return replace(trial, rate=trial.rate / _SLOWER, **means, **last)


CONDITIONS: dict[str, Callable[[Trial], Trial]] = {
    "recorded": lambda trial: trial,
    "cold_start": cold_start,
    "cold_start_bias": cold_start_with_bias,
    "third_rate": third_of_the_rate,
}
"""Modifications of a trial by name."""
