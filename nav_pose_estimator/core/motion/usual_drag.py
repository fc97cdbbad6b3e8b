"""Rotor drag with a population prior: the law of motion until the flight has determined its own.

Frames and propellers differ, yet on most multirotors the specific force along body x and y is -D times the velocity
through the air, with D near 0.2 1/s (P. Martin and E. Salaun, "The true role of accelerometer feedback in quadrotor
control", ICRA 2010). The law is linear in 1 / D, so that a normal prior on 1 / D is conjugate.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, DragLaw, learn_drag, with_law
from nav_pose_estimator.core.motion.epochs import BODY_VELOCITY, FORCE, PERIOD, VELOCITY, attitude, inputs
from nav_pose_estimator.core.motion.usual import Drag, Shown, hovering

Array = NDArray[np.float64]

_LEAST = 10.0  # s: least travelling from which drag is estimated
_USUAL_NOISE = 20.0  # s of travelling: weight of the population's noise
_WIND_RIDGE = 1e-3  # ridge penalty on the wind, per epoch
_UNKNOWN = Drag(0.2, 0.1, 3.0)  # 1/s, 1/s, m/s: from the literature, where fewer than two airframes have travelled


def fit_drag(airframes: Sequence[Shown]) -> Drag:
    """Population values of ``airframes`` of multirotors; from the literature where too few have travelled."""
    rates, noises = [], []
    for one in airframes:
        flights = [epochs for epochs in one.epochs if (~hovering(epochs)).sum() * PERIOD >= _LEAST]
        if flights:
            rates.append(float(np.mean([_rate(epochs) for epochs in flights])))
            noises.append(float(np.mean([np.log(learn_drag(epochs).noise[:2].mean()) for epochs in flights])))
    if len(rates) < 2 or np.mean(rates) <= 0.0:
        return _UNKNOWN
    return Drag(float(np.mean(rates)), float(np.std(rates)), float(np.exp(0.5 * np.mean(noises))))


def with_usual_drag(epochs: Array, usual: Drag) -> AirVelocityModel:
    """Fit 1 / D, wind and noise to ``epochs`` (N, COLUMNS or more), N at least 8, with the prior ``usual``.

    The remaining variance of 1 / D becomes the ``parameter_cov`` of the model.
    """
    gain, spread = 1.0 / usual.rate, usual.rate_spread / usual.rate**2
    count, C = len(epochs), attitude(epochs)
    design = np.zeros((count, 2, 4))
    design[:, 0, 0], design[:, 1, 1] = -epochs[:, FORCE], -epochs[:, FORCE + 1]
    design[:, :, 2:] = C[:, :2, :2].transpose(0, 2, 1)
    worth = usual.noise**2 / (PERIOD * spread**2)  # weight of the prior: epochs at 1 m/s^2
    prior = np.diag([worth, worth, _WIND_RIDGE * count, _WIND_RIDGE * count])
    gram = np.einsum("nai,naj->ij", design, design)
    moment = np.einsum("nai,na->i", design, epochs[:, BODY_VELOCITY : BODY_VELOCITY + 2])
    gains = np.linalg.solve(gram + prior, moment + prior @ np.array([gain, gain, 0.0, 0.0]))[:2]
    model = with_law(epochs, DragLaw(gains))
    travelled = float((~hovering(epochs)).sum()) * PERIOD
    noise = (_USUAL_NOISE * usual.noise**2 + travelled * model.noise) / (_USUAL_NOISE + travelled)
    unknown = np.zeros_like(model.parameter_cov)
    unknown[[0, 1], [0, 1]] = 1.0 / (PERIOD * (np.diag(gram)[:2] + worth))
    return replace(model, noise=noise, parameter_cov=unknown)


def expected_noise(model: AirVelocityModel, epochs: Array) -> float:
    """Mean horizontal variance [m^2/s^2] of a second that ``model`` states, over travelling epochs (N, COLUMNS+)."""
    travels = ~hovering(epochs)
    x = inputs(epochs[travels] if travels.any() else epochs)
    return float(model.noise[:2].sum() * model.doubt(x).mean())


def _rate(epochs: Array) -> float:
    """D [1/s] by least squares of specific force along x and y on velocity in b, with wind and accelerometer bias."""
    C, v = attitude(epochs)[:, :2, :2], epochs[:, BODY_VELOCITY:VELOCITY]
    design = np.zeros((len(epochs), 2, 5))
    design[:, :, 0], design[:, :, 1:3] = -v[:, :2], C.transpose(0, 2, 1)
    design[:, 0, 3], design[:, 1, 4] = 1.0, 1.0
    force = epochs[:, FORCE : FORCE + 2]
    return float(np.linalg.lstsq(design.reshape(-1, 5), force.ravel(), rcond=None)[0][0])
