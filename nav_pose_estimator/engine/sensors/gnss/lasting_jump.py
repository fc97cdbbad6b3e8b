"""Doubts about the position after a jump of GNSS, and while consistent fixes contradict the navigator."""

import math

from nav_pose_estimator.core.gnss.reacquisition import Decision, ReacquisitionSettings

_CREDIBLE = 3.0  # standard deviations that cover both ends of a jump
_FRESH, _SHORT = 10.0, 20.0
"""s for which sigma covers the offset of a return, and s: longest outage before it. Between obstacles, fixes have a
common error for seconds, while the navigator has hardly drifted."""
_FEW = ("consistency", "innovation")  # reasons while there are too few fixes for a contradiction
_HOLDS = 2.0  # s after the last contradicting fix for which the doubt is reported


class LastingJump:
    """Doubt after a jump: until the end of the probation either of the two positions may be right.

    For some seconds the same holds after the return from a short outage, but without a warning.
    """

    def __init__(self) -> None:
        self._size, self._until = 0.0, -math.inf  # m, s
        self._offset, self._fresh_until = 0.0, -math.inf  # m, s: of the last return

    def returned(self, t: float, gap: float, decision: Decision) -> None:
        """Note a return of GNSS at ``t`` [s], ``gap`` [s] after the last fix that was used."""
        if gap < _SHORT:
            self._offset, self._fresh_until = math.hypot(*decision.offset[:2]), t + _FRESH

    def note(self, t: float, gap: float, decision: Decision, settings: ReacquisitionSettings) -> None:
        """Note a reset at ``t`` [s], ``gap`` [s] after the last fix that was used.

        Only a jump that began while GNSS was good counts; after an outage the filter may have drifted that far.
        """
        strange = decision.reason.endswith(("implausible", "unexplained", "inconsistent"))
        if strange and gap < settings.implausible_time + 2.0 * settings.loss_time:
            self._size, self._until = math.hypot(*decision.offset[:2]), t + settings.probation
        else:
            self._until = -math.inf

    def least_sd(self, t: float) -> float:
        """Floor of the standard deviation [m] on each horizontal axis, which covers the position before the jump."""
        size, offset = self._size * (t < self._until), self._offset * (t < self._fresh_until)
        return max(size, offset) / _CREDIBLE

    def is_over(self, t: float) -> bool:
        """Whether there is no floor at ``t`` [s]."""
        return not t < max(self._until, self._fresh_until)

    def reason(self, t: float) -> str:
        """Why the position at ``t`` [s] is in doubt, one clause for the user; empty where it is not."""
        return f"GNSS jumped by {self._size:.0f} m while it was in use, and stayed there" if t < self._until else ""


class Contradiction:
    """Doubt while fixes that agree with each other are not used because they contradict the navigator."""

    def __init__(self) -> None:
        self._apart, self._until = 0.0, -math.inf  # m, s

    def note(self, t: float, decision: Decision, settings: ReacquisitionSettings) -> None:
        """Note the guard's decision on a fix at ``t`` [s]."""
        is_one = decision.action in ("wait", "reject") and decision.sigmas > settings.sigmas
        if is_one and not decision.reason.endswith(_FEW):
            self._apart, self._until = math.hypot(*decision.offset), t + _HOLDS
        elif not is_one:
            self._until = -math.inf

    def reason(self, t: float) -> str:
        """Why the position at ``t`` [s] is in doubt, one clause for the user; empty where it is not."""
        if not t < self._until:
            return ""
        return f"GNSS fixes that agree with each other lie {self._apart:.0f} m from the navigator: one of them is wrong"
