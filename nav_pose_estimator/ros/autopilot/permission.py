"""When the autopilot gets the pose. Asks no clock: the modes of the solutions decide."""

from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.solutions import Mode


class Permission:
    """Whether the pose may leave. ``always``: also while GNSS aids the navigator.

    A pose that has EXPIRED is not given again before GNSS has aided the navigator: a fix under test makes the mode
    REACQUIRING, and the position no better.
    """

    def __init__(self, always: bool) -> None:
        self._always = always
        self._expired = False

    def ask(self, mode: Mode) -> bool:
        """Whether a solution in ``mode`` may be sent. To be asked for every solution."""
        if mode is Mode.EXPIRED:
            self._expired = True
        elif mode is Mode.AIDED:
            self._expired = False
        return not self._expired and (mode in DENIED or (self._always and mode is Mode.AIDED))

    def why_not(self, mode: Mode) -> str:
        """The reason of the last refusal, as a clause."""
        if self._expired:
            return "too long without GNSS, the position is no longer to be trusted"
        return "GNSS is used again" if mode is Mode.AIDED else "the navigator starts again"
