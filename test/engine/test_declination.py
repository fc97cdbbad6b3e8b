"""Magnetic declination from the World Magnetic Model: its published values, who asks for them, and without it."""

import math
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuSample, MagSample
from nav_pose_estimator.engine.sensors.magnetic import declination
from nav_pose_estimator.engine.sensors.magnetic.declination import model_declination
from nav_pose_estimator.engine.solutions import AttitudeBlock, Event, Level, Mode, NavBlock
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import find_scenario, generate
from nav_pose_estimator.sim.sensors import Magnetometer
from nav_pose_estimator.sim.trajectories import Origin

SEATTLE = Origin(math.radians(47.6205), math.radians(-122.3493), 60.0)
YEAR_2023 = 1_700_000_000_000_000_000  # when the stories begin
ASK = "aids.declination_from_model"

# "Test Values for WMM2025", NOAA/NCEI, December 2024: year, height [km], latitude, longitude, declination [deg]
PUBLISHED = [
    (2025.0, 0, 80, 0, 1.28),
    (2025.0, 0, 0, 120, -0.16),
    (2025.0, 0, -80, 240, 68.78),
    (2025.0, 100, 80, 0, 0.85),
    (2025.0, 100, 0, 120, -0.15),
    (2025.0, 100, -80, 240, 68.21),
    (2027.5, 0, 80, 0, 2.59),
    (2027.5, 0, 0, 120, -0.24),
    (2027.5, 0, -80, 240, 68.49),
    (2027.5, 100, 80, 0, 2.16),
    (2027.5, 100, 0, 120, -0.23),
    (2027.5, 100, -80, 240, 67.93),
]


def needs_the_model() -> None:
    pytest.importorskip("pygeomag", reason="needs pygeomag (make setup)")


def stamp(year: float) -> int:
    """Unix time [ns] of a year with its fraction; the middle of 2027 is noon on 2 July."""
    begin, end = (datetime(int(year) + k, 1, 1, tzinfo=UTC).timestamp() for k in (0, 1))
    return round((begin + (year - int(year)) * (end - begin)) * 1e9)


@pytest.fixture(scope="module")
def flight() -> Recording:
    """Half a minute near Seattle, where the needle points 15 deg East of North; it begins at rest."""
    needs_the_model()
    there = model_declination(YEAR_2023, *SEATTLE)
    good = Magnetometer(hard_iron_sd=0.0, soft_iron_sd=0.0, heading_sd=0.0, declination=there)
    story = replace(find_scenario("multirotor_outage"), magnetometer=good, origin=SEATTLE)
    return generate(story, 30.0, 1, imu_rate=50.0)


def fly(recording: Recording, **overrides: object) -> tuple[PoseEstimator, list]:
    engine = PoseEstimator(update(Parameters(), {ASK: True, **overrides}))
    return engine, [output for sample in recording.samples() for output in engine.feed(sample)]


def yaw_deg(q_nb: np.ndarray) -> float:
    C = quat_to_matrix(q_nb)
    return math.degrees(math.atan2(C[1, 0], C[0, 0]))


def yaw_error(recording: Recording, stamp_ns: int, q_nb: np.ndarray) -> float:
    """Estimated minus true yaw [deg]."""
    true = recording.truth.at(np.array([(stamp_ns - recording.start_ns) * 1e-9])).q_nb[0]
    return math.degrees(math.remainder(math.radians(yaw_deg(q_nb) - yaw_deg(true)), 2.0 * math.pi))


def first_headings(recording: Recording, outputs: list) -> tuple[float, float]:
    """Yaw errors [deg] of the navigator's first solution and of the attitude filter at that time."""
    first = next(i for i, o in enumerate(outputs) if isinstance(o, NavBlock))
    attitude = [o for o in outputs[:first] if isinstance(o, AttitudeBlock)][-1]
    navigation = outputs[first]
    return (
        yaw_error(recording, int(navigation.stamps_ns[0]), navigation.rows[0, at.OUT_QUAT : at.OUT_RATE]),
        yaw_error(recording, int(attitude.stamps_ns[-1]), attitude.q_nb[-1]),
    )


def told(outputs: list, name: str) -> list[Event]:
    return [o for o in outputs if isinstance(o, Event) and o.name.startswith(name)]


# --- the model -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("year", "height", "lat", "lon", "published"), PUBLISHED)
def test_published_values_of_the_model(year, height, lat, lon, published):
    needs_the_model()
    found = model_declination(stamp(year), math.radians(lat), math.radians(lon), 1e3 * height)
    assert math.degrees(found) == pytest.approx(published, abs=0.0051)


@pytest.mark.parametrize(
    ("year", "lat", "lon", "reason"),
    [
        (2031.2, 47.0, 8.0, "pygeomag has no field model for the year 2031 of the stamps"),
        (1970.0, 47.0, 8.0, "pygeomag has no field model for the year 1970 of the stamps"),
        (2025.5, 85.8, 139.3, "a compass is useless this close to a magnetic pole"),
        (2025.5, math.nan, 8.0, "the position is not finite"),
    ],
)
def test_where_the_model_says_nothing_a_clause_says_why(year, lat, lon, reason):
    needs_the_model()
    with pytest.raises(UserError) as caught:
        model_declination(stamp(year), math.radians(lat), math.radians(lon), 0.0)
    assert str(caught.value) == reason


# --- the estimator -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("ask", "expected"), [(True, 0.0), (False, 15.2)])
def test_the_heading_at_the_start_counts_from_true_north(flight, ask, expected):
    """GIVEN a place with 15 deg of declination WHEN the model is asked THEN both headings are true; else 15 deg off."""
    _, outputs = fly(flight, **{ASK: ask})
    for error in first_headings(flight, outputs):
        assert error == pytest.approx(expected, abs=1.5)
    texts = [event.text for event in told(outputs, "mag.declination")]
    assert texts == (["magnetic declination 15.2 deg, from the World Magnetic Model"] if ask else [])


def test_without_the_package_the_parameter_stands_and_one_sentence_says_so(flight, monkeypatch):
    monkeypatch.setattr(declination, "GeoMag", None)
    engine, outputs = fly(flight, **{"aids.declination": 0.2})
    assert engine.mode is Mode.AIDED
    assert engine.sins.run.parameters.aids.declination == 0.2
    (event,) = told(outputs, "mag.declination")
    assert (event.name, event.level) == ("mag.declination.fallback", Level.WARN)
    assert event.text == ("magnetic declination 11.5 deg, from aids.declination: the package pygeomag is not installed")


def test_a_flight_gives_the_same_numbers_every_time_and_after_a_snapshot(flight):
    """GIVEN the same samples WHEN flown again, from a snapshot before the first fix THEN the same to a bit."""
    samples = list(flight.samples())
    engine, twin = (PoseEstimator(update(Parameters(), {ASK: True})) for _ in range(2))
    early = len(samples) // 30
    for sample in samples[:early]:
        twin.feed(sample)
    before = twin.snapshot()
    for sample in samples[early:]:
        twin.feed(sample)
    twin.restore(before)
    for sample in samples[:early]:
        engine.feed(sample)
    ends = [[o for s in samples[early:] for o in one.feed(s)] for one in (engine, twin)]
    first, second = ([o.rows.tobytes() for o in end if isinstance(o, NavBlock)] for end in ends)
    assert first == second
    assert len(first) > 100
    assert told(ends[0], "mag.declination.model")


def test_what_was_found_outlives_a_change_of_parameters_and_a_reset(flight):
    engine, _ = fly(flight)
    found = engine.sins.run.parameters.aids.declination
    assert math.degrees(found) == pytest.approx(15.2, abs=0.1)
    engine.set_parameters(update(engine.parameters, {"aids.magnetometer_sd": 0.2}))
    assert engine.sins.run.parameters.aids.declination == found
    assert engine.sins.run.parameters.aids.magnetometer_sd == 0.2
    engine.reset(int(flight.imu.stamps_ns[-1]), "a test")
    assert engine.sins.run.parameters.aids.declination == found
    again = [o for s in flight.samples() for o in engine.feed(s)]
    assert told(again, "mag.declination") == []
    assert [error == pytest.approx(0.0, abs=1.5) for error in first_headings(flight, again)] == [True, True]


def test_a_model_that_said_nothing_is_asked_again_after_a_restart(flight, monkeypatch):
    """GIVEN a first start without the model (or with a clock in 1970) WHEN the navigator starts again THEN it asks."""
    with monkeypatch.context() as first:
        first.setattr(declination, "GeoMag", None)
        engine, outputs = fly(flight)
    assert [event.name for event in told(outputs, "mag.declination")] == ["mag.declination.fallback"]
    engine.reset(int(flight.imu.stamps_ns[-1]), "a test")
    again = [o for s in flight.samples() for o in engine.feed(s)]
    assert [event.name for event in told(again, "mag.declination")] == ["mag.declination.model"]
    assert math.degrees(engine.sins.run.parameters.aids.declination) == pytest.approx(15.2, abs=0.1)


@pytest.mark.parametrize("method", ["complementary", "two_stage"])
def test_an_attitude_filter_turns_by_a_declination_that_comes_late(method):
    """GIVEN a filter with a magnetic heading WHEN the declination is told THEN it turns at once, level as before."""
    engine = AttitudeEngine(update(Parameters(), {"attitude.filter": method}))

    def sit(begin: int, samples: int) -> np.ndarray:
        for i in range(begin, begin + samples):
            sample = at_rest(i)
            (solution,) = engine.feed(sample)
            engine.feed(MagSample(sample.stamp_ns, (20e-6, 0.0, -43e-6)))
        return solution.q_nb

    before = yaw_deg(sit(0, 500))
    engine.set_declination(0.2)
    after = sit(500, 1)
    assert before - yaw_deg(after) == pytest.approx(math.degrees(0.2), abs=0.05)
    assert quat_to_matrix(after)[2, 2] == pytest.approx(1.0, abs=1e-6)
    assert yaw_deg(sit(501, 500)) == pytest.approx(yaw_deg(after), abs=0.1), "and it stays there"
    engine.reset(10_000_000_000, "a test")
    assert yaw_deg(sit(1001, 500)) == pytest.approx(yaw_deg(after), abs=0.1), "a reset does not forget it"


def test_without_a_magnetic_heading_a_declination_turns_nothing():
    engine = AttitudeEngine()
    before = [engine.feed(at_rest(i)) for i in range(300)][-1][0]
    engine.set_declination(0.2)
    (after,) = engine.feed(at_rest(300))
    assert yaw_deg(after.q_nb) == pytest.approx(yaw_deg(before.q_nb), abs=0.01)


def at_rest(i: int) -> ImuSample:
    """A sensor that lies level, with a little life in it."""
    life = 1e-5 * (i % 7 - 3)
    return ImuSample(1_000_000_000 + i * 10_000_000, (life, -life, life), (life, -life, 9.81 + life))
