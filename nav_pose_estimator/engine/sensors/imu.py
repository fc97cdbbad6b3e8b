"""The door for IMU samples: checks them, names what is wrong, and turns the sensor's axes into the body's.

Every engine that takes IMU samples owns one :class:`ImuInput`, so that a damaged sample is refused for the same reason
everywhere. The scalar rules in :meth:`ImuInput.accept` are the only definition; :meth:`ImuInput.accept_block` proves
with whole-array comparisons that no rule applies to a block and otherwise walks through it sample by sample.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nav_pose_estimator.core.numerics.imu_checks import is_unremarkable
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.engine.parameters.imu import ImuParameters
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Vector3
from nav_pose_estimator.engine.solutions import Event, Level

GAP = "imu.gap"
CLOCK_JUMP = "imu.clock_jump"
RESTARTS = frozenset((GAP, CLOCK_JUMP))
"""Names of the events after which an engine must not integrate across: it starts again from the next sample."""

STUCK = "imu.stuck"
STUCK_END = "imu.stuck.ended"
SATURATED_GYRO = "imu.saturated.gyroscope"
SATURATED_ACCEL = "imu.saturated.accelerometer"
SATURATED_END = "imu.saturated.ended"

_GAP_RUN = 2  # so many samples in a row that agree on a later time end a gap; one alone is a damaged stamp
_BACKWARD_RUN = 3  # so many that agree on an earlier time are a clock set back
_CLIPPED_RUN = 3  # so many equal values in a row on one axis ...
_CLIPPED_RATE = 4.3  # ... beyond the smallest usual range (250 deg/s) are a saturated gyroscope [rad/s]
_CLIPPED_FORCE = 19.0  # ... beyond the smallest usual range (2 g) are a saturated accelerometer [m/s^2]
_FEW = 4  # up to so many samples are checked faster one by one than by whole-array comparisons
_MANY = 64  # a longer block with something in it is halved: most of it may be clean
_NOT_CLIPPED = (0, 0, 0)
_NS = 1e-9


@dataclass
class _Memory:
    """All that the checks remember of earlier samples; a snapshot is a copy of it."""

    last_ns: int | None = None
    elsewhere_ns: int = 0  # last stamp of a run that does not continue ``last_ns``
    elsewhere_run: int = 0
    gyro: Vector3 = (math.nan,) * 3  # last accepted values, as published
    accel: Vector3 = (math.nan,) * 3
    gyro_since_ns: int = 0  # since when the gyroscope repeats ``gyro``
    accel_since_ns: int = 0
    stuck: bool = False
    clipped: tuple[int, ...] = 2 * _NOT_CLIPPED  # per axis: values in a row, 0 within usual ranges
    saturated: bool = False


def axes_matrix(parameters: ImuParameters) -> np.ndarray:
    """C_bs (3, 3): sensor axes as published (``convention``, then ``mounting_rpy``) into body axes FLU."""
    matrix = rotation_from_rpy(parameters.mounting_rpy)
    if parameters.convention == "frd":
        matrix = matrix @ np.diag([1.0, -1.0, -1.0])
    exact = np.round(matrix)  # a quarter turn is exact, not 6e-17 beside it
    return np.where(np.abs(matrix - exact) < 1e-12, exact, matrix)


def rotation_from_rpy(rpy: Sequence[float]) -> np.ndarray:
    """Rotation matrix (3, 3) of roll, pitch, yaw [rad] about the fixed axes x, y, z."""
    roll, pitch, yaw = rpy
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


class ImuInput:
    """Validation and mounting of one IMU. Not thread-safe; one per engine."""

    def __init__(self, parameters: ImuParameters) -> None:
        self._limits = parameters
        self._max_gap_ns = round(parameters.max_gap * 1e9)
        self._stuck_ns = round(parameters.stuck_time * 1e9)
        self._usual_rate = min(parameters.max_rate, _CLIPPED_RATE)
        self._usual_force = min(parameters.max_force, _CLIPPED_FORCE)
        matrix = axes_matrix(parameters)
        self._rows = None if np.array_equal(matrix, np.eye(3)) else [tuple(row) for row in matrix.tolist()]
        self._seen: Counter[str] = Counter()
        self._memory = _Memory()

    def snapshot(self) -> _Memory:
        """The memory of the checks, to be given to :meth:`restore`."""
        return replace(self._memory)

    def restore(self, memory: _Memory) -> None:
        """Go back to an earlier :meth:`snapshot`."""
        self._memory = replace(memory)

    def reset(self) -> None:
        """Forget all earlier samples."""
        self._memory = _Memory()

    def to_body(self, vector: Vector3) -> Vector3:
        """A vector in the sensor's axes as published, turned into body axes (FLU)."""
        if self._rows is None:
            return vector
        x, y, z = vector
        a, b, c = self._rows
        return a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z

    def passes(self, sample: ImuSample) -> bool:
        """True where :meth:`accept` would give the sample and nothing else: it then counts as accepted.

        False leaves everything as it was. The usual case at a tenth of the cost; the sample still has to be turned
        into the body.
        """
        memory, stamp, gyro, accel = self._memory, sample.stamp_ns, sample.gyro, sample.accel
        rate, force, last = self._usual_rate, self._usual_force, memory.last_ns
        wx, wy, wz = gyro
        fx, fy, fz = accel
        if not (
            -rate <= wx <= rate
            and -rate <= wy <= rate
            and -rate <= wz <= rate
            and -force <= fx <= force
            and -force <= fy <= force
            and -force <= fz <= force
            and last is not None
            and 0 < stamp - last <= self._max_gap_ns
            and gyro != memory.gyro
            and accel != memory.accel
        ):
            return False
        if memory.stuck or memory.saturated:
            return False
        memory.last_ns = memory.gyro_since_ns = memory.accel_since_ns = stamp
        memory.elsewhere_run = 0
        memory.gyro, memory.accel = gyro, accel
        return True

    def accept(self, sample: ImuSample) -> list[ImuSample | Event]:
        """What follows from ``sample``, in order: events, and the sample in body axes unless it is refused."""
        if self.passes(sample):
            return [self._turned(sample)]
        refusal = self._refusal(sample)
        if refusal is not None:
            return refusal
        memory = self._memory
        memory.last_ns, memory.elsewhere_run = sample.stamp_ns, 0
        events: list[ImuSample | Event] = []
        if sample.gyro == memory.gyro or sample.accel == memory.accel or memory.stuck:
            events += self._check_stuck(sample)
        if self._is_extreme(sample) or memory.saturated:
            events += self._check_saturation(sample)
        if sample.gyro != memory.gyro:
            memory.gyro, memory.gyro_since_ns = sample.gyro, sample.stamp_ns
        if sample.accel != memory.accel:
            memory.accel, memory.accel_since_ns = sample.accel, sample.stamp_ns
        return [*events, self._turned(sample)]

    def _turned(self, sample: ImuSample) -> ImuSample:
        if self._rows is None:
            return sample
        return ImuSample(sample.stamp_ns, self.to_body(sample.gyro), self.to_body(sample.accel))

    def accept_block(self, block: ImuBlock) -> list[ImuBlock | Event]:
        """What follows from ``block``, in order: events and the accepted runs of samples in body axes."""
        if COMPILED and self._block_passes(block):
            stamp = int(block.stamps_ns[-1])
            self._remember_end(block, (stamp, stamp))
            return [self._block_to_body(block)]
        if len(block) > _FEW:
            since = self._quiet_since(block)
            if since is not None:
                self._remember_end(block, since)
                return [self._block_to_body(block)]
        if len(block) > _MANY:
            half = len(block) // 2
            return self.accept_block(_part(block, 0, half)) + self.accept_block(_part(block, half, len(block)))
        stamps, gyro, accel = block.stamps_ns.tolist(), block.gyro.tolist(), block.accel.tolist()
        rows = zip(stamps, gyro, accel, strict=True)
        items = (item for t, w, f in rows for item in self.accept(ImuSample(t, tuple(w), tuple(f))))
        return _joined(items)

    # --- refusals --------------------------------------------------------------------------------------------------

    def _refusal(self, sample: ImuSample) -> list[ImuSample | Event] | None:
        """None for a good sample; else the reason, or what a new clock leads to."""
        rate, force = self._limits.max_rate, self._limits.max_force
        (wx, wy, wz), (fx, fy, fz), stamp = sample.gyro, sample.accel, sample.stamp_ns
        in_range = (
            -rate <= wx <= rate
            and -rate <= wy <= rate
            and -rate <= wz <= rate
            and -force <= fx <= force
            and -force <= fy <= force
            and -force <= fz <= force
        )
        if not in_range:
            return [self._bad_value(sample)]
        last = self._memory.last_ns
        if stamp <= 0:
            return [self._event(stamp, "imu.rejected.zero_stamp", "an IMU sample came without a time stamp; not used")]
        if last is None or 0 < stamp - last <= self._max_gap_ns:
            return None
        if stamp == last:
            text = f"two IMU samples have the stamp {stamp * _NS:.6f} s; the second is not used"
            return [self._event(stamp, "imu.rejected.duplicate", text)]
        return self._elsewhere(sample, last)

    def _bad_value(self, sample: ImuSample) -> Event:
        values, at = (*sample.gyro, *sample.accel), f"{sample.stamp_ns * _NS:.3f} s"
        if not all(map(math.isfinite, values)):
            text = f"the IMU sample at {at} holds NaN or infinity; not used"
            return self._event(sample.stamp_ns, "imu.rejected.nan", text)
        if max(map(abs, sample.gyro)) > self._limits.max_rate:
            text = f"the IMU sample at {at} holds an angular rate above {self._limits.max_rate:g} rad/s; not used"
            return self._event(sample.stamp_ns, "imu.rejected.rate", text)
        text = f"the IMU sample at {at} holds a specific force above {self._limits.max_force:g} m/s^2; not used"
        return self._event(sample.stamp_ns, "imu.rejected.force", text)

    def _elsewhere(self, sample: ImuSample, last: int) -> list[ImuSample | Event]:
        """A stamp that does not continue ``last``: one alone is damaged, a run that agrees is a gap or a new clock."""
        memory, stamp = self._memory, sample.stamp_ns
        follows = memory.elsewhere_run and 0 < stamp - memory.elsewhere_ns <= self._max_gap_ns
        memory.elsewhere_run = memory.elsewhere_run + 1 if follows else 1
        memory.elsewhere_ns = stamp
        seconds = abs(stamp - last) * _NS
        if stamp > last and memory.elsewhere_run >= _GAP_RUN:
            return self._restart(sample, self._event(stamp, GAP, f"no IMU data for {seconds:.3f} s", gap_s=seconds))
        if stamp > last:
            text = f"an IMU sample is {seconds:.3f} s later than the one before it; not used until a second one agrees"
            return [self._event(stamp, "imu.rejected.forward", text)]
        if memory.elsewhere_run >= _BACKWARD_RUN and seconds > self._limits.max_gap:
            text = f"the IMU's clock went back by {seconds:.3f} s; starting again"
            return self._restart(sample, self._event(stamp, CLOCK_JUMP, text, back_s=seconds))
        text = f"an IMU sample is {seconds:.4f} s older than the one before it; not used"
        return [self._event(stamp, "imu.rejected.backward", text)]

    def _restart(self, sample: ImuSample, reason: Event) -> list[ImuSample | Event]:
        self.reset()
        return [reason, *self.accept(sample)]

    # --- warnings --------------------------------------------------------------------------------------------------

    def _check_stuck(self, sample: ImuSample) -> list[ImuSample | Event]:
        """Begin and end of a sensor that repeats exactly one value for longer than a live one can."""
        memory, stamp = self._memory, sample.stamp_ns
        gyro = sample.gyro == memory.gyro and stamp - memory.gyro_since_ns >= self._stuck_ns
        accel = sample.accel == memory.accel and stamp - memory.accel_since_ns >= self._stuck_ns
        if (gyro or accel) == memory.stuck:
            return []
        memory.stuck = gyro or accel
        if not memory.stuck:
            return [self._event(stamp, STUCK_END, "the IMU's values change again", level=Level.INFO)]
        which = "gyroscope and accelerometer" if gyro and accel else "gyroscope" if gyro else "accelerometer"
        text = f"the {which} repeated one value exactly for {self._limits.stuck_time:g} s: stuck, or made without noise"
        return [self._event(stamp, STUCK, text, gyro=float(gyro), accel=float(accel))]

    def _is_extreme(self, sample: ImuSample) -> bool:
        rate, force = _CLIPPED_RATE, _CLIPPED_FORCE
        (wx, wy, wz), (fx, fy, fz) = sample.gyro, sample.accel
        gyro = wx > rate or wx < -rate or wy > rate or wy < -rate or wz > rate or wz < -rate
        return gyro or fx > force or fx < -force or fy > force or fy < -force or fz > force or fz < -force

    def _check_saturation(self, sample: ImuSample) -> list[ImuSample | Event]:
        """A value that stays exactly the same beyond the smallest usual range has been clipped."""
        memory, clipped = self._memory, self._memory.clipped
        if sample.gyro != memory.gyro:  # three equal values are no saturation but a slow sensor, sent again
            clipped = _count_equal(sample.gyro, memory.gyro, _CLIPPED_RATE, clipped[:3]) + clipped[3:]
        if sample.accel != memory.accel:
            clipped = clipped[:3] + _count_equal(sample.accel, memory.accel, _CLIPPED_FORCE, clipped[3:])
        memory.clipped, values = clipped, (*sample.gyro, *sample.accel)
        saturated = max(memory.clipped) >= _CLIPPED_RUN
        if saturated == memory.saturated:
            return []
        memory.saturated = saturated
        if not saturated:
            return [self._event(sample.stamp_ns, SATURATED_END, "the IMU is within its range again", level=Level.INFO)]
        value = max((abs(v) for v, n in zip(values, memory.clipped, strict=True) if n >= _CLIPPED_RUN))
        if max(memory.clipped[:3]) >= _CLIPPED_RUN:
            text = f"the gyroscope is saturated at {value:.4g} rad/s"
            return [self._event(sample.stamp_ns, SATURATED_GYRO, text, value=value)]
        text = f"the accelerometer is saturated at {value:.4g} m/s^2"
        return [self._event(sample.stamp_ns, SATURATED_ACCEL, text, value=value)]

    def _event(self, stamp: int, name: str, text: str, level: Level = Level.WARN, **data: float) -> Event:
        """Counted every time, told in words the 1st, 10th, 100th ... time."""
        self._seen[name] += 1
        told = math.log10(self._seen[name]).is_integer()
        return Event(stamp, name, level if told else Level.DEBUG, text if told else "", data)

    # --- blocks ----------------------------------------------------------------------------------------------------

    def _block_passes(self, block: ImuBlock) -> bool:
        """``_quiet_since`` in one compiled pass, for blocks in which no sensor repeats itself: nearly all."""
        memory, limits = self._memory, self._limits
        stamps, gyro, accel = block.stamps_ns, block.gyro, block.accel
        if memory.stuck or memory.saturated or not len(stamps) or stamps[0] <= 0:
            return False
        last_ns = int(stamps[0]) - 1 if memory.last_ns is None else memory.last_ns
        bounds = (limits.max_rate, limits.max_force, _CLIPPED_RATE, _CLIPPED_FORCE)
        return is_unremarkable(stamps, gyro, accel, last_ns, memory.gyro + memory.accel, self._max_gap_ns, bounds)

    def _quiet_since(self, block: ImuBlock) -> tuple[int, int] | None:
        """None when a rule of :meth:`accept` may speak up; else since when each sensor repeats its last value [ns]."""
        memory, stamps, gyro, accel = self._memory, block.stamps_ns, block.gyro, block.accel
        if memory.stuck or memory.saturated or stamps[0] <= 0:
            return None
        if memory.last_ns is not None and not 0 < stamps[0] - memory.last_ns <= self._max_gap_ns:
            return None
        steps = stamps[1:] - stamps[:-1]
        if len(steps) and not (steps.min() > 0 and steps.max() <= self._max_gap_ns):
            return None
        limits = self._limits
        if not (np.abs(gyro).max() <= limits.max_rate and np.abs(accel).max() <= limits.max_force):  # false for NaN
            return None
        since = self._repeats_since(gyro, memory.gyro, memory.gyro_since_ns, _CLIPPED_RATE, stamps)
        if since is None:
            return None
        other = self._repeats_since(accel, memory.accel, memory.accel_since_ns, _CLIPPED_FORCE, stamps)
        return None if other is None else (since, other)

    def _repeats_since(
        self, values: np.ndarray, before: Vector3, since_ns: int, bound: float, stamps: np.ndarray
    ) -> int | None:
        """Since when the last row repeats itself; None if any run is long enough for stuck, or an axis clips."""
        equal = np.empty(values.shape, dtype=bool)
        equal[0], equal[1:] = values[0] == before, values[1:] == values[:-1]
        if not equal.any():
            return int(stamps[-1])
        rows = equal.all(axis=1)
        if (equal & (np.abs(values) > bound) & ~rows[:, None]).any():
            return None
        if not rows.any():
            return int(stamps[-1])
        begin = np.maximum.accumulate(np.where(rows, -1, np.arange(len(rows))))  # -1: the run began ahead of the block
        since = np.where(begin < 0, since_ns, stamps[begin])
        if (rows & (stamps - since >= self._stuck_ns)).any():
            return None
        return int(since[-1])

    def _remember_end(self, block: ImuBlock, since: tuple[int, int]) -> None:
        memory = self._memory
        gyro, accel = tuple(block.gyro[-1].tolist()), tuple(block.accel[-1].tolist())
        if since[0] != memory.gyro_since_ns:
            memory.clipped = _count_one(gyro, _CLIPPED_RATE) + memory.clipped[3:]
        if since[1] != memory.accel_since_ns:
            memory.clipped = memory.clipped[:3] + _count_one(accel, _CLIPPED_FORCE)
        memory.last_ns, memory.elsewhere_run = int(block.stamps_ns[-1]), 0
        memory.gyro, memory.accel = gyro, accel
        memory.gyro_since_ns, memory.accel_since_ns = since

    def _block_to_body(self, block: ImuBlock) -> ImuBlock:
        if self._rows is None:
            return block
        # Sums of columns round exactly as the scalar form does; a matrix product may not.
        gyro = np.column_stack(self.to_body(tuple(block.gyro.T)))
        return ImuBlock(block.stamps_ns, gyro, np.column_stack(self.to_body(tuple(block.accel.T))))


def _count_equal(values: Vector3, before: Vector3, bound: float, counts: tuple[int, ...]) -> tuple[int, ...]:
    """Per axis: how often a value beyond ``bound`` came in a row; 0 within the bound."""
    rows = zip(values, before, counts, strict=True)
    return tuple(0 if abs(v) <= bound else n + 1 if v == b else 1 for v, b, n in rows)


def _count_one(values: Vector3, bound: float) -> tuple[int, ...]:
    """The counts of :func:`_count_equal` for values of which none repeats."""
    if -bound <= min(values) and max(values) <= bound:
        return _NOT_CLIPPED
    return tuple(int(abs(v) > bound) for v in values)


def _part(block: ImuBlock, start: int, end: int) -> ImuBlock:
    return block.part(start, end)


def _joined(items: Iterable[ImuSample | Event]) -> list[ImuBlock | Event]:
    """Runs of samples joined into blocks, events left in their places."""
    out: list[ImuBlock | Event] = []
    run: list[ImuSample] = []
    for item in items:
        if isinstance(item, ImuSample):
            run.append(item)
            continue
        if run:
            out.append(_block(run))
            run = []
        out.append(item)
    return [*out, _block(run)] if run else out


def _block(run: list[ImuSample]) -> ImuBlock:
    stamps = np.array([s.stamp_ns for s in run], dtype=np.int64)
    return ImuBlock(stamps, np.array([s.gyro for s in run]), np.array([s.accel for s in run]))
