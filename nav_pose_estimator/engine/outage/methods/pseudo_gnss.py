"""Pseudo-GNSS, as in the source text: predicted velocities are integrated to positions, which replace the fixes.

    p_k = p_0 + sum_i T (C_i v_i + w)          R_k = P_0 + T sum_i C_i N C_i' s_i + t^2 (W + W_t)                (1)

v, N: velocity through the air and the variance of its one-second mean, s_i its factor for novel inputs; w: wind with
covariance W at the loss, W_t the covariance of its change since. The covariance grows with time as for any integral.

The errors of all composed positions belong to one random walk: treated as independent fixes, they would be weighted far
too much. So the covariance of the k-th position is multiplied by k. Even so, the positions contain no more information
than the velocities that they are integrated from, which ``cnn_lstm`` gives to the filter directly.

The receiver of the source gives longitude, latitude and height (its step 12), so its substitute is a position, too. The
source does not state which of the network's position, attitude and velocity are observed (the formulas of step 5 are
not in its published summary). Attitude and velocity increments of the network are less accurate than gyroscopes and
accelerometers, and its velocity is what ``cnn_lstm`` observes: here it would be used twice.

Source: M. Feng et al. (see ``core.learning.conv_lstm``), steps 5 and 6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel
from nav_pose_estimator.core.motion.wind import WIND_TIME
from nav_pose_estimator.engine.outage.methods.cnn_lstm import PRETRAINED, CnnLstm
from nav_pose_estimator.engine.outage.methods.coast import Coast
from nav_pose_estimator.engine.outage.methods.method import Advice, Array, Flight, Guide, RehearsalScores
from nav_pose_estimator.engine.samples import ComposedPosition, VelocityError

_START_VAR = 2.0**2  # m^2: variance of the position at the loss of GNSS, each axis
_LONGEST = 600.0  # s: longest outage that is composed


@dataclass(frozen=True)
class ComposedFixes:
    """Composes positions, beginning at ``last`` (COLUMNS or more), the last aided epoch."""

    model: AirVelocityModel
    last: Array

    def advise(self, stamp_ns: int, recent: Array, external: VelocityError | None = None) -> Advice:
        """A position at each epoch; none once an epoch since the loss is missing."""
        since = recent[recent[:, me.TIME] > self.last[me.TIME]]
        steps = np.diff(np.append(self.last[me.TIME], since[:, me.TIME]))
        if len(since) == 0 or steps.max() > 1.5 * me.PERIOD:
            return Advice()
        displacement, cov = self.composed(since)
        # the position of the last aided epoch is a mean, valid a quarter of a second before the end of the epoch
        begun = 0.5 * me.PERIOD * self.last[me.VELOCITY : me.FORCE]
        lat, lon, alt = (float(x) for x in enu_to_lla(begun + displacement, *self.last[me.POSITION :][:3].tolist()))
        return Advice((ComposedPosition(stamp_ns, (lat, lon, alt), len(since) * cov),))

    def composed(self, since: Array) -> tuple[Array, Array]:
        """Eq. (1) over epochs (N, COLUMNS or more): displacement (3,) [m] and its covariance (3, 3) [m^2], ENU."""
        C, model = me.attitude(since), self.model
        predicted = [model.predict(one) for one in since]
        wind = np.append(model.wind_mean + model.wind, 0.0)
        velocity = np.einsum("nij,nj->ni", C, np.array([air for air, _ in predicted])) + wind
        doubt = np.array([factor for _, factor in predicted])
        cov = me.PERIOD * np.einsum("nij,j,nkj,n->ik", C, model.noise, C, doubt) + _START_VAR * np.eye(3)
        seconds = len(since) * me.PERIOD
        changed = model.wind_spread * (1.0 - math.exp(-2.0 * seconds / WIND_TIME))
        cov[:2, :2] += seconds**2 * (model.wind_cov + changed * np.eye(2))
        return me.PERIOD * velocity.sum(axis=0), cov


class PseudoGnss(CnnLstm):
    """For comparison with ``cnn_lstm``: the same network, its output integrated to positions."""

    name = "pseudo_gnss"
    summary = "the network of cnn_lstm as in its source: its predictions, summed up to positions, in place of fixes"
    history = round(_LONGEST / me.PERIOD)

    def ways(self, flight: Flight) -> dict[str, Guide]:
        """The composed positions, once there is a law with the network's output."""
        if flight.model is None or flight.model.stacked is None:
            return {}
        return {PRETRAINED: ComposedFixes(flight.model.stacked, flight.epochs[-1])}

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        """The composed positions, unless coasting was better in rehearsals."""
        guide = self.ways(flight).get(PRETRAINED)
        return None if guide is None or scores.is_worse(PRETRAINED, Coast.name, 1.0) else guide
