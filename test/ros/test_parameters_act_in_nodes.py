"""Parameters of what only nodes have: each is changed, and something else must be seen outside."""

import importlib
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from driver_types import make
from fake_learner import Job, Pupil
from nav_pose_estimator.core.attitude.layout import HEAD_SIZE
from nav_pose_estimator.engine import array_file
from nav_pose_estimator.engine.composed import resumption
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.ros import ModelParameters
from nav_pose_estimator.engine.parameters.schema import flatten, update
from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.engine.solutions import AttitudeSolution, Mode, NavSolution, Status
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.ros import inputs, qos
from nav_pose_estimator.ros.autopilot import link
from nav_pose_estimator.ros.continuation.state_keeper import StateKeeper
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.load.inbox import Arrival
from nav_pose_estimator.ros.load.input_watch import InputWatch
from nav_pose_estimator.ros.messages import installed
from nav_pose_estimator.ros.model_keeper import ModelKeeper
from nav_pose_estimator.ros.outputs import AttitudeOutput, NavigationOutput
from nav_pose_estimator.ros.training import Trainer
from parameter_changes import CHANGES, OF_NODES, READ
from ros_processes import wait_until

START = 1_700_000_000_000_000_000
STEP = 5_000_000  # ns
Observe = Callable[[Parameters], Any]


class NoEngine:
    """Takes everything, and remembers why it was reset."""

    mode = Mode.WAITING_IMU
    origin = None

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self.resets: list[str] = []

    def warm_up(self) -> None:
        pass

    def feed(self, sample: Any) -> list:
        return []

    def status(self) -> Status:
        nan = float("nan")
        return Status(0, self.mode, "", 0.0, nan, nan, "", None, {}, {})

    def reset(self, stamp_ns: int, reason: str) -> list:
        self.resets.append(reason)
        return []


@pytest.fixture
def published(monkeypatch) -> Observe:
    """What two seconds of solutions at 200 Hz lead to: messages by topic, frames, the last twist and orientation."""

    def observe(parameters: Parameters) -> Any:
        heard: dict[str, list] = {}

        def advertise(node, kind, topic, profile=None):
            messages = heard.setdefault(topic, [])
            return SimpleNamespace(publish=messages.append, get_subscription_count=lambda: 1)

        monkeypatch.setattr(qos, "advertise", advertise)
        monkeypatch.setattr(installed, "message_class", lambda *_: lambda transforms: transforms[0])
        navigation, attitude = NavigationOutput(None, parameters), AttitudeOutput(None, parameters)
        navigation.publish_origin(START, (0.8, 0.1, 500.0))
        for i in range(400):
            navigation.publish(solution(START + i * STEP))
            attitude.publish(tilted(START + i * STEP))
        frames = {
            topic: [len(messages), getattr(getattr(messages[-1], "header", None), "frame_id", "")]
            for topic, messages in heard.items()
        }
        odometry = heard["odometry/filtered"][-1]
        return frames, odometry.child_frame_id, str(odometry.twist), str(heard["imu/data"][-1].orientation)

    return observe


def solution(stamp_ns: int, mode: Mode = Mode.AIDED) -> NavSolution:
    """At rest, to which a correction at the half brings it."""
    zero = np.zeros(3)
    moving = np.full(3, 3.0 if stamp_ns < START + 200 * STEP else 0.0)
    return NavSolution.of(
        stamp_ns=stamp_ns,
        mode=mode,
        lat=0.8,
        lon=0.1,
        alt=500.0,
        vel_n=moving,
        q_nb=np.array([1.0, 0.0, 0.0, 0.0]),
        rate_b=zero,
        force_b=np.array([0.0, 0.0, 9.80665]),
        gyro_bias=zero,
        accel_bias=zero,
        cov=np.eye(15),
        position_enu=zero,
        correction_enu=zero,
        reset_count=0,
    )


def tilted(stamp_ns: int) -> AttitudeSolution:
    result = AttitudeSolution(stamp_ns, np.zeros(HEAD_SIZE))
    result.q_nb[:] = 0.5
    return result


@pytest.fixture
def node_of(started) -> Callable[[Parameters], EstimatorNode]:
    """A node of these parameters around no engine, one at a time."""

    def make(parameters: Parameters) -> EstimatorNode:
        changed = {k: v for k, v in flatten(parameters).items() if v != flatten(Parameters())[k]}
        importlib.import_module("rclpy").try_shutdown()
        arguments = [word for key, value in changed.items() for word in ("-p", f"{key}:={value}")]
        return started(lambda: EstimatorNode("some_node", NoEngine), *arguments)

    return make


@pytest.fixture
def queue(node_of) -> Observe:
    def observe(parameters: Parameters) -> int:
        node = node_of(parameters)
        node.listen(inputs.imu(parameters))
        (subscription,) = (s for s in node.subscriptions if s.topic_name == "/imu/data_raw")
        return subscription.qos_profile.depth

    return observe


@pytest.fixture
def diagnostics(node_of) -> Observe:
    return lambda parameters: [timer.timer_period_ns for timer in node_of(parameters).timers]


@pytest.fixture
def relief(node_of) -> Observe:
    """The step that is in force when a message has waited for a second."""

    def observe(parameters: Parameters) -> int:
        node = node_of(parameters)
        intake, watch = node.intake, InputWatch(node, "imu/data_raw", False)
        intake._inbox._waiting.append(Arrival(time.time_ns() - 10**9, watch, lambda message: (), None))
        intake.catch_up()
        return intake.overload.step

    return observe


@pytest.fixture
def regression(node_of) -> Observe:
    """Whether IMU stamps that go back by two seconds are a new run."""

    def observe(parameters: Parameters) -> list[str]:
        node = node_of(parameters)
        for first in (START, START - 2 * 10**9):
            for stamp in range(first, first + 10 * STEP, STEP):
                node.take(ImuSample(stamp, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)))
        return node.engine.resets

    return observe


@pytest.fixture
def model_file(tmp_path) -> Observe:
    """Whether there is a place for the model."""

    def observe(parameters: Parameters) -> bool:
        name = parameters.ros.model.file
        keeper = _keeper(ModelParameters(file=str(tmp_path / name) if name else ""), [], Trainer())
        return keeper.attempt(keeper.save)[0]

    return observe


@pytest.fixture
def model_saved(tmp_path) -> Observe:
    """Whether a training leaves a file."""

    def observe(parameters: Parameters) -> bool:
        wants = parameters.ros.model.save_after_training
        file, said, trainer = tmp_path / f"model_{wants}", [], Trainer()
        keeper = _keeper(ModelParameters(file=str(file), save_after_training=wants), said, trainer)
        try:
            trainer.submit(Job(1))
            wait_until(lambda: keeper.look_after() or "outage.trained" in said)
        finally:
            keeper.stop()
        return file.exists()

    return observe


@pytest.fixture
def state_writes(tmp_path, monkeypatch) -> Observe:
    """How often four seconds of flight leave a state in the working folder."""
    monkeypatch.chdir(tmp_path)

    def observe(parameters: Parameters) -> int:
        written: list[Any] = []
        monkeypatch.setattr(array_file, "save", lambda *arguments, **more: written.append(arguments))
        monkeypatch.setattr(resumption, "arrays_of", lambda engine: {})
        wanted = parameters.ros.state
        keeper = StateKeeper(SimpleNamespace(say=print), SimpleNamespace(), wanted)
        for i in range(40):
            keeper.note(START + i * 100_000_000)
            keeper.wait()
        keeper.stop()
        return len(written)

    return observe


@pytest.fixture
def state_writes_to_a_file(state_writes) -> Observe:
    """The same where there is a file."""
    return lambda parameters: state_writes(update(parameters, {"ros.state.file": "drone.state"}))


@pytest.fixture
def sent_to_autopilot(monkeypatch) -> Observe:
    """What two seconds of solutions, first aided, then denied, lead to: messages and words by topic."""

    def observe(parameters: Parameters) -> Any:
        heard: dict[str, list] = {}

        def advertise(node, kind, topic, profile=None):
            publish = lambda message: heard.setdefault(topic, []).append(str(message))  # noqa: E731
            return SimpleNamespace(publish=publish, get_subscription_count=lambda: 1)

        monkeypatch.setattr(qos, "advertise", advertise)
        monkeypatch.setattr(link, "message_class", lambda name, word: partial(make, name))
        said: list[str] = []
        node = SimpleNamespace(resolve_topic_name=str, say=lambda name, level, text: said.append(name))
        output = link.autopilot_link(node, parameters)
        for i in range(400):
            output.publish(solution(START + i * STEP, Mode.AIDED if i < 200 else Mode.DEAD_RECKONING))
        return heard, said

    return observe


@pytest.fixture
def sent_to_mavros(sent_to_autopilot) -> Observe:
    return lambda parameters: sent_to_autopilot(update(parameters, {"ros.output.autopilot": "mavros"}))


@pytest.fixture
def sent_as_receiver(sent_to_autopilot) -> Observe:
    def observe(parameters: Parameters) -> Any:
        given = {"ros.output.autopilot": "mavros_gps"}
        if not parameters.ros.output.knows_geoid:
            given["ros.output.autopilot_geoid"] = -20.0
        return sent_to_autopilot(update(parameters, given))

    return observe


def _keeper(parameters: ModelParameters, said: list[str], trainer: Trainer) -> ModelKeeper:
    node = SimpleNamespace(create_timer=lambda *_, **__: None, create_service=lambda *_: None)
    return ModelKeeper(node, Pupil(), trainer, parameters, lambda name, *_: said.append(name))


OBSERVERS = {
    "ros.input.queue": "queue",
    "ros.input.relieve": "relief",
    "ros.input.max_stamp_regression": "regression",
    "ros.output.diagnostics_period": "diagnostics",
    "ros.output.autopilot": "sent_to_autopilot",
    "ros.output.autopilot_when": "sent_to_mavros",
    "ros.output.autopilot_rate": "sent_to_mavros",
    "ros.output.autopilot_dry_run": "sent_to_mavros",
    "ros.output.autopilot_geoid": "sent_as_receiver",
    "ros.output.autopilot_gps_id": "sent_as_receiver",
    "ros.state.file": "state_writes",
    "ros.state.period": "state_writes_to_a_file",
    "ros.model.file": "model_file",
    "ros.model.save_after_training": "model_saved",
}


@pytest.mark.parametrize("key", sorted(OF_NODES))
def test_a_changed_parameter_of_a_node_is_seen_outside(request, key):
    observe = request.getfixturevalue(OBSERVERS.get(key, "published"))
    changed = observe(update(Parameters(), {key: OF_NODES[key]}))
    assert changed != observe(Parameters())


def test_a_node_and_replay_take_the_same_parameters_from_a_file(started, tmp_path):
    """GIVEN a file in which every parameter has another value WHEN a node and replay read it THEN both have all."""
    values = {key: value for changes in (*CHANGES.values(), READ, OF_NODES) for key, value in changes.items()}
    lines = [f"    {key}: {written(value)}\n" for key, value in values.items()]
    file = tmp_path / "every.yaml"
    file.write_text("/**:\n  ros__parameters:\n" + "".join(lines))
    wanted = update(Parameters(), values)
    assert load_parameters(file) == wanted
    node = started(lambda: EstimatorNode("some_node", NoEngine), "--params-file", str(file))
    assert node.parameters == node.engine.parameters == wanted
    assert set(flatten(wanted).items()).isdisjoint(flatten(Parameters()).items())


def written(value: Any) -> str:
    """As YAML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(repr, value))}]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
