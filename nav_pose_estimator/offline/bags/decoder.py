"""Messages of one topic of a bag: of a known layout, else by the definition that the bag carries."""

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
"""Of types that are not part of ROS itself: what a bag without definitions is taken to hold."""


class Decoder:
    """From bytes to messages with attributes, as rclpy would give them."""

    def __init__(self, topic: Topic) -> None:
        """Raises ``BagError`` for a type that neither the package nor the bag describes."""
        self._topic = topic
        self._store = None if topic.type in LAYOUTS else _typestore(topic)

    def __call__(self, payload: bytes) -> Any:
        """One message. Raises ``CdrError`` if it is damaged."""
        if self._store is None:
            return decode(self._topic.type, payload)
        try:
            return self._store.deserialize_cdr(payload, self._topic.type)
        except Exception as error:  # generated code raises whatever the damaged bytes lead to
            raise CdrError(f"a {self._topic.type} message is damaged ({error})") from None


def _typestore(topic: Topic) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    if topic.type not in store.types:
        definition = topic.definition or _DEFINITIONS.get(topic.type, "")
        if not definition:
            raise BagError(f"{topic.name} is of type {topic.type}, which the bag does not describe")
        try:
            types = get_types_from_msg(definition, topic.type)
            store.register({name: fields for name, fields in types.items() if name not in store.types})
        except Exception as error:  # whatever the grammar of the definitions stumbles over
            raise BagError(f"{topic.name}: the definition of {topic.type} cannot be read ({error})") from None
    return store
