"""Fast DDS without shared memory: what nodes choose, what they leave to others, and that both kinds hear each other."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from sensor_msgs.msg import Imu

from nav_pose_estimator.ros.middleware import shared_memory
from ros_processes import Child, children

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
CHOICES = (PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
MEMORY, FINISHED = Path("/dev/shm"), b"\2\0\0\0"
QUICK = ("-p", "imu_rate:=50.0", "-p", "duration:=60.0", "-p", "sim_time:=false")


def shared_memory_of(child: Child) -> list[str]:
    """What of Fast DDS's shared memory a process has mapped."""
    maps = Path(f"/proc/{child.process.pid}/maps").read_text()
    return [line for line in maps.splitlines() if "/dev/shm/fastrtps" in line]


def unfinished(file: Path, age: float = 10.0) -> None:
    """A segment as a process leaves it that is killed before it has written anything to it."""
    file.write_bytes(bytes(52400))
    os.utime(file, (time.time() - age,) * 2)


@pytest.fixture
def started_with(child_environment, tmp_path) -> Callable[..., list[str]]:
    """``started_with(range, **environment)``: the shared memory of a node that is ready, with nothing else chosen.

    The range OFF announces nothing to anybody, and leaves the transports to Fast DDS as SUBNET does.
    """

    def shared(discovery: str, **more: str) -> list[str]:
        kept = {name: value for name, value in child_environment.items() if name not in CHOICES}
        with children(kept | {"ROS_AUTOMATIC_DISCOVERY_RANGE": discovery} | more, tmp_path) as start:
            node = start("attitude_node")
            node.wait_for("ready")
            return shared_memory_of(node)

    return shared


def test_a_node_leaves_no_shared_memory_behind_that_could_hold_up_the_next(started_with) -> None:
    """GIVEN Fast DDS and nobody who has chosen its transports WHEN a node starts THEN it has no shared memory, so that
    a kill leaves none; who asks for it still gets it."""
    assert started_with("OFF") == []
    assert started_with("OFF", FASTDDS_BUILTIN_TRANSPORTS="DEFAULT") != []


def test_the_profile_for_one_host_has_no_shared_memory(started_with, repository) -> None:
    """GIVEN the profile of config/ THEN a node has no shared memory; with the range LOCALHOST it has some whatever
    is chosen."""
    profile = str(repository / "config" / "fastdds_one_host.xml")
    assert started_with("SYSTEM_DEFAULT", **{PROFILES: profile}) == []
    assert started_with("LOCALHOST", FASTDDS_BUILTIN_TRANSPORTS="UDPv4") != []


def test_a_node_is_not_held_up_by_what_a_killed_one_left_unfinished(launch, ros_domain: int) -> None:
    """GIVEN a port in shared memory whose creator was killed while creating it WHEN a node starts THEN it is ready."""
    port = MEMORY / f"fastrtps_port{7400 + 250 * ros_domain + 10}"
    unfinished(port)
    try:
        launch("attitude_node").wait_for("ready")
        assert not port.exists() or port.read_bytes()[:4] == FINISHED
    finally:
        port.unlink(missing_ok=True)


def test_only_what_nobody_will_finish_is_removed(tmp_path: Path) -> None:
    """GIVEN segments that are finished, begun long ago, begun just now, and files of others
    WHEN the unfinished ones are removed THEN only the second is."""
    (tmp_path / "fastrtps_port7002").write_bytes(FINISHED + bytes(100))
    unfinished(tmp_path / "fastrtps_port7001")
    unfinished(tmp_path / "fastrtps_0123456789abcdef", age=0.0)
    for other in ("fastrtps_port7001_el", "sem.fastrtps_port7001_mutex", "somebody"):
        unfinished(tmp_path / other)
    os.utime(tmp_path / "fastrtps_port7002", (0, 0))
    assert shared_memory.remove_unfinished(tmp_path) == ["fastrtps_port7001"]
    assert len(list(tmp_path.iterdir())) == 5
    assert shared_memory.remove_unfinished(tmp_path / "absent") == []


@pytest.mark.parametrize("chosen", CHOICES)
def test_a_choice_of_the_user_stands(monkeypatch, chosen) -> None:
    """GIVEN a variable that says how Fast DDS shall talk WHEN a node starts THEN nothing changes; GIVEN none, UDP."""
    for name in CHOICES:
        monkeypatch.setenv(name, "")  # so that it is put back to what it was
        monkeypatch.delenv(name)
    monkeypatch.setenv(chosen, "mine")
    shared_memory.choose_transport()
    assert {name: os.environ[name] for name in CHOICES if name in os.environ} == {chosen: "mine"}
    monkeypatch.delenv(chosen)
    shared_memory.choose_transport()
    assert os.environ["FASTDDS_BUILTIN_TRANSPORTS"] == "UDPv4"


def test_peers_with_and_without_shared_memory_hear_each_other(child_environment, observer, tmp_path) -> None:
    """GIVEN sensors with shared memory, that wait for a subscriber, and an observer THEN they meet."""
    with_memory = {name: value for name, value in child_environment.items() if name not in CHOICES}
    heard = observer.listen(Imu, "/imu/data_raw")
    with children(with_memory | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, tmp_path) as start:
        sensors = start("synthetic_sensors", *QUICK)
        observer.until(lambda: len(heard) > 20, "IMU from a peer with shared memory")
        assert shared_memory_of(sensors) != []
