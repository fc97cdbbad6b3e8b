"""Results of the attitude benchmark for one filter and trial."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One filter on one trial: RMSE [deg], and the consistency of its standard deviations if it has any."""

    condition: str
    trial: str
    method: str
    inclination_deg: float  # without magnetometer
    heading_deg: float  # with magnetometer, as the following
    total_deg: float
    tilt_in_95: float = float("nan")  # fraction of samples whose tilt error is within the filter's 95 % region
    heading_in_95: float = float("nan")
    tilt_nes: float = float("nan")  # normalised error squared per degree of freedom: 1 if consistent, less if cautious
    heading_nes: float = float("nan")
    us_per_sample: float = float("nan")  # with magnetometer, this process, one run
