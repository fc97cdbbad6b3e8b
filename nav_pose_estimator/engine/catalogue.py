"""Every event: what it means and what to do about it. Diagnostics, log and documentation take their wording from here.

The name of an event is its counter on ``/diagnostics``. A ``*`` in a name stands for one word. The page
``docs/troubleshooting.md`` is made from this table, and a test compares it with the names in the code.
"""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache


@dataclass(frozen=True)
class Entry:
    """One kind of event: ``meaning`` is a clause for the pilot, ``cure`` what to do; empty where nothing is wrong."""

    name: str
    meaning: str
    cure: str = ""


_CLOCKS = "synchronise the clocks of driver and host (chrony, PX4 and MAVROS time sync)"
_SENSOR = "check the driver and the wiring; a few are harmless"
_WAIT = "wait; if it persists, check the count on the driver's topic"

SECTIONS: dict[str, tuple[Entry, ...]] = {
    "Start, modes and operator": (
        Entry("aligned", "attitude and position are known, the navigator runs"),
        Entry("reset", "the navigator restarts; the log line says why", "see the reason in the log line"),
        Entry("attitude.reset", "the attitude filter restarts", "see the reason in the log line"),
        Entry("mode.*", "the mode has changed to the one in the name"),
        Entry("mode.use_gnss", "an operator has switched GNSS off or on", "call ~/use_gnss with true to use it again"),
        Entry("parameters.changed", "parameters were changed in flight"),
        Entry("set_pose", "the pose was set from outside"),
        Entry("set_pose.rejected.frame", "a pose came in a frame that is not map", "publish it in ros.frames.map"),
        Entry("set_pose.rejected.nan", "a pose was not finite, or its orientation was invalid", "check its publisher"),
        Entry("set_pose.rejected.stamp", "a pose came without a stamp", "let whoever publishes set_pose stamp it"),
        Entry("set_pose.rejected.value", "a pose held no numbers or no rotation", "look at who publishes set_pose"),
        Entry("set_pose.rejected.far", "a pose lay far from where the navigator is", "look at who publishes set_pose"),
        Entry(
            "doubt.begun",
            "GNSS keeps contradicting the navigator: its sigma grows until they agree",
            "set gnss.delay and gnss.lever_arm; look for vibration of the IMU",
        ),
        Entry("doubt.ended", "GNSS and the navigator agree again"),
        Entry("set_pose.rejected.no_origin", "a pose came before the origin was known", "wait for AIDED once"),
        Entry("qos.incompatible", "a publisher's QoS is incompatible: nothing is received", "see the log line"),
        Entry("callback.failed.*", "a message caused an error in this package and was not used", "please report it"),
        Entry("output.withheld.nan", "a solution was not finite and was not published", "please report it with a bag"),
    ),
    "The way back to the autopilot": (
        Entry("autopilot.sending", "the autopilot gets the pose from now on; the sentence says what is missing"),
        Entry("autopilot.silent", "the autopilot no longer gets the pose; the sentence says why"),
        Entry("autopilot.dry_run", "what would have been sent", "set ros.output.autopilot_dry_run to false to send it"),
        Entry(
            "autopilot.feedback",
            "gps/fix repeats the pose that the autopilot gets from here: a feedback loop, its fixes are not used",
            "give gps/fix and gps/vel the topics of the receiver itself, not of what the autopilot has fused; after"
            " EXPIRED start the node again",
        ),
        Entry("autopilot.feedback.fixes", "a fix that lay on our own track and was not used", "see autopilot.feedback"),
        Entry("autopilot.feedback.ended", "gps/fix no longer repeats our own pose"),
        Entry(
            "autopilot.feedback.topic",
            "gps/fix is mapped to the position that the autopilot has fused",
            "map it to the receiver: global_position/raw/fix of MAVROS, vehicle_gps_position of PX4",
        ),
    ),
    "IMU": (
        Entry("imu.gap", "no IMU data for longer than imu.max_gap: aligning again", "find out why the IMU stopped"),
        Entry(
            "imu.clock_jump", "the IMU's stamps went back: aligning again", "a looping bag does this; else " + _CLOCKS
        ),
        Entry(
            "imu.stuck", "a sensor repeats one value exactly", "power-cycle it; with a noise-free simulator ignore it"
        ),
        Entry("imu.stuck.ended", "the values change again"),
        Entry(
            "imu.saturated.gyroscope", "the gyroscope is at the limit of its range", "choose a wider range, fly gently"
        ),
        Entry("imu.saturated.accelerometer", "the accelerometer is at the limit of its range", "as for the gyroscope"),
        Entry("imu.saturated.ended", "the IMU is within its range again"),
        Entry(
            "imu.rejected.absent",
            "the message has no rate or no acceleration",
            "use the raw topic; have the driver combine gyroscope and accelerometer",
        ),
        Entry("imu.rejected.backward", "a stamp older than the previous one", _SENSOR),
        Entry(
            "imu.rejected.duplicate",
            "two samples with the same stamp",
            "the driver sends samples twice or stamps coarsely",
        ),
        Entry("imu.rejected.forward", "a stamp far ahead, not yet confirmed by a second one", _SENSOR),
        Entry("imu.rejected.force", "a specific force above imu.max_force", "check the unit: m/s^2, not g"),
        Entry("imu.rejected.rate", "an angular rate above imu.max_rate", "check the unit: rad/s, not degrees"),
        Entry(
            "imu.implausible.in_g",
            "the mean specific force is about 1: no alignment",
            "let the driver send m/s^2 (REP-103): multiply by 9.80665",
        ),
        Entry(
            "imu.implausible.no_gravity",
            "the mean specific force is about 0: no alignment",
            "use the driver's raw acceleration, not its linear one",
        ),
        Entry(
            "imu.implausible.force_scale",
            "the specific force at rest is not that of gravity: no alignment",
            "check unit and range of the accelerometer",
        ),
        Entry(
            "imu.implausible.upside_down",
            "gravity pulls towards the top of the body: no alignment",
            "set imu.convention (frd) or imu.mounting_rpy, or turn the sign in the driver",
        ),
        Entry(
            "imu.implausible.no_accelerometer",
            "the accelerometer reads exactly zero: no alignment",
            "let the driver join gyroscope and accelerometer (realsense: unite_imu_method)",
        ),
        Entry("imu.implausible.no_gyroscope", "the gyroscope reads exactly zero: no alignment", "as above"),
        Entry("imu.implausible.dead_axis", "an axis does not change while the others do", "replace the IMU"),
        Entry(
            "imu.implausible.two_imus",
            "two IMUs publish on one topic",
            "give each IMU a topic of its own; see ros2 topic info -v",
        ),
        Entry(
            "imu.implausible.motion",
            "the IMU tells another motion than GNSS velocity; the sentence names unit, sign or axes",
            "check rad/s, signs and axes of both sensors; if they are right: ros.input.velocity_frame, gnss.delay",
        ),
        Entry("imu.implausible.ended", "the IMU is plausible again: it aligns anew"),
        Entry("imu.vibration", "the IMU shakes heavily: expect errors of vertical velocity", "dampen its mount"),
        Entry("imu_doubt.used", "the IMU was dead, clipped or struck while GNSS was away: less certain from then on"),
        Entry(
            "navigator.distrusted",
            "without GNSS, an IMU that is none or a speed that the vehicle cannot fly: EXPIRED until GNSS is back",
            "see the reason in the log line",
        ),
        Entry("imu.rejected.nan", "a value that is not finite", _SENSOR),
        Entry("imu.rejected.zero_stamp", "a sample without a stamp", "make the driver stamp its messages"),
    ),
    "GNSS: the gate": (
        Entry("gnss.rejected.status", "the receiver reports no fix", "wait for a fix; check the antenna"),
        Entry("gnss.rejected.age", "the fix is older than gnss.gate.max_age", "set gnss.delay, or " + _CLOCKS),
        Entry(
            "gnss.rejected.accuracy",
            "the receiver states a larger error than the gate allows",
            "wait, or widen the gate",
        ),
        Entry("gnss.rejected.satellites", "too few satellites", "wait, or lower gnss.gate.min_satellites_enter"),
        Entry(
            "gnss.rejected.null_island",
            "latitude and longitude are exactly zero, which is no fix",
            "wait for a fix; let the driver send no position before it",
        ),
        Entry(
            "gnss.rejected.future",
            "the fix has a stamp more than 1 s ahead of the IMU's time; the sentence says by how much and why",
            _CLOCKS + "; leap seconds and time zones are the driver's to correct",
        ),
        Entry(
            "gnss.rejected.stuck",
            "position and velocity repeat to the last digit while the vehicle moves",
            "power the receiver again; look at what repeats its messages",
        ),
        Entry(
            "gnss.rejected.height",
            "the height jumped while the position stayed; latitude and longitude are used",
            "let the driver give heights above the ellipsoid in every fix",
        ),
        Entry(
            "gnss.height.moved",
            "heights stay on another reference; the step is taken off them",
            "let the driver give heights above the ellipsoid in every fix",
        ),
        Entry(
            "gnss.height.missing",
            "a fix has no altitude: the height is the barometer's, or held",
            "let the driver fill the altitude; connect a barometer",
        ),
        Entry("gnss.rejected.value", "the fix holds NaN or an impossible latitude", _SENSOR),
        Entry("gnss.rejected.disabled", "GNSS is switched off by the operator", "call ~/use_gnss with true"),
        Entry(
            "gnss.rejected.before_imu", "a fix came before the first IMU sample", "if it persists, check imu/data_raw"
        ),
        Entry("gnss.rejected.zero_stamp", "a message came without a stamp", "make the driver stamp its messages"),
        Entry(
            "gnss.waiting.count_missing",
            "no satellite count has arrived yet",
            "publish gps/satellites, or set gnss.gate.satellite_source to the source you have, or to none",
        ),
        Entry("gnss.waiting.count_unknown", "the receiver does not know its satellite count (255)", _WAIT),
        Entry("gnss.waiting.count_stale", "the satellite count is older than gnss.gate.count_max_age", _WAIT),
        Entry("gnss.waiting.hold", "the satellite count has not been good for gnss.gate.hold yet", "wait"),
        Entry("gnss.count.unknown", "the satellite count became unknown; the gate stays as it was", _WAIT),
        Entry("gnss.count.stale", "the satellite count is stale; the gate stays as it was", _WAIT),
        Entry("gnss.count.out_of_order", "a satellite count older than the last one was ignored"),
        Entry("gnss.gate.opened", "enough satellites for long enough: GNSS may be used"),
        Entry("gnss.gate.closed", "too few satellites: GNSS is no longer used", "see gnss.gate.min_satellites_leave"),
        Entry(
            "gnss.gate.inactive",
            "no satellite count is available: status and accuracy alone decide",
            "publish gps/satellites, or set gnss.gate.satellite_source to none if this is intended",
        ),
    ),
    "GNSS: in the filter": (
        Entry("gnss.used.*", "a position or velocity was used"),
        Entry(
            "gnss.inflated.*",
            "a position or velocity was unlikely and was given less weight",
            "if there are many, raise gnss.position_sd",
        ),
        Entry(
            "gnss.rejected.position_innovation",
            "the position disagrees with the filter",
            "see gnss.rejected.innovation",
        ),
        Entry(
            "gnss.rejected.velocity_innovation",
            "the velocity disagrees with the filter",
            "check ros.input.velocity_frame, gnss.delay and gnss.lever_arm",
        ),
        Entry(
            "gnss.rejected.innovation",
            "the fix lies too far from where the filter expects it",
            "multipath or spoofing; if it persists, check gnss.delay, gnss.lever_arm and imu.convention",
        ),
        Entry(
            "gnss.drift",
            "fixes and their own velocities drift apart: the position is being pulled away",
            "do not trust GNSS: spoofing or severe multipath",
        ),
        Entry("gnss.drift.ended", "fixes and their velocities agree again"),
        Entry("gnss.drift.fixes", "a fix that came while positions and velocities drifted apart"),
        Entry(
            "gnss.rejected.velocity_axes",
            "a velocity whose axes contradict the way between fixes",
            "see gnss.velocity.axes",
        ),
        Entry(
            "gnss.velocity.axes.ned",
            "velocities look like North-East-Down and are not used",
            "set ros.input.velocity_frame to ned",
        ),
        Entry(
            "gnss.velocity.axes.turned",
            "velocities are as fast as the positions move, but in another direction; they are not used",
            "let the driver send East-North-Up; a velocity in body axes belongs on another topic",
        ),
        Entry(
            "gnss.velocity.axes.silent",
            "velocities stay zero while the positions move and are not used",
            "set ros.input.velocity to none",
        ),
        Entry("gnss.velocity.axes.ended", "velocities agree with the way between fixes again"),
        Entry(
            "gnss.velocity.turned",
            "velocities are North-East-Down beyond doubt; they are turned and used",
            "set ros.input.velocity_frame to ned",
        ),
        Entry(
            "gnss.velocity.vertical.silent",
            "the vertical velocity stays zero while the height changes and is not used",
            "set ros.input.vertical_velocity to false",
        ),
        Entry(
            "gnss.velocity.vertical.down",
            "the vertical velocity is positive down and is not used",
            "let the driver send it positive up",
        ),
        Entry(
            "gnss.noise.optimistic",
            "the receiver's errors are three or more times as large as it states (gnss.noise has found the factor)",
            "look for reflections and interference; else set gnss.position_sd, gnss.velocity_sd to what is true",
        ),
        Entry("gnss.noise.agrees", "the receiver's errors are about as large as it states again"),
        Entry("gnss.rejected.velocity_value", "a velocity that is not finite", _SENSOR),
        Entry(
            "gnss.rejected.velocity_without_fix", "a velocity came while fixes are refused", "see why fixes are refused"
        ),
        Entry(
            "gnss.rejected.velocity_without_position",
            "a velocity came while no position is used",
            "see why no position is used",
        ),
        Entry("gnss.velocity.rejected.invalid", "PX4 reports the velocity as invalid", "wait for a better fix"),
        Entry("*.rejected.future", "a stamp more than 1 s ahead of the IMU's time", _CLOCKS),
        Entry("*.rejected.late", "a message older than navigator.memory", _CLOCKS + ", or raise navigator.memory"),
    ),
    "GNSS: the return after an outage": (
        Entry("gnss.waiting.consistency", "too few consistent fixes since GNSS came back", "wait"),
        Entry("gnss.waiting.expected", "the fixes lie where they should, but have not lasted long enough", "wait"),
        Entry("gnss.rejected.expected", "the fixes lie where they should, but have not lasted long enough", "wait"),
        Entry(
            "gnss.waiting.contradiction",
            "the fixes agree with each other, but not with the filter",
            "wait: gnss.reacquisition.contradiction_time decides",
        ),
        Entry("gnss.rejected.contradiction", "consistent fixes contradict a filter that GNSS still aids", "see above"),
        Entry(
            "gnss.waiting.implausible",
            "the vehicle cannot have reached the position that the fixes give",
            "check gnss.reacquisition.max_speed; if it is right, the fixes are wrong",
        ),
        Entry("gnss.rejected.implausible", "fixes that the vehicle cannot have reached", "as above"),
        Entry(
            "gnss.waiting.inconsistent",
            "position and velocity of the fixes contradict each other",
            "check ros.input.velocity_frame and whether gps/vel is filled",
        ),
        Entry("gnss.rejected.inconsistent", "position and velocity of the fixes contradict each other", "as above"),
        Entry("gnss.waiting.ambiguous", "two series of fixes contradict each other", "wait: the longer one wins"),
        Entry(
            "gnss.held",
            "an unexpected return waits for a decision (policy hold)",
            "call ~/accept_return or ~/refuse_return",
        ),
        Entry("gnss.return.accepted", "the operator accepted the return of GNSS that was held"),
        Entry("gnss.return.refused", "the operator refused the return of GNSS that was held"),
        Entry("gnss.return.none", "a decision about a return was made, but none was held"),
        Entry("gnss.reacquired.*", "GNSS is back and used as a correction"),
        Entry(
            "gnss.reset.*",
            "GNSS is back and the position was reset to it; map jumped, odom did not",
            "after a long outage this is expected; otherwise look for spoofing",
        ),
    ),
    "Magnetometer, barometer and other aids": (
        Entry(
            "mag.disturbed",
            "the magnetic field is disturbed: heading by gyroscope alone",
            "keep away from steel and currents",
        ),
        Entry("mag.undisturbed", "the magnetic field is undisturbed again"),
        Entry(
            "mag.rejected.disturbed", "a field that is not the Earth's", "calibrate attitude.hard_iron and soft_iron"
        ),
        Entry(
            "mag.heading.wrong_start",
            "motion has shown that the magnetic heading of the start was wrong: aligned anew, it steers nothing",
            "calibrate (docs/calibration.md): attitude.hard_iron, aids.magnetometer_rpy",
        ),
        Entry(
            "mag.heading.disagrees",
            "the magnetic heading is not the one that motion shows; it steers nothing",
            "as above; the sentence says by how much and the likely cause",
        ),
        Entry(
            "mag.unit",
            "the field, or attitude.hard_iron, is in another unit than tesla; alignment does not believe it",
            "publish tesla, as sensor_msgs/MagneticField demands; write attitude.hard_iron in tesla",
        ),
        Entry("mag.heading.cause", "turns have shown what is wrong with the magnetic heading", "see the log line"),
        Entry("mag.heading.agrees", "the magnetic heading agrees with the motion again"),
        Entry("mag.ignored", "aids.magnetometer is false"),
        Entry("mag.declination.model", "the World Magnetic Model gave the declination at the first position"),
        Entry(
            "mag.declination.fallback",
            "the model gave no declination, so aids.declination is used; the log line says why",
            "pip install pygeomag, or set aids.declination",
        ),
        Entry("mag.rejected.nan", "a field that is not finite", _SENSOR),
        Entry("mag.rejected.value", "a field that is zero or not finite", _SENSOR),
        Entry("mag.rejected.no_attitude_yet", "a field came before the first IMU sample"),
        Entry("mag.rejected.stamp", "a field not newer than the previous one", _SENSOR),
        Entry("mag.rejected.stale", "a field half a second away from the IMU's time", _CLOCKS),
        Entry(
            "baro.rejected.unit",
            "a pressure that belongs to the height of GNSS in another unit than pascal",
            "let the driver send pascal",
        ),
        Entry(
            "baro.contradicts",
            "the barometer has moved away from the heights of GNSS; it is not used in an outage",
            "look for a blocked port, or one that the propellers blow on",
        ),
        Entry("baro.contradicts.ended", "barometer and GNSS heights agree again"),
        Entry("baro.rejected.value", "a pressure outside the atmospheric range", "check the unit: pascal, not hPa"),
        Entry("zero_velocity.rejected", "the IMU was still, but the filter is sure of motion: not rest"),
        Entry(
            "zero_velocity.withheld.rate",
            "the IMU was still, but for a rotation that its bias does not explain: not rest",
        ),
        Entry("zero_velocity.withheld.speed", "the IMU was still, but a low speed is not certain: not taken as rest"),
        Entry("body_velocity.rejected.value", "a velocity without a finite component", _SENSOR),
        Entry("airspeed.rejected.absent", "PX4 reports no airspeed", "check the pitot tube and its driver"),
        Entry("airspeed.rejected.value", "an airspeed that is not finite, or impossible", _SENSOR),
        Entry("airspeed.rejected.slow", "an airspeed below aids.airspeed_min, where a pitot tube is useless"),
        Entry("airspeed.*", "an airspeed was used, given less weight (inflated), or refused by the filter's gate"),
        Entry("range.rejected.value", "a distance to the ground that is not finite, or impossible", _SENSOR),
        Entry(
            "range.new_ground",
            "the ground was at another level for two seconds: heights are measured from there",
        ),
        Entry("ground_range.*", "a height above ground was used, given less weight (inflated), or refused by the gate"),
        Entry("range.rejected.outside", "no echo within the limits that the rangefinder states", "fly lower, or wait"),
        Entry(
            "outage.rejected.covariance",
            "a predicted velocity error that is not finite or lacks its covariance",
            "anfis_node sends both",
        ),
        Entry("outage.evidence", "what the flight so far says about the motion was used"),
        Entry("outage.evidence.redundant", "what the flight taught was not used, because the airspeed is better"),
        Entry("outage.evidence.network", "... and the network's prediction was part of it"),
        Entry(
            "outage.no_model", "GNSS is lost and anfis_node has no model yet", "fly longer with GNSS, or load a model"
        ),
        Entry("outage.reset", "the learner starts again", "see the reason in the log line"),
        Entry("outage.trained", "a training has ended and its result is adopted"),
        Entry("outage.training_failed", "a training gave no result; the model stays as it was", "see the log line"),
        Entry("outage.model.loaded", "a model was read from its file"),
        Entry("outage.model.saved", "the model was written to its file"),
        Entry(
            "outage.request_failed",
            "a request to train, load or save the model could not be met",
            "see the log line",
        ),
        Entry(
            "odometry.rejected.incomplete",
            "an odometry without orientation, covariance or finite values",
            "run one navigator",
        ),
        Entry(
            "*.rejected.before_imu", "a message came before the first IMU sample", "if it persists, check imu/data_raw"
        ),
        Entry("*.rejected.zero_stamp", "a message came without a stamp", "make the driver stamp its messages"),
        Entry(
            "*.covariance.*",
            "an invalid covariance (the last word says why) was treated as unknown",
            "correct the driver; until then the noise comes from the parameters",
        ),
        Entry("attitude.rejected.absent", "imu/data has no orientation", "let attitude_node publish imu/data"),
        Entry("*.used", "an aid was used"),
        Entry("*.inflated", "an aid was unlikely and was given less weight"),
        Entry(
            "*.rejected",
            "an aid disagreed with the filter and was not used",
            "if there are many, check its mounting and noise",
        ),
        Entry("navigator_velocity.ignored.heading_unknown", "the attitude filter does not know its heading yet"),
        Entry("navigator_velocity.rejected.nan", "the navigator's velocity is not finite", "please report it"),
        Entry("navigator_velocity.rejected.no_attitude_yet", "a velocity came before the first IMU sample"),
        Entry(
            "navigator_velocity.rejected.stamp", "a velocity not newer than the previous one", "run only one navigator"
        ),
        Entry(
            "navigator_velocity.rejected.orientation", "an odometry without an orientation", "run only one navigator"
        ),
    ),
}


@cache
def find(name: str) -> Entry | None:
    """The entry for the event ``name``: that of the exact name, else the first whose pattern fits."""
    entries = [entry for section in SECTIONS.values() for entry in section]
    exact = (entry for entry in entries if entry.name == name)
    return next(exact, None) or next((entry for entry in entries if fnmatchcase(name, entry.name)), None)


def in_words(name: str) -> str:
    """What the event ``name`` means; the name itself where it is unknown."""
    entry = find(name)
    return name if entry is None else entry.meaning
