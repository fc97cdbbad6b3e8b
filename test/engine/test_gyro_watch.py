"""When a doubt about the gyroscope begins, ends and returns, and what is said of it."""

import numpy as np

from nav_pose_estimator.core.alignment.gyro_evidence import SIZE
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.sensors.gyroscope.watch import GyroWatch, Second

STILL = np.zeros(3)
LONG = 60  # s


class Watched:
    """A watch, and the names and texts of what it has said."""

    def __init__(self) -> None:
        self.watch, self.journal = GyroWatch(), Journal()
        self.releases = 0

    def seconds(self, count: int, scales: tuple[float, float, float] = (0.0, 0.0, 0.0), **seen: object) -> None:
        """The same second ``count`` times; scale factors of which GNSS has said all."""
        m = np.zeros(SIZE)
        m[[0, 4, 8]] = scales
        values = {"bias": STILL, "nis": 0.1} | seen
        for _ in range(count):
            self.releases += self.watch.second(Second(m, 1e-4 * np.eye(SIZE), **values), self.journal, 0)

    def contradict(self) -> None:
        """Seconds in which the filter's estimate contradicts its prior."""
        for mean, share in ((0.0, 1.0), (0.05, 0.5)):
            second = Second(np.full(SIZE, mean), 1e-4 * share * np.eye(SIZE), STILL, 0.1)
            self.releases += self.watch.second(second, self.journal, 0)

    def shown_right(self) -> None:
        """A second in which GNSS shows all scale factors to be right within 2 %."""
        self.releases += self.watch.second(Second(np.zeros(SIZE), 8e-5 * np.eye(SIZE), STILL, 0.1), self.journal, 0)

    @property
    def said(self) -> list[str]:
        return [event.name for event in self.journal.drain()]


def test_a_suspicion_of_signs_or_axes_is_a_doubt() -> None:
    """GIVEN a sound estimate WHEN other axes explain a manoeuvre far better THEN there is a doubt, and a wide prior."""
    watched = Watched()
    watched.seconds(5)
    assert watched.watch.reason == ""
    watched.seconds(1, suspected=True)
    assert "gyroscope" in watched.watch.reason
    assert watched.releases == 1
    assert watched.said == ["imu.gyroscope.doubted"]


def test_rest_does_not_end_a_suspicion() -> None:
    """GIVEN a suspicion WHEN the vehicle hovers and GNSS agrees THEN it stays, until manoeuvres agree."""
    watched = Watched()
    watched.seconds(1, suspected=True)
    watched.seconds(LONG)
    assert watched.watch.reason
    watched.seconds(LONG, agrees=True)
    assert watched.watch.reason == ""
    assert watched.said == ["imu.gyroscope.doubted", "imu.gyroscope.fits"]


def test_a_large_scale_has_to_be_confirmed_by_motion() -> None:
    """GIVEN a doubt WHEN a scale factor of 0.5 is learned THEN rest does not end the doubt, but manoeuvres do."""
    watched = Watched()
    watched.contradict()
    watched.seconds(LONG, scales=(0.0, 0.0, 0.5))
    assert watched.watch.reason
    watched.seconds(LONG, scales=(0.0, 0.0, 0.5), agrees=True)
    assert watched.said == ["imu.gyroscope.doubted", "imu.gyroscope.scale"]


def test_a_small_scale_needs_no_manoeuvre() -> None:
    """GIVEN a doubt WHEN a scale factor of 0.2 is learned and GNSS agrees for 20 s THEN the doubt ends, and no later
    evidence of the same kind raises it again."""
    watched = Watched()
    watched.contradict()
    watched.seconds(LONG, scales=(0.0, 0.0, 0.2))
    assert watched.watch.reason == ""
    assert watched.said == ["imu.gyroscope.doubted", "imu.gyroscope.scale"]


def test_a_doubt_returns_when_what_was_learned_is_wrong() -> None:
    """GIVEN a learned scale WHEN GNSS contradicts the filter for some seconds THEN it is in doubt again; a single
    second is no reason."""
    watched = Watched()
    watched.contradict()
    watched.seconds(LONG, scales=(0.0, 0.0, 0.2))
    watched.seconds(1, nis=5.0)
    watched.seconds(5)
    assert watched.watch.reason == ""
    watched.seconds(5, nis=5.0)
    assert watched.watch.reason
    assert watched.releases == 1
    assert watched.said == ["imu.gyroscope.doubted", "imu.gyroscope.scale", "imu.gyroscope.doubted"]


def test_turns_that_the_magnetometer_contradicts_are_a_doubt_until_gnss_shows_yaw() -> None:
    """GIVEN a magnetometer that turns differently THEN the heading is in doubt, which is said once, and no longer once
    GNSS has shown the yaw axis to be right."""
    watched = Watched()
    watched.seconds(3, compass_differs=True)
    assert "magnetometer" in watched.watch.compass_reason
    assert watched.watch.reason == ""
    watched.shown_right()
    watched.seconds(3, compass_differs=True)
    assert watched.watch.compass_reason == ""
    assert watched.said == ["imu.gyroscope.compass"]


def test_a_restart_within_a_doubt_is_no_news() -> None:
    """GIVEN a doubt WHEN the filter restarts THEN the prior is released again, and nothing is said."""
    watched = Watched()
    watched.contradict()
    watched.watch.filter_restarts()
    watched.seconds(2)
    assert watched.watch.reason
    assert watched.releases == 2
    assert watched.said == ["imu.gyroscope.doubted"]


def test_a_bias_that_has_changed_is_named() -> None:
    """GIVEN a doubt WHEN GNSS agrees with right scales and another bias THEN the change of the bias is said."""
    watched = Watched()
    watched.contradict()
    watched.seconds(LONG, bias=np.radians([0.0, 0.5, 0.01]))
    [text] = [event.text for event in watched.journal.drain() if event.name == "imu.gyroscope.fits"]
    assert "bias about y has changed by 0.50 deg/s" in text
