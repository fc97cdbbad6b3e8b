"""Search for the mounting with which a rejected beam sensor would agree with the navigator, as a hint to the user."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.geometry import Reading
from nav_pose_estimator.engine.imu.mounting import rotation_from_rpy

Array = NDArray[np.float64]

_KEPT = 40  # messages that are kept
_FIT = 3.0  # largest RMS of the normalised residuals of a mounting that fits
_CLEAR = 4.0  # factor to the best RMS beyond which a mounting is excluded
_SLOW = 2.0  # standard deviations of the velocity: slower messages are not kept, because every mounting fits
_MOUNTINGS = tuple((roll, 0.0, yaw) for roll in (0.0, math.pi) for yaw in (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi))
"""Roll, pitch, yaw of sensors with a vertical z axis, up or down."""


class _Message(NamedTuple):
    directions: Array  # (n, 3), as published
    velocities: Array  # (n,)
    in_body: Array  # (3,) velocity over ground in b that the navigator has
    sd: float


class MountingGuess:
    """Keeps the last messages that did not agree, with the navigator's velocity, and tests mountings on them."""

    def __init__(self) -> None:
        self._messages: deque[_Message] = deque(maxlen=_KEPT)

    def add(self, directions: Array, velocities: Array, in_body: Array, sd: float) -> None:
        """Add a message as published, (n, 3) and (n,) [m/s], NaN where lost.

        ``in_body`` (3,): the navigator's velocity over ground in b [m/s]; ``sd`` of beam and velocity together [m/s].
        """
        if np.linalg.norm(in_body) > _SLOW * sd:
            known = np.isfinite(velocities)
            self._messages.append(_Message(directions[known], velocities[known], in_body, sd))

    def sentence(self, readings: tuple[Reading, ...]) -> str:
        """One clause with the only mounting (or at least roll) that fits any of ``readings``; empty without one."""
        misfits = {rpy: min(self._misfit(reading, rpy) for reading in readings) for rpy in _MOUNTINGS}
        best = min(misfits.values())
        fitting = [rpy for rpy, misfit in misfits.items() if misfit < max(_CLEAR * best, 1.0)]
        if best > _FIT or len({roll for roll, _, _ in fitting}) > 1:
            return ""
        if len(fitting) > 1:
            return f"they would agree with a roll of {fitting[0][0]:.4f} in aids.beams.rpy"
        return f"they would agree with aids.beams.rpy [{', '.join(f'{angle:.4f}' for angle in fitting[0])}]"

    def _misfit(self, reading: Reading, rpy: tuple[float, float, float]) -> float:
        axes = rotation_from_rpy(rpy)
        squares = np.concatenate(
            [
                (reading.sign * m.velocities - reading.directions(m.directions) @ (axes.T @ m.in_body)) / m.sd
                for m in self._messages
            ]
            or [np.array([math.inf])]
        )
        return math.sqrt(float(np.square(squares).mean())) if len(squares) else math.inf
