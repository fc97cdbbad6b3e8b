"""Statistics of the two regimes of motion, hovering and travelling, estimated from the flight so far.

A hovering multirotor keeps its velocity near zero and hardly accelerates; a travelling one does neither. The variance
of the velocity, the activity (``epochs.activity``) and the extent of the flight are shrunk towards population values
(``usual``), so that they are defined before the flight has shown both regimes. A vehicle that never slows down (a fixed
wing) has one regime only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.motion.epochs import PERIOD, TIME, VELOCITY, activity
from nav_pose_estimator.core.motion.usual import (
    Hover,
    UsualMotion,
    departures,
    displacement_squares,
    hovering,
    wander_squares,
)

_ABLE = 5.0  # m/s: a vehicle that spends a tenth of its flight below this speed can hover
_SHARE = 10.0  # percent: that tenth, as a percentile of the speed
_FLOWN = 20.0  # s: least flight since the first fast motion on which that test relies; with less, all data count
_RECENT = round(5.0 / PERIOD)  # epochs: the share of hovering among them is the prior probability of a hover
_USUAL_TIME = 20.0  # s of a regime: weight of its population values, about three independent draws of a velocity
_USUAL_PLACE = 60.0  # s of flight: weight of the population's displacement, two draws
_USUAL_DEPARTURES = 2.0  # ends of a hover: weight of the population's length of a hover
_USUAL_DECISIONS = 30.0  # s of travelling in rehearsals: weight of the population's share of wrong decisions
_DOUBT = 0.02  # least probability of either regime


@dataclass(frozen=True)
class Decisions:
    """How well rehearsals identified the regimes: motion that ``travelled``, and the part of it that was ``missed``.

    Both are integrals over time of the square of a velocity component [m^2/s], for fast motion matters most. Missed is
    what was taken for hovering.
    """

    travelled: float = 0.0
    missed: float = 0.0

    def __add__(self, other: Decisions) -> Decisions:
        """The sum of both."""
        return Decisions(self.travelled + other.travelled, self.missed + other.missed)


@dataclass(frozen=True)
class MotionRegimes:
    """Statistics of both regimes: variance of a velocity component [m^2/s^2] and (mean, variance) of the activity.

    ``travel_time`` [s]: flight that makes one independent draw of a travelling vehicle's velocity. ``place_var`` [m^2]:
    variance of a horizontal component of the displacement from where GNSS was lost, None where it is unknown;
    ``wander_var`` [m^2]: the same for a hover. ``unnoticed_psd`` [m^2/s]: spectral density with which the position
    spreads if the vehicle has left a hover unnoticed; ``hover_time`` [s]: mean length of a hover. ``until`` [s]: time
    up to which the flight is known.
    """

    can_hover: bool
    travel_var: float
    hover_var: float
    travel_activity: tuple[float, float]
    hover_activity: tuple[float, float]
    hover_probability: float
    travel_time: float
    place_var: float | None
    wander_var: float
    unnoticed_psd: float
    hover_time: float
    until: float

    def doubt_psd(self, time: float) -> float:
        """Spectral density [m^2/s] of a hover's position at ``time`` [s]: it may have ended since GNSS was lost."""
        return self.unnoticed_psd * -math.expm1(-max(time - self.until, 0.0) / self.hover_time)


def learn_regimes(
    epochs: np.ndarray, usual: UsualMotion, decisions: Decisions | None = None, can_hover: bool | None = None
) -> MotionRegimes:
    """Estimate the statistics from aided epochs (N, COLUMNS) in order of time; N may be zero.

    ``usual``: population values. ``can_hover``: by the class of the vehicle; None where the flight has to show it.
    """
    square = np.square(epochs[:, VELOCITY : VELOCITY + 2]).sum(axis=1)
    hovers = hovering(epochs)
    active = activity(epochs) if len(epochs) else np.zeros(0)
    recent = float(hovers[-_RECENT:].mean()) if len(hovers) else 0.5
    can_hover = shows_hovering(epochs) if can_hover is None else can_hover
    travel, hover = usual.multirotor if can_hover else usual.fixed_wing, usual.hover
    travel_var = _shrunk_variance(square[~hovers], travel.speed)
    return MotionRegimes(
        can_hover=can_hover,
        travel_var=travel_var,
        hover_var=_shrunk_variance(square[hovers], hover.speed),
        travel_activity=_shrunk_moments(active[~hovers], *hover.travel_activity),
        hover_activity=_shrunk_moments(active[hovers], *hover.activity),
        hover_probability=_DOUBT + (1.0 - 2.0 * _DOUBT) * recent,
        travel_time=travel.velocity_time,
        place_var=_place_variance(displacement_squares(epochs), travel.loiter**2 * travel_var),
        wander_var=_place_variance(wander_squares(epochs), hover.wander**2),
        unnoticed_psd=travel.velocity_time * _unnoticed(travel_var, hover, decisions or Decisions()),
        hover_time=_hover_time(epochs, hover),
        until=float(epochs[-1, TIME]) if len(epochs) else 0.0,
    )


def shows_hovering(epochs: np.ndarray) -> bool:
    """Whether the vehicle of epochs (N, COLUMNS) can hover, because it is slow now and then; N may be zero."""
    return _slow_speed(np.hypot(epochs[:, VELOCITY], epochs[:, VELOCITY + 1])) < _ABLE


def _slow_speed(speed: np.ndarray) -> float:
    """Tenth percentile [m/s] of the speeds (N,) since the vehicle was fast for the first time.

    Earlier motion may have been on the way to the start, on the ground or being carried.
    """
    fast = speed > _ABLE
    first = int(np.argmax(fast)) if fast.any() else len(speed)
    flown = speed[first:]
    if len(flown) * PERIOD < _FLOWN:
        flown = speed
    return float(np.percentile(flown, _SHARE)) if len(flown) else 0.0


def _unnoticed(travel_var: float, usual: Hover, decisions: Decisions) -> float:
    """Mean square [m^2/s^2] of a velocity component that may be taken for hovering, as long as rehearsals are few.

    Where the vehicle has travelled in rehearsals, their own results replace this population value.
    """
    worth = _USUAL_DECISIONS * travel_var
    return travel_var * usual.missed * worth / (worth + decisions.travelled)


def _hover_time(epochs: np.ndarray, usual: Hover) -> float:
    """Mean length of a hover [s]: posterior of a Poisson process whose prior is the population's rate."""
    hovered = float(hovering(epochs).sum()) * PERIOD
    return (_USUAL_DEPARTURES * usual.time + hovered) / (_USUAL_DEPARTURES + departures(epochs))


def _place_variance(squares: np.ndarray, usual: float) -> float:
    return float((_USUAL_PLACE * usual + squares.sum() * PERIOD) / (_USUAL_PLACE + len(squares) * PERIOD))


def _shrunk_variance(squared_speed: np.ndarray, usual: float) -> float:
    seconds = len(squared_speed) * PERIOD
    return float((_USUAL_TIME * usual**2 + 0.5 * squared_speed.sum() * PERIOD) / (_USUAL_TIME + seconds))


def _shrunk_moments(values: np.ndarray, mean: float, sd: float) -> tuple[float, float]:
    seconds = len(values) * PERIOD
    middle = (_USUAL_TIME * mean + values.sum() * PERIOD) / (_USUAL_TIME + seconds)
    spread = _USUAL_TIME * (sd**2 + (middle - mean) ** 2) + np.square(values - middle).sum() * PERIOD
    return float(middle), float(spread / (_USUAL_TIME + seconds))
