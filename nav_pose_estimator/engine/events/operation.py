"""Start, modes, the operator and the autopilot."""

from nav_pose_estimator.engine.events.entry import Entry

SECTIONS: dict[str, tuple[Entry, ...]] = {
    "Start, modes and operator": (
        Entry(
            "outage.class",
            "the flight moves like another class of vehicle than the airframe file, or learner.vehicle_class, says",
            "give the file of this vehicle, or none",
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
        Entry("set_pose.rejected.stamp", "a pose came without a stamp", "let whoever publishes set_pose stamp it"),
        Entry("set_pose.rejected.value", "a pose held no numbers or no rotation", "look at who publishes set_pose"),
        Entry("set_pose.rejected.far", "a pose lay far from where the navigator is", "look at who publishes set_pose"),
        Entry("set_origin", "the zero of map was set from outside; odom stays"),
        Entry("set_origin.rejected.value", "an origin was no place on Earth", "look at who publishes set_origin"),
        Entry("set_origin.rejected.far", "an origin lay more than 100 km off", "look at who publishes set_origin"),
        Entry("coordinates.no_origin", "from_ll or to_ll was asked before there was an origin", "wait for AIDED once"),
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
            "the node is behind what arrives and leaves out work: rehearsals and rates of results first, then IMU"
            " samples are averaged",
            "a faster computer, numba, a lower IMU rate, pose_estimator instead of three nodes; see docs/load.md",
        ),
        Entry("overload.dropped", "the node was seconds behind and dropped what waited", "see overload.step"),
        Entry("overload.ended", "the node keeps up again, and leaves out nothing"),
        Entry("input.gone", "a topic has lost its last publisher", "look whether that node or driver has died"),
        Entry("qos.incompatible", "a publisher's QoS is incompatible: nothing is received", "see the log line"),
        Entry("callback.failed.*", "a message caused an error in this package and was not used", "please report it"),
        Entry("output.withheld.nan", "a solution was not finite and was not published", "please report it with a bag"),
    ),
    "A restart in flight": (
        Entry("resume.none", "ros.state.file does not exist yet: nothing is there to go on from"),
        Entry("resume.begun", "a saved state is there: origin, noise and, if it can, pose and biases go on from it"),
        Entry("resume.refused.file", "the saved state cannot be read, or is none", "nothing; the next one replaces it"),
        Entry("resume.origin", "the saved state is over a minute old, or of another clock: only what lasts is kept"),
        Entry("resume.refused.moved", "GNSS is further off than the vehicle can have got since the state was saved"),
        Entry("resume.model.refused", "the saved outage model is of another learner.method"),
        Entry("resume.heading.wrong", "the heading from before the restart was far off; the navigator aligned anew"),
        Entry("state.not_written", "the state could not be written", "look at ros.state.file and its disk"),
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
}
