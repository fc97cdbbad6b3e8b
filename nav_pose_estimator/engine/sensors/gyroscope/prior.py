"""Prior of the gyroscope's scale factors and misalignments as an observation: a narrow one, or a wide one."""

from __future__ import annotations

import numpy as np

from nav_pose_estimator.core.alignment.gyro_evidence import GyroEvidence
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX
from nav_pose_estimator.core.filter.error_state import inject
from nav_pose_estimator.engine.observation import Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.sensor import Sensor

SCALES = np.array([0, 4, 8])
"""Scale factors in the matrix, row-major."""
WIDE = 0.5
"""Standard deviation of the scale factors after the release."""


class GyroMatrix(Sensor):
    """Replaces the prior of the gyroscope's scale factors by a wide one, as if the filter had started with it.

    A prior is an observation of the states. A narrow one is taken out of the filter as one is put in, but with the
    opposite sign of its information, through the correlations that have grown since the start. So attitude, heading,
    velocity and biases are corrected by what the narrow prior has distorted, and their covariance is that of a
    gyroscope with unknown scale. This is exact as far as the error model is linear. Misalignments keep their prior:
    with all nine elements free, a filter in real vibration finds solutions that are none.
    """

    kind = Kind("gyro_matrix", precedence=0)

    def set_parameters(self, parameters: Parameters) -> None:
        """It has no parameters."""

    def observe(self, evidence: GyroEvidence, t: float, stamp_ns: int) -> Observation:
        """The release at ``t`` [s] of the prior to which ``evidence`` refers."""
        self._journal.count("gyro_matrix.released")
        return Observation(t, stamp_ns, self.kind, (evidence.centre[SCALES], evidence.variance))

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """It always takes effect."""
        return Decision(Use.DOUBTED)

    def settle(self, o: Observation, f: FilterView) -> None:
        """Correct the filter; nothing happens where its prior is another one by now."""
        if not GYRO_MATRIX.is_in(f.constants):
            return
        centre, variance = o.measured
        own = GYRO_MATRIX.states(f.constants).start + SCALES
        # the information that is taken out, 1/variance - 1/WIDE^2, is that of noise with a negative variance
        S = np.eye(len(SCALES)) / (1.0 / variance - 1.0 / WIDE**2) - f.P[np.ix_(own, own)]
        if np.linalg.eigvalsh(S)[0] <= 0.0:
            return
        gain = np.linalg.solve(S, f.P[own, :])
        inject(f.nav, f.constants, gain.T @ (f.nav[GYRO_MATRIX.estimates][SCALES] - centre))
        f.P[:] += f.P[:, own] @ gain
        f.P[:] = 0.5 * (f.P + f.P.T)
