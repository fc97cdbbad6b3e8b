"""Publication of /diagnostics and ~/status with the texts of :mod:`wording`."""

import time
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.ros import qos, wording
from nav_pose_estimator.ros.messages.outgoing import fill_stamp


class InputWatch:
    """Counts the messages of one input, and measures their rate by a monotonic clock, for diagnostics only."""

    def __init__(self, node: Any, topic: str, needed: bool) -> None:
        """``node`` also has ``say``, to report the loss of the publisher."""
        self.topic = topic
        self._node, self._needed = node, needed
        self._total = self._reported = self._lost_reported = 0
        self._reported_lost = self._skipped = self._dropped = 0
        self._taken = 0  # messages taken from the middleware
        self._numbered = 0, 0  # last known publication number, and how many messages were taken by then
        self._skipped_lately = 0
        self._had_publisher = self._is_gone = False
        self._last = self._reported_at = time.monotonic()
        self._ever = False
        self._subscription: Any = None

    def attach(self, subscription: Any) -> None:
        """Report from now on publishers that are incompatible with ``subscription``."""
        self._subscription = subscription

    def saw(self) -> None:
        """Count a message that is processed."""
        self._total += 1

    def lost(self, count: int) -> None:
        """Count messages that the middleware reports as lost."""
        self._reported_lost += count

    def dropped(self) -> None:
        """Count a message that was dropped because the node is too far behind."""
        self._dropped += 1

    def taken(self, number: int | None = None) -> None:
        """Count a message that was taken from the middleware; ``number`` is its publication number, if known.

        The middleware drops messages from a full queue silently. Their number is the increase of the publication number
        beyond that of the messages taken. With several publishers, which number their messages independently, it is
        unknown (``report``).
        """
        self._taken += 1
        if number is None:
            return
        before, taken = self._numbered
        if before:
            self._skipped_lately += max(number - before - (self._taken - taken), 0)
        self._numbered = number, self._taken

    @property
    def lost_so_far(self) -> int:
        """Number of messages that were published and did not reach the estimator."""
        return max(self._reported_lost, self._skipped) + self._dropped

    def report(self) -> wording.InputReport:
        """State of the input, with rate and losses since the last report."""
        now, new = time.monotonic(), self._total - self._reported
        if new:
            self._last, self._ever = now, True
        rate = new / max(now - self._reported_at, 1e-3)
        self._reported, self._reported_at = self._total, now
        age = now - self._last if self._ever or now - self._last < 2.0 else float("inf")
        publishers = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(self.topic))
        if len(publishers) == 1:
            self._skipped += self._skipped_lately
        else:
            self._numbered = 0, 0
        self._skipped_lately = 0
        lost, lately = self.lost_so_far, self.lost_so_far - self._lost_reported
        self._lost_reported = lost
        self._had_publisher = self._had_publisher or bool(publishers)
        is_gone = self._had_publisher and not publishers
        if is_gone and not self._is_gone:
            self._node.say("input.gone", Level.WARN, f"{self.topic}: its publisher is gone")
        self._is_gone = is_gone
        return wording.InputReport(
            topic=self.topic,
            total=self._total,
            rate=rate,
            lost=lost,
            age=age,
            publishers=len(publishers),
            needed=self._needed,
            misfits=tuple(self._misfits(publishers)),
            lost_lately=lately,
            is_gone=is_gone,
        )

    def _misfits(self, publishers: list[Any]) -> list[str]:
        if self._subscription is None:
            return []
        kind = self._subscription.msg_type
        package, name = kind.__module__.split(".")[0], kind.__name__
        return qos.misfits(publishers, f"{package}/msg/{name}", self._subscription.qos_profile)


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
