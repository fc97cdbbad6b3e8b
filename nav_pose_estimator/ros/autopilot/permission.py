"""Decision whether a solution is sent to the autopilot, by its mode alone."""

from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.solutions import Mode


class Permission:
    """Permission to send. With ``always`` the pose is also sent while GNSS aids the navigator.

    Once the mode was EXPIRED, nothing is sent until GNSS aids the navigator again. A fix under test changes the mode to
    REACQUIRING, but does not improve the position.
    """

    def __init__(self, always: bool) -> None:
        self._always = always
        self._expired = False

    def ask(self, mode: Mode) -> bool:
        """Whether a solution in ``mode`` may be sent. Must be called for every solution."""
        if mode is Mode.EXPIRED:
            self._expired = True
        elif mode is Mode.AIDED:
            self._expired = False
        return not self._expired and (mode in DENIED or (self._always and mode is Mode.AIDED))

    def why_not(self, mode: Mode) -> str:
        """The reason of the last refusal, as a clause."""
        if self._expired:
            return "too long without GNSS, the position can no longer be trusted"
        return "GNSS is used again" if mode is Mode.AIDED else "the navigator starts again"
