"""Do a receiver's positions go where its velocities say? They diverge when a spoofer drags the position slowly away.

A spoofer that moves the position by a metre per second passes every gate on single fixes: the filter follows. But the
sum of the receiver's own velocities does not. Single fixes scatter, so what counts is how the difference between
position and summed velocity has changed since some seconds ago. Pure Python, without a clock.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

_PAUSE = 2.0  # s: over a longer one nothing can be summed up
_MEDIAN = 5  # differences of which the middle counts: two fixes that are far off are neither a mark nor a drift
_LEFT = 2  # marks that a drift leaves behind: one alone may lie wrong
_MARK_PERIOD = 5.0  # s between the differences that are kept
_MARKS = 12  # ... which reach back a minute
_SPEED = 0.5  # m/s: what velocities of honest receivers may be wrong by for long
_LASTS = 2.0  # s of a drift, which single fixes that are far off are not
_FLICKERS = 0.5  # s for which it may seem to stop meanwhile
_REMEMBERED = 60.0  # s for which a position that has left its velocities is doubted after it has stopped to do so
_CREDIBLE = 2.0  # deviations that cover where positions are and where velocities lead
_NEARLY = 0.999  # of a square: below, the distance need not be taken exactly

Mark = tuple[float, float, float]  # t [s], difference East and North [m]


@dataclass(frozen=True, slots=True)
class _State:
    t: float = -math.inf
    velocity: tuple[float, float] = (0.0, 0.0)
    travelled: tuple[float, float] = (0.0, 0.0)
    recent: tuple[Mark, ...] = ()
    marks: tuple[Mark, ...] = ()
    leaving_since: float = math.inf  # s
    last_leaving: float = -math.inf
    left: Mark | None = None  # what positions have left
    left_until: float = -math.inf  # s
    way: float = 0.0  # m from there


@dataclass(eq=False)
class WalkOff:
    """Offer it every fix that is fused, with the receiver's velocity at that time."""

    state: _State = field(default_factory=_State, init=False)

    def reset(self) -> None:
        """Forget everything."""
        self.state = _State()

    @property
    def is_on(self) -> bool:
        """Whether positions have left their velocities, and not come back."""
        return self.state.left is not None

    @property
    def way(self) -> float:
        """How far [m] positions are by now from where velocities lead."""
        return self.state.way

    @property
    def least_sd(self) -> float:
        """Deviation [m] that covers both, on each axis."""
        return self.way / _CREDIBLE

    @property
    def reason(self) -> str:
        """Why the position is not to be believed as usual, a clause; empty if it is."""
        if not self.is_on:
            return ""
        return (
            f"GNSS positions are {self.way:.0f} m from where the receiver's own velocities lead: dragged, or reflected"
        )

    def update(
        self, t: float, position_enu: Sequence[float], velocity_enu: Sequence[float] | None, scatter: float
    ) -> float:
        """Speed [m/s] at which positions leave their velocities, 0.0 while that may be chance.

        Args:
            t: time of validity [s], increasing.
            position_enu: (3,) in a local frame [m]; Up is not looked at, as is that of the velocity [m/s].
            scatter: how far two honest fixes may differ by chance [m].
        """
        s = self.state
        if velocity_enu is None:
            return 0.0
        v = float(velocity_enu[0]), float(velocity_enu[1])
        if not 0.0 < t - s.t < _PAUSE:
            self.state = _State(t, v, recent=((t, float(position_enu[0]), float(position_enu[1])),))
            return 0.0
        half = 0.5 * (t - s.t)
        x, y = (p + half * (a + b) for p, a, b in zip(s.travelled, s.velocity, v, strict=True))
        recent = (*s.recent, (t, float(position_enu[0]) - x, float(position_enu[1]) - y))[-_MEDIAN:]
        here = t, _middle(recent, 1), _middle(recent, 2)
        is_due = not s.marks or t - s.marks[-1][0] >= _MARK_PERIOD
        marks = (*s.marks, here)[-_MARKS:] if is_due and len(recent) == _MEDIAN else s.marks
        speed, then = _leaving(marks, here, scatter)
        last = t if then else s.last_leaving
        since = min(s.leaving_since, t) if then or t - last < _FLICKERS else math.inf
        left, until = s.left, s.left_until
        if then and t - since >= _LASTS:
            left, until = left or then, t + _REMEMBERED
        way = 0.0 if left is None else math.hypot(here[1] - left[1], here[2] - left[2])
        if left is not None and (way < scatter or t > until):
            left, way = None, 0.0
        self.state = _State(t, v, (x, y), recent, marks, since, last, left, until, way)
        return speed


def _middle(recent: tuple[Mark, ...], column: int) -> float:
    return sorted(one[column] for one in recent)[len(recent) // 2]


def _leaving(marks: tuple[Mark, ...], now: Mark, scatter: float) -> tuple[float, Mark | None]:
    """The largest speed away from one of ``marks`` that is more than chance, and which; 0.0 where it is less for all,
    or for all but one."""
    fastest, from_where, left = 0.0, None, 0
    for then in marks:
        seconds, east, north = now[0] - then[0], now[1] - then[1], now[2] - then[2]
        bound = scatter + _SPEED * seconds
        if seconds > 0.0 and bound > 0.0 and east * east + north * north > _NEARLY * bound * bound:
            apart = math.hypot(east, north)
            left += apart > bound
            if apart > bound and apart > fastest * seconds:
                fastest, from_where = apart / seconds, then
    return (fastest, from_where) if left >= _LEFT else (0.0, None)
