"""Quality gate of GNSS fixes: by satellite count, fix status, age and stated accuracy.

Pure Python and without a clock: time comes with each call, float seconds since the engine's epoch. Everything that
changes is in one ``state``, so that ``core.numerics.snapshot`` can copy the gate.
"""

import math
from dataclasses import dataclass, field

_STEPS = 6  # intervals between fixes from which the period is estimated
_LONGEST_PERIOD = 10.0  # s: longest period; a receiver that is slower counts as failing
_PERIODS = 2.2  # periods of a slow receiver after which its count is stale


@dataclass(frozen=True, slots=True)
class Notice:
    """An event for the operator: dotted ``name``, ``severity`` info, warn or error, and one sentence ``text``."""

    name: str
    severity: str
    text: str


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Thresholds of ``GnssGate``; times in seconds, accuracies as one standard deviation in metres."""

    satellite_source: str  # "none": there is no count, only status and accuracy decide
    min_satellites_enter: int
    min_satellites_leave: int
    hold: float  # the count stays at or above the enter threshold this long before the gate opens
    count_max_age: float  # an older count is stale
    count_timeout: float  # without a known count for this long the gate works without one
    max_age: float  # an older fix is rejected
    max_horizontal_sd: float
    max_vertical_sd: float


@dataclass(slots=True)
class GateState:
    """Everything that changes in a ``GnssGate``."""

    open: bool = False
    inactive: bool = False  # no count is available: status and accuracy decide alone
    count: int = 0  # the last known one
    count_state: str = "missing"  # known, unknown, stale, missing
    count_time: float = -math.inf  # of the last known count
    last_update: float = -math.inf  # of the last count message, known or not
    counting_since: float = -math.inf  # first fix after a pause, for which no count could be expected
    last_fix: float = -math.inf
    steps: tuple[float, ...] = ()  # s between the last fixes
    period: float = 0.0  # s: the shortest of them, within bounds
    good_since: float = math.inf  # time since which the count has been at or above the enter threshold; inf: it is not
    usable_since: float | None = None  # time since which all fixes have been usable
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a fix is ``usable``, the dotted ``reason`` (a counter), and the events since the last verdict."""

    usable: bool
    reason: str
    notices: tuple[Notice, ...] = ()


_USABLE = Verdict(True, "gnss.usable")


@dataclass(eq=False, slots=True)
class GnssGate:
    """Gate by satellite count with hysteresis, fix status, age and stated accuracy.

    The gate opens when the count has been at or above ``min_satellites_enter`` for ``hold`` and closes at once below
    ``min_satellites_leave``. Receivers that send the count without a header send it after its fix, so a fix is judged
    by the last count that is not older than ``count_max_age``.

    A count that is unknown (``None``) or stale neither opens nor closes the gate; the change of ``state.count_state``
    is an event. When no count has been known for ``count_timeout``, the gate becomes inactive, with an error event:
    status and accuracy then decide alone until a count is known again.
    """

    settings: GateSettings
    state: GateState = field(init=False)

    def __post_init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.state = GateState()
        if self.settings.satellite_source == "none":
            self.state.inactive = True
            self._note("gnss.gate.none", "info", "Satellites are not counted: status and accuracy decide about fixes.")

    @property
    def period(self) -> float:
        """Period of fixes [s], used or not: the shortest of the last intervals, so that a pause does not count."""
        return self.state.period

    @property
    def _count_max_age(self) -> float:
        """Largest age of a count [s]; longer for a slow receiver, whose counts have the period of its fixes."""
        return max(self.settings.count_max_age, _PERIODS * self.period)

    def update_count(self, t: float, count: int | None) -> None:
        """Process a satellite count at ``t`` [s]; ``None`` means that the receiver does not know it."""
        s = self.state
        if t < s.last_update:
            self._note("gnss.count.out_of_order", "info", "A satellite count older than the last one is ignored.")
            return
        s.last_update = t
        if self.settings.satellite_source == "none":
            return
        if count is None:
            self._set_count_state("unknown")
            s.good_since = math.inf
            return
        if t - s.count_time > self._count_max_age or count < self.settings.min_satellites_enter:
            s.good_since = math.inf
        s.count, s.count_time, s.inactive = count, t, False
        self._set_count_state("known")
        if count >= self.settings.min_satellites_enter:
            s.good_since = min(s.good_since, t)
        if s.open and count < self.settings.min_satellites_leave:
            self._close(f"{count} satellites, fewer than {self.settings.min_satellites_leave}")

    def assess_fix(
        self,
        t: float,
        status: int,
        horizontal_sd: float | None = None,
        vertical_sd: float | None = None,
        age: float = 0.0,
    ) -> Verdict:
        """Assess one fix: NavSatStatus ``status``, accuracy [m] or ``None`` if unknown, ``age`` [s] on arrival."""
        s = self.state
        step = t - s.last_fix
        if math.inf > step > 0.0:
            s.steps = (*s.steps, step)[-_STEPS:]
            s.period = min(min(s.steps), _LONGEST_PERIOD)
        if step > self._count_max_age:
            s.counting_since = t
        if step > 0.0:
            s.last_fix = t
        reason = self._quality(status, horizontal_sd, vertical_sd, age) or self._count_reason(t)
        if reason:
            s.usable_since = None
        elif s.usable_since is None:
            s.usable_since = t
        if not (reason or s.notices):
            return _USABLE
        notices, s.notices = s.notices, ()
        return Verdict(not reason, reason or "gnss.usable", notices)

    def _quality(self, status: int, horizontal_sd: float | None, vertical_sd: float | None, age: float) -> str:
        settings = self.settings
        if status < 0:
            return "gnss.rejected.status"
        if not age <= settings.max_age:
            return "gnss.rejected.age"
        # written so that NaN is rejected too
        bad_horizontal = horizontal_sd is not None and not horizontal_sd <= settings.max_horizontal_sd
        bad_vertical = vertical_sd is not None and not vertical_sd <= settings.max_vertical_sd
        return "gnss.rejected.accuracy" if bad_horizontal or bad_vertical else ""

    def _count_reason(self, t: float) -> str:
        """Why the satellite count rejects the fix; empty if it does not."""
        s, settings = self.state, self.settings
        if s.inactive:
            return ""
        since_known = t - max(s.count_time, s.counting_since)
        if since_known > max(settings.count_timeout, _PERIODS * self.period):
            self._deactivate(f"no satellite count for {since_known:.0f} s from source {settings.satellite_source!r}")
            return ""
        if s.count_state == "known" and t - s.count_time > self._count_max_age:
            s.good_since = math.inf
            if t - s.counting_since > self._count_max_age:
                self._set_count_state("stale")
        if s.open:
            return ""
        if s.count_state != "known":
            return f"gnss.waiting.count_{s.count_state}"
        if s.count < settings.min_satellites_enter:
            return "gnss.rejected.satellites"
        if t - s.good_since < settings.hold:
            return "gnss.waiting.hold"
        s.open = True
        self._note("gnss.gate.opened", "info", f"GNSS gate open: {s.count} satellites for {settings.hold:g} s.")
        return ""

    def _set_count_state(self, new: str) -> None:
        s = self.state
        if new == s.count_state:
            return
        s.count_state = new
        if new in ("unknown", "stale"):
            stays = "open" if s.open else "closed"
            self._note(f"gnss.count.{new}", "warn", f"The satellite count is {new}; the GNSS gate stays {stays}.")

    def _close(self, why: str) -> None:
        self.state.open = False
        self._note("gnss.gate.closed", "warn", f"GNSS gate closed: {why}.")

    def _deactivate(self, why: str) -> None:
        self.state.inactive = True
        self._note(
            "gnss.gate.inactive", "error", f"GNSS gate by satellites is inactive: {why}; status and accuracy only."
        )

    def _note(self, name: str, severity: str, text: str) -> None:
        self.state.notices += (Notice(name, severity, text),)
