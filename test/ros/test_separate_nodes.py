"""attitude_node, sins_node and anfis_node as three processes over DDS: services in flight, an outage and the return."""

import math
from collections.abc import Callable

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, NavSatFix
from std_srvs.srv import SetBool, Trigger

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.ros.messages import convert
from nav_pose_estimator.sim.scenarios import HOME, START_NS
from ros_processes import Child, Observer

pytestmark = pytest.mark.compiled
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = QoSProfile(depth=1000)
FLIGHT, OUTAGE = 100.0, 40.0  # s
STORY = ("scenario:=stop_and_go", "imu:=mpu6000", "imu_rate:=50.0", "seed:=5", "duration:=1200.0", "truth_rate:=10.0")
INPUTS = ("imu/data_raw", "gps/fix", "gps/vel", "gps/satellites", "imu/mag", "baro", "odometry/filtered")


def parameters(*settings: str) -> list[str]:
    return [a for setting in settings for a in ("-p", setting)]


def reliable() -> list[str]:
    """A busy machine shall make the nodes late and not deaf: what is compared are the estimators."""
    return parameters(
        *(
            f"qos_overrides./{topic}.subscription.{setting}"
            for topic in INPUTS
            for setting in ("reliability:=reliable", "depth:=1000")
        )
    )


class Navigator:
    """A navigator over ground, seen from outside: its counters, and how far from the truth it is."""

    def __init__(self, observer: Observer, name: str) -> None:
        self.name, self._observer = name, observer
        self.poses = observer.listen(PoseWithCovarianceStamped, f"/{name}/pose", DEEP)
        self._origin = observer.listen(NavSatFix, f"/{name}/origin", LATCHED)
        self._status = observer.listen(DiagnosticStatus, f"/{name}/status", LATCHED)

    @property
    def mode(self) -> str:
        return self._status[-1].message.split(":")[0] if self._status else ""

    @property
    def newest(self) -> float:
        """Stamp of the newest pose [s]."""
        return convert.stamp_ns(self.poses[-1]) * 1e-9 if self.poses else -math.inf

    def use_gnss(self, flag: bool) -> None:
        assert self._observer.call(SetBool, f"/{self.name}/use_gnss", SetBool.Request(data=flag)).success

    def off(self, stamp_ns: int, truth: tuple[float, float, float]) -> float:
        """Horizontal error [m] of the pose at ``stamp_ns``."""
        (pose,) = (p.pose.pose.position for p in self.poses if convert.stamp_ns(p) == stamp_ns)
        fix = self._origin[-1]
        east, north, _ = lla_to_enu(math.radians(fix.latitude), math.radians(fix.longitude), fix.altitude, *HOME)
        return math.hypot(pose.x + east - truth[0], pose.y + north - truth[1])


@pytest.fixture
def counters(observer: Observer) -> Callable[[str, str], int]:
    """``counters(node, name)``: that counter on the newest diagnostics of that node."""
    arrays = observer.listen(DiagnosticArray, "/diagnostics")

    def read(node: str, name: str) -> int:
        for array in reversed(arrays):
            for status in array.status:
                if status.name == f"{node}: counters":
                    return next((int(pair.value) for pair in status.values if pair.key == name), 0)
        return 0

    return read


def ask(observer: Observer, service: str) -> Trigger.Response:
    return observer.call(Trigger, f"/anfis_node/{service}", Trigger.Request())


def test_three_nodes_through_an_outage_and_back(launch, observer, counters, tmp_path) -> None:
    """GIVEN three nodes that have learned in flight, and a navigator that only coasts
    WHEN GNSS is taken from both navigators THEN the prediction of anfis_node is used, the pose is nearer to the truth
    than coasting in the same flight, and GNSS is taken back; before that train, save_model and load_model work."""
    file = tmp_path / "drone.model"
    nodes = fly(launch, file)
    sins, coasting = Navigator(observer, "sins_node"), Navigator(observer, "coasting")
    truth = observer.listen(Odometry, "/ground_truth/odom", DEEP)
    attitude = observer.listen(Imu, "/imu/data")
    predictions = observer.listen(TwistWithCovarianceStamped, "/outage/velocity_error", DEEP)
    learner = observer.listen(DiagnosticStatus, "/anfis_node/status", LATCHED)

    observer.until(lambda: sins.mode == coasting.mode == "AIDED", "AIDED")
    observer.until(lambda: attitude, "the attitude")
    observer.until(lambda: sins.newest > START_NS * 1e-9 + FLIGHT, f"{FLIGHT:.0f} s of flight")
    before = counters("anfis_node", "outage.trained")
    observer.until(lambda: ask(observer, "train").success, "a training on request")
    observer.until(lambda: counters("anfis_node", "outage.trained") > before, "the end of a training")
    observer.until(lambda: learner and learner[-1].message.startswith("AIDED"), "a model")
    # a training in between may find that its network explains nothing, and then there is no model to save
    observer.until(lambda: ask(observer, "save_model").message == f"the model was saved to {file}", "a saved model")
    answer = ask(observer, "load_model")
    assert (answer.success, answer.message) == (True, f"the model was loaded from {file}")

    for navigator in (sins, coasting):
        navigator.poses.clear()
        navigator.use_gnss(False)
    observer.until(lambda: sins.poses and coasting.poses, "poses")
    begin = max(sins.newest, coasting.newest)
    observer.until(lambda: min(sins.newest, coasting.newest) > begin + OUTAGE, f"an outage of {OUTAGE:.0f} s")
    assert sins.mode == "COASTING"
    both = {convert.stamp_ns(p) for p in sins.poses} & {convert.stamp_ns(p) for p in coasting.poses}
    known = {convert.stamp_ns(m): convert.vector(m.pose.pose.position) for m in truth}
    compared = sorted(s for s in both & known.keys() if s * 1e-9 > begin + 0.5 * OUTAGE)
    assert len(compared) > 5
    errors = [(sins.off(stamp, known[stamp]), coasting.off(stamp, known[stamp])) for stamp in compared]
    assert sum(e for e, _ in errors) < sum(e for _, e in errors), errors
    assert len(predictions) > OUTAGE
    assert counters("sins_node", "outage.evidence.network") > OUTAGE
    assert counters("coasting", "outage.evidence") == 0

    for navigator in (sins, coasting):
        navigator.use_gnss(True)
    observer.until(lambda: sins.mode == coasting.mode == "AIDED", "AIDED again")
    for node in nodes:
        assert node.stop() == 0, node.text()
        assert "Traceback" not in node.text()


def fly(launch: Callable[..., Child], model_file: object) -> list[Child]:
    """Three nodes, and one that coasts on the same sensors; then the flight begins."""
    apart = ("odometry/filtered", "gps/filtered", "gnss/denied", "outage/velocity_error")
    aside = ["-r", "__node:=coasting"] + [a for topic in apart for a in ("-r", f"{topic}:=coasting/{topic}")]
    diagnostics = parameters("ros.output.diagnostics_period:=0.2")
    nodes = [
        launch("attitude_node", *reliable(), *diagnostics),
        launch("sins_node", *reliable(), *diagnostics),
        launch("sins_node", *reliable(), *diagnostics, *parameters("learner.method:=coast"), *aside),
        launch("anfis_node", *reliable(), *diagnostics, *parameters(f"ros.model.file:={model_file}")),
    ]
    for node in nodes:
        node.wait_for("ready")
    launch("synthetic_sensors", *parameters(*STORY, "sim_time:=true", "speed:=2.0"))
    return nodes
