"""A Doppler log whose beams are used one by one: outages, faults of single beams, wrong set-ups."""

import math
from dataclasses import replace

import numpy as np
import pytest

from beam_flight import LOST, Flown, on_velocities
from beamed import beam_directions, with_beams
from nav_pose_estimator.core.beams.geometry import with_swapped_angle
from nav_pose_estimator.core.filter.blocks import DVL
from nav_pose_estimator.core.filter.layout import VEL
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.observation import Decision, FilterView, Row, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import BeamVelocitySample, PressureSample, stamp_of
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.scenarios import generate
from pieces import one_by_one
from told import silence

pytestmark = pytest.mark.compiled


def test_beams_hold_an_outage(without, sound):
    """GIVEN a drone with four beams WHEN GNSS is away for 50 s THEN it drifts a tenth as far as without them at most,
    knows it within 3 sigma, and says that the drift is bounded."""
    assert sound.error < 0.1 * without.error
    assert sound.error < 3.0 * sound.status.horizontal_sd
    assert sound.engine.mode is Mode.COASTING
    (told,) = sound.said("geometry")
    assert "4 beams, directions as published, positive for motion along the beam" in told
    assert sum(sound.refused(beam) for beam in (1, 2, 3, 4)) <= 0.003 * 4 * sound.counters["beam_velocity.used"]


def test_lost_beams_cost_little(flight, without):
    """GIVEN two neighbours lost for most of the outage, and none for ten seconds THEN the rest still holds it."""

    def lose(t: float, velocities: np.ndarray) -> None:
        velocities[[0, 1]] = velocities[[0, 1]] if t < 65.0 else np.nan
        velocities[:] = velocities if not 80.0 < t < 90.0 else np.nan

    flown = Flown(flight, with_beams(flight, on_velocities(lose)))
    assert flown.error < 0.1 * without.error
    assert flown.error < 3.0 * flown.status.horizontal_sd
    assert flown.counters["beam_velocity.1.lost"] > 100
    assert flown.said("beam_out") == []


@pytest.mark.parametrize("kind", ["bias", "scale", "noise"])
def test_a_faulty_beam_is_left_out(flight, without, kind):
    """GIVEN a beam that goes wrong in the outage THEN it is left out and named, and the others hold the outage."""
    rng = np.random.default_rng(4)
    faults = {
        "bias": lambda t, v: v + 0.8,
        "scale": lambda t, v: 1.6 * v,
        "noise": lambda t, v: v + rng.normal(0.0, 0.02 * (t - 65.0)),
    }

    def spoil(t: float, velocities: np.ndarray) -> None:
        if 65.0 < t < 100.0:
            velocities[1] = faults[kind](t, velocities[1])

    flown = Flown(flight, with_beams(flight, on_velocities(spoil)))
    assert flown.error < 0.1 * without.error
    assert flown.error < 3.0 * flown.status.horizontal_sd
    assert any("beam 2 excluded" in text for text in flown.said("beam_out"))
    assert flown.refused(2) > 80
    assert flown.refused(1) + flown.refused(3) + flown.refused(4) < 10
    assert any("beam 2 used again" in text for text in flown.said("beam_in"))


def test_outliers_are_refused_one_by_one(flight, without):
    rng, hit = np.random.default_rng(8), []

    def spoil(t: float, velocities: np.ndarray) -> None:
        if t > 40.0 and rng.random() < 0.2:
            velocities[rng.integers(4)] += 3.0
            hit.append(t)

    flown = Flown(flight, with_beams(flight, on_velocities(spoil)))
    assert flown.error < 0.1 * without.error
    assert sum(flown.refused(beam) for beam in (1, 2, 3, 4)) >= len(hit)


def test_the_mounting_is_learned_while_gnss_is_good(flight, sound):
    """GIVEN a sensor turned by one degree more than is said THEN the filter finds that degree."""
    turned = Flown(flight, with_beams(flight, rpy=(0.0, 0.0, math.radians(1.0))))
    yaw = turned.nav[DVL.estimates][7] - sound.nav[DVL.estimates][7]
    assert math.degrees(yaw) == pytest.approx(1.0, abs=0.3)
    assert turned.error < 1.3 * sound.error + 0.2


def test_a_lever_arm_is_allowed_for(flight, sound):
    lever = (1.5, -1.0, -0.5)
    flown = Flown(flight, with_beams(flight, lever=lever), lever=lever)
    assert flown.error < 1.3 * sound.error + 0.2


@pytest.mark.parametrize("own", [False, True], ids=["against the navigator", "against its own velocity"])
@pytest.mark.parametrize(("swapped", "sign"), [(True, 1), (False, -1), (True, -1)])
def test_other_readings_are_found_and_said(flight, without, own, swapped, sign):
    """GIVEN a driver with another sign, or sine and cosine swapped THEN the log says so and the outage is held."""

    def publish(t: float, sample: BeamVelocitySample) -> BeamVelocitySample:
        directions = with_swapped_angle(sample.directions) if swapped else sample.directions
        return replace(sample, directions=directions, velocities=sign * sample.velocities)

    flown = Flown(flight, with_beams(flight, publish, own=own), until=90.0)
    (told,) = flown.said("geometry")
    assert ("sine and cosine swapped" in told) == swapped
    assert ("against the beam" in told) == (sign < 0)
    assert flown.error < 0.2 * without.error


@pytest.mark.parametrize("own", [False, True], ids=["against the navigator", "against its own velocity"])
def test_a_sensor_that_is_turned_over_is_refused_with_the_cure(flight, without, own):
    """GIVEN a sensor whose z axis looks down, without a word of it THEN nothing is used, and the log says the roll."""
    flown = Flown(flight, with_beams(flight, rpy=(math.pi, 0.0, 0.0), own=own))
    (told,) = flown.said("contradicts") if own else flown.said("geometry.refused")
    assert "3.1416" in told
    assert "aids.beams.rpy" in told
    assert flown.counters["beam_velocity.used"] < 10
    assert flown.error == pytest.approx(without.error, rel=0.2)
    cured = Flown(flight, with_beams(flight, rpy=(math.pi, 0.0, 0.0), own=own), rpy=(3.1416, 0.0, 0.0))
    assert cured.error < 0.1 * without.error


def test_a_sensor_that_gnss_has_not_confirmed_in_motion_is_not_believed_without_it():
    """GIVEN GNSS that goes while the drone takes off, and a sensor turned over THEN it holds nothing, and the log says
    why: a wrong velocity that is said to be good would be worse than none."""
    recording = generate("multirotor_outage", 60.0, seed=5, imu_rate=50.0).with_faults(*silence(15.0, 45.0))
    flown = Flown(recording, with_beams(recording, rpy=(math.pi, 0.0, 0.0), own=True), until=50.0)
    (told,) = flown.said("unproven")
    assert "before they had agreed with it in motion" in told
    assert flown.engine.mode is Mode.DEAD_RECKONING


@pytest.mark.parametrize("delay", [0.15, 0.3])
def test_stamps_of_arrival_are_noticed(flight, sound, delay):
    """GIVEN a driver that stamps messages when they arrive THEN the log says how old they are; set, it is silent."""
    late = lambda t, sample: replace(sample, stamp_ns=sample.stamp_ns + round(delay * 1e9))  # noqa: E731
    flown = Flown(flight, with_beams(flight, late), until=LOST)
    texts = [*flown.said("delayed"), *flown.said("contradicts")]
    assert any("s old when they are stamped" in text for text in texts), texts
    cured = Flown(flight, with_beams(flight, late), delay=delay)
    assert cured.said("delayed") == []
    assert cured.error < 1.3 * sound.error + 0.2
    assert sound.said("delayed") == []


@pytest.mark.parametrize("delay", [0.0, 0.15])
def test_a_delay_that_is_estimated_is_known_and_allowed_for(flight, sound, delay):
    """GIVEN stamps of validity, or of arrival WHEN the delay is a state THEN it is known within 3 deviations of a
    quarter of what was thought at most, the late ones are named, and both hold the outage."""
    late = lambda t, sample: replace(sample, stamp_ns=sample.stamp_ns + round(delay * 1e9))  # noqa: E731
    flown = Flown(flight, with_beams(flight, late), delay_sd=0.1)
    values = flown.status.values
    assert values["beams.delay_sd"] < 0.025
    assert abs(values["beams.delay"] - delay) < 3.0 * values["beams.delay_sd"]
    assert flown.error < 1.3 * sound.error + 0.2
    assert flown.error < 3.0 * flown.status.horizontal_sd
    assert [text.split(" s old")[1] for text in flown.said("delayed")] == [
        " when they are stamped: compensated (set aids.beams.delay)"
    ] * (delay > 0.0)


def test_directions_that_are_given_win(flight, sound):
    """GIVEN messages without directions THEN one sentence asks for them; with them all is well."""
    bare = lambda t, sample: replace(sample, directions=np.full((4, 3), np.nan))  # noqa: E731
    flown = Flown(flight, with_beams(flight, bare), until=40.0)
    (told,) = flown.said("rejected.geometry")
    assert "aids.beams.directions" in told
    given = tuple(beam_directions().ravel().tolist())
    assert Flown(flight, with_beams(flight, bare), directions=given).error == pytest.approx(sound.error, abs=0.05)


def test_three_beams_are_enough_and_said_to_be_three(flight, without):
    three = lambda t, sample: replace(sample, directions=sample.directions[:3], velocities=sample.velocities[:3])  # noqa: E731
    flown = Flown(flight, with_beams(flight, three))
    (told,) = flown.said("geometry")
    assert "3 beams" in told
    assert "cannot check each other" in told
    assert flown.error < 0.1 * without.error


def test_a_count_that_the_parameter_does_not_give_is_said(flight):
    given = (*beam_directions()[:3].ravel().tolist(), 0.0, 0.0, 0.0)
    flown = Flown(flight, with_beams(flight), until=20.0, directions=given)
    (told,) = flown.said("rejected.count")
    assert "4 beams, but aids.beams.directions gives 3" in told


def test_lost_beams_may_be_missing_from_the_message(flight, sound):
    """GIVEN a driver that leaves lost beams out, or sends them in another order THEN each is known by its direction."""
    rng = np.random.default_rng(2)

    def some(t: float, sample: BeamVelocitySample) -> BeamVelocitySample:
        chosen = rng.permutation(4)[: 4 if t < 40.0 else 3]
        return replace(sample, directions=sample.directions[chosen], velocities=sample.velocities[chosen])

    flown = Flown(flight, with_beams(flight, some))
    assert flown.error < 1.5 * sound.error + 0.2
    assert flown.counters["beam_velocity.2.lost"] > 50
    assert flown.counters["beam_velocity.points.used"] == 0


def test_a_radar_with_many_points_works_without_beams_of_its_own(flight, without):
    """GIVEN points that differ from message to message, a tenth of them moving THEN those are refused one by one."""
    rng = np.random.default_rng(6)

    def points(t: float, sample: BeamVelocitySample) -> BeamVelocitySample:
        directions = rng.standard_normal((30, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        velocity = np.linalg.lstsq(sample.directions, sample.velocities, rcond=None)[0]
        velocities = directions @ velocity + 0.1 * rng.standard_normal(30)
        velocities[rng.random(30) < 0.1] += 4.0
        return replace(sample, directions=directions, velocities=-velocities)

    flown = Flown(flight, with_beams(flight, points), sd=0.1)
    (told,) = flown.said("geometry")
    assert "points, directions as published, positive for motion against the beam" in told
    assert flown.error < 0.1 * without.error
    assert flown.counters["beam_velocity.points.rejected"] > 500


def test_two_faulty_beams_do_not_move_a_sound_navigator_at_once(flight, without):
    """GIVEN two beams that go wrong together for twenty seconds THEN they are left out: an accusation takes longer."""

    def spoil(t: float, velocities: np.ndarray) -> None:
        if 70.0 < t < 90.0:
            velocities[[0, 1]] += 1.0

    flown = Flown(flight, with_beams(flight, on_velocities(spoil)))
    assert flown.counters["beam_velocity.accusation"] == 0
    assert flown.error < 0.1 * without.error


def test_beams_that_accuse_the_navigator_for_long_are_followed(flight):
    """GIVEN a navigator that sinks by 12 m/s too fast in an outage THEN four beams that agree put it right.

    There is no barometer, which would show it sooner, and over ground the speed is not unusual.
    """
    samples = [sample for sample in with_beams(flight) if not isinstance(sample, PressureSample)]
    cut = next(i for i, sample in enumerate(samples) if (stamp_of(sample) or 0) > flight.start_ns + (LOST + 5.0) * 1e9)
    engine = SinsEngine(Parameters())
    for sample in samples[:cut]:
        engine.feed(sample)
    engine.run.settled.nav[VEL + 2] -= 12.0
    engine.run.timeline.start(engine.run.timeline.filter.nav.copy(), engine.run.timeline.filter.P.copy())
    for sample in samples[cut:]:
        engine.feed(sample)
    assert engine.journal.counters["beam_velocity.accusation"] > 0
    assert np.linalg.norm(engine.run.settled.nav[VEL : VEL + 3] - flight.truth.v_n[-1]) < 1.5


def test_each_row_keeps_its_own_variance_whatever_its_place(sound, flight):
    """GIVEN flagged beams that follow the others in a decision THEN each has its own innovation and variance."""
    run = sound.engine.run
    sensor = run.aids[BeamVelocitySample]
    message = [sample for sample in with_beams(flight) if isinstance(sample, BeamVelocitySample)][-1]
    o = sensor.observe(message, run.now)
    view, order = FilterView(run.settled.nav, run.settled.P, run.settled.constants), [0, 1, 3, 2]
    o.decision = Decision(Use.UNGATED, rows=tuple(Row(i, 1.0) for i in range(4)), change=np.zeros(3))
    z, H, _ = sensor.linearise(o, view)
    o.decision = Decision(Use.UNGATED, rows=tuple(Row(i, 1.0 + i, 0.1 * i) for i in order), change=np.zeros(3))
    turned, rows, R = sensor.linearise(o, view)
    np.testing.assert_allclose(turned, z[order] + 0.1 * np.array(order))
    np.testing.assert_array_equal(rows, H[order])
    np.testing.assert_array_equal(R, np.diag([1.0, 2.0, 4.0, 3.0]))


def test_blocks_give_what_single_samples_give(flight):
    """GIVEN the same samples one by one THEN the same numbers come out."""
    whole = Flown(flight, with_beams(flight), until=math.inf)
    single = Flown(flight, one_by_one(with_beams(flight)), until=math.inf)
    np.testing.assert_array_equal(whole.nav, single.nav)


def test_a_snapshot_knows_all_that_was_learned_of_the_beams(flight):
    """GIVEN a snapshot in the outage WHEN both go on THEN both arrive at the same numbers."""
    samples = list(with_beams(flight))
    engine = SinsEngine(Parameters())
    half = int(0.7 * len(samples))
    for sample in samples[:half]:
        engine.feed(sample)
    twin = engine.snapshot()
    for sample in samples[half:]:
        engine.feed(sample)
    for sample in samples[half:]:
        twin.feed(sample)
    np.testing.assert_array_equal(engine.run.settled.nav, twin.run.settled.nav)
    assert engine.journal.counters == twin.journal.counters
