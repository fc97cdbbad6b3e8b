"""Assignment of the topics of a bag to the inputs: by default names, by remaps of the user, and by type.

The inputs and their types are those of the message table. A parameter that selects a type (``ros.input.*``) applies as
in a node. If it has its default value, any type in the table is accepted, because a bag, unlike a future driver, shows
its types; a notice then names the value that a node needs.
"""

from dataclasses import dataclass, field

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.offline.bags import vehicles
from nav_pose_estimator.offline.bags.raw_messages import BagError, Topic
from nav_pose_estimator.ros.messages.message_table import FIX, GNSS, IMU, INPUTS, NONE, VELOCITY, Input, Source

TRUTH = "ground_truth/odom"
IGNORED = "ground_truth"  # topics below this name are never an input, whatever their type
NAMESPACE = "__ns"
_TRUTH_TYPE = "nav_msgs/msg/Odometry"
_COMBINED = {kind.name for kind in FIX.types} & {kind.name for kind in VELOCITY.types}
_MAVROS_VELOCITY = "raw/gps_vel"


@dataclass
class TopicMap:
    """Topic and source of each input. ``notices``: sentences for the user about assumptions."""

    topics: dict[str, Topic] = field(default_factory=dict)  # by the input's own topic
    sources: dict[str, Source] = field(default_factory=dict)
    truth: Topic | None = None
    notices: list[str] = field(default_factory=list)

    @property
    def imu(self) -> Topic:
        """Topic of the IMU, which always exists."""
        return self.topics[IMU.topic]


def parse_remaps(texts: list[str]) -> dict[str, str]:
    """Parse ``/imu/data_raw:=/mavros/imu/data_raw`` or ``__ns:=/drone1`` to names in the bag by own names."""
    remaps: dict[str, str] = {}
    known = {_absolute(name) for name in (*(one.topic for one in INPUTS), TRUTH)}
    for text in texts:
        ours, mark, theirs = (part.strip() for part in text.partition(":="))
        if not (mark and ours and theirs):
            raise BagError(f"--remap {text!r}: write OUR_TOPIC:=TOPIC_IN_THE_BAG")
        ours = ours if ours == NAMESPACE else _absolute(ours)
        if ours not in known and ours != NAMESPACE:
            inputs = ", ".join(sorted(known))
            raise BagError(
                f"--remap {text!r}: there is no input {ours}; inputs are {inputs} ({NAMESPACE}: all of them)"
            )
        remaps[ours] = _absolute(theirs).rstrip("/")
    return remaps


def map_topics(available: dict[str, Topic], remaps: dict[str, str], parameters: Parameters | None = None) -> TopicMap:
    """Find the topic of every input. Raises ``BagError`` without an IMU, or for a remap to a missing topic."""
    search = _Search(available, remaps, parameters or Parameters())
    search.take_named()
    search.detect()
    search.take_truth()
    found = search.found
    if IMU.topic not in found.topics:
        raise BagError(_why_there_is_no_imu(available, search.candidates_of_imu))
    if FIX.topic not in found.topics and not any(_absolute(FIX.topic) in notice for notice in found.notices):
        found.notices.append("the bag has no GNSS fix, without which there is no position")
    if found.imu.type != IMU.types[0].name:
        found.notices.append(f"{found.imu.name} has the axes Forward-Right-Down: see config/driver_px4.yaml")
    return found


class _Search:
    """Search for the topics of one vehicle in a bag."""

    def __init__(self, available: dict[str, Topic], remaps: dict[str, str], parameters: Parameters) -> None:
        self._available, self._remaps, self._parameters = available, remaps, parameters
        self._namespace = remaps.get(NAMESPACE, "")
        if self._namespace and not any(name.startswith(f"{self._namespace}/") for name in available):
            raise BagError(f"there is no topic below {self._namespace} in the bag; {_listing(available)}")
        self.found = TopicMap()
        self.candidates_of_imu: list[str] = []
        self._of_others: tuple[str, ...] = ()  # namespaces of other vehicles

    def take_named(self) -> None:
        """Assign topics with the default or remapped names of inputs."""
        for one in INPUTS:
            asked = _absolute(one.topic) in self._remaps
            name = self._name(one.topic)
            if name in self._available:
                self._take(one, self._available[name], asked)
            elif asked:
                raise BagError(f"there is no topic {name} in the bag; {_listing(self._available)}")

    def detect(self) -> None:
        """Assign topics to missing inputs by type and words; first the IMU, because it identifies the vehicle."""
        imus = [topic.name for topic in self._fitting(IMU)]
        if IMU.topic not in self.found.topics:
            self._detect(IMU)
        if IMU.topic in self.found.topics and not _are_halves(imus):
            self._of_others = vehicles.others(self.found.imu.name, imus)
        rest = sorted((one for one in INPUTS if one is not IMU), key=lambda one: one is not FIX)
        for one in rest:
            if one.topic not in self.found.topics and one.words is not None:
                self._detect(one)
        if self._of_others:
            names = ", ".join(self._of_others)
            self.found.notices.append(f"topics below {names} are taken as another vehicle's: choose one with --remap")

    def take_truth(self) -> None:
        """Find the topic of the true motion of the vehicle, if there is one."""
        name, plain = self._name(TRUTH), _absolute(TRUTH)
        truth = self._available.get(name)
        if truth is None and plain in self._remaps:
            raise BagError(f"there is no topic {name} in the bag; {_listing(self._available)}")
        if self._of_others and plain not in self._remaps:
            truth = None
        if truth is not None and truth.type == _TRUTH_TYPE and truth.encoding == "cdr":
            self.found.truth = truth
        elif plain in self._available:
            text = f"{plain} is not used, because it may be another vehicle's: --remap {plain}:={plain} takes it"
            self.found.notices.append(text)

    def _name(self, topic: str) -> str:
        return self._remaps.get(_absolute(topic), f"{self._namespace}/{topic}")

    def _source(self, one: Input, topic: Topic) -> Source | None:
        """Source that reads ``topic`` as ``one``; None if the parameters or the table exclude its type."""
        is_default = one.choice(self._parameters) == one.types[0].choice
        wanted = one.source(self._parameters)
        if wanted is None or not (is_default or wanted.type == topic.type):
            return None
        parameters = self._parameters
        if one is VELOCITY and topic.name.endswith(_MAVROS_VELOCITY):
            parameters = update(parameters, {"ros.input.vertical_velocity": False})
        return one.source(parameters, topic.type)

    def _take(self, one: Input, topic: Topic, asked: bool) -> None:
        """Assign ``topic``, with the name of ``one``; if unreadable, it is an error if ``asked`` for or for the IMU."""
        source = self._source(one, topic)
        trouble = ""
        if topic.encoding != "cdr":
            trouble = f"{topic.name} is serialized as {topic.encoding}; only cdr can be read"
        elif source is None and one.choice(self._parameters) == NONE:
            trouble = f"{topic.name} is not used: {one.parameter} is {NONE}"
        elif source is None:
            trouble = f"{topic.name} is of type {topic.type}; as {_absolute(one.topic)} it must be {self._types(one)}"
        if trouble and (asked or one is IMU) and "ros1" not in topic.encoding:
            raise BagError(trouble)
        if trouble or source is None:
            self.found.notices.append(f"{trouble}: left out")
            return
        if topic.count == 0:
            self.found.notices.append(f"{topic.name} holds no message")
        self._use(one, topic, source)

    def _types(self, one: Input) -> str:
        """Clause with the types that ``one`` may have, and the parameter that selects them."""
        choice = one.choice(self._parameters)
        if choice == one.types[0].choice:
            return " or ".join(kind.name for kind in one.types)
        return f"{next(kind.name for kind in one.types if kind.choice == choice)}, for {one.parameter} is {choice}"

    def _use(self, one: Input, topic: Topic, source: Source) -> None:
        self.found.topics[one.topic], self.found.sources[one.topic] = topic, source
        choice = next(kind.choice for kind in one.types if kind.name == topic.type)
        if choice != one.choice(self._parameters):
            self.found.notices.append(f"{topic.name} is of type {topic.type}: a node needs {one.parameter}: {choice}")
        if one is VELOCITY and topic.name.endswith(_MAVROS_VELOCITY):
            text = f"MAVROS does not fill the vertical velocity of {topic.name}: it is not used"
            self.found.notices.append(f"{text} (in a node: ros.input.vertical_velocity: false)")

    def _fitting(self, one: Input) -> list[Topic]:
        return [
            topic
            for topic in self._available.values()
            if topic.name.startswith(f"{self._namespace}/")
            and topic.encoding == "cdr"
            and IGNORED not in topic.name
            and not any(topic.name.startswith(f"{other}/") for other in self._of_others)
            and self._source(one, topic) is not None
            and (not one.words or any(word in topic.name for word in one.words))
        ]

    def _detect(self, one: Input) -> None:
        fix = self.found.topics.get(FIX.topic)
        if one in GNSS and fix is not None and fix.type in _COMBINED:
            source = self._source(one, fix)
            if source is not None:
                self._use(one, fix, source)
                return
        taken = {topic.name for topic in self.found.topics.values()}
        fitting = [topic for topic in self._fitting(one) if topic.name not in taken]
        if one is IMU:
            self.candidates_of_imu = sorted(topic.name for topic in fitting)
        # a topic that differs from the default name only by a namespace is preferred to others of its type
        namespaced = [topic for topic in fitting if topic.name.endswith(_absolute(one.topic))]
        choice = namespaced if len(namespaced) == 1 else fitting
        ours = _absolute(one.topic)
        source = self._source(one, choice[0]) if len(choice) == 1 else None
        if source is not None:
            self.found.notices.append(f"{ours} is not in the bag: using {choice[0].name}")
            self._use(one, choice[0], source)
        elif choice:
            names = ", ".join(sorted(topic.name for topic in choice))
            self.found.notices.append(
                f"{ours} is not in the bag and several could be it ({names}): choose with --remap"
            )


def _why_there_is_no_imu(available: dict[str, Topic], candidates: list[str]) -> str:
    ours, names = _absolute(IMU.topic), ", ".join(candidates)
    if _are_halves(candidates):
        return (
            f"gyroscope and accelerometer are on two topics ({names}), but are needed in one message: let the driver"
            " join them (realsense2_camera: unite_imu_method 2) and record that topic"
        )
    if several := vehicles.namespaces(candidates):
        option = f"--remap {NAMESPACE}:={several[0]}"
        return f"the bag holds several vehicles or IMUs ({', '.join(several)}): choose one with {option}"
    if candidates:
        return f"several topics could be the IMU ({names}): choose one with --remap {ours}:=TOPIC"
    return f"the bag has no sensor_msgs/Imu topic, without which there is no pose; {_listing(available)}"


def _are_halves(imus: list[str]) -> bool:
    """Whether the IMU topics of a bag are a separate gyroscope and accelerometer, by their names."""
    return len(imus) == 2 and sum("gyro" in name for name in imus) == 1 == sum("acc" in name for name in imus)


def _listing(available: dict[str, Topic]) -> str:
    if not available:
        return "it holds no topics at all"
    topics = sorted(available.values(), key=lambda topic: topic.name)
    return "it holds " + ", ".join(f"{topic.name} ({topic.type or 'unknown type'})" for topic in topics)


def _absolute(name: str) -> str:
    return "/" + name.strip().lstrip("/")
