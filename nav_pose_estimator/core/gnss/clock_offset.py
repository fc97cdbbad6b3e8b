"""Offset between the clocks of a sensor and the IMU, in words, with its likely cause."""

from __future__ import annotations

from nav_pose_estimator.core.earth.gps_time import LEAP_SECONDS

_DAY = 86_400.0  # s
_YEAR = 365.25 * _DAY
_WEEK_ROLLOVER = 1024 * 7 * _DAY
_LEAP_SECONDS = [seconds for _, seconds in LEAP_SECONDS[1:]]  # since 2012: GPS minus UTC [s]
_LATENCY = 0.7  # s: tolerance of an offset, because the latency of the messages is contained in it
_BOOT = 10.0 * _YEAR  # earlier stamps count from the boot of a board and not from 1970


def in_words(ahead: float, stamp: float, reference: float) -> str:
    """One clause for the user: offset of a stamp from the IMU's clock, and its likely cause.

    Args:
        ahead: stamp minus time of the IMU [s], not zero.
        stamp, reference: stamp and time of the IMU as received, in seconds since 1970.
    """
    cause = _cause(ahead, stamp, reference)
    return f"its stamps are {_amount(abs(ahead))} {'ahead of' if ahead > 0.0 else 'behind'} the IMU's: {cause}"


def _amount(seconds: float) -> str:
    if seconds > _YEAR:
        return f"{seconds / _YEAR:.1f} years"
    if seconds > 2.0 * _DAY:
        return f"{seconds / _DAY:.1f} days"
    return f"{seconds:.0f} s" if seconds > 100.0 else f"{seconds:.1f} s"


def _cause(ahead: float, stamp: float, reference: float) -> str:
    size = abs(ahead)
    if abs(size - _WEEK_ROLLOVER) < 2.0 * _DAY:
        return "1024 weeks, a week number that rolled over in an old receiver"
    if min(stamp, reference) < _BOOT < max(stamp, reference):
        from_boot, utc = ("the IMU's", "these") if reference < stamp else ("these", "the IMU's")
        return f"{from_boot} count from the start of a board, {utc} are UTC"
    if any(abs(size - leap) < _LATENCY for leap in _LEAP_SECONDS):
        return "GPS time against UTC, the leap seconds" + ("" if ahead > 0.0 else " (taken off twice, or the IMU's)")
    half_hours = round(size / 1800.0)
    if 0 < half_hours <= 28 and abs(size - 1800.0 * half_hours) < 2.0:
        return "a time zone, local time against UTC"
    if size < 5.0:
        return f"clocks that are not synchronised, or {'IMU messages' if ahead > 0.0 else 'messages'} that come late"
    return "clocks that are not synchronised"
