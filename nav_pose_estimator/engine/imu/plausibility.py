"""Plausibility checks of IMU data, one function per integration mistake; each returns a finding or None.

The checks use the last seconds (``seconds.ImuSecond``), the newest last. Their limits allow for all sixteen recorded
flights (rotors with a vibration of 17 m/s^2, loops with 3 g, a tumble, a crash): there the mean force was never below
2.5 m/s^2 in two consecutive calm seconds, and above 30 m/s^2 for at most five seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from nav_pose_estimator.engine.imu.seconds import ImuSecond

G = 9.81  # m/s^2
_AGREED = 2  # consecutive seconds that decide before the filter runs
_AGREED_IN_FLIGHT = 4  # consecutive seconds that decide in flight, where a finding ends the solution
_CONSTANT = 5  # s without any change after which an axis is dead
_CALM_TURN = 0.5  # rad/s: up to this mean rate, the mean force over a second still shows gravity
_STILL_FORCE, _STILL_TURN = 0.3, 0.05  # m/s^2 (vibration), rad/s: limits of rest, or of a very smooth flight
_RESTING = 5  # s of rest that the check of the scale requires
_AIRBORNE = 3  # s upside down before the start that count as a wrong mounting
_SCALE = 0.15  # largest scale error of an accelerometer at rest, relative to g
_LARGE = 6.0 * G  # m/s^2: no vehicle of this package sustains such a mean force for seconds
_INTERLEAVED_OF, _INTERLEAVED = 8, 2  # two interleaved seconds of eight are a finding; 3900 s of flights had none
_NEAR_G, _NO_FORCE = (8.5, 11.0), 2.0  # norm of the gyroscope's values, of the accelerometer's, when they are exchanged
# A gyroscope in deg/s: its rate across the mean force, rad/s, which as a true one would leave 0.84 of the force in the
# mean; share of the force that is left; and number of such seconds of eight.
_WHIRLS, _STAYS, _WHIRLING = 2.0, 0.95, 3
_AXES = "xyz"
DEAD_AXIS = "imu.implausible.dead_axis"
"""Name of the finding that ends only when all axes change again."""


@dataclass(frozen=True)
class Finding:
    """An implausibility: ``name`` of its event, ``sentence`` with the likely cause for the user."""

    name: str
    sentence: str


Check = Callable[[Sequence[ImuSecond], int], "Finding | None"]
"""Takes the last seconds, and the number of them that have to agree."""


def absent(seconds: Sequence[ImuSecond], agreed: int) -> Finding | None:
    """A sensor that reads exactly zero: the messages have only one half."""
    last = seconds[-agreed:]
    if all(not any(s.spread[3:]) and not any(s.force) for s in last):
        text = (
            "the accelerometer reads exactly zero: half of the message is missing, gyroscope and "
            "accelerometer probably come on two topics; let the driver combine them"
        )
        return Finding("imu.implausible.no_accelerometer", text)
    if all(not any(s.spread[:3]) and not any(s.rate) and all(s.spread[3:]) for s in last):
        text = (
            "the gyroscope reads exactly zero while the accelerometer changes: half of the message is missing, "
            "they probably come on two topics; let the driver combine them"
        )
        return Finding("imu.implausible.no_gyroscope", text)
    return None


def dead_axis(seconds: Sequence[ImuSecond], agreed: int) -> Finding | None:
    """One axis that does not change while the two others do."""
    last = seconds[-_CONSTANT:]
    if len(last) < _CONSTANT or all(last[-1].spread):
        return None
    for name, first, moves in (("gyroscope", 0, 0.05), ("accelerometer", 3, 0.3)):
        for axis in range(3):
            others = {first, first + 1, first + 2} - {first + axis}
            move = all(sum(s.spread[k] for s in last) > _CONSTANT * moves for k in others)
            if move and not any(s.spread[first + axis] for s in last):
                text = (
                    f"the {name}'s {_AXES[axis]} axis does not change while the others do: it is dead, or the driver "
                    "does not fill it in"
                )
                return Finding(DEAD_AXIS, text)
    return None


def gravity_missing(seconds: Sequence[ImuSecond], agreed: int) -> Finding | None:
    """Mean specific force far below 9.8 m/s^2: in units of g, or with gravity removed."""
    last = seconds[-agreed:]
    norm = sum(s.norm for s in last) / len(last)
    mean = sum(s.gravity for s in last) / len(last)
    if all(0.6 < s.norm < 1.6 and s.gravity > 0.8 * s.norm for s in last):
        text = f"the mean specific force is {norm:.2f} m/s^2 instead of 9.8: the accelerometer is probably in g"
        return Finding("imu.implausible.in_g", text)
    if all(s.gravity < 0.25 * G and s.turn < _CALM_TURN for s in last):
        text = (
            f"the mean specific force is {mean:.2f} m/s^2 instead of 9.8: the driver probably removes gravity; "
            "use its raw acceleration"
        )
        return Finding("imu.implausible.no_gravity", text)
    return None


def scale(seconds: Sequence[ImuSecond], agreed: int) -> Finding | None:
    """Specific force at rest that differs from gravity, or is larger than a vehicle sustains."""
    mean = seconds[-1].gravity
    if all(s.gravity > _LARGE for s in seconds[-_AGREED_IN_FLIGHT:]) and len(seconds) >= _AGREED_IN_FLIGHT:
        text = f"the mean specific force has been {mean:.0f} m/s^2 for seconds: probably another unit than m/s^2"
        return Finding("imu.implausible.force_scale", text)
    last = seconds[-_RESTING:]
    still = all(s.vibration < _STILL_FORCE and s.turn < _STILL_TURN for s in last)
    steady = max(s.gravity for s in last) - min(s.gravity for s in last) < 0.02 * mean
    if len(last) == _RESTING and still and steady and abs(mean - G) > _SCALE * G:
        text = (
            f"the specific force at rest is {mean:.2f} m/s^2 instead of 9.8, {mean / G:.2f} times as much: the "
            "accelerometer's unit or range is probably wrong"
        )
        return Finding("imu.implausible.force_scale", text)
    return None


def exchanged(seconds: Sequence[ImuSecond], agreed: int) -> Finding | None:
    """Exchanged fields: the gyroscope's values have the norm of gravity, and the accelerometer's are small."""
    last = seconds[-agreed:]
    if not all(_NEAR_G[0] < s.turn < _NEAR_G[1] and s.norm < _NO_FORCE for s in last):
        return None
    text = (
        f"the gyroscope reads {last[-1].turn:.1f} and the accelerometer {last[-1].norm:.1f}: "
        "angular_velocity and linear_acceleration are probably exchanged"
    )
    return Finding("imu.implausible.exchanged", text)


def degrees(seconds: Sequence[ImuSecond], agreed: int) -> Finding | None:
    """Rates that would rotate gravity in the body within a second, while its direction stays: a gyroscope in deg/s."""
    whirling = [s for s in seconds if s.gravity > _STAYS * s.norm and _across(s) > _WHIRLS]
    if len(whirling) < _WHIRLING:
        return None
    text = (
        f"the gyroscope reads {whirling[-1].turn:.1f} rad/s while gravity stays where it is in the body: the "
        "gyroscope is probably in deg/s instead of rad/s"
    )
    return Finding("imu.implausible.degrees", text)


def _across(second: ImuSecond) -> float:
    """Part of the mean rate [rad/s] across the mean force."""
    along = sum(w * f for w, f in zip(second.rate, second.force, strict=True)) / max(second.gravity, 1e-9)
    return math.sqrt(max(second.turn**2 - along**2, 0.0))


def on_its_back(seconds: Sequence[ImuSecond], agreed: int) -> Finding | None:
    """Specific force along negative z: upside down, at rest or for seconds in the air."""
    still = all(s.vibration < 2.0 * _STILL_FORCE and s.turn < 2.0 * _STILL_TURN for s in seconds[-_AGREED:])
    last = seconds[-(_AGREED if still else _AIRBORNE) :]
    if any(s.gravity < 0.5 * G for s in last):
        return None
    if len(last) < (_AGREED if still else _AIRBORNE) or not all(s.force[2] < -0.7 * s.gravity for s in last):
        return None
    text = (
        f"the specific force along the body's z axis is {last[-1].force[2]:.1f} m/s^2 where upright it is 9.8: the "
        "vehicle lies on its back, or the accelerometer is inverted, or its axes are FRD (imu.convention) or "
        "turned (imu.mounting_rpy)"
    )
    return Finding("imu.implausible.upside_down", text)


def two_imus(seconds: Sequence[ImuSecond], agreed: int) -> Finding | None:
    """Two IMUs on one topic: every second sample differs from the rest by the same amount."""
    if sum(s.interleaved for s in seconds) < _INTERLEAVED:
        return None
    text = "every other IMU sample contradicts the rest: two IMUs probably publish on one topic"
    return Finding("imu.implausible.two_imus", text)


ALWAYS: tuple[Check, ...] = (absent, exchanged, gravity_missing, scale, dead_axis, two_imus)
"""Checks that are valid at any attitude and motion."""
BEFORE_THE_START: tuple[Check, ...] = (*ALWAYS, on_its_back, degrees)
"""Checks before the start. A vehicle in flight may be upside down, or roll with the thrust along its axis; at the start
a wrong mounting or unit is more likely."""
MEMORY = _INTERLEAVED_OF
"""s of data that the checks need."""


def find(seconds: Sequence[ImuSecond], in_flight: bool) -> Finding | None:
    """First finding of the checks; None where the IMU is plausible or too little is known."""
    agreed = _AGREED_IN_FLIGHT if in_flight else _AGREED
    if len(seconds) < agreed:
        return None
    if in_flight and _is_usual(seconds[-1]):
        return two_imus(seconds, agreed)
    checks = ALWAYS if in_flight else BEFORE_THE_START
    return next((found for check in checks if (found := check(seconds, agreed)) is not None), None)


def _is_usual(second: ImuSecond) -> bool:
    """Whether this newest second, as nearly all, excludes each finding of ``ALWAYS`` but two IMUs by itself.

    With gravity in the mean force, the mean norm cannot be smaller, as it would be in g or in exchanged fields.
    """
    gravity = second.gravity
    may_rest = second.vibration < _STILL_FORCE and second.turn < _STILL_TURN
    has_scale = not may_rest or abs(gravity - G) <= _SCALE * G
    return 0.25 * G < gravity < _LARGE and has_scale and all(second.spread)
