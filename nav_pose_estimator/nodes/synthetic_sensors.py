"""synthetic_sensors: publishes simulated sensor data in wall or simulated time, with jitter, delays and losses."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.engine.parameters.synthetic import SyntheticParameters
from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.ros import qos, spin
from nav_pose_estimator.ros.messages.outgoing import fill_stamp
from nav_pose_estimator.ros.messages.sample_messages import TOPICS, to_message, truth_message
from nav_pose_estimator.ros.parameters import declare
from nav_pose_estimator.sim import scenarios
from nav_pose_estimator.sim.sensors import Timed
from nav_pose_estimator.sim.transport import Transport

_SHORTEST_TICK = 0.0005  # s: shortest period of the timer


class SyntheticSensors(Node):
    """Plays a simulated recording, and ends after it."""

    def __init__(self) -> None:
        super().__init__("synthetic_sensors")
        p = self._scenario = declare(self, SyntheticParameters())
        recording = scenarios.generate(p.scenario, p.duration or None, p.seed, p.imu, p.imu_rate)
        transport = Transport(p.jitter, p.delay, p.drop, p.burst_every, p.burst_length)
        self._start_ns = recording.start_ns
        self._arrivals = transport.carry(recording.arrivals(), recording.start_ns, p.seed)
        self._truth = list(_true_motion(recording, p.truth_rate)) if p.truth_rate else []
        self._length_ns = round((recording.truth.t[-1] + 1.0 / p.imu_rate) * 1e9)
        self._speed = p.speed if p.sim_time else 1.0
        self._outputs = {kind: qos.advertise(self, message, topic) for kind, (topic, message) in TOPICS.items()}
        self._truth_output = qos.advertise(self, Odometry, "ground_truth/odom")
        self._clock_output = qos.advertise(self, ClockMessage, "/clock") if p.sim_time else None
        self._clock_step_ns = round(1e9 / p.clock_rate)
        self._began: float | None = None
        self._lap, self.is_over = 0, False
        tick = max(min(0.5 / p.imu_rate, 0.01) / self._speed, _SHORTEST_TICK)
        self._timer = self.create_timer(tick, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"{p.scenario}: {self._length_ns * 1e-9:.0f} s, {len(self._arrivals)} messages")

    # --- time ------------------------------------------------------------------------------------------------------

    def _on_timer(self) -> None:
        if self._began is None:
            self._begin()
            return
        now = round((time.monotonic() - self._began) * self._speed * 1e9)
        self._publish_until(min(now, self._length_ns))
        if now >= self._length_ns:
            self._finish_lap()

    def _begin(self) -> None:
        """Start a lap as soon as there is a subscriber."""
        waits = self._scenario.wait_for_subscriber
        if waits and not self._outputs[ImuSample].get_subscription_count():
            return
        self._began, self._next, self._next_truth, self._next_clock_ns = time.monotonic(), 0, 0, 0
        # simulated time restarts with every lap, wall time continues
        self._shift_ns = 0 if self._clock_output is not None else time.time_ns() - self._start_ns

    def _finish_lap(self) -> None:
        self._lap += 1
        self._began = None
        if self._lap >= self._scenario.laps:
            self.is_over = True
            self._timer.cancel()
            self.get_logger().info("the scenario is over")

    # --- messages --------------------------------------------------------------------------------------------------

    def _publish_until(self, now_ns: int) -> None:
        """Publish all messages that arrive up to ``now_ns`` after the start of the lap."""
        until = self._start_ns + now_ns
        while self._next < len(self._arrivals) and self._arrivals[self._next].arrival_ns <= until:
            self._publish_clock(self._arrivals[self._next].arrival_ns)
            self._publish(self._arrivals[self._next])
            self._next += 1
        while self._next_truth < len(self._truth) and self._truth[self._next_truth][0] <= until:
            stamp, *motion = self._truth[self._next_truth]
            self._truth_output.publish(truth_message(stamp + self._shift_ns, *motion))
            self._next_truth += 1

    def _publish(self, timed: Timed) -> None:
        sample: Any = timed.sample
        if sample.stamp_ns is not None and self._shift_ns:
            sample = replace(sample, stamp_ns=sample.stamp_ns + self._shift_ns)
        self._outputs[type(sample)].publish(to_message(sample))

    def _publish_clock(self, arrival_ns: int) -> None:
        if self._clock_output is None or arrival_ns < self._start_ns + self._next_clock_ns:
            return
        self._next_clock_ns = arrival_ns - self._start_ns + self._clock_step_ns
        message = ClockMessage()
        fill_stamp(message.clock, arrival_ns)
        self._clock_output.publish(message)


def _true_motion(
    recording: scenarios.Recording, rate: float
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield stamp [ns], position ENU from the origin [m], velocity ENU [m/s] and attitude, at about ``rate`` [Hz]."""
    truth, step = recording.truth, max(round(1.0 / (rate * recording.truth.dt)), 1)
    for i in range(0, len(truth), step):
        stamp = recording.start_ns + round(truth.t[i] * 1e9)
        position = lla_to_enu(truth.lat[i], truth.lon[i], truth.alt[i], *recording.origin)
        yield stamp, position, truth.v_n[i], truth.q_nb[i]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return spin.run(SyntheticSensors, arguments, is_over=lambda node: node.is_over)
