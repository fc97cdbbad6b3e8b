"""The source text's way: what a network says of each half second is summed up, and the sum stands in for fixes.

    p_k = p_0 + sum_i T (C_i v_i + w)          R_k = P_0 + T sum_i C_i N C_i' s_i + t^2 (W + W_t)                (1)

v, N: velocity through the air and the variance of its mean over a second, s_i its factor for strange inputs; w: wind of
covariance W at the loss, W_t what it may have changed by since. The covariance grows with time as it does for any sum.

The errors of all the composed positions are one and the same random walk: as independent fixes they would be believed
far too much. So the k-th counts as k times its covariance. Even so a sum of positions knows no more than the velocities
that it is made of, which ``cnn_lstm`` hands to the filter as they are.

The text's receiver gives longitude, latitude and height (its step 12), so what stands in for it is a position, too. The
text does not say what of the network's position, attitude and velocity it observes (the formulas of step 5 are not in
its published summary); attitude and velocity increments of the network know less than the strapdown's gyroscopes and
accelerometers, and its velocity is what ``cnn_lstm`` observes: as a second observation here it would count twice.

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

_START_VAR = 2.0**2  # m^2: of the position at the loss, each axis
_LONGEST = 600.0  # s


@dataclass(frozen=True)
class ComposedFixes:
    """Composes positions from ``last`` (COLUMNS or more), the last aided epoch, on."""

    model: AirVelocityModel
    last: Array

    def advise(self, stamp_ns: int, recent: Array, external: VelocityError | None = None) -> Advice:
        """A position every epoch; none where an epoch since the loss is missing."""
        since = recent[recent[:, me.TIME] > self.last[me.TIME]]
        steps = np.diff(np.append(self.last[me.TIME], since[:, me.TIME]))
        if len(since) == 0 or steps.max() > 1.5 * me.PERIOD:
            return Advice()
        displacement, cov = self.composed(since)
        # the last aided epoch is a mean: it lies a quarter of a second before its end
        begun = 0.5 * me.PERIOD * self.last[me.VELOCITY : me.FORCE]
        lat, lon, alt = (float(x) for x in enu_to_lla(begun + displacement, *self.last[me.POSITION :][:3].tolist()))
        return Advice((ComposedPosition(stamp_ns, (lat, lon, alt), len(since) * cov),))

    def composed(self, since: Array) -> tuple[Array, Array]:
        """Eq. (1) over epochs (N, COLUMNS or more): displacement (3,) [m] and its covariance (3, 3) [m^2], ENU."""
        C, model = me.attitude(since), self.model
        said = [model.predict(one) for one in since]
        wind = np.append(model.wind_mean + model.wind, 0.0)
        velocity = np.einsum("nij,nj->ni", C, np.array([air for air, _ in said])) + wind
        doubt = np.array([factor for _, factor in said])
        cov = me.PERIOD * np.einsum("nij,j,nkj,n->ik", C, model.noise, C, doubt) + _START_VAR * np.eye(3)
        seconds = len(since) * me.PERIOD
        changed = model.wind_spread * (1.0 - math.exp(-2.0 * seconds / WIND_TIME))
        cov[:2, :2] += seconds**2 * (model.wind_cov + changed * np.eye(2))
        return me.PERIOD * velocity.sum(axis=0), cov


class PseudoGnss(CnnLstm):
    """For comparison with ``cnn_lstm``: the same network, its output summed up."""

    name = "pseudo_gnss"
    summary = "the network of cnn_lstm as in its source: its predictions, summed up to positions, in place of fixes"
    history = round(_LONGEST / me.PERIOD)

    def ways(self, flight: Flight) -> dict[str, Guide]:
        """The composed positions, as soon as there is a law."""
        if flight.model is None or flight.model.stacked is None:
            return {}
        return {PRETRAINED: ComposedFixes(flight.model.stacked, flight.epochs[-1])}

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        """What was asked for, unless rehearsals say that coasting is better."""
        guide = self.ways(flight).get(PRETRAINED)
        return None if guide is None or scores.is_worse(PRETRAINED, Coast.name, 1.0) else guide
