"""Error measures of one outage, as reported by replay and benchmark.

``end_error_m`` is the mean horizontal error over the fixes in the last 1.05 s of the outage, so that it does not depend
on the noise of a single fix, and at 1 Hz contains at least one.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.offline.flights.outages import Outage
from nav_pose_estimator.offline.flights.tracks import Reference, Track, displacement_enu

END_WINDOW = 1.05  # s: end of an outage over which errors are averaged
OK, NO_REFERENCE, NO_ESTIMATE, NOT_AIDED = "ok", "no_reference", "no_estimate", "not_aided"


@dataclass(frozen=True)
class OutageErrors:
    """Errors of one outage [m]. ``growth`` and ``sigma`` (K,) [m]: horizontal error and sigma ``after`` (K,) [s].

    ``why``: the navigator's doubt, if it was not aided before the outage.
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

    ``lever`` (3,) [m] in b is the vector from the IMU to the point of the reference. ``end_vertical_m`` is the mean
    magnitude of the vertical errors, and ``end_sigma_m`` the filter's mean horizontal sigma, over the same fixes as
    ``end_error_m``.
    """
    times = fix_times[outage.contains(fix_times)]
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
