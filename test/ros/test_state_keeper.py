"""The state on disk: what a node leaves behind, and that no file, however wrong, does it harm."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine import array_file
from nav_pose_estimator.engine.composed import resumption
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.ros import StateParameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, update
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.engine.solutions import NavBlock
from nav_pose_estimator.ros.continuation.state_keeper import STATE, StateKeeper
from told import flight

pytestmark = pytest.mark.compiled


def estimator() -> PoseEstimator:
    return PoseEstimator(update(Parameters(), {"learner.enabled": False}), attitude=False)


@pytest.fixture(scope="module")
def flown() -> PoseEstimator:
    engine = estimator()
    for sample in flight("multirotor_light", 20.0).samples():
        engine.feed(sample)
    return engine


class Node:
    """Keeps what is said."""

    def __init__(self) -> None:
        self.said: list[tuple[str, str]] = []

    def say(self, name, level, text) -> None:
        self.said.append((name, text))


def keeper_of(path: Path, engine: PoseEstimator, node: Node | None = None, **more: float) -> StateKeeper:
    return StateKeeper(node or Node(), engine, StateParameters(file=str(path), **more))


def test_what_is_written_is_what_is_read(flown, tmp_path):
    """GIVEN a navigator in flight WHEN its node ends THEN the file holds its state, and the next one begins with it."""
    path = tmp_path / "drone.state"
    keeper_of(path, flown).stop()
    expected = resumption.arrays_of(flown)
    read = array_file.load(path, STATE)
    assert expected is not None
    assert read.keys() == expected.keys()
    assert all(np.array_equal(read[name], expected[name], equal_nan=True) for name in read)
    engine, node = estimator(), Node()
    keeper_of(path, engine, node)
    assert engine.sins.resume is not None
    assert node.said == []


def test_a_file_that_another_node_writes_is_left_alone(flown, tmp_path):
    """GIVEN a node with a state file WHEN a second one gets the same file THEN it neither reads nor writes it."""
    path = tmp_path / "drone.state"
    first = keeper_of(path, flown)
    first.note(1_700_000_000_000_000_000)
    first.wait()
    before, engine, node = path.read_bytes(), estimator(), Node()
    second = keeper_of(path, engine, node)
    assert node.said == [
        (
            "resume.refused.file",
            f"the saved state is not used: another node writes {path}; give each node a file of its own",
        )
    ]
    assert engine.sins.resume is None
    second.note(1_700_000_001_000_000_000)
    second.stop()
    assert path.read_bytes() == before
    first.stop()
    keeper_of(path, engine, node).stop()
    assert engine.sins.resume is not None


def test_the_state_is_written_in_flight_and_not_more_often_than_asked(flown, tmp_path):
    """GIVEN solutions at 100 Hz WHEN ten seconds pass THEN there are about five states with a period of two seconds."""
    path, stamps = tmp_path / "drone.state", []
    keeper = keeper_of(path, flown, period=2.0)
    for i in range(1000):
        keeper.note(1_700_000_000_000_000_000 + i * 10_000_000)
        keeper.wait()
        if path.exists() and (not stamps or path.stat().st_mtime_ns != stamps[-1]):
            stamps.append(path.stat().st_mtime_ns)
    assert len(stamps) == 5
    assert [item.name for item in tmp_path.iterdir()] == ["drone.state"], "nothing half written is left"
    keeper.stop()


def good(flown: PoseEstimator, path: Path) -> dict[str, np.ndarray]:
    arrays = resumption.arrays_of(flown)
    assert arrays is not None
    array_file.save(path, STATE, arrays)
    return dict(arrays)


def truncated(flown: PoseEstimator, path: Path) -> None:
    good(flown, path)
    path.write_bytes(path.read_bytes()[:-100])


def flipped(flown: PoseEstimator, path: Path) -> None:
    good(flown, path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x40
    path.write_bytes(content)


def of_another_kind(flown: PoseEstimator, path: Path) -> None:
    array_file.save(path, array_file.Kind("model", 1), good(flown, path))


def newer(flown: PoseEstimator, path: Path) -> None:
    array_file.save(path, array_file.Kind("state", 2), good(flown, path))


def with_change(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[PoseEstimator, Path], None]:
    def spoil(flown: PoseEstimator, path: Path) -> None:
        arrays = good(flown, path)
        arrays[name] = change(arrays[name])
        array_file.save(path, STATE, arrays)

    return spoil


def without_one(flown: PoseEstimator, path: Path) -> None:
    arrays = good(flown, path)
    del arrays["q_nb"]
    array_file.save(path, STATE, arrays)


SPOILED = {
    "empty": (lambda flown, path: path.touch(), "is not a state"),
    "text": (lambda flown, path: path.write_text("home: 47.4"), "is not a state"),
    "folder": (lambda flown, path: path.mkdir(), "cannot read"),
    "truncated": (truncated, "damaged"),
    "flipped": (flipped, "damaged"),
    "model": (of_another_kind, "is not a state"),
    "newer": (newer, "version 2"),
    "missing": (without_one, "q_nb is missing"),
    "shape": (with_change("cov", lambda cov: cov[:3]), "cov is missing, or has"),
    "kind": (with_change("velocity", lambda v: np.array(["a", "b", "c"])), "velocity is missing, or has"),
    "nan": (with_change("position", lambda p: p * np.nan), "beyond what a vehicle can do"),
    "far": (with_change("position", lambda p: p * 100.0), "beyond what a vehicle can do"),
    "fast": (with_change("velocity", lambda v: v + 1e4), "beyond what a vehicle can do"),
    "turned": (with_change("q_nb", lambda q: 2.0 * q), "beyond what a vehicle can do"),
    "sure": (with_change("cov", lambda cov: 0.0 * cov), "beyond what a vehicle can do"),
    "indefinite": (with_change("cov", lambda cov: -cov), "beyond what a vehicle can do"),
    "biased": (with_change("gyro_bias", lambda b: b + 3.0), "beyond what a vehicle can do"),
    "noisy": (with_change("imu_variance", lambda v: v * np.inf), "beyond what a vehicle can do"),
}


@pytest.mark.parametrize("how", SPOILED)
def test_a_file_that_is_no_state_is_one_sentence_and_a_cold_start(flown, tmp_path, how):
    """GIVEN a file that is damaged, foreign, newer or impossible WHEN a node starts THEN it says so in one sentence,
    and its estimator is as if there were no file."""
    spoil, word = SPOILED[how]
    path, engine, node = tmp_path / "drone.state", estimator(), Node()
    spoil(flown, path)
    keeper_of(path, engine, node)
    assert engine.sins.resume is None
    ((name, text),) = node.said
    assert name == "resume.refused.file"
    assert word in text
    assert "\n" not in text


def test_a_state_that_cannot_be_written_is_told_once(flown, tmp_path):
    """GIVEN a path that is a folder by now WHEN the state is due THEN there is one warning, and the next success and
    failure are told again."""
    node, path = Node(), tmp_path / "drone.state"
    keeper = keeper_of(path, flown, node, period=0.1)
    (path / "inside").mkdir(parents=True)
    for i in range(20):
        keeper.note(1_700_000_000_000_000_000 + i * 100_000_000)
        keeper.wait()
    assert [name for name, _ in node.said] == ["resume.none", "state.not_written"]
    assert "cannot write the state" in node.said[1][1]


def test_a_folder_that_does_not_exist_is_found_at_the_start(flown, tmp_path):
    with pytest.raises(ParameterError, match="there is no folder"):
        keeper_of(tmp_path / "nowhere" / "drone.state", flown)


def test_a_file_that_does_not_exist_yet_is_told(tmp_path):
    """GIVEN ros.state.file that nobody has written WHEN a node starts THEN one sentence says what that means."""
    engine, node = estimator(), Node()
    keeper_of(tmp_path / "drone.state", engine, node).stop()
    ((name, text),) = node.said
    assert name == "resume.none"
    assert "there is no saved state yet" in text
    assert engine.sins.resume is None


def test_without_a_file_nothing_happens(flown):
    keeper = StateKeeper(Node(), flown, StateParameters())
    keeper.note(1)
    keeper.stop()
    assert flown.sins.resume is None


def test_before_the_navigator_runs_the_last_state_stays(flown, tmp_path):
    """GIVEN a node that has not aligned yet WHEN it is stopped THEN the state of the flight before is still there."""
    path = tmp_path / "drone.state"
    good(flown, path)
    content = path.read_bytes()
    keeper = keeper_of(path, estimator())
    keeper.note(1_700_000_000_000_000_000)
    keeper.stop()
    assert path.read_bytes() == content


def test_a_snapshot_of_a_resumed_estimator_is_the_same_estimator(flown, tmp_path):
    """GIVEN an estimator that goes on from a file WHEN it is copied THEN both compute the same."""
    arrays, recording = resumption.arrays_of(flown), flight("multirotor_light", 30.0)
    assert arrays is not None
    engine = estimator()
    resumption.resume(engine, arrays)
    twin = estimator()
    twin.restore(engine.snapshot())
    limit = recording.start_ns + 24 * 10**9
    rows = []
    for one in (engine, twin):
        later = [s for s in recording.samples() if isinstance(s, ImuBlock) and s.stamps_ns[0] > limit]
        outputs = [output for sample in later for output in one.feed(sample)]
        rows.append(np.concatenate([o.rows for o in outputs if isinstance(o, NavBlock)]))
    np.testing.assert_array_equal(*rows)
    assert len(rows[0]) > 100
