"""An alternative to leaving out a faulty beam: predict its error.

A compensator is asked only about beams that the tests (gate, latch, parity) have flagged without it. Its inputs are
functions of the innovation: where every beam is compensated the innovation goes, and with it the sensor.
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
    """What one message says of its n beams, before any of them has corrected the filter. A lost beam is NaN.

    ``innovation`` (n,) measurement minus estimate [m/s]; ``variance`` (n,) of it, H P H' + R [m^2/s^2] with the nominal
    R: an adapted one hides the fault. ``flagged`` (n,) bool: found faulty.
    """

    t: float  # s, engine time of validity
    innovation: Array
    variance: Array
    flagged: NDArray[np.bool_]


class Compensator(Protocol):
    """Predicts the errors of beams. It is copied with the filter (``copy.deepcopy``) and asks no clock."""

    def learn(self, evidence: BeamEvidence) -> None:
        """Beams while GNSS is good: the innovation then is the beam's error but for the navigator's own."""

    def predict(self, evidence: BeamEvidence) -> tuple[Array, Array]:
        """Predicted errors (n,), measured minus true [m/s], and the variances (n,) of what is left; NaN: no answer.

        Only the answers for flagged beams are used.
        """

    def figures(self) -> dict[str, float]:
        """What it shows in the navigator's status, names that begin with ``beams.compensation.``."""


COMPENSATORS: dict[str, Callable[[], Compensator | None]] = {
    "none": lambda: None,
    "anfis": AnfisCompensator,
    "anfis_frcg": partial(AnfisCompensator, "frcg"),
    "anfis_linear": partial(AnfisCompensator, rules=1),
}
"""The compensators by the names that ``aids.beams.compensation`` chooses them by."""
