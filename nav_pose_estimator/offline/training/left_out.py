"""Leave-one-out cross-validation: the benefit of an archive of all other flights for each flight, with controls.

The measure is dead reckoning of v = C g + wind with the aided attitude over half a minute, from starts early in the
flight; every law uses only the data before the start. It ranks laws; the errors with the filter are those of
``benchmark outage --airframe``.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, learn_air_velocity, with_law
from nav_pose_estimator.core.motion.prior import MotionPrior, PriorLaw
from nav_pose_estimator.core.motion.wind import WIND_TIME
from nav_pose_estimator.offline.terminal import aligned

Array = NDArray[np.float64]
Learn = Callable[[Array], AirVelocityModel]

FIRST, LAST, EVERY, LENGTH = 20.0, 130.0, 10.0, 30.0
"""First and last start [s of flight], interval of the starts [s], and length of the dead reckoning [s]."""
OWN, ARCHIVE, BOTH = "own flight", "archive alone", "own + archive"
NETWORK, STACKED, UNTRAINED = "network alone", "+ network", "+ untrained"


class OutputLaw:
    """Law that returns the output of a network, which is the last three inputs."""

    rules = 1

    def predict(self, x: Array) -> Array:
        """Air velocity in b (N, 3) [m/s] of inputs (N, 12)."""
        return x[:, -3:]

    def novelty(self, x: Array) -> Array:
        """Not used here."""
        return np.zeros(len(x))


@dataclass(frozen=True)
class Score:
    """Errors [m] after ``LENGTH`` by method, one for each start; all methods of a flight have the same starts."""

    name: str
    errors: Mapping[str, Array]


def linear_ways(law: PriorLaw | None, prior: MotionPrior | None) -> dict[str, Learn]:
    """Methods with the flight alone and with the archive of the others; only the first without other flights."""
    ways: dict[str, Learn] = {OWN: learn_air_velocity}
    if law is not None and prior is not None:
        ways[ARCHIVE] = lambda epochs: with_law(epochs, law, prior.is_guided)
        ways[BOTH] = lambda epochs: learn_air_velocity(epochs, prior=prior)
    return ways


def stacked_way(prior: MotionPrior) -> Learn:
    """Method with a network's output as additional input, and the archive of the others."""
    return lambda epochs: learn_air_velocity(epochs, prior=prior)


def judge(epochs: Array, ways: Mapping[str, Learn]) -> dict[str, Array]:
    """Errors [m] of each of ``ways`` on the starts of a flight of ``epochs`` (N, COLUMNS or more)."""
    ahead, starts = round(LENGTH / me.PERIOD), _starts(epochs, LENGTH)
    return {
        name: np.array([_drift(learn(epochs[:k]), epochs[k : k + ahead]) for k in starts])
        for name, learn in ways.items()
    }


def _starts(epochs: Array, length: float) -> list[int]:
    """Indices of the epochs that begin ``length`` [s] of uninterrupted flight."""
    ahead = round(length / me.PERIOD)
    starts = np.arange(FIRST, LAST + EVERY / 2, EVERY) / me.PERIOD
    return [int(k) for k in starts if k + ahead <= len(epochs) and _is_whole(epochs[int(k) - 1 : int(k) + ahead])]


def lasting_noise(epochs: Array, model: AirVelocityModel) -> Array:
    """Variance (3,) [m^2/s^2] of a mean over 1 s in b, by the residuals of ``model`` in means over ``WIND_TIME``.

    It is at least the model's own. A whole flight reveals more than its beginning: the error of a law lasts as long as
    the vehicle moves in the same way, longer than the correlation time of the residuals. The part due to changes of the
    wind is not counted twice: the mean of a first-order Gauss-Markov process over its correlation time has 2/e of its
    variance.
    """
    count = round(WIND_TIME / me.PERIOD)
    wind = np.einsum("nij,i->nj", me.attitude(epochs)[:, :2], model.wind_mean)
    left = epochs[:, me.BODY_VELOCITY : me.VELOCITY] - model.network.predict(me.inputs(epochs)) - wind
    means = left[: len(left) // count * count].reshape(-1, count, 3).mean(axis=1)
    by_wind = 2.0 / math.e * model.wind_spread * np.array((1.0, 1.0, 0.0))
    return np.maximum(WIND_TIME * (np.square(means).mean(axis=0) - by_wind), model.noise)


def table(scores: Sequence[Score]) -> list[str]:
    """Lines for the terminal: median / RMS [m] by flight and way, and over all starts."""
    names = list(dict.fromkeys(name for score in scores for name in score.errors))
    everything = {
        name: np.concatenate([score.errors[name] for score in scores if name in score.errors]) for name in names
    }
    rows = [*scores, Score("all", everything)]
    cells = [["left out", "n", *names]]
    for row in rows:
        count = max((len(errors) for errors in row.errors.values()), default=0)
        cells.append([row.name, str(count), *(_cell(row.errors.get(name)) for name in names)])
    return aligned(cells)


def _cell(errors: Array | None) -> str:
    if errors is None or len(errors) == 0:
        return "-"
    return f"{np.median(errors):.1f} / {np.sqrt(np.mean(errors**2)):.1f}"


def _is_whole(epochs: Array) -> bool:
    return bool(np.diff(epochs[:, me.TIME]).max() < 1.5 * me.PERIOD)


def _drift(model: AirVelocityModel, ahead: Array) -> float:
    air = model.network.predict(me.inputs(ahead))
    over_ground = np.einsum("nij,nj->ni", me.attitude(ahead)[:, :2], air) + model.wind_mean + model.wind
    missed = over_ground - ahead[:, me.VELOCITY : me.VELOCITY + 2]
    return float(np.linalg.norm(me.PERIOD * missed.sum(axis=0)))
