"""Which topic of a bag plays which part: the default names, the user's remaps, and detection by type."""

from dataclasses import dataclass, field

from nav_pose_estimator.offline.bags.raw_messages import BagError, Topic

IMU, MAGNETOMETER, FIX, SATELLITES = "imu", "magnetometer", "fix", "satellites"
GNSS_VELOCITY, BAROMETER, BODY_VELOCITY, SET_POSE, TRUTH = (
    "gnss_velocity",
    "barometer",
    "body_velocity",
    "set_pose",
    "truth",
)


PX4_IMU = "px4_msgs/msg/SensorCombined"
COMBINED = ("gps_msgs/msg/GPSFix", "px4_msgs/msg/SensorGps")  # position, velocity and satellites in one message


@dataclass(frozen=True, slots=True)
class Part:
    """A part that a topic can play. ``words``: a topic of another name is taken only if it contains one of them."""

    name: str
    topic: str
    types: tuple[str, ...]
    words: tuple[str, ...] | None = None  # None: never detected; (): the type alone decides


PARTS = (
    Part(IMU, "/imu/data_raw", ("sensor_msgs/msg/Imu", PX4_IMU), ()),
    Part(MAGNETOMETER, "/imu/mag", ("sensor_msgs/msg/MagneticField",), ()),
    Part(FIX, "/gps/fix", ("sensor_msgs/msg/NavSatFix", *COMBINED), ()),
    Part(
        SATELLITES,
        "/gps/satellites",
        ("std_msgs/msg/UInt32", "mavros_msgs/msg/GPSRAW", "ublox_msgs/msg/NavPVT", *COMBINED),
        ("satellites", "gpsfix", "gps1/raw", "navpvt"),
    ),
    Part(
        GNSS_VELOCITY,
        "/gps/vel",
        ("geometry_msgs/msg/TwistWithCovarianceStamped", "geometry_msgs/msg/TwistStamped", *COMBINED),
        ("gps_vel", "gps/vel", "fix_velocity", "gnss/vel"),
    ),
    Part(BAROMETER, "/baro", ("sensor_msgs/msg/FluidPressure",), ()),
    Part(BODY_VELOCITY, "/body_velocity", ("geometry_msgs/msg/TwistWithCovarianceStamped",)),
    Part(SET_POSE, "/set_pose", ("geometry_msgs/msg/PoseWithCovarianceStamped",)),
    Part(TRUTH, "/ground_truth/odom", ("nav_msgs/msg/Odometry",)),
)
IGNORED = "ground_truth"  # topics below this name are never an input, whatever their type


@dataclass
class TopicMap:
    """Part name -> topic. ``notices`` tells the user what was assumed."""

    topics: dict[str, Topic] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)


def parse_remaps(texts: list[str]) -> dict[str, str]:
    """``/imu/data_raw:=/mavros/imu/data_raw`` -> name in this package to name in the bag."""
    remaps: dict[str, str] = {}
    known = {part.topic for part in PARTS}
    for text in texts:
        ours, mark, theirs = text.partition(":=")
        if not (mark and ours.strip() and theirs.strip()):
            raise BagError(f"--remap {text!r}: write OUR_TOPIC:=TOPIC_IN_THE_BAG")
        ours = _absolute(ours)
        if ours not in known:
            raise BagError(f"--remap {text!r}: there is no input {ours}; inputs are {', '.join(sorted(known))}")
        remaps[ours] = _absolute(theirs)
    return remaps


def map_topics(available: dict[str, Topic], remaps: dict[str, str]) -> TopicMap:
    """Find the topic of every part. Raises ``BagError`` without an IMU, or for a remap to what is not there."""
    found = TopicMap()
    for part in PARTS:
        wanted = remaps.get(part.topic, part.topic)
        if wanted in available:
            _take(found, part, available[wanted])
        elif part.topic in remaps:
            raise BagError(f"there is no topic {wanted} in the bag; {_listing(available)}")
    for part in PARTS:
        if part.name not in found.topics and part.words is not None:
            _detect(found, part, available)
    if IMU not in found.topics:
        candidates = [topic.name for topic in available.values() if topic.type in PARTS[0].types]
        if candidates:
            names = ", ".join(sorted(candidates))
            raise BagError(f"several topics could be the IMU ({names}): choose one with --remap /imu/data_raw:=TOPIC")
        raise BagError(f"the bag has no sensor_msgs/Imu topic, without which there is no pose; {_listing(available)}")
    if found.topics[IMU].type == PX4_IMU:
        found.notices.append(f"{found.topics[IMU].name} has the axes Forward-Right-Down: see config/driver_px4.yaml")
    return found


def _take(found: TopicMap, part: Part, topic: Topic) -> None:
    if topic.type not in part.types:
        expected = " or ".join(part.types)
        raise BagError(f"{topic.name} is of type {topic.type}; as {part.topic} it must be {expected}")
    if topic.encoding != "cdr":
        raise BagError(f"{topic.name} is serialized as {topic.encoding}; only cdr can be read")
    if topic.count == 0:
        found.notices.append(f"{topic.name} holds no message")
    found.topics[part.name] = topic


def _detect(found: TopicMap, part: Part, available: dict[str, Topic]) -> None:
    taken = {topic.name for topic in found.topics.values()}
    fix = found.topics.get(FIX)
    if fix is not None and fix.type in COMBINED and fix.type in part.types:
        found.topics[part.name] = fix
        return
    fitting = [
        topic
        for topic in available.values()
        if topic.type in part.types
        and topic.name not in taken
        and topic.encoding == "cdr"
        and IGNORED not in topic.name
        and (not part.words or any(word in topic.name for word in part.words))
    ]
    # A driver in a namespace keeps the last parts of the name; that beats any other topic of the type.
    namespaced = [topic for topic in fitting if topic.name.endswith(part.topic)]
    choice = namespaced if len(namespaced) == 1 else fitting
    if len(choice) == 1:
        found.topics[part.name] = choice[0]
        found.notices.append(f"{part.topic} is not in the bag: using {choice[0].name}")
    elif choice:
        names = ", ".join(sorted(topic.name for topic in choice))
        found.notices.append(f"{part.topic} is not in the bag and several could be it ({names}): choose with --remap")


def _listing(available: dict[str, Topic]) -> str:
    if not available:
        return "it holds no topics at all"
    topics = sorted(available.values(), key=lambda topic: topic.name)
    return "it holds " + ", ".join(f"{topic.name} ({topic.type or 'unknown type'})" for topic in topics)


def _absolute(name: str) -> str:
    return "/" + name.strip().lstrip("/")
