"""Values that repeat themselves for longer than by chance."""

import numpy as np
import pytest

from nav_pose_estimator.engine.sensors.frozen import FROZEN, LIVE, SUSPECT, Frozen

PERIOD = 0.1  # s


def heights(resolution: float, noise: float, climb: float, count: int = 1200, repeat: int = 1) -> np.ndarray:
    """What a barometer of this ``resolution`` and ``noise`` [m] tells, every value ``repeat`` times."""
    rng = np.random.default_rng(4)
    true = climb * PERIOD * np.arange(count) + rng.normal(0.0, noise, count)
    return np.repeat(np.round(true / resolution) * resolution, repeat)


def told(values: np.ndarray, start: float = 0.0, frozen: Frozen | None = None) -> tuple[Frozen, list[bool]]:
    frozen, verdicts = frozen or Frozen(), []
    for k, value in enumerate(values.tolist()):
        frozen.note(start + PERIOD * k, value)
        verdicts.append(frozen.verdict == FROZEN)
    return frozen, verdicts


@pytest.mark.parametrize("repeat", [1, 5])
@pytest.mark.parametrize(("resolution", "noise"), [(0.02, 0.2), (0.1, 0.1), (0.8, 0.3)])
@pytest.mark.parametrize("climb", [0.0, 1.0])
def test_a_live_barometer_is_not_frozen(resolution: float, noise: float, climb: float, repeat: int) -> None:
    assert not any(told(heights(resolution, noise, climb, repeat=repeat))[1])


@pytest.mark.parametrize(("repeat", "within"), [(1, 9.0), (5, 12.0)])
def test_a_frozen_one_is_found_and_forgiven(repeat: int, within: float) -> None:
    sound = heights(0.02, 0.2, 0.0, repeat=repeat)
    frozen, _ = told(sound)
    frozen, verdicts = told(np.full(200, sound[-1]), PERIOD * len(sound), frozen)
    assert verdicts.index(True) * PERIOD < within
    frozen.note(1e4, sound[-1] + 0.02)
    assert frozen.verdict == LIVE


def test_a_value_that_repeats_is_suspected_at_once() -> None:
    """GIVEN a barometer that hardly ever repeats a value WHEN one comes five times THEN it is not used meanwhile."""
    sound = heights(0.02, 0.2, 0.0)
    frozen, _ = told(sound)
    told(np.full(5, sound[-1]), PERIOD * len(sound), frozen)
    assert frozen.verdict == SUSPECT


def test_nothing_is_said_of_a_sensor_that_was_never_seen_to_change() -> None:
    assert not any(told(np.full(3000, 1.0))[1])
