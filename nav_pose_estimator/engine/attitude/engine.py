"""Attitude engine: IMU, magnetometer and the navigator's velocity in; attitude with covariance and events out."""

import copy
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from nav_pose_estimator.core.attitude import layout as at
from nav_pose_estimator.core.attitude.motion import subtract_velocity_change, turn_heading
from nav_pose_estimator.engine.attitude.filters import KERNELS, MAKE_STATE
from nav_pose_estimator.engine.parameters import Parameters, schema
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, MagSample, NavigatorVelocity, Sample, Vector3
from nav_pose_estimator.engine.sensors.imu import (
    CLOCK_JUMP,
    RESTARTS,
    SATURATED_ACCEL,
    SATURATED_END,
    SATURATED_GYRO,
    STUCK,
    STUCK_END,
    ImuInput,
)
from nav_pose_estimator.engine.solutions import AttitudeBlock, AttitudeSolution, Event, Level, Mode, Output, Status
from nav_pose_estimator.errors import UserError

_NS = 1e-9
_FIRST_NS = 1_000_000_000  # stamp of the first recorded sample
_NO_FIELD = np.empty((0, 3))
_DISTURBED, _UNDISTURBED = 0.1, 0.5  # trusts of the field at which a disturbance begins and ends
_STALE_MAG_NS = 500_000_000
_VELOCITY_GAP_NS = 1_000_000_000
_KNOWN_HEADING = 0.35  # rad: a wider heading cannot turn the navigator's velocity into the filter's axes

_HEALTHY = {at.EXTRA_PSD: 0.0, at.EXTRA_SWAY_PSD: 0.0, at.FROZEN: 0.0}
_SENSOR_TROUBLE: dict[str, dict[int, float]] = {
    SATURATED_GYRO: {at.EXTRA_PSD: 0.1},  # about 1 rad/s missing, for about 0.1 s
    SATURATED_ACCEL: {at.EXTRA_SWAY_PSD: 2.5},  # about 5 m/s^2 missing, for about 0.1 s
    SATURATED_END: _HEALTHY,
    STUCK: {at.EXTRA_PSD: 0.1, at.FROZEN: 1.0},
    STUCK_END: _HEALTHY,
}
"""What the filter has to know of a sensor in trouble, by the event that tells of it."""


@dataclass
class _Memory:
    """All that changes while the engine runs."""

    state: np.ndarray
    last_ns: int | None = None
    started_ns: int = 0
    mag_ns: int | None = None
    disturbed: bool = False
    velocity: NavigatorVelocity | None = None


class AttitudeEngine:
    """Attitude from a stream of samples; see ``AttitudeParameters`` for the choice of filter. Not thread-safe."""

    def __init__(self, parameters: Parameters | None = None) -> None:
        self._parameters = parameters or Parameters()
        p = self._parameters.attitude
        self._kernels = KERNELS[p.filter]
        self._door = ImuInput(self._parameters.imu)
        self._hard_iron = np.array(p.hard_iron)
        self._soft_iron = np.array(p.soft_iron).reshape(3, 3)
        self._iron_free = not self._hard_iron.any() and np.array_equal(self._soft_iron, np.eye(3))
        self._counters: Counter[str] = Counter()
        self._memory = self._fresh()

    def _fresh(self) -> _Memory:
        return _Memory(MAKE_STATE[self._parameters.attitude.filter](self._parameters))

    # --- the face shared by all engines ----------------------------------------------------------------------------

    def feed(self, sample: Sample) -> list[Output]:
        """Solutions and events that follow from ``sample``, in order. Samples that are of no use here give nothing."""
        if isinstance(sample, ImuSample):
            if self._door.passes(sample):
                return [
                    self._on_imu(sample.stamp_ns, self._door.to_body(sample.gyro), self._door.to_body(sample.accel))
                ]
            return [self._handle(item) for item in self._door.accept(sample)]
        if isinstance(sample, ImuBlock):
            return [self._handle(item) for item in self._door.accept_block(sample)]
        if isinstance(sample, MagSample):
            return [self._handle(item) for item in self._on_mag(sample)]
        if isinstance(sample, NavigatorVelocity):
            return [self._handle(item) for item in self._on_velocity(sample)]
        return []

    def _handle(self, item: ImuSample | ImuBlock | Event) -> Output:
        """One thing at a time, in order: an event in the middle of a block acts before what follows it."""
        if isinstance(item, ImuSample):
            return self._on_imu(item.stamp_ns, item.gyro, item.accel)
        if isinstance(item, ImuBlock):
            return self._on_block(item)
        self._counters[item.name] += 1
        if item.name in RESTARTS:
            self._restart(item.name)
        for slot, value in _SENSOR_TROUBLE.get(item.name, {}).items():
            self._memory.state[slot] = value
        return item

    @property
    def mode(self) -> Mode:
        """AIDED once the attitude is level."""
        if self._memory.last_ns is None:
            return Mode.WAITING_IMU
        return Mode.AIDED if self._age() >= 1.0 else Mode.ALIGNING

    def status(self) -> Status:
        """How the filter stands; ``values`` holds deviations [deg] and what was learned."""
        memory, s = self._memory, self._memory.state
        values = {
            "tilt_sd_deg": math.degrees(math.sqrt(max(s[at.COV], s[at.COV + 4]))),
            "yaw_sd_deg": math.degrees(math.sqrt(s[at.COV + 8])),
            "gyro_bias_deg_s": math.degrees(float(np.linalg.norm(s[at.BIAS : at.BIAS + 3]))),
            "field_trust": float(s[at.FIELD_TRUST]) if memory.mag_ns is not None else 0.0,
        }
        return Status(
            stamp_ns=memory.last_ns or 0,
            mode=self.mode,
            waiting_for=self._waiting_for(),
            seconds_coasting=0.0,
            horizontal_sd=math.nan,
            horizontal_sd_in_30_s=math.nan,
            gnss_refusal="",
            satellites=None,
            counters=dict(self._counters),
            values=values,
        )

    def snapshot(self) -> Any:
        """Everything that changes, to be given to :meth:`restore`. Counters go on counting."""
        return copy.deepcopy(self._memory), self._door.snapshot()

    def restore(self, snapshot: Any) -> None:
        """Go back to an earlier :meth:`snapshot`."""
        memory, door = snapshot
        self._memory = copy.deepcopy(memory)
        self._door.restore(door)

    def set_parameters(self, parameters: Parameters) -> None:
        """Take new constants while the filter runs; estimates stay. The filter itself must be the same."""
        self._parameters = parameters
        state, declination = self._memory.state, self._memory.state[at.DECLINATION]
        state[at.PERIOD : at.OWN] = MAKE_STATE[parameters.attitude.filter](parameters)[at.PERIOD : at.OWN]
        state[at.DECLINATION] = declination

    def set_declination(self, declination: float) -> None:
        """Magnetic declination [rad], east positive, known only now: a heading from the field turns with it."""
        state = self._memory.state
        change = declination - state[at.DECLINATION]
        if change == 0.0:
            return
        if state[at.FIELD_H] > 0.0:
            turn_heading(state, -change)
        state[at.DECLINATION] = declination

    def reset(self, stamp_ns: int, reason: str) -> list[Output]:
        """Forget everything but the counters and the declination, and say why."""
        self._start_anew()
        self._door.reset()
        text = f"the attitude filter starts anew: {reason}"
        return [self._handle(Event(stamp_ns, "attitude.reset", Level.WARN, text))]

    def warm_up(self) -> None:
        """Compile (or load) every kernel now, so that no sample has to wait for it."""
        twin, stamps = AttitudeEngine(self._parameters), np.array([1, 2]) * 10_000_000
        twin.feed(
            ImuBlock(stamps, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e-3]]), np.array([[0, 0, 9.8], [0, 0, 9.81]]))
        )
        twin.feed(ImuSample(30_000_000, (0.0, 0.0, 2e-3), (0.0, 0.0, 9.82)))
        twin.feed(MagSample(30_000_000, (0.0, 2e-5, -4e-5)))
        twin.set_declination(0.1)
        twin.feed(NavigatorVelocity(20_000_000, (0.0, 0.0, 0.0)))
        twin.feed(NavigatorVelocity(30_000_000, (0.0, 0.0, 0.0)))

    # --- IMU -------------------------------------------------------------------------------------------------------

    def _on_imu(self, stamp_ns: int, gyro: Vector3, accel: Vector3) -> AttitudeSolution:
        memory = self._memory
        if memory.last_ns is None:
            memory.last_ns = memory.started_ns = stamp_ns
        self._kernels.step(memory.state, (stamp_ns - memory.last_ns) * _NS, *gyro, *accel)
        memory.last_ns = stamp_ns
        return AttitudeSolution(stamp_ns, memory.state[: at.HEAD_SIZE].copy())

    def _on_block(self, block: ImuBlock) -> AttitudeBlock:
        return AttitudeBlock(block.stamps_ns, self._run(block, _NO_FIELD))

    def _run(self, block: ImuBlock, field: np.ndarray) -> np.ndarray:
        """Rows (N, BLOCK_COLUMNS) of accepted samples; ``field`` (N, 3) or (0, 3) in b."""
        memory = self._memory
        if memory.last_ns is None:
            memory.last_ns = memory.started_ns = int(block.stamps_ns[0])
        rows = np.empty((len(block), at.BLOCK_COLUMNS))
        self._kernels.run(memory.state, memory.last_ns, block.stamps_ns, block.gyro, block.accel, field, rows)
        memory.last_ns = int(block.stamps_ns[-1])
        return rows

    def _start_anew(self) -> None:
        declination = self._memory.state[at.DECLINATION]
        self._memory = self._fresh()
        self._memory.state[at.DECLINATION] = declination

    def _restart(self, name: str) -> None:
        """Start levelling again; what was learned of the sensors stays unless the clock is a new one."""
        memory = self._memory
        if name == CLOCK_JUMP:
            self._start_anew()
            return
        memory.state[at.AGE] = -1.0
        memory.last_ns, memory.velocity = None, None

    # --- magnetometer and navigator --------------------------------------------------------------------------------

    def _on_mag(self, sample: MagSample) -> list[Event]:
        memory, stamp = self._memory, sample.stamp_ns
        if not self._parameters.aids.magnetometer:
            return [Event(stamp, "mag.ignored")]
        if not all(map(math.isfinite, sample.field)):
            return [Event(stamp, "mag.rejected.nan")]
        if memory.last_ns is None:
            return [Event(stamp, "mag.rejected.no_attitude_yet")]
        if memory.mag_ns is not None and stamp <= memory.mag_ns:
            return [Event(stamp, "mag.rejected.stamp")]
        if abs(stamp - memory.last_ns) > _STALE_MAG_NS:
            return [Event(stamp, "mag.rejected.stale")]
        memory.mag_ns = stamp
        field = sample.field
        if not self._iron_free:
            field = tuple((self._soft_iron @ (np.array(field) - self._hard_iron)).tolist())
        self._kernels.add_magnetic_field(memory.state, *self._door.to_body(field))
        return self._disturbance(stamp)

    def _disturbance(self, stamp: int) -> list[Event]:
        """Begin and end of a disturbed magnetic field; each refused sample is counted."""
        memory, weight = self._memory, self._memory.state[at.FIELD_TRUST]
        events = [Event(stamp, "mag.rejected.disturbed")] if weight < _DISTURBED else []
        if weight < _DISTURBED and not memory.disturbed:
            memory.disturbed = True
            text = "the magnetic field is disturbed: heading by gyroscope alone"
            return [*events, Event(stamp, "mag.disturbed", Level.WARN, text)]
        if weight > _UNDISTURBED and memory.disturbed:
            memory.disturbed = False
            return [Event(stamp, "mag.undisturbed", Level.INFO, "the magnetic field is undisturbed again")]
        return events

    def _on_velocity(self, sample: NavigatorVelocity) -> list[Event]:
        memory, stamp, before = self._memory, sample.stamp_ns, self._memory.velocity
        if not all(map(math.isfinite, sample.vel_enu)):
            return [Event(stamp, "navigator_velocity.rejected.nan")]
        if memory.last_ns is None:
            return [Event(stamp, "navigator_velocity.rejected.no_attitude_yet")]
        if before is not None and stamp <= before.stamp_ns:
            return [Event(stamp, "navigator_velocity.rejected.stamp")]
        memory.velocity = sample
        if before is None or not (sample.valid and before.valid) or stamp - before.stamp_ns > _VELOCITY_GAP_NS:
            return []
        turn = self._heading_from(sample)
        if turn is None:
            return [Event(stamp, "navigator_velocity.ignored.heading_unknown")]
        dt, c, d = (stamp - before.stamp_ns) * _NS, math.cos(turn), math.sin(turn)
        east, north, up = (now - then for now, then in zip(sample.vel_enu, before.vel_enu, strict=True))
        change = (c * east - d * north, d * east + c * north, up)
        speed = -1.0 if sample.drifting else math.hypot(*sample.vel_enu)
        subtract_velocity_change(memory.state, change, dt, 2.0 * dt, speed)
        return []

    def _heading_from(self, sample: NavigatorVelocity) -> float | None:
        """Angle from the navigator's axes to the filter's about Up; None when neither can be trusted to be the same."""
        s = self._memory.state
        if sample.q_nb is None:
            return 0.0 if s[at.COV + 8] < _KNOWN_HEADING**2 else None
        (a, b, c, d), (w, x, y, z) = s[at.QUAT : at.QUAT + 4].tolist(), sample.q_nb
        return 2.0 * math.atan2(d * w - a * z + c * x - b * y, a * w + b * x + c * y + d * z)

    # --- recorded arrays -------------------------------------------------------------------------------------------

    def feed_recorded(self, block: ImuBlock, mag: np.ndarray | None = None) -> AttitudeBlock:
        """One row for every sample of ``block``, refused ones included: they repeat the row ahead of them.

        ``mag`` (N, 3) is the field that follows each IMU sample, any unit, NaN for none.
        """
        if not len(block):
            return AttitudeBlock(block.stamps_ns, np.empty((0, at.BLOCK_COLUMNS)))
        field = _NO_FIELD if mag is None or not self._parameters.aids.magnetometer else self._field_in_b(mag)
        items = self._door.accept_block(block)
        if len(items) == 1 and isinstance(items[0], ImuBlock) and len(items[0]) == len(block):
            return AttitudeBlock(block.stamps_ns, self._run(items[0], field))
        rows = np.full((len(block), at.BLOCK_COLUMNS), np.nan)
        done = 0
        for item in items:
            if isinstance(item, Event):
                self._handle(item)
                continue
            stamps, first = np.unique(block.stamps_ns[done:], return_index=True)
            where = done + first[np.searchsorted(stamps, item.stamps_ns)]
            rows[where] = self._run(item, field[where] if len(field) else _NO_FIELD)
            done = int(where[-1]) + 1
        return AttitudeBlock(block.stamps_ns, _hold(rows))

    def _field_in_b(self, mag: np.ndarray) -> np.ndarray:
        field = (np.asarray(mag, dtype=float) - self._hard_iron) @ self._soft_iron.T
        return np.column_stack(self._door.to_body(tuple(field.T)))

    # --- the rest --------------------------------------------------------------------------------------------------

    def _age(self) -> float:
        return ((self._memory.last_ns or 0) - self._memory.started_ns) * _NS

    def _waiting_for(self) -> str:
        if self._memory.last_ns is None:
            return "no IMU sample has come yet"
        if self._age() < 1.0:
            return "levelling: the first second of data"
        return ""


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
    or dotted names in it (``{"attitude.wander": 0.003}``). Returns (N, 4) quaternions w, x, y, z that take body (FLU)
    to ENU; without a magnetometer the yaw starts near 0. A sample that has to be refused (NaN, out of range, out of
    order) repeats the estimate ahead of it.
    """
    t, gyro, accel = (np.ascontiguousarray(x, dtype=float) for x in (t, gyro, accel))
    _check_shapes(t, gyro, accel, mag)
    tree, changes = (params, {}) if isinstance(params, Parameters) else (Parameters(), dict(params or {}))
    if changes or method != tree.attitude.filter:
        tree = schema.update(tree, {**changes, "attitude.filter": method})
    engine = AttitudeEngine(tree)
    stamps = np.rint((t - t[:1]) * 1e9).astype(np.int64) + _FIRST_NS
    return engine.feed_recorded(ImuBlock(stamps, gyro, accel), mag).q_nb


def _check_shapes(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, mag: np.ndarray | None) -> None:
    if t.ndim != 1:
        raise UserError(f"t has shape {t.shape}, not (N,)")
    for name, value in (("gyro", gyro), ("accel", accel), ("mag", mag)):
        if value is not None and np.shape(value) != (len(t), 3):
            raise UserError(f"{name} has shape {np.shape(value)}, not ({len(t)}, 3) as t has {len(t)} values")
    if not np.isfinite(t).all():
        raise UserError("t holds NaN or infinity")


def _hold(rows: np.ndarray) -> np.ndarray:
    """``rows`` with each NaN row replaced by the row ahead of it; ahead of the first, level and all unknown."""
    last = np.maximum.accumulate(np.where(np.isnan(rows[:, 0]), -1, np.arange(len(rows))))
    held = rows[np.maximum(last, 0)]
    held[last < 0] = 0.0
    held[last < 0, at.BLOCK_QUAT] = 1.0
    held[last < 0, at.BLOCK_TILT_VAR : at.BLOCK_BIAS] = math.pi**2 / 3.0
    return held
