"""Quality of service: inputs are best effort, which is compatible with every publisher, and outputs are reliable.

Every profile can be overridden in YAML (``qos_overrides./topic.subscription.reliability`` ...). Incompatible peers are
reported: those of inputs in a sentence with the remedy (``on_misfit``) and on diagnostics (``misfits``), those of
outputs by rclpy. ``on_lost`` receives the number of lost messages.
"""

from collections.abc import Callable, Iterable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

_DEPTH_OUT = 10  # messages in the queue of an output


def sensor(depth: int) -> QoSProfile:
    """Profile for inputs: best effort, keep the last ``depth`` messages."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def result() -> QoSProfile:
    """Profile for outputs: reliable."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=_DEPTH_OUT, reliability=ReliabilityPolicy.RELIABLE)


def latched() -> QoSProfile:
    """Profile for states that late subscribers need: reliable, transient local, keep the last message."""
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
    on_misfit: Callable[[str], None] | None = None,
) -> Any:
    """Subscribe with an overridable ``profile``; with ``raw`` the callback receives serialized messages.

    ``on_lost`` receives the number of newly lost messages, ``on_misfit`` a sentence about an incompatible publisher.
    """
    lost = None if on_lost is None else lambda info: on_lost(info.total_count_change)
    misfit = None if on_misfit is None else lambda info: on_misfit(_misfit(node, topic, info.last_policy_kind))
    return node.create_subscription(
        kind,
        topic,
        callback,
        profile,
        raw=raw,
        event_callbacks=SubscriptionEventCallbacks(message_lost=lost, incompatible_qos=misfit),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
    )


def advertise(node: Node, kind: Any, topic: str, profile: QoSProfile | None = None) -> Any:
    """Create a publisher with the overridable ``profile``, by default that of outputs."""
    return node.create_publisher(
        kind, topic, profile or result(), qos_overriding_options=QoSOverridingOptions.with_default_policies()
    )


def has_subscriber(publisher: Any) -> bool:
    """Whether there is a subscriber: a query of 3 microseconds, against 60 to fill and publish a message in vain."""
    return publisher.get_subscription_count() > 0


def misfits(publishers: Iterable[Any], kind: str, profile: QoSProfile) -> list[str]:
    """Clauses that say which of ``publishers`` (topic endpoint infos) are incompatible, and why.

    ``kind`` is the type of the subscription, and ``profile`` its QoS.
    """
    found = []
    for peer in publishers:
        level, reason = qos_check_compatible(peer.qos_profile, profile)
        if peer.topic_type != kind:
            found.append(f"{_name(peer)} publishes {peer.topic_type}, {kind} is expected")
        elif level == QoSCompatibility.ERROR:  # a value of the middleware's own enumeration, not the same object
            found.append(f"{_name(peer)} offers incompatible QoS ({reason.removeprefix('ERROR: ').rstrip(';')})")
    return found


def _misfit(node: Node, topic: str, policy_kind: Any) -> str:
    """Sentence about a publisher that offers less than the subscription requests."""
    name, policy = node.resolve_topic_name(topic), qos_policy_name_from_kind(policy_kind)
    return (
        f"a publisher on {name} offers incompatible QoS ({policy}); nothing is received from it: "
        f"change its QoS, or qos_overrides.{name}.subscription.{policy.lower()} of this node"
    )


def _name(peer: Any) -> str:
    return f"{peer.node_namespace.rstrip('/')}/{peer.node_name}"
