"""The time line: whenever an observation arrives, it acts at its own time and leads to the same numbers."""

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.kalman import correct
from nav_pose_estimator.engine.navigator import filter_setup
from nav_pose_estimator.engine.navigator.timeline import Observation, Timeline
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update

RATE = 200
LAT, LON, ALT = 0.8, 0.2, 300.0


def apply(o: Observation, nav: np.ndarray, P: np.ndarray, constants: np.ndarray) -> None:
    """Position or velocity with unit noise."""
    if o.kind == "position":
        z, H = measurements.gnss_position(nav, len(P), *o.arguments, np.zeros(3))
    else:
        z, H = measurements.gnss_velocity(nav, len(P), np.array(o.arguments), np.zeros(3))
    correct(nav, P, constants, z, H, np.eye(3))


def imu_rows(seconds: float, seed: int = 3) -> np.ndarray:
    """IMU rows of a vehicle that shakes and turns."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    rows = np.empty((n, at.IMU_COLUMNS))
    rows[:, 0] = (1 + np.arange(n)) / RATE + rng.uniform(-2e-4, 2e-4, n)
    rows[:, 1:4] = rng.normal((0.0, 0.0, 0.3), 0.2, (n, 3))
    rows[:, 4:] = rng.normal([0.3, -0.2, 9.81], 0.5, (n, 3))
    return rows


def started(sampling: str = "mean") -> Timeline:
    parameters = update(Parameters(), {"imu.sampling": sampling})
    timeline = Timeline(filter_setup.constants(parameters), apply, window=1.5)
    nav = np.zeros(at.NAV_SIZE)
    nav[at.LAT : at.VEL] = LAT, LON, ALT
    nav[at.QUAT] = 1.0
    timeline.start(nav, 0.01 * np.eye(at.BASE_STATES))
    return timeline


OBSERVATIONS = [
    (0.4031, "position", (LAT + 1e-7, LON, ALT), 0),
    (0.4031, "velocity", (0.1, 0.2, 0.0), 1),
    (0.8, "position", (LAT, LON + 1e-7, ALT + 1.0), 0),
    (1.11, "velocity", (0.3, -0.2, 0.1), 1),
]


def run(arrivals: list[tuple[float, tuple]], sampling: str = "mean", block: int = 7) -> Timeline:
    """Feed 2 s of IMU in blocks; each observation arrives once the IMU has passed its arrival time."""
    timeline, rows, waiting, done = started(sampling), imu_rows(2.0), sorted(arrivals, key=lambda a: a[0]), 0
    while done < len(rows):
        while waiting and waiting[0][0] <= (timeline.time if done else 0.0) + 1e-12:
            t, kind, arguments, priority = waiting.pop(0)[1]
            assert timeline.observe(t, kind, arguments, priority)
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
    np.testing.assert_allclose(late.nav, reference.nav, rtol=0, atol=1e-12)
    np.testing.assert_allclose(late.P, reference.P, rtol=1e-9, atol=1e-15)


def test_out_of_order_observations_lead_to_the_same_state() -> None:
    reference = run(punctual())
    shuffled = run([(1.4, OBSERVATIONS[3]), (1.3, OBSERVATIONS[1]), (1.35, OBSERVATIONS[0]), (1.6, OBSERVATIONS[2])])
    np.testing.assert_array_equal(shuffled.nav, reference.nav)
    np.testing.assert_array_equal(shuffled.P, reference.P)


@pytest.mark.parametrize("block", [1, 3, 64, 400])
def test_blocks_and_single_rows_are_equal_bit_for_bit(block: int) -> None:
    reference = run(punctual(), block=1)
    other = run(punctual(), block=block)
    np.testing.assert_array_equal(other.nav, reference.nav)
    np.testing.assert_array_equal(other.P, reference.P)


def test_an_observation_beyond_the_memory_is_refused_and_changes_nothing() -> None:
    timeline = started()
    timeline.advance(imu_rows(4.0))
    nav = timeline.nav.copy()
    assert not timeline.observe(0.5, "velocity", (5.0, 5.0, 5.0), 1)
    timeline.settle()
    np.testing.assert_array_equal(timeline.nav, nav)


def test_a_copy_lives_its_own_life() -> None:
    timeline = started()
    rows = imu_rows(2.0)
    timeline.advance(rows[:200])
    twin = timeline.copy(apply)
    twin.observe(0.9, "velocity", (5.0, 5.0, 5.0), 1)
    twin.advance(rows[200:])
    timeline.advance(rows[200:])
    plain = started()
    plain.advance(rows)
    np.testing.assert_array_equal(timeline.nav, plain.nav)
    assert abs(twin.nav[at.VEL] - timeline.nav[at.VEL]) > 0.01


def test_memory_stays_bounded() -> None:
    timeline = started()
    for k, chunk in enumerate(np.split(imu_rows(40.0), 80)):
        timeline.observe(0.5 * k + 0.25, "velocity", (0.0, 0.0, 0.0), 1)
        timeline.advance(chunk)
    assert timeline.checkpoints < 12
    assert len(timeline._observations) < 8
    assert len(timeline._rows) < 3000


@pytest.mark.parametrize("sampling", ["mean", "point"])
@pytest.mark.parametrize("step", [79, 80, 81, 120])
def test_an_observation_of_the_present_acts_as_if_it_had_been_known(sampling: str, step: int) -> None:
    """GIVEN a fix stamped like the last IMU row WHEN it arrives after that row THEN nothing differs, then or later."""
    rows = imu_rows(2.0)
    now = float(rows[step, 0])
    fix, late = (now, "position", (LAT + 1e-7, LON, ALT), 0), (now - 0.01, "velocity", (0.1, 0.2, 0.0), 1)
    known, told = started(sampling), started(sampling)
    known.observe(*fix)
    known.observe(*late)
    known.advance(rows)
    told.advance(rows[: step + 1])
    told.observe(*fix)
    told.advance(rows[step + 1 : 200])
    told.observe(*late)
    told.advance(rows[200:])
    told.settle()
    np.testing.assert_array_equal(told.nav, known.nav)
    np.testing.assert_array_equal(told.P, known.P)
