"""Verification of beam conventions against the sensor's own 3-D velocity, else against the navigator's."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.geometry import ENOUGH, GeometryCheck, Reading, readings
from nav_pose_estimator.core.filter.layout import DVEL, PHI, VEL
from nav_pose_estimator.core.filter.measurements import BEAMS
from nav_pose_estimator.engine.observation import FilterView
from nav_pose_estimator.engine.sensors.beams.arrangement import Arrangement
from nav_pose_estimator.engine.sensors.beams.message import Beams
from nav_pose_estimator.engine.sensors.beams.mounting_guess import MountingGuess
from nav_pose_estimator.engine.solutions import Level

Array = NDArray[np.float64]
Said = tuple[str, Level, str] | None
"""Name, level and text of an event."""
_OWN_ERROR = 0.01  # standard deviation of the sensor's own 3-D velocity relative to its beams, per speed


def deviation_of(f: FilterView, angle_sd: float) -> float:
    """Standard deviation [m/s] of the navigator's velocity in axes that are known to ``angle_sd`` [rad]."""
    variances = f.P.diagonal()
    angle_var = angle_sd**2 + float(variances[PHI : PHI + 3].max())
    speed_squared = float(np.square(f.nav[VEL : VEL + 3]).sum())
    return math.sqrt(float(variances[DVEL : DVEL + 3].max()) + speed_squared * angle_var)


class Verification:
    """The verification. ``reading`` is the convention of the messages, None until it is established."""

    def __init__(self, sign: int, directions_are_given: bool) -> None:
        self._readings = readings(sign, directions_are_given)
        self._check = GeometryCheck(self._readings)
        self._guess = MountingGuess()
        self.reading: Reading | None = None
        self._is_own = False  # whether it was established by the sensor's own 3-D velocity

    def compare_anew(self) -> None:
        """Start again, because the navigator's velocity was in wrong axes.

        A convention established by the sensor's own velocity is kept.
        """
        self._guess = MountingGuess()
        if not self._is_own:
            self._check, self.reading = GeometryCheck(self._readings), None

    def add(self, beams: Beams, arrangement: Arrangement, navigator: tuple[Array, float] | None, sd: float) -> Said:
        """Process a message, with the ``navigator``'s velocity (3,) in b [m/s] and its deviation where known.

        ``sd`` [m/s]: smallest standard deviation of a beam. Returns the event of a decision, else None.
        """
        arrangement.meet(beams)
        if navigator is not None:
            self._guess.add(beams.directions, beams.velocities, navigator[0], math.hypot(sd, navigator[1]))
        if beams.velocity is not None:
            velocity, whose = np.array(beams.velocity), "the message's own 3-D velocity"
            error = _OWN_ERROR * float(np.linalg.norm(velocity))
        elif navigator is not None:
            velocity, whose, error = arrangement.axes.T @ navigator[0], "the navigator's velocity", navigator[1]
        else:
            return None
        refusals = self._check.refusals
        self._check.add(beams.directions, beams.velocities, velocity, math.hypot(sd, error))
        self.reading = self._check.decide()
        if self.reading is not None:
            arrangement.settle(self.reading)
            self._is_own = beams.velocity is not None
            self._guess = MountingGuess()
            return "beam_velocity.geometry", Level.INFO, self._verified(self.reading, arrangement.count, whose)
        return self._refused(whose) if self._check.refusals > refusals else None

    def disagrees(self, beams: Beams, in_body: Array, sd: float) -> None:
        """Add a message of a verified sensor that disagrees with the navigator."""
        self._guess.add(beams.directions, beams.velocities, in_body, sd)

    def contradiction(self, delay: float) -> tuple[str, Level, str]:
        """Event for beams that mostly contradict the navigator; ``delay`` [s]: their apparent latency, or 0."""
        assert self.reading is not None
        late = f"they seem to be {delay:.2f} s old when they are stamped: aids.beams.delay?" if delay else ""
        cure = self._guess.sentence((self.reading,)) or late or "check aids.beams.rpy, delay, lever and sd"
        text = f"beam velocities not used: most beams contradict the navigator while GNSS is good; {cure}"
        return "beam_velocity.contradicts", Level.WARN, text

    def _refused(self, whose: str) -> tuple[str, Level, str]:
        cure = self._guess.sentence(self._readings) or "check aids.beams.directions, sign, rpy and sd"
        text = (
            f"beam velocities not used: no convention of directions and signs agrees with {whose} "
            f"(the best one differs by {self._check.fit:.1f} standard deviations); {cure}"
        )
        return "beam_velocity.geometry.refused", Level.WARN, text

    def _verified(self, reading: Reading, count: int, whose: str) -> str:
        how = "with sine and cosine swapped" if reading.swapped else "as published"
        sense = "along the beam" if reading.sign > 0 else "against the beam"
        fourth = "; without a fourth beam they cannot check each other" if count == BEAMS - 1 else ""
        kind = f"{count} beams" if count else "points"
        return (
            f"beam velocities: {kind}, directions {how}, positive for motion {sense} "
            f"({self._check.fit:.1f} standard deviations from {whose} in {ENOUGH} messages){fourth}"
        )
