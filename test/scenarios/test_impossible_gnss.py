"""GNSS and barometer that say what cannot be: noticed before they are trusted, named, and the good half goes on."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    MagSample,
    PressureSample,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.engine.solutions import Level, Mode
from nav_pose_estimator.sim.faults import Fault, Freeze, Redate, Shift, Stop
from nav_pose_estimator.sim.sensors import Timed
from told import Told, flight, tell

pytestmark = pytest.mark.compiled
DAY = 86_400.0


@dataclass(frozen=True)
class Rewrite(Fault):
    """``change`` gives what arrives instead of a sample, from the sample and its number; None is nothing."""

    change: Callable[[Any, int], Any] = lambda sample, number: sample

    def spoil(self, timed: Timed, healthy: Sample | None, number: int) -> Timed | None:
        changed = self.change(timed.sample, number)
        return None if changed is None else timed._replace(sample=changed)


def baseline() -> Told:
    """The same flight without a fault."""
    return tell(flight())


def rms(told: Told, start: float = 20.0, end: float = 120.0) -> tuple[float, float]:
    """Horizontal and vertical error [m]."""
    rows = told.between(start, end)
    return float(np.sqrt(np.mean(told.off[rows] ** 2))), float(np.sqrt(np.mean(told.error[rows, 2] ** 2)))


def as_good_as_ever(told: Told, start: float = 20.0) -> bool:
    """Whether the position is within 1.2 times the error of the flight without a fault."""
    return rms(told, start)[0] < 1.2 * rms(baseline(), start)[0]


def ned(sample: GnssVelocity, _number: int) -> GnssVelocity:
    east, north, up = sample.vel_enu
    return replace(sample, vel_enu=(north, east, -up))


def test_null_island_is_no_fix_before_the_flight() -> None:
    """GIVEN a driver that sends 0/0 before its first fix THEN nothing starts there, and why is said."""
    told = tell(flight(), Rewrite(GnssFix, 0.0, 8.0, lambda fix, _: replace(fix, lat=0.0, lon=0.0, cov_enu=None)))
    assert told.count("gnss.rejected.null_island") >= 30
    assert "exactly zero" in told.event("gnss.rejected.null_island").text
    assert told.t[0] > 8.0
    assert as_good_as_ever(told)


def test_null_island_is_no_fix_in_flight() -> None:
    """GIVEN a flight WHEN three seconds of fixes are 0/0 THEN they are an outage of three seconds, no more."""
    told = tell(flight(), Rewrite(GnssFix, 60.0, 3.0, lambda fix, _: replace(fix, lat=0.0, lon=0.0)))
    assert told.count("gnss.rejected.null_island") == 15
    assert told.off.max() < 5.0
    assert told.modes[-1] is Mode.AIDED


def test_a_start_far_off_moves_the_origin() -> None:
    """GIVEN a receiver that begins 800 km off WHEN it finds its place THEN the navigator starts anew, there."""
    told = tell(flight(), Shift(GnssFix, 0.0, 8.0, (800e3, 100e3, 0.0)))
    assert "km from where the navigator started" in told.event("reset").text
    assert told.off[told.t > told.when("aligned")[-1] + 1.0].max() < 5.0
    lat, lon, _ = told.estimator.origin
    assert math.hypot(lat - flight().origin.lat, lon - flight().origin.lon) < 1e-4


def test_velocity_in_ned_is_dropped_and_then_turned() -> None:
    """GIVEN a velocity North-East-Down THEN its axes are named, and it is turned once that is sure."""
    told = tell(flight(), Rewrite(GnssVelocity, change=ned))
    assert "North-East-Down" in told.event("gnss.velocity.axes.ned").text
    assert told.count("gnss.velocity.turned") == 1
    assert told.modes_between(20.0, 120.0) == {Mode.AIDED}
    assert as_good_as_ever(told, start=told.when("gnss.velocity.turned")[0] + 10.0)


def test_velocity_in_turned_axes_is_put_right() -> None:
    """GIVEN a velocity turned by 130 degrees THEN it is not used, turned back once that is sure, and undone."""
    c, s = math.cos(math.radians(130.0)), math.sin(math.radians(130.0))

    def turn(v: GnssVelocity, _number: int) -> GnssVelocity:
        east, north, up = v.vel_enu
        return replace(v, vel_enu=(c * east - s * north, s * east + c * north, up))

    told = tell(flight(), Rewrite(GnssVelocity, change=turn))
    assert re.search(r"turned by 1[23]\d deg", told.event("gnss.velocity.turned").text)
    assert told.count("gnss.velocity.undone") >= 1
    assert told.modes[-1] is Mode.AIDED
    assert as_good_as_ever(told, start=told.when("gnss.velocity.turned")[0] + 1.0)
    assert np.mean(told.off < 3.0 * told.sigma) > 0.97


def test_a_vertical_velocity_that_is_never_filled_is_named() -> None:
    """GIVEN vz = 0 for ever WHEN the vehicle climbs THEN it is named and the height is as good as ever."""
    told = tell(flight(), Rewrite(GnssVelocity, change=lambda v, _: replace(v, vel_enu=(*v.vel_enu[:2], 0.0))))
    assert "does not fill it" in told.event("gnss.velocity.vertical.silent").text
    assert rms(told)[1] < 1.2 * rms(baseline())[1]


def test_a_height_in_feet_is_told_without_a_barometer() -> None:
    """GIVEN a height in feet and no barometer WHEN the vehicle climbs THEN that is said, the status is in doubt from
    then on, and the horizontal position is as good as ever; in metres nothing is said."""
    no_barometer = Rewrite(PressureSample, change=lambda _sample, _: None)
    told = tell(flight(), no_barometer, Rewrite(GnssFix, change=lambda fix, _: replace(fix, alt=fix.alt / 0.3048)))
    assert "vertical velocity it is in feet" in told.event("gnss.height.unit").text
    assert told.when("gnss.height.unit")[0] < 60.0
    assert "height of GNSS is in feet" in told.estimator.status().doubt
    assert as_good_as_ever(told)
    sound = tell(flight(), no_barometer)
    assert sound.count("gnss.height.unit") == 0
    assert sound.estimator.status().doubt == ""


@pytest.mark.parametrize("every", [5, 10, 25])
def test_a_slow_receiver_is_not_lost_between_its_fixes(every: int) -> None:
    """GIVEN a fix every 1, 2 or 5 s THEN the time-outs follow it: AIDED throughout."""

    def seldom(sample: Any, number: int) -> Any:
        return sample if number % every == 0 else None

    kinds = (GnssFix, GnssVelocity, SatelliteCount)
    told = tell(flight(), *(Rewrite(kind, change=seldom) for kind in kinds))
    assert told.modes_between(40.0, 120.0) == {Mode.AIDED}
    assert rms(told, 40.0)[0] < 2.0 * rms(baseline(), 40.0)[0]  # one fix for 25 averages less


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (18.0, "18.0 s ahead of the IMU's: GPS time against UTC"),
        (-18.0, "18.0 s behind the IMU's: GPS time against UTC"),
        (7200.0, "7200 s ahead of the IMU's: a time zone"),
        (-1024 * 7 * DAY, "1024 weeks"),
    ],
)
def test_clocks_that_differ_are_named_and_refused_before_the_start(seconds: float, words: str) -> None:
    """GIVEN GNSS stamps of another clock THEN no position comes of them, and amount and cause are said."""
    recording = flight(duration=20.0)
    told = tell(recording, *(Redate(kind, seconds=seconds) for kind in (GnssFix, GnssVelocity)))
    assert told.last is None
    said = [event.text for event in told.events if event.name in ("gnss.rejected.future", "gnss.rejected.age")]
    assert words in said[0]
    assert len(said) == 1


def test_a_clock_that_jumps_in_flight_is_refused_there_too() -> None:
    """GIVEN a flight WHEN the stamps of GNSS jump 18 s ahead and back THEN those fixes are refused and it returns."""
    told = tell(flight(), *(Redate(kind, 60.0, 10.0, seconds=18.0) for kind in (GnssFix, GnssVelocity)))
    assert told.count("gnss.rejected.future") == 50
    assert Mode.AIDED not in told.modes_between(62.0, 70.0)
    assert told.modes_between(75.0, 120.0) == {Mode.AIDED}


@pytest.mark.parametrize(("factor", "unit"), [(1e-2, "hPa"), (1e-3, "kPa")])
def test_pressure_in_another_unit_is_named(factor: float, unit: str) -> None:
    """GIVEN a pressure in hPa or kPa THEN it is refused with its unit, and the flight is as good as ever."""
    told = tell(
        flight(), Rewrite(PressureSample, change=lambda p, _: replace(p, pressure=p.pressure * factor, variance=None))
    )
    assert f"pascal expected, looks like {unit}" in told.event("baro.rejected.unit").text
    assert as_good_as_ever(told)


def test_an_altitude_in_the_place_of_the_pressure_is_named() -> None:
    """GIVEN a driver that publishes the height, 468 m, as pressure THEN the sentence does not speak of hPa alone."""
    change = Rewrite(PressureSample, change=lambda p, _: replace(p, pressure=468.0, variance=None))
    assert (
        "looks like hPa, or a height in metres" in tell(flight(duration=20.0), change).event("baro.rejected.unit").text
    )


def test_altitudes_that_are_sometimes_nan_cost_nothing() -> None:
    """GIVEN every fourth altitude NaN THEN latitude and longitude of that fix are used."""

    def hole(fix: GnssFix, number: int) -> GnssFix:
        return replace(fix, alt=math.nan) if number % 4 == 0 else fix

    told = tell(flight(), Rewrite(GnssFix, change=hole))
    assert told.count("gnss.height.missing") > 100
    assert told.count("gnss.rejected.value") == 0
    assert as_good_as_ever(told)


def test_a_receiver_without_altitude_gives_a_position_and_an_honest_height() -> None:
    """GIVEN no altitude at all THEN the horizontal position is as good as ever and the height covered by its sigma."""
    told = tell(flight(), Rewrite(GnssFix, change=lambda fix, _: replace(fix, alt=math.nan)))
    assert as_good_as_ever(told)
    assert told.last is not None
    assert abs(told.error[-1, 2]) < 3.0 * math.sqrt(told.last.cov[8, 8])
    assert np.ptp(told.error[told.t > 20.0, 2]) < 10.0  # the barometer holds it


def test_a_height_of_another_reference_is_named_and_the_rest_goes_on() -> None:
    """GIVEN a flight WHEN heights become 47 m lower THEN position goes on, the step is named and taken off."""
    told = tell(flight(), Shift(GnssFix, 60.0, 60.0, (0.0, 0.0, -47.0)))
    assert "geoid" in told.event("gnss.rejected.height").text
    assert told.modes_between(20.0, 120.0) == {Mode.AIDED}
    assert as_good_as_ever(told)
    assert np.abs(told.error[told.t > 20.0, 2]).max() < 6.0


def test_heights_of_two_references_in_turn_are_left_out() -> None:
    """GIVEN every second height 47 m off THEN position goes on and the height's sigma covers both."""
    told = tell(flight(), Rewrite(GnssFix, change=lambda fix, n: replace(fix, alt=fix.alt - 47.0) if n % 2 else fix))
    assert told.count("gnss.rejected.height") > 300
    assert as_good_as_ever(told)
    assert told.last is not None
    assert abs(told.error[-1, 2]) < 3.0 * math.sqrt(told.last.cov[8, 8])


def test_a_receiver_that_repeats_itself_is_stuck() -> None:
    """GIVEN a flight WHEN position and velocity freeze with fresh stamps THEN that is an outage, and named."""
    told = tell(flight(), Freeze(GnssFix, 60.0, 30.0), Freeze(GnssVelocity, 60.0, 30.0))
    assert "stuck" in told.event("gnss.rejected.stuck").text
    assert Mode.AIDED not in told.modes_between(63.0, 90.0)
    assert np.mean(told.off < 3.0 * told.sigma) > 0.99
    assert told.modes[-1] is Mode.AIDED


@pytest.mark.parametrize("metres", [300.0, 3000.0])
def test_a_jump_is_taken_with_the_doubt_it_deserves(metres: float) -> None:
    """GIVEN a flight WHEN GNSS jumps and stays there THEN it is taken in the end, with a sigma that covers the way."""
    told = tell(flight(), Shift(GnssFix, 60.0, 60.0, (metres, 0.0, 0.0)))
    assert told.modes[-1] is Mode.AIDED
    assert np.mean(told.off < 3.0 * told.sigma) > 0.99
    assert "jumped" in told.estimator.status().doubt


@pytest.mark.parametrize("rate", [1.0, 11.0 / 12.0])
def test_a_clock_that_runs_slow_is_named_with_the_amount(rate: float) -> None:
    """GIVEN stamps of a clock that counts 11 s in 12 WHEN the vehicle has gone far enough THEN 8.3 % are told."""
    recording = flight("fixed_wing")

    def slow(sample: Any) -> Any:
        since = recording.start_ns
        if isinstance(sample, ImuBlock):
            stamps = (since + rate * (sample.stamps_ns - recording.start_ns)).astype(np.int64)
            return replace(sample, stamps_ns=stamps)
        if sample.stamp_ns is None:
            return sample
        return replace(sample, stamp_ns=int(since + rate * (sample.stamp_ns - recording.start_ns)))

    told = tell(recording, samples=map(slow, recording.samples()), learner__method="coast")
    said = [event.text for event in told.events if event.name == "gnss.velocity.scale"]
    assert len(said) == (rate < 1.0)
    if said:
        amount = re.search(r"runs ([\d.]+) % slow", said[0])
        assert amount is not None
        assert abs(float(amount.group(1)) - 8.3) < 2.0


@pytest.mark.parametrize(("numbers", "unit"), [(1.944, "knots"), (3.6, "km/h")])
def test_a_velocity_in_another_unit_is_named_and_not_used(numbers: float, unit: str) -> None:
    """GIVEN velocities in knots or km/h THEN the unit is named and the positions go on without them."""

    def converted(sample: GnssVelocity, _number: int) -> GnssVelocity:
        return replace(sample, vel_enu=tuple(numbers * v for v in sample.vel_enu))

    told = tell(flight(), Rewrite(GnssVelocity, change=converted), learner__method="coast")
    assert f"looks like {unit}" in told.event("gnss.velocity.axes.unit").text
    late = told.between(60.0, 120.0)
    assert late.any()
    assert np.mean(told.off[late] < 3.0 * told.sigma[late]) > 0.97
    assert told.off[late].max() < 6.0


@pytest.mark.parametrize(
    ("kind", "name"), [(MagSample, "magnetic_heading"), (PressureSample, "height"), (MagSample, "mag")]
)
@pytest.mark.parametrize(
    ("seconds", "words"), [(-1.6e9, "these count from the start of a board"), (7200.0, "a time zone")]
)
def test_an_aid_with_stamps_of_another_clock_is_named(kind: type, name: str, seconds: float, words: str) -> None:
    """GIVEN a magnetometer or barometer with stamps of another clock THEN it is not used, and why is said."""
    faults = (Stop(GnssFix, 40.0, 20.0),) if name == "magnetic_heading" else ()  # it aids the filter in outages only
    told = tell(flight(duration=60.0), Redate(kind, seconds=seconds), *faults)
    which = "future" if seconds > 0.0 else "late"
    event = told.event(f"{name}.rejected.{which}")
    assert event.level is Level.WARN
    assert words in event.text


def freeze(start: float, length: float, with_velocity: bool) -> tuple[Fault, ...]:
    """A receiver that repeats its last fix, with or without velocities before; none come meanwhile."""
    silent = Stop(GnssVelocity, start, length) if with_velocity else Stop(GnssVelocity, 0.0, 1e3)
    return Freeze(GnssFix, start, length), silent


@pytest.mark.parametrize("with_velocity", [True, False])
def test_a_stuck_receiver_is_found_without_velocities_and_undone(with_velocity: bool) -> None:
    """GIVEN a flight WHEN fixes repeat to the last digit, with fresh stamps and without a velocity that could tell
    THEN the navigator's own motion tells, the pose is as if they had never come, and they are used once they change."""
    told = tell(flight(), *freeze(50.0, 30.0, with_velocity), learner__method="coast")
    found = told.when("gnss.stuck")
    assert 52.0 < found[0] < 60.0
    assert len(found) == 1
    assert "moved" in told.event("gnss.stuck").text
    assert told.count("gnss.velocity.undone") == 1
    assert Mode.AIDED not in told.modes_between(found[0] + 0.5, 79.0)
    after = told.between(found[0] + 0.5, 80.0)
    assert np.all(told.off[after] < 3.0 * told.sigma[after])
    assert told.modes[-1] is Mode.AIDED


def test_a_stuck_receiver_of_a_fast_vehicle_is_no_return() -> None:
    """GIVEN a fixed wing, which has left a repeated position so soon that its fixes are refused as contradictions
    THEN the navigator is not reset to that position seconds later, and sigma covers the error."""
    told = tell(flight("fixed_wing", 100.0), *freeze(60.0, 30.0, True), learner__method="coast")
    found = told.when("gnss.stuck")
    assert 62.0 < found[0] < 66.0
    after = told.between(found[0] + 0.5, 90.0)
    assert np.all(told.off[after] < 3.0 * told.sigma[after])
    assert told.modes[-1] is Mode.AIDED


def test_a_position_that_repeats_at_rest_is_used() -> None:
    """GIVEN a vehicle at rest whose receiver holds its position, without velocities THEN it is no fault."""
    told = tell(flight("at_rest", 60.0), *freeze(20.0, 30.0, with_velocity=False))
    assert told.when("gnss.stuck") == []
    assert told.count("gnss.rejected.stuck") == 0
    assert told.modes_between(20.0, 60.0) == {Mode.AIDED}


@pytest.mark.parametrize(("times", "is_used_once"), [(5, True), (25, False)])
def test_a_driver_that_repeats_the_fixes_of_a_slow_receiver(times: int, is_used_once: bool) -> None:
    """GIVEN a driver that publishes each fix of a slow receiver several times, with new stamps and without velocities
    THEN it is not stuck; copies of fixes of one hertz are left out, and the pose is as good as without them."""
    held: list[GnssFix] = []

    def hold(fix: GnssFix, number: int) -> GnssFix:
        if number % times == 0:
            held[:] = [fix]
        return replace(held[0], stamp_ns=fix.stamp_ns)

    no_velocity = Stop(GnssVelocity, 0.0, 1e3)
    told = tell(flight(), Rewrite(GnssFix, change=hold), no_velocity)
    assert len(told.when("gnss.stuck")) + told.count("gnss.rejected.stuck") == 0
    if is_used_once:
        assert told.count("gnss.rejected.copy") > 400
        assert told.modes_between(30.0, 120.0) == {Mode.AIDED}
        first = Rewrite(GnssFix, change=lambda fix, number: None if number % times else fix)
        assert rms(told)[0] < 1.1 * rms(tell(flight(), first, no_velocity))[0]


def field(change: Callable[[np.ndarray], np.ndarray]) -> Rewrite:
    return Rewrite(MagSample, change=lambda m, _: replace(m, field=tuple(change(np.array(m.field)).tolist())))


@pytest.mark.parametrize(
    ("fault", "event", "words"),
    [
        (
            Rewrite(PressureSample, change=lambda p, _: replace(p, pressure=0.0)),
            "baro.rejected.unit",
            "may not fill it",
        ),
        (field(lambda m: 0.0 * m), "mag.empty", "exactly zero"),
        (field(lambda m: m / np.linalg.norm(m)), "mag.unit", "a direction without its strength"),
    ],
)
def test_a_magnetometer_or_barometer_that_says_nothing_is_named(fault: Fault, event: str, words: str) -> None:
    """GIVEN a field or pressure that the driver does not fill, or a normalised field THEN it is named, once."""
    told = tell(flight(duration=60.0), fault)
    assert words in told.event(event).text
    assert len(told.when(event)) == 1
    assert told.modes[-1] is Mode.AIDED


def test_a_magnetometer_that_starts_with_zeros_is_no_fault() -> None:
    """GIVEN a driver whose first fields are zero THEN they are not named, and later ones are checked."""
    zeros = Rewrite(MagSample, 0.0, 1.0, lambda m, _: replace(m, field=(0.0, 0.0, 0.0)))
    assert tell(flight(duration=30.0), zeros).when("mag.empty") == []
    gauss = Rewrite(MagSample, 1.0, 1e3, lambda m, _: replace(m, field=tuple(1e4 * b for b in m.field)))
    assert tell(flight(duration=30.0), zeros, gauss).when("mag.unit")
