"""One axis of an IMU that stays where it is, and two halves of a message that are exchanged."""

from collections import deque

import numpy as np
import pytest

from nav_pose_estimator.engine.imu.doubt import DoubtMeter
from nav_pose_estimator.engine.imu.physics import ImuPhysics
from nav_pose_estimator.engine.imu.plausibility import Finding, find
from nav_pose_estimator.engine.imu.seconds import second_of
from nav_pose_estimator.engine.journal import Journal

RATE = 100


def second(k: int, moves: float = 0.2) -> np.ndarray:
    """Rows (101, 7) of the second that begins at ``k``, with one from before it; rates move by about ``moves``."""
    rng = np.random.default_rng(k)
    t = k + np.arange(RATE + 1) / RATE
    swing = moves * np.column_stack([np.sin(2.0 * t + phase) for phase in range(3)])
    rows = np.column_stack([t, swing, 2.0 * swing + [0.0, 0.0, 9.8]])
    rows[:, 1:] += rng.normal(0.0, 0.01, (RATE + 1, 6))
    return rows


def doubted(rows: np.ndarray) -> tuple[float, float]:
    """Deviations of attitude and velocity after a second like any other, and these ``rows``."""
    meter = DoubtMeter()
    meter.measure(second(0))
    doubt = meter.measure(rows)
    return (0.0, 0.0) if doubt is None else doubt[:2]


@pytest.mark.parametrize(("column", "sensor"), [(2, 0), (4, 1)], ids=["gyroscope's y", "accelerometer's x"])
def test_an_axis_that_stays_while_the_others_move_is_a_doubt(column: int, sensor: int) -> None:
    rows = second(1)
    rows[20:, column] = rows[20, column]
    assert doubted(rows)[sensor] > (0.1, 1.0)[sensor]
    assert doubted(rows)[1 - sensor] == 0.0


@pytest.mark.parametrize(
    ("columns", "lasting"), [([1, 2, 3], True), ([4, 5, 6], False), ([1, 2, 3, 4, 5, 6], False)],
    ids=["gyroscope", "accelerometer", "both, as in a simulation at rest"],
)  # fmt: skip
def test_a_dead_gyroscope_is_doubted_with_gnss_too(columns: list[int], lasting: bool) -> None:
    """GIVEN a sensor that repeats one value THEN GNSS does not remove the doubt about a gyroscope: heading is lost."""
    meter, rows = DoubtMeter(), second(1)
    meter.measure(second(0))
    rows[20:, columns] = rows[20, columns]
    doubt = meter.measure(rows)
    assert doubt is not None
    assert doubt.lasting is lasting


def test_an_axis_that_stays_for_a_moment_is_none() -> None:
    rows = second(1)
    rows[20:60, 2] = rows[20, 2]
    assert doubted(rows) == (0.0, 0.0)


def test_coarse_rates_of_a_vehicle_that_hardly_turns_are_none() -> None:
    rows = second(1, moves=0.01)
    rows[:, 1:4] = np.round(rows[:, 1:4] / 0.02) * 0.02
    rows[:, 2] = 0.0
    assert doubted(rows) == (0.0, 0.0)


def found(change, seconds: int = 6) -> Finding | None:
    known: deque = deque(maxlen=8)
    for k in range(seconds):
        rows = second(k)
        known.append(second_of(change(rows)[1:], k + 1.0))
    return find(list(known), in_flight=False)


def test_a_dead_axis_is_named_also_in_gentle_flight() -> None:
    def stuck(rows: np.ndarray) -> np.ndarray:
        rows[:, 3] = 0.123
        return rows

    finding = found(stuck)
    assert finding is not None
    assert "gyroscope's z axis" in finding.sentence
    assert found(lambda rows: rows) is None


def test_a_dead_axis_stays_dead_until_it_changes() -> None:
    """A calm stretch, in which the other axes hardly move either, proves nothing."""
    physics, journal, refusals = ImuPhysics(), Journal(), []
    for k in range(20):
        rows = second(k, moves=0.2 if k < 6 else 0.0)
        if k < 12:
            rows[:, 3] = 0.123
        physics.look(k + 1.0, rows, None, journal, 0)
        refusals.append(bool(physics.refusal))
    assert refusals[5:14] == [True] * 9
    assert not refusals[-1]


def test_exchanged_halves_are_named() -> None:
    finding = found(lambda rows: rows[:, [0, 4, 5, 6, 1, 2, 3]], seconds=3)
    assert finding is not None
    assert finding.name == "imu.implausible.exchanged"
    assert "exchanged" in finding.sentence


def test_an_acceleration_without_gravity_is_not_taken_for_g() -> None:
    """A driver that takes gravity away is named throughout, also where it reads 1 m/s^2 for seconds."""
    physics, journal = ImuPhysics(), Journal()
    for k in range(10):
        rows = second(k)
        rows[:, 6] -= 9.8 if k < 5 else 8.8
        physics.look(k + 1.0, rows, None, journal, 0)
    assert "removes gravity" in physics.refusal
    assert not journal.counters["imu.implausible.in_g"]
