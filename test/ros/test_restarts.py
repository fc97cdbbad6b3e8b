"""Processes that die and come back, and a bag that is played in a loop, over DDS on this host."""

import math
import re
import signal
from collections.abc import Callable, Iterable

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool

from nav_pose_estimator.engine.samples import Sample
from nav_pose_estimator.ros.messages import convert
from nav_pose_estimator.ros.messages.sample_messages import TOPICS, to_message
from nav_pose_estimator.sim.scenarios import generate
from ros_processes import Observer

pytestmark = pytest.mark.compiled
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = QoSProfile(depth=1000)
SENSORS = ("duration:=600.0", "sim_time:=false", "imu_rate:=100.0", "seed:=4", "scenario:=hover")


def sensors(launch: Callable) -> object:
    return launch("synthetic_sensors", *(a for s in SENSORS for a in ("-p", s)))


@pytest.mark.parametrize(
    ("command", "topic", "kind"),
    [("attitude_node", "/imu/data", Imu), ("sins_node", "/odometry/filtered", Odometry)],
)
def test_a_node_that_is_killed_comes_back(launch, observer, command: str, topic: str, kind: type) -> None:
    """GIVEN a node at work WHEN it is killed and started again THEN it works again, without anybody else's help."""
    sensors(launch)
    node, heard = launch(command), observer.listen(kind, topic)
    observer.until(lambda: len(heard) > 10, f"{topic} before")
    assert node.stop(signal.SIGKILL) == -signal.SIGKILL
    before = len(heard)
    again = launch(command)
    again.wait_for("ready")
    observer.until(lambda: len(heard) > before + 10, f"{topic} after")
    assert convert.stamp_ns(heard[-1]) > convert.stamp_ns(heard[before - 1])
    assert again.stop(signal.SIGTERM) == 0, again.text()


def test_the_estimator_outlives_its_sensors(launch, observer) -> None:
    """GIVEN sensors and estimator in two processes WHEN the sensors are killed and come back with another clock
    THEN the estimator lives on, says that there was a gap, and estimates."""
    source, node = sensors(launch), launch("pose_estimator")
    heard, denied = observer.listen(Odometry, "/odometry/filtered"), observer.listen(Bool, "/gnss/denied", LATCHED)
    observer.until(lambda: len(heard) > 10, "odometry before")
    observer.until(lambda: denied and not denied[-1].data, "GNSS in use")
    assert source.stop(signal.SIGKILL) == -signal.SIGKILL
    before = len(heard)
    sensors(launch)
    observer.until(lambda: len(heard) > before + 10, "odometry after")
    assert node.process.poll() is None
    assert "no IMU data for" in node.text()
    assert "Traceback" not in node.text()
    assert node.stop(signal.SIGINT) == 0, node.text()


def test_pain_10_a_bag_in_a_loop_gives_the_same_lap_twice(launch, observer) -> None:
    """GIVEN a bag WHEN it is played twice in a loop THEN time goes back, one warning says so, and lap two ends as lap
    one (through the callbacks test_nodes.py compares bit for bit)."""
    topics = [TOPICS[kind][0] for kind in TOPICS]
    reliable = [
        f"qos_overrides./{topic}.subscription.{setting}"
        for topic in topics
        for setting in ("reliability:=reliable", "depth:=1000")
    ]
    rates = ("ros.output.odometry_rate:=0.0", "ros.output.diagnostics_period:=0.1")
    node = launch("sins_node", *(a for s in [*reliable, *rates] for a in ("-p", s)))
    node.wait_for("ready")
    poses = observer.listen(PoseWithCovarianceStamped, "/sins_node/pose", DEEP)
    player = Player(observer)
    flight = generate("multirotor_outage", 8.0, seed=2, imu_rate=50.0)
    end = int(flight.imu.stamps_ns[-1])
    laps = []
    for _ in range(2):
        player.play(flight.samples(blocks=False))
        observer.until(lambda: poses and convert.stamp_ns(poses[-1]) == end, "the lap's end")
        laps.append({convert.stamp_ns(pose): convert.vector(pose.pose.pose.position) for pose in poses})
        poses.clear()
    common = laps[0].keys() & laps[1].keys()
    assert len(common) > 100
    assert len(common) >= 0.9 * max(map(len, laps))
    # with which fix the alignment ends depends on which topic arrives first; what that changes fades within the lap
    last = [stamp for stamp in common if stamp > end - 10**9]
    assert max(math.dist(laps[0][stamp], laps[1][stamp]) for stamp in last) < 0.3
    assert node.text().count("time went back") == 1
    assert node.stop(signal.SIGTERM) == 0, node.text()


class Player:
    """Publishes samples in order, and no faster than a navigator takes them.

    A burst overflows the middleware on a busy machine: what it loses it sends again seconds later, and topics overtake
    each other. The same goes for what is sent before the node has found every publisher. Its diagnostics tell both.
    """

    _BLOCK = 40  # messages on their way at most

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._arrays = observer.listen(DiagnosticArray, "/diagnostics")
        self._publishers = {
            kind: observer.node.create_publisher(message, topic, DEEP) for kind, (topic, message) in TOPICS.items()
        }
        self._sent = 0
        self._observer.until(lambda: self._told(r"(\d+) publishers", min) == 1, "the node knows every publisher")

    def play(self, samples: Iterable[Sample]) -> None:
        """All ``samples``; returns when the node has seen the last one."""
        for sample in samples:
            self._publishers[type(sample)].publish(to_message(sample))
            self._sent += 1
            if self._sent % self._BLOCK == 0:
                self._wait()
        self._wait()

    def _wait(self) -> None:
        self._observer.until(lambda: self._told(r"(\d+) in all", sum) == self._sent, f"{self._sent} messages counted")

    def _told(self, pattern: str, combine: Callable[[Iterable[int]], int]) -> int:
        """One number of every input that is played, from the newest diagnostics of the node; -1: there are none."""
        facts = [s.values for array in self._arrays[-1:] for s in array.status if s.name.endswith("inputs")]
        played = {topic for topic, _ in TOPICS.values()}
        numbers = [int(re.search(pattern, pair.value)[1]) for values in facts for pair in values if pair.key in played]
        return combine(numbers) if numbers else -1
