"""A process killed in flight: time until its next solution and errors after the restart, with and without saved state.

tools/in_environment.sh python benchmarks/restart_in_flight.py --gap 6 flights/*_bag

Each flight is interrupted at 40, 60 and 80 % of its length, and evaluated for 25 s after the restart. Silence is the
time from the first IMU sample of the new process to its first solution, errors are horizontal, relative to GNSS, and
"sigma" is the fraction of them within three sigma.
"""

import argparse
import math
import statistics
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed import resumption
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import Sample, stamp_of
from nav_pose_estimator.engine.solutions import NavBlock
from nav_pose_estimator.offline.flights.flight_window import flight_window
from nav_pose_estimator.offline.flights.recording import Recording, load

_WATCHED = 25.0  # s after the restart that are evaluated
_SHARES = (0.4, 0.6, 0.8)  # fractions of the flight at which the process is killed


class Life(NamedTuple):
    """Results of a new process: silence [s] (infinite without solution), largest error [m], fraction within 3 sigma."""

    silent: float
    worst: float
    within: float

    def __str__(self) -> str:
        silent = f"{self.silent:5.1f} s" if math.isfinite(self.silent) else "  never"
        return f"{silent} {self.worst:6.1f} m {100.0 * self.within:4.0f} %"


def live(recording: Recording, samples: list[Sample], parameters: Parameters, saved: Mapping | None, back: int) -> Life:
    """Run a process that begins with ``samples`` at the stamp ``back``."""
    engine = PoseEstimator(parameters)
    if saved is not None:
        resumption.resume(engine, saved)
    blocks = [o for sample in samples for o in engine.feed(sample) if isinstance(o, NavBlock)]
    if not blocks:
        return Life(math.inf, math.nan, math.nan)
    stamps, rows = (np.concatenate(parts) for parts in zip(*((b.stamps_ns, b.rows) for b in blocks), strict=True))
    t, reference = (stamps - recording.epoch_ns) * 1e-9, recording.reference(parameters.gnss.delay)
    errors, sigmas = [], []
    for when, place in zip(reference.t, reference.position, strict=True):
        if t[0] < when < t[-1]:
            row = rows[np.searchsorted(t, when)]
            errors.append(float(np.linalg.norm(lla_to_enu(*row[at.OUT_POS : at.OUT_VEL], *place)[:2])))
            sigmas.append(math.sqrt(row[at.OUT_VAR + at.DPOS] + row[at.OUT_VAR + at.DPOS + 1]))
    within = [error < 3.0 * sigma for error, sigma in zip(errors, sigmas, strict=True)]
    silent = (int(stamps[0]) - back) * 1e-9
    return Life(silent, max(errors, default=math.nan), statistics.fmean(within) if within else math.nan)


def restart(recording: Recording, parameters: Parameters, killed_s: float, gap: float) -> tuple[Life, Life] | None:
    """Results with and without the saved state; None if the navigator did not run when it was killed."""
    killed = recording.epoch_ns + round(killed_s * 1e9)
    back, end = killed + round(gap * 1e9), killed + round((gap + _WATCHED) * 1e9)
    engine, now, later = PoseEstimator(parameters), 0, []
    for sample in recording.samples:
        now = stamp_of(sample) or now
        if now < killed:
            engine.feed(sample)
        elif back <= now < end:
            later.append(sample)
    saved = resumption.arrays_of(engine)
    if saved is None or not later:
        return None
    return live(recording, later, parameters, saved, back), live(recording, later, parameters, None, back)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", type=Path, nargs="+")
    parser.add_argument("--without-magnetometer", action="store_true", help="nor anything learned of it")
    parser.add_argument("--gap", type=float, default=6.0, help="from the kill to the first IMU sample, s")
    options = parser.parse_args()
    pairs = []
    print(f"{'flight':24} {'killed at':>9}   with the saved state       without")
    for bag in options.bags:
        recording = load(bag)
        delay = float(recording.sidecar.get("gnss_latency_est_s") or 0.0)
        aids = {"aids.magnetometer": not options.without_magnetometer}
        parameters = update(Parameters(), {"gnss.delay": delay, "learner.enabled": False, **aids})
        begin, end = flight_window(recording)
        for share in _SHARES:
            killed = begin + share * (end - begin)
            pair = restart(recording, parameters, killed, options.gap)
            told = "not aligned by then" if pair is None else "   ".join(map(str, pair))
            print(f"{bag.name:24} {killed:7.0f} s   {told}", flush=True)
            pairs += [] if pair is None else [pair]
    for name, lives in zip(("with", "without"), zip(*pairs, strict=True), strict=True):
        silent = sorted(life.silent for life in lives)
        quick = sum(life.silent < 3.0 for life in lives)
        spoken = [life for life in lives if math.isfinite(life.worst)]
        worst = max(life.worst for life in spoken)
        within = 100.0 * statistics.fmean(life.within for life in spoken)
        print(f"{name} the saved state: silent for {statistics.median(silent):.1f} s (median), ", end="")
        print(f"under 3 s in {quick} of {len(lives)}; worst error {worst:.1f} m, within 3 sigma {within:.1f} %")


if __name__ == "__main__":
    main()
