"""What a vehicle is by how it moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import is_guided
from nav_pose_estimator.core.motion.airframe import FIXED_WING, MULTIROTOR, UNKNOWN, WHEELS
from nav_pose_estimator.core.motion.regimes import shows_hovering

Array = NDArray[np.float64]
_STALLS = 12.0  # m/s: few multirotors go faster all the time, few wings fly slower
_FAST = 3.0  # m/s: a vehicle is under way
_LEAST = 60.0  # s under way


def shown_class(epochs: Array) -> str:
    """The class of epochs (N, COLUMNS): a car does not slip, a wing does not hover and stalls when slow.

    ``UNKNOWN`` for what a multirotor does at speed, laps, say: a slow wing would look the same.
    """
    if is_guided(epochs):
        return WHEELS
    if shows_hovering(epochs):
        return MULTIROTOR
    return FIXED_WING if np.median(_speed(epochs)) > _STALLS else UNKNOWN


def contradiction(epochs: Array, vehicle_class: str) -> str:
    """The class that epochs (N, COLUMNS) show instead of ``vehicle_class``; empty where they may be of that one.

    Only what lies between the first and the last fast moment counts: before and after it a wing stands on the ground.
    """
    fast = np.flatnonzero(_speed(epochs) > _FAST)
    if vehicle_class == UNKNOWN or len(fast) * me.PERIOD < _LEAST:
        return ""
    shown = shown_class(epochs[fast[0] : fast[-1] + 1])
    return "" if shown in (UNKNOWN, vehicle_class) else shown


def _speed(epochs: Array) -> Array:
    return np.asarray(np.hypot(epochs[:, me.VELOCITY], epochs[:, me.VELOCITY + 1]))
