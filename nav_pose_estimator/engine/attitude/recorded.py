"""Attitude from recorded arrays, by the same engine as in flight: causal, row by row."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from nav_pose_estimator.core.attitude import layout as at
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.attitude.field import NO_FIELD
from nav_pose_estimator.engine.parameters import Parameters, schema
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.engine.solutions import AttitudeBlock, Event
from nav_pose_estimator.errors import UserError

_FIRST_NS = 1_000_000_000  # stamp of the first recorded sample


def estimate_attitude(
    t: np.ndarray,
    gyro: np.ndarray,
    accel: np.ndarray,
    mag: np.ndarray | None = None,
    method: str = "complementary",
    params: Mapping[str, Any] | Parameters | None = None,
) -> np.ndarray:
    """Attitude of recorded data, causal: row k uses rows 0 ... k only.

    ``t`` (N,) [s], increasing; ``gyro`` (N, 3) [rad/s]; ``accel`` (N, 3) [m/s^2], +g up at rest; ``mag`` (N, 3), any
    unit, NaN rows where there is none, or None. ``method`` complementary or two_stage. ``params`` the parameter tree,
    or dotted names in it (``{"attitude.wander": 0.003}``). Returns (N, 4) quaternions w, x, y, z from body (FLU) to
    ENU; without a magnetometer the yaw starts near 0. At a rejected sample (NaN, out of range, out of order) the
    previous estimate is repeated. Raises ``UserError`` for arrays of a wrong shape.
    """
    t, gyro, accel = (np.ascontiguousarray(x, dtype=float) for x in (t, gyro, accel))
    _check_shapes(t, gyro, accel, mag)
    tree, changes = (params, {}) if isinstance(params, Parameters) else (Parameters(), dict(params or {}))
    if changes or method != tree.attitude.filter:
        tree = schema.update(tree, {**changes, "attitude.filter": method})
    engine = AttitudeEngine(tree)
    stamps = np.rint((t - t[:1]) * 1e9).astype(np.int64) + _FIRST_NS
    return feed_recorded(engine, ImuBlock(stamps, gyro, accel), mag).q_nb


def _check_shapes(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, mag: np.ndarray | None) -> None:
    if t.ndim != 1:
        raise UserError(f"t has shape {t.shape}, not (N,)")
    for name, value in (("gyro", gyro), ("accel", accel), ("mag", mag)):
        if value is not None and np.shape(value) != (len(t), 3):
            raise UserError(f"{name} has shape {np.shape(value)}, not ({len(t)}, 3) as t has {len(t)} values")
    if not np.isfinite(t).all():
        raise UserError("t holds NaN or infinity")


def feed_recorded(engine: AttitudeEngine, block: ImuBlock, mag: np.ndarray | None = None) -> AttitudeBlock:
    """One row for every sample of ``block``; a rejected sample repeats the previous row.

    ``mag`` (N, 3) is the field that follows each IMU sample, any unit, NaN for none.
    """
    if not len(block):
        return AttitudeBlock(block.stamps_ns, np.empty((0, at.BLOCK_COLUMNS)))
    field = NO_FIELD if mag is None else engine.field.many_in_body(mag)
    items = engine.input.accept_block(block)
    if len(items) == 1 and isinstance(items[0], ImuBlock) and len(items[0]) == len(block):
        return AttitudeBlock(block.stamps_ns, engine.run(items[0], field))
    rows = np.full((len(block), at.BLOCK_COLUMNS), np.nan)
    done = 0
    for item in items:
        if isinstance(item, Event):
            engine.note(item)
            continue
        stamps, first = np.unique(block.stamps_ns[done:], return_index=True)
        where = done + first[np.searchsorted(stamps, item.stamps_ns)]
        rows[where] = engine.run(item, field[where] if len(field) else NO_FIELD)
        done = int(where[-1]) + 1
    return AttitudeBlock(block.stamps_ns, _hold(rows))


def _hold(rows: np.ndarray) -> np.ndarray:
    """``rows`` with each NaN row replaced by the previous one; before the first valid row, level and unknown."""
    last = np.maximum.accumulate(np.where(np.isnan(rows[:, 0]), -1, np.arange(len(rows))))
    held = rows[np.maximum(last, 0)]
    held[last < 0] = 0.0
    held[last < 0, at.BLOCK_QUAT] = 1.0
    held[last < 0, at.BLOCK_TILT_VAR : at.BLOCK_BIAS] = math.pi**2 / 3.0
    return held
