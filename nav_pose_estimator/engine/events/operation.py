"""Start, modes, the operator and the autopilot."""

from nav_pose_estimator.engine.events.entry import Entry

SECTIONS: dict[str, tuple[Entry, ...]] = {
    "Start, modes and operator": (
        Entry(
            "outage.class",
            "the vehicle moves like another class than the one of the airframe file or of learner.vehicle_class",
            "use the file of this vehicle, or none",
        ),
        Entry("aligned", "attitude and position are known, the navigator runs"),
        Entry("reset", "the navigator restarts; the log line says why", "see the reason in the log line"),
        Entry("attitude.reset", "the attitude filter restarts", "see the reason in the log line"),
        Entry("mode.*", "the mode has changed to the one in the name"),
        Entry("mode.use_gnss", "an operator has switched GNSS off or on", "call ~/use_gnss with true to use it again"),
        Entry("parameters.changed", "parameters were changed in flight"),
        Entry("set_pose", "the pose was set from outside"),
        Entry("set_pose.rejected.frame", "a pose came in a frame that is not map", "publish it in ros.frames.map"),
        Entry("set_pose.rejected.nan", "a pose was not finite, or its orientation was invalid", "check its publisher"),
        Entry("set_pose.rejected.stamp", "a pose came without a stamp", "let the publisher of set_pose stamp it"),
        Entry(
            "set_pose.rejected.value",
            "a pose had values that are not finite or a quaternion that is no rotation",
            "check the publisher of set_pose",
        ),
        Entry("set_pose.rejected.far", "a pose was far from where the navigator is", "check the publisher of set_pose"),
        Entry("set_origin", "the origin of map was set from outside; odom stays"),
        Entry(
            "set_origin.rejected.value", "an origin was not a position on Earth", "check the publisher of set_origin"
        ),
        Entry("set_origin.rejected.far", "an origin was more than 100 km off", "check the publisher of set_origin"),
        Entry("coordinates.no_origin", "from_ll or to_ll was called before there was an origin", "wait for AIDED once"),
        Entry("origin.far", "the fixed origin is more than 100 km off", "check origin.latitude and origin.longitude"),
        Entry(
            "doubt.begun",
            "GNSS keeps contradicting the navigator: its sigma grows until they agree",
            "set gnss.delay and gnss.lever_arm; look for vibration of the IMU",
        ),
        Entry("doubt.ended", "GNSS and the navigator agree again"),
        Entry("set_pose.rejected.no_origin", "a pose came before the origin was known", "wait for AIDED once"),
        Entry(
            "overload.step",
            "the node cannot keep up and leaves out work: first rehearsals and some of the results, then IMU samples"
            " are averaged",
            "a faster computer, numba, a lower IMU rate, pose_estimator instead of three nodes; see docs/load.md",
        ),
        Entry("overload.dropped", "the node was seconds behind and dropped the waiting messages", "see overload.step"),
        Entry("overload.ended", "the node keeps up again and leaves out nothing"),
        Entry("input.gone", "a topic has lost its last publisher", "check whether that node or driver has died"),
        Entry("qos.incompatible", "a publisher's QoS is incompatible: nothing is received", "see the log line"),
        Entry("callback.failed.*", "a message caused an error in this package and was not used", "please report it"),
        Entry("output.withheld.nan", "a solution was not finite and was not published", "please report it with a bag"),
    ),
    "A restart in flight": (
        Entry("resume.none", "ros.state.file does not exist yet: there is nothing to continue from"),
        Entry(
            "resume.begun",
            "a saved state, or that before an IMU gap, continues: origin, noise and, where possible, pose and biases",
        ),
        Entry(
            "resume.refused.file", "the saved state cannot be read or is invalid", "nothing: the next one replaces it"
        ),
        Entry(
            "resume.origin", "the saved state is over a minute old or of another clock: only origin and noise are kept"
        ),
        Entry(
            "resume.refused.moved", "GNSS is further away than the vehicle can have travelled since the state was saved"
        ),
        Entry("resume.model.refused", "the saved outage model is of another learner.method"),
        Entry("resume.heading.wrong", "the heading from before the restart or IMU gap was far off; aligned again"),
        Entry("state.not_written", "the state could not be written", "check ros.state.file and its disk"),
    ),
    "The way back to the autopilot": (
        Entry("autopilot.sending", "the autopilot gets the pose from now on; the sentence says what is missing"),
        Entry("autopilot.silent", "the autopilot no longer gets the pose; the sentence says why"),
        Entry(
            "autopilot.dry_run",
            "what would be sent to the autopilot",
            "set ros.output.autopilot_dry_run to false to send it",
        ),
        Entry(
            "autopilot.feedback",
            "gps/fix repeats the pose that is sent to the autopilot: a feedback loop; its fixes are not used",
            "map gps/fix and gps/vel to the receiver itself, not to what the autopilot has fused; after EXPIRED"
            " restart the node",
        ),
        Entry(
            "autopilot.feedback.fixes", "a fix that repeats our own track and was not used", "see autopilot.feedback"
        ),
        Entry("autopilot.feedback.ended", "gps/fix no longer repeats our own pose"),
        Entry(
            "autopilot.feedback.topic",
            "gps/fix is mapped to the fused position of the autopilot",
            "map it to the receiver: global_position/raw/fix of MAVROS, vehicle_gps_position of PX4",
        ),
    ),
}
