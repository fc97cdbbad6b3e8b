"""Parameters of the node synthetic_sensors, a separate tree that the estimators do not use."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameters.schema import param


@dataclass(frozen=True)
class SyntheticParameters:
    """The simulated scenario, and the transport of its messages."""

    scenario: str = param("multirotor_outage", "", "Name of the scenario (simulate --list lists them)")
    duration: float = param(0.0, "s", "Length; 0: that of the scenario", 0.0, 86400.0)
    seed: int = param(0, "", "The same seed gives the same data", 0, 2**31)
    imu: str = param("icm42688", "", "Grade of the IMU")
    imu_rate: float = param(200.0, "Hz", "Rate of the IMU", 10.0, 4000.0)
    sim_time: bool = param(False, "", "Publish /clock and stamp in simulated time; else stamps are wall time")
    speed: float = param(1.0, "", "Simulated seconds per second of wall time (with sim_time)", 0.01, 100.0)
    laps: int = param(1, "", "How often it is played (with sim_time stamps start again, like a bag loop)", 1, 1000)
    wait_for_subscriber: bool = param(True, "", "Begin when imu/data_raw has a subscriber")
    clock_rate: float = param(100.0, "Hz", "Rate of /clock (with sim_time)", 1.0, 1000.0)
    truth_rate: float = param(50.0, "Hz", "Rate of ground_truth/odom; 0: none", 0.0, 1000.0)
    jitter: float = param(0.0, "s", "Deviation of the random delay of each message (half-normal)", 0.0, 1.0)
    delay: float = param(0.0, "s", "Delay of every message but those of the IMU", 0.0, 10.0)
    drop: float = param(0.0, "", "Fraction of the messages that are lost", 0.0, 1.0)
    burst_every: float = param(0.0, "s", "Interval at which messages are held back ...; 0: never", 0.0, 3600.0)
    burst_length: float = param(0.1, "s", "... for this long, and then arrive all at once", 0.0, 10.0)
