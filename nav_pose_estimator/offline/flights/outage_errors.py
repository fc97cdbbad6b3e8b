"""How far the pose drifted in one outage: the measures that replay and the benchmark report.

``end_error_m`` is the horizontal error, mean over the fixes in the last 1.05 s of the outage: the figure does not hang
on the noise of a single fix, and at 1 Hz there is at least one.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.offline.flights.outages import Outage
from nav_pose_estimator.offline.flights.tracks import Reference, Track, displacement_enu

END_WINDOW = 1.05  # s
OK, NO_REFERENCE, NO_ESTIMATE, NOT_AIDED = "ok", "no_reference", "no_estimate", "not_aided"


@dataclass(frozen=True)
class OutageErrors:
    """Errors of one outage [m]; ``after`` (K,) [s], ``growth`` (K,) and ``sigma`` (K,) are the course of it.

    ``why`` says what the navigator was in doubt of where it was not aided.
    """

    start_s: float
    length_s: float
    end_error_m: float = math.nan
    rms_error_m: float = math.nan
    max_error_m: float = math.nan
    end_vertical_m: float = math.nan
    end_sigma_m: float = math.nan
    travelled_m: float = math.nan
    status: str = OK
    why: str = ""
    after: np.ndarray = field(default_factory=lambda: np.empty(0))
    growth: np.ndarray = field(default_factory=lambda: np.empty(0))
    sigma: np.ndarray = field(default_factory=lambda: np.empty(0))


def judge(
    outage: Outage, fix_times: np.ndarray, reference: Reference, track: Track, lever: np.ndarray | None = None
) -> OutageErrors:
    """Errors of ``track`` in ``outage`` against ``reference`` at the times of validity ``fix_times`` (M,) of all fixes.

    ``lever`` (3,) [m] leads from the IMU to the point that the reference describes. ``end_vertical_m`` is the mean of
    the vertical errors' magnitudes over the same fixes as ``end_error_m``, ``end_sigma_m`` the filter's horizontal
    deviation there.
    """
    times = fix_times[(fix_times >= outage.start) & (fix_times < outage.end)]
    at_end = times >= outage.end - END_WINDOW
    travelled = reference.travelled(outage.start, outage.end)
    if not at_end.any():
        return OutageErrors(outage.start, outage.length, travelled_m=travelled, status=NO_REFERENCE)
    truth = reference.at(times)
    errors = displacement_enu(track.antenna_at(times, np.zeros(3) if lever is None else lever), truth)
    if not np.isfinite(truth[at_end]).any():
        return OutageErrors(outage.start, outage.length, travelled_m=travelled, status=NO_REFERENCE)
    known = np.isfinite(errors).all(axis=1)
    if not (known & at_end).any():
        return OutageErrors(outage.start, outage.length, travelled_m=travelled, status=NO_ESTIMATE)
    sigma = Track(times, track.at(times)).horizontal_sd
    times, errors, sigma, at_end = times[known], errors[known], sigma[known], at_end[known]
    horizontal = np.linalg.norm(errors[:, :2], axis=1)
    return OutageErrors(
        start_s=outage.start,
        length_s=outage.length,
        end_error_m=float(horizontal[at_end].mean()),
        rms_error_m=float(math.sqrt(np.mean(horizontal**2))),
        max_error_m=float(horizontal.max()),
        end_vertical_m=float(np.abs(errors[at_end, 2]).mean()),
        end_sigma_m=float(sigma[at_end].mean()),
        travelled_m=travelled,
        after=times - outage.start,
        growth=horizontal,
        sigma=sigma,
    )
