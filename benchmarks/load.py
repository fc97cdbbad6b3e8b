"""Load of this machine by the nodes: CPU usage, latency from stamp to odometry, and losses, by IMU rate.

    python benchmarks/load.py --rates 200,400,1000 --seconds 30 --out out/load

A sender publishes a simulated flight in wall time, and a receiver takes the odometry. The estimator runs between them
in separate processes: composed (pose_estimator) or separate (attitude_node, sins_node, anfis_node). All of them run on
this computer.
"""

import argparse
import json
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nav_pose_estimator.offline.process_clock import stat_fields

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

SYSTEMS = {"composed": ("pose_estimator",), "separate": ("attitude_node", "sins_node", "anfis_node")}
_WARM_UP = 8.0  # s after the first odometry that are not measured
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Row:
    """One line of the table: times [ms], CPU usage [% of one core]; ``others``: that of all other programs."""

    system: str
    imu_hz: float
    cpu_percent: float
    p50_ms: float
    p99_ms: float
    worst_ms: float
    sent: int
    answered: int
    others_percent: float

    @property
    def dropped(self) -> int:
        """IMU messages without an odometry."""
        return max(self.sent - self.answered, 0)


# --- the sender: a process of its own ------------------------------------------------------------------------------
def send(rate: float, seconds: float) -> int:
    """Publish a simulated flight with wall-time stamps; the IMU as ready-made bytes."""
    import rclpy
    from rclpy.serialization import serialize_message

    from nav_pose_estimator.engine.samples import ImuSample
    from nav_pose_estimator.ros import qos
    from nav_pose_estimator.ros.messages.sample_messages import TOPICS, to_message
    from nav_pose_estimator.sim.scenarios import generate

    flight = generate("multirotor_light", duration=seconds, seed=1, imu_rate=rate)
    rclpy.init()
    node = rclpy.create_node("load_sender")
    outputs = {kind: qos.advertise(node, message, topic) for kind, (topic, message) in TOPICS.items()}
    ready: list[tuple[int, type, Any]] = []
    for timed in flight.arrivals():
        message = to_message(timed.sample)
        data = bytearray(serialize_message(message)) if isinstance(timed.sample, ImuSample) else message
        ready.append((timed.arrival_ns, type(timed.sample), data))
    while not outputs[ImuSample].get_subscription_count():
        time.sleep(0.05)
    shift = time.time_ns() - flight.start_ns + 500_000_000
    for arrival_ns, kind, message in ready:
        at = arrival_ns + shift
        wait = (at - time.time_ns()) * 1e-9
        if wait > 0.0:
            time.sleep(wait)
        _stamp(message, time.time_ns())
        outputs[kind].publish(bytes(message) if kind is ImuSample else message)
    node.destroy_node()
    rclpy.shutdown()
    return 0


def _stamp(message: Any, now_ns: int) -> None:
    if isinstance(message, bytearray):
        struct.pack_into("<iI", message, 4, now_ns // 10**9, now_ns % 10**9)
    elif hasattr(message, "header"):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 10**9)


# --- the receiver: this process ------------------------------------------------------------------------------------
def measure(system: str, rate: float, seconds: float) -> Row:
    """One run of one system at one IMU rate."""
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.qos import QoSProfile

    from nav_pose_estimator.ros.messages.cdr import peek_stamp_ns
    from nav_pose_estimator.ros.spin import make_executor

    rclpy.init()
    node = rclpy.create_node("load_receiver")
    executor = make_executor()
    executor.add_node(node)
    answers: list[tuple[int, int]] = []

    def answered(data: Any) -> None:
        answers.append((peek_stamp_ns(data), time.time_ns()))

    node.create_subscription(Odometry, "odometry/filtered", answered, QoSProfile(depth=1000), raw=True)
    with _running(system, rate, seconds) as (children, sender):
        cpu_start = begin = None
        own = (*children, sender)
        while sender.poll() is None:
            executor.spin_once(timeout_sec=0.1)
            if answers and begin is None and answers[-1][0] - answers[0][0] > _WARM_UP * 1e9:
                begin, cpu_start, wall_start = answers[-1][0], _cpu(children), time.monotonic()
                others_start = _machine() - _cpu(own) - time.process_time()
            if begin is not None and time.monotonic() - wall_start > 1.0:
                cpu_end, wall_end = _cpu(children), time.monotonic()
                others_end = _machine() - _cpu(own) - time.process_time()
    executor.remove_node(node)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()
    if begin is None or cpu_start is None:
        raise SystemExit(f"{system} at {rate:g} Hz: no odometry came; run it for longer")
    measured = np.array([(stamp, seen) for stamp, seen in answers if stamp > begin])
    latency = (measured[:, 1] - measured[:, 0]) * 1e-6
    span = (measured[-1, 0] - begin) * 1e-9
    return Row(
        system=system,
        imu_hz=rate,
        cpu_percent=100.0 * (cpu_end - cpu_start) / (wall_end - wall_start),
        p50_ms=float(np.percentile(latency, 50)),
        p99_ms=float(np.percentile(latency, 99)),
        worst_ms=float(latency.max()),
        sent=round(span * rate),
        answered=len(measured),
        others_percent=100.0 * (others_end - others_start) / (wall_end - wall_start),
    )


@contextmanager
def _running(system: str, rate: float, seconds: float) -> Iterator[tuple[list[subprocess.Popen], subprocess.Popen]]:
    """The nodes, ready, and the sender."""
    children = []
    try:
        for command in SYSTEMS[system]:
            call = [sys.executable, "-m", "nav_pose_estimator", command, "--ros-args", "--log-level", "warn"]
            children.append(subprocess.Popen([*call, "-p", "ros.output.odometry_rate:=0.0"]))
        call = [sys.executable, __file__, "--send", str(rate), "--seconds", str(seconds)]
        sender = subprocess.Popen(call)
        children.append(sender)
        yield children[:-1], sender
    finally:
        for child in children:
            if child.poll() is None:
                child.send_signal(signal.SIGINT)
        for child in children:
            child.wait(timeout=30)


def _cpu(children: Sequence[subprocess.Popen]) -> float:
    """CPU time [s] of the processes."""
    total = 0
    for child in children:
        fields = stat_fields(child.pid)
        total += int(fields[11]) + int(fields[12])
    return total / _TICKS


def _machine() -> float:
    """CPU time [s] of all processes on this machine."""
    user, nice, system, _idle, _wait, irq, softirq = map(int, Path("/proc/stat").read_text().split()[1:8])
    return (user + nice + system + irq + softirq) / _TICKS


def table(rows: Sequence[Row]) -> str:
    """The result as Markdown."""
    lines = [
        "| system | IMU Hz | CPU of one core | latency p50 / p99 / worst, ms | dropped | CPU of others |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        times = f"{row.p50_ms:.2f} / {row.p99_ms:.2f} / {row.worst_ms:.1f}"
        lines.append(
            f"| {row.system} | {row.imu_hz:g} | {row.cpu_percent:.0f} % | {times} | {row.dropped} of {row.sent} | "
            f"{row.others_percent:.0f} % |"
        )
    return "\n".join(lines)


def main() -> int:
    """Run all systems at all rates; print the table, write load.json and load.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rates", default="200,400,1000", help="IMU rates in Hz")
    parser.add_argument("--systems", default="composed,separate", help=f"of {', '.join(SYSTEMS)}")
    parser.add_argument("--seconds", type=float, default=30.0, help="length of each run")
    parser.add_argument("--out", type=Path, help="folder for load.json and load.md")
    parser.add_argument("--send", type=float, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.send:
        return send(arguments.send, arguments.seconds)
    rates, systems = map(float, arguments.rates.split(",")), arguments.systems.split(",")
    rows = [measure(system, rate, arguments.seconds) for rate in rates for system in systems]
    print(table(rows))
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / "load.json").write_text(json.dumps([asdict(row) for row in rows], indent=2))
        (arguments.out / "load.md").write_text(table(rows) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
