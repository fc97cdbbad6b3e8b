"""Publication of /diagnostics and ~/status with the texts of :mod:`wording`."""

from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from nav_pose_estimator.ros import qos, wording
from nav_pose_estimator.ros.load.input_watch import InputWatch
from nav_pose_estimator.ros.messages.outgoing import fill_stamp


class Diagnostics:
    """Publishes the state of one node."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._name = node.get_fully_qualified_name().lstrip("/")
        self._array = qos.advertise(node, DiagnosticArray, "/diagnostics")
        self._status = qos.advertise(node, DiagnosticStatus, "~/status", qos.latched())

    def publish(self, state: wording.Description, watches: list[InputWatch], counters: Mapping[str, int]) -> None:
        """Publish both topics. ``state``: level, sentence and facts."""
        reports = [watch.report() for watch in watches]
        level, text = wording.input_sentence(reports)
        counted = [(key, str(count)) for key, count in sorted(counters.items())]
        message = DiagnosticArray(
            status=[
                self.publish_status(*state),
                self._message("inputs", level, text, wording.input_facts(reports)),
                self._message("counters", wording.OK, f"{len(counted)} kinds of events", counted),
            ]
        )
        fill_stamp(message.header.stamp, self._node.get_clock().now().nanoseconds)
        self._array.publish(message)

    def publish_status(self, level: int, sentence: str, facts: list[tuple[str, str]]) -> Any:
        """Publish ~/status alone, as on a change of the mode; return its message."""
        state = self._message("", level, sentence, facts)
        self._status.publish(state)
        return state

    def _message(self, part: str, level: int, text: str, pairs: list[tuple[str, str]]) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=bytes([level]),
            name=f"{self._name}: {part}" if part else self._name,
            message=text,
            hardware_id=self._name,
            values=[KeyValue(key=key, value=value) for key, value in pairs],
        )
