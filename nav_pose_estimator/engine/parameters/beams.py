"""Parameters of a Doppler log or radar whose beams are used one by one."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameters.schema import param


@dataclass(frozen=True)
class BeamParameters:
    """Geometry, mounting and noise of the beams."""

    directions: tuple[float, ...] = param(
        (0.0,) * 12,
        "",
        "Unit vectors of beams 1 to 4 in the sensor frame, x y z each; zeros: those of the message, or no such beam",
        -1.0,
        1.0,
    )
    sign: int = param(
        0,
        "",
        "1: a velocity is positive while the sensor moves along its beam; -1: the opposite; 0: found from the data",
        -1,
        1,
    )
    sd: float = param(0.02, "m/s", "Lower bound on the deviation of a beam velocity", 0.0005, 10.0, mutable=True)
    bias_sd: float = param(0.005, "m/s", "Deviation of a beam's bias before it is known", 0.0, 1.0)
    scale_sd: float = param(0.005, "", "Deviation of the common scale error before it is known", 0.0, 0.2)
    delay: float = param(0.0, "s", "Stamp minus time of validity of a beam velocity", -1.0, 1.0)
    delay_sd: float = param(
        0.0, "s", "Deviation of that delay before it is known; 0: it is as given, else it is estimated", 0.0, 0.5
    )
    lever: tuple[float, ...] = param((0.0, 0.0, 0.0), "m", "From the IMU to the sensor, body frame", -50.0, 50.0)
    rpy: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), "rad", "Roll, pitch, yaw of the sensor frame in the body frame", -3.2, 3.2
    )
    rpy_sd: float = param(0.02, "rad", "Deviation of each mounting angle before it is known", 0.0, 0.2)
    compensation: str = param(
        "none",
        "",
        "What is done with a faulty beam; none: it is left out; else a network learns its errors "
        "while GNSS is good (anfis: trained by particle swarm, anfis_frcg: by conjugate gradient, anfis_linear: ridge)",
        choices=("none", "anfis", "anfis_frcg", "anfis_linear"),
    )
