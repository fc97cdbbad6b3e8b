"""Quality of service: sensors are read best effort (that meets every publisher), results are written reliably.

Every profile can be overridden in YAML (``qos_overrides./topic.subscription.reliability`` ...). Where a peer does not
fit, rclpy logs the topic and the policy; messages that were lost on the way are handed to ``on_lost``.
"""

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

_DEPTH_OUT = 10


def sensor(depth: int) -> QoSProfile:
    """For inputs: best effort, the last ``depth`` messages."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def result() -> QoSProfile:
    """For outputs: reliable."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=_DEPTH_OUT, reliability=ReliabilityPolicy.RELIABLE)


def latched() -> QoSProfile:
    """For facts that a late subscriber must still get: reliable, transient local, the last one."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def subscribe(
    node: Node,
    kind: Any,
    topic: str,
    callback: Callable[[Any], None],
    profile: QoSProfile,
    raw: bool = False,
    on_lost: Callable[[int], None] | None = None,
) -> Any:
    """Subscribe with an overridable ``profile``; ``raw`` gives serialized messages, ``on_lost`` a number of losses."""
    lost = None if on_lost is None else lambda info: on_lost(info.total_count_change)
    return node.create_subscription(
        kind,
        topic,
        callback,
        profile,
        raw=raw,
        event_callbacks=SubscriptionEventCallbacks(message_lost=lost),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
    )


def advertise(node: Node, kind: Any, topic: str, profile: QoSProfile | None = None) -> Any:
    """Publish reliably, or with ``profile``; overridable."""
    return node.create_publisher(
        kind, topic, profile or result(), qos_overriding_options=QoSOverridingOptions.with_default_policies()
    )
