"""Parameters of GNSS: latency, antenna, gate, re-acquisition."""

from dataclasses import dataclass, field

from nav_pose_estimator.core.filter.measurement_noise import MODELS
from nav_pose_estimator.engine.parameters.schema import param


@dataclass(frozen=True)
class GateParameters:
    """Conditions under which a fix is good enough to be used."""

    satellite_source: str = param(
        "uint32",
        "",
        "Where the number of satellites comes from; none: status and accuracy alone decide",
        choices=("uint32", "gpsfix", "gpsraw", "navpvt", "px4", "none"),
    )
    min_satellites_enter: int = param(6, "", "Satellites needed to begin using GNSS", 0, 100, mutable=True)
    min_satellites_leave: int = param(5, "", "With fewer satellites GNSS is dropped at once", 0, 100, mutable=True)
    hold: float = param(2.0, "s", "How long the count must be good before GNSS is used", 0.0, 60.0, mutable=True)
    count_max_age: float = param(2.0, "s", "An older satellite count is stale", 0.1, 60.0, mutable=True)
    count_timeout: float = param(5.0, "s", "Without a known count for this long the gate works without it", 0.5, 600.0)
    max_age: float = param(1.0, "s", "An older fix is refused", 0.05, 10.0, mutable=True)
    max_horizontal_sd: float = param(
        10.0, "m", "Largest stated horizontal deviation accepted", 0.1, 1000.0, mutable=True
    )
    max_vertical_sd: float = param(20.0, "m", "Largest stated vertical deviation accepted", 0.1, 1000.0, mutable=True)


@dataclass(frozen=True)
class ReacquisitionParameters:
    """Conditions under which GNSS is used again after an outage."""

    policy: str = param(
        "blend",
        "",
        "blend: expected returns are corrections, others resets; reset: all are resets; hold: unexpected ones wait",
        choices=("blend", "reset", "hold"),
    )
    fixes: int = param(5, "", "Mutually consistent fixes before GNSS is trusted again", 1, 100, mutable=True)
    min_duration: float = param(0.8, "s", "Shortest time that these fixes must span", 0.0, 60.0, mutable=True)
    sigmas: float = param(5.0, "", "Width of every statistical bound in standard deviations", 1.0, 20.0, mutable=True)
    max_speed: float = param(60.0, "m/s", "Maximum speed of the vehicle", 0.1, 400.0, mutable=True)
    max_acceleration: float = param(40.0, "m/s^2", "Maximum acceleration of the vehicle", 0.1, 500.0, mutable=True)
    velocity_tolerance: float = param(
        1.0, "m/s", "Disagreement allowed between a fix's velocity and its motion", 0.05, 20.0, mutable=True
    )
    contradiction_time: float = param(
        8.0, "s", "Persistence that outweighs the filter's own covariance", 0.5, 600.0, mutable=True
    )
    implausible_time: float = param(
        30.0, "s", "Persistence that outweighs the physical bound", 1.0, 3600.0, mutable=True
    )
    despair_gap: float = param(
        13.0,
        "s",
        "If GNSS was away for less and velocities contradict too, the attitude is wrong: align again",
        0.0,
        600.0,
        mutable=True,
    )
    track_timeout: float = param(2.0, "s", "A series of fixes that pauses for longer is dropped", 0.2, 60.0)
    probation: float = param(120.0, "s", "Longest time during which a return may be reopened", 0.0, 3600.0)


@dataclass(frozen=True)
class GnssParameters:
    """Latency, antenna and noise of the receiver."""

    delay: float = param(0.0, "s", "Stamp minus time of validity of a fix", -1.0, 1.0)
    delay_sd: float = param(
        0.2,
        "s",
        "Deviation of the latency while delay is 0, that is, not measured; motion reduces it. 0: the stamps are right",
        0.0,
        1.0,
        mutable=True,
    )
    lever_arm: tuple[float, ...] = param((0.0, 0.0, 0.0), "m", "From the IMU to the antenna, body frame", -50.0, 50.0)
    position_sd: float = param(1.5, "m", "Lower bound on the horizontal deviation of a fix", 0.001, 100.0, mutable=True)
    vertical_sd: float = param(2.5, "m", "Lower bound on the vertical deviation of a fix", 0.001, 100.0, mutable=True)
    velocity_sd: float = param(
        0.5, "m/s", "Lower bound on the horizontal deviation of a velocity", 0.001, 10.0, mutable=True
    )
    velocity_vertical_sd: float = param(
        0.75, "m/s", "Lower bound on the vertical deviation of a velocity", 0.001, 10.0, mutable=True
    )
    position_correlation: float = param(
        0.5, "s", "Fixes closer in time share their error, so each gets less weight", 0.0, 100.0, mutable=True
    )
    noise: str = param(
        "fixed",
        "",
        "Noise model of positions and velocities; fixed: as stated, with the floors above; others: estimated upwards",
        choices=tuple(MODELS),
    )
    error_states: bool = param(
        False, "", "Estimate time-correlated errors of positions and velocities (six states); see docs/outages.md"
    )
    gate: GateParameters = field(default_factory=GateParameters)
    reacquisition: ReacquisitionParameters = field(default_factory=ReacquisitionParameters)
