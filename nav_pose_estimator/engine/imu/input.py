"""Input of IMU samples: validation, events for what is wrong, and rotation into body axes.

Every engine that takes IMU samples owns one :class:`ImuInput`, so that a damaged sample is rejected for the same reason
everywhere. ``rules`` is the only definition of a valid sample. :meth:`ImuInput.accept_block` first tests by whole-array
comparisons that no rule applies to a block, and otherwise processes it sample by sample.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from nav_pose_estimator.core.numerics.imu_checks import is_unremarkable
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.imu.mounting import Mounting
from nav_pose_estimator.engine.imu.rules import CLIPPED_FORCE, CLIPPED_RATE, ImuMemory, ImuRules, count_one
from nav_pose_estimator.engine.parameters.imu import ImuParameters
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Vector3, joined
from nav_pose_estimator.engine.solutions import Event

_FEW = 4  # blocks of up to this many samples are checked faster one by one than by whole-array comparisons
_MANY = 64  # longer blocks that fail the quick test are halved, because most of it may be clean


class ImuInput:
    """Validation and mounting of one IMU. Not thread-safe; one per engine."""

    def __init__(self, parameters: ImuParameters) -> None:
        self._limits = parameters
        # squares of magnitudes up to which no rule about values applies
        self._usual_rate, self._usual_force = (
            min(parameters.max_rate, CLIPPED_RATE) ** 2,
            min(parameters.max_force, CLIPPED_FORCE) ** 2,
        )
        self._rules = ImuRules(parameters)
        self.mounting = Mounting(parameters)

    def snapshot(self) -> ImuMemory:
        """The memory of the rules, for :meth:`restore`."""
        return snapshot(self._rules.memory)

    def restore(self, memory: ImuMemory) -> None:
        """Go back to an earlier :meth:`snapshot`."""
        self._rules.memory = snapshot(memory)

    def reset(self) -> None:
        """Forget all earlier samples."""
        self._rules.memory = self._rules.memory.afresh()

    def passes(self, sample: ImuSample) -> bool:
        """Quick test of the usual case: True where :meth:`accept` would return the sample and no event.

        The sample then counts as accepted, and the caller has to apply ``mounting`` itself. False changes nothing.
        It costs a tenth of :meth:`accept`.
        """
        memory, stamp, gyro, accel = self._rules.memory, sample.stamp_ns, sample.gyro, sample.accel
        (wx, wy, wz), (fx, fy, fz), last = gyro, accel, memory.last_ns
        if not (
            wx * wx + wy * wy + wz * wz <= self._usual_rate  # false for NaN
            and fx * fx + fy * fy + fz * fz <= self._usual_force
            and last is not None
            and 0 < stamp - last <= self._rules.max_gap_ns
            and gyro != memory.gyro
            and accel != memory.accel
            and not memory.stuck
            and not memory.saturated
            and not memory.elsewhere_run
        ):
            return False
        memory.last_ns = memory.gyro_since_ns = memory.accel_since_ns = stamp
        memory.gyro, memory.accel = gyro, accel
        return True

    def accept(self, sample: ImuSample) -> list[ImuSample | Event]:
        """Events of ``sample``, followed by the sample in body axes unless it is rejected."""
        if self.passes(sample):
            return [self.mounting.sample(sample)]
        good, events = self._rules.judge(sample)
        return [*events, self.mounting.sample(sample)] if good else [*events]

    def accept_all(self, blocks: Sequence[ImuBlock]) -> bool:
        """Accept all ``blocks`` together if ``accept_block`` would return each of them and no event; else return False.

        Accepted blocks still have to be rotated into b. False leaves the state unchanged.
        """
        return len(blocks) > 1 and self.accept_whole(joined(blocks))

    def accept_whole(self, block: ImuBlock) -> bool:
        """``accept_all`` for one block."""
        if not (COMPILED and self._block_passes(block)):
            return False
        stamp = int(block.stamps_ns[-1])
        self._remember_end(block, (stamp, stamp))
        return True

    def is_usual(self, block: ImuBlock) -> bool:
        """Whether ``accept_block`` would return the ``block`` and no event; changes nothing."""
        return self._block_passes(block) or self._quiet_since(block) is not None

    def accept_block(self, block: ImuBlock) -> list[ImuBlock | Event]:
        """Events of ``block`` and the accepted runs of its samples in body axes, in order."""
        if self.accept_whole(block):
            return [self.mounting.block(block)]
        if len(block) > _FEW:
            since = self._quiet_since(block)
            if since is not None:
                self._remember_end(block, since)
                return [self.mounting.block(block)]
        if len(block) > _MANY:
            half = len(block) // 2
            return self.accept_block(block.part(0, half)) + self.accept_block(block.part(half, len(block)))
        return _joined(item for sample in block.samples() for item in self.accept(sample))

    def _block_passes(self, block: ImuBlock) -> bool:
        """``_quiet_since`` in one compiled pass, for blocks in which no sensor repeats a sample, the usual case."""
        memory, limits = self._rules.memory, self._limits
        stamps, gyro, accel = block.stamps_ns, block.gyro, block.accel
        if memory.stuck or memory.saturated or memory.elsewhere_run or not len(stamps) or stamps[0] <= 0:
            return False
        last_ns = int(stamps[0]) - 1 if memory.last_ns is None else memory.last_ns
        bounds = (limits.max_rate, limits.max_force, CLIPPED_RATE, CLIPPED_FORCE)
        return is_unremarkable(stamps, gyro, accel, last_ns, memory.gyro + memory.accel, self._rules.max_gap_ns, bounds)

    def _quiet_since(self, block: ImuBlock) -> tuple[int, int] | None:
        """Times [ns] since which gyroscope and accelerometer repeat their last value; None where a rule may apply."""
        memory, stamps, gyro, accel = self._rules.memory, block.stamps_ns, block.gyro, block.accel
        if memory.stuck or memory.saturated or memory.elsewhere_run or stamps[0] <= 0:
            return None
        if memory.last_ns is not None and not 0 < stamps[0] - memory.last_ns <= self._rules.max_gap_ns:
            return None
        steps = stamps[1:] - stamps[:-1]
        if len(steps) and not (steps.min() > 0 and steps.max() <= self._rules.max_gap_ns):
            return None
        limits = self._limits
        if not (np.abs(gyro).max() <= limits.max_rate and np.abs(accel).max() <= limits.max_force):  # false for NaN
            return None
        since = self._repeats_since(gyro, memory.gyro, memory.gyro_since_ns, CLIPPED_RATE, stamps)
        if since is None:
            return None
        other = self._repeats_since(accel, memory.accel, memory.accel_since_ns, CLIPPED_FORCE, stamps)
        return None if other is None else (since, other)

    def _repeats_since(
        self, values: np.ndarray, before: Vector3, since_ns: int, bound: float, stamps: np.ndarray
    ) -> int | None:
        """Time [ns] since which the last row is repeated; None where a run is as long as stuck, or an axis clips."""
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
        if (rows & (stamps - since >= self._rules.stuck_ns)).any():
            return None
        return int(since[-1])

    def _remember_end(self, block: ImuBlock, since: tuple[int, int]) -> None:
        memory = self._rules.memory
        gyro, accel = tuple(block.gyro[-1].tolist()), tuple(block.accel[-1].tolist())
        if since[0] != memory.gyro_since_ns:
            memory.clipped = count_one(gyro, CLIPPED_RATE) + memory.clipped[3:]
        if since[1] != memory.accel_since_ns:
            memory.clipped = memory.clipped[:3] + count_one(accel, CLIPPED_FORCE)
        memory.last_ns, memory.elsewhere_run = int(block.stamps_ns[-1]), 0
        memory.gyro, memory.accel = gyro, accel
        memory.gyro_since_ns, memory.accel_since_ns = since


def _joined(items: Iterable[ImuSample | Event]) -> list[ImuBlock | Event]:
    """Join consecutive samples into blocks; events keep their places."""
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
