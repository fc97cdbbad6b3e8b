"""Frequency of a wrong pose with a good status, with faults of sensors or clocks that are hard to detect.

Size, rate, axis and start of the fault are random for each flight, and so are vehicle and seed.

tools/in_environment.sh python benchmarks/hostile_imu.py --kinds "gyro ramp" "baro frozen, outage" --draws 3
"""

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import (
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    PressureSample,
    Sample,
    SatelliteCount,
    Vector3,
)
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavBlock
from nav_pose_estimator.sim import faults, scenarios
from nav_pose_estimator.sim.recording import Recording

VEHICLES = ("multirotor_outage", "laps", "stop_and_go", "hover", "fixed_wing", "road_vehicle", "closed_curve")
LOST, LENGTH = 60.0, 25.0  # s: the outage, of the faults that need one
DURATION = 100.0  # s
GNSS = (GnssFix, GnssVelocity, SatelliteCount)
WRONG, LEAST = 3.0, 3.0  # sigmas, and m: an error that exceeds both is wrong
Samples = Iterator[Sample]


class LowPass:
    """First-order low-passes of time constant ``tau`` [s], one per key."""

    def __init__(self, tau: float) -> None:
        self._tau = tau
        self._last: dict[object, tuple[int, Vector3]] = {}

    def __call__(self, key: object, stamp_ns: int, values: Vector3) -> Vector3:
        """The smoothed ``values``."""
        before_ns, before = self._last.get(key, (stamp_ns, values))
        share = 1.0 - math.exp(-1e-9 * (stamp_ns - before_ns) / self._tau)
        (a, b, c), (x, y, z) = before, values
        smooth = a + share * (x - a), b + share * (y - b), c + share * (z - c)
        self._last[key] = stamp_ns, smooth
        return smooth

    def fix(self, fix: GnssFix) -> GnssFix:
        """The smoothed ``fix``."""
        lat, lon, alt = self(GnssFix, fix.stamp_ns, (fix.lat, fix.lon, fix.alt))
        return replace(fix, lat=lat, lon=lon, alt=alt)


@dataclass(frozen=True)
class Flight:
    """One flight and its random values; times [s] are from the start of the recording."""

    recording: Recording
    rng: np.random.Generator
    lost: float
    """Start of the outage, infinite without one."""

    def seconds(self, stamps_ns: Any) -> Any:
        """Times of stamps."""
        return (stamps_ns - self.recording.start_ns) * 1e-9

    def begin(self) -> float:
        """Random start of a fault, up to 5 s after that of the outage, or between 20 and 40 s without one."""
        return self.lost + self.rng.uniform(0.0, 5.0) if math.isfinite(self.lost) else self.rng.uniform(20.0, 40.0)

    def axis(self) -> np.ndarray:
        """Random direction (3,) in b."""
        axis = self.rng.standard_normal(3)
        return axis / np.linalg.norm(axis)


def on_imu(flight: Flight, change: Callable[[np.ndarray, ImuBlock], ImuBlock]) -> Samples:
    """The flight with changed IMU data; ``change`` receives the times (N,) of a block and the block."""
    for sample in flight.recording.samples():
        yield change(flight.seconds(sample.stamps_ns), sample) if isinstance(sample, ImuBlock) else sample


def sound(flight: Flight) -> Samples:
    """No fault."""
    return flight.recording.samples()


def imu_late(flight: Flight) -> Samples:
    """The IMU's stamps are 0.25 to 0.8 s late, as of a driver that stamps after a queue."""
    late = round(flight.rng.uniform(0.25, 0.8) * 1e9)
    return on_imu(flight, lambda t, b: replace(b, stamps_ns=b.stamps_ns + late))


def gnss_late(flight: Flight) -> Samples:
    """The receiver's stamps are 0.25 to 0.8 s late."""
    late = round(flight.rng.uniform(0.25, 0.8) * 1e9)
    for sample in flight.recording.samples():
        yield replace(sample, stamp_ns=sample.stamp_ns + late) if isinstance(sample, GnssFix | GnssVelocity) else sample


def filtered(flight: Flight) -> Samples:
    """The receiver smooths its positions and velocities with a low-pass of 0.3 to 1 s."""
    smooth = LowPass(flight.rng.uniform(0.3, 1.0))
    for sample in flight.recording.samples():
        if isinstance(sample, GnssFix):
            yield smooth.fix(sample)
        elif isinstance(sample, GnssVelocity):
            yield replace(sample, vel_enu=smooth(GnssVelocity, sample.stamp_ns, sample.vel_enu))
        else:
            yield sample


def predicted(flight: Flight) -> Samples:
    """The receiver extrapolates its positions by 0.3 to 1 s with velocities that it smooths with as much."""
    lag = flight.rng.uniform(0.3, 1.0)
    smooth = LowPass(lag)
    velocity: Vector3 = (0.0, 0.0, 0.0)
    for sample in flight.recording.samples():
        if isinstance(sample, GnssVelocity):
            velocity = smooth(GnssVelocity, sample.stamp_ns, sample.vel_enu)
            yield replace(sample, vel_enu=velocity)
        elif isinstance(sample, GnssFix):
            fix = smooth.fix(sample)
            yield replace(fix, **faults.moved(fix, tuple(lag * v for v in velocity)))
        else:
            yield sample


def clock_scaled(flight: Flight) -> Samples:
    """The receiver's clock runs fast or slow by 500 to 5000 ppm, from the first fix on."""
    rate = flight.rng.choice([-1.0, 1.0]) * flight.rng.uniform(0.0005, 0.005)
    for sample in flight.recording.samples():
        if isinstance(sample, GnssFix | GnssVelocity):
            since = sample.stamp_ns - flight.recording.start_ns
            sample = replace(sample, stamp_ns=sample.stamp_ns + round(rate * since))
        yield sample


def height_in_feet(flight: Flight) -> Samples:
    """The height of the fixes is in feet."""
    for sample in flight.recording.samples():
        yield replace(sample, alt=sample.alt / 0.3048) if isinstance(sample, GnssFix) else sample


def height_in_feet_no_baro(flight: Flight) -> Samples:
    """The same without a barometer."""
    return (sample for sample in height_in_feet(flight) if not isinstance(sample, PressureSample))


def aliased(flight: Flight) -> Samples:
    """Vibration of 1 to 4 m/s^2 that sampling aliases to 0.1 to 1 Hz."""
    size, rate, axis, begin = flight.rng.uniform(1.0, 4.0), flight.rng.uniform(0.1, 1.0), flight.axis(), flight.begin()

    def change(t: np.ndarray, b: ImuBlock) -> ImuBlock:
        wave = np.where(t > begin, size * np.sin(2.0 * np.pi * rate * (t - begin)), 0.0)
        return replace(b, accel=b.accel + wave[:, None] * axis)

    return on_imu(flight, change)


def rounded(flight: Flight) -> Samples:
    """Latitude and longitude with two to four decimals of a degree, or of a minute."""
    step = 10.0 ** -float(flight.rng.integers(2, 5)) / float(flight.rng.choice([1.0, 60.0]))

    def coarse(angle: float) -> float:
        return math.radians(round(math.degrees(angle) / step) * step)

    for sample in flight.recording.samples():
        yield replace(sample, lat=coarse(sample.lat), lon=coarse(sample.lon)) if isinstance(sample, GnssFix) else sample


def clipped(flight: Flight) -> Samples:
    """The gyroscope's range is 40 to 90 % of the largest rate of the flight, and at least 50 deg/s."""
    bound = max(flight.rng.uniform(0.4, 0.9) * float(np.abs(flight.recording.imu.gyro).max()), math.radians(50.0))
    return on_imu(flight, lambda t, b: replace(b, gyro=np.clip(b.gyro, -bound, bound)))


def ramp(flight: Flight) -> Samples:
    """The gyroscope bias drifts by 1 to 5 deg/s per minute."""
    slope, axis, begin = math.radians(flight.rng.uniform(1.0, 5.0)) / 60.0, flight.axis(), flight.begin()
    return on_imu(flight, lambda t, b: replace(b, gyro=b.gyro + slope * np.maximum(t - begin, 0.0)[:, None] * axis))


def step(flight: Flight) -> Samples:
    """The gyroscope bias steps by 0.3 to 2 deg/s."""
    size, axis, begin = math.radians(flight.rng.uniform(0.3, 2.0)), flight.axis(), flight.begin()
    return on_imu(flight, lambda t, b: replace(b, gyro=b.gyro + np.where(t > begin, size, 0.0)[:, None] * axis))


def vibrating(flight: Flight) -> Samples:
    """Vibration of 4 to 15 m/s^2 on each axis at a wandering frequency above half of the sampling rate, rectified."""
    rng, begin = flight.rng, flight.begin()
    size, middle, phases = rng.uniform(4.0, 15.0), rng.uniform(60.0, 250.0), rng.uniform(0.0, 2.0 * np.pi, 6)
    turning = rng.uniform(0.005, 0.02) * size  # rad/s
    offset = rng.uniform(0.0005, 0.003) * size**2 * flight.axis()  # m/s^2
    state = {"phase": 0.0, "off": 0.0, "t": begin}

    def change(t: np.ndarray, b: ImuBlock) -> ImuBlock:
        phase = np.empty(len(t))
        for i, now in enumerate(t.tolist()):
            dt = max(now - state["t"], 0.0)
            state["off"] += -dt * state["off"] + 5.0 * math.sqrt(2.0 * dt) * rng.standard_normal()  # Hz
            state["phase"] += 2.0 * np.pi * dt * (middle + state["off"])
            state["t"] = max(now, state["t"])
            phase[i] = state["phase"]
        waves = np.sqrt(2.0) * np.sin(phase[:, None] + phases) * (t > begin)[:, None]
        shift = np.outer(t > begin, offset)
        return replace(b, gyro=b.gyro + turning * waves[:, :3], accel=b.accel + size * waves[:, 3:] + shift)

    return on_imu(flight, change)


def baro_frozen(flight: Flight) -> Samples:
    """The barometer repeats its last value."""
    begin, held = flight.begin(), math.nan
    for sample in flight.recording.samples():
        if isinstance(sample, PressureSample):
            if flight.seconds(sample.stamp_ns) < begin:
                held = sample.pressure
            sample = replace(sample, pressure=held)
        yield sample


def baro_late(flight: Flight) -> Samples:
    """The barometer's values are 1 to 5 s old."""
    late, memory = flight.rng.uniform(1.0, 5.0), []
    for sample in flight.recording.samples():
        if isinstance(sample, PressureSample):
            memory.append((sample.stamp_ns, sample.pressure))
            while len(memory) > 1 and memory[1][0] <= sample.stamp_ns - late * 1e9:
                memory.pop(0)
            sample = replace(sample, pressure=memory[0][1])
        yield sample


def returned(flight: Flight) -> Samples:
    """GNSS returns with a constant error of 5 to 60 m."""
    far, angle = flight.rng.uniform(5.0, 60.0), flight.rng.uniform(0.0, 2.0 * np.pi)
    away = (far * math.cos(angle), far * math.sin(angle), 0.0)
    return flight.recording.with_faults(faults.Shift(GnssFix, flight.lost + LENGTH, math.inf, away)).samples()


def baro_step(flight: Flight) -> Samples:
    """The pressure steps by 40 to 300 Pa."""
    size, begin = flight.rng.choice([-1.0, 1.0]) * flight.rng.uniform(40.0, 300.0), flight.begin()
    return flight.recording.with_faults(faults.Shift(PressureSample, begin, math.inf, (size,))).samples()


def baro_drift(flight: Flight) -> Samples:
    """The pressure drifts by 2 to 12 Pa/s, 0.2 to 1 m/s."""
    slope, begin = flight.rng.choice([-1.0, 1.0]) * flight.rng.uniform(2.0, 12.0), flight.begin()
    for sample in flight.recording.samples():
        if isinstance(sample, PressureSample):
            late = max(flight.seconds(sample.stamp_ns) - begin, 0.0)
            sample = replace(sample, pressure=sample.pressure + slope * late)
        yield sample


def baro_weather(flight: Flight) -> Samples:
    """The pressure drifts by 0.1 to 2 Pa/s, 0.01 to 0.2 m/s, from the start of the flight on."""
    slope = flight.rng.choice([-1.0, 1.0]) * 10.0 ** flight.rng.uniform(-1.0, 0.3)
    for sample in flight.recording.samples():
        if isinstance(sample, PressureSample):
            sample = replace(sample, pressure=sample.pressure + slope * flight.seconds(sample.stamp_ns))
        yield sample


def baro_wash(flight: Flight) -> Samples:
    """The pressure changes by 0.1 to 0.6 Pa for each (m/s)^2 of speed, as of a port in the airflow."""
    factor, truth = flight.rng.choice([-1.0, 1.0]) * flight.rng.uniform(0.1, 0.6), flight.recording.truth
    for sample in flight.recording.samples():
        if isinstance(sample, PressureSample):
            row = min(int(truth.t.searchsorted(flight.seconds(sample.stamp_ns))), len(truth) - 1)
            speed = float(np.hypot(*truth.v_n[row, :2]))
            sample = replace(sample, pressure=sample.pressure + factor * speed**2)
        yield sample


def gnss_stuck(flight: Flight) -> Samples:
    """The receiver, or its driver, repeats its last fix with fresh stamps, and velocities end."""
    begin = flight.begin()
    stops = faults.Freeze(GnssFix, begin, math.inf), faults.Stop(GnssVelocity, begin, math.inf)
    return flight.recording.with_faults(*stops).samples()


def gyro_dead(flight: Flight) -> Samples:
    """The gyroscope repeats its last value from 10 to 40 s on, the accelerometer goes on."""
    begin, last = flight.rng.uniform(10.0, 40.0), np.zeros(3)

    def change(t: np.ndarray, b: ImuBlock) -> ImuBlock:
        live = t < begin
        if live.any():
            last[:] = b.gyro[live][-1]
        return replace(b, gyro=np.where(live[:, None], b.gyro, last))

    return on_imu(flight, change)


def with_body_velocity(
    flight: Flight, change: Callable[[float, np.ndarray, np.ndarray], np.ndarray], late: float = 0.0
) -> Samples:
    """The flight with a velocity sensor of 10 Hz and 0.05 m/s.

    ``change`` receives time [s], velocity (3,) in b with noise, and in n without. ``late`` [s]: its age when sent.
    """
    truth, due = flight.recording.truth, 0.0
    for sample in flight.recording.samples():
        yield sample
        if isinstance(sample, ImuBlock) and (t := flight.seconds(sample.stamps_ns[-1])) >= due:
            due = t + 0.1
            row = min(int(truth.t.searchsorted(max(t - late, 0.0))), len(truth) - 1)
            velocity = truth.v_n[row]
            in_body = quat_to_matrix(truth.q_nb[row]).T @ velocity + flight.rng.normal(0.0, 0.05, 3)
            yield BodyVelocity(int(sample.stamps_ns[-1]), tuple(change(t, in_body, velocity).tolist()))


def body_enu(flight: Flight) -> Samples:
    """The body velocity is East-North-Up."""
    return with_body_velocity(flight, lambda t, b, n: n)


def body_late(flight: Flight) -> Samples:
    """The body velocity is 0.2 to 1 s late."""
    return with_body_velocity(flight, lambda t, b, n: b, flight.rng.uniform(0.2, 1.0))


def body_scaled(flight: Flight) -> Samples:
    """The body velocity has another unit or scale."""
    size = flight.rng.choice([0.5, 0.8, 1.2, 1.94, 3.28, 100.0])
    return with_body_velocity(flight, lambda t, b, n: size * b)


def body_changed(flight: Flight) -> Samples:
    """The body velocity stops, or changes its scale."""
    size, begin = flight.rng.choice([0.0, 0.5, 0.7, 1.5]), flight.begin()
    return with_body_velocity(flight, lambda t, b, n: b * (size if t > begin else 1.0))


def body_offset(flight: Flight) -> Samples:
    """The body velocity gets an offset of 0.2 to 1.5 m/s."""
    offset, begin = flight.rng.uniform(0.2, 1.5) * flight.axis(), flight.begin()
    return with_body_velocity(flight, lambda t, b, n: b + offset * (t > begin))


KINDS: dict[str, tuple[Callable[[Flight], Samples], bool]] = {
    "sound": (sound, False),
    "sound, outage": (sound, True),
    "IMU late": (imu_late, False),
    "GNSS late": (gnss_late, False),
    "rounded": (rounded, False),
    "gyro clipped": (clipped, False),
    "gyro clipped, outage": (clipped, True),
    "gyro step": (step, False),
    "gyro step, outage": (step, True),
    "gyro ramp": (ramp, False),
    "gyro ramp, outage": (ramp, True),
    "aliased": (aliased, False),
    "aliased, outage": (aliased, True),
    "vibration": (vibrating, False),
    "vibration, outage": (vibrating, True),
    "baro frozen, outage": (baro_frozen, True),
    "baro late, outage": (baro_late, True),
    "GNSS returns off": (returned, True),
    "baro step, outage": (baro_step, True),
    "baro drift, outage": (baro_drift, True),
    "body velocity ENU": (body_enu, True),
    "body velocity late": (body_late, True),
    "body velocity scaled": (body_scaled, True),
    "body velocity changes": (body_changed, True),
    "body velocity offset": (body_offset, True),
    "GNSS late, outage": (gnss_late, True),
    "GNSS filtered": (filtered, False),
    "GNSS filtered, outage": (filtered, True),
    "GNSS predicted": (predicted, False),
    "GNSS clock": (clock_scaled, False),
    "height in feet": (height_in_feet, False),
    "height in feet, no baro": (height_in_feet_no_baro, False),
    "baro weather, outage": (baro_weather, True),
    "baro airflow, outage": (baro_wash, True),
    "GNSS stuck": (gnss_stuck, False),
    "gyro dead": (gyro_dead, True),
}
"""Faults by name, and whether there is a GNSS outage."""


@dataclass
class Judged:
    """Of one flight, every 0.2 s of engine time: error and sigma [m], and whether the status is good."""

    rows: list[tuple[float, float, float, float, float, bool]]
    words: list[str]

    def lies(self) -> tuple[float, float, float, str]:
        """Time wrong with good status [s], time wrong [s], largest error in the former [m], and the worst as text."""
        if not self.rows:
            return 0.0, 0.0, 0.0, "no pose"
        t, off, sd, up, up_sd, ok = (np.array(column) for column in zip(*self.rows, strict=True))
        wrong = ((off > WRONG * sd) & (off > LEAST)) | ((up > WRONG * up_sd) & (up > LEAST))
        lie = wrong & ok
        worst = int(np.argmax(np.where(lie, np.maximum(off / sd, up / up_sd), 0.0)))
        told = f"h {off[worst]:.0f}/{sd[worst]:.1f} v {up[worst]:.0f}/{up_sd[worst]:.1f} m at {t[worst]:.0f} s"
        largest = float(np.maximum(off, up)[lie].max()) if lie.any() else 0.0
        return 0.2 * float(lie.sum()), 0.2 * float(wrong.sum()), largest, told if lie.any() else ""


def fly(flight: Flight, samples: Samples, method: str) -> Judged:
    """Run the samples without GNSS in the outage."""
    estimator = PoseEstimator(update(Parameters(), {"learner.method": method}), attitude=False)
    recording, now, asked, judged = flight.recording, 0.0, -1.0, Judged([], [])
    for sample in samples:
        if isinstance(sample, GNSS) and flight.lost <= now < flight.lost + LENGTH:
            continue
        for output in estimator.feed(sample):
            if isinstance(output, Event) and output.level is not Level.INFO and output.text:
                judged.words.append(f"{flight.seconds(output.stamp_ns):.1f} {output.name}: {output.text}")
            elif isinstance(output, NavBlock) and output.stamps_ns[-1] * 1e-9 - asked > 0.2 - 1e-6:
                asked = output.stamps_ns[-1] * 1e-9
                t, status = flight.seconds(output.stamps_ns[-1]), estimator.status()
                row = output.rows[-1]
                error = recording.error_enu(t, row[at.OUT_POS : at.OUT_VEL])
                sd = np.sqrt(row[at.OUT_VAR + at.DPOS : at.OUT_VAR + at.DPOS + 3])
                good = status.mode is not Mode.EXPIRED and not status.doubt
                judged.rows.append((t, math.hypot(*error[:2]), math.hypot(*sd[:2]), abs(error[2]), sd[2], good))
        if isinstance(sample, ImuBlock):
            now = flight.seconds(sample.stamps_ns[-1])
    return judged


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--vehicles", nargs="+", default=list(VEHICLES), choices=list(VEHICLES))
    parser.add_argument("--draws", type=int, default=1, help="of every kind on every vehicle")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--method", default="coast", help="learner.method")
    parser.add_argument("--words", action="store_true", help="show every flight and its warnings")
    options = parser.parse_args()
    print(
        f"{'kind':22s} {'flights':>7s} {'with a lie':>10s} {'wrong and OK':>12s} {'wrong':>8s} {'largest':>8s}  worst"
    )
    for kind in options.kinds:
        spoil, has_outage = KINDS[kind]
        results = []
        for vehicle in options.vehicles:
            for draw in range(options.seed, options.seed + options.draws):
                recording = scenarios.generate(vehicle, DURATION, draw, imu_rate=100.0)
                rng = np.random.default_rng([draw, VEHICLES.index(vehicle), list(KINDS).index(kind)])
                flight = Flight(recording, rng, LOST if has_outage else math.inf)
                judged = fly(flight, spoil(flight), options.method)
                results.append((vehicle, judged.lies()))
                if options.words:
                    print(vehicle, draw, judged.lies(), *(f"    {word}" for word in judged.words), sep="\n")
        lies = [one for _, one in results]
        name, worst = max(results, key=lambda one: one[1][2])
        print(
            f"{kind:22s} {len(lies):7d} {sum(one[0] > 0.0 for one in lies):10d} {sum(o[0] for o in lies):10.1f} s "
            f"{sum(o[1] for o in lies):6.1f} s {worst[2]:6.0f} m  {name + ': ' + worst[3] if worst[3] else ''}",
            flush=True,
        )


if __name__ == "__main__":
    main()
