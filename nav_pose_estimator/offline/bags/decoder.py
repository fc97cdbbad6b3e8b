"""Decoder of the messages of one topic of a bag, by a known layout or by the definition in the bag."""

from typing import Any

from nav_pose_estimator.offline.bags.raw_messages import BagError, Topic
from nav_pose_estimator.ros.messages.cdr import LAYOUTS, CdrError, decode

_DEFINITIONS = {
    "dvl_msgs/msg/DVL": f"""
std_msgs/Header header
float64 time
geometry_msgs/Vector3 velocity
float64 fom
float64 altitude
dvl_msgs/DVLBeam[] beams
bool velocity_valid
int64 status
string form
{"=" * 80}
MSG: dvl_msgs/DVLBeam
int64 id
float64 velocity
float64 distance
float64 rssi
float64 nsd
bool valid
""",
    "geographic_msgs/msg/GeoPointStamped": f"""
std_msgs/Header header
geographic_msgs/GeoPoint position
{"=" * 80}
MSG: geographic_msgs/GeoPoint
float64 latitude
float64 longitude
float64 altitude
""",
}
"""Definitions of types that are not part of ROS itself, for bags without definitions."""


class Decoder:
    """Converts bytes to messages with the attributes of rclpy."""

    def __init__(self, topic: Topic) -> None:
        """Raise ``BagError`` for a type of which neither the package nor the bag has a definition."""
        self._topic = topic
        self._store = None if topic.type in LAYOUTS else _typestore(topic)

    def __call__(self, payload: bytes) -> Any:
        """Decode one message. Raises ``CdrError`` if it is damaged."""
        if self._store is None:
            return decode(self._topic.type, payload)
        try:
            return self._store.deserialize_cdr(payload, self._topic.type)
        except Exception as error:  # the generated code raises various types
            raise CdrError(f"a {self._topic.type} message is damaged ({error})") from None


def _typestore(topic: Topic) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    if topic.type not in store.types:
        definition = topic.definition or _DEFINITIONS.get(topic.type, "")
        if not definition:
            raise BagError(f"{topic.name} is of type {topic.type}, of which the bag has no definition")
        try:
            types = get_types_from_msg(definition, topic.type)
            store.register({name: fields for name, fields in types.items() if name not in store.types})
        except Exception as error:  # the parser of definitions raises various types
            raise BagError(f"{topic.name}: the definition of {topic.type} cannot be read ({error})") from None
    return store
