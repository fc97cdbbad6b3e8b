"""The last second of a solution as a network takes it: the same motion gives the same window at every rate."""

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.learning.conv_lstm import STEPS
from nav_pose_estimator.core.motion.windows import CHANNELS, increments, rotation_vector, window
from nav_pose_estimator.core.numerics.rotation import quat_from_euler, quat_to_matrix

TURN = 0.8  # rad/s about up


def rows(rate: float, seconds: float = 1.0, until: float = 12.0) -> np.ndarray:
    """A vehicle that turns on a circle, with a specific force that changes slowly."""
    t = until - np.arange(round(seconds * rate), -1, -1) / rate
    out = np.zeros((len(t), at.OUT_COLUMNS))
    out[:, at.OUT_T] = t
    out[:, at.OUT_VEL], out[:, at.OUT_VEL + 1] = 5.0 * np.cos(TURN * t), 5.0 * np.sin(TURN * t)
    for i, now in enumerate(t):
        out[i, at.OUT_QUAT : at.OUT_QUAT + 4] = quat_from_euler(0.2, 0.1, TURN * now)
    out[:, at.OUT_FORCE], out[:, at.OUT_FORCE + 2] = np.sin(t), 9.8
    out[:, at.OUT_RATE + 2] = TURN
    return out


@pytest.mark.parametrize("rate", [50.0, 200.0, 1000.0])
def test_a_window_holds_fifty_means_whatever_the_rate(rate: float) -> None:
    """GIVEN one motion WHEN sampled at 50, 200, 1000 Hz THEN the window differs by no more than half a sample of it."""
    found = window(rows(rate))
    middle = 12.0 - 1.0 + (np.arange(STEPS) + 0.5) / STEPS
    assert found.shape == (STEPS, CHANNELS)
    np.testing.assert_allclose(found[:, 0], np.sin(middle), atol=0.6 / rate)
    np.testing.assert_allclose(found[:, 5], TURN, atol=1e-9)
    up = quat_to_matrix(np.array(quat_from_euler(0.2, 0.1, 0.0)))[2]
    np.testing.assert_allclose(found[:, 6:], np.tile(up, (STEPS, 1)), atol=1e-9)


def test_what_is_older_than_a_second_does_not_count() -> None:
    older = rows(200.0, 1.5)
    older[older[:, at.OUT_T] < 11.0 - 0.01, at.OUT_FORCE] = 1e6
    np.testing.assert_allclose(window(older), window(rows(200.0)), atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 30])
def test_a_window_that_begins_late_is_filled_up(count: int) -> None:
    """GIVEN fewer rows than a second WHEN asked THEN the first ones hold since before, and nothing is NaN."""
    found = window(rows(100.0)[-count:])
    assert np.isfinite(found).all()
    assert found[-1, 0] == pytest.approx(np.sin(12.0), abs=0.02)
    np.testing.assert_allclose(found[:, 8], found[0, 8])


def test_repeated_stamps_do_no_harm() -> None:
    twice = np.repeat(rows(100.0), 2, axis=0)
    np.testing.assert_allclose(window(twice), window(rows(100.0)), atol=1e-9)


def test_increments_are_those_of_the_motion() -> None:
    """GIVEN a level circle WHEN a second has passed THEN dp is the chord, dtheta the turn, dv the change, in b."""
    level = rows(200.0)
    for row in level:
        row[at.OUT_QUAT : at.OUT_QUAT + 4] = quat_from_euler(0.0, 0.0, TURN * row[at.OUT_T])
    found = increments(level)
    end = TURN * 12.0
    begin = end - TURN
    C = quat_to_matrix(np.array(quat_from_euler(0.0, 0.0, end)))
    chord = 5.0 / TURN * np.array([np.sin(end) - np.sin(begin), np.cos(begin) - np.cos(end), 0.0])
    change = 5.0 * np.array([np.cos(end) - np.cos(begin), np.sin(end) - np.sin(begin), 0.0])
    np.testing.assert_allclose(found[:3], chord @ C, atol=0.02)
    np.testing.assert_allclose(found[3:6], [0.0, 0.0, TURN], atol=1e-6)
    np.testing.assert_allclose(found[6:], change @ C, atol=1e-6)


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-12, 0.0, 0.0), (0.3, -0.5, 1.0), (3.0, 0.1, 0.0)])
def test_the_logarithm_undoes_a_rotation(vector: tuple[float, float, float]) -> None:
    phi = np.array(vector)
    angle = np.linalg.norm(phi)
    q = np.append(np.cos(angle / 2.0), phi * (0.5 * np.sinc(angle / (2.0 * np.pi))))
    np.testing.assert_allclose(rotation_vector(quat_to_matrix(q)), phi, atol=1e-9)
