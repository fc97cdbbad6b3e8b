"""What leaves a node beside odometry: transforms where they are wanted, latched facts, rates by stamps."""

import importlib
from types import SimpleNamespace

import numpy as np
import pytest

from nav_pose_estimator.core.attitude.layout import HEAD_SIZE
from nav_pose_estimator.core.numerics.rotation import quat_from_rotvec
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, update
from nav_pose_estimator.engine.solutions import AttitudeSolution, Mode, NavSolution
from nav_pose_estimator.nodes.sins_node import SinsNode
from nav_pose_estimator.ros import qos
from nav_pose_estimator.ros.messages import installed
from nav_pose_estimator.ros.outputs import AttitudeOutput, NavigationOutput

STAMP = 1_700_000_000_000_000_000


def solution(stamp_ns: int = STAMP, mode: Mode = Mode.AIDED) -> NavSolution:
    zero = np.zeros(3)
    return NavSolution.of(
        stamp_ns=stamp_ns,
        mode=mode,
        lat=0.8,
        lon=0.1,
        alt=500.0,
        vel_n=np.array([1.0, 2.0, 0.0]),
        q_nb=quat_from_rotvec(np.array([0.1, -0.2, 1.3])),
        rate_b=zero,
        force_b=zero,
        gyro_bias=zero,
        accel_bias=zero,
        cov=np.eye(15),
        position_enu=np.array([10.0, -20.0, 30.0]),
        correction_enu=np.array([3.0, 4.0, -5.0]),
        reset_count=1,
    )


class Heard(dict):
    """Stands where publishers are made: topic -> messages; ``listeners`` is 1 for each unless said otherwise."""

    def __init__(self) -> None:
        super().__init__()
        self.listeners: dict[str, int] = {}

    def advertise(self, node, kind, topic, profile=None):
        messages = self.setdefault(topic, [])
        return SimpleNamespace(publish=messages.append, get_subscription_count=lambda: self.listeners.get(topic, 1))


@pytest.fixture
def heard(monkeypatch) -> Heard:
    heard = Heard()
    monkeypatch.setattr(qos, "advertise", heard.advertise)
    return heard


def test_transforms_chain_to_the_pose_in_map(heard, monkeypatch):
    """GIVEN publish_tf and tf2_msgs WHEN a solution comes THEN map -> odom -> base_link give its position."""
    kinds = {"tf2_msgs/msg/TFMessage": lambda transforms: SimpleNamespace(transforms=transforms)}
    monkeypatch.setattr(installed, "message_class", lambda name, *_: kinds[name])
    names = {"map": "world", "odom": "odom", "base_link": "drone", "publish_tf": True}
    parameters = update(Parameters(), {f"ros.frames.{key}": value for key, value in names.items()})
    output = NavigationOutput(None, parameters)
    output.publish(solution())
    (jumps, motion) = heard["/tf"][-1].transforms
    assert (jumps.header.frame_id, jumps.child_frame_id) == ("world", "odom")
    assert (motion.header.frame_id, motion.child_frame_id) == ("odom", "drone")
    a, b = jumps.transform.translation, motion.transform.translation
    np.testing.assert_allclose([a.x + b.x, a.y + b.y, a.z + b.z], solution().position_enu)
    np.testing.assert_allclose([a.x, a.y, a.z], solution().correction_enu)
    q = motion.transform.rotation
    np.testing.assert_allclose([q.w, q.x, q.y, q.z], solution().q_nb)
    assert jumps.transform.rotation.w == 1.0


def test_no_transforms_unless_asked_for(heard):
    NavigationOutput(None, Parameters()).publish(solution())
    assert "/tf" not in heard
    assert len(heard["odometry/filtered"]) == 1


def test_transforms_without_their_package_stop_the_node_with_the_cure(started):
    try:
        importlib.import_module("tf2_msgs.msg")
        pytest.skip("tf2_msgs is installed here")
    except ImportError:
        pass
    with pytest.raises(ParameterError, match="tf2_msgs is not installed here; install ros-jazzy-tf2-msgs"):
        started(SinsNode, "-p", "ros.frames.publish_tf:=true")


def test_denial_is_told_once_for_each_change(heard):
    output = NavigationOutput(None, Parameters())
    modes = (Mode.AIDED, Mode.AIDED, Mode.DEAD_RECKONING, Mode.COASTING, Mode.REACQUIRING, Mode.AIDED)
    for i, mode in enumerate(modes):
        output.publish(solution(STAMP + i * 10_000_000, mode))
    assert [message.data for message in heard["gnss/denied"]] == [False, True, False]


def test_nothing_is_made_for_nobody_but_latched_facts(heard):
    output = NavigationOutput(None, Parameters())
    heard.listeners = dict.fromkeys(["odometry/filtered", "~/pose", "gps/filtered"], 0)
    output.publish(solution())
    output.publish_origin(STAMP, (0.8, 0.1, 500.0))
    assert [topic for topic in heard.listeners if heard[topic]] == []
    assert len(heard["gnss/denied"]) == len(heard["~/origin"]) == 1


@pytest.mark.parametrize("rate", [100, 400])
def test_rate_and_force_of_imu_data_state_their_noise_and_bias(heard, rate):
    """GIVEN the noise densities of the IMU WHEN its samples are published THEN each states the variance of a mean over
    its interval, and of the bias that is left."""
    p = Parameters().imu
    output = AttitudeOutput(None, Parameters())
    for i in range(3):
        attitude = AttitudeSolution(STAMP + i * 10**9 // rate, np.zeros(HEAD_SIZE))
        attitude.q_nb[0] = 1.0
        output.publish(attitude)
    message = heard["imu/data"][-1]
    for given, noise, bias in (
        (message.angular_velocity_covariance, p.gyro_noise, p.gyro_bias_sd),
        (message.linear_acceleration_covariance, p.accel_noise, p.accel_bias_sd),
    ):
        np.testing.assert_allclose(given.reshape(3, 3), (noise**2 * rate + bias**2) * np.eye(3))


def test_rates_follow_the_stamps(heard):
    parameters = update(Parameters(), {"ros.output.odometry_rate": 50.0})
    output = NavigationOutput(None, parameters)
    for i in range(400):
        output.publish(solution(STAMP + i * 5_000_000))
    assert len(heard["odometry/filtered"]) == len(heard["~/pose"]) == 100
    assert len(heard["gps/filtered"]) == 10
    assert len(heard["~/bias/gyro"]) == len(heard["~/bias/accel"]) == 2
