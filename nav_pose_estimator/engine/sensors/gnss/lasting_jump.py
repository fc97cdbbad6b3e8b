"""A jump of GNSS that was taken in the end: for how long, and by how much, its position is doubted."""

import math

from nav_pose_estimator.core.gnss.reacquisition import Decision, ReacquisitionSettings

_CREDIBLE = 3.0  # deviations that cover both ends of a jump


class LastingJump:
    """The doubt after a jump: until the probation is over, nobody knows which of the two positions was right."""

    def __init__(self) -> None:
        self._size, self._until = 0.0, -math.inf  # m, s

    def note(self, t: float, gap: float, decision: Decision, settings: ReacquisitionSettings) -> None:
        """A reset at ``t`` [s], ``gap`` [s] after the last fix that was used.

        One that began while GNSS was good counts. After an outage the filter may have drifted as far.
        """
        strange = decision.reason.endswith(("implausible", "unexplained", "inconsistent"))
        if strange and gap < settings.implausible_time + 2.0 * settings.loss_time:
            self._size, self._until = math.hypot(*decision.offset[:2]), t + settings.probation
        else:
            self._until = -math.inf

    def least_sd(self, t: float) -> float:
        """The horizontal deviation [m] that covers where the position jumped from."""
        return self._size / _CREDIBLE if t < self._until else 0.0

    def is_over(self, t: float) -> bool:
        """Whether nothing is doubted any more at ``t`` [s]."""
        return not t < self._until

    def reason(self, t: float) -> str:
        """Why the position at ``t`` is doubted, a clause; empty if it is not."""
        return f"GNSS jumped by {self._size:.0f} m while it was in use, and stayed there" if t < self._until else ""
