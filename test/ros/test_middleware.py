"""Fast DDS without shared memory: what nodes choose, what they leave to others, and that both kinds hear each other."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import Child, children
from sensor_msgs.msg import Imu

from nav_pose_estimator.ros import spin

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
CHOICES = (PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
QUICK = ("-p", "imu_rate:=50.0", "-p", "duration:=60.0", "-p", "sim_time:=false")


def shared_memory_of(child: Child) -> list[str]:
    """What of Fast DDS's shared memory a process has mapped."""
    maps = Path(f"/proc/{child.process.pid}/maps").read_text()
    return [line for line in maps.splitlines() if "/dev/shm/fastrtps" in line]


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


def test_the_profile_for_one_host_has_no_shared_memory(launch) -> None:
    """GIVEN the profile of config/, with which these tests run THEN a node has no shared memory; the range LOCALHOST
    has it whatever is chosen, which is why the tests do not use it."""
    assert Path(os.environ[PROFILES]).name == "fastdds_one_host.xml"
    node = launch("attitude_node")
    node.wait_for("ready")
    assert shared_memory_of(node) == []


@pytest.mark.parametrize("chosen", CHOICES)
def test_a_choice_of_the_user_stands(monkeypatch, chosen) -> None:
    """GIVEN a variable that says how Fast DDS shall talk WHEN a node starts THEN nothing changes; GIVEN none, UDP."""
    for name in CHOICES:
        monkeypatch.setenv(name, "")  # so that it is put back to what it was
        monkeypatch.delenv(name)
    monkeypatch.setenv(chosen, "mine")
    spin.choose_transport()
    assert {name: os.environ[name] for name in CHOICES if name in os.environ} == {chosen: "mine"}
    monkeypatch.delenv(chosen)
    spin.choose_transport()
    assert os.environ["FASTDDS_BUILTIN_TRANSPORTS"] == "UDPv4"


def test_peers_with_and_without_shared_memory_hear_each_other(child_environment, observer, tmp_path) -> None:
    """GIVEN sensors with shared memory, that wait for a subscriber, and an observer without THEN they meet."""
    with_memory = {name: value for name, value in child_environment.items() if name not in CHOICES}
    heard = observer.listen(Imu, "/imu/data_raw")
    with children(with_memory | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, tmp_path) as start:
        sensors = start("synthetic_sensors", *QUICK)
        observer.until(lambda: len(heard) > 20, "IMU from a peer with shared memory")
        assert shared_memory_of(sensors) != []
