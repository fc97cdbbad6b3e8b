"""Magnetometer, barometer, other aids and the outage."""

from nav_pose_estimator.engine.events.entry import CLOCKS, SENSOR, Entry

SECTIONS: dict[str, tuple[Entry, ...]] = {
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
            "navigator.turned",
            "IMU and GNSS have shown that the heading was far off: the navigator continues with the one that they show",
            "find its cause: a magnetometer (docs/calibration.md), a start in motion, velocities in other axes",
        ),
        Entry(
            "mag.heading.wrong_start",
            "motion has shown that the magnetic heading at the start was wrong: aligned again, magnetometer not used",
            "calibrate (docs/calibration.md): attitude.hard_iron, aids.magnetometer_rpy",
        ),
        Entry(
            "mag.heading.disagrees",
            "the magnetic heading contradicts the heading that the motion shows; the magnetometer is not used",
            "as above; the log line says by how much, and the likely cause",
        ),
        Entry(
            "mag.unit",
            "the field, or attitude.hard_iron, is not in tesla; alignment does not use it",
            "publish tesla, as sensor_msgs/MagneticField demands; write attitude.hard_iron in tesla",
        ),
        Entry(
            "mag.empty",
            "the field is exactly zero; it is not used",
            "let the driver publish what the sensor measures, in tesla",
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
        Entry("mag.rejected.nan", "a field that is not finite", SENSOR),
        Entry("mag.rejected.value", "a field that is zero, huge or not finite", SENSOR),
        Entry("mag.rejected.no_attitude_yet", "a field came before the first IMU sample"),
        Entry("mag.rejected.stamp", "a field not newer than the previous one", SENSOR),
        Entry("mag.rejected.stale", "a field half a second away from the IMU's time", CLOCKS),
        Entry(
            "baro.rejected.unit",
            "a pressure that no air has, or that fits the GNSS height only in another unit than pascal",
            "let the driver send pascal",
        ),
        Entry(
            "baro.contradicts",
            "the barometric height has drifted away from GNSS; it is not used in an outage",
            "look for a blocked port, or one in the propellers' wash",
        ),
        Entry("baro.contradicts.ended", "barometer and GNSS heights agree again"),
        Entry(
            "baro.frozen",
            "the barometer repeats one value exactly, for longer than it has done before; it is not used",
            "restart the sensor or its driver; does the driver send old values again?",
        ),
        Entry("baro.frozen.ended", "the barometer's values change again"),
        Entry(
            "depth.rejected.value",
            "an impossible water pressure",
            "publish absolute pressure in pascal; set aids.water_density to 0 for a barometer",
        ),
        Entry("depth.*", "a height from water pressure was used, given less weight (inflated), or refused"),
        Entry("zero_velocity.rejected", "the IMU was still, but the filter is certain of motion: not rest"),
        Entry(
            "zero_velocity.withheld.rate",
            "the IMU was still except for a rotation that its bias does not explain: not rest",
        ),
        Entry(
            "zero_velocity.withheld.speed",
            "the IMU was still, but the estimated speed does not exclude steady motion: not taken for rest",
        ),
        Entry("body_velocity.rejected.value", "a velocity without a finite component", SENSOR),
        Entry(
            "body_velocity.implausible",
            "the changes of the body velocity contradict the IMU, or its scale differs from GNSS velocity; not used",
            "the sentence names the likely mistake: set aids.body_velocity_rpy or _delay, or let the driver send "
            "Forward-Left-Up in m/s",
        ),
        Entry(
            "body_velocity.unfelt",
            "without GNSS the body velocity changed, and the IMU felt no force: either may be wrong; the deviation of "
            "the position grows with the difference until GNSS is back",
            "look for a sensor that lost its ground lock, slips, or repeats itself",
        ),
        Entry(
            "body_velocity.unproven",
            "a body velocity not used while GNSS is good, because no motion has confirmed its axes yet",
            "speed up, brake and turn: three windows of six seconds that agree with the IMU confirm it",
        ),
        Entry("body_velocity.rejected.axes", "a body velocity that contradicts the IMU and was not used", "as above"),
        Entry(
            "beam_velocity.geometry",
            "directions and signs of the beams are verified: the log line names the convention",
        ),
        Entry(
            "beam_velocity.geometry.refused",
            "no convention of directions and signs makes the beams agree with the known velocity; no beam is used",
            "the sentence says what would fit; aids.beams.directions, sign and rpy (docs/beams.md)",
        ),
        Entry(
            "beam_velocity.contradicts",
            "most beams contradict the navigator while GNSS is good; no beam is used",
            "the sentence says what would fit; aids.beams.rpy, delay, lever and sd (docs/beams.md)",
        ),
        Entry(
            "beam_velocity.delayed",
            "the velocities lag behind the acceleration: they are not stamped when they were valid",
            "set aids.beams.delay to what the log line says; with aids.beams.delay_sd 0 repeat until it is gone",
        ),
        Entry(
            "beam_velocity.unproven",
            "GNSS was lost before the beams had agreed with it in motion; they are not used without it",
            "move for half a minute while GNSS is good",
        ),
        Entry("beam_velocity.contradicts.ended", "beams and GNSS agree again"),
        Entry(
            "beam_velocity.beam_out",
            "a beam is excluded until it agrees again, because too many of its velocities did not",
            "if it stays out, check its transducer and whether something is in its way",
        ),
        Entry("beam_velocity.beam_in", "an excluded beam is used again"),
        Entry(
            "beam_velocity.accusation",
            "two or more beams have contradicted the navigator for 30 s without GNSS: it is corrected by them in steps",
        ),
        Entry("beam_velocity.rejected.empty", "a message without beams", SENSOR),
        Entry(
            "beam_velocity.rejected.geometry",
            "a message without directions (dvl_msgs/DVL has none)",
            "set aids.beams.directions",
        ),
        Entry(
            "beam_velocity.rejected.count",
            "a message with more or fewer beams than aids.beams.directions gives",
            "give a direction for each beam",
        ),
        Entry("beam_velocity.rejected.direction", "a direction that is not a unit vector", "set aids.beams.directions"),
        Entry(
            "beam_velocity.rejected.duplicate",
            "two beams of one message have the same direction",
            "let the driver send each beam once",
        ),
        Entry("beam_velocity.rejected.zero", "all velocities are exactly zero: no echo", "wait for bottom lock"),
        Entry(
            "beam_velocity.rejected.stamp",
            "a message with the stamp of the one before it",
            "let the driver stamp every measurement, and send it once",
        ),
        Entry(
            "beam_velocity.rejected.stuck",
            "all velocities of a message repeat those of the messages before it to the last digit",
            "restart the sensor, or let its driver send each measurement once",
        ),
        Entry("beam_velocity.rejected.lost", "no beam of a message has a velocity", "wait for bottom lock"),
        Entry("beam_velocity.rejected.contradicts", "a message while the beams contradict GNSS", "as above"),
        Entry(
            "beam_velocity.rejected.water",
            "the sensor measures relative to the water, not the ground",
            "switch it to bottom track",
        ),
        Entry("beam_velocity.rejected.beams", "beams whose numbers are not 0 to 3 or 1 to 4", SENSOR),
        Entry(
            "beam_velocity.rejected.fields", "a point cloud without x, y, z or velocity", "let the driver publish them"
        ),
        Entry("beam_velocity.rejected.layout", "a point cloud shorter than its own fields say", SENSOR),
        Entry("beam_velocity.*.used", "a velocity of this beam was used"),
        Entry("beam_velocity.*.lost", "a message in which this beam had no velocity"),
        Entry("beam_velocity.*.rejected", "a velocity of this beam did not fit the navigator", "a few are harmless"),
        Entry(
            "beam_velocity.*.rejected.parity",
            "the beams contradicted each other, and this one explained the contradiction best",
        ),
        Entry("beam_velocity.*.rejected.out", "a velocity that agrees, of a beam that is excluded"),
        Entry("airspeed.rejected.absent", "PX4 reports no airspeed", "check the pitot tube and its driver"),
        Entry("airspeed.rejected.value", "an airspeed that is not finite, or impossible", SENSOR),
        Entry("airspeed.rejected.slow", "an airspeed below aids.airspeed_min, where a pitot tube is useless"),
        Entry("airspeed.*", "an airspeed was used, given less weight (inflated), or refused by the filter's gate"),
        Entry("composed.rejected.value", "a composed position that is not finite, or lacks its covariance"),
        Entry("composed.used", "a position composed of predictions was used (learner.method pseudo_gnss)"),
        Entry("composed.inflated", "such a position was unlikely and was given less weight"),
        Entry("composed.rejected", "such a position was refused by the filter's gate"),
        Entry("range.rejected.value", "a distance to the ground that is not finite, or impossible", SENSOR),
        Entry(
            "range.new_ground",
            "the ground has been at another level for two seconds: heights now count from there",
        ),
        Entry("range.*", "a height above ground was used, given less weight (inflated), or refused by the gate"),
        Entry("range.rejected.outside", "no echo within the limits that the rangefinder states", "fly lower, or wait"),
        Entry(
            "outage.rejected.covariance",
            "a predicted velocity error that is not finite or lacks its covariance",
            "anfis_node sends both",
        ),
        Entry("outage.evidence", "what this flight has shown of the vehicle's motion was used"),
        Entry("outage.evidence.redundant", "what this flight has shown was not used, because the airspeed is better"),
        Entry("outage.evidence.unseen", "of it only the usual speed was used, because of a gap in the IMU data before"),
        Entry("outage.evidence.network", "as outage.evidence, with the prediction of the network"),
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
        Entry(
            "attitude.body_velocity.incomplete",
            "a body velocity lacks an axis: the attitude filter cannot derive the acceleration from it",
            "let a driver for wheels publish 0 for the axes along which they cannot move",
        ),
        Entry("attitude.body_velocity.stamp", "a body velocity not newer than the previous one"),
        Entry("*.used", "an aid was used"),
        Entry("*.inflated", "an aid was unlikely and was given less weight"),
        Entry(
            "*.rejected",
            "an aid disagreed with the filter and was not used",
            "if there are many, check its mounting and noise",
        ),
        Entry("navigator_velocity.ignored.heading_unknown", "the attitude filter does not know its heading yet"),
        Entry(
            "navigator_velocity.rejected.nan",
            "the navigator's velocity or attitude is not finite, or absurd",
            "please report it",
        ),
        Entry("navigator_velocity.rejected.no_attitude_yet", "a velocity came before the first IMU sample"),
        Entry(
            "navigator_velocity.rejected.stamp", "a velocity not newer than the previous one", "run only one navigator"
        ),
        Entry(
            "navigator_velocity.rejected.orientation", "an odometry without an orientation", "run only one navigator"
        ),
    ),
}
