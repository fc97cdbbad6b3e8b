"""A spoofer that drags positions and velocities away together: what the IMU can tell of it, and what it cannot."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, Sample
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.faults import Fault, Shift
from nav_pose_estimator.sim.sensors import Timed
from told import Told, flight, silence, tell

pytestmark = pytest.mark.compiled
BEGIN, LENGTH, RATE = 60.0, 45.0, 5.0  # s, s, fixes a second


@dataclass(frozen=True)
class Drag(Fault):
    """Positions move away at ``velocity`` (East, North) [m/s] and velocities say so; it sets in within ``ramp`` [s]."""

    velocity: tuple[float, float] = (0.0, 0.0)
    ramp: float = 0.0

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        t = number / RATE
        share = min(t / self.ramp, 1.0) if self.ramp else 1.0
        seconds = 0.5 * t * share if share < 1.0 else t - 0.5 * self.ramp
        grown = seconds if self.sensor is GnssFix else share
        east, north = self.velocity
        return Shift(self.sensor, offset=(grown * east, grown * north, 0.0)).spoil(timed, healthy, number)


def dragged(name: str, seed: int, speed: float, ramp: float = 0.0, azimuth: float = 0.5) -> Told:
    velocity = speed * math.cos(azimuth), speed * math.sin(azimuth)
    faults = [Drag(kind, BEGIN, LENGTH, velocity, ramp) for kind in (GnssFix, GnssVelocity)]
    return tell(flight(name, seed=seed), *faults, learner__method="coast")


@pytest.mark.parametrize(
    ("name", "seed", "speed", "azimuth"),
    [("multirotor_light", 2, 2.0, 0.5), ("multirotor_light", 5, 2.0, 0.5), ("road_vehicle", 3, 1.0, -1.0)],
)
def test_a_drag_is_noticed_when_it_begins_and_the_truth_is_taken(name, seed, speed, azimuth) -> None:
    """GIVEN an aided navigator WHEN GNSS is dragged off by 1 or 2 m/s, its velocities with it, and let go again
    THEN that is told within 8 s, sigma covers the way, the status says why, and the truth is back at once."""
    told = dragged(name, seed, speed, azimuth=azimuth)
    assert BEGIN < told.when("gnss.pulled")[0] < BEGIN + 8.0
    late = told.between(BEGIN + 8.0, BEGIN + LENGTH)
    assert told.off[late].max() > 0.9 * speed * 40.0  # it is followed: nobody knows who is right
    assert np.mean(told.off[late] < 3.0 * told.sigma[late]) > 0.98
    assert told.modes_between(BEGIN, 120.0) == {Mode.AIDED}
    assert told.off[told.t > BEGIN + LENGTH + 3.0].max() < 3.0
    assert told.when("gnss.pulled.ended")


@pytest.mark.parametrize("speed", [6.0, 15.0])
def test_a_fast_drag_is_noticed_after_the_filter_has_given_in(speed: float) -> None:
    """GIVEN an aided navigator WHEN GNSS is dragged off so fast that its velocities are refused at first
    THEN the doubt about that passes over into the one about the drag, and sigma covers the way."""
    faults = [Drag(kind, BEGIN, LENGTH, (speed, 0.0)) for kind in (GnssFix, GnssVelocity)]
    told = tell(flight(duration=80.0), *faults, learner__method="coast")
    assert "without a force" in told.estimator.status().doubt
    late = told.between(BEGIN + 8.0, 80.0)
    assert np.mean(told.off[late] < 3.0 * told.sigma[late]) > 0.98


def test_the_status_names_the_drag() -> None:
    """GIVEN a drag that was noticed THEN the status is in doubt and says by how much."""
    faults = [Drag(kind, BEGIN, LENGTH, (2.0, 0.0)) for kind in (GnssFix, GnssVelocity)]
    told = tell(flight(duration=80.0), *faults, learner__method="coast")
    assert "without a force" in told.estimator.status().doubt


def test_an_outage_in_a_drag_is_covered_by_its_sigma() -> None:
    """GIVEN a drag WHEN GNSS is lost in the midst of it THEN sigma covers both its way and its speed."""
    faults = [Drag(kind, BEGIN, LENGTH, (2.0, 0.0)) for kind in (GnssFix, GnssVelocity)]
    told = tell(flight(), *faults, *silence(80.0, 20.0), learner__method="coast")
    rows = told.between(BEGIN + 8.0, 100.0)
    assert np.mean(told.off[rows] < 3.0 * told.sigma[rows]) > 0.98


def test_a_drag_that_sets_in_slowly_is_not_noticed() -> None:
    """GIVEN 1 m/s that sets in within 20 s THEN nothing is told: 0.05 m/s^2 look like 0.3 deg of tilt (a limit)."""
    told = dragged("multirotor_light", 2, 1.0, ramp=20.0)
    assert not [t for t in told.when("gnss.pulled") if t < BEGIN + LENGTH]
