"""Counts of one input topic, its losses and its publishers, for diagnostics."""

import math
import time
from typing import Any

from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.ros import qos, wording

_RECENT = 2.0  # s after the start in which an input without any message is not called silent


class InputWatch:
    """Counts the messages of one input, and measures their rate by a monotonic clock, for diagnostics only."""

    def __init__(self, node: Any, topic: str, needed: bool) -> None:
        """``node`` also has ``say``, to report the loss of the publisher."""
        self.topic = topic
        self._needed = needed
        self._losses, self._publishers = _Losses(), _Publishers(node, topic)
        self._total = self._total_then = self._lost_then = 0  # now; in all at the last report
        self._last = self._reported_at = time.monotonic()

    def attach(self, subscription: Any) -> None:
        """Report from now on publishers that are incompatible with ``subscription``."""
        self._publishers.subscription = subscription

    def saw(self) -> None:
        """Count a message that is processed."""
        self._total += 1

    def lost(self, count: int) -> None:
        """Count messages that the middleware reports as lost."""
        self._losses.reported += count

    def dropped(self) -> None:
        """Count a message that was dropped because the node is too far behind."""
        self._losses.dropped += 1

    def taken(self, number: int | None = None) -> None:
        """Count a message that was taken from the middleware; ``number`` is its publication number, if known."""
        self._losses.taken(number)

    @property
    def lost_so_far(self) -> int:
        """Number of messages that were published and did not reach the estimator."""
        return self._losses.total

    def report(self) -> wording.InputReport:
        """State of the input, with rate and losses since the last report."""
        self._publishers.look()
        self._losses.settle(self._publishers.count == 1)
        now, new, lately = time.monotonic(), self._total - self._total_then, self._losses.total - self._lost_then
        if new:
            self._last = now
        rate = new / max(now - self._reported_at, 1e-3)
        self._reported_at, self._total_then, self._lost_then = now, self._total, self._losses.total
        age = now - self._last
        return wording.InputReport(
            topic=self.topic,
            total=self._total,
            rate=rate,
            lost=self._losses.total,
            age=age if self._total or age < _RECENT else math.inf,
            publishers=self._publishers.count,
            needed=self._needed,
            misfits=self._publishers.misfits,
            lost_lately=lately,
            is_gone=self._publishers.is_gone,
        )


class _Losses:
    """Counts the messages that were published and did not reach the estimator.

    The middleware drops messages from a full queue silently. Their number is the increase of the publication number
    beyond that of the messages taken. With several publishers, which number their messages independently, it is
    unknown.
    """

    def __init__(self) -> None:
        self.reported = 0  # lost, as the middleware says
        self.dropped = 0  # by this node
        self._skipped = self._skipped_lately = 0  # by publication number: in all, since ``settle``
        self._taken = 0  # messages taken from the middleware
        self._numbered = 0, 0  # last known publication number, and how many messages were taken by then

    @property
    def total(self) -> int:
        """Lost messages in all."""
        return max(self.reported, self._skipped) + self.dropped

    def taken(self, number: int | None) -> None:
        """Count a message that was taken from the middleware; ``number`` is its publication number, if known."""
        self._taken += 1
        if number is None:
            return
        before, taken = self._numbered
        if before:
            self._skipped_lately += max(number - before - (self._taken - taken), 0)
        self._numbered = number, self._taken

    def settle(self, is_single: bool) -> None:
        """Count what was skipped since the last call if the topic has a single publisher; forget it otherwise."""
        if is_single:
            self._skipped += self._skipped_lately
        else:
            self._numbered = 0, 0
        self._skipped_lately = 0


class _Publishers:
    """The publishers of a topic; the loss of the last one is reported once."""

    def __init__(self, node: Any, topic: str) -> None:
        self.count = 0
        self.is_gone = False  # there was one, and there is none any more
        self.misfits: tuple[str, ...] = ()  # one clause for each that is incompatible with ``subscription``
        self.subscription: Any = None
        self._node, self._topic = node, topic
        self._had_one = False

    def look(self) -> None:
        """Ask the middleware for the publishers."""
        found = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(self._topic))
        self.count, self.misfits = len(found), tuple(self._misfits(found))
        self._had_one = self._had_one or bool(found)
        was_gone, self.is_gone = self.is_gone, self._had_one and not found
        if self.is_gone and not was_gone:
            self._node.say("input.gone", Level.WARN, f"{self._topic}: its publisher is gone")

    def _misfits(self, publishers: list[Any]) -> list[str]:
        if self.subscription is None:
            return []
        kind = self.subscription.msg_type
        package, name = kind.__module__.split(".")[0], kind.__name__
        return qos.misfits(publishers, f"{package}/msg/{name}", self.subscription.qos_profile)
