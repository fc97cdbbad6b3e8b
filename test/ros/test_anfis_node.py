"""anfis_node: what it is fed through topics, what it predicts in an outage, and the navigator that listens to it."""

import errno
import os
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import TwistWithCovarianceStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Bool

from fake_learner import StillAir
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel
from nav_pose_estimator.core.motion.epochs import ATTITUDE, BODY_VELOCITY, COLUMNS, PERIOD, TIME
from nav_pose_estimator.core.numerics.rotation import quat_from_rotvec
from nav_pose_estimator.engine.outage.methods.anfis import NetworkTraining
from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.engine.solutions import Mode, NavSolution, PredictedDrift
from nav_pose_estimator.nodes.anfis_node import AnfisNode
from nav_pose_estimator.nodes.sins_node import SinsNode
from nav_pose_estimator.ros.messages import convert
from nav_pose_estimator.ros.messages import outgoing as messages
from nav_pose_estimator.ros.messages.sample_messages import TOPICS, to_message
from nav_pose_estimator.sim.scenarios import generate

STAMP = 1_700_000_000_000_000_000


class Around:
    """The topics around the node, by hand: messages go to its callbacks, what it publishes is kept."""

    def __init__(self, node: AnfisNode) -> None:
        self.node, self.engine = node, node.engine
        self.callbacks = {s.topic_name: s.callback for s in node.subscriptions}
        self.seen: list[NavSolution] = []
        self.velocity, self.position = [], []
        node._output._velocity = SimpleNamespace(publish=lambda m: self.velocity.append(convert.velocity_error(m)[0]))
        node._output._position = SimpleNamespace(publish=lambda m: self.position.append(convert.vector(m.vector)))
        watched = node.engine.watch.odometry
        node.engine.watch.odometry = lambda s: self.note(watched(s))

    def note(self, solution: NavSolution | None) -> NavSolution | None:
        self.seen += [] if solution is None else [solution]
        return solution

    def odometry(self, solution: NavSolution) -> None:
        message = Odometry()
        messages.fill_odometry(message, solution)
        self.callbacks["/odometry/filtered"](serialize_message(message))

    def facts(self, denied: bool, accel=(0.0, 0.0, 0.0)) -> None:
        message = NavSatFix()
        messages.fill_origin(message, STAMP, (0.8, 0.1, 500.0))
        self.callbacks["/sins_node/origin"](message)
        for name, values in (("gyro", (0.0, 0.0, 0.0)), ("accel", accel)):
            bias = Vector3Stamped()
            messages.fill_vector_stamped(bias, STAMP, np.array(values))
            self.callbacks[f"/sins_node/bias/{name}"](bias)
        self.callbacks["/gnss/denied"](Bool(data=denied))

    def fly(self, seconds: float, begin: int = STAMP, rate: int = 50) -> None:
        for i in range(1, round(seconds * rate) + 1):
            stamp = begin + i * 10**9 // rate
            for at in (stamp - 10**7, stamp):
                sample = ImuSample(at, (0.0, 0.0, 1e-4 * (i % 7)), (0.1, 0.0, 9.8))
                self.callbacks["/imu/data_raw"](serialize_message(to_message(sample)))
            self.odometry(solution(stamp))


def solution(stamp: int = STAMP) -> NavSolution:
    factor = np.random.default_rng(3).normal(size=(15, 15)) * 0.01
    return NavSolution.of(
        stamp_ns=stamp,
        mode=Mode.AIDED,
        lat=0.8,
        lon=0.1,
        alt=500.0,
        vel_n=np.array([3.0, -2.0, 0.5]),
        q_nb=quat_from_rotvec(np.array([0.1, -0.2, 1.3])),
        rate_b=np.array([0.01, 0.02, 0.03]),
        force_b=np.zeros(3),
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        cov=factor @ factor.T + 1e-4 * np.eye(15),
        position_enu=np.array([10.0, -20.0, 30.0]),
        correction_enu=np.zeros(3),
        reset_count=0,
    )


@pytest.fixture
def around(started) -> Around:
    return Around(started(AnfisNode))


def test_the_learner_gets_the_navigators_solution_back_from_its_topics(around):
    around.facts(denied=False, accel=(0.05, 0.0, -0.1))
    around.fly(0.1)
    seen, sent = around.seen[-1], solution()
    assert seen.mode is Mode.AIDED
    for name in ("vel_n", "q_nb", "rate_b", "position_enu"):
        np.testing.assert_allclose(getattr(seen, name), getattr(sent, name), atol=1e-9, err_msg=name)
    np.testing.assert_allclose(seen.force_b, [0.05, 0.0, 9.9], atol=1e-12)
    for rows, columns in ((slice(3), slice(3)), (slice(6, 9), slice(6, 9)), (slice(6, 9), slice(3))):
        np.testing.assert_allclose(seen.cov[rows, columns], sent.cov[rows, columns], atol=1e-12)
    assert 6_390_000.0 * (seen.lat - 0.8) == pytest.approx(-20.0, abs=0.2)
    around.facts(denied=True)
    around.fly(0.1, STAMP + 10**9)
    assert around.seen[-1].mode is Mode.DEAD_RECKONING


def test_until_all_is_known_the_node_says_what_is_missing(around):
    status = around.engine.status
    around.fly(0.1)
    assert around.seen == []
    assert around.node.describe(status())[:2] == (1, "WAITING_IMU: waiting for the origin of the navigator")
    around.facts(denied=False)
    around.fly(2.0, STAMP + 10**9)
    level, sentence, facts = around.node.describe(status())
    assert level == 0
    assert sentence.startswith("ALIGNING: only ")
    assert dict(facts)["not used because"] == around.engine.learner.state.reason
    assert dict(facts)["training"] == "-"


def test_in_an_outage_the_predicted_error_is_published_and_summed_up(around):
    """GIVEN a model of a vehicle at rest in still air WHEN GNSS is lost THEN all of the velocity is an error."""
    around.facts(denied=False)
    around.fly(5.0)
    around.engine.learner.state.model = StillAir()
    assert around.velocity == []
    for begin in (5, 20):
        around.facts(denied=True)
        around.fly(10.0, STAMP + begin * 10**9)
        assert around.velocity[-1].dv_n == pytest.approx((3.0, -2.0, 0.5))
        assert around.position[-1] == pytest.approx((30.0, -20.0, 5.0), abs=2.0), "summed up anew in each outage"
        around.facts(denied=False)
        around.fly(5.0, STAMP + (begin + 10) * 10**9)
    assert len(around.velocity) == pytest.approx(40, abs=2)
    assert np.trace(around.velocity[-1].cov) == pytest.approx(0.29)
    assert around.engine.mode is Mode.AIDED


def test_without_a_model_an_outage_is_counted_not_guessed(around):
    around.facts(denied=True)
    around.fly(3.0)
    assert around.velocity == []
    assert around.node.logbook.counters["outage.no_model"] > 3


def test_enough_flight_starts_a_training_in_another_process(around):
    around.facts(denied=False)
    around.fly(45.0, rate=20)
    assert around.node.model_keeper.training == "running"
    assert {"~/train", "~/save_model", "~/load_model", "~/reset"} <= {s.srv_name for s in around.node.services}


def test_a_second_lap_resets_the_learner_once_and_keeps_the_model(around):
    around.facts(denied=False)
    around.fly(3.0)
    around.engine.learner.state.model = model = StillAir()
    around.fly(1.0)
    assert around.node.logbook.counters["outage.reset"] == 1
    assert around.engine.learner.state.model is model
    assert around.engine.watch.waiting_for == ""


def test_a_full_disk_keeps_the_last_good_model_and_the_node_in_the_air(started, tmp_path, monkeypatch, capfd):
    """GIVEN a node that has saved its model WHEN the disk is full THEN one sentence, the old file, and it flies on."""
    file = tmp_path / "drone.model"
    around = Around(started(AnfisNode, "-p", f"ros.model.file:={file}"))
    around.facts(denied=False)
    around.fly(5.0)
    keeper = around.node.model_keeper
    around.engine.learner.state.model = trained_model()
    assert keeper.attempt(keeper.save) == (True, f"the model was saved to {file}")
    before = file.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    capfd.readouterr()
    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", full)
        for _ in range(3):
            assert keeper.attempt(keeper.save) == (False, f"cannot write the model {file}: No space left on device")
    assert capfd.readouterr().err.count("No space left on device") == 1
    assert around.node.logbook.counters["outage.request_failed"] == 3
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file], "nothing half written is left"
    assert keeper.attempt(keeper.load) == (True, f"the model was loaded from {file}")
    around.facts(denied=True)
    around.fly(5.0, STAMP + 40 * 10**9)
    assert len(around.velocity) > 5
    assert keeper.attempt(keeper.save) == (True, f"the model was saved to {file}")


def trained_model() -> AirVelocityModel:
    """A model of a flight that was never flown, but one that can be saved."""
    epochs = np.random.default_rng(0).normal(size=(120, COLUMNS))
    epochs[:, TIME] = np.arange(120) * PERIOD
    epochs[:, ATTITUDE:BODY_VELOCITY] = np.eye(3).ravel()
    return NetworkTraining(epochs, (1,)).run().model


def test_odometry_without_covariance_is_refused_by_name(around):
    around.facts(denied=False)
    message = Odometry()
    messages.fill_odometry(message, solution())
    message.twist.covariance[:] = np.zeros(36)
    around.callbacks["/odometry/filtered"](serialize_message(message))
    assert around.seen == []
    assert around.node.logbook.counters["odometry.rejected.incomplete"] == 1


# --- the navigator's side ------------------------------------------------------------------------------------------
def error(stamp: int = STAMP, dv_n=(1.5, -0.25, 0.1)) -> PredictedDrift:
    return PredictedDrift(
        stamp, dv_n, np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.16]]), (1.0, 2.0, 3.0)
    )


def test_a_prediction_goes_through_its_message_unchanged():
    message = TwistWithCovarianceStamped()
    messages.fill_velocity_error(message, error())
    (back,) = convert.velocity_error(message)
    assert (back.stamp_ns, back.dv_n) == (STAMP, (1.5, -0.25, 0.1))
    np.testing.assert_array_equal(back.cov, error().cov)
    message.twist.covariance[:] = np.zeros(36)
    assert convert.velocity_error(message)[0].name == "outage.rejected.covariance"


def test_the_navigator_alone_listens_to_predictions_in_an_outage(started):
    """GIVEN sins_node WHEN GNSS is lost and predictions come THEN it goes by them and by the flight so far."""
    node = started(SinsNode)
    callbacks = {s.topic_name: s.callback for s in node.subscriptions}
    flight = generate("laps", duration=100.0, seed=2, imu_rate=50.0)
    for sample in flight.samples(blocks=False):
        message = to_message(sample)
        data = serialize_message(message) if isinstance(sample, ImuSample) else message
        callbacks[f"/{TOPICS[type(sample)][0]}"](data)
        if isinstance(sample, ImuSample) and sample.stamp_ns - flight.start_ns > 90 * 10**9:
            node.engine.set_use_gnss(False)
            prediction = TwistWithCovarianceStamped()
            messages.fill_velocity_error(prediction, error(sample.stamp_ns, (0.1, 0.2, 0.0)))
            callbacks["/outage/velocity_error"](prediction)
    assert node.engine.mode is Mode.COASTING
    counters = node.engine.status().counters
    assert counters["outage.evidence"] == counters["outage.evidence.network"] > 10
    aid = node.engine.outage_aid
    assert aid.learner.state.model is None, "training is the work of anfis_node"
    (evidence,) = aid.guide.advise(sample.stamp_ns, aid._pilot.state.collector.recent, aid.state.external).samples
    C_nb, velocity = evidence.attitude, np.array(evidence.velocity)
    np.testing.assert_allclose(C_nb @ np.array(evidence.air_velocity), velocity - [0.1, 0.2, 0.0], atol=0.05)
