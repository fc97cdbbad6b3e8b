"""Conversion of GPS weeks to UTC, with week rollover and leap seconds."""

import numpy as np

Array = np.ndarray
_GPS_EPOCH = 315_964_800  # s from 1970-01-01 to 1980-01-06, UTC
WEEK = 604_800  # s
ROLLOVER = 1024  # weeks: receivers send the week in ten bits
_OLDEST_WEEK = 1565  # January 2010: the logs of these autopilots are not older
_LAST_WEEK = 10_000  # larger weeks are invalid
OLDEST_UTC = _GPS_EPOCH + _OLDEST_WEEK * WEEK
# (begin of validity [s of UTC since 1970], leap seconds between GPS and UTC), by IERS Bulletin C
_LEAP_SECONDS = ((1_230_768_000, 15), (1_341_100_800, 16), (1_435_708_800, 17), (1_483_228_800, 18))


def utc_from_gps_week(week: Array, millisecond_of_week: Array) -> Array:
    """UTC [µs since 1970] (N,) int64 of GPS weeks and milliseconds of week, int64; 0 where the week is unknown.

    A week before 2010 is due to a rollover, and 1024 weeks are added.
    """
    known = (week > 0) & (week < _LAST_WEEK)
    gps_ms = (np.where(known, week, 0) * WEEK + _GPS_EPOCH) * 1000 + millisecond_of_week
    return np.where(known, _without_leap_seconds(rolled(gps_ms * 1000)), 0)


def rolled(utc_us: Array) -> Array:
    """Times [µs since 1970], of which those before 2010 are increased by whole rollovers; 0 (unknown) remains."""
    behind = np.maximum(OLDEST_UTC * 10**6 - utc_us, 0)
    step = ROLLOVER * WEEK * 10**6
    return np.where(utc_us > 0, utc_us + -(-behind // step) * step, 0)


def _without_leap_seconds(gps_us: Array) -> Array:
    leap = np.zeros(gps_us.shape, np.int64)
    for since, seconds in _LEAP_SECONDS:
        leap[gps_us >= (since + seconds) * 10**6] = seconds
    return gps_us - leap * 10**6
