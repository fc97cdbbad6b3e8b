"""GNSS that is sound in itself, and not this vehicle's: a base station, another drone, two receivers on one topic."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, Sample
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.sensors import Timed
from told import GNSS, Told, flight, tell

pytestmark = pytest.mark.compiled
SECONDS, MANOEUVRED = 75.0, 50.0  # of the flight: its length, when it has accelerated for ten seconds


def base_station(recording: Recording, velocity: bool) -> Iterator[Sample]:
    """The first fix again and again, with a receiver's noise; its velocity is nearly zero, or there is none."""
    first = next(timed.sample for timed in recording.others if isinstance(timed.sample, GnssFix))
    rng = np.random.default_rng(8)
    for sample in recording.samples():
        if isinstance(sample, GnssFix):
            east, north, up = rng.normal(0.0, 0.3, 3) / (6.4e6, 6.4e6, 1.0)
            yield replace(sample, lat=first.lat + north, lon=first.lon + east, alt=first.alt + up)
        elif not isinstance(sample, GnssVelocity):
            yield sample
        elif velocity:
            yield replace(sample, vel_enu=tuple(rng.normal(0.0, 0.03, 3).tolist()))


def of_another_drone(recording: Recording, other: Recording) -> Iterator[Sample]:
    """The receiver of another drone that takes off beside this one."""

    def receiver(of: Recording, wanted: bool) -> list[Timed]:
        return [timed for timed in of.others if isinstance(timed.sample, GNSS) is wanted]

    both = sorted(receiver(recording, False) + receiver(other, True), key=lambda timed: timed.arrival_ns)
    return replace(recording, others=both).samples()


def assert_not_believed(told: Told) -> None:
    """From some seconds of manoeuvres on the pose is doubted, and its sigma covers the truth."""
    status = told.estimator.status()
    assert "tell different motions" in status.doubt
    assert "another vehicle" in told.event("gnss.other_motion").text
    late = told.between(MANOEUVRED, SECONDS)
    assert np.mean(told.off[late] > 3.0 * told.sigma[late]) < 0.05
    assert told.off[late].max() > 50.0, "what is doubted is wrong indeed"
    assert told.count("imu.implausible") == 0, "nothing is said of the IMU, which is sound"


@pytest.mark.parametrize("velocity", [True, False], ids=["velocity of zero", "no velocity"])
def test_fixes_of_a_base_station_are_not_believed_once_the_vehicle_moves(velocity: bool) -> None:
    """GIVEN positions that stay WHEN the IMU feels manoeuvres THEN the status says that these differ."""
    recording = flight("multirotor_light", SECONDS)
    assert_not_believed(tell(recording, samples=base_station(recording, velocity), learner__enabled=False))


def test_fixes_of_another_drone_are_not_believed_once_both_move() -> None:
    """GIVEN the receiver of another drone WHEN both manoeuvre differently for long THEN the status says so."""
    recording, other = flight("multirotor_light", SECONDS), flight("multirotor_light", SECONDS, seed=16)
    assert_not_believed(tell(recording, samples=of_another_drone(recording, other), learner__enabled=False))


def test_two_receivers_on_one_topic_are_told_and_covered() -> None:
    """GIVEN fixes of two receivers, 40 m apart, in turn WHEN the filter keeps to one of them
    THEN the status says so within seconds, and sigma covers both."""
    recording = flight("multirotor_light", 30.0)

    def in_turn() -> Iterator[Sample]:
        number = 0
        for sample in recording.samples():
            if isinstance(sample, GnssFix):
                number += 1
                sample = replace(sample, lon=sample.lon + (number % 2) * 40.0 / 4.33e6)
            yield sample

    told = tell(recording, samples=in_turn(), learner__enabled=False)
    assert told.when("gnss.two_places")[0] < 10.0
    assert "two receivers" in told.estimator.status().doubt
    late = told.between(11.0, 30.0)
    assert told.off[late].max() > 20.0
    assert np.all(told.off[late] < 3.0 * told.sigma[late])


def test_a_receiver_that_comes_to_itself_is_believed_again() -> None:
    """GIVEN fixes that stay for 30 s of flight WHEN they follow the vehicle again
    THEN the doubt is named while it lasts and ends when motion has shown that both agree."""
    recording = flight("multirotor_light", 105.0)
    held: dict[type, Sample] = {}
    rng = np.random.default_rng(6)

    def frozen() -> Iterator[Sample]:
        now = 0.0
        for sample in recording.samples():
            if isinstance(sample, GnssFix):
                now = (sample.stamp_ns - recording.start_ns) * 1e-9
            if not (35.0 < now < 62.0 and isinstance(sample, GnssFix | GnssVelocity)):
                yield sample
            elif isinstance(sample, GnssFix):
                here = held.setdefault(GnssFix, sample)
                yield replace(here, stamp_ns=sample.stamp_ns, lat=here.lat + rng.normal(0.0, 1e-9))
            else:
                yield replace(sample, vel_enu=tuple(rng.normal(0.0, 0.02, 3).tolist()))

    told = tell(recording, samples=frozen(), learner__enabled=False)
    assert min(told.when("gnss.other_motion")) > 38.0
    assert told.when("gnss.other_motion.ended", after=62.0)
    assert told.off[-1] < 3.0
