"""Words for fixes that are not used: what they name has to be possible."""

import pytest

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, SatelliteCount
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.gnss.reception import GnssReception
from nav_pose_estimator.engine.sensors.gnss.velocity_report import VelocityReport


class StandingStill:
    """A check by which the velocity is so much too large that the positions hardly move."""

    stands_still, name = True, "57 times m/s"


@pytest.mark.parametrize(
    ("place", "word"), [((0.83, 0.15), "radians"), ((47.4, 8.5), "frozen"), ((0.83, 8.5), "frozen")]
)
def test_only_what_can_be_radians_is_called_so(place: tuple[float, float], word: str) -> None:
    """No latitude in radians is above 1.6, no longitude above 3.2."""
    assert word in VelocityReport(Journal()).positions(StandingStill(), place, 0)


def test_a_gate_says_how_many_satellites_it_needs() -> None:
    parameters, journal = Parameters(), Journal()
    reception = GnssReception(parameters.gnss, Aiding(2.0), journal)
    for k in range(20):
        reception.count(SatelliteCount(None, 3), 0.2 * k)
        assert not reception.fix(GnssFix(k, 0.8, 0.1, 400.0), 0.2 * k, 0.2 * k)
    assert reception.refusal == f"too few satellites, {parameters.gnss.gate.min_satellites_enter} are needed"


@pytest.mark.parametrize(("climb", "is_stuck"), [(0.003, False), (0.5, True)])
def test_the_weather_shows_no_stuck_receiver(climb: float, is_stuck: bool) -> None:
    """GIVEN a receiver that holds its position for an hour WHEN the pressure altitude drifts as by weather THEN its
    fixes are used; a climb refuses them."""
    reception = GnssReception(Parameters().gnss, Aiding(2.0), Journal())
    used = []
    for k in range(3600):
        reception.velocities.barometric_height(100.0 + climb * k)
        used.append(reception.fix(GnssFix(k, 0.8, 0.1, 400.0), float(k), float(k)))
        reception.velocity(GnssVelocity(k, (0.0, 0.0, 0.0)), float(k))
    assert all(used[60:]) is not is_stuck
    assert any(used[60:]) is not is_stuck
