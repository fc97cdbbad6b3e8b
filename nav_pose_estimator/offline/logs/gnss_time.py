"""Conversion of GPS weeks to UTC, with week rollover and leap seconds."""

import numpy as np

from nav_pose_estimator.core.earth.gps_time import EPOCH_S, LEAP_SECONDS, WEEK_S

Array = np.ndarray
ROLLOVER = 1024  # weeks: receivers send the week in ten bits
_OLDEST_WEEK = 1565  # January 2010: the logs of these autopilots are not older
_LAST_WEEK = 10_000  # larger weeks are invalid
OLDEST_UTC = EPOCH_S + _OLDEST_WEEK * WEEK_S


def utc_from_gps_week(week: Array, millisecond_of_week: Array) -> Array:
    """UTC [µs since 1970] (N,) int64 of GPS weeks and milliseconds of week, int64; 0 where the week is unknown.

    A week before 2010 is due to a rollover, and 1024 weeks are added.
    """
    known = (week > 0) & (week < _LAST_WEEK)
    gps_ms = (np.where(known, week, 0) * WEEK_S + EPOCH_S) * 1000 + millisecond_of_week
    return np.where(known, _without_leap_seconds(rolled(gps_ms * 1000)), 0)


def rolled(utc_us: Array) -> Array:
    """Times [µs since 1970], of which those before 2010 are increased by whole rollovers; 0 (unknown) remains."""
    behind = np.maximum(OLDEST_UTC * 10**6 - utc_us, 0)
    step = ROLLOVER * WEEK_S * 10**6
    return np.where(utc_us > 0, utc_us + -(-behind // step) * step, 0)


def _without_leap_seconds(gps_us: Array) -> Array:
    leap = np.zeros(gps_us.shape, np.int64)
    for since, seconds in LEAP_SECONDS:
        leap[gps_us >= (since + seconds) * 10**6] = seconds
    return gps_us - leap * 10**6
