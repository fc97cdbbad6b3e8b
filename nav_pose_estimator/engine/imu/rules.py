"""Rules for single IMU samples: rejection, gaps and clock jumps, stuck and saturated sensors."""

import math
from dataclasses import dataclass, field

from nav_pose_estimator.engine.parameters.imu import ImuParameters
from nav_pose_estimator.engine.samples import ImuSample, Vector3
from nav_pose_estimator.engine.solutions import Event, Level

GAP = "imu.gap"
CLOCK_JUMP = "imu.clock_jump"
RESTARTS = frozenset((GAP, CLOCK_JUMP))
"""Events over which an engine must not integrate: it starts again from the next sample."""

STUCK = "imu.stuck"
STUCK_END = "imu.stuck.ended"
SATURATED_GYRO = "imu.saturated.gyroscope"
SATURATED_ACCEL = "imu.saturated.accelerometer"
SATURATED_END = "imu.saturated.ended"

_OTHER_RATE, _OTHER_FORCE = 0.2, 2.0  # rad/s, m/s^2: samples with equal stamps that differ by more are of two IMUs
_GAP_RUN = 2  # consecutive samples after a jump forward that make it a gap; a single one has a damaged stamp
_BACKWARD_RUN = 3  # consecutive samples after a jump back that make it a change of the clock
_LOST_RUN, _LOST_NS = 10, 50_000_000
"""Samples in a row, and their duration, that were refused as too old because the clock was set back: lost motion."""
_MANY = 100  # refusals that are no longer harmless
_CLIPPED_RUN = 3  # consecutive equal values of one axis, beyond the limits below, that mean saturation
CLIPPED_RATE = 4.3
"""rad/s: just below the smallest usual range of a gyroscope (250 deg/s)."""
CLIPPED_FORCE = 19.0
"""m/s^2: just below the smallest usual range of an accelerometer (2 g)."""
NOT_CLIPPED = (0, 0, 0)
"""Counts of equal values of three axes within these limits."""
_NS = 1e-9


@dataclass(slots=True)
class ImuMemory:
    """Memory of the rules: everything they need of earlier samples; a snapshot is a copy of it."""

    last_ns: int | None = None
    elsewhere_ns: int = 0  # last stamp of a run of samples that does not continue ``last_ns``
    elsewhere_run: int = 0  # length of that run
    elsewhere_since_ns: int = 0  # its first stamp
    gyro: Vector3 = (math.nan,) * 3  # last accepted values, as published
    accel: Vector3 = (math.nan,) * 3
    gyro_since_ns: int = 0  # time since which the gyroscope repeats ``gyro``
    accel_since_ns: int = 0
    stuck: bool = False
    clipped: tuple[int, ...] = 2 * NOT_CLIPPED  # per axis: consecutive equal values, 0 within the usual ranges
    saturated: bool = False
    seen: dict[str, int] = field(default_factory=dict)  # number of events by name, of which only some have a sentence

    def afresh(self) -> "ImuMemory":
        """A memory without samples."""
        return ImuMemory(seen=self.seen)


class ImuRules:
    """The only definition of a valid sample; ``memory`` is its whole state."""

    def __init__(self, parameters: ImuParameters) -> None:
        self._limits = parameters
        self.max_gap_ns = round(parameters.max_gap * 1e9)
        self.stuck_ns = round(parameters.stuck_time * 1e9)
        self.memory = ImuMemory()

    def judge(self, sample: ImuSample) -> tuple[bool, list[Event]]:
        """(whether ``sample`` is valid, events). A gap or clock jump clears the memory before the sample is judged."""
        refusal = self._refusal(sample)
        if refusal is not None:
            if refusal.name not in RESTARTS:
                return False, [refusal]
            self.memory = self.memory.afresh()
            good, events = self.judge(sample)
            return good, [refusal, *events]
        memory = self.memory
        memory.last_ns, memory.elsewhere_run = sample.stamp_ns, 0
        events = []
        if sample.gyro == memory.gyro or sample.accel == memory.accel or memory.stuck:
            events += self._check_stuck(sample)
        if _is_extreme(sample) or memory.saturated:
            events += self._check_saturation(sample)
        if sample.gyro != memory.gyro:
            memory.gyro, memory.gyro_since_ns = sample.gyro, sample.stamp_ns
        if sample.accel != memory.accel:
            memory.accel, memory.accel_since_ns = sample.accel, sample.stamp_ns
        return True, events

    # --- refusals --------------------------------------------------------------------------------------------------

    def _refusal(self, sample: ImuSample) -> Event | None:
        """None for a valid sample; else the event of its rejection, of a gap or of a clock jump."""
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
            return self._bad_value(sample)
        last = self.memory.last_ns
        if stamp <= 0:
            return self._event(stamp, "imu.rejected.zero_stamp", "an IMU sample came without a time stamp; not used")
        if last is None:
            return None
        if 0 < stamp - last <= self.max_gap_ns:
            return self._lost_motion(sample, last) if self.memory.elsewhere_run >= _LOST_RUN else None
        if stamp == last:
            return self._duplicate(sample)
        return self._elsewhere(sample, last)

    def _lost_motion(self, sample: ImuSample, last: int) -> Event | None:
        """A gap where a clock set back by less than ``max_gap`` has come to ``last`` again: time passed meanwhile."""
        lost, stamp = sample.stamp_ns - self.memory.elsewhere_since_ns, sample.stamp_ns
        if self.memory.elsewhere_ns >= last or lost < _LOST_NS:
            return None
        text = f"the IMU's clock went back by {lost * _NS:.3f} s, and the motion of that time is lost"
        return self._event(stamp, GAP, text, gap_s=lost * _NS)

    def _duplicate(self, sample: ImuSample) -> Event:
        """Rejection of a second sample with the same stamp, with a hint where the two differ by more than noise."""
        text = f"two IMU samples have the stamp {sample.stamp_ns * _NS:.6f} s; the second is not used"
        turn, push = math.dist(sample.gyro, self.memory.gyro), math.dist(sample.accel, self.memory.accel)
        if turn > _OTHER_RATE or push > _OTHER_FORCE:
            text += (
                f" and differs by {turn:.2g} rad/s and {push:.2g} m/s^2: probably a second IMU on the topic, "
                "remap one of them"
            )
        return self._event(sample.stamp_ns, "imu.rejected.duplicate", text)

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

    def _elsewhere(self, sample: ImuSample, last: int) -> Event:
        """A stamp that does not continue ``last``: damaged if single; a gap or clock jump if the next ones agree."""
        memory, stamp = self.memory, sample.stamp_ns
        follows = memory.elsewhere_run and 0 < stamp - memory.elsewhere_ns <= self.max_gap_ns
        memory.elsewhere_run = memory.elsewhere_run + 1 if follows else 1
        memory.elsewhere_since_ns = memory.elsewhere_since_ns if follows else stamp
        memory.elsewhere_ns = stamp
        seconds = abs(stamp - last) * _NS
        if stamp > last and memory.elsewhere_run >= _GAP_RUN:
            return self._event(stamp, GAP, f"no IMU data for {seconds:.3f} s", gap_s=seconds)
        if stamp > last:
            text = f"an IMU sample is {seconds:.3f} s later than the one before it; not used unless the next one agrees"
            return self._event(stamp, "imu.rejected.forward", text)
        if memory.elsewhere_run >= _BACKWARD_RUN and seconds > self._limits.max_gap:
            text = f"the IMU's clock went back by {seconds:.3f} s; starting again"
            return self._event(stamp, CLOCK_JUMP, text, back_s=seconds)
        text = f"an IMU sample is {seconds:.4f} s older than the one before it; not used"
        before = memory.seen.get("imu.rejected.backward", 0)
        if before + 1 >= _MANY:
            text += f", like {before} before: stamps that jitter, or samples out of order"
        return self._event(stamp, "imu.rejected.backward", text)

    # --- warnings --------------------------------------------------------------------------------------------------

    def _check_stuck(self, sample: ImuSample) -> list[Event]:
        """Begin and end of a stuck sensor: it repeats one value exactly for longer than a live sensor can."""
        memory, stamp = self.memory, sample.stamp_ns
        gyro = sample.gyro == memory.gyro and stamp - memory.gyro_since_ns >= self.stuck_ns
        accel = sample.accel == memory.accel and stamp - memory.accel_since_ns >= self.stuck_ns
        if (gyro or accel) == memory.stuck:
            return []
        memory.stuck = gyro or accel
        if not memory.stuck:
            return [self._event(stamp, STUCK_END, "the IMU's values change again", level=Level.INFO)]
        which = "gyroscope and accelerometer" if gyro and accel else "gyroscope" if gyro else "accelerometer"
        text = (
            f"the {which} has repeated one value exactly for {self._limits.stuck_time:g} s: it is stuck, or simulated "
            "without noise"
        )
        return [self._event(stamp, STUCK, text, gyro=float(gyro), accel=float(accel))]

    def _check_saturation(self, sample: ImuSample) -> list[Event]:
        """Begin and end of saturation: a value repeats exactly beyond the smallest usual range."""
        memory, clipped = self.memory, self.memory.clipped
        if sample.gyro != memory.gyro:  # all three axes equal: the same sample was published again, no saturation
            clipped = _count_equal(sample.gyro, memory.gyro, CLIPPED_RATE, clipped[:3]) + clipped[3:]
        if sample.accel != memory.accel:
            clipped = clipped[:3] + _count_equal(sample.accel, memory.accel, CLIPPED_FORCE, clipped[3:])
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
        """An event, with its sentence only the 1st, 10th, 100th ... time; events of a restart always have one."""
        count = self.memory.seen[name] = self.memory.seen.get(name, 0) + 1
        is_reported = name in RESTARTS or math.log10(count).is_integer()
        return Event(stamp, name, level if is_reported else Level.DEBUG, text if is_reported else "", data)


def _is_extreme(sample: ImuSample) -> bool:
    rate, force = CLIPPED_RATE, CLIPPED_FORCE
    (wx, wy, wz), (fx, fy, fz) = sample.gyro, sample.accel
    gyro = wx > rate or wx < -rate or wy > rate or wy < -rate or wz > rate or wz < -rate
    return gyro or fx > force or fx < -force or fy > force or fy < -force or fz > force or fz < -force


def _count_equal(values: Vector3, before: Vector3, bound: float, counts: tuple[int, ...]) -> tuple[int, ...]:
    """Per axis: number of consecutive equal values beyond ``bound``; 0 within the bound."""
    rows = zip(values, before, counts, strict=True)
    return tuple(0 if abs(v) <= bound else n + 1 if v == b else 1 for v, b, n in rows)


def count_one(values: Vector3, bound: float) -> tuple[int, ...]:
    """The counts of :func:`_count_equal` where no value repeats the one before."""
    if -bound <= min(values) and max(values) <= bound:
        return NOT_CLIPPED
    return tuple(int(abs(v) > bound) for v in values)
