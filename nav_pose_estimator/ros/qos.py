"""Quality of service: sensors are read best effort (that meets every publisher), results are written reliably.

Every profile can be overridden in YAML (``qos_overrides./topic.subscription.reliability`` ...). A peer that does not
fit is named: for inputs in a sentence with the cure (``on_misfit``) and on diagnostics (``misfits``), for outputs by
rclpy. Messages that were lost on the way are handed to ``on_lost``.
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
    on_misfit: Callable[[str], None] | None = None,
) -> Any:
    """Subscribe with an overridable ``profile``; ``raw`` gives serialized messages.

    ``on_lost`` gets a number of losses, ``on_misfit`` a sentence when a publisher comes that cannot be heard.
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
    """Publish reliably, or with ``profile``; overridable."""
    return node.create_publisher(
        kind, topic, profile or result(), qos_overriding_options=QoSOverridingOptions.with_default_policies()
    )


def is_heard(publisher: Any) -> bool:
    """Whether there is a subscriber. Asking costs 3 microseconds, filling and publishing a message for nobody 60."""
    return publisher.get_subscription_count() > 0


def misfits(publishers: Iterable[Any], kind: str, profile: QoSProfile) -> list[str]:
    """Why ``publishers`` (topic endpoint infos) are not heard by a subscription of type ``kind`` with ``profile``.

    One clause each, empty for those that fit.
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
    """The sentence for a publisher that offers less than the subscription asks for."""
    name, policy = node.resolve_topic_name(topic), qos_policy_name_from_kind(policy_kind)
    return (
        f"a publisher on {name} offers incompatible QoS ({policy}); nothing is received from it: "
        f"change its QoS, or qos_overrides.{name}.subscription.{policy.lower()} of this node"
    )


def _name(peer: Any) -> str:
    return f"{peer.node_namespace.rstrip('/')}/{peer.node_name}"
