"""The IMU: readings that cannot be, gaps and clocks."""

from nav_pose_estimator.engine.events.entry import CLOCKS, SENSOR, Entry

SECTIONS: dict[str, tuple[Entry, ...]] = {
    "IMU": (
        Entry(
            "imu.gap",
            "no IMU data for longer than imu.max_gap, or refused ones of a clock set back: the navigator continues "
            "from its last state, or aligns again",
            "find out why the IMU stopped, or whether its clock was set ahead or back: " + CLOCKS,
        ),
        Entry(
            "imu.clock_jump", "the IMU's stamps went back: aligning again", "a looping bag does this; else " + CLOCKS
        ),
        Entry(
            "imu.stuck", "a sensor repeats one value exactly", "power-cycle it; with a noise-free simulator ignore it"
        ),
        Entry("imu.stuck.ended", "the values change again"),
        Entry(
            "imu.saturated.gyroscope", "the gyroscope is at the limit of its range", "choose a wider range, fly gently"
        ),
        Entry("imu.saturated.accelerometer", "the accelerometer is at the limit of its range", "as for the gyroscope"),
        Entry(
            "imu.clips",
            "an axis repeats the largest value of the flight: it is saturated at the end of its range",
            "choose a wider range (docs of the driver); sigma covers what may be lost",
        ),
        Entry("imu.saturated.ended", "the IMU is within its range again"),
        Entry(
            "imu.rejected.absent",
            "the message has no rate or no acceleration",
            "use the raw topic; have the driver combine gyroscope and accelerometer",
        ),
        Entry(
            "imu.rejected.backward",
            "a stamp older than the previous one",
            "a few are harmless; with many, stamps jitter or samples come out of order: let the driver stamp with the "
            "sensor's time, and publish in order",
        ),
        Entry(
            "imu.rejected.duplicate",
            "two samples with the same stamp",
            "the driver sends samples twice or stamps coarsely, or two IMUs publish on the topic (ros2 topic info -v)",
        ),
        Entry("imu.rejected.forward", "a stamp far ahead, not yet confirmed by a second one", SENSOR),
        Entry("imu.rejected.force", "a specific force above imu.max_force", "check the unit: m/s^2, not g"),
        Entry("imu.rejected.rate", "an angular rate above imu.max_rate", "check the unit: rad/s, not degrees"),
        Entry(
            "imu.implausible.in_g",
            "the mean specific force is about 1: no alignment",
            "let the driver send m/s^2 (REP-103): multiply by 9.80665",
        ),
        Entry(
            "imu.implausible.exchanged",
            "the gyroscope reads gravity and the accelerometer next to nothing: no alignment",
            "let the driver fill angular_velocity with rad/s and linear_acceleration with m/s^2",
        ),
        Entry(
            "imu.implausible.degrees",
            "the gyroscope reads fast turns while gravity stays where it is in the body: no alignment",
            "let the driver publish rad/s",
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
            "gravity points to the top of the body: no alignment",
            "set imu.convention (frd) or imu.mounting_rpy, or change the sign in the driver",
        ),
        Entry(
            "imu.implausible.no_accelerometer",
            "the accelerometer reads exactly zero: no alignment",
            "let the driver combine gyroscope and accelerometer (realsense: unite_imu_method)",
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
            "IMU and GNSS velocity contradict each other; the log line names unit, sign or axes",
            "check rad/s, signs and axes of both sensors; if they are right: ros.input.velocity_frame, gnss.delay",
        ),
        Entry("imu.implausible.ended", "the IMU is plausible again: the navigator aligns"),
        Entry(
            "imu.gyroscope.doubted",
            "the gyroscope's rates do not fit GNSS: attitude and heading are uncertain, and its scale is learned",
            "check range and unit of the gyroscope, signs and axes of both sensors; if they are right: gnss.delay",
        ),
        Entry(
            "imu.gyroscope.scale",
            "the gyroscope fits GNSS with another scale, which the navigator uses from now on",
            "set the range that the driver converts with; the log line has the factor of each axis",
        ),
        Entry(
            "imu.gyroscope.compass",
            "gyroscope and magnetometer turn differently: one of them has wrong signs or axes",
            "check signs and axes of both, and aids.magnetometer_rpy; a wrong magnetometer is no longer in doubt once "
            "GNSS has shown the gyroscope to be right",
        ),
        Entry("imu.gyroscope.fits", "the gyroscope's scale is right after all: the doubt has ended"),
        Entry("gyro_matrix.released", "the gyroscope is in doubt: its scale factors are uncertain by 0.5 from then on"),
        Entry(
            "imu.vibration.risen",
            "without GNSS the IMU vibrates at least twice as much as ever before: sigma grows with it",
            "look for a damaged propeller or a loose mount",
        ),
        Entry("imu.vibration", "the IMU vibrates heavily: expect errors of the vertical velocity", "damp its mount"),
        Entry(
            "imu_doubt.used",
            "the IMU was stuck or had a shock without GNSS, or was saturated at any time: sigma is larger from then on",
        ),
        Entry(
            "navigator.distrusted",
            "without GNSS, the IMU is not plausible or the speed not possible: EXPIRED until GNSS is back",
            "see the reason in the log line",
        ),
        Entry("imu.rejected.nan", "a value that is not finite", SENSOR),
        Entry("imu.rejected.zero_stamp", "a sample without a stamp", "make the driver stamp its messages"),
    ),
}
