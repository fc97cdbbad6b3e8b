"""Parameters of the strapdown navigator and its Kalman filter."""

from dataclasses import dataclass

from nav_pose_estimator.engine.parameters.schema import param


@dataclass(frozen=True)
class NavigatorParameters:
    """The filter, its optional states, its memory, and the times at which its mode changes."""

    covariance_period: float = param(0.04, "s", "Time between covariance steps", 0.001, 1.0)
    memory: float = param(1.5, "s", "How old an observation may be when it arrives", 0.1, 10.0)
    gyro_matrix_states: bool = param(True, "", "Estimate the gyroscope's scale factors and misalignments (9 states)")
    gyro_matrix_sd: float = param(
        0.01, "", "Deviation of scale factors and misalignments before they are known", 0.0, 0.1
    )
    gravity_states: bool = param(
        False, "", "Estimate the deviation from normal gravity (3 states); level flight cannot tell it from a bias"
    )
    gravity_sd: float = param(0.01, "m/s^2", "Deviation of gravity from normal gravity, each axis", 0.0, 0.01)
    gate_probability: float = param(
        0.999,
        "",
        "Probability up to which an innovation is used unchanged; above it the noise is inflated",
        0.5,
        0.999999,
        mutable=True,
    )
    reject_probability: float = param(
        0.999999999, "", "Probability above which an innovation is rejected", 0.5, 0.9999999999999, mutable=True
    )
    gap_rate_sd: float = param(0.3, "rad/s", "Unknown angular rate while IMU data are missing", 0.0, 10.0)
    gap_force_sd: float = param(2.0, "m/s^2", "Unknown specific force while IMU data are missing", 0.0, 50.0)
    lost_after: float = param(
        1.5, "s", "Time without a used fix after which GNSS counts as lost", 0.2, 30.0, mutable=True
    )
    expire_after: float = param(
        600.0, "s", "Time without any position after which the solution expires", 1.0, 1e6, mutable=True
    )
