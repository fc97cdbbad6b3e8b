"""Re-acquisition of GNSS after an outage: the state machine that decides when fixes are trusted again.

Pure Python and without a clock: time comes with each call, float seconds since the engine's epoch. Everything that
changes is in one ``state``, so that ``core.numerics.snapshot`` can copy the guard.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from nav_pose_estimator.core.gnss.quality_gate import Notice

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ReacquisitionSettings:
    """Thresholds of ``Reacquisition``; SI units."""

    policy: str  # blend, reset, hold
    fixes: int  # mutually consistent fixes before GNSS is trusted again
    min_duration: float  # s that these fixes must span
    loss_time: float  # s without a fused fix after which GNSS counts as lost
    sigmas: float  # width of every statistical bound in standard deviations
    max_speed: float
    max_acceleration: float
    velocity_tolerance: float  # allowed difference between the velocity of a fix and its motion
    contradiction_time: float  # persistence that outweighs the filter's covariance
    implausible_time: float  # persistence that outweighs the physical bound
    track_timeout: float  # s without a fix after which a track is dropped
    probation: float  # longest time during which a return can be reopened cheaply


@dataclass(slots=True)
class Fix:
    """A fix: time [s], position (3,) [m] in the local frame, and its standard deviations ``sd`` (3,) [m], ENU.

    Never written to. It is not frozen, because it is created for every fix, and freezing would triple the cost.
    """

    t: float
    position: Vector3
    sd: Vector3


@dataclass(frozen=True, slots=True)
class Track:
    """A series of consistent fixes: the first one, propagated by their velocities, and the number of confirmations.

    ``unexplained`` (``return_evidence``) is the largest value of its first fixes. It does not fall while the filter's
    sigma grows: waiting alone must not make a doubtful track credible.
    """

    first: Fix
    t: float
    position: Vector3  # the first fix, propagated to t by the velocities
    last_position: Vector3
    velocity: Vector3 | None
    count: int = 1
    unexplained: float = 0.0

    @property
    def duration(self) -> float:
        """s between its first and last fix."""
        return self.t - self.first.t


@dataclass(frozen=True, slots=True)
class Return:
    """A return of GNSS: its offset from the unaided prediction, with the prediction's sigma and the zone."""

    t: float
    until: float  # end of the probation
    offset: Vector3
    sd: Vector3
    zone: int


@dataclass(slots=True)
class ReacquisitionState:
    """Everything that changes in a ``Reacquisition``."""

    anchor: Fix | None = None  # last fused fix that is beyond doubt
    approved: Fix | None = None  # last fix that was accepted
    tracks: tuple[Track, ...] = ()
    loose: Track | None = None  # fixes that are continuous in space, regardless of their velocities
    returned: Return | None = None
    held: bool = False  # a return has passed all tests and waits for the operator
    confirmed: bool = False  # the operator has accepted the next jump


@dataclass(frozen=True, slots=True)
class Decision:
    """Decision on a fix.

    ``action``: ``fuse``: correct the filter (behind its own gate only if ``gated``); ``reset``: set position and
    velocity to the fix; ``wait`` and ``reject``: do not use it. ``offset`` (3,) is fix minus prediction, ENU [m],
    ``sigmas`` the same in standard deviations. ``notice`` is an event for the operator, where there is one.
    """

    action: str
    reason: str
    offset: Vector3
    sigmas: float
    gated: bool = True
    notice: Notice | None = None


EXPECTED, CONTRADICTION, UNEXPLAINED, IMPLAUSIBLE, INCONSISTENT = range(5)
_ZONES = ("expected", "contradiction", "unexplained", "implausible", "inconsistent")
_SEVERITIES = ("info", "warn", "error", "error", "error")
HELD = "gnss.held"
_MAX_TRACKS = 4  # tracks that are followed at a time
_SCATTER = 0.33  # scatter of fixes within seconds relative to their sigma: most of their error is common
_EASY = 0.5  # fraction of the bound on ``unexplained`` up to which a return needs no additional time
# m/s: drift of a navigator a minute into an outage. It limits the additional time, so that waiting costs no more than
# the jump itself.
_DRIFT_SPEED = 8.0
_DECISIVE = 6.0  # difference of squared deviations that makes one of two positions twenty times more likely
_TINY = 1e-6  # m: avoids a division by a zero sigma; s: tolerance for the rounding of times


@dataclass(eq=False, slots=True)
class Reacquisition:
    """Guard in front of the filter. It receives every usable fix, while GNSS is fused and after an outage alike.

    After an outage fixes count only as a track: at least ``fixes`` of them over ``min_duration`` that agree with the
    first one propagated by the velocities in between. How long a track must last depends on its zone:

    * expected: within ``sigmas`` of the filter's prediction: no longer;
    * contradiction: outside, but the filter may have drifted more than its sigma: ``contradiction_time``;
    * unexplained: no drift that agrees with the receiver's velocity leads there (``core.gnss.return_evidence``), as
      when the position returns 300 m off with a correct velocity: up to ``implausible_time``, and an error event. The
      closer a track comes to this zone and the larger the jump, the longer it has to last;
    * implausible: out of reach (``max_speed`` times the time since the last trusted fix, plus ``sigmas``), or faster
      than ``max_speed``: the same;
    * inconsistent: fixes that are continuous but contradict their own velocities, as from a spoofer or a receiver with
      a broken velocity: the same.

    So GNSS is never locked out permanently, neither after an outage nor when a step makes the filter reject every fix.
    A return can be reopened for as long as the outage lasted (at most ``probation``): a track that agrees better with
    the prediction from before the return replaces it at once; one that agrees equally well, when it has lasted as long
    as the track that it contradicts. A false cluster at the end of an outage is thus left as soon as true fixes follow.

    Policies: ``blend``: an expected return is an ordinary update, any other a reset; ``reset``: every return is a
    reset; ``hold``: only expected returns are accepted, all others wait for ``decide()``.
    """

    settings: ReacquisitionSettings
    state: ReacquisitionState = field(default_factory=ReacquisitionState, init=False)

    def reset(self) -> None:
        """Forget everything."""
        self.state = ReacquisitionState()

    def decide(self, accept: bool) -> bool:
        """The operator's decision on a held return (policy ``hold``); False where none is held.

        An accepted return is used with its next fix. A refused one is dropped; if its fixes continue, they have to pass
        all tests again and are held again.
        """
        if not self.state.held:
            return False
        self.state.confirmed = accept
        if not accept:
            self.state.tracks, self.state.loose = (), None
        self.state.held = False
        return True

    def offer(
        self,
        t: float,
        position_enu: Sequence[float],
        velocity_enu: Sequence[float] | None,
        sd: float | Sequence[float],
        predicted_enu: Sequence[float],
        predicted_sd: float | Sequence[float],
        gap_s: float,
        unexplained: float = 0.0,
    ) -> Decision:
        """Decide on one fix.

        Args:
            t: time of validity of the fix [s], not decreasing.
            position_enu, predicted_enu: fix and filter at ``t`` (3,) in one local frame [m].
            velocity_enu: (3,) [m/s] or ``None``; a missing component is NaN.
            sd, predicted_sd: one sigma [m], a number or (3,) ENU.
            gap_s: s since the last fix that the filter used. It keeps growing if a fix that was approved here was then
                rejected by the filter's own gate.
            unexplained: distance of position and velocity that no drift explains (``core.gnss.return_evidence``), 0.0
                without a velocity.
        """
        fix = Fix(t, _vector(position_enu), _vector(sd))
        offset = _difference(fix.position, _vector(predicted_enu))
        predicted_sd = _vector(predicted_sd)
        sigmas = _sigmas(offset, fix.sd, predicted_sd)
        lost = gap_s > self.settings.loss_time
        if not lost and sigmas <= self.settings.sigmas:
            self.expected(fix, gap_s)
            return Decision("fuse", "gnss.fuse", offset, sigmas)
        self._note_fused(t - gap_s)
        track = self._with_unexplained(self._follow(fix, _velocity(velocity_enu)), unexplained)
        zone = self._zone(track, sigmas)
        waiting_for = self._waiting_for(track, zone, offset, lost)
        loose = self.state.loose
        if waiting_for and loose is not None and not self._waiting_for(loose, INCONSISTENT, offset, lost):
            track, zone, waiting_for = loose, INCONSISTENT, ""
        self.state.held = waiting_for == HELD
        if waiting_for:
            return Decision("wait" if lost else "reject", waiting_for, offset, sigmas)
        return self._approve(fix, track, zone, offset, sigmas, predicted_sd, gap_s)

    def expected(self, fix: Fix, gap_s: float) -> None:
        """Accept a ``fix`` that agrees with the prediction while GNSS is fused."""
        self._note_fused(fix.t - gap_s)
        self.state.approved = fix

    @property
    def soonest_reset(self) -> float:
        """Shortest time [s] that contradicting fixes must last before a reset."""
        if self.state.returned is not None:
            return self.settings.min_duration
        return min(self.settings.contradiction_time, self.settings.implausible_time)

    def _note_fused(self, last_fused: float) -> None:
        """After an approved fix has been fused: drop rival tracks, and make the fix the anchor after the probation."""
        s = self.state
        if s.approved is None or last_fused < s.approved.t - 1e-6:
            return
        if s.returned is None or last_fused > s.returned.until:
            s.anchor, s.returned = s.approved, None
        if s.tracks:
            s.tracks = tuple(track for track in s.tracks if track.first.t > last_fused)
        if s.loose is not None and s.loose.first.t <= last_fused:
            s.loose = None

    def _follow(self, fix: Fix, velocity: Vector3 | None) -> Track:
        """The track that the fix belongs to, propagated to it; a new one if it fits none."""
        timeout, loose = self.settings.track_timeout, self.state.loose
        new = Track(fix, fix.t, fix.position, fix.position, velocity)
        if loose is not None and fix.t - loose.t <= timeout and self._fits(loose, fix, None):
            self.state.loose = _advance(loose, fix, None)
        else:
            self.state.loose = new
        live = [track for track in self.state.tracks if fix.t - track.t <= timeout]
        fitting = [track for track in live if self._fits(track, fix, velocity)]
        if fitting:
            old = max(fitting, key=lambda track: track.count)
            live.remove(old)
            moved = _advance(old, fix, velocity)
        else:
            moved = new
        live.sort(key=lambda track: -track.count)
        self.state.tracks = (moved, *live[: _MAX_TRACKS - 1])
        return moved

    def _fits(self, track: Track, fix: Fix, velocity: Vector3 | None) -> bool:
        settings = self.settings
        dt = fix.t - track.t
        slack = settings.sigmas * _SCATTER * math.hypot(max(fix.sd), max(track.first.sd))
        if velocity is None or track.velocity is None:
            return math.dist(fix.position, track.last_position) <= settings.max_speed * dt + slack
        if math.dist(velocity, track.velocity) > settings.max_acceleration * dt + 2 * settings.velocity_tolerance:
            return False
        drift = settings.velocity_tolerance * (fix.t - track.first.t)
        return math.dist(fix.position, _propagated(track, fix.t, velocity)) <= slack + drift

    def _with_unexplained(self, track: Track, unexplained: float) -> Track:
        """The first track with the largest ``unexplained`` of its first fixes."""
        if track.count <= self.settings.fixes and unexplained > track.unexplained:
            track = replace(track, unexplained=unexplained)
            self.state.tracks = (track, *self.state.tracks[1:])
        return track

    def _zone(self, track: Track, sigmas: float) -> int:
        settings, anchor = self.settings, self.state.anchor
        if anchor is not None:
            reach = settings.max_speed * max(track.first.t - anchor.t, 0.0)
            reach += settings.sigmas * math.hypot(max(track.first.sd), max(anchor.sd))
            if math.dist(track.first.position, anchor.position) > reach:
                return IMPLAUSIBLE
        if track.velocity is not None and math.hypot(*track.velocity) > settings.max_speed:
            return IMPLAUSIBLE
        if track.unexplained > settings.sigmas:
            return UNEXPLAINED
        return EXPECTED if sigmas <= settings.sigmas else CONTRADICTION

    def _waiting_for(self, track: Track, zone: int, offset: Vector3, lost: bool) -> str:
        """Reason to continue waiting; empty when the track is trusted."""
        settings = self.settings
        if track.count < settings.fixes or track.duration < settings.min_duration - _TINY:
            return "gnss.waiting.consistency" if lost else "gnss.rejected.innovation"
        if track.duration < self._required(zone, track, offset) - _TINY:
            word = "doubtful" if zone == EXPECTED else _ZONES[zone]
            return f"gnss.{'waiting' if lost else 'rejected'}.{word}"
        rivals = [other.count for other in self.state.tracks if other is not track and other.t > track.first.t]
        if track.count < 2 * max(rivals, default=0) and track.duration < settings.implausible_time:
            return "gnss.waiting.ambiguous"
        if settings.policy == "hold" and zone != EXPECTED and not self.state.confirmed:
            return HELD
        return ""

    def _required(self, zone: int, track: Track, offset: Vector3) -> float:
        """Time [s] that a track in ``zone`` must last."""
        settings, returned = self.settings, self.state.returned
        if zone >= IMPLAUSIBLE:
            return settings.implausible_time
        usual = settings.min_duration if zone == EXPECTED else settings.contradiction_time
        doubt = (track.unexplained / settings.sigmas - _EASY) / (1.0 - _EASY)
        longest = min(settings.implausible_time - usual, math.hypot(*offset) / _DRIFT_SPEED)
        usual += min(max(doubt, 0.0), 1.0) * max(longest, 0.0)
        if zone == EXPECTED or returned is None or track.first.t > returned.until:
            return usual
        track_sigmas = self._from_unaided(returned, track, offset)
        if track_sigmas > settings.sigmas:
            return usual
        return_sigmas = _sigmas(returned.offset, track.first.sd, returned.sd)
        if returned.zone != EXPECTED or return_sigmas**2 - track_sigmas**2 > _DECISIVE:
            return settings.min_duration
        lasted = track.first.t - returned.t
        return min(max(lasted, settings.min_duration), settings.contradiction_time)

    @staticmethod
    def _from_unaided(returned: Return, track: Track, offset: Vector3) -> float:
        """Distance of the track, in standard deviations, from the prediction before the return that is now in doubt."""
        return _sigmas(_sum(offset, returned.offset), track.first.sd, returned.sd)

    def _approve(
        self, fix: Fix, track: Track, zone: int, offset: Vector3, sigmas: float, predicted_sd: Vector3, gap_s: float
    ) -> Decision:
        s, settings = self.state, self.settings
        returned = s.returned
        reopened = zone != EXPECTED and returned is not None and track.first.t <= returned.until
        if reopened and returned is not None:
            # still the same outage: compare with the prediction before its end
            near = self._from_unaided(returned, track, offset) <= settings.sigmas
            first_zone = EXPECTED if near else CONTRADICTION
            s.returned = replace(returned, t=fix.t, offset=_sum(offset, returned.offset), zone=first_zone)
        else:
            s.returned = Return(fix.t, fix.t + min(gap_s, settings.probation), offset, predicted_sd, zone)
        s.approved, s.confirmed = fix, False
        resets = settings.policy == "reset" or zone != EXPECTED
        text = (
            f"GNSS {'return reopened' if reopened else 'is back'}: {math.hypot(*offset):.1f} m from the prediction "
            f"({sigmas:.1f} sigma), {_ZONES[zone]}, {track.count} consistent fixes over {track.duration:.1f} s."
        )
        severity = _SEVERITIES[zone]
        name = f"gnss.{'reset' if resets else 'reacquired'}.{'reopened' if reopened else _ZONES[zone]}"
        notice = Notice(name, severity, text)
        return Decision("reset" if resets else "fuse", name, offset, sigmas, gated=False, notice=notice)


def _propagated(track: Track, t: float, velocity: Vector3) -> Vector3:
    """The track's first fix propagated to ``t`` [s] (trapezoidal rule on the velocities)."""
    before = velocity if track.velocity is None else track.velocity
    half = 0.5 * (t - track.t)
    x, y, z = (p + half * (a + b) for p, a, b in zip(track.position, before, velocity, strict=True))
    return x, y, z


def _advance(track: Track, fix: Fix, velocity: Vector3 | None) -> Track:
    position = fix.position
    if velocity is not None and track.velocity is not None:
        position = _propagated(track, fix.t, velocity)
    return replace(
        track, t=fix.t, position=position, last_position=fix.position, velocity=velocity, count=track.count + 1
    )


def _vector(value: float | Sequence[float]) -> Vector3:
    if isinstance(value, (int, float)):
        return (float(value),) * 3
    x, y, z = (float(item) for item in value)
    return x, y, z


def _velocity(value: Sequence[float] | None) -> Vector3 | None:
    """Velocity with a missing vertical component set to zero; ``None`` if a horizontal one is missing."""
    if value is None or not (math.isfinite(value[0]) and math.isfinite(value[1])):
        return None
    return float(value[0]), float(value[1]), float(value[2]) if math.isfinite(value[2]) else 0.0


def _sum(a: Vector3, b: Vector3) -> Vector3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _difference(a: Vector3, b: Vector3) -> Vector3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _sigmas(offset: Vector3, sd_a: Vector3, sd_b: Vector3) -> float:
    """The larger of the horizontal and the vertical offset in standard deviations."""
    horizontal = math.hypot(
        *(o / (math.hypot(a, b) + _TINY) for o, a, b in zip(offset[:2], sd_a[:2], sd_b[:2], strict=True))
    )
    return max(horizontal, abs(offset[2]) / (math.hypot(sd_a[2], sd_b[2]) + _TINY))
