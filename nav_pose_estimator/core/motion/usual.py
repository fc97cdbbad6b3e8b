"""How vehicles usually move: what a flight begins with, and what it shows replaces (empirical Bayes).

Every number is one that a single flight has, too, averaged over airframes (each counts once, however far it flew), so
that a flight can be shrunk towards it. Squares are averaged for scales: a vehicle whose speed is not known yet has the
mean square of all, and with it the deviation that covers the fast ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.core.motion.epochs import PERIOD, POSITION, TIME, VELOCITY, activity
from nav_pose_estimator.core.numerics.rotation import wrap_angle_many

Array = NDArray[np.float64]

SLOW = 0.8  # m/s: slower counts as hovering
LOITER_LAG = 30.0  # s: by then the path has bent back on most flights, and the displacement hardly grows any more
_LAG = round(LOITER_LAG / PERIOD)
_LONGEST_LAG = 20.0  # s for the correlation of velocities
_UNKNOWN_WANDER = 1.5  # m, where no flight has hovered for half a minute
_LEAST = 10.0  # s in a regime below which a flight says nothing of it


@dataclass(frozen=True)
class Travel:
    """A vehicle under way. ``speed``: RMS of each horizontal velocity component [m/s].

    ``velocity_time`` [s]: so much flight makes one independent draw of the velocity. ``loiter`` [s]: RMS displacement
    of each axis in half a minute over ``speed``: how local flights are.
    """

    speed: float
    velocity_time: float
    loiter: float


@dataclass(frozen=True)
class Hover:
    """A vehicle that can hover. ``speed`` as in ``Travel``, hovering; activities: mean and deviation of the logarithm.

    ``wander`` [m]: RMS displacement of each axis in half a minute of a hover. ``time`` [s]: how long one lasts. Of the
    square of a travelling vehicle's speed the regimes take ``missed`` for hovering when there is no GNSS.
    """

    speed: float
    activity: tuple[float, float]
    travel_activity: tuple[float, float]
    wander: float
    time: float
    missed: float


@dataclass(frozen=True)
class Drag:
    """Rotor drag of multirotors. ``rate``: specific force along body x or y over velocity through the air [1/s], with
    deviation ``rate_spread`` over airframes. ``noise``: deviation of a mean over one second of what it leaves [m/s]."""

    rate: float
    rate_spread: float
    noise: float


@dataclass(frozen=True)
class UsualMotion:
    """What is usual for each kind of vehicle. One that rolls is guided by the ground: nothing is expected of it."""

    multirotor: Travel
    fixed_wing: Travel
    hover: Hover
    drag: Drag


@dataclass(frozen=True)
class Shown:
    """What flights of one airframe have shown: aided ``epochs`` (N, COLUMNS) of each.

    ``travelled``, ``missed`` [m^2/s]: in rehearsals, and how much of that was taken for hovering (``Decisions``).
    """

    epochs: tuple[Array, ...]
    travelled: float = 0.0
    missed: float = 0.0


def hovering(epochs: Array) -> NDArray[np.bool_]:
    """Whether the vehicle hovers, (N,), by its speed over ground."""
    return np.asarray(np.square(epochs[:, VELOCITY : VELOCITY + 2]).sum(axis=1) < SLOW**2)


def departures(epochs: Array) -> int:
    """How often a hover ended in epochs (N, COLUMNS)."""
    hovers = hovering(epochs)
    return int((hovers[:-1] & ~hovers[1:]).sum())


def displacement_squares(epochs: Array) -> Array:
    """Squared displacements in ``LOITER_LAG``, mean of both horizontal axes [m^2], (M,) of epochs (N, COLUMNS).

    Of those half minutes that begin or end under way: what stands on the ground or hovers says nothing of travelling.
    """
    hovers = hovering(epochs)
    return _displacement_squares(epochs, ~(hovers[_LAG:] & hovers[:-_LAG]))


def wander_squares(epochs: Array) -> Array:
    """The same of those half minutes in which the vehicle hovers throughout."""
    hovered = np.concatenate([[0], np.cumsum(hovering(epochs))])
    return _displacement_squares(epochs, hovered[_LAG + 1 :] - hovered[: -_LAG - 1] == _LAG + 1)


def _displacement_squares(epochs: Array, counts: NDArray[np.bool_]) -> Array:
    """Squares of those half minutes that ``counts`` (N - _LAG,) names and that have no gap."""
    if len(epochs) <= _LAG:
        return np.empty(0)
    counts = counts & (epochs[_LAG:, TIME] - epochs[:-_LAG, TIME] < LOITER_LAG + 0.5 * PERIOD)
    r_m, r_n = radii(float(epochs[0, POSITION]))
    steps = (epochs[_LAG:, POSITION : POSITION + 2] - epochs[:-_LAG, POSITION : POSITION + 2])[counts]
    east = wrap_angle_many(steps[:, 1]) * r_n * np.cos(epochs[0, POSITION])
    return np.asarray(0.5 * (np.square(east) + np.square(steps[:, 0] * r_m)))


def fit_travel(airframes: Sequence[Shown]) -> Travel:
    """The mean of ``airframes`` of one kind, at least one."""
    squares = [_mean(_travel_squares(one)) for one in airframes]
    loiter = [
        float(np.concatenate([displacement_squares(e) for e in one.epochs]).mean()) / square
        for one, square in zip(airframes, squares, strict=True)
        if sum(len(displacement_squares(e)) for e in one.epochs) * PERIOD >= _LEAST
    ]
    times = [2.0 * _correlation_time(epochs) for one in airframes for epochs in one.epochs]
    return Travel(_root(squares), float(np.median(times)), _root(loiter))


def fit_hover(airframes: Sequence[Shown]) -> Hover:
    """The mean of ``airframes`` that hover, at least one."""
    speeds, hover, travel, wander, times, missed = [], [], [], [], [], []
    for one in airframes:
        hovers = np.concatenate([hovering(e) for e in one.epochs])
        active = np.concatenate([activity(e) for e in one.epochs])
        square = np.concatenate([np.square(e[:, VELOCITY : VELOCITY + 2]).mean(axis=1) for e in one.epochs])
        if hovers.sum() * PERIOD >= _LEAST:
            speeds.append(float(square[hovers].mean()))
            hover.append((float(active[hovers].mean()), float(active[hovers].var())))
            times.append(float(hovers.sum()) * PERIOD / max(sum(departures(e) for e in one.epochs), 1))
        wandered = np.concatenate([wander_squares(e) for e in one.epochs])
        if len(wandered) * PERIOD >= _LEAST:
            wander.append(float(wandered.mean()))
        if (~hovers).sum() * PERIOD >= _LEAST:
            travel.append((float(active[~hovers].mean()), float(active[~hovers].var())))
        if one.travelled >= _LEAST:
            missed.append(one.missed / one.travelled)
    time = float(np.exp(np.mean(np.log(times))))
    return Hover(
        _root(speeds),
        _moments(hover),
        _moments(travel),
        _root(wander) if wander else _UNKNOWN_WANDER,
        time,
        float(np.mean(missed)) if missed else 0.5,
    )


def _travel_squares(one: Shown) -> list[float]:
    return [
        float(square) for e in one.epochs for square in np.square(e[~hovering(e), VELOCITY : VELOCITY + 2]).mean(axis=1)
    ]


def _correlation_time(epochs: Array) -> float:
    """Time [s] in which the correlation of the velocity with itself falls to 1 / e."""
    v = epochs[:, VELOCITY : VELOCITY + 2]
    square = float(np.square(v).sum(axis=1).mean())
    before = 1.0
    for lag in range(1, min(round(_LONGEST_LAG / PERIOD), len(v) - 1) + 1):
        now = float((v[lag:] * v[:-lag]).sum(axis=1).mean()) / square
        if now < np.exp(-1.0):
            return PERIOD * (lag - 1 + (before - np.exp(-1.0)) / (before - now))
        before = now
    return _LONGEST_LAG


def _moments(groups: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean and deviation of what a flight of an airframe not known yet will show, from (mean, variance) of several."""
    means, variances = np.array(groups).T
    return float(means.mean()), float(np.sqrt(means.var() + variances.mean()))


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _root(squares: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(squares)))
