"""A calibration as a parameter file, with comments about its data, its residuals, and what was not observable."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.alignment.levelling import likely_unit
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.calibration.field_fit import FieldFit
from nav_pose_estimator.offline.calibration.field_pairs import LAG, LONGEST_STEP, FieldPairs
from nav_pose_estimator.offline.calibration.rests import Rests, accelerometer_errors
from nav_pose_estimator.offline.flights.recording import Recording

_FEWEST = 100  # smallest number of pairs
_MUCH = 20.0  # deg in ``LAG``: the vehicle turned, but not about all axes
_WORST = 15.0  # deg rms: largest residual of an accepted calibration
_AXES = "xyz"


def check(pairs: FieldPairs, paths: Sequence[Path]) -> None:
    """Raise ``UserError`` for too few pairs, and for a field in another unit."""
    names = ", ".join(path.name for path in paths)
    if len(pairs) < _FEWEST:
        raise UserError(
            f"{names}: only {len(pairs)} pairs of fields {LAG:g} s apart without a gap of {LONGEST_STEP:g} s in IMU or "
            f"magnetometer, {_FEWEST} are needed: record longer, and the magnetometer at 5 Hz or more"
        )
    strength = float(np.median(np.linalg.norm(pairs.before, axis=1)))
    unit = likely_unit(strength * 1e-6)
    if unit:
        raise UserError(f"{names}: a magnetic field of {strength * 1e-6:.3g} is in {unit}; publish tesla")


def _angles(pairs: FieldPairs) -> np.ndarray:
    trace = np.trace(pairs.turn, axis1=1, axis2=2)
    return np.asarray(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)))


def summary(fit: FieldFit) -> str:
    """One line for the terminal."""
    unseen = _unseen(fit)
    return f"the field agrees with the gyroscope to {fit.after_deg:.1f} deg rms, before {fit.before_deg:.1f} deg" + (
        f"; not observable: {'; '.join(unseen)}" if unseen else ""
    )


def _unseen(fit: FieldFit) -> list[str]:
    unseen = []
    if not fit.sees_iron.all():
        axes = ", ".join(axis for axis, seen in zip(_AXES, fit.sees_iron, strict=True) if not seen)
        unseen.append(f"hard iron along {axes} (to {fit.iron_sd.max():.0f} uT only)")
    if not fit.sees_shape:
        unseen.append("soft iron")
    if not fit.sees_mounting:
        unseen.append("mounting (turn about more axes)")
    return unseen


def parameter_file(fit: FieldFit, pairs: FieldPairs, rests: Rests, recordings: Sequence[Recording]) -> str:
    """Text of the file. Raises ``UserError`` for too little rotation, and where the field contradicts the gyroscope."""
    names = ", ".join(r.path.name for r in recordings)
    if fit.after_deg > _WORST:
        raise UserError(
            f"{names}: the field does not turn with the gyroscope ({fit.after_deg:.0f} deg rms at best): "
            "currents or steel nearby, or inconsistent stamps"
        )
    if fit.sees_iron.sum() < 2:
        angle = math.degrees(float(np.percentile(_angles(pairs), 90)))
        why = f"nine tenths of the time less than {angle:.0f} deg in {LAG:.0f} s"
        if angle > _MUCH:
            why = (
                f"the hard iron is known to {_numbers(fit.iron_sd, 0)} uT only: not about all axes, or currents disturb"
            )
        raise UserError(
            f"{names}: too little rotation to calibrate a magnetometer ({why}); "
            "turn the vehicle once around each of its axes"
        )
    lengths = ", ".join(f"{r.path.name} ({r.duration:.0f} s)" for r in recordings)
    comments = [
        f"Magnetometer calibration by 'calibrate' from {lengths}: {len(pairs)} pairs of fields {LAG:.0f} s apart.",
        f"The field agrees with the gyroscope to {fit.after_deg:.1f} deg rms; as published {fit.before_deg:.1f} deg.",
        f"Strength {fit.strength:.1f} uT. Rotated by up to {math.degrees(float(_angles(pairs).max())):.0f} deg in "
        f"{LAG:.0f} s.",
        f"Standard deviations: hard iron {_numbers(fit.iron_sd, 1)} uT, soft iron {fit.shape_sd:.3f}, mounting "
        f"{math.degrees(fit.angle_sd):.1f} deg.",
        *(f"Not observable, unchanged: {one}." for one in _unseen(fit)),
        *(["The driver publishes mirrored axes; the last row of soft_iron corrects it."] if fit.is_mirror else []),
        *(
            ["The place is unknown: a field that is reversed as a whole cannot be detected."]
            if not pairs.down.any()
            else []
        ),
        *_imu_comments(rests),
    ]
    rotation = fit.rotation if fit.sees_mounting else np.eye(3)
    soft = fit.soft_iron if fit.sees_shape else np.diag(np.sign(np.diag(fit.soft_iron)))
    lines = [
        "/**:",
        "  ros__parameters:",
        f"    attitude.hard_iron: {_numbers(np.where(fit.sees_iron, fit.hard_iron, 0.0) * 1e-6, 9)}",
        f"    attitude.soft_iron: {_numbers(soft.ravel(), 5)}",
        f"    aids.magnetometer_rpy: {_numbers(_rpy(rotation), 5)}",
        *_accelerometer_lines(rests),
    ]
    return "\n".join([*(f"# {one}" for one in comments), *lines]) + "\n"


def _imu_comments(rests: Rests) -> list[str]:
    """Comments about the IMU at rest; the gyroscope bias is only for information, as the navigator estimates it."""
    bias = rests.gyro_bias
    if bias is None:
        return ["No rest of 2 s: the gyroscope bias was assumed to be zero."]
    sides = len(rests.sides())
    seen = "below" if accelerometer_errors(rests.sides()) is not None else f"{sides} sides at rest, 6 are needed"
    force = f"accelerometer: {seen}"
    return [f"At rest: gyroscope bias {_numbers(bias, 5)} rad/s; {force}."]


def _accelerometer_lines(rests: Rests) -> list[str]:
    """Lines of the accelerometer's parameters; none unless there were rests on six sides."""
    found = accelerometer_errors(rests.sides())
    if found is None:
        return []
    return [f"    imu.accel_bias: {_numbers(found[0], 4)}", f"    imu.accel_scale: {_numbers(found[1], 5)}"]


def _rpy(C: np.ndarray) -> np.ndarray:
    pitch = -math.asin(max(-1.0, min(1.0, C[2, 0])))
    return np.array([math.atan2(C[2, 1], C[2, 2]), pitch, math.atan2(C[1, 0], C[0, 0])])


def _numbers(values: np.ndarray, digits: int) -> str:
    return "[" + ", ".join(f"{value + 0.0:.{digits}f}" for value in values) + "]"
