"""Generator of docs/troubleshooting.md: the modes, what a node waits for, and every event with cause and remedy."""

from collections.abc import Iterable, Iterator

from nav_pose_estimator.engine.events.catalogue import SECTIONS
from nav_pose_estimator.ros.wording import ATTITUDE_MEANINGS, LEARNER_MEANINGS, MEANINGS

PAGE = "docs/troubleshooting.md"

_INTRODUCTION = """# Troubleshooting

Written by `make docs` from `engine/events` and `tools/docs/troubleshooting_docs.py`; a test compares it with the
code.

Three places report the state, in the same words: the log of the node, `~/status` (latched: the last message arrives at
once) and `/diagnostics` (once a second: state, inputs, counters). In a recorded flight `replay` counts the same events.

```bash
ros2 topic echo --full-length --qos-durability transient_local --qos-reliability reliable /pose_estimator/status \\
    diagnostic_msgs/msg/DiagnosticStatus
ros2 topic echo /diagnostics        # or rqt_robot_monitor
```

Look up what you see in the first table, and the name of a counter in the last tables.
"""

_SYMPTOMS = (
    (
        "`imu/data_raw was never received (0 publishers)`",
        "nothing publishes under that name",
        "`ros2 topic list`, then remap: `-r imu/data_raw:=/your/topic`; namespaces count",
    ),
    (
        "`imu/data_raw was never received (1 publishers)`",
        "there is a publisher, but nothing gets through",
        "the same line names a wrong type or QoS; else `ROS_DOMAIN_ID`, `ROS_AUTOMATIC_DISCOVERY_RANGE`, a firewall",
    ),
    (
        "`... publishes geometry_msgs/msg/TwistStamped, ... is expected`",
        "the driver sends another message type than the node subscribes to",
        "set `ros.input.imu`, `.fix`, `.velocity` or `gnss.gate.satellite_source`; see config/driver_*.yaml",
    ),
    (
        "`... offers incompatible QoS (...)`",
        "publisher and subscription do not agree on reliability or durability",
        "inputs are best effort, which fits every publisher: remove the `qos_overrides` that made it stricter",
    ),
    (
        "`gps/fix silent for 4 s (1 publishers)`",
        "the driver is there but has stopped publishing",
        "check the receiver; the navigator continues without it",
    ),
    (
        "many `lost` in the inputs",
        "the machine is too slow, or another process takes the core",
        "[load](load.md); install numba; lower `ros.output.odometry_rate`; raise `ros.input.queue`",
    ),
    (
        "`... is set to px4_msgs/SensorCombined, but px4_msgs is not installed here`",
        "the message package is missing in this workspace",
        "install it, source the workspace, or choose another type in the parameter that is named",
    ),
    (
        "`there is no parameter '...'; did you mean ...`",
        "a misspelt name in the YAML file or after `-p`",
        "[all parameters](parameters.md); the node stops on purpose instead of flying with a default",
    ),
    (
        "AIDED never comes, `satellite count` in the sentence",
        "the gate needs a satellite count that nothing publishes",
        "remap `gps/satellites`, or set `gnss.gate.satellite_source` to `none`",
    ),
    (
        "AIDED never comes, `Finding the heading from motion`",
        "no magnetometer, or one that cannot be trusted",
        "accelerate and turn; [calibrate the magnetometer](calibration.md)",
    ),
    (
        "the attitude is upside down or mirrored",
        "the axes of the IMU are not Forward-Left-Up",
        "at rest and level the driver must read z = +9.8; for FRD set `imu.convention: frd`, else `imu.mounting_rpy`",
    ),
    (
        "the pose circles or oscillates while GNSS is good",
        "the stamps of GNSS and IMU do not match",
        "`replay BAG --estimate-latency` measures `gnss.delay`; then check the clocks",
    ),
    (
        "heading is wrong by a constant angle on the ground",
        "magnetic declination or hard iron",
        "[`aids.declination_from_model`, or set `aids.declination`](conventions.md#magnetic-declination); calibrate",
    ),
    (
        "sigma is much smaller or larger than the errors",
        "the IMU noise parameters do not match the IMU",
        "set `imu.gyro_noise`, `imu.accel_noise` ([tuning](tuning.md)); watch `nis.*`: above 1 they are too small",
    ),
    (
        "`ros2 topic hz` of odometry is lower than the IMU's",
        "`ros.output.odometry_rate` limits it (100 Hz)",
        "set it to 0 for one message with every IMU sample",
    ),
    (
        "with `use_sim_time` the stamps of /diagnostics are 0",
        "nothing publishes /clock",
        "play the bag with `--clock`; the estimator itself runs on the stamps of the samples and needs no clock",
    ),
)

_WAITING = (
    ("Waiting for IMU data.", "check the inputs line: name, type, QoS"),
    ("Level and heading are known; waiting for a GNSS fix.", "the rest of the sentence says why fixes are refused"),
    ("Waiting for a GNSS fix", "or keep the vehicle still, with a magnetometer, as the text in brackets says"),
    ("Finding the heading from motion:", "speed up, brake or turn; straight and steady flight shows no heading"),
    ("Level is known; heading needs motion, because there is", "fly, or connect a magnetometer that can be trusted"),
    ("The IMU is at rest, but GNSS reports motion;", "wait; on a moving deck or vehicle: accelerate"),
    ("Waiting for GNSS to show the vehicle's motion.", "gps/vel helps; without it a few seconds of fixes are needed"),
    ("no IMU sample has come yet", "attitude_node: check the inputs line"),
    ("levelling: the first second of data", "attitude_node: wait"),
    ("waiting for the origin of the navigator", "anfis_node: start sins_node, or remap sins_node/origin"),
    ("waiting for the navigator's biases", "anfis_node: remap sins_node/bias/gyro and sins_node/bias/accel"),
    ("waiting for odometry/filtered", "anfis_node: remap odometry/filtered"),
)

_STATUS = (
    ("mode", "see the table of modes"),
    ("waiting for", "what is missing until AIDED"),
    ("seconds without GNSS", "since the last fix that was used; 0 while AIDED"),
    ("horizontal sigma [m]", "one standard deviation of the position, now"),
    ("horizontal sigma in 30 s [m]", "what it will be if GNSS stays unavailable"),
    ("in doubt because", "why GNSS contradicts an aided navigator, whose sigma grows until they agree"),
    ("GNSS refused because", "why the last fix was not used"),
    ("satellites", "the latest count"),
    (
        "nis.gnss_position, nis.gnss_velocity",
        "mean normalised innovation squared: below 1 with the wide defaults; above 1 the noises are too small",
    ),
    ("nis.gnss_position.p99, nis.gnss_velocity.p99", "its 99th percentile over the last observations"),
    (
        "innovation.gnss_position.lag_1, innovation.gnss_velocity.lag_1",
        "correlation of each innovation with the next: white below 0.2; receivers are usually above",
    ),
    ("gnss.gate_radius_m", "how far from the prediction a fix may lie now without being refused"),
    (
        "gnss.noise.position_factor, gnss.noise.velocity_factor, body_velocity.noise.factor",
        "variance that the filter uses over the stated one, for the worst axis; 1 with `fixed`",
    ),
    (
        "imu.mean_force_m_s2, imu.vibration_m_s2",
        "mean specific force of the last second (about 9.8), and its change from sample to sample",
    ),
    (
        "imu.motion_misfit",
        "how far IMU and GNSS velocity contradict each other, as a share of the force; below 0.1 is good",
    ),
    ("gnss.resets, gnss.last_reset_m", "how often the position was reset to GNSS, and how far it moved the last time"),
    ("mag.heading_spread_deg", "spread of the magnetic heading's error while GNSS shows the heading"),
    (
        "noise.imu, noise.gnss",
        "noise identified in flight: deviations relative to those set (`imu.learn_noise`)",
    ),
    (
        "gnss.error.position_sd, gnss.error.position_tau, gnss.error.position_white_sd",
        "with `gnss.error_states`: lasting error of positions (m, s), and the white noise beside it (m)",
    ),
    (
        "gnss.error.velocity_sd, gnss.error.velocity_tau, gnss.error.velocity_white_sd",
        "the same of velocities (m/s, s, m/s)",
    ),
    ("noise.trials", "how many trials this rests on; old ones fade"),
    ("rangefinder.above_ground_m", "height above the ground that the rangefinder saw"),
    ("learner.flight_s, learner.trainings", "flight with GNSS that the learner remembers; trainings adopted"),
    (
        "learner.class.NAME",
        "probability of each class of vehicle, by how it moves",
    ),
    ("learner.rules, learner.target_rms", "rules of the network; RMS of its training targets [m/s]"),
    (
        "learner.error_rms.N, learner.noise.x",
        "residual of N rules on held-out data; noise of the prediction",
    ),
    ("rehearsal.count, rehearsal.rms_30_s.NAME", "rehearsed outages; RMS error [m] after 30 s of each way to coast"),
    ("rehearsal.drift_variance", "squared errors of coasting as a fraction of the stated variance"),
    ("alignment.restarts", "how often the search for the heading restarted"),
    ("tilt_sd_deg, yaw_sd_deg", "attitude_node: standard deviations in degrees"),
    ("not used because", "anfis_node: why the model is not used in an outage"),
    ("training, trainings", "anfis_node: running, or why the last one failed; how many there were"),
    ("... after each training", "anfis_node: the learning curve of each score"),
    ("gyro_bias_deg_s, field_trust", "attitude_node: bias found; trust in the magnetic field, 0 to 1"),
)


def page_text() -> str:
    """The whole page."""
    return "\n".join(_page()) + "\n"


def _page() -> Iterator[str]:
    yield _INTRODUCTION
    yield "## What you see\n"
    yield from _table(("you see", "because", "do"), _SYMPTOMS)
    yield "\n## Modes\n"
    yield from _table(("mode", "means"), ((f"`{mode.value}`", text) for mode, text in MEANINGS.items()))
    yield "\nAIDED is OK, EXPIRED an error, any other mode a warning. In the other nodes the modes mean:\n"
    yield from _table(("node", "mode", "means"), _of_other_nodes())
    yield ""
    yield "## What a node waits for\n"
    yield from _table(("the sentence begins", "do"), ((f"`{text}`", cure) for text, cure in _WAITING))
    yield "\n## The values of the status\n"
    yield from _table(("key", "means"), ((f"`{key}`", text) for key, text in _STATUS))
    yield "\n## Events and counters\n"
    yield "The counter `imu.rejected.nan` counts the events of that name; `*` stands for any word. The log shows"
    yield "an event the 1st, 10th, 100th ... time.\n"
    for title, entries in SECTIONS.items():
        yield f"### {title}\n"
        rows = ((f"`{entry.name}`", entry.meaning, entry.cure or "nothing to do") for entry in entries)
        yield from _table(("event", "means", "do"), rows)
        yield ""


def _of_other_nodes() -> Iterator[tuple[str, str, str]]:
    for node, meanings in (("attitude_node", ATTITUDE_MEANINGS), ("anfis_node", LEARNER_MEANINGS)):
        yield from ((node, f"`{mode.value}`", text) for mode, text in meanings.items())


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
