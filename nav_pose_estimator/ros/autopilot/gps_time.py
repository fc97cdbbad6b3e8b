"""GPS time in the format of receivers: week and milliseconds of the week."""

_GPS_EPOCH_S = 315_964_800  # 1980-01-06, UTC
_WEEK_MS = 604_800_000
GPS_MINUS_UTC_S = 18
"""Leap seconds between GPS and UTC since 2017-01-01 (IERS Bulletin C); none has been announced since."""
_SINCE_S = 1_483_228_800  # 2017-01-01, UTC: begin of the validity of ``GPS_MINUS_UTC_S``


def week_and_milliseconds(stamp_ns: int) -> tuple[int, int]:
    """GPS week and millisecond of the week of a UTC stamp.

    (0, 0), which means unknown, for a stamp before 2017: simulated time, time since boot, or a clock that was not set.
    """
    if stamp_ns < _SINCE_S * 10**9:
        return 0, 0
    gps_ms = stamp_ns // 10**6 + (GPS_MINUS_UTC_S - _GPS_EPOCH_S) * 1000
    return divmod(gps_ms, _WEEK_MS)
