"""Saved state of a navigator as plain numbers, with the checks that a state must pass before it is used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.alignment.types import KnownBiases
from nav_pose_estimator.core.filter import bias_noise
from nav_pose_estimator.core.filter.layout import BASE_STATES, D_ACCEL_BIAS, D_GYRO_BIAS
from nav_pose_estimator.engine.number_checks import is_covariance, is_position, is_within
from nav_pose_estimator.engine.samples import Vector3
from nav_pose_estimator.errors import UserError

Place = tuple[float, float, float]
"""Latitude, longitude [rad], height above the ellipsoid [m]."""
_FASTEST = 400.0  # m/s: largest valid velocity component
_LARGEST_RATE, _LARGEST_FORCE = 1.0, 5.0  # rad/s, m/s^2: largest valid biases of an IMU
_FARTHEST = 1e7  # m: largest valid offset between map and odom
_LARGEST_NOISE = 16.0  # largest valid variance factor of the noise identification
_KNOWN_GYRO_SD = 0.01  # rad/s: with a larger deviation of the bias, a gentle turn cannot be distinguished from rest
_LEAST_SHARE, _LARGEST_SHARE = 0.01, 100.0  # range of valid error shares


@dataclass(frozen=True)
class SavedState:
    """A navigator at ``stamp_ns``; frames, units and the order of ``cov`` (15, 15) are those of ``core.filter.layout``.

    ``unaided``: s since the last position update by GNSS. ``correction_enu`` [m] and ``resets``: offset of odom in map,
    and number of its changes. ``compass_offset`` [rad] and ``baro_offset`` [m]: as learned by the sensors, NaN where
    unknown; ``baro_variance`` [m^2]: variance of the height from which the latter was learned;
    ``baro_least_sd`` [m]: floor of the height's standard deviation while the barometer is in doubt.
    ``body_velocity_error``: possible error of a body velocity that motion has confirmed, relative to the speed; NaN
    where it is not confirmed, or in doubt. ``error_shares``:
    lasting and white factor of GNSS positions, then of velocities (``core.filter.noise_identification``).
    ``gyro_wander``: identified driving noise of the gyroscope bias (``core.filter.bias_noise.Wander``). ``is_sound``:
    attitude and position may be continued, not only origin and noise.
    """

    stamp_ns: int
    origin: Place
    position: Place
    velocity: Vector3
    q_nb: tuple[float, float, float, float]
    gyro_bias: Vector3
    accel_bias: Vector3
    cov: NDArray[np.float64]
    unaided: float
    correction_enu: Vector3
    resets: int
    imu_variance: float
    gnss_variance: float
    trials: int
    error_shares: tuple[float, float, float, float]
    gyro_wander: tuple[float, float, float, float]
    compass_offset: float
    baro_offset: float
    baro_variance: float
    baro_least_sd: float
    body_velocity_error: float
    gate_is_open: bool
    is_sound: bool

    def arrays(self) -> dict[str, np.ndarray]:
        """All fields as arrays, by name."""
        return {item.name: np.asarray(getattr(self, item.name)) for item in fields(self)}

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> SavedState:
        """The state of ``arrays()``; ``UserError`` where a field is missing or its value is impossible."""
        # fields that files of earlier versions do not have
        since = {
            "error_shares": np.ones(4),
            "gyro_wander": np.array(bias_noise.Wander()),
            "baro_variance": np.zeros(()),
            "baro_least_sd": np.zeros(()),
            "body_velocity_error": np.array(math.nan),
        }
        arrays = {**since, **arrays}
        values = {name: _value(name, arrays, like) for name, like in _FORM.items()}
        state = cls(**values)
        if not state.is_possible:
            raise UserError("its numbers are beyond what a vehicle can do")
        return state

    @property
    def is_possible(self) -> bool:
        """Whether a vehicle can be in this state: all values are finite and within physical bounds."""
        offsets = (self.compass_offset, self.baro_offset, self.body_velocity_error)
        return (
            self.stamp_ns > 0
            and self.resets >= 0
            and self.trials >= 0
            and is_position(*self.origin)
            and is_position(*self.position)
            and is_within(self.velocity, _FASTEST)
            and abs(math.hypot(*self.q_nb) - 1.0) < 1e-3  # false for NaN
            and is_within(self.gyro_bias, _LARGEST_RATE)
            and is_within(self.accel_bias, _LARGEST_FORCE)
            and is_within(self.correction_enu, _FARTHEST)
            and 0.0 <= self.unaided < math.inf
            and 0.0 <= self.baro_variance < math.inf
            and 0.0 <= self.baro_least_sd < math.inf
            and not self.body_velocity_error < 0.0
            and all(1.0 <= one <= _LARGEST_NOISE for one in (self.imu_variance, self.gnss_variance))
            and all(_LEAST_SHARE <= one <= _LARGEST_SHARE for one in self.error_shares)
            and bias_noise.SMALLEST <= self.gyro_wander[0] <= bias_noise.LARGEST
            and all(0.0 <= one < math.inf for one in self.gyro_wander)
            and not any(map(math.isinf, offsets))
            and is_covariance(self.cov, BASE_STATES)
            and bool((self.cov.diagonal() > 0.0).all())
        )

    @property
    def biases(self) -> KnownBiases:
        """Biases of the IMU, with twice their saved standard deviations."""
        variances = self.cov.diagonal()
        gyro_sd, accel_sd = (2.0 * math.sqrt(variances[i : i + 3].max()) for i in (D_GYRO_BIAS, D_ACCEL_BIAS))
        return KnownBiases(self.gyro_bias, self.accel_bias, gyro_sd, accel_sd)

    @property
    def known_biases(self) -> KnownBiases | None:
        """``biases`` that are certain enough to distinguish rest from a gentle turn in an alignment, else None."""
        return self.biases if self.biases.gyro_sd <= _KNOWN_GYRO_SD else None


_FORM: dict[str, Any] = {
    **dict.fromkeys(("stamp_ns", "resets", "trials"), 0),
    **dict.fromkeys(("origin", "position", "velocity", "gyro_bias", "accel_bias", "correction_enu"), (0.0,) * 3),
    **dict.fromkeys(("q_nb", "error_shares", "gyro_wander"), (0.0,) * 4),
    "cov": np.zeros((BASE_STATES, BASE_STATES)),
    **dict.fromkeys(("unaided", "imu_variance", "gnss_variance"), 0.0),
    **dict.fromkeys(("compass_offset", "baro_offset", "baro_variance", "baro_least_sd"), 0.0),
    "body_velocity_error": 0.0,
    **dict.fromkeys(("gate_is_open", "is_sound"), False),
}
"""Form of each field: a value of its type and shape."""


def _value(name: str, arrays: Mapping[str, np.ndarray], like: Any) -> Any:
    form, value = np.asarray(like), arrays.get(name)
    if value is None or value.shape != form.shape or value.dtype.kind != form.dtype.kind:
        raise UserError(f"{name} is missing, or has a wrong type or shape")
    if isinstance(like, np.ndarray):
        return value.astype(float)
    return tuple(value.tolist()) if isinstance(like, tuple) else value.item()
