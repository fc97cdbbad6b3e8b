"""Population statistics of vehicle motion: the prior of a flight, which its own data replace (empirical Bayes).

Each number is a statistic of a single flight averaged over airframes (each counts once, however far it flew), so that
the estimate from a flight can be shrunk towards it. Scales are root mean squares: a vehicle whose speed is not known
yet gets a standard deviation that covers the fast ones, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.core.motion.epochs import PERIOD, POSITION, TIME, VELOCITY, activity
from nav_pose_estimator.core.numerics.rotation import wrap_angle_many

Array = NDArray[np.float64]

SLOW = 0.8  # m/s over ground: a slower vehicle counts as hovering
LOITER_LAG = 30.0  # s: after that the path of most flights has turned back, and the displacement hardly grows further
_LAG = round(LOITER_LAG / PERIOD)  # the same in epochs
_LONGEST_LAG = 20.0  # s: longest correlation time of the velocity that is looked for
_UNKNOWN_WANDER = 1.5  # m: wander of a hover where no flight has hovered for half a minute
_LEAST = 10.0  # s: least time in a regime from which its statistics are taken


@dataclass(frozen=True)
class Travel:
    """Statistics of a travelling vehicle. ``speed``: RMS of each horizontal velocity component [m/s].

    ``velocity_time`` [s]: flight that makes one independent draw of the velocity. ``loiter`` [s]: RMS displacement of
    each axis in half a minute, divided by ``speed``; small where flights stay local.
    """

    speed: float
    velocity_time: float
    loiter: float


@dataclass(frozen=True)
class Hover:
    """Statistics of a vehicle that can hover. ``speed``: as in ``Travel``, while hovering.

    ``activity``, ``travel_activity``: mean and standard deviation of ``epochs.activity`` in a hover and under way.
    ``wander`` [m]: RMS displacement of each axis in half a minute of a hover. ``time`` [s]: mean length of a hover.
    ``missed``: fraction of a travelling vehicle's squared speed that is taken for hovering without GNSS.
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
    standard deviation ``rate_spread`` over airframes. ``noise``: standard deviation of the residual velocity's
    one-second mean [m/s]."""

    rate: float
    rate_spread: float
    noise: float


@dataclass(frozen=True)
class UsualMotion:
    """Population statistics for each kind of vehicle; there are none for ground vehicles, which the ground guides."""

    multirotor: Travel
    fixed_wing: Travel
    hover: Hover
    drag: Drag


@dataclass(frozen=True)
class Shown:
    """Data of one airframe: aided ``epochs`` (N, COLUMNS) of each flight.

    ``travelled``, ``missed`` [m^2/s]: motion in rehearsals, and the part of it taken for hovering (``Decisions``).
    """

    epochs: tuple[Array, ...]
    travelled: float = 0.0
    missed: float = 0.0


def hovering(epochs: Array) -> NDArray[np.bool_]:
    """Whether the vehicle hovers at each epoch, (N,), by its speed over ground."""
    return np.asarray(np.square(epochs[:, VELOCITY : VELOCITY + 2]).sum(axis=1) < SLOW**2)


def departures(epochs: Array) -> int:
    """Number of ends of a hover in epochs (N, COLUMNS)."""
    hovers = hovering(epochs)
    return int((hovers[:-1] & ~hovers[1:]).sum())


def displacement_squares(epochs: Array) -> Array:
    """Squared displacements over ``LOITER_LAG``, mean of both horizontal axes (M,) [m^2], of epochs (N, COLUMNS).

    Only half minutes that begin or end under way count: standing or hovering is no evidence of travelling.
    """
    hovers = hovering(epochs)
    return _displacement_squares(epochs, ~(hovers[_LAG:] & hovers[:-_LAG]))


def wander_squares(epochs: Array) -> Array:
    """Squared displacements as ``displacement_squares``, of half minutes in which the vehicle hovers throughout."""
    hovered = np.concatenate([[0], np.cumsum(hovering(epochs))])
    return _displacement_squares(epochs, hovered[_LAG + 1 :] - hovered[: -_LAG - 1] == _LAG + 1)


def _displacement_squares(epochs: Array, counts: NDArray[np.bool_]) -> Array:
    """Squared displacements of the half minutes selected by ``counts`` (N - _LAG,), without those that have a gap."""
    if len(epochs) <= _LAG:
        return np.empty(0)
    counts = counts & (epochs[_LAG:, TIME] - epochs[:-_LAG, TIME] < LOITER_LAG + 0.5 * PERIOD)
    r_m, r_n = radii(float(epochs[0, POSITION]))
    steps = (epochs[_LAG:, POSITION : POSITION + 2] - epochs[:-_LAG, POSITION : POSITION + 2])[counts]
    east = wrap_angle_many(steps[:, 1]) * r_n * np.cos(epochs[0, POSITION])
    return np.asarray(0.5 * (np.square(east) + np.square(steps[:, 0] * r_m)))


def fit_travel(airframes: Sequence[Shown]) -> Travel:
    """Statistics of travelling over ``airframes`` of one kind, at least one."""
    squares = [_mean(_travel_squares(one)) for one in airframes]
    loiter = [
        float(np.concatenate([displacement_squares(e) for e in one.epochs]).mean()) / square
        for one, square in zip(airframes, squares, strict=True)
        if sum(len(displacement_squares(e)) for e in one.epochs) * PERIOD >= _LEAST
    ]
    times = [2.0 * _correlation_time(epochs) for one in airframes for epochs in one.epochs]
    return Travel(_root(squares), float(np.median(times)), _root(loiter))


def fit_hover(airframes: Sequence[Shown]) -> Hover:
    """Statistics of hovering over ``airframes`` that can hover, at least one."""
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
    """Time [s] after which the autocorrelation of the velocity falls to 1 / e."""
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
    """Predictive mean and standard deviation for an unknown airframe, from (mean, variance) of several."""
    means, variances = np.array(groups).T
    return float(means.mean()), float(np.sqrt(means.var() + variances.mean()))


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _root(squares: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(squares)))
