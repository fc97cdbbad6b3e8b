"""Errors of the pose with impossible GNSS data, by kind of error and vehicle, with and without an outage.

tools/in_environment.sh python benchmarks/impossible_gnss.py --vehicles multirotor wing car --kinds ned body
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, SatelliteCount
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavBlock
from nav_pose_estimator.sim import scenarios
from nav_pose_estimator.sim.recording import Recording

VEHICLES = {"multirotor": "multirotor_outage", "wing": "fixed_wing", "car": "road_vehicle"}
GNSS = (GnssFix, GnssVelocity, SatelliteCount)
Change = Callable[[Recording, Any, dict], Any]
"""Function that changes a fix or velocity; the dictionary is its state within one flight."""


def on_velocity(new: Callable[[float, float, float], tuple[float, float, float]]) -> Change:
    """Change of the velocity (East, North, Up) by ``new``."""

    def change(_recording: Recording, sample: Any, _memory: dict) -> Any:
        return replace(sample, vel_enu=new(*sample.vel_enu)) if isinstance(sample, GnssVelocity) else sample

    return change


def on_fix(new: Callable[[GnssFix], GnssFix]) -> Change:
    """Change of the fix by ``new``."""
    return lambda _recording, sample, _memory: new(sample) if isinstance(sample, GnssFix) else sample


def body(recording: Recording, sample: Any, _memory: dict) -> Any:
    """Velocity in body axes instead of ENU."""
    if not isinstance(sample, GnssVelocity):
        return sample
    row = min(
        int(np.searchsorted(recording.truth.t, (sample.stamp_ns - recording.start_ns) * 1e-9)), len(recording.truth) - 1
    )
    C = quat_to_matrix(recording.truth.q_nb[row])
    return replace(sample, vel_enu=tuple((C.T @ np.array(sample.vel_enu)).tolist()))


def late(recording: Recording, sample: Any, memory: dict) -> Any:
    """The velocity of one second ago with the present stamp."""
    if not isinstance(sample, GnssVelocity):
        return sample
    waiting = memory.setdefault("waiting", [])
    waiting.append(sample.vel_enu)
    return replace(sample, vel_enu=waiting[-6] if len(waiting) > 5 else waiting[0])


def frozen(kind: type[GnssFix | GnssVelocity], after: float) -> Change:
    """The values of ``kind`` stay as they were at ``after`` [s], with fresh stamps."""

    def change(recording: Recording, sample: Any, memory: dict) -> Any:
        if not isinstance(sample, kind) or (sample.stamp_ns - recording.start_ns) * 1e-9 < after:
            return sample
        held = memory.setdefault("held", sample)
        return replace(held, stamp_ns=sample.stamp_ns)

    return change


def turned(degrees: float) -> Change:
    """Velocity rotated about Up."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return on_velocity(lambda e, n, u: (c * e - s * n, s * e + c * n, u))


KINDS: dict[str, Change] = {
    "sound": lambda _recording, sample, _memory: sample,
    "ned": on_velocity(lambda e, n, u: (n, e, -u)),
    "ned, vz up": on_velocity(lambda e, n, u: (n, e, u)),
    "ned, 2D": on_velocity(lambda e, n, u: (n, e, math.nan)),
    "east inverted": on_velocity(lambda e, n, u: (-e, n, u)),
    "north inverted": on_velocity(lambda e, n, u: (e, -n, u)),
    "both inverted": on_velocity(lambda e, n, u: (-e, -n, u)),
    "turned 90": turned(90.0),
    "turned 45": turned(45.0),
    "turned 20": turned(20.0),
    "body": body,
    "speed only": on_velocity(lambda e, n, u: (math.hypot(e, n), 0.0, u)),
    "speed only, 2D": on_velocity(lambda e, n, u: (math.hypot(e, n), 0.0, 0.0)),
    "vz inverted": on_velocity(lambda e, n, u: (e, n, -u)),
    "vz silent": on_velocity(lambda e, n, u: (e, n, 0.0)),
    "velocity silent": on_velocity(lambda e, n, u: (0.0, 0.0, 0.0)),
    "north silent": on_velocity(lambda e, n, u: (e, 0.0, u)),
    "cm/s": on_velocity(lambda e, n, u: (100.0 * e, 100.0 * n, 100.0 * u)),
    "mm/s": on_velocity(lambda e, n, u: (1e3 * e, 1e3 * n, 1e3 * u)),
    "knots": on_velocity(lambda e, n, u: (1.944 * e, 1.944 * n, 1.944 * u)),
    "km/h": on_velocity(lambda e, n, u: (3.6 * e, 3.6 * n, 3.6 * u)),
    "velocity halved": on_velocity(lambda e, n, u: (0.5 * e, 0.5 * n, 0.5 * u)),
    "velocity late": late,
    "velocity frozen": frozen(GnssVelocity, 40.0),
    "position frozen": frozen(GnssFix, 40.0),
    "height in feet": on_fix(lambda f: replace(f, alt=3.2808 * f.alt)),
    "height in cm": on_fix(lambda f: replace(f, alt=100.0 * f.alt)),
    "height in mm": on_fix(lambda f: replace(f, alt=1e3 * f.alt)),
    "height inverted": on_fix(lambda f: replace(f, alt=-f.alt)),
    "lat, lon swapped": on_fix(lambda f: replace(f, lat=f.lon, lon=f.lat)),
    "lon inverted": on_fix(lambda f: replace(f, lon=-f.lon)),
    "lat inverted": on_fix(lambda f: replace(f, lat=-f.lat)),
    "degrees times 1e7": on_fix(lambda f: replace(f, lat=1e7 * f.lat, lon=1e7 * f.lon)),
    "radians": on_fix(lambda f: replace(f, lat=math.radians(f.lat), lon=math.radians(f.lon))),
}


@dataclass
class Judged:
    """About every 0.1 s: time [s], error (N, 3), sigma (N, 3) [m], and whether the status is OK."""

    t: np.ndarray
    error: np.ndarray
    sd: np.ndarray
    ok: np.ndarray
    words: list[str]

    def row(self, begin: float, end: float) -> np.ndarray:
        return (self.t >= begin) & (self.t < end)


@cache
def flight(vehicle: str, duration: float, seed: int) -> Recording:
    """The simulated flight, which is cached."""
    return scenarios.generate(VEHICLES[vehicle], duration, seed, imu_rate=100.0)


def fly(recording: Recording, change: Change, lost: float | None, length: float) -> Judged:
    """Run the flight with changed GNSS, and without GNSS from ``lost`` on for ``length`` [s]."""
    estimator = PoseEstimator(update(Parameters(), {"learner.method": "coast"}), attitude=False)
    memory: dict = {}
    t, rows, ok, words, now, asked = [], [], [], [], 0.0, -1.0
    fine = False
    for sample in recording.samples():
        if isinstance(sample, GNSS):
            if lost is not None and lost <= now < lost + length:
                continue
            sample = change(recording, sample, memory)
        for output in estimator.feed(sample):
            if isinstance(output, Event) and (output.level is not Level.INFO or output.name == "aligned"):
                words.append(f"{(output.stamp_ns - recording.start_ns) * 1e-9:.1f} {output.name}: {output.text}")
            elif isinstance(output, NavBlock):
                now = (output.stamps_ns[-1] - recording.start_ns) * 1e-9
                if now - asked > 0.2:
                    status, asked = estimator.status(), now
                    fine = status.mode is Mode.AIDED and not status.doubt
                t.append(now)
                rows.append(output.rows[-1])
                ok.append(fine)
        if not isinstance(sample, GNSS) and hasattr(sample, "stamps_ns"):
            now = (sample.stamps_ns[-1] - recording.start_ns) * 1e-9
    if not rows:
        return Judged(np.empty(0), np.empty((0, 3)), np.empty((0, 3)), np.empty(0, bool), words)
    times, solutions = np.array(t), np.array(rows)
    error = recording.error_enu(times, solutions[:, at.OUT_POS : at.OUT_VEL])
    sd = np.sqrt(solutions[:, at.OUT_VAR + at.DPOS : at.OUT_VAR + at.DPOS + 3])
    return Judged(times, error, sd, np.array(ok), words)


def summary(judged: Judged, begin: float, end: float, fixed: bool) -> str:
    """Summary of the time from ``begin`` to ``end`` [s], or with ``fixed`` of its end."""
    rows = judged.row(end - 0.3, end) if fixed else judged.row(begin, end)
    if not rows.any():
        return "no pose"
    off, sigma = np.hypot(*judged.error[rows, :2].T), np.hypot(*judged.sd[rows, :2].T)
    up, up_sigma = np.abs(judged.error[rows, 2]), judged.sd[rows, 2]
    ok = judged.ok[rows]
    if fixed:
        return f"h {off.mean():7.1f} / {sigma.mean():6.1f} m  v {up.mean():6.1f} / {up_sigma.mean():5.1f} m"
    rms, up_rms = np.sqrt(np.mean(off**2)), np.sqrt(np.mean(up**2))
    wrong, up_wrong = 100.0 * np.mean(ok & (off > 3.0 * sigma)), 100.0 * np.mean(ok & (up > 3.0 * up_sigma))
    return (
        f"h {rms:6.1f} max {off.max():6.1f} m, {wrong:3.0f} % wrong and OK  "
        f"v {up_rms:5.1f} max {up.max():5.1f} m, {up_wrong:3.0f} %  OK {100.0 * ok.mean():3.0f} %"
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", nargs="+", default=list(VEHICLES), choices=list(VEHICLES))
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--duration", type=float, default=75.0, help="of a flight, s")
    parser.add_argument("--lost", type=float, nargs="*", default=[40.0], help="when an outage begins, s")
    parser.add_argument("--length", type=float, default=20.0, help="of the outages, s")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--words", action="store_true", help="show the events")
    options = parser.parse_args()
    for vehicle in options.vehicles:
        recording = flight(vehicle, options.duration, options.seed)
        for kind in options.kinds:
            steady = fly(recording, KINDS[kind], None, 0.0)
            print(f"{vehicle:10s} {kind:18s} steady    {summary(steady, 5.0, options.duration, False)}", flush=True)
            if options.words:
                print(*(f"    {word}" for word in steady.words), sep="\n")
            for lost in options.lost:
                judged = fly(recording, KINDS[kind], lost, options.length)
                end = lost + options.length
                print(f"{vehicle:10s} {kind:18s} lost {lost:3.0f}  {summary(judged, lost, end, True)}", flush=True)


if __name__ == "__main__":
    main()
