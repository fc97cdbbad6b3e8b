"""Mode of the navigator: its rules, its changes and their events."""

from __future__ import annotations

import math
from collections.abc import Callable

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.parameters.navigator import NavigatorParameters
from nav_pose_estimator.engine.sensors.aiding import AID_HOLDS, Aiding
from nav_pose_estimator.engine.solutions import Level, Mode

_OFFER_HOLDS = 2.0  # s after a fix under test for which the mode is REACQUIRING
LEVELLING = frozenset((Mode.WAITING_IMU, Mode.ALIGNING, Mode.NO_ORIGIN))
"""Modes in which the filter does not run."""
DENIED = frozenset((Mode.COASTING, Mode.DEAD_RECKONING, Mode.EXPIRED, Mode.REACQUIRING))
"""Modes without GNSS."""


class ModeKeeper:
    """Keeps the mode, a function of four times: now, last used fix, last fix under test, last bounding aid."""

    def __init__(self, parameters: NavigatorParameters) -> None:
        self._parameters = parameters
        self.mode = Mode.WAITING_IMU
        self.distrust_reason = ""
        """Why a solution without GNSS must not be trusted at all, one sentence; empty where it may."""

    def set_parameters(self, parameters: NavigatorParameters) -> None:
        """Take new times at which the mode changes."""
        self._parameters = parameters

    def note_alignment(self, has_attitude: bool) -> None:
        """Set the mode before the filter runs: ALIGNING, or NO_ORIGIN where only a position is missing."""
        self.mode = Mode.NO_ORIGIN if has_attitude else Mode.ALIGNING

    def distrust(self, reason: str, journal: Journal, stamp_ns: int) -> None:
        """Without GNSS and with a ``reason``: the solution counts as EXPIRED until GNSS aids the filter again."""
        if reason and not self.distrust_reason:
            self.distrust_reason = reason
            journal.say(
                stamp_ns, "navigator.distrusted", Level.ERROR, f"not to be trusted until GNSS is back: {reason}"
            )

    @staticmethod
    def seconds_unaided(t: float, aiding: Aiding) -> float:
        """s since the last used fix while GNSS counts as lost, else zero."""
        gap = t - aiding.fix_used
        return gap if aiding.lost_after < gap < math.inf else 0.0

    def deadline(self, t: float, aiding: Aiding) -> float:
        """The next time [s] after ``t`` at which the mode may change without an observation."""
        soonest, lost_after = math.inf, aiding.lost_after
        for at in (
            aiding.fix_used + lost_after,
            aiding.fix_used + self._parameters.expire_after,
            aiding.fix_offered + max(_OFFER_HOLDS, lost_after),
            aiding.drift_bounded + AID_HOLDS,
        ):
            if t < at < soonest:
                soonest = at
        return soonest

    def update(self, t: float, aiding: Aiding, refusal: str, journal: Journal, stamp: Callable[[float], int]) -> Mode:
        """Update the mode of a running filter to ``t`` [s], with an event for a change.

        ``refusal``: why the last fix was not used.
        """
        mode = self.at(t, aiding)
        if mode is Mode.AIDED:
            self.distrust_reason = ""
        if mode is not self.mode:
            was_denied, is_denied = self.mode in DENIED, mode in DENIED
            level = Level.WARN if is_denied and not was_denied else Level.INFO
            why = f" ({refusal})" if is_denied and refusal else ""
            journal.say(stamp(t), f"mode.{mode.value.lower()}", level, f"{self.mode.value} -> {mode.value}{why}")
            self.mode = mode
        return mode

    def at(self, t: float, aiding: Aiding) -> Mode:
        """The mode of a running filter at ``t`` [s]."""
        # sums as in ``deadline``: a difference may be rounded to the other side
        lost_at, offer_holds = aiding.fix_used + aiding.lost_after, max(_OFFER_HOLDS, aiding.lost_after)
        if t < lost_at:
            return Mode.AIDED
        if t < aiding.fix_offered + offer_holds and aiding.fix_offered > lost_at:
            return Mode.REACQUIRING
        if t >= aiding.fix_used + self._parameters.expire_after or self.distrust_reason:
            return Mode.EXPIRED
        return Mode.COASTING if t < aiding.drift_bounded + AID_HOLDS else Mode.DEAD_RECKONING
