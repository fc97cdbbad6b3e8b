"""One second of an IMU in a few numbers: what the checks of its physics look at."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.filter import layout as at

_COMPLETE = 0.8  # s that a second's samples have to span
_SETS_APART = 20.0  # deviations of the difference between every other sample and the rest
_APART_RATE, _APART_FORCE = 0.1, 0.5  # rad/s, m/s^2: the difference itself


@dataclass(frozen=True, eq=False)
class ImuSecond:
    """What the IMU said over one second, in body axes; ``end`` engine time [s]."""

    end: float
    samples: int
    rate: np.ndarray
    """(3,) rad/s, mean."""
    force: np.ndarray
    """(3,) m/s^2, mean."""
    norm: float
    """m/s^2, mean of the specific force's norm."""
    vibration: float
    """m/s^2: deviation of the specific force from sample to sample."""
    spread: np.ndarray
    """(6,) largest less smallest value of each axis of rate and force."""
    interleaved: bool
    """Every other sample belongs to another IMU."""

    @property
    def gravity(self) -> float:
        """m/s^2, norm of the mean force: vibration, which has no mean, is not in it."""
        return math.sqrt(float(self.force @ self.force))

    @property
    def turn(self) -> float:
        """rad/s, norm of the mean rate."""
        return math.sqrt(float(self.rate @ self.rate))


def second_of(rows: np.ndarray, end: float) -> ImuSecond | None:
    """The numbers of IMU rows (N, 7) of one second up to ``end``; None where too much of it is missing."""
    if len(rows) < 5 or rows[-1, at.IMU_T] - rows[0, at.IMU_T] < _COMPLETE:
        return None
    values = rows[:, at.IMU_GYRO :]
    mean = values.sum(axis=0) / len(values)
    force = values[:, 3:]
    steps = force[1:] - force[:-1]
    return ImuSecond(
        end=end,
        samples=len(rows),
        rate=mean[:3],
        force=mean[3:],
        norm=float(np.sqrt((force * force).sum(axis=1)).sum()) / len(rows),
        vibration=math.sqrt(0.5 * float((steps * steps).sum()) / len(steps)),
        spread=values.max(axis=0) - values.min(axis=0),
        interleaved=_is_interleaved(values),
    )


def _is_interleaved(values: np.ndarray) -> bool:
    """Whether every other sample lies elsewhere by the same amount, on some axis: demodulated at half the rate."""
    apart = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    apart[1::2] *= -1.0
    count = len(apart)
    mean = apart.sum(axis=0) / count
    noise = np.sqrt(((apart - mean) ** 2).sum(axis=0) / count**2)
    sure = np.abs(mean) > _SETS_APART * noise
    large = np.abs(mean) > np.repeat((_APART_RATE, _APART_FORCE), 3)
    return bool((sure & large).any())
