"""Repeated kill and restart of a small node: time until the new one receives its sensor, by settings of Fast DDS.

tools/in_environment.sh env ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET FASTDDS_BUILTIN_TRANSPORTS=UDPv4 \
    ROS_DOMAIN_ID=99 python benchmarks/restart_over_dds.py --trials 40 --in-start 6

Without FASTDDS_BUILTIN_TRANSPORTS shared memory is also used; docs/getting_started.md describes the profile. A
publisher of 100 Hz runs meanwhile. A node is killed once it has received a message; others are killed during their
start. Killed processes may leave damaged shared memory of the domain behind; `fastdds shm clean` removes it.
"""

import argparse
import os
import random
import select
import signal
import statistics
import time
from collections.abc import Callable

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu

_CREATED, _HEARD = b"c", b"h"
_LONGEST_START = 0.35  # s: latest time at which a node is killed during its start
_GIVEN_UP = 10.0  # s without a message after which a node has failed


def child(live: Callable[[], None]) -> int:
    """Run ``live`` in a child process; return its id."""
    number = os.fork()
    if number == 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        live()
        os._exit(0)
    return number


def sense() -> None:
    """Publish at 100 Hz."""
    rclpy.init()
    node = rclpy.create_node("sensor")
    publisher = node.create_publisher(Imu, "imu", 50)
    node.create_timer(0.01, lambda: publisher.publish(Imu()))
    _spin(node)


def listen(pipe: int) -> None:
    """Create a node and receive the sensor, and report both through ``pipe``."""
    rclpy.init()
    node = rclpy.create_node(f"listener_{os.getpid()}")
    os.write(pipe, _CREATED)

    def hear(_: Imu) -> None:
        os.write(pipe, _HEARD)

    node.create_subscription(Imu, "imu", hear, qos_profile_sensor_data)
    _spin(node)


def _spin(node: Node) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while True:
        executor.spin_once()


def kill_in_mid_start(count: int, draw: random.Random) -> None:
    """Start ``count`` nodes at once, as a launch file does, and kill each at a random moment."""
    nobody = os.open(os.devnull, os.O_WRONLY)
    nodes = [
        (time.monotonic() + draw.uniform(0.0, _LONGEST_START), child(lambda: listen(nobody))) for _ in range(count)
    ]
    for when, node in sorted(nodes):
        time.sleep(max(when - time.monotonic(), 0.0))
        os.kill(node, signal.SIGKILL)
        os.waitpid(node, 0)
    os.close(nobody)


def restart() -> dict[bytes, float]:
    """Start a node and wait for its first message or the time-out; return the times [s] of its reports."""
    ours, theirs = os.pipe()
    began, told = time.monotonic(), dict[bytes, float]()
    node = child(lambda: listen(theirs))
    os.close(theirs)
    while _HEARD not in told and (left := began + _GIVEN_UP - time.monotonic()) > 0.0:
        if select.select([ours], [], [], left)[0]:
            told.setdefault(os.read(ours, 1), time.monotonic() - began)
    os.kill(node, signal.SIGKILL)
    os.waitpid(node, 0)
    os.close(ours)
    return told


def main() -> None:
    """Run all trials and print one line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--in-start", type=int, default=0, help="nodes that are killed in mid-start before each life")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    draw = random.Random(given.seed)
    sensor = child(sense)
    told = []
    try:
        time.sleep(2.0)
        for _ in range(given.trials):
            kill_in_mid_start(given.in_start, draw)
            told.append(restart())
    finally:
        os.kill(sensor, signal.SIGKILL)
        os.waitpid(sensor, 0)
    heard = sorted(one[_HEARD] for one in told if _HEARD in one)
    hung = sum(_CREATED not in one for one in told)
    print(
        f"{len(told)} restarts watched, {hung} hung in creating the node, {len(told) - len(heard)} never heard", end=""
    )
    print(f"; heard after {statistics.median(heard):.1f} s, at worst {heard[-1]:.1f} s" if heard else "")


if __name__ == "__main__":
    main()
