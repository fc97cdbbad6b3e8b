"""A process that is killed in flight and comes back with what it had saved: silence, steps, sigma, refusals."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.bias_noise import Wander
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.composed.resumption import arrays_of, resume
from nav_pose_estimator.engine.continuation.saved_state import SavedState
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator.filter_run import FilterRun, resumed, state_of
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import MagSample, PressureSample, Sample, stamp_of
from nav_pose_estimator.engine.solutions import Event, Mode, NavBlock
from nav_pose_estimator.sim.recording import Recording
from told import GNSS, flight, silence

pytestmark = pytest.mark.compiled
KILLED, BACK, END = 60.0, 66.0, 85.0  # s; the process is away for six seconds


@dataclass
class Life:
    """A process: row i of the arrays belongs to one solution. ``t`` in seconds of the recording."""

    engine: PoseEstimator
    events: list[Event]
    t: np.ndarray
    error: np.ndarray  # (N, 3) ENU [m]
    sigma: np.ndarray  # (N,) horizontal
    odom: np.ndarray  # (N, 3)
    modes: list[Mode]

    def names(self) -> list[str]:
        return [event.name for event in self.events]


def live(recording: Recording, samples: list[Sample], saved: SavedState | None = None, **overrides: Any) -> Life:
    engine = PoseEstimator(update(Parameters(), {"learner.enabled": False, **overrides}))
    if saved is not None:
        resume(engine, saved.arrays())
    outputs = [output for sample in samples for output in engine.feed(sample)]
    blocks = [o for o in outputs if isinstance(o, NavBlock)]
    rows = np.concatenate([b.rows for b in blocks]) if blocks else np.empty((0, at.OUT_COLUMNS))
    stamps = np.concatenate([b.stamps_ns for b in blocks]) if blocks else np.empty(0, np.int64)
    t = (stamps - recording.start_ns) * 1e-9
    error = recording.error_enu(t, rows[:, at.OUT_POS : at.OUT_VEL])
    place = engine.origin or recording.origin
    correction = [np.tile(b.correction_enu, (len(b.stamps_ns), 1)) for b in blocks]
    odom = lla_to_enu(*rows[:, at.OUT_POS : at.OUT_VEL].T, *place) - np.concatenate(correction or [np.empty((0, 3))])
    sigma = np.sqrt(rows[:, at.OUT_VAR + at.DPOS : at.OUT_VAR + at.DPOS + 2].sum(axis=1))
    modes = [b.mode for b in blocks for _ in range(len(b.stamps_ns))]
    return Life(engine, [o for o in outputs if isinstance(o, Event)], t, error, sigma, odom, modes)


def within(recording: Recording, start: float, end: float, left_out: tuple[type, ...] = ()) -> list[Sample]:
    limits = [recording.start_ns + int(s * 1e9) for s in (start, end)]
    now, samples = 0, []
    for sample in recording.samples():
        now = stamp_of(sample) or now
        if limits[0] <= now < limits[1] and not isinstance(sample, left_out):
            samples.append(sample)
    return samples


def before(recording: Recording, **overrides: Any) -> tuple[Life, SavedState]:
    """The life that ends with the kill, and what it has left."""
    life = live(recording, within(recording, 0.0, KILLED), **overrides)
    state = state_of(life.engine.sins.run)
    assert state is not None
    return life, SavedState.of(state.arrays())


def after(recording: Recording, saved: SavedState | None, *left_out: type, **overrides: Any) -> Life:
    return live(recording, within(recording, BACK, END, left_out), saved, **overrides)


@pytest.mark.parametrize("name", ["multirotor_light", "stop_and_go", "laps", "hover"])
@pytest.mark.parametrize("seed", [5, 6])
def test_a_warm_start_takes_less_than_three_seconds_and_is_where_the_vehicle_is(name, seed):
    """GIVEN a navigator killed in flight WHEN it comes back six seconds later with what it had saved
    THEN it is silent for less than three seconds, its axes are the same, its position is right within sigma from the
    first one on, and it is aided."""
    recording = flight(name, END, seed)
    first, saved = before(recording)
    again = after(recording, saved)
    assert again.t[0] - BACK < 3.0
    assert again.engine.origin == first.engine.origin
    off = np.linalg.norm(again.error[:, :2], axis=1)
    assert np.mean(off < 3.0 * again.sigma) > 0.99, off.max()
    assert off.max() < 12.0
    assert again.modes[-1] is Mode.AIDED
    assert "resume.begun" in again.names()


def test_a_law_of_drag_does_not_keep_the_state_from_being_saved():
    """GIVEN the method drag, whose law is no network that could be saved WHEN it has been fitted THEN the state is
    saved without it, and a process that continues has the flight to fit it again."""
    recording, parameters = flight("multirotor_light", END), update(Parameters(), {"learner.method": "drag"})
    first, second = PoseEstimator(parameters), PoseEstimator(parameters)
    first.feed_all(within(recording, 0.0, KILLED))
    assert first.outage_aid is not None
    assert first.outage_aid.learner.state.model is not None
    arrays = arrays_of(first)
    assert arrays is not None
    resume(second, arrays)
    second.feed_all(within(recording, BACK, END))
    assert second.outage_aid is not None
    assert second.outage_aid.learner.state.model is not None


def test_without_a_saved_state_the_same_restart_is_silent_for_ten_seconds_and_moves_the_axes():
    """GIVEN the same kill WHEN nothing was saved THEN this is what a warm start is worth."""
    recording = flight("multirotor_light", END)
    first, saved = before(recording)
    cold, warm = after(recording, None), after(recording, saved)
    assert cold.t[0] - BACK > 8.0 > 3.0 > warm.t[0] - BACK
    assert first.engine.origin is not None
    assert cold.engine.origin is not None
    apart = lla_to_enu(*cold.engine.origin, *first.engine.origin)
    assert np.linalg.norm(apart) > 20.0


@pytest.mark.parametrize("magnetometer", [True, False], ids=["with compass", "without"])
def test_in_aerobatics_gnss_tells_what_of_the_force_is_gravity(magnetometer):
    """GIVEN a vehicle in a loop, whose force is not up WHEN it comes back THEN it goes on in the old axes within three
    seconds all the same, from the acceleration that GNSS shows, and is right within sigma."""
    recording = flight("closed_curve", END)
    first, saved = before(recording, **{"aids.magnetometer": magnetometer})
    again = after(recording, saved, **{"aids.magnetometer": magnetometer})
    off = np.linalg.norm(again.error[:, :2], axis=1)
    assert again.t[0] - BACK < 3.0
    assert np.mean(off < 3.0 * again.sigma) > 0.99
    assert off.max() < 12.0
    assert again.engine.origin == first.engine.origin


def test_without_a_magnetometer_a_hovering_vehicle_goes_on_with_an_unknown_heading():
    """GIVEN no magnetometer and a hover WHEN six seconds have passed unseen THEN nobody knows the heading: the position
    goes on within three seconds, and covariance and status say what is missing."""
    recording = flight("hover", END, 6)
    _, saved = before(recording)
    blind = moved(saved, compass_offset=math.nan)
    again = after(recording, blind, MagSample, **{"aids.magnetometer": False})
    off = np.linalg.norm(again.error[:, :2], axis=1)
    assert again.t[0] - BACK < 3.0
    assert again.modes[0] is Mode.AIDED
    assert np.mean(off < 3.0 * again.sigma) > 0.99
    assert off.max() < 12.0
    start = live(recording, within(recording, BACK, BACK + 4.0, (MagSample,)), blind, **{"aids.magnetometer": False})
    assert math.sqrt(start.engine.sins.run.settled.P[at.PHI + 2, at.PHI + 2]) > 0.7
    assert "the heading is known to" in start.engine.status().doubt


def test_odom_goes_on_where_it_was():
    """GIVEN map moved against odom by a return of GNSS WHEN the process is killed THEN odom goes on within sigma."""
    recording = flight("multirotor_light", END).with_faults(*silence(30.0, 15.0))
    first, saved = before(recording)
    assert math.hypot(*saved.correction_enu) > 1.0
    again = after(recording, saved)
    truth = recording.truth
    moved = [np.interp([first.t[-1], again.t[0]], truth.t, c) for c in (truth.lat, truth.lon, truth.alt)]
    there, here = lla_to_enu(*moved, *recording.origin)
    step = again.odom[0] - first.odom[-1] - (here - there)
    assert np.linalg.norm(step[:2]) < 3.0 * math.hypot(first.sigma[-1], again.sigma[0])


def test_a_restart_in_an_outage_goes_on_coasting():
    """GIVEN GNSS lost ten seconds before the kill WHEN the process comes back THEN it does not claim to be aided, it
    counts the seconds since the loss, its sigma covers the error, and GNSS is taken again when it returns."""
    recording = flight("multirotor_light", 120.0).with_faults(*silence(50.0, 40.0))
    first, saved = before(recording)
    assert saved.unaided > 8.0
    again = live(recording, within(recording, BACK, 110.0), saved)
    assert again.t[0] - BACK < 3.0
    assert again.modes[0] in (Mode.COASTING, Mode.DEAD_RECKONING)
    coasting = again.t < 88.0
    off = np.linalg.norm(again.error[:, :2], axis=1)
    assert np.mean(off[coasting] < 3.0 * again.sigma[coasting]) > 0.95
    assert again.modes[-1] is Mode.AIDED
    assert off[-1] < 10.0
    assert again.engine.origin == first.engine.origin


def test_a_flight_that_was_saved_and_restored_has_nearly_the_same_pose_and_sigma():
    """GIVEN a flight that has learned WHEN a process ends, the next one goes on at once, and 35 s later GNSS is lost
    THEN pose and sigma are nearly those of a process that did not end, aided and without GNSS."""
    saved_at, lost, end = 80.0, 115.0, 135.0
    recording = flight("multirotor_light", end).with_faults(*silence(lost, 100.0))
    parameters = Parameters()
    engine, tracks = PoseEstimator(parameters), []
    for sample in within(recording, 0.0, saved_at):
        engine.feed(sample)
    arrays = arrays_of(engine)
    assert arrays is not None
    again = PoseEstimator(parameters)
    resume(again, {name: values.copy() for name, values in arrays.items()})
    for copy in (engine, again):
        outputs = [o for sample in within(recording, saved_at, end) for o in copy.feed(sample)]
        blocks = [o for o in outputs if isinstance(o, NavBlock)]
        t = (np.concatenate([b.stamps_ns for b in blocks]) - recording.start_ns) * 1e-9
        rows = np.concatenate([b.rows for b in blocks])
        tracks.append(rows[np.searchsorted(t, [lost - 1.0, lost + 5.0, end - 1.0])])
    whole, restored = tracks
    sigmas = [np.sqrt(rows[:, at.OUT_VAR + at.DPOS : at.OUT_VAR + at.DPOS + 3]) for rows in tracks]
    np.testing.assert_array_less(np.abs(np.log(sigmas[1] / sigmas[0])), math.log(1.6))
    for a, b, sigma in zip(whole, restored, sigmas[0], strict=True):
        apart = lla_to_enu(*a[at.OUT_POS : at.OUT_VEL], *b[at.OUT_POS : at.OUT_VEL])
        assert np.all(np.abs(apart) < 1.5 * sigma)


def test_a_file_of_an_earlier_version_is_read():
    """GIVEN a file without what later versions keep THEN it is a state in which that is unknown."""
    _, saved = before(flight("hover", END, 6))
    assert saved.gyro_wander != Wander()
    assert saved.baro_variance > 0.0
    later = ("error_shares", "gyro_wander", "baro_variance", "baro_least_sd", "body_velocity_error")
    old = SavedState.of({name: values for name, values in saved.arrays().items() if name not in later})
    assert (old.error_shares, old.gyro_wander, old.baro_variance) == ((1.0,) * 4, Wander(), 0.0)
    assert math.isnan(old.body_velocity_error)


def test_a_height_that_was_vague_is_not_known_better_after_a_restart():
    """GIVEN a barometer that was compared with a height good to 30 m WHEN the next process begins THEN its heights are
    no better."""
    _, saved = before(flight("hover", END, 6))
    run = after(flight("hover", END, 6), moved(saved, baro_variance=900.0)).engine.sins.run
    fresh = resumed(
        moved(saved, baro_variance=900.0), FilterRun(Parameters(), Journal(), None, True), saved.stamp_ns + 1
    )
    assert fresh.aids[PressureSample].is_vague
    assert not run.aids[PressureSample].is_vague  # GNSS has shown it since


def test_a_barometer_in_doubt_stays_so():
    """GIVEN a barometer that has strayed from the navigator by 20 m in an outage WHEN the next process begins THEN the
    height is as uncertain as before."""
    _, saved = before(flight("hover", END, 6))
    assert saved.baro_least_sd == 0.0
    fresh = resumed(
        moved(saved, baro_least_sd=30.0), FilterRun(Parameters(), Journal(), None, True), saved.stamp_ns + 1
    )
    assert fresh.aids[PressureSample].least_sd == 30.0


@pytest.mark.parametrize("error", [0.02, math.nan])
def test_a_confirmed_body_velocity_stays_confirmed(error: float):
    """GIVEN a body velocity that motion has confirmed, or not WHEN the next process begins THEN it is as well known."""
    _, saved = before(flight("hover", END, 6))
    run = resumed(
        moved(saved, body_velocity_error=error), FilterRun(Parameters(), Journal(), None, True), saved.stamp_ns + 1
    )
    body = run.imu_physics.motion.body
    assert body.is_proven == math.isfinite(error)
    assert body.possible_error == (error if math.isfinite(error) else 1.0)


# --- a state that is wrong ------------------------------------------------------------------------------------------
def moved(saved: SavedState, **changes: Any) -> SavedState:
    return replace(saved, **changes)


@pytest.mark.parametrize("seconds", [7.0, 1e6, -61.0, -3600.0, -1e7], ids=lambda x: f"{x:.0f}")
def test_of_an_old_state_the_origin_is_kept_and_nothing_that_ages(seconds):
    """GIVEN a state of a minute, an hour or months ago, or of another clock THEN it says so once, aligns as if there
    were none, and its axes are the old ones; noise counts for an hour."""
    recording = flight("multirotor_light", END)
    _, saved = before(recording)
    old = moved(saved, stamp_ns=saved.stamp_ns + int(seconds * 1e9), imu_variance=2.0, trials=5)
    again, cold = after(recording, old), after(recording, None)
    assert [n for n in again.names() if n.startswith("resume")] == ["resume.origin"]
    assert "aligned" in again.names()
    assert again.engine.origin == saved.origin != cold.engine.origin
    assert again.t[0] == pytest.approx(cold.t[0], abs=0.5)
    off = np.linalg.norm(again.error[:, :2], axis=1)
    assert np.mean(off < 3.0 * again.sigma) > 0.99
    assert off.max() < 12.0
    assert (again.engine.sins.run.noise.trials >= 5) is (seconds == -61.0)


@pytest.mark.parametrize("seconds", [-3600.0, 1e6], ids=["old", "another clock"])
def test_the_origin_of_another_place_is_given_up(seconds):
    """GIVEN an old state of 150 km further North WHEN the first fix comes THEN the origin is a new one, and it says so;
    half as far it is kept."""
    recording = flight("multirotor_light", END)
    _, saved = before(recording)
    for km, kept in ((150.0, False), (75.0, True)):
        (lat, lon, alt), (lat0, lon0, alt0) = saved.position, saved.origin
        north = 1e3 * km / 6.4e6
        far = moved(saved, position=(lat + north, lon, alt), origin=(lat0 + north, lon0, alt0))
        again = after(recording, moved(far, stamp_ns=saved.stamp_ns + int(seconds * 1e9)))
        assert again.names().count("resume.refused.moved") == (0 if kept else 1)
        assert (again.engine.origin == far.origin) is kept
        assert np.linalg.norm(again.error[:, :2], axis=1).max() < 12.0


def test_a_vehicle_that_was_carried_away_aligns_cold():
    """GIVEN a state of five kilometres further North WHEN the first fix comes THEN nothing of it counts."""
    recording = flight("multirotor_light", END)
    _, saved = before(recording)
    lat, lon, alt = saved.position
    wrong = moved(saved, position=(lat + 5e3 / 6.4e6, lon, alt))
    again = after(recording, wrong)
    assert again.names().count("resume.refused.moved") == 1
    assert again.engine.origin != saved.origin
    off = np.linalg.norm(again.error[:, :2], axis=1)
    assert np.mean(off < 3.0 * again.sigma) > 0.99
    assert off.max() < 12.0


@pytest.mark.parametrize("turn", [1.5, 3.1])
def test_a_vehicle_that_has_turned_unseen_does_not_fly_on_with_the_old_heading(turn):
    """GIVEN a state whose heading is wrong by a quarter or half a turn, and no magnetometer to tell
    THEN it is found out within seconds of motion, and the position stays right within sigma."""
    recording = flight("stop_and_go", 110.0)
    life = live(recording, within(recording, 0.0, KILLED), **{"aids.magnetometer": False})
    saved = state_of(life.engine.sins.run)
    assert saved is not None
    w, z = math.cos(turn / 2.0), math.sin(turn / 2.0)
    a, b, c, d = saved.q_nb
    wrong = moved(saved, q_nb=(w * a - z * d, w * b - z * c, w * c + z * b, w * d + z * a))
    samples = within(recording, KILLED + 1.0, 100.0, (MagSample,))
    again = live(recording, samples, wrong, **{"aids.magnetometer": False})
    off = np.linalg.norm(again.error[:, :2], axis=1)
    assert again.names().count("resume.heading.wrong") == 1
    told = next(e for e in again.events if e.name == "resume.heading.wrong")
    assert (told.stamp_ns - recording.start_ns) * 1e-9 < KILLED + 20.0
    assert off[again.t > 75.0].max() < 5.0
    assert np.mean(off < 3.0 * again.sigma) > 0.95


def test_a_heading_that_nobody_has_confirmed_is_not_handed_on():
    """GIVEN a vehicle that has just aligned on its magnetometer WHEN its state is saved THEN it is not to be flown on
    with: what it knows of the heading is what a cold start finds as well."""
    recording = flight("multirotor_light", END)
    state = state_of(live(recording, within(recording, 0.0, 5.0)).engine.sins.run)
    assert state is not None
    assert not state.is_sound


def test_a_continued_heading_stays_on_trial():
    """GIVEN a warm start THEN its heading is on trial: nobody has seen what happened in between."""
    recording = flight("hover", END, 6)
    _, saved = before(recording)
    run = live(recording, within(recording, BACK, BACK + 3.0), saved).engine.sins.run
    assert run.timeline.running
    assert run.trial is not None


def test_gnss_left_out_of_the_first_second_is_waited_for():
    """GIVEN an aided state WHEN no fix comes after the restart THEN it goes on without GNSS, and says so."""
    recording = flight("multirotor_light", END)
    _, saved = before(recording)
    again = after(recording, saved, *GNSS)
    assert again.t[0] - BACK < 4.0
    assert again.modes[-1] is Mode.DEAD_RECKONING
    off = np.linalg.norm(again.error[:, :2], axis=1)
    assert np.mean(off < 3.0 * again.sigma) > 0.95
