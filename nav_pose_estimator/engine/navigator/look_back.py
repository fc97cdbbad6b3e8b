"""What the last second of IMU data showed: whether the vehicle rests, and how noisy its sensors are."""

from __future__ import annotations

import math

from nav_pose_estimator.core.alignment.rest import Stillness
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import noise_identification
from nav_pose_estimator.engine.navigator.filter_run import FilterRun

_GROUNDED = 1.0  # m/s
_ROWS = 1.5 * noise_identification.PERIOD  # s: the last second began with the row before it


def look_back(run: FilterRun, t: float) -> None:
    """Ahead of the IMU row at ``t``, the first one of a second, on what the rows up to the one before showed.

    It is decided with what has arrived by then, and stays when the past is replayed.
    """
    run.second_due = (math.floor(t / Stillness.PERIOD) + 1.0) * Stillness.PERIOD
    whole, mean_rate = run.timeline.filter, run.stillness.add(run.timeline.recent_rows(Stillness.PERIOD))
    if run.parameters.imu.learn_noise:
        _identify_noise(run, rests=mean_rate is not None)
    if mean_rate is not None and run.parameters.aids.zero_velocity:
        run.observe(run.rest.observe(mean_rate, whole.view, run.clock.stamp(whole.time)))


def _identify_noise(run: FilterRun, rests: bool) -> None:
    whole = run.timeline.filter
    # a smooth cruise looks like rest; motors that do not run tell nothing of vibration
    grounded = rests and math.hypot(*whole.nav[at.VEL : at.VEL + 3].tolist()) < _GROUNDED
    if grounded or not run.aiding.gnss_is_good(whole.time) or whole.branches is not None:
        run.noise.interrupt()
    elif run.noise.note(whole.nav, whole.P, whole.constants, run.timeline.recent_rows(_ROWS)):
        run.gnss.reception.noise_variance = run.noise.gnss_variance
        run.renew_constants()
