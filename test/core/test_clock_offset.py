"""Two clocks that differ, in words."""

import pytest

from nav_pose_estimator.core.gnss.clock_offset import in_words

NOW = 1.7e9  # s since 1970


@pytest.mark.parametrize(
    ("stamp", "reference", "words"),
    [
        (NOW + 18.0, NOW, "18.0 s ahead of the IMU's: GPS time against UTC, the leap seconds"),
        (NOW - 17.8, NOW, "17.8 s behind the IMU's: GPS time against UTC, the leap seconds (taken off twice"),
        (NOW, 5.0, "53.9 years ahead of the IMU's: the IMU's count from the start of a board, these are UTC"),
        (5.0, NOW, "53.9 years behind the IMU's: these count from the start of a board, the IMU's are UTC"),
        (NOW - 619315200.0, NOW, "19.6 years behind the IMU's: 1024 weeks"),
        (NOW + 19800.0, NOW, "19800 s ahead of the IMU's: a time zone"),
        (NOW + 8470.0, NOW, "8470 s ahead of the IMU's: clocks that are not synchronised"),
        (NOW + 1.5, NOW, "1.5 s ahead of the IMU's: clocks that are not synchronised, or IMU messages that come late"),
        (NOW - 1.5, NOW, "1.5 s behind the IMU's: clocks that are not synchronised, or messages that come late"),
    ],
)
def test_amount_and_cause(stamp: float, reference: float, words: str) -> None:
    assert words in in_words(stamp - reference, stamp, reference)
