"""GNSS velocities and positions that contradict each other: which is wrong, how soon it is known, what is undone."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.navigator.go_back import UNDONE
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, Sample
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.faults import Fault, Freeze
from nav_pose_estimator.sim.sensors import Timed
from told import Told, flight, silence, tell

pytestmark = pytest.mark.compiled
MOTION = 27.0  # s: when the flight begins to move along the ground
LOST, LENGTH = 45.0, 20.0  # s
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Rewrite(Fault):
    """``change`` gives what arrives instead of a sample."""

    change: Callable[[Any], Any] = lambda sample: sample

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        return timed._replace(sample=self.change(timed.sample))


@dataclass(frozen=True)
class Late(Fault):
    """The velocity of ``samples`` ago with the stamp of now."""

    samples: int = 5
    before: list = None  # type: ignore[assignment]

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        self.before.append(timed.sample.vel_enu)
        return timed._replace(sample=replace(timed.sample, vel_enu=self.before[max(number - self.samples, 0)]))


def base():
    return flight("multirotor_outage", 70.0)


def velocity(new: Callable[[float, float, float], Vector]) -> Rewrite:
    return Rewrite(GnssVelocity, change=lambda v: replace(v, vel_enu=new(*v.vel_enu)))


def position(new: Callable[[GnssFix], GnssFix]) -> Rewrite:
    return Rewrite(GnssFix, change=new)


def in_body(v: GnssVelocity) -> GnssVelocity:
    truth = base().truth
    row = min(int(np.searchsorted(truth.t, (v.stamp_ns - base().start_ns) * 1e-9)), len(truth) - 1)
    return replace(v, vel_enu=tuple((quat_to_matrix(truth.q_nb[row]).T @ np.array(v.vel_enu)).tolist()))


MENDED = {
    "North-East-Down": velocity(lambda e, n, u: (n, e, -u)),
    "West-North": velocity(lambda e, n, u: (-e, n, u)),
    "West-South": velocity(lambda e, n, u: (-e, -n, u)),
    "knots": velocity(lambda e, n, u: (1.944 * e, 1.944 * n, 1.944 * u)),
    "0.5 times m/s": velocity(lambda e, n, u: (0.5 * e, 0.5 * n, 0.5 * u)),
    "cm/s": velocity(lambda e, n, u: (100.0 * e, 100.0 * n, 100.0 * u)),
}
DROPPED = {
    "the vehicle's own": Rewrite(GnssVelocity, change=in_body),
    "its axes look like": velocity(lambda e, n, u: (math.hypot(e, n), 0.0, u)),
    "stays zero while": velocity(lambda e, n, u: (0.0, 0.0, 0.0)),
    "repeats itself": Freeze(GnssVelocity, 32.0),
}
WRONG_POSITIONS = {
    "exchanged": position(lambda f: replace(f, lat=f.lon, lon=f.lat)),
    "longitude looks inverted": position(lambda f: replace(f, lon=-f.lon)),
    "latitude looks inverted": position(lambda f: replace(f, lat=-f.lat)),
    "radians": position(lambda f: replace(f, lat=math.radians(f.lat), lon=math.radians(f.lon))),
}


def lost(*faults: Fault) -> Told:
    return tell(base(), *faults, *silence(LOST, LENGTH), learner__method="coast")


@cache
def usual() -> Told:
    return lost()


@cache
def positions_alone() -> Told:
    return lost(velocity(lambda e, n, u: (math.nan, math.nan, math.nan)))


def end(told: Told) -> float:
    """Horizontal error at the end of the outage [m]."""
    return float(told.off[told.between(LOST + LENGTH - 0.3, LOST + LENGTH)].mean())


def honest(told: Told) -> bool:
    inside = told.between(LOST, LOST + LENGTH)
    return bool((told.off[inside] < 3.0 * told.sigma[inside]).all())


@pytest.mark.parametrize("name", MENDED)
def test_a_mistake_that_is_known_beyond_doubt_is_undone(name: str) -> None:
    """GIVEN velocities in wrong axes or units WHEN GNSS is lost a quarter of a minute after the first motion
    THEN what is wrong is named, what it did is undone, and the outage ends as with sound velocities."""
    told = lost(MENDED[name])
    assert any(name in event.text for event in told.events if event.name.startswith("gnss.velocity.axes"))
    assert told.when("gnss.velocity.turned")[0] < LOST
    assert told.when(UNDONE)
    assert honest(told)
    assert end(told) < 1.2 * end(usual()) + 2.0


@pytest.mark.parametrize("name", DROPPED)
def test_velocities_that_cannot_be_put_right_leave_no_trace(name: str) -> None:
    """GIVEN velocities that no turn mends WHEN GNSS is lost THEN the outage ends as with positions alone."""
    told = lost(DROPPED[name])
    assert any(name in event.text for event in told.events if event.name.startswith("gnss.velocity.axes"))
    assert told.when(UNDONE)[-1] < MOTION + 10.0
    assert honest(told)
    assert end(told) < 1.2 * max(end(usual()), end(positions_alone())) + 2.0


def test_late_velocities_are_used_as_of_their_time() -> None:
    """GIVEN velocities a second late THEN that is told with the amount, and the outage is as good as usual."""
    told = lost(Late(GnssVelocity, before=[]))
    assert "1 s late" in told.event("gnss.velocity.late").text
    assert honest(told)
    assert end(told) < 1.2 * end(usual()) + 3.0


@pytest.mark.parametrize("name", WRONG_POSITIONS)
def test_positions_that_the_imu_contradicts_are_refused(name: str) -> None:
    """GIVEN latitude and longitude exchanged, inverted or in radians WHEN the vehicle manoeuvres
    THEN the IMU tells that the velocity is right, the mistake is named, and no position is said to be good."""
    told = tell(base(), WRONG_POSITIONS[name], learner__method="coast")
    assert name in told.event("gnss.position.axes").text
    assert told.modes[-1] is Mode.EXPIRED


def test_a_wrong_velocity_is_not_blamed_on_positions() -> None:
    """GIVEN velocities North-East-Down THEN positions are never refused."""
    told = tell(base(), MENDED["North-East-Down"], learner__method="coast")
    assert told.when("gnss.position.axes") == []
    assert told.modes[-1] is Mode.AIDED


def test_positions_that_stay_while_the_vehicle_moves_are_stuck() -> None:
    """GIVEN a flight WHEN positions freeze and velocities go on THEN that is an outage, and named."""
    told = tell(base(), Freeze(GnssFix, 45.0, 15.0), learner__method="coast")
    assert "stuck" in told.event("gnss.rejected.stuck").text
    assert told.when("gnss.velocity.axes") == []
    assert Mode.AIDED not in told.modes_between(50.0, 59.0)
    assert told.modes[-1] is Mode.AIDED


def _nmea(angle: float) -> float:
    """Degrees and minutes as ddmm.mm, taken for degrees."""
    degrees, minutes = divmod(math.degrees(angle) * 60.0, 60.0)
    return math.radians(100.0 * degrees + minutes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: replace(f, lat=1e7 * f.lat, lon=1e7 * f.lon), "is it in degrees times 1e7?"),
        (lambda f: replace(f, lat=_nmea(f.lat), lon=_nmea(f.lon)), "is it in NMEA's ddmm.mm?"),
        (lambda f: replace(f, lat=f.lon + 2.4, lon=f.lat), "are latitude and longitude exchanged?"),
        (lambda f: replace(f, lat=math.nan), "latitude or longitude is NaN or infinite"),
        (lambda f: replace(f, alt=1000.0 * f.alt), "is it in mm?"),
        (lambda f: replace(f, lat=math.radians(277.7)), "277.7000, 8.5456 deg is not a place on Earth"),
    ],
)
def test_a_position_that_is_not_on_earth_is_named(change, words: str) -> None:
    """GIVEN positions that cannot be THEN there is no pose, and the likely cause is said."""
    told = tell(base(), position(change), learner__method="coast")
    assert told.last is None
    assert words in told.event("gnss.rejected.value").text


@pytest.mark.parametrize(("factor", "words"), [(3.2808, "in feet"), (-1.0, "positive down"), (100.0, "in cm")])
def test_a_height_that_barometer_and_velocity_contradict_is_not_used(factor: float, words: str) -> None:
    """GIVEN heights in feet, in cm or positive down WHEN the vehicle has climbed
    THEN what they are is named, and the height comes from the barometer, as good as it says."""
    told = tell(base(), position(lambda f: replace(f, alt=factor * f.alt)), learner__method="coast")
    assert words in told.event("gnss.height.unit").text
    assert told.last is not None
    assert abs(told.error[-1, 2]) < 3.0 * math.sqrt(told.last.cov[8, 8])
    assert told.modes[-1] is Mode.AIDED


def test_the_odometry_does_not_jump_when_the_past_is_undone() -> None:
    """GIVEN velocities in wrong axes WHEN the navigator goes back THEN map takes the jump, and odom goes on."""
    told = lost(MENDED["West-North"])
    smooth = told.position - told.correction
    steps = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
    assert told.resets[-1] >= 1
    for t in told.when(UNDONE):
        assert steps[told.between(t - 0.5, t + 0.5)[1:]].max() < 0.5


def test_fixes_that_a_wrong_velocity_keeps_off_widen_sigma():
    """GIVEN velocities turned by 10 deg, too little to be told WHEN they drag the navigator off the fixes for seconds
    THEN its sigma covers what lies between, and a sound flight is as it was."""
    c, s = math.cos(math.radians(10.0)), math.sin(math.radians(10.0))
    told = tell(flight("laps", 90.0), velocity(lambda e, n, u: (c * e - s * n, s * e + c * n, u)))
    sound = tell(flight("laps", 90.0), gnss__delay_sd=0.0)
    wrong = (told.off > 3.0 * told.sigma) & (told.off > 3.0)
    assert wrong[told.t > 20.0].mean() < 0.2
    assert told.count("imu_doubt.used") > sound.count("imu_doubt.used")
    assert sound.sigma[-1] < 1.2
