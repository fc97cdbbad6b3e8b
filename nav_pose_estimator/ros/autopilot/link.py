"""Link of a node to an autopilot: sends the solutions that may be sent, and removes them where they return as fixes."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from nav_pose_estimator.core.filter.layout import DPOS
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.ros import OutputParameters
from nav_pose_estimator.engine.parameters.schema import ParameterError
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavSolution
from nav_pose_estimator.ros import qos
from nav_pose_estimator.ros.autopilot.channels import Channel, MavrosGps, MavrosOdometry, Px4Odometry
from nav_pose_estimator.ros.autopilot.echo import EchoWatch, Finding
from nav_pose_estimator.ros.autopilot.permission import Permission
from nav_pose_estimator.ros.autopilot.px4_clock import reference
from nav_pose_estimator.ros.messages import installed
from nav_pose_estimator.ros.messages.message_table import FIX, VELOCITY, Source
from nav_pose_estimator.ros.pace import Pace

_CHANNELS: dict[str, tuple[str, str, type[Any]]] = {
    "mavros": ("nav_msgs/msg/Odometry", "autopilot/odometry", MavrosOdometry),
    "mavros_gps": ("mavros_msgs/msg/GPSINPUT", "autopilot/gps_input", MavrosGps),
    "px4": ("px4_msgs/msg/VehicleOdometry", "fmu/in/vehicle_visual_odometry", Px4Odometry),
}
_PX4_SAYS = "fmu/out/vehicle_local_position"  # topic with the reference of PX4's local frame
_FUSED_TOPICS = ("global_position/global", "vehicle_global_position")  # names of the fused positions of autopilots
_DRY_RUN_RATE = 1.0  # Hz: rate of the log lines of a dry run
_MAX_PAUSE_NS = 1_000_000_000  # longest time between two solutions without a new ``begin``


def autopilot_link(node: Any, parameters: Parameters) -> "AutopilotLink | NoLink":
    """Link to the autopilot that the parameters select; ``ParameterError`` where it is not possible."""
    word = parameters.ros.output.autopilot
    return NoLink() if word == "none" else AutopilotLink(node, parameters)


class NoLink:
    """Stands for the link where there is no autopilot: nothing is sent, and no fix is removed."""

    def publish(self, solution: NavSolution) -> None:
        """Do nothing."""

    def screened(self, source: Source) -> Source:
        """``source`` unchanged."""
        return source


class AutopilotLink:
    """Sends solutions to one autopilot; ``screened`` inputs discard fixes that repeat them."""

    def __init__(self, node: Any, parameters: Parameters) -> None:
        wanted = parameters.ros.output
        type_name, topic, make = _CHANNELS[wanted.autopilot]
        _check(wanted)
        kind = message_class(type_name, wanted.autopilot)
        self._node, self._dry = node, wanted.autopilot_dry_run
        self.channel: Channel = make(kind(), parameters.ros)
        self._publisher = None if self._dry else qos.advertise(node, kind, topic)
        self._topic = node.resolve_topic_name(topic)
        self._permission = Permission(wanted.autopilot_when == "always")
        self._pace = Pace(min(wanted.autopilot_rate, _DRY_RUN_RATE) if self._dry else wanted.autopilot_rate)
        self._sends = False
        self._echo = EchoWatch()
        if isinstance(self.channel, Px4Odometry):
            says = message_class("px4_msgs/msg/VehicleLocalPosition", wanted.autopilot)
            qos.subscribe(node, says, _PX4_SAYS, self._hear_px4, qos.sensor(5))
        self._newest_ns = 0
        self._warn_of_fused_topic()

    # --- out -------------------------------------------------------------------------------------------------------

    def publish(self, solution: NavSolution) -> None:
        """Send ``solution`` if its mode permits it and the rate has it due."""
        since_ns, self._newest_ns = solution.stamp_ns - self._newest_ns, solution.stamp_ns
        may = self._permission.ask(solution.mode)
        if may is not self._sends:
            self._sends = may
            self._turn(solution)
        elif may and not 0 <= since_ns <= _MAX_PAUSE_NS:
            self.channel.begin(solution)  # the navigator restarted in between
        if not may or not self._pace.is_due(solution.stamp_ns):
            return
        self.channel.fill(solution)
        if self._publisher is None:
            self._node.say("autopilot.dry_run", Level.INFO, f"dry run, not sent: {_in_words(solution)}")
            return
        self._publisher.publish(self.channel.message)
        if solution.mode in DENIED:
            self._echo.sent(solution.stamp_ns, solution.lat, solution.lon, _horizontal_sigma(solution))
        else:
            self._echo.stopped()

    def _turn(self, solution: NavSolution) -> None:
        """Report that sending begins or ends, and begin it."""
        if not self._sends:
            self._echo.stopped()
            level = Level.INFO if solution.mode is Mode.AIDED else Level.WARN
            why = self._permission.why_not(solution.mode)
            self._node.say("autopilot.silent", level, f"the autopilot no longer gets the pose: {why}")
            return
        self.channel.begin(solution)
        lack = self._lack()
        text = f"the autopilot gets the pose on {self._topic}{lack}"
        self._node.say("autopilot.sending", Level.WARN if lack else Level.INFO, text)

    def _lack(self) -> str:
        """Clause that says why the autopilot cannot make full use of the pose; empty if it can."""
        if self._publisher is None:
            return " (dry run: it is only logged)"
        lack = "" if qos.has_subscriber(self._publisher) else ", but nobody listens there"
        if isinstance(self.channel, Px4Odometry) and self.channel.reference is None:
            topic = self._node.resolve_topic_name(_PX4_SAYS)
            lack += f"; velocity only, because PX4 has not published the reference of its local frame on {topic}"
        return lack

    # --- in --------------------------------------------------------------------------------------------------------

    def screened(self, source: Source) -> Source:
        """``source`` without the fixes that repeat the sent pose, and without their velocities."""
        if source.topic not in (FIX.topic, VELOCITY.topic):
            return source
        adapter: Callable[[Any], tuple[Any, ...]] = source.adapter
        return replace(source, adapter=lambda message: tuple(out for x in adapter(message) for out in self._admit(x)))

    def _admit(self, item: Any) -> tuple[Any, ...]:
        if isinstance(item, GnssVelocity):
            return () if self._echo.suspects else (item,)
        if not isinstance(item, GnssFix):
            return (item,)
        finding = self._echo.judge(item)
        if finding is Finding.NONE:
            return (item,)
        if finding is Finding.ENDED:
            text = "gps/fix no longer repeats the sent pose"
            return (Event(item.stamp_ns, "autopilot.feedback.ended", Level.INFO, text), item)
        if finding is Finding.LOOP:
            text = (
                f"{self._node.resolve_topic_name(FIX.topic)} repeats the pose that is sent to the autopilot: it is"
                " not GNSS and is not used; map gps/fix to the receiver's own topic"
            )
            return (Event(item.stamp_ns, "autopilot.feedback", Level.ERROR, text),)
        return (Event(item.stamp_ns, "autopilot.feedback.fixes"),)

    def _hear_px4(self, message: Any) -> None:
        assert isinstance(self.channel, Px4Odometry)
        if self._newest_ns:
            self.channel.clock.note(int(message.timestamp), self._newest_ns)
        self.channel.reference = reference(message) or self.channel.reference

    def _warn_of_fused_topic(self) -> None:
        name = self._node.resolve_topic_name(FIX.topic)
        if name.endswith(_FUSED_TOPICS):
            text = f"gps/fix is {name}, the autopilot's fused position: it contains the sent pose and is not pure GNSS"
            self._node.say("autopilot.feedback.topic", Level.WARN, text)


def message_class(name: str, word: str) -> Any:
    """Class of the message ``name`` that the autopilot ``word`` needs; ``ParameterError`` where it is not installed."""
    wanted = f"ros.output.autopilot is {word}, which needs {name.replace('/msg/', '/')}"
    return installed.message_class(name, wanted, "choose another word")


def _check(wanted: OutputParameters) -> None:
    if wanted.autopilot == "mavros_gps" and not wanted.knows_geoid:
        raise ParameterError(
            "ros.output.autopilot is mavros_gps, which needs heights above the sea: set ros.output.autopilot_geoid "
            "to the height of the geoid above the ellipsoid where you fly (EGM96; 47 m in Zurich)"
        )


def _horizontal_sigma(solution: NavSolution) -> float:
    return math.sqrt(float(solution.cov[DPOS, DPOS] + solution.cov[DPOS + 1, DPOS + 1]))


def _in_words(solution: NavSolution) -> str:
    lat, lon = math.degrees(solution.lat), math.degrees(solution.lon)
    speed = math.hypot(*solution.vel_n.tolist())
    return (
        f"{lat:.7f} {lon:.7f} deg, {solution.alt:.1f} m above the ellipsoid, {speed:.1f} m/s, "
        f"good to {_horizontal_sigma(solution):.1f} m, {solution.mode.value}"
    )
