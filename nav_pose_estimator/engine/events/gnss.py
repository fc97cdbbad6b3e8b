"""GNSS: gate, filter and return."""

from nav_pose_estimator.engine.events.entry import CLOCKS, SENSOR, WAIT, Entry

SECTIONS: dict[str, tuple[Entry, ...]] = {
    "GNSS: the gate": (
        Entry("gnss.rejected.status", "the receiver reports no fix", "wait for a fix; check the antenna"),
        Entry("gnss.rejected.age", "the fix is older than gnss.gate.max_age", "set gnss.delay, or " + CLOCKS),
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
            CLOCKS + "; the driver has to correct leap seconds and time zones",
        ),
        Entry(
            "gnss.stuck",
            "the position repeats to the last digit while the navigator moves away; it is refused until it changes",
            "power-cycle the receiver; check what repeats its messages",
        ),
        Entry(
            "gnss.rejected.stuck",
            "the position repeats to the last digit while the vehicle moves",
            "power-cycle the receiver; check what repeats its messages",
        ),
        Entry(
            "gnss.rejected.copy",
            "an old fix with a new stamp: a driver repeats each fix of a slow receiver; the first one is used",
            "let the driver publish each fix once, with the time at which it is valid",
        ),
        Entry(
            "gnss.rejected.axes",
            "positions whose latitude and longitude are exchanged, inverted or in radians",
            "see gnss.position.axes",
        ),
        Entry(
            "gnss.position.axes",
            "positions and velocities contradict each other; the IMU confirms the velocities; positions are not used",
            "let the driver send degrees, latitude North and longitude East positive, in their own fields",
        ),
        Entry(
            "gnss.rejected.height",
            "the height jumped while the position stayed; latitude and longitude are used",
            "let the driver give heights above the ellipsoid in every fix",
        ),
        Entry(
            "gnss.height.moved",
            "heights now have another reference; the step is subtracted",
            "let the driver give heights above the ellipsoid in every fix",
        ),
        Entry(
            "gnss.height.stuck",
            "the height of fixes is exactly zero from the beginning, or repeats itself while they move; not used",
            "let the driver fill the altitude; a barometer holds the height meanwhile",
        ),
        Entry("gnss.height.stuck.ended", "GNSS heights change again and are used"),
        Entry(
            "gnss.height.missing",
            "a fix has no altitude: the height is the barometer's, or held",
            "let the driver fill the altitude; connect a barometer",
        ),
        Entry("gnss.rejected.value", "the fix holds NaN or an impossible latitude", SENSOR),
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
        Entry("gnss.waiting.count_unknown", "the receiver does not know its satellite count (255)", WAIT),
        Entry("gnss.waiting.count_stale", "the satellite count is older than gnss.gate.count_max_age", WAIT),
        Entry("gnss.waiting.hold", "the satellite count has not been good for gnss.gate.hold yet", "wait"),
        Entry("gnss.count.unknown", "the satellite count became unknown; the gate stays as it was", WAIT),
        Entry("gnss.count.stale", "the satellite count is stale; the gate stays as it was", WAIT),
        Entry("gnss.count.out_of_order", "a satellite count older than the last one was ignored"),
        Entry("gnss.gate.opened", "enough satellites for long enough: GNSS may be used"),
        Entry("gnss.gate.closed", "too few satellites: GNSS is no longer used", "see gnss.gate.min_satellites_leave"),
        Entry("gnss.gate.none", "satellites are not counted, as gnss.gate.satellite_source: none asks for"),
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
        Entry(
            "gnss.pulled",
            "the receiver's velocity changed without a force on the IMU, and its positions follow",
            "do not trust GNSS: spoofing, or an IMU fault; call ~/accept_return if GNSS is right",
        ),
        Entry("gnss.pulled.ended", "GNSS agrees with the IMU again after a change that no force explained"),
        Entry(
            "gnss.other_motion",
            "the velocity changes of GNSS are not those that the IMU measures",
            "find out whose fixes they are (base station, another vehicle); look for a frozen receiver or an IMU fault",
        ),
        Entry(
            "gnss.delayed",
            "IMU and GNSS velocity have shown by how much the stamps of GNSS are late",
            "set gnss.delay to what the sentence says; then compare the clocks of receiver and IMU",
        ),
        Entry(
            "gnss.scatters",
            "positions scatter from fix to fix by more than the receiver states; they are used with that noise, and "
            "the status says in doubt",
            "look for reflections, a covered antenna, or a source that adds noise to the fixes",
        ),
        Entry("gnss.scatters.ended", "they scatter as stated again"),
        Entry(
            "gnss.velocity.scatters",
            "velocities scatter by more than the receiver states, compared with the IMU; they are used with that noise",
            "use the receiver's own (Doppler) velocity, not one that a driver derives from positions",
        ),
        Entry("gnss.velocity.scatters.ended", "they scatter as stated again"),
        Entry(
            "gnss.rounded",
            "all positions lie on a coarse grid; they are used with that error, which sigma covers",
            "let the driver print latitude and longitude with seven decimals; no single precision",
        ),
        Entry("gnss.rounded.ended", "positions are no longer rounded to a coarse grid"),
        Entry(
            "gnss.two_places",
            "every other fix is displaced by the same amount, as from two receivers",
            "let one receiver publish on the topic (ros2 topic info -v), or remap one of them",
        ),
        Entry("gnss.two_places.ended", "all fixes agree on one place again"),
        Entry("gnss.other_motion.ended", "GNSS and IMU agree on the motion again"),
        Entry("gnss.drift.ended", "fixes and their velocities agree again"),
        Entry("gnss.drift.fixes", "a fix that came while positions and velocities drifted apart"),
        Entry(
            "gnss.rejected.velocity_axes",
            "a velocity whose axes contradict the motion between fixes",
            "see gnss.velocity.axes",
        ),
        Entry(
            "gnss.velocity.axes.ned",
            "velocities look like North-East-Down and are not used",
            "set ros.input.velocity_frame to ned",
        ),
        Entry(
            "gnss.velocity.axes.turned",
            "velocities have the speed of the motion but another direction; they are not used",
            "let the driver send East-North-Up; a velocity in body axes belongs on another topic",
        ),
        Entry(
            "gnss.velocity.axes.silent",
            "velocities, or an axis of them, stay zero or repeat while the positions move; they are not used",
            "set ros.input.velocity to none",
        ),
        Entry(
            "gnss.velocity.axes.unit",
            "velocities have the direction of the motion but not its speed; they are not used",
            "let the driver send m/s",
        ),
        Entry(
            "gnss.velocity.axes.unexplained",
            "velocities contradict the positions, and the IMU does not confirm them; they are not used",
            SENSOR,
        ),
        Entry("gnss.velocity.axes.ended", "velocities agree with the motion between fixes again"),
        Entry(
            "gnss.velocity.turned",
            "the error in axes or unit of the velocities is established; they are corrected and used",
            "let the driver send East-North-Up in m/s; set ros.input.velocity_frame to ned if it sends that",
        ),
        Entry(
            "gnss.velocity.undone",
            "the effect of wrong measurements on the pose is undone: the last seconds were computed again",
            "see the event before it",
        ),
        Entry(
            "gnss.velocity.late",
            "velocities are late: they fit the positions of some time ago, and are used as of then",
            "let the driver stamp velocities with the time at which they were valid, as it does positions",
        ),
        Entry(
            "gnss.velocity.scale",
            "positions move farther, or less far, than velocities and stamps imply",
            "compare the clock of the stamps with GNSS time (replay LOG --clock gnss for flight logs)",
        ),
        Entry(
            "gnss.velocity.vertical.silent",
            "the vertical velocity stays zero while the height changes and is not used",
            "set ros.input.vertical_velocity to false",
        ),
        Entry(
            "gnss.velocity.vertical.down",
            "the vertical velocity is positive down; its sign is inverted and it is used",
            "let the driver send it positive up",
        ),
        Entry(
            "gnss.velocity.vertical.other",
            "heights and barometer agree with each other and not with the vertical velocity, which is not used",
            "let the driver send m/s; else set ros.input.vertical_velocity to false",
        ),
        Entry(
            "gnss.height.unit",
            "the GNSS height is in another unit, or positive down, by barometer or vertical velocity; it is not used",
            "let the driver send metres above the ellipsoid, positive up",
        ),
        Entry(
            "gnss.noise.optimistic",
            "the receiver's errors are three or more times as large as it states (gnss.noise has found the factor)",
            "look for reflections and interference; else set gnss.position_sd and gnss.velocity_sd to true values",
        ),
        Entry("gnss.noise.agrees", "the receiver's errors are about as large as it states again"),
        Entry("gnss.rejected.velocity_value", "a velocity that is not finite", SENSOR),
        Entry(
            "gnss.rejected.velocity_without_fix", "a velocity came while fixes are refused", "see why fixes are refused"
        ),
        Entry(
            "gnss.rejected.velocity_without_position",
            "a velocity came while no position is used",
            "see why no position is used",
        ),
        Entry("gnss.velocity.rejected.invalid", "PX4 reports the velocity as invalid", "wait for a better fix"),
        Entry("*.rejected.future", "a stamp more than 1 s ahead of the IMU's time", CLOCKS),
        Entry(
            "*.rejected.late",
            "a stamp of another clock, or a message older than navigator.memory",
            CLOCKS + ", or raise navigator.memory",
        ),
    ),
    "GNSS: the return after an outage": (
        Entry("gnss.waiting.consistency", "there are too few consistent fixes since GNSS came back", "wait"),
        Entry("gnss.waiting.expected", "the fixes are where they should be, but not for long enough yet", "wait"),
        Entry("gnss.rejected.expected", "the fixes are where they should be, but not for long enough yet", "wait"),
        Entry(
            "gnss.waiting.contradiction",
            "the fixes agree with each other, but not with the filter",
            "wait: gnss.reacquisition.contradiction_time decides",
        ),
        Entry("gnss.rejected.contradiction", "consistent fixes contradict a filter that GNSS still aids", "see above"),
        Entry(
            "gnss.waiting.unexplained",
            "position and velocity of the fixes lie where no drift of the navigator since the loss leads",
            "wait: gnss.reacquisition.contradiction_time decides; if it recurs, look for spoofing or reflections",
        ),
        Entry("gnss.rejected.unexplained", "fixes that no drift of the navigator explains", "as above"),
        Entry(
            "gnss.waiting.doubtful",
            "the fixes fit what the navigator may have drifted only just, and have to last longer",
            "wait",
        ),
        Entry("gnss.rejected.doubtful", "fixes that fit the navigator only just, and have not lasted long", "wait"),
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
        Entry("gnss.return.none", "the operator decided about a return of GNSS, but none was held"),
        Entry("gnss.reacquired.*", "GNSS is back and used as a correction"),
        Entry(
            "gnss.reset.*",
            "GNSS is back and the position was reset to it; map jumped, odom did not",
            "after a long outage this is expected; otherwise look for spoofing",
        ),
    ),
}
