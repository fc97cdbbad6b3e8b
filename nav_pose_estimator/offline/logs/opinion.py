"""The autopilot's own estimate in a log, for comparison in the report.

It is a :class:`Reference` and not a ``Sample``, so that it cannot be fed to an estimator.
"""

import numpy as np

from nav_pose_estimator.offline.flights.tracks import Reference

Array = np.ndarray
_LONGEST_US = 2_000_000  # longest interval between two rows over which the estimate is interpolated


def opinion(
    kind: str, placed: tuple[Array, Array, Array] | None, turned: tuple[Array, Array] | None
) -> Reference | None:
    """Join position and attitude, which are logged apart.

    ``placed``: times (N,) [µs], positions (N, 3) latitude, longitude [rad], height [m], velocities (N, 3) ENU.
    ``turned``: times (M,) [µs] and quaternions (M, 4) body FLU to ENU. Rows at the times of ``placed``, else of
    ``turned``, in seconds of the log. None if there is neither.
    """
    if placed is None and turned is None:
        return None
    if placed is None:
        assert turned is not None
        time_us, q_nb = turned
        nothing = np.full((len(time_us), 3), np.nan)
        return Reference(kind, time_us * 1e-6, nothing, None, q_nb)
    time_us, position, velocity = placed
    attitude = None if turned is None or len(turned[0]) < 2 else _nearest(time_us, *turned)
    return Reference(kind, time_us * 1e-6, position, velocity, attitude)


def _nearest(wanted_us: Array, time_us: Array, q_nb: Array) -> Array:
    """Attitudes (N, 4) nearest in time to ``wanted_us``; NaN where there is none within a second."""
    after = np.clip(np.searchsorted(time_us, wanted_us), 1, len(time_us) - 1)
    before = after - 1
    nearest = np.where(wanted_us - time_us[before] < time_us[after] - wanted_us, before, after)
    found = q_nb[nearest].copy()
    found[np.abs(time_us[nearest] - wanted_us) > _LONGEST_US // 2] = np.nan
    return found
