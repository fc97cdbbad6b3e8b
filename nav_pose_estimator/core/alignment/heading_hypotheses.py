"""Heading from GNSS alone: a bank of Kalman filters with different initial headings, weighted by their likelihoods.

Each hypothesis is a full 15-state filter that starts at its own heading. All hypotheses receive the same IMU and GNSS
data. Once the vehicle accelerates, the innovations of a wrong heading grow and its likelihood falls, so the weight
concentrates on the hypotheses near the true heading.

Sources: P. Riseborough, EKF-GSF yaw estimator (PX4-Autopilot, 2020), which uses five planar three-state filters;
Alspach and Sorenson, IEEE Trans. Automatic Control 17(4), 1972 (Gaussian-sum filters). Here each hypothesis runs the
navigator's own filter. Tilt, biases and their correlations are therefore estimated together with the heading, and the
navigator continues from the mixture.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.alignment.types import FixNoise
from nav_pose_estimator.core.filter.error_state import error_between, inject
from nav_pose_estimator.core.filter.kalman import correct
from nav_pose_estimator.core.filter.layout import (
    BASE_STATES,
    PHI,
    QUAT,
    TIME,
)
from nav_pose_estimator.core.filter.measurement_noise import NoiseModel
from nav_pose_estimator.core.filter.measurements import gnss_position, gnss_velocity
from nav_pose_estimator.core.filter.strapdown import flush_covariance, propagate
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.rotation import (
    euler_from_quat,
    quat_from_rotvec,
    quat_multiply,
    wrap_angle,
)

Array = NDArray[np.float64]

_NIS_CAP = 25.0  # per degree of freedom: one outlier must not count for more than this against a hypothesis
_NIS_MEMORY = 25.0  # updates over which the NIS of a hypothesis is averaged


@kernel
def run_bank(navs, Ps, constants, rows):
    """``propagate`` for every hypothesis: ``navs`` (K, NAV_SIZE), ``Ps`` (K, 15, 15), ``rows`` (N, 7)."""
    for k in range(navs.shape[0]):
        for i in range(rows.shape[0]):
            propagate(navs[k], Ps[k], constants, rows[i])


@kernel
def fuse_bank(navs, Ps, constants, position, R_position, velocity, R_velocity, lever, scores):
    """Correct every hypothesis with velocity and position; ``scores`` (K, 2) receives the sums of NIS and of ln det S.

    ``position`` is (lat, lon, alt) in rad, rad, m; ``velocity`` (3,) is ENU in m/s. An infinite ``R_velocity`` (3, 3)
    says that the fix has no velocity.
    """
    states = Ps.shape[1]
    for k in range(navs.shape[0]):
        nav, P = navs[k], Ps[k]
        flush_covariance(nav, P, constants)
        scores[k, 0] = 0.0
        scores[k, 1] = 0.0
        if R_velocity[0, 0] < math.inf:
            z, H = gnss_velocity(nav, states, velocity, lever)
            scores[k, 1] += _log_det(P, H, R_velocity)
            scores[k, 0] += correct(nav, P, constants, z, H, R_velocity)
        z, H = gnss_position(nav, states, position[0], position[1], position[2], lever)
        scores[k, 1] += _log_det(P, H, R_position)
        scores[k, 0] += correct(nav, P, constants, z, H, R_position)


@kernel
def _log_det(P, H, R):
    """ln det S of a three-dimensional measurement, S = H P H' + R."""
    S = np.empty((3, 3))
    n = P.shape[0]
    for i in range(3):
        for j in range(3):
            S[i, j] = R[i, j]
            for a in range(n):
                if H[i, a] != 0.0:
                    for b in range(n):
                        S[i, j] += H[i, a] * P[a, b] * H[j, b]
    det = 0.0
    for i in range(3):
        j = (i + 1) % 3
        k = (i + 2) % 3
        det += S[0, i] * (S[1, j] * S[2, k] - S[1, k] * S[2, j])
    return math.log(max(det, 1e-300))


class _Measurement(NamedTuple):
    """Position or velocity of a fix: its noise model, its covariance, and the function that gives (z, H) at a state."""

    model: NoiseModel
    R: Array  # (3, 3)
    observe: Callable[[Array], tuple[Array, Array]]


@dataclass(init=False, eq=False, slots=True)
class HeadingHypotheses:
    """The bank of K hypotheses, all at the same time; ``merged`` gives their mixture as one state."""

    headings0: list[float]
    navs: Array
    Ps: Array
    began: float
    updates: int
    _constants: Array
    _lever: Array
    _cost: Array  # (K,) -2 ln(prior times likelihood), up to a common constant
    _nis: Array  # (K,) running mean of the NIS per degree of freedom
    _scores: Array  # (K, 2) sums of NIS and of ln det S of the last fix

    def __init__(
        self,
        nav: Array,
        P: Array,
        count: int,
        constants: Array,
        lever: Array,
        log_prior: Array | None = None,
        attitudes: Array | None = None,
    ) -> None:
        """Start ``count`` copies of ``nav``, ``P`` at evenly spaced headings, the first at the heading of ``nav``.

        The heading deviation of each is half the spacing, so that neighbours overlap. ``log_prior`` (count,) holds the
        logarithms of the prior weights. In accelerated motion the unobservable rotation axis is the specific force
        instead of the vertical: ``attitudes`` (N, 4) then goes once around that axis, and each hypothesis takes one.
        """
        spacing = 2.0 * math.pi / count
        self.headings0 = [k * spacing for k in range(count)]
        self.navs = np.repeat(nav[None], count, axis=0)
        self.Ps = np.repeat(P[None], count, axis=0)
        for k, turn in enumerate(self.headings0):
            _turn(self.navs[k], self.Ps[k], turn)
            if attitudes is not None:
                self.navs[k, QUAT : QUAT + 4] = attitudes[k * len(attitudes) // count]
            self.Ps[k, PHI + 2, PHI + 2] = (0.5 * spacing) ** 2
        self.began, self.updates = self.time, 0
        self._constants = constants
        self._lever = lever
        self._cost = np.zeros(count) if log_prior is None else -2.0 * log_prior
        self._nis = np.ones(count)
        self._scores = np.zeros((count, 2))

    @property
    def time(self) -> float:
        """Time of all hypotheses [s]."""
        return float(self.navs[0, TIME])

    def run(self, rows: Array) -> None:
        """Propagate all hypotheses through the IMU rows (N, 7)."""
        run_bank(self.navs, self.Ps, self._constants, rows)

    def fuse(
        self,
        position: tuple[float, float, float],
        position_sd: Array,
        velocity: Array | None,
        velocity_sd: Array,
        noise: FixNoise,
    ) -> None:
        """Correct all hypotheses with one fix at their time: (lat, lon, alt), ``velocity`` ENU, deviations (3,).

        Where a model of ``noise`` is adaptive, it adapts the covariance to the innovations of the best hypothesis.
        """
        states, lever = self.Ps.shape[1], self._lever
        R_position, R_velocity = np.diag(position_sd**2), np.full((3, 3), math.inf)
        parts = [_Measurement(noise.position, R_position, lambda nav: gnss_position(nav, states, *position, lever))]
        if velocity is not None:
            v_enu, R_velocity = velocity, np.diag(velocity_sd**2)
            parts.append(_Measurement(noise.velocity, R_velocity, lambda nav: gnss_velocity(nav, states, v_enu, lever)))
        expected = [self._expect(part) for part in parts if part.model.learns]
        velocity = np.zeros(3) if velocity is None else velocity
        fuse_bank(
            self.navs,
            self.Ps,
            self._constants,
            np.array(position),
            R_position,
            velocity,
            R_velocity,
            self._lever,
            self._scores,
        )
        dof = 6.0 if R_velocity[0, 0] < math.inf else 3.0
        self.updates += 1
        nis = self._scores[:, 0] / dof
        self._nis += (nis - self._nis) / min(self.updates + 1.0, _NIS_MEMORY)
        self._cost += dof * np.minimum(nis, _NIS_CAP) + self._scores[:, 1]
        best = self.navs[np.argmin(self._cost)]
        for part, z, HPH, R_stated in expected:
            part.model.note(self.time, z, part.observe(best)[0], HPH, R_stated)

    def _expect(self, part: _Measurement) -> tuple[_Measurement, Array, Array, Array]:
        """(part, innovation, H P H', stated R) of the best hypothesis; ``part.R`` is set to the adapted covariance."""
        best = np.argmin(self._cost)
        nav, P = self.navs[best], self.Ps[best]
        flush_covariance(nav, P, self._constants)
        z, H = part.observe(nav)
        HPH, R_stated = H @ P @ H.T, part.R.copy()
        part.R[:] = part.model.covariance(z, HPH, R_stated)
        return part, z, HPH, R_stated

    @property
    def nis(self) -> float:
        """Mean NIS per degree of freedom of the best hypothesis; 1 when the noise is as modelled."""
        return float(self._nis[np.argmin(self._cost)])

    @property
    def weights(self) -> Array:
        """Probability (K,) of each hypothesis.

        A NIS above 1 of the best hypothesis says that the noise is larger than modelled. The differences of the
        log-likelihoods are divided by it, since the same evidence then says less.
        """
        excess = max(self.nis, 1.0)
        w = np.exp(-0.5 * (self._cost - self._cost.min()) / excess)
        return w / w.sum()

    def heading(self) -> tuple[float, float]:
        """Mean yaw of the mixture and its standard deviation [rad]; infinite where a covariance is no longer valid."""
        weights = self.weights
        yaws = np.array([euler_from_quat(nav[QUAT : QUAT + 4])[2] for nav in self.navs])
        mean = math.atan2(float(weights @ np.sin(yaws)), float(weights @ np.cos(yaws)))
        spread = np.array([wrap_angle(yaw - mean) for yaw in yaws]) ** 2
        variance = float(weights @ (spread + self.Ps[:, PHI + 2, PHI + 2]))
        return mean, math.sqrt(variance) if variance >= 0.0 else math.inf

    def merged(self) -> tuple[Array, Array]:
        """(nav, P): mean and covariance of the mixture, linearised about the best hypothesis, its spread included."""
        weights = self.weights
        best = int(np.argmax(weights))
        errors = np.array([error_between(nav, self.navs[best], self._constants) for nav in self.navs])
        mean = weights @ errors
        nav = self.navs[best].copy()
        inject(nav, self._constants, mean)
        deviations = errors - mean
        P = np.einsum("k,kij->ij", weights, self.Ps) + np.einsum("k,ki,kj->ij", weights, deviations, deviations)
        return nav, 0.5 * (P + P.T) * max(self.nis, 1.0)


def _turn(nav: Array, P: Array, angle: float) -> None:
    """Turn a first state by ``angle`` [rad] about Up: its attitude, and the covariance of its tilt with it."""
    turn = quat_from_rotvec(np.array([0.0, 0.0, angle]))
    nav[QUAT : QUAT + 4] = quat_multiply(turn, nav[QUAT : QUAT + 4])
    c, s = math.cos(angle), math.sin(angle)
    C = np.eye(BASE_STATES)
    C[PHI : PHI + 2, PHI : PHI + 2] = [[c, -s], [s, c]]
    P[:] = C @ P @ C.T
