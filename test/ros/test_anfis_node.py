"""anfis_node with a stand-in for the learner: what it is fed, what it publishes, models on disk, training beside it."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from fake_learner import FakeLearner, Job
from geometry_msgs.msg import TwistWithCovarianceStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from nav_pose_estimator.core.rotation import quat_from_rotvec
from nav_pose_estimator.engine.model_file import load_arrays, save_arrays
from nav_pose_estimator.engine.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.samples import ImuSample, VelocityError
from nav_pose_estimator.engine.solutions import Mode, NavSolution
from nav_pose_estimator.nodes.anfis_node import AnfisNode
from nav_pose_estimator.ros import convert, messages
from nav_pose_estimator.ros.sample_messages import to_message
from nav_pose_estimator.sim.scenarios import generate

from conftest import wait_until  # isort: skip

STAMP = 1_700_000_000_000_000_000


class Around:
    """The topics around the node, by hand: messages go to its callbacks, what it publishes is kept."""

    def __init__(self, node: AnfisNode) -> None:
        self.node, self.learner = node, node.engine.learner
        self.callbacks = {s.topic_name: s.callback for s in node.subscriptions}
        self.velocity, self.position = [], []
        publishers = {p.topic_name: p for p in node.publishers}
        node._output._velocity = SimpleNamespace(publish=lambda m: self.velocity.append(convert.velocity_error(m)[0]))
        node._output._position = SimpleNamespace(publish=lambda m: self.position.append(convert.vector(m.vector)))
        assert {"/outage/velocity_error", "/outage/position_error"} <= set(publishers)

    def imu(self, stamp: int, accel=(0.1, 0.0, 9.8)) -> None:
        self.callbacks["/imu/data_raw"](serialize_message(to_message(ImuSample(stamp, (0.0, 0.0, 1e-4), accel))))

    def odometry(self, solution: NavSolution) -> None:
        message = Odometry()
        messages.fill_odometry(message, solution)
        self.callbacks["/odometry/filtered"](serialize_message(message))

    def facts(self, denied: bool, gyro=(0.0, 0.0, 0.0), accel=(0.0, 0.0, 0.0), origin=(0.8, 0.1, 500.0)) -> None:
        message = NavSatFix()
        messages.fill_origin(message, STAMP, origin)
        self.callbacks["/sins_node/origin"](message)
        for name, values in (("gyro", gyro), ("accel", accel)):
            bias = Vector3Stamped()
            messages.fill_vector_stamped(bias, STAMP, np.array(values))
            self.callbacks[f"/sins_node/bias/{name}"](bias)
        self.callbacks["/gnss/denied"](Bool(data=denied))

    def fly(self, seconds: float, begin: int = STAMP, rate: int = 50) -> None:
        for i in range(1, round(seconds * rate) + 1):
            stamp = begin + i * 10**9 // rate
            self.imu(stamp - 10**7)
            self.imu(stamp)
            self.odometry(solution(stamp))

    def call(self, action) -> tuple[bool, str]:
        answer = self.node.keeper._serve(action, Trigger.Request(), Trigger.Response())
        return answer.success, answer.message

    def train(self) -> None:
        """Let the training timer run until the outcome has been taken."""
        keeper, counters = self.node.keeper, self.node.logbook.counters
        ended = ("outage.trained", "outage.training_failed")
        before = sum(counters[name] for name in ended)
        wait_until(lambda: keeper.look_after() or sum(counters[name] for name in ended) > before, what="the training")


def solution(stamp: int = STAMP) -> NavSolution:
    factor = np.random.default_rng(3).normal(size=(15, 15)) * 0.1
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
def make(started):
    return lambda *arguments: Around(started(lambda: AnfisNode(FakeLearner), *arguments))


def test_the_learner_gets_the_navigators_solution_back_from_its_topics(make):
    around = make()
    around.facts(denied=False, accel=(0.05, 0.0, -0.1))
    around.fly(0.1)
    seen, sent = around.learner.seen[-1], solution()
    assert seen.mode is Mode.AIDED
    for name in ("vel_n", "q_nb", "rate_b", "position_enu"):
        np.testing.assert_allclose(getattr(seen, name), getattr(sent, name), atol=1e-9, err_msg=name)
    np.testing.assert_allclose(seen.force_b, [0.05, 0.0, 9.9], atol=1e-12)
    np.testing.assert_allclose(seen.cov[:3, :3], sent.cov[:3, :3], atol=1e-12)
    np.testing.assert_allclose(seen.cov[6:9, 6:9], sent.cov[6:9, 6:9], atol=1e-12)
    np.testing.assert_allclose(seen.cov[6:9, :3], sent.cov[6:9, :3], atol=1e-12)
    north = 6_390_000.0 * (seen.lat - 0.8)
    assert north == pytest.approx(-20.0, abs=0.2)
    around.facts(denied=True)
    around.fly(0.1, STAMP + 10**9)
    assert around.learner.seen[-1].mode is Mode.DEAD_RECKONING


def test_until_all_is_known_the_node_says_what_is_missing(make):
    around = make()
    status = around.node.engine.status
    assert "origin" in status().waiting_for
    around.fly(0.1)
    assert around.learner.seen == []
    level, sentence, _ = around.node.describe(status())
    assert (level, sentence) == (1, "WAITING_IMU: waiting for the origin of the navigator")
    around.facts(denied=False)
    around.fly(0.1, STAMP + 10**9)
    level, sentence, facts = around.node.describe(status())
    assert (level, sentence) == (0, "ALIGNING: nothing has been learned yet")
    assert dict(facts)["not used because"] == "nothing has been learned yet"


def test_in_an_outage_the_predicted_error_is_published_and_summed_up(make):
    around = make()
    around.facts(denied=False)
    around.learner.weight = 2.0
    around.fly(1.0)
    assert around.velocity == []
    around.facts(denied=True)
    around.fly(10.0, STAMP + 10**9)
    assert len(around.velocity) == 500
    assert around.velocity[-1].dv_en == (2.0, -2.0)
    np.testing.assert_array_equal(around.velocity[-1].cov, np.diag([0.04, 0.09]))
    np.testing.assert_allclose(around.position[-1], [2.0 * 9.98, -2.0 * 9.98, 0.0])
    assert around.node.logbook.counters["outage.unsent.position"] == 500
    around.facts(denied=False)
    around.fly(1.0, STAMP + 11 * 10**9)
    around.facts(denied=True)
    around.fly(1.0, STAMP + 12 * 10**9)
    np.testing.assert_allclose(around.position[-1], [2.0 * 0.98, -2.0 * 0.98, 0.0])


def test_training_runs_beside_the_node_and_its_scores_make_a_curve(make):
    around = make()
    around.learner.jobs += [Job(3), Job(4)]
    around.facts(denied=False)
    around.fly(0.1)
    around.train()
    around.train()
    assert [number for number, _ in around.learner.results] == [3, 4]
    facts = dict(around.node.describe(around.node.engine.status())[2])
    assert facts["validation error after each training"] == "0.25, 0.2"
    assert facts["trainings"] == "2"
    assert around.node.engine.mode is Mode.AIDED


def test_a_failed_training_is_told_and_changes_nothing(make):
    around = make()
    around.learner.weight = 5.0
    around.learner.jobs.append(Job(1, "fails"))
    around.train()
    assert around.node.logbook.counters["outage.training_failed"] == 1
    facts = dict(around.node.describe(around.node.engine.status())[2])
    assert facts["training"] == "ZeroDivisionError: division by zero"
    assert around.learner.weight == 5.0


def test_the_services_answer_in_a_sentence(make, tmp_path):
    around = make()
    node = around.node
    assert around.call(node.keeper.train) == (
        False,
        "there is nothing to train on yet (nothing has been learned yet)",
    )
    assert around.call(node.keeper.save) == (False, "there is no file for the model: set ros.model.file")
    around.learner.jobs.append(Job(1, "hangs"))
    assert around.call(node.keeper.train)[0]
    assert around.call(node.keeper.train) == (False, "a training is running")
    assert {"~/train", "~/save_model", "~/load_model", "~/reset"} <= {service.srv_name for service in node.services}


def test_a_model_survives_the_node(make, tmp_path):
    """GIVEN a node that saves after each training WHEN another starts with its file THEN it begins with that model."""
    file = tmp_path / "drone.model"
    settings = ("-p", f"ros.model.file:={file}", "-p", "ros.model.save_after_training:=true")
    first = make(*settings)
    first.learner.jobs.append(Job(6))
    first.train()
    assert float(load_arrays(file)["weight"]) == 6.0
    second = Around(AnfisNode(FakeLearner))
    assert second.learner.weight == 6.0
    second.learner.weight = 1.0
    assert second.call(second.node.keeper.load)[0]
    assert second.learner.weight == 6.0
    second.learner.weight = 8.0
    assert second.call(second.node.keeper.save)[0]
    assert float(load_arrays(file)["weight"]) == 8.0
    second.node.destroy_node()


@pytest.mark.parametrize("content", ["garbage", "foreign"])
def test_a_bad_model_file_does_not_keep_the_node_from_flying(make, tmp_path, content):
    file = tmp_path / "drone.model"
    if content == "garbage":
        file.write_bytes(b"\x00" * 100)
    else:
        save_arrays(file, {"other": np.zeros(3)})
    around = make("-p", f"ros.model.file:={file}")
    assert around.node.logbook.counters["outage.request_failed"] == 1
    assert around.learner.weight == 0.0


def test_a_second_lap_resets_the_learner_once(make):
    around = make()
    around.facts(denied=False)
    around.fly(3.0)
    around.fly(1.0)
    assert around.node.logbook.counters["outage.reset"] == 1
    assert around.learner.seen[-1].stamp_ns == STAMP + 10**9


def test_odometry_without_covariance_is_refused_by_name(make):
    around = make()
    around.facts(denied=False)
    around.imu(STAMP)
    message = Odometry()
    messages.fill_odometry(message, solution())
    message.twist.covariance[:] = np.zeros(36)
    around.callbacks["/odometry/filtered"](serialize_message(message))
    assert around.learner.seen == []
    assert around.node.logbook.counters["odometry.rejected.incomplete"] == 1


# --- the navigator's side ------------------------------------------------------------------------------------------
def test_a_prediction_goes_through_its_message_unchanged():
    error = VelocityError(STAMP, (1.5, -0.25), np.array([[0.04, 0.01], [0.01, 0.09]]))
    message = TwistWithCovarianceStamped()
    messages.fill_velocity_error(message, error)
    (back,) = convert.velocity_error(message)
    assert (back.stamp_ns, back.dv_en) == (error.stamp_ns, error.dv_en)
    np.testing.assert_array_equal(back.cov, error.cov)
    message.twist.covariance[:] = np.zeros(36)
    assert convert.velocity_error(message)[0].name == "outage.rejected.covariance"


def test_the_navigator_uses_predictions_and_coasts():
    """GIVEN an outage WHEN predictions of no error come THEN the navigator is COASTING and its speed stays bounded."""
    flight, engine = generate("hover", duration=60.0, seed=2, imu_rate=50.0), PoseEstimator(attitude=False).sins
    for sample in flight.samples(blocks=False):
        engine.feed(sample)
        if sample.stamp_ns is not None and sample.stamp_ns - flight.start_ns > 40 * 10**9:
            engine.set_use_gnss(False)
            if isinstance(sample, ImuSample) and sample.stamp_ns % 500_000_000 < 20_000_000:
                speed = engine.nominal_state()[3:5]
                engine.feed(VelocityError(sample.stamp_ns, tuple(speed.tolist()), np.diag([0.25, 0.25])))
    assert engine.mode is Mode.COASTING
    assert math.hypot(*engine.nominal_state()[3:5]) < 1.0
    assert engine.status().counters["velocity_error.used"] > 10
