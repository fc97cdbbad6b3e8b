"""The time line: whenever an observation arrives, it acts at its own time and leads to the same numbers."""

import copy
import dataclasses

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import measurements, memory
from nav_pose_estimator.core.filter.kalman import correct
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.engine.navigator import filter_setup
from nav_pose_estimator.engine.navigator.timeline import Timeline
from nav_pose_estimator.engine.observation import GATED, FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update

RATE = 200
POSITION, VELOCITY = Kind("position", precedence=0), Kind("velocity", precedence=1)
LAT, LON, ALT = 0.8, 0.2, 300.0


def apply(o: Observation, f: FilterView) -> None:
    """Position or velocity with unit noise."""
    if o.kind is POSITION:
        z, H = measurements.gnss_position(f.nav, len(f.P), *o.measured, np.zeros(3))
    else:
        z, H = measurements.gnss_velocity(f.nav, len(f.P), np.array(o.measured), np.zeros(3))
    correct(*f, z, H, np.eye(3))


def observation(t: float, kind: Kind, measured: tuple) -> Observation:
    """One that is stamped like its time."""
    return Observation(t, round(t * 1e9), kind, measured)


def imu_rows(seconds: float, seed: int = 3) -> np.ndarray:
    """IMU rows of a vehicle that shakes and turns."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    rows = np.empty((n, at.IMU_COLUMNS))
    rows[:, 0] = (1 + np.arange(n)) / RATE + rng.uniform(-2e-4, 2e-4, n)
    rows[:, 1:4] = rng.normal((0.0, 0.0, 0.3), 0.2, (n, 3))
    rows[:, 4:] = rng.normal([0.3, -0.2, 9.81], 0.5, (n, 3))
    return rows


def started(sampling: str = "mean", window: float = 1.5) -> Timeline:
    parameters = update(Parameters(), {"imu.sampling": sampling})
    timeline = Timeline(filter_setup.constants(parameters, NoiseIdentification()), apply, window)
    nav = np.zeros(at.NAV_SIZE)
    nav[at.LAT : at.VEL] = LAT, LON, ALT
    nav[at.QUAT] = 1.0
    timeline.start(nav, 0.01 * np.eye(at.BASE_STATES))
    return timeline


OBSERVATIONS = [
    (0.4031, POSITION, (LAT + 1e-7, LON, ALT)),
    (0.4031, VELOCITY, (0.1, 0.2, 0.0)),
    (0.8, POSITION, (LAT, LON + 1e-7, ALT + 1.0)),
    (1.11, VELOCITY, (0.3, -0.2, 0.1)),
]


def run(arrivals: list[tuple[float, tuple]], sampling: str = "mean", block: int = 7) -> Timeline:
    """Feed 2 s of IMU in blocks; each observation arrives once the IMU has passed its arrival time."""
    timeline, rows, waiting, done = started(sampling), imu_rows(2.0), sorted(arrivals, key=lambda a: a[0]), 0
    while done < len(rows):
        while waiting and waiting[0][0] <= (timeline.filter.time if done else 0.0) + 1e-12:
            assert timeline.observe(observation(*waiting.pop(0)[1]))
        timeline.advance(rows[done : done + block])
        done += block
    timeline.settle()
    return timeline


def punctual() -> list[tuple[float, tuple]]:
    return [(0.0, o) for o in OBSERVATIONS]


@pytest.mark.parametrize("sampling", ["mean", "point"])
@pytest.mark.parametrize("delay", [0.003, 0.1, 0.45, 0.8])
def test_late_observations_lead_to_the_same_state(sampling: str, delay: float) -> None:
    """GIVEN fixes that arrive before their time WHEN the same fixes arrive late THEN nothing differs."""
    reference = run(punctual(), sampling)
    late = run([(o[0] + delay, o) for o in OBSERVATIONS], sampling)
    np.testing.assert_allclose(late.filter.nav, reference.filter.nav, rtol=0, atol=1e-12)
    np.testing.assert_allclose(late.filter.P, reference.filter.P, rtol=1e-9, atol=1e-15)


def test_out_of_order_observations_lead_to_the_same_state() -> None:
    reference = run(punctual())
    shuffled = run([(1.4, OBSERVATIONS[3]), (1.3, OBSERVATIONS[1]), (1.35, OBSERVATIONS[0]), (1.6, OBSERVATIONS[2])])
    np.testing.assert_array_equal(shuffled.filter.nav, reference.filter.nav)
    np.testing.assert_array_equal(shuffled.filter.P, reference.filter.P)


@pytest.mark.parametrize("block", [1, 3, 64, 400])
def test_blocks_and_single_rows_are_equal_bit_for_bit(block: int) -> None:
    reference = run(punctual(), block=1)
    other = run(punctual(), block=block)
    np.testing.assert_array_equal(other.filter.nav, reference.filter.nav)
    np.testing.assert_array_equal(other.filter.P, reference.filter.P)


def test_an_observation_beyond_the_memory_is_refused_and_changes_nothing() -> None:
    timeline = started()
    timeline.advance(imu_rows(4.0))
    nav = timeline.filter.nav.copy()
    assert not timeline.observe(observation(0.5, VELOCITY, (5.0, 5.0, 5.0)))
    timeline.settle()
    np.testing.assert_array_equal(timeline.filter.nav, nav)


def test_a_copy_lives_its_own_life() -> None:
    timeline = started()
    rows = imu_rows(2.0)
    timeline.advance(rows[:200])
    twin = copy.deepcopy(timeline)
    twin.observe(observation(0.9, VELOCITY, (5.0, 5.0, 5.0)))
    twin.advance(rows[200:])
    timeline.advance(rows[200:])
    plain = started()
    plain.advance(rows)
    np.testing.assert_array_equal(timeline.filter.nav, plain.filter.nav)
    assert abs(twin.filter.nav[at.VEL] - timeline.filter.nav[at.VEL]) > 0.01


def test_a_copy_of_an_observation_lacks_nothing() -> None:
    one = Observation(1.5, 7, POSITION, (LAT, LON, ALT), np.eye(3), 3, GATED, behind=True)
    for field in dataclasses.fields(one):
        assert getattr(copy.deepcopy(one), field.name) is getattr(one, field.name), field.name


def test_memory_stays_bounded() -> None:
    timeline = started()
    for k, chunk in enumerate(np.split(imu_rows(40.0), 80)):
        timeline.observe(observation(0.5 * k + 0.25, VELOCITY, (0.0, 0.0, 0.0)))
        timeline.advance(chunk)
    kept = timeline.filter.vector[memory.NEWEST] - timeline.filter.vector[memory.OLDEST]
    assert kept < 35
    assert len(timeline.queue) < 8
    assert len(timeline.imu.rows) < 3000


@pytest.mark.parametrize("sampling", ["mean", "point"])
@pytest.mark.parametrize("step", [79, 80, 81, 120])
def test_an_observation_of_the_present_acts_as_if_it_had_been_known(sampling: str, step: int) -> None:
    """GIVEN a fix stamped like the last IMU row WHEN it arrives after that row THEN nothing differs, then or later."""
    rows = imu_rows(2.0)
    now = float(rows[step, 0])
    fix, late = (now, POSITION, (LAT + 1e-7, LON, ALT)), (now - 0.01, VELOCITY, (0.1, 0.2, 0.0))
    known, told = started(sampling), started(sampling)
    known.observe(observation(*fix))
    known.observe(observation(*late))
    known.advance(rows)
    told.advance(rows[: step + 1])
    told.observe(observation(*fix))
    told.advance(rows[step + 1 : 200])
    told.observe(observation(*late))
    told.advance(rows[200:])
    told.settle()
    np.testing.assert_array_equal(told.filter.nav, known.filter.nav)
    np.testing.assert_array_equal(told.filter.P, known.filter.P)


def test_what_acts_behind_a_row_does_not_act_ahead_of_it() -> None:
    """GIVEN two observations of the time of a row, of which one acts ahead of the row and one behind it
    WHEN both are known before it THEN the row is the same as if the second one came after it."""
    rows = imu_rows(1.0)
    now = float(rows[80, 0])
    known, told = started(), started()
    for timeline in (known, told):
        timeline.observe(observation(now, POSITION, (LAT + 1e-7, LON, ALT)))
    second = observation(now, VELOCITY, (0.1, 0.2, 0.0))
    known.observe(dataclasses.replace(second, behind=True))
    before = told.advance(rows[:81])
    told.observe(second)
    np.testing.assert_array_equal(known.advance(rows), np.concatenate([before, told.advance(rows[81:])]))


@pytest.mark.parametrize("block", [1, 7, 400])
def test_rows_of_the_last_second_and_a_half_are_known_with_a_short_memory(block: int) -> None:
    """GIVEN a memory of 0.3 s WHEN rows come one by one or in blocks THEN the past that a look back needs is known."""
    timeline, rows = started(window=0.3), imu_rows(3.0)
    for part in np.split(rows, range(block, len(rows), block)):
        timeline.advance(part)
    since = timeline.filter.time - 1.5
    np.testing.assert_array_equal(timeline.rows_since(since), rows[rows[:, 0] > since])
