"""How a vehicle moves, learned from its flight: it hovers or it travels, and each regime has its own statistics.

A multirotor that hovers keeps its velocity near zero and hardly accelerates; one that travels does neither. Velocity
spread and activity (``motion_epochs.activity``) of both regimes are estimated from the flight so far, shrunk towards
what is usual, so that a young flight has sensible values, too. A vehicle that never slows down (a fixed wing) has one
regime only.
"""

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.motion.epochs import PERIOD, VELOCITY, activity

SLOW = 0.8  # m/s: slower counts as hovering
_ABLE = 5.0  # m/s: a vehicle that spends a tenth of its flight below this can hover
_SHARE = 10.0  # percent
_FLOWN = 20.0  # s since the vehicle was fast for the first time that tell whether it can hover, too
_RECENT = round(5.0 / PERIOD)  # epochs that say in which regime the vehicle is
_USUAL_TIME = 20.0  # s of flight that the usual values are worth
_USUAL_HOVER, _USUAL_TRAVEL = 0.3, 2.0  # m/s, each axis
_USUAL_ACTIVITY = ((math.log(0.9), 0.9), (math.log(0.15), 0.6))  # travel, hover: mean and deviation of the logarithm
_DOUBT = 0.02  # no regime is certain


@dataclass(frozen=True)
class MotionRegimes:
    """Variance of a velocity component [m^2/s^2] and (mean, variance) of the activity, each for travel and hover."""

    can_hover: bool
    travel_var: float
    hover_var: float
    travel_activity: tuple[float, float]
    hover_activity: tuple[float, float]
    hover_probability: float


def learn_regimes(epochs: np.ndarray, can_hover: bool | None = None) -> MotionRegimes:
    """Statistics of aided epochs (N, COLUMNS) in order of time; N may be zero.

    ``can_hover``: what the class of the vehicle says; None where it is unknown and the flight has to show it.
    """
    square = np.square(epochs[:, VELOCITY : VELOCITY + 2]).sum(axis=1)
    hovers = square < SLOW**2
    active = activity(epochs) if len(epochs) else np.zeros(0)
    recent = float(hovers[-_RECENT:].mean()) if len(hovers) else 0.5
    return MotionRegimes(
        can_hover=_slow_speed(np.sqrt(square)) < _ABLE if can_hover is None else can_hover,
        travel_var=_shrunk_variance(square[~hovers], _USUAL_TRAVEL),
        hover_var=_shrunk_variance(square[hovers], _USUAL_HOVER),
        travel_activity=_shrunk_moments(active[~hovers], *_USUAL_ACTIVITY[0]),
        hover_activity=_shrunk_moments(active[hovers], *_USUAL_ACTIVITY[1]),
        hover_probability=_DOUBT + (1.0 - 2.0 * _DOUBT) * recent,
    )


def _slow_speed(speed: np.ndarray) -> float:
    """Speed [m/s] that nine tenths of the flight were faster than, from speeds (N,).

    What came before the first fast flight may have been the way to the start, on the ground or being carried.
    """
    fast = speed > _ABLE
    first = int(np.argmax(fast)) if fast.any() else len(speed)
    flown = speed[first:]
    if len(flown) * PERIOD < _FLOWN:
        flown = speed
    return float(np.percentile(flown, _SHARE)) if len(flown) else 0.0


def _shrunk_variance(squared_speed: np.ndarray, usual: float) -> float:
    seconds = len(squared_speed) * PERIOD
    return float((_USUAL_TIME * usual**2 + 0.5 * squared_speed.sum() * PERIOD) / (_USUAL_TIME + seconds))


def _shrunk_moments(values: np.ndarray, mean: float, sd: float) -> tuple[float, float]:
    seconds = len(values) * PERIOD
    middle = (_USUAL_TIME * mean + values.sum() * PERIOD) / (_USUAL_TIME + seconds)
    spread = _USUAL_TIME * (sd**2 + (middle - mean) ** 2) + np.square(values - middle).sum() * PERIOD
    return float(middle), float(spread / (_USUAL_TIME + seconds))
