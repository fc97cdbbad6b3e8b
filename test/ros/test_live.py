"""Nodes as processes, over DDS on this host: modes through an outage, latched facts, QoS, names, signals."""

import math
import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Pose, PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import FluidPressure, Imu, NavSatFix
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.engine.solutions import NavSolution
from nav_pose_estimator.ros.messages import convert
from nav_pose_estimator.ros.messages.sample_messages import to_message
from nav_pose_estimator.sim.scenarios import generate
from ros_processes import PATIENCE

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)

LATE = ("-p", "ros.input.relieve:=false")  # where the machine is busy, late with every pose rather than with few

pytestmark = pytest.mark.compiled


def mode_of(statuses: list[DiagnosticStatus]) -> str:
    return statuses[-1].message.split(":")[0] if statuses else ""


def test_an_outage_and_the_return_over_topics(launch, observer):
    """GIVEN a flight in simulated time, in a namespace and with a remapped topic
    WHEN GNSS is taken away and given back THEN modes, latched topics and accuracy follow, and odom never jumps."""
    name = "/drone/pose_estimator"
    status = observer.listen(DiagnosticStatus, f"{name}/status", LATCHED)
    odometry = observer.listen(Odometry, "/drone/odom")
    truth = observer.listen(Odometry, "/drone/ground_truth/odom")
    pose = observer.listen(PoseWithCovarianceStamped, f"{name}/pose")
    names = ("-r", "__ns:=/drone")
    estimator = launch("pose_estimator", *names, "-r", "odometry/filtered:=odom", "-p", "use_sim_time:=true", *LATE)
    estimator.wait_for("ready")
    story = ("scenario:=hover", "duration:=120.0", "sim_time:=true", "speed:=2.0", "imu_rate:=100.0", "seed:=4")
    sensors = launch("synthetic_sensors", *names, *(a for s in story for a in ("-p", s)))

    observer.until(lambda: mode_of(status) == "AIDED", "AIDED")
    answer = observer.call(SetBool, f"{name}/use_gnss", SetBool.Request(data=False))
    assert answer.success
    observer.until(lambda: mode_of(status) == "DEAD_RECKONING", "DEAD_RECKONING")
    assert "GNSS refused: " in status[-1].message
    late = observer.listen(Bool, "/drone/gnss/denied", LATCHED)
    observer.until(lambda: late and late[-1].data, "gnss/denied")
    observer.call(SetBool, f"{name}/use_gnss", SetBool.Request(data=True))
    observer.until(lambda: mode_of(status) == "AIDED", "AIDED again")
    observer.until(lambda: not late[-1].data, "gnss/denied false")

    origin = observer.listen(NavSatFix, f"{name}/origin", LATCHED)
    observer.until(lambda: origin, "the latched origin")
    assert (origin[-1].latitude, origin[-1].longitude) == pytest.approx((47.3977, 8.5456), abs=1e-3)
    assert (odometry[-1].header.frame_id, odometry[-1].child_frame_id) == ("odom", "base_link")
    check_continuity(odometry)
    observer.until(lambda: len(errors(pose, truth, origin[-1])) > 20, "poses with a known truth")
    assert float(np.median(errors(pose, truth, origin[-1]))) < 4.0
    assert sensors.stop() == 0
    assert estimator.stop() == 0, estimator.text()
    assert "Traceback" not in estimator.text()


def check_continuity(odometry: list[Odometry]) -> None:
    """base_link moves in odom no faster than the vehicle: no step at the outage, none at the return."""
    t = np.array([convert.stamp_ns(m) for m in odometry]) * 1e-9
    p = np.array([convert.vector(m.pose.pose.position) for m in odometry])
    v = np.linalg.norm([convert.vector(m.twist.twist.linear) for m in odometry], axis=1)
    assert len(p) > 200
    steps, dt = np.linalg.norm(np.diff(p, axis=0), axis=1), np.diff(t)
    assert np.all(steps <= np.maximum(v[1:], v[:-1]) * dt + 0.01), steps.max()


def errors(pose: list[PoseWithCovarianceStamped], truth: list[Odometry], origin: NavSatFix) -> list[float]:
    """Horizontal errors [m] of the last poses in map whose truth has arrived."""
    recording = generate("hover", duration=1.0)
    offset = lla_to_enu(
        math.radians(origin.latitude), math.radians(origin.longitude), origin.altitude, *recording.origin
    )
    true = {convert.stamp_ns(m): np.array(convert.vector(m.pose.pose.position)) for m in truth[-1000:]}
    return [
        math.hypot(*(np.array(convert.vector(m.pose.pose.position)) + offset - true[convert.stamp_ns(m)])[:2])
        for m in pose[-300:]
        if convert.stamp_ns(m) in true
    ]


def test_two_processes_equal_the_engine_alone(launch, observer):
    """GIVEN sensors and navigator in two processes WHEN a flight is flown THEN its poses equal those of the engine.

    How soon behind the IMU's a fix arrives is chance, and the poses until then do not know it. The last before the next
    fix does.
    """
    reliable = [
        f"qos_overrides./{topic}.subscription.{setting}"
        for topic in ("imu/data_raw", "gps/fix", "gps/vel", "gps/satellites", "imu/mag", "baro")
        for setting in ("reliability:=reliable", "depth:=1000")
    ]
    settings = [a for s in [*reliable, "ros.output.odometry_rate:=0.0", "ros.input.relieve:=false"] for a in ("-p", s)]
    launch("sins_node", *settings).wait_for("ready")
    poses = observer.listen(PoseWithCovarianceStamped, "/sins_node/pose", QoSProfile(depth=1000))
    flight = generate("multirotor_outage", duration=20.0, seed=6, imu_rate=100.0)
    story = ("duration:=20.0", "seed:=6", "imu_rate:=100.0", "sim_time:=true", "speed:=2.0", "truth_rate:=0.0")
    sensors = launch("synthetic_sensors", *(a for s in story for a in ("-p", s)))
    end = int(flight.imu.stamps_ns[-1])
    observer.until(lambda: poses and convert.stamp_ns(poses[-1]) == end, "the end of the flight")
    assert sensors.process.wait(timeout=PATIENCE) == 0

    engine = PoseEstimator(attitude=False)
    alone, last_fix = {}, 0  # stamp of a pose -> solution, number of the fix before it
    for sample in flight.samples(blocks=False):
        message = to_message(sample)
        if isinstance(message, NavSatFix):
            last_fix, sample = last_fix + 1, convert.nav_sat_fix(message)[0]
        for output in engine.feed(sample):
            if isinstance(output, NavSolution):
                alone[output.stamp_ns] = output, last_fix
    common = [(m.pose.pose, *alone[convert.stamp_ns(m)]) for m in poses if convert.stamp_ns(m) in alone]
    assert len(common) > 0.95 * len(alone) > 500
    agree = [_is_same(pose, solution) for pose, solution, _ in common]
    assert np.mean(agree) > 0.8
    fixes = [fix for *_, fix in common]
    before_a_fix = [same for same, fix, later in zip(agree, fixes, fixes[1:], strict=False) if later > fix]
    assert len(before_a_fix) > 15
    assert all(before_a_fix)


def _is_same(pose: Pose, solution: NavSolution) -> bool:
    """Equal to a millimetre and a hundredth of a degree."""
    w, x, y, z = solution.q_nb
    cosine = abs(w * pose.orientation.w + x * pose.orientation.x + y * pose.orientation.y + z * pose.orientation.z)
    near = math.dist(convert.vector(pose.position), solution.position_enu) < 1e-3
    return near and math.degrees(2.0 * math.acos(min(cosine, 1.0))) < 0.01


def test_pain_12_every_kind_of_publisher_is_heard_and_a_misfit_is_named(launch, observer):
    """Scenario 12: best effort and reliable publishers both reach the node; a wrong override is named in the log."""
    node = launch("attitude_node", "-r", "__node:=one")
    strict = launch(
        "attitude_node",
        *("-r", "__node:=strict", "-r", "imu/data:=strict/data"),
        *("-p", "qos_overrides./imu/data_raw.subscription.reliability:=reliable"),
    )
    heard = observer.listen(Imu, "/imu/data")
    node.wait_for("ready")
    strict.wait_for("ready")
    stamp = 1_700_000_000_000_000_000
    for profile in (BEST_EFFORT, RELIABLE):
        publisher = observer.node.create_publisher(Imu, "/imu/data_raw", profile)
        before = len(heard)

        def tick(publisher=publisher) -> bool:
            nonlocal stamp
            stamp += 10_000_000
            publisher.publish(to_message(ImuSample(stamp, (0.0, 0.0, 1e-4 * (stamp % 7)), (0.0, 0.0, 9.81))))
            return False

        observer.until(lambda before=before, tick=tick: tick() or len(heard) > before + 5, f"imu/data from {profile}")
        if profile is BEST_EFFORT:
            strict.wait_for("a publisher on /imu/data_raw offers incompatible QoS (RELIABILITY)")
            assert "qos_overrides./imu/data_raw.subscription.reliability" in strict.text()
    assert node.stop(signal.SIGTERM) == 0, node.text()
    assert strict.stop(signal.SIGINT) == 0, strict.text()


def test_publishers_that_are_not_heard_are_named_on_diagnostics(launch, observer):
    """GIVEN a driver of another message type and one with weaker QoS WHEN they appear THEN the pilot reads why."""
    override = "qos_overrides./baro.subscription.reliability:=reliable"
    node = launch("sins_node", "-p", "ros.output.diagnostics_period:=0.2", "-p", override)
    arrays = observer.listen(DiagnosticArray, "/diagnostics")
    observer.node.create_publisher(TwistStamped, "/gps/vel", RELIABLE)
    observer.node.create_publisher(FluidPressure, "/baro", BEST_EFFORT)
    kind = "gps/vel: /observer publishes geometry_msgs/msg/TwistStamped"
    observer.until(lambda: any(kind in s.message for s in arrays[-1].status) if arrays else False, "the wrong type")
    observer.until(
        lambda: any("baro: /observer offers incompatible QoS" in s.message for s in arrays[-1].status), "the weaker QoS"
    )
    inputs = next(s for s in arrays[-1].status if s.name == "sins_node: inputs")
    assert inputs.level == DiagnosticStatus.WARN
    assert node.stop() == 0, node.text()


def test_a_bag_that_loops_in_simulated_time_resets_once_and_flies_again(launch, observer):
    """GIVEN a flight under /clock that starts again WHEN the second lap comes THEN one reset, one line, and AIDED."""
    status = observer.listen(DiagnosticStatus, "/pose_estimator/status", LATCHED)
    arrays = observer.listen(DiagnosticArray, "/diagnostics")
    estimator = launch("pose_estimator", "-p", "use_sim_time:=true", "-p", "ros.output.diagnostics_period:=0.2")
    estimator.wait_for("ready")
    story = ("scenario:=hover", "duration:=25.0", "sim_time:=true", "speed:=2.0", "imu_rate:=50.0", "laps:=2")
    launch("synthetic_sensors", *(a for s in story for a in ("-p", s)))

    def resets() -> int:
        pairs = [pair for s in arrays[-1].status for pair in s.values if s.name.endswith("counters")] if arrays else []
        return sum(int(pair.value) for pair in pairs if pair.key == "reset")

    observer.until(lambda: mode_of(status) == "AIDED", "AIDED")
    assert resets() == 0
    observer.until(lambda: resets() == 1, "the reset of the second lap")
    observer.until(lambda: mode_of(status) == "AIDED", "AIDED in the second lap")
    assert resets() == 1
    assert estimator.stop() == 0, estimator.text()
    assert estimator.text().count("the navigator starts again: time went back by 2") == 1, estimator.text()


def test_a_navigator_without_data_says_what_it_misses(launch, observer):
    node = launch("sins_node", "-p", "ros.output.diagnostics_period:=0.2")
    arrays = observer.listen(DiagnosticArray, "/diagnostics")
    observer.until(
        lambda: any("imu/data_raw was never received" in s.message for a in arrays for s in a.status), "the missing IMU"
    )
    state = arrays[-1].status[0]
    assert state.name == "sins_node"
    assert state.message.startswith("WAITING_IMU: Waiting for IMU data")
    assert state.message.count("no fix has arrived yet") == 1
    assert observer.call(Trigger, "/sins_node/reset", Trigger.Request()).success
    assert node.stop(signal.SIGTERM) == 0, node.text()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM], ids=lambda s: s.name)
@pytest.mark.parametrize("command", ["attitude_node", "synthetic_sensors"])
def test_a_signal_ends_a_node_with_code_0(launch, command, how):
    child = launch(command)
    child.wait_for("ready" if command == "attitude_node" else "messages")
    assert child.stop(how) == 0, child.text()
    assert "Traceback" not in child.text()


def test_two_interrupts_at_once_leave_no_traceback(launch):
    """GIVEN a node under launch WHEN Ctrl-C reaches it from the terminal and from launch THEN it ends quietly."""
    child = launch("synthetic_sensors", "-p", "duration:=30.0")
    child.wait_for("messages")
    child.process.send_signal(signal.SIGINT)
    assert child.stop(signal.SIGINT) == 0, child.text()
    assert "Traceback" not in child.text()


def test_a_file_with_a_wrong_value_ends_a_node_with_code_2(launch, tmp_path):
    file = tmp_path / "wrong.yaml"
    file.write_text("/**:\n  ros__parameters:\n    gnss:\n      delay: 9.0\n")
    child = launch("sins_node", "--params-file", str(file))
    assert child.process.wait(timeout=PATIENCE) == 2
    assert child.text().strip() == "sins_node: gnss.delay: 9 is above the maximum 1 s"
