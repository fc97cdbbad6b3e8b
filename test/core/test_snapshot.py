"""One copy for the state of every component."""

import dataclasses
from collections import deque
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import pytest
from exact_motion import survey, times_of

from filter_start import plain_constants
from nav_pose_estimator.core.alignment.heading_hypotheses import HeadingHypotheses
from nav_pose_estimator.core.gnss.quality_gate import GateSettings, GnssGate
from nav_pose_estimator.core.numerics.snapshot import SHARED, snapshot


class Phase(Enum):
    GOOD = "good"


@dataclass(frozen=True)
class Settings:
    table: list[float]


@dataclass(slots=True)
class Track:
    marks: list[float]


@dataclass
class State:
    settings: Settings
    track: Track
    phase: Phase = Phase.GOOD
    memory: np.ndarray = field(default_factory=lambda: np.zeros(3))
    recent: deque = field(default_factory=lambda: deque([1.0, 2.0], maxlen=2))
    counters: dict[str, int] = field(default_factory=dict)
    windows: tuple[np.ndarray, ...] = ()
    journal: list[str] = field(default_factory=list, metadata=SHARED)


def state() -> State:
    return State(Settings([1.0]), Track([0.5]), counters={"used": 1}, windows=(np.ones(2),))


def test_a_change_of_the_original_leaves_the_copy_alone() -> None:
    """GIVEN a copy WHEN every part of the original changes THEN the copy is what the original was."""
    original, expected = state(), state()
    twin = snapshot(original)
    original.track.marks.append(9.0)
    original.memory[0] = 9.0
    original.recent.append(9.0)
    original.counters["used"] = 9
    original.windows[0][:] = 9.0
    assert dataclasses.replace(twin, memory=[], windows=()) == dataclasses.replace(expected, memory=[], windows=())
    np.testing.assert_array_equal(twin.memory, expected.memory)
    np.testing.assert_array_equal(twin.windows[0], expected.windows[0])
    assert twin.recent.maxlen == 2


def test_parameters_and_what_is_marked_are_shared() -> None:
    original = state()
    twin = snapshot(original)
    assert twin.settings is original.settings
    assert twin.journal is original.journal


def test_a_field_that_is_added_later_is_copied() -> None:
    """GIVEN a state with one more mutable field WHEN copied THEN that field is copied without another line of code."""
    wider = dataclasses.make_dataclass("Wider", [("added", list)], bases=(Track,))
    original = wider(marks=[1.0], added=[[2.0]])
    twin = snapshot(original)
    original.added[0].append(3.0)
    assert twin.added == [[2.0]]
    assert type(twin) is wider


def test_what_is_shared_inside_a_state_is_shared_inside_its_copy() -> None:
    track = Track([1.0])
    first, second = snapshot([track, track])
    assert first is second
    assert first is not track


def test_an_array_that_cannot_be_written_to_is_shared() -> None:
    rows = np.ones(3)
    rows.flags.writeable = False
    assert snapshot([rows])[0] is rows


@pytest.mark.parametrize("value", [object(), np.random.default_rng(1), [].append, np.array([[], None], dtype=object)])
def test_what_cannot_be_copied_is_refused(value: object) -> None:
    with pytest.raises(TypeError, match="snapshot cannot copy"):
        snapshot(Track([value]))  # type: ignore[list-item]


def test_the_components_of_core_are_states() -> None:
    """GIVEN a gate and a bank of hypotheses WHEN copied THEN the copy goes its own way."""
    gate = GnssGate(GateSettings("none", 6, 4, 2.0, 2.0, 10.0, 0.5, 20.0, 40.0))
    twin = snapshot(gate)
    gate.update_count(1.0, 9)
    assert gate.state.last_update == 1.0
    assert twin.state.last_update == -np.inf
    assert twin.settings is gate.settings

    bank = HeadingHypotheses(survey().nav(0.0), np.eye(15), 4, plain_constants(), np.zeros(3))
    other = snapshot(bank)
    before = other.navs.copy()
    bank.run(survey().imu_rows(times_of(0.5, 50.0)))
    np.testing.assert_array_equal(other.navs, before)
    other.run(survey().imu_rows(times_of(0.5, 50.0)))
    np.testing.assert_array_equal(other.navs, bank.navs)
