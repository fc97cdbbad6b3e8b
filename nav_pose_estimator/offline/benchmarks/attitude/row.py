"""One line of the attitude benchmark."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One filter on one trial: RMSE [deg]; the filter's own deviation against the error, where it gives one."""

    condition: str
    trial: str
    method: str
    inclination_deg: float  # without magnetometer
    heading_deg: float  # with magnetometer, as the following
    total_deg: float
    tilt_in_95: float = float("nan")  # share of samples whose tilt error lies in the filter's own 95 % region
    heading_in_95: float = float("nan")
    tilt_nes: float = float("nan")  # mean squared error over variance and degree of freedom: 1 if true, less if careful
    heading_nes: float = float("nan")
    us_per_sample: float = float("nan")  # with magnetometer, this process, one run
