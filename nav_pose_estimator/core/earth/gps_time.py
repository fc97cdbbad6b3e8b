"""GPS time: week and milliseconds of the week, as receivers send it."""

EPOCH_S = 315_964_800  # 1980-01-06, UTC [s since 1970]
WEEK_S = 604_800
LEAP_SECONDS = ((1_230_768_000, 15), (1_341_100_800, 16), (1_435_708_800, 17), (1_483_228_800, 18))
"""(begin of validity [s of UTC since 1970], GPS minus UTC [s]) since 2009, by IERS Bulletin C; the last is of 2017."""


def week_and_milliseconds(stamp_ns: int) -> tuple[int, int]:
    """GPS week and millisecond of the week of a UTC stamp.

    (0, 0), which means unknown, for a stamp before 2017: simulated time, time since boot, or a clock that was not set.
    """
    since_s, gps_minus_utc_s = LEAP_SECONDS[-1]
    if stamp_ns < since_s * 10**9:
        return 0, 0
    gps_ms = stamp_ns // 10**6 + (gps_minus_utc_s - EPOCH_S) * 1000
    return divmod(gps_ms, WEEK_S * 1000)
