"""A node that cannot keep up: it says so, leaves out work before samples, and never takes its own delay for GNSS's."""

import time
from collections.abc import Callable

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, NavSatFix
from std_msgs.msg import Bool

from nav_pose_estimator.engine.samples import GnssFix, ImuSample
from nav_pose_estimator.engine.solutions import Mode, Status
from nav_pose_estimator.ros import inputs
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.load.overload import ImuGroups, Overload
from nav_pose_estimator.ros.messages.outgoing import fill_stamp
from nav_pose_estimator.ros.spin import make_executor
from ros_processes import children, wait_until

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STEP_NS = 2_500_000  # 400 Hz


# --- the steps, and what they do to samples ------------------------------------------------------------------------
def test_work_is_left_out_before_samples_and_taken_up_again() -> None:
    """GIVEN a delay that grows WHEN seconds pass THEN rehearsals rest first, groups grow, and calm takes all back."""
    steps: list[tuple[int, int]] = []
    load = Overload(lambda before, step: steps.append((before, step)))
    load.note(0.1, 0.0)
    assert (load.step, load.sentence(0)) == (0, ""), "a burst is no overload"
    load.note(0.3, 1.0)
    assert (load.step, load.group) == (1, 1), "no sample is touched yet"
    assert load.sentence(0).startswith("OVERLOADED")
    load.note(0.5, 2.1)
    assert (load.step, load.group) == (2, 2)
    load.note(0.3, 3.2)
    assert load.step == 2, "it is catching up"
    for second in range(4, 60):
        load.look_back(float(second))
    assert load.step == 0
    assert steps == [(0, 1), (1, 2), (2, 1), (1, 0)]


def test_a_single_stall_drops_nothing() -> None:
    """GIVEN a computer that stood still for five seconds WHEN it goes on THEN what waits is used, however old."""
    load = Overload(lambda before, step: None)
    load.note(5.0, 100.0)
    assert not load.is_hopeless
    for second in range(1, 5):
        load.note(5.0, 100.0 + 1.1 * second)
    assert load.is_hopeless, "nothing is left to leave out"


def test_a_step_that_was_taken_back_too_soon_stays_longer_the_next_time() -> None:
    load = Overload(lambda before, step: None)
    lasted = []
    for start in (100.0, 1000.0):
        load.note(0.5, start)
        lasted.append(next(s for s in range(1, 400) if load.look_back(start + s) or load.step == 0))
    assert lasted[1] > 1.9 * lasted[0]


def test_averaged_imu_samples_keep_the_sum() -> None:
    """GIVEN IMU samples WHEN groups of four are averaged THEN turn and velocity gained are those of the samples."""
    rows = np.random.default_rng(3).normal(size=(40, 6))
    groups = ImuGroups()
    samples = [ImuSample((i + 1) * STEP_NS, tuple(row[:3]), tuple(row[3:])) for i, row in enumerate(rows)]
    means = [mean for sample in samples if (mean := groups.add(sample, 4)) is not None]
    assert [mean.stamp_ns for mean in means] == [4 * STEP_NS * (i + 1) for i in range(10)]
    np.testing.assert_allclose(4 * np.sum([(*m.gyro, *m.accel) for m in means], axis=0), rows.sum(axis=0))


@pytest.mark.parametrize(("rate", "count"), [(50, 1), (100, 2), (200, 4), (400, 8), (1000, 8)])
def test_a_mean_is_never_longer_than_a_turn_allows(rate: int, count: int) -> None:
    """GIVEN an IMU at some rate WHEN eight samples are to be averaged THEN as many are as 20 ms hold."""
    groups = ImuGroups()
    stamps = [10**9 + i * 10**9 // rate for i in range(81)]
    means = [groups.add(ImuSample(stamp, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)), 8) for stamp in stamps]
    told = [mean.stamp_ns for mean in means if mean is not None]
    assert set(np.diff(told)) == {count * 10**9 // rate}


def test_a_group_that_is_not_complete_when_the_load_ends_loses_nothing() -> None:
    groups = ImuGroups()
    assert groups.add(ImuSample(1, (1.0, 0.0, 0.0), (0.0, 0.0, 9.0)), 4) is None
    assert groups.add(ImuSample(2, (3.0, 0.0, 0.0), (0.0, 0.0, 11.0)), 1) == ImuSample(
        2, (2.0, 0.0, 0.0), (0.0, 0.0, 10.0)
    )
    assert not groups


# --- a node with an engine that is too slow ------------------------------------------------------------------------
class SlowEngine:
    """Needs four times as long for an IMU sample as 400 Hz leave, and remembers what it was fed."""

    mode, origin = Mode.AIDED, None

    def __init__(self, parameters) -> None:
        self.fed: list[ImuSample | GnssFix] = []

    def feed(self, sample) -> list:
        self.fed.append(sample)
        if isinstance(sample, ImuSample):
            time.sleep(0.01)
        return []

    def status(self) -> Status:
        return Status(0, self.mode, "", 0.0, 1.0, 2.0, "", None, {}, {})

    def warm_up(self) -> None:
        """Nothing to compile."""


class SlowNode(EstimatorNode):
    spared: tuple[bool, ...] = ()

    def __init__(self) -> None:
        super().__init__("slow_node", SlowEngine)
        self.listen(inputs.imu(self.parameters), needed=True)
        self.listen(next(s for s in inputs.of_navigator(self.parameters) if s.topic == "gps/fix"))

    def spare(self, flag: bool) -> None:
        self.spared = (*self.spared, flag)


@pytest.fixture
def slow(started):
    node = started(SlowNode, "-p", "ros.output.diagnostics_period:=0.1")
    executor = make_executor()
    executor.add_node(node)
    sender = node.create_publisher(Imu, "imu/data_raw", 1000), node.create_publisher(NavSatFix, "gps/fix", 100)

    def spin_until(condition: Callable[[], bool]) -> None:
        wait_until(condition, lambda: executor.spin_once(timeout_sec=0.05), patience=60.0)

    spin_until(lambda: all(publisher.get_subscription_count() for publisher in sender))
    yield node, sender, spin_until
    executor.remove_node(node)
    executor.shutdown()


def send(sender, first: int, last: int) -> None:
    """IMU messages number ``first`` to ``last``, and a fix behind every fortieth."""
    for i in range(first, last + 1):
        message = Imu()
        fill_stamp(message.header.stamp, i * STEP_NS)
        message.linear_acceleration.z = 9.8 + 1e-3 * (i % 7)
        sender[0].publish(message)
        if i % 40 == 0:
            fix = NavSatFix()
            fill_stamp(fix.header.stamp, i * STEP_NS)
            sender[1].publish(fix)


def test_samples_that_are_lost_are_counted_where_they_are_lost(slow) -> None:
    """GIVEN a queue of 200 WHEN 500 messages wait THEN 300 are lost, told and no others."""
    node, sender, spin_until = slow
    send(sender, 1, 10)
    imu = node.intake.watches[0]
    spin_until(lambda: imu.report().total == 10)
    assert imu.report().lost == 0
    send(sender, 11, 510)
    spin_until(lambda: imu.report().total == 210)
    assert imu.report().lost == 300


def test_a_late_node_meets_fixes_and_imu_in_the_order_of_their_arrival(slow) -> None:
    """GIVEN IMU messages and fixes that wait WHEN the node is seconds late THEN no fix is older than its IMU data."""
    node, sender, spin_until = slow
    send(sender, 1, 200)
    spin_until(lambda: node.intake.watches[0].report().total == 200)
    newest, ages = 0, []
    for sample in node.engine.fed:
        if isinstance(sample, ImuSample):
            newest = sample.stamp_ns // STEP_NS
        else:
            ages.append(newest - sample.stamp_ns // STEP_NS)
    assert len(ages) == 5
    assert max(ages) <= 2, "in units of one IMU sample"


def test_the_status_of_a_late_node_names_overload(slow, observer) -> None:
    """GIVEN messages faster than the engine WHEN the node falls behind THEN its status says so, and it spares work."""
    node, sender, spin_until = slow
    statuses = observer.listen(DiagnosticStatus, "/slow_node/status", LATCHED)
    sent = 0

    def overloaded() -> bool:
        nonlocal sent
        send(sender, sent + 1, sent + 40)
        sent += 40
        observer.executor.spin_once(timeout_sec=0.0)
        return bool(statuses) and "OVERLOADED" in statuses[-1].message

    spin_until(overloaded)
    assert statuses[-1].level == DiagnosticStatus.WARN
    assert "rehearsals are paused" in statuses[-1].message
    assert "refused" not in statuses[-1].message
    assert node.spared[:1] == (True,)
    assert node.logbook.counters["overload.step"] >= 1


# --- flights -------------------------------------------------------------------------------------------------------
class Watched:
    """What a node in another process says of itself."""

    def __init__(self, observer, name: str) -> None:
        self._name = name
        self._statuses = observer.listen(DiagnosticStatus, f"/{name}/status", LATCHED)
        self._arrays = observer.listen(DiagnosticArray, "/diagnostics", 100)

    @property
    def mode(self) -> str:
        return self._statuses[-1].message.split(":")[0] if self._statuses else ""

    @property
    def said(self) -> list[str]:
        return [status.message for status in self._statuses]

    def input(self, topic: str) -> tuple[int, int]:
        """Messages that arrived, and that were lost."""
        for status in (s for array in reversed(self._arrays) for s in array.status):
            if status.name == f"{self._name}: inputs":
                words = next((pair.value.split(", ") for pair in status.values if pair.key == topic), None)
                return (0, 0) if words is None else (int(words[1].split()[0]), int(words[2].split()[0]))
        return 0, 0


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("commands", "rate", "plain"),
    [(("pose_estimator",), 400, True), (("sins_node", "attitude_node", "anfis_node"), 1000, False)],
    ids=["plain Python, composed, 400 Hz", "three nodes, 1000 Hz"],
)
def test_a_flight_at_a_high_rate_never_loses_gnss(observer, child_environment, launch, tmp_path, commands, rate, plain):
    """GIVEN sensors and a computer that may be too slow for them WHEN ten seconds are flown
    THEN GNSS stays with the navigator, and what it got and what it lost are all that was sent."""
    denied = observer.listen(Bool, "/gnss/denied", LATCHED)
    watched = Watched(observer, commands[0])
    folder = tmp_path / "nodes"
    folder.mkdir()
    with children(child_environment | ({"NUMBA_DISABLE_JIT": "1"} if plain else {}), folder) as start:
        nodes = [start(command) for command in commands]
        for node in nodes:
            node.wait_for("ready")
        story = (f"imu_rate:={rate}.0", "duration:=600.0", "scenario:=multirotor_light", "truth_rate:=0.0")
        sensors = launch("synthetic_sensors", *(a for s in story for a in ("-p", s)))
        observer.until(lambda: watched.mode == "AIDED", "AIDED")
        denied.clear()
        since = watched.input("imu/data_raw")
        observer.until(lambda: sum(watched.input("imu/data_raw")) > sum(since) + 10 * rate, "ten seconds of flight")
        assert not any(message.data for message in denied)
        assert watched.mode == "AIDED"
        assert not any("GNSS refused" in sentence for sentence in watched.said[-8:]), watched.said
        assert sensors.stop() == 0
        for node in nodes:
            assert node.stop() == 0, node.text()
            assert "Traceback" not in node.text()
