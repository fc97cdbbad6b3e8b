"""GNSS elsewhere than the navigator: while nobody knows who is right, and after it was taken in the end."""

import math

from nav_pose_estimator.core.gnss.reacquisition import Decision, ReacquisitionSettings

_CREDIBLE = 3.0  # deviations that cover both ends of a jump
_FEW = ("consistency", "innovation")  # too few fixes to contradict anybody
_HOLDS = 2.0  # s after the last of them


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


class Contradiction:
    """Fixes that agree with each other and are not used, because they lie elsewhere: one of the two is wrong."""

    def __init__(self) -> None:
        self._apart, self._until = 0.0, -math.inf  # m, s

    def note(self, t: float, decision: Decision, settings: ReacquisitionSettings) -> None:
        """What the guard has decided on a fix of the time ``t`` [s]."""
        is_one = decision.action in ("wait", "reject") and decision.sigmas > settings.sigmas
        if is_one and not decision.reason.endswith(_FEW):
            self._apart, self._until = math.hypot(*decision.offset), t + _HOLDS
        elif not is_one:
            self._until = -math.inf

    def reason(self, t: float) -> str:
        """Why the position at ``t`` is doubted, a clause; empty if it is not."""
        if not t < self._until:
            return ""
        return f"GNSS fixes that agree with each other lie {self._apart:.0f} m from the navigator: one of them is wrong"
