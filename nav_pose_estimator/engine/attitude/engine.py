"""Attitude engine: attitude with covariance from IMU, magnetometer and a velocity (navigator or wheels)."""

import copy
import math
from collections import Counter
from typing import Any

import numpy as np

from nav_pose_estimator.core.attitude import layout as at
from nav_pose_estimator.core.attitude import navigator_aid
from nav_pose_estimator.core.attitude.motion import turn_heading
from nav_pose_estimator.engine.attitude.body_velocity import BodyVelocityInput
from nav_pose_estimator.engine.attitude.field import NO_FIELD, FieldInput
from nav_pose_estimator.engine.attitude.filters import KERNELS, MAKE_STATE
from nav_pose_estimator.engine.attitude.memory import Memory, take_velocity
from nav_pose_estimator.engine.imu.input import ImuInput
from nav_pose_estimator.engine.imu.rules import (
    CLOCK_JUMP,
    RESTARTS,
    SATURATED_ACCEL,
    SATURATED_END,
    SATURATED_GYRO,
    STUCK,
    STUCK_END,
)
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import (
    BodyVelocity,
    ImuBlock,
    ImuSample,
    MagSample,
    NavigatorVelocity,
    Sample,
    Vector3,
)
from nav_pose_estimator.engine.solutions import AttitudeBlock, AttitudeSolution, Event, Level, Mode, Output, Status

_NS = 1e-9
_NOWHERE, _NOTHING = np.empty(0, np.int64), np.empty((0, navigator_aid.SIZE))

_HEALTHY = {at.EXTRA_PSD: 0.0, at.EXTRA_SWAY_PSD: 0.0, at.FROZEN: 0.0}
_SENSOR_TROUBLE: dict[str, dict[int, float]] = {
    SATURATED_GYRO: {at.EXTRA_PSD: 0.1},  # about 1 rad/s missing, for about 0.1 s
    SATURATED_ACCEL: {at.EXTRA_SWAY_PSD: 2.5},  # about 5 m/s^2 missing, for about 0.1 s
    SATURATED_END: _HEALTHY,
    STUCK: {at.EXTRA_PSD: 0.1, at.FROZEN: 1.0},
    STUCK_END: _HEALTHY,
}
"""Settings of the filter for a faulty sensor, by the event that reports the fault."""


class AttitudeEngine:
    """Attitude from a stream of samples; see ``AttitudeParameters`` for the choice of filter. Not thread-safe."""

    def __init__(self, parameters: Parameters | None = None) -> None:
        self._parameters = parameters or Parameters()
        self._kernels = KERNELS[self._parameters.attitude.filter]
        self.input = ImuInput(self._parameters.imu)
        self.field = FieldInput(self._parameters, self._kernels)
        self._body_velocity = BodyVelocityInput(self._parameters)
        self._counters: Counter[str] = Counter()
        self.memory = _fresh(self._parameters)

    # --- interface of all engines ----------------------------------------------------------------------------------

    def feed(self, sample: Sample) -> list[Output]:
        """Solutions and events that follow from ``sample``, in order; empty for samples that are not used here."""
        if isinstance(sample, ImuSample):
            if self.input.passes(sample):
                mounting = self.input.mounting
                return [self._step(sample.stamp_ns, mounting.vector(sample.gyro), mounting.force(sample.accel))]
            return [self._handle(item) for item in self.input.accept(sample)]
        if isinstance(sample, ImuBlock):
            return [self._handle(item) for item in self.input.accept_block(sample)]
        if isinstance(sample, MagSample):
            return [self.note(event) for event in self.field.take(sample, self.memory)]
        if isinstance(sample, NavigatorVelocity):
            return [self.note(event) for event in take_velocity(sample, self.memory)]
        if isinstance(sample, BodyVelocity):
            return [self.note(event) for event in self._body_velocity.take(sample, self.memory)]
        return []

    def _handle(self, item: ImuSample | ImuBlock | Event) -> Output:
        """Process one item in order: an event within a block takes effect before the samples after it."""
        if isinstance(item, ImuSample):
            return self._step(item.stamp_ns, item.gyro, item.accel)
        if isinstance(item, ImuBlock):
            return AttitudeBlock(item.stamps_ns, self.run(item, NO_FIELD))
        return self.note(item)

    def note(self, event: Event) -> Event:
        """Count an event and apply its consequences to the filter."""
        self._counters[event.name] += 1
        if event.name in RESTARTS:
            self._restart(event.name)
        for slot, value in _SENSOR_TROUBLE.get(event.name, {}).items():
            self.memory.state[slot] = value
        return event

    @property
    def mode(self) -> Mode:
        """AIDED once the attitude is level."""
        if self.memory.last_ns is None:
            return Mode.WAITING_IMU
        return Mode.AIDED if self.memory.age >= 1.0 else Mode.ALIGNING

    def status(self) -> Status:
        """Status of the filter; ``values`` holds standard deviations [deg] and learned quantities."""
        memory, s = self.memory, self.memory.state
        values = {
            "tilt_sd_deg": math.degrees(math.sqrt(max(s[at.COV], s[at.COV + 4]))),
            "yaw_sd_deg": math.degrees(math.sqrt(s[at.COV + 8])),
            "gyro_bias_deg_s": math.degrees(float(np.linalg.norm(s[at.BIAS : at.BIAS + 3]))),
            "field_trust": float(s[at.FIELD_TRUST]) if memory.mag_ns is not None else 0.0,
        }
        return Status(
            stamp_ns=memory.last_ns or 0,
            mode=self.mode,
            waiting_for=memory.waiting_for,
            seconds_coasting=0.0,
            horizontal_sd=math.nan,
            horizontal_sd_in_30_s=math.nan,
            gnss_refusal="",
            satellites=None,
            counters=dict(self._counters),
            values=values,
        )

    def snapshot(self) -> Any:
        """The whole state except the counters, for :meth:`restore`."""
        return copy.deepcopy(self.memory), self.input.snapshot()

    def restore(self, snapshot: Any) -> None:
        """Go back to an earlier :meth:`snapshot`."""
        memory, door = snapshot
        self.memory = copy.deepcopy(memory)
        self.input.restore(door)

    def set_parameters(self, parameters: Parameters) -> None:
        """Change the constants of the running filter; estimates stay. The choice of filter must be the same."""
        self._parameters = parameters
        state, declination = self.memory.state, self.memory.state[at.DECLINATION]
        state[at.PERIOD : at.OWN] = MAKE_STATE[parameters.attitude.filter](parameters)[at.PERIOD : at.OWN]
        state[at.DECLINATION] = declination

    def set_declination(self, declination: float) -> None:
        """Set the magnetic declination [rad], east positive; a heading from the field changes with it."""
        state = self.memory.state
        change = declination - state[at.DECLINATION]
        if change == 0.0:
            return
        if state[at.FIELD_H] > 0.0:
            turn_heading(state, -change)
        state[at.DECLINATION] = declination

    def reset(self, stamp_ns: int, reason: str) -> list[Output]:
        """Reset everything except the counters and the declination; the event gives the ``reason``."""
        self.memory = _fresh(self._parameters, float(self.memory.state[at.DECLINATION]))
        self.input.reset()
        text = f"the attitude filter restarts: {reason}"
        return [self.note(Event(stamp_ns, "attitude.reset", Level.WARN, text))]

    def warm_up(self) -> None:
        """Compile (or load) all kernels now, so that no sample has to wait for them."""
        twin, stamps = AttitudeEngine(self._parameters), np.array([1, 2]) * 10_000_000
        twin.feed(
            ImuBlock(stamps, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e-3]]), np.array([[0, 0, 9.8], [0, 0, 9.81]]))
        )
        twin.feed(ImuSample(30_000_000, (0.0, 0.0, 2e-3), (0.0, 0.0, 9.82)))
        twin.feed(MagSample(30_000_000, (0.0, 2e-5, -4e-5)))
        twin.set_declination(0.1)
        twin.feed(NavigatorVelocity(20_000_000, (0.0, 0.0, 0.0)))
        twin.feed(NavigatorVelocity(30_000_000, (0.0, 0.0, 0.0)))
        for stamp in (20_000_000, 30_000_000):
            twin.feed(BodyVelocity(stamp, (0.0, 0.0, 0.0)))

    # --- IMU -------------------------------------------------------------------------------------------------------

    def _step(self, stamp_ns: int, gyro: Vector3, accel: Vector3) -> AttitudeSolution:
        memory = self.memory
        if memory.last_ns is None:
            memory.last_ns = memory.started_ns = stamp_ns
        self._kernels.step(memory.state, (stamp_ns - memory.last_ns) * _NS, *gyro, *accel)
        memory.last_ns = stamp_ns
        return AttitudeSolution(stamp_ns, memory.state[: at.HEAD_SIZE].copy())

    def run(
        self,
        block: ImuBlock,
        field: np.ndarray,
        anomaly: float = math.inf,
        behind: np.ndarray = _NOWHERE,
        aids: np.ndarray = _NOTHING,
    ) -> np.ndarray:
        """Rows (N, BLOCK_COLUMNS) of the solution at accepted samples; ``field`` (N, 3) or (0, 3) in b.

        Fewer rows where a field differs by more than ``anomaly`` from the learned one; it belongs to the last row.
        ``aids`` (M, navigator_aid.SIZE) of a navigator take effect after the samples ``behind`` (M,), in order of time.
        """
        memory = self.memory
        if memory.last_ns is None:
            memory.last_ns = memory.started_ns = int(block.stamps_ns[0])
        rows = np.empty((len(block), at.BLOCK_COLUMNS))
        imu = block.stamps_ns, block.gyro, block.accel
        done = self._kernels.run(memory.state, memory.last_ns, *imu, field, anomaly, behind, aids, rows)
        memory.last_ns = int(block.stamps_ns[done - 1])
        return rows[:done]

    def _restart(self, name: str) -> None:
        """Start levelling again; learned sensor errors are kept unless the clock changed."""
        memory = self.memory
        if name == CLOCK_JUMP:
            self.memory = _fresh(self._parameters, float(memory.state[at.DECLINATION]))
            return
        memory.state[at.AGE] = -1.0
        memory.last_ns, memory.velocity, memory.body_velocity_ns = None, None, None


def _fresh(parameters: Parameters, declination: float | None = None) -> Memory:
    """A memory before its first sample, with a known ``declination`` [rad]."""
    memory = Memory(MAKE_STATE[parameters.attitude.filter](parameters))
    if declination is not None:
        memory.state[at.DECLINATION] = declination
    return memory
