"""Two hypotheses of what the vehicle does, each with a navigator of its own, while nothing else bounds the drift.

The filter splits when GNSS is lost: one branch travels as the network predicts, one hovers. Every half second each branch
takes in what its hypothesis says of the velocity; how well that fits decides how probable it is (interacting multiple
model, Blom and Bar-Shalom 1988). A wrong hypothesis cannot spoil the other, and what comes out, mean and covariance of
the mixture, is as uncertain as the decision.
"""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core import layout as at
from nav_pose_estimator.core import measurements
from nav_pose_estimator.core.gaussian_branches import blend_rows, error_between, merge, with_wind, without_wind
from nav_pose_estimator.core.kalman import correct
from nav_pose_estimator.core.strapdown import flush_covariance, run_imu
from nav_pose_estimator.engine.samples import Hypothesis, MotionEvidence

_LEAST_WEIGHT = 1e-4  # no hypothesis is given up for good
_CORRELATION = 4.0  # s: velocities that are nearer in time are no independent evidence


class Branches:
    """Branches of the filter with their weights. ``navs`` (K, NAV_SIZE), ``Ps`` (K, n, n), n with wind block."""

    def __init__(self, nav: np.ndarray, P: np.ndarray, constants: np.ndarray, evidence: MotionEvidence) -> None:
        """Split ``nav`` and ``P`` into the hypotheses of ``evidence``, with the wind that it brings."""
        count = len(evidence.hypotheses)
        start = nav.copy()
        start[at.WIND : at.WIND + 2] = evidence.wind
        self.navs = np.repeat(start[None], count, axis=0)
        self.Ps = np.repeat(with_wind(P, evidence.wind_var)[None], count, axis=0)
        self.weights = np.array([h.probability for h in evidence.hypotheses])
        self.constants = _with_wind_block(constants, evidence)

    def copy(self) -> Branches:
        """An independent copy."""
        twin = object.__new__(Branches)
        twin.navs, twin.Ps, twin.weights = self.navs.copy(), self.Ps.copy(), self.weights.copy()
        twin.constants = self.constants
        return twin

    def run(self, rows: np.ndarray, out: np.ndarray) -> None:
        """Carry every branch over IMU ``rows``; ``out`` receives the solution of the mixture."""
        all_rows = np.empty((len(self.navs), *out.shape))
        for nav, P, own in zip(self.navs, self.Ps, all_rows, strict=True):
            run_imu(nav, P, self.constants, rows, own)
        blend_rows(all_rows, self.weights, out)

    def flush(self) -> None:
        """Bring every covariance to the present."""
        for nav, P in zip(self.navs, self.Ps, strict=True):
            flush_covariance(nav, P, self.constants)

    def merged(self) -> tuple[np.ndarray, np.ndarray]:
        """Nominal state and covariance of the mixture, without the wind block. Flush first."""
        nav, P = merge(self.navs, self.Ps, self.weights)
        return nav, without_wind(P)

    def decide(self, evidence: MotionEvidence) -> None:
        """Let every hypothesis act on its branch, weigh the hypotheses, and mix the branches for the next interval."""
        middle, _ = merge(self.navs, self.Ps, self.weights)
        hypotheses = evidence.hypotheses
        likelihood = np.array(
            [
                _act(nav, P, middle, evidence, hypothesis)
                for nav, P, hypothesis in zip(self.navs, self.Ps, hypotheses, strict=True)
            ]
        )
        if len(hypotheses) == 1:
            return
        stay = math.exp(-evidence.interval / evidence.dwell)
        count = len(hypotheses)
        transition = np.full((count, count), (1.0 - stay) / (count - 1))
        np.fill_diagonal(transition, stay)
        exponent = likelihood * min(evidence.interval / _CORRELATION, 1.0)
        weights = (self.weights @ transition) * np.exp(exponent - exponent.max())
        weights = np.maximum(weights / weights.sum(), _LEAST_WEIGHT)
        self.weights = weights / weights.sum()
        arriving = self.weights @ transition
        mixed = [merge(self.navs, self.Ps, transition[:, j] * self.weights / arriving[j]) for j in range(count)]
        for j, (nav, P) in enumerate(mixed):
            self.navs[j], self.Ps[j] = nav, P


def _act(nav: np.ndarray, P: np.ndarray, middle: np.ndarray, evidence: MotionEvidence, hypothesis: Hypothesis) -> float:
    """Correct one branch; returns the logarithm of the likelihood of what was observed."""
    n = len(P)
    mean = np.array(evidence.wind_mean)
    nav[at.WIND : at.WIND + 2] = mean + math.exp(-evidence.interval / evidence.wind_tau) * (
        nav[at.WIND : at.WIND + 2] - mean
    )
    apart = error_between(middle, nav, n)  # the branch's error were the mixture the truth
    parts = []
    if hypothesis.velocity_var is not None:
        _, H = measurements.horizontal_velocity(nav, n, 0.0, 0.0)
        z = np.array(evidence.velocity[:2]) + H @ apart
        parts.append((z, H, np.full(2, hypothesis.velocity_var)))
    if evidence.air_velocity is not None and hypothesis.air_noise is not None:
        means = evidence.attitude, np.array(evidence.velocity), np.array(evidence.body_velocity)
        z, H = measurements.mean_air_velocity(nav, n, *means, np.array(evidence.air_velocity))
        base = slice(at.BASE_STATES)  # the wind is the branch's own already
        parts.append((z + H[:, base] @ apart[base], H, np.array(hypothesis.air_noise)))
    if not parts:
        return hypothesis.log_likelihood
    z, H = np.concatenate([p[0] for p in parts]), np.vstack([p[1] for p in parts])
    R = np.diag(np.concatenate([p[2] for p in parts]))
    _, log_determinant = np.linalg.slogdet(H @ P @ H.T + R)
    nis = correct(nav, P, z, H, R)
    if not math.isfinite(nis):
        return -math.inf
    return hypothesis.log_likelihood - 0.5 * (nis + float(log_determinant))


def _with_wind_block(constants: np.ndarray, evidence: MotionEvidence) -> np.ndarray:
    wider = constants.copy()
    wider[at.I_WIND_DRAG] = at.BASE_STATES
    if wider[at.I_GYRO_MATRIX] >= 0.0:
        wider[at.I_GYRO_MATRIX] += at.WIND_DRAG_STATES
    wider[at.WIND_RATE] = 1.0 / evidence.wind_tau
    wider[at.WIND_PSD] = 2.0 * evidence.wind_spread / evidence.wind_tau
    return wider
