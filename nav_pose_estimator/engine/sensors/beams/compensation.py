"""Compensation of faulty beams: an alternative to excluding them, by a prediction of their error.

A compensator is used only for beams that the tests (gate, latch, parity) have flagged. Its inputs are functions of the
innovation: if it compensated all beams, it would remove the innovation and with it all information of the sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.engine.sensors.beams.anfis_compensator import AnfisCompensator

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BeamEvidence:
    """Data of the n beams of one message before the filter is updated; NaN for a lost beam.

    ``innovation`` (n,): measurement minus estimate [m/s]; ``variance`` (n,): its variance H P H' + R [m^2/s^2] with the
    nominal R, since an adapted one would hide the fault; ``flagged`` (n,) bool: found faulty.
    """

    t: float  # s, engine time of validity
    innovation: Array
    variance: Array
    flagged: NDArray[np.bool_]


class Compensator(Protocol):
    """Predicts the errors of beams. It is copied with the filter (``copy.deepcopy``) and must not use a clock."""

    def learn(self, evidence: BeamEvidence) -> None:
        """Learn from a message while GNSS is good, when the innovation is mostly the beam's error."""

    def predict(self, evidence: BeamEvidence) -> tuple[Array, Array]:
        """Predicted errors (n,), measured minus true [m/s], and residual variances (n,) [m^2/s^2]; NaN: no prediction.

        Only the predictions for flagged beams are used.
        """

    def figures(self) -> dict[str, float]:
        """Values of the navigator's status, with keys that begin with ``beams.compensation.``."""


COMPENSATORS: dict[str, Callable[[], Compensator | None]] = {
    "none": lambda: None,
    "anfis": AnfisCompensator,
    "anfis_frcg": partial(AnfisCompensator, "frcg"),
    "anfis_linear": partial(AnfisCompensator, rules=1),
}
"""The compensators by the choices of ``aids.beams.compensation``."""
