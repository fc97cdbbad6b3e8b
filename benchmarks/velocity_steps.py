"""Steps of the estimated and of the published velocity between samples, in outages of recorded flights.

tools/in_environment.sh python benchmarks/velocity_steps.py flights/*_bag

A step is the difference of the velocity in b from the last one propagated with the IMU. In each flight GNSS is removed
for the second half of every minute, all in one run. "late" is the fraction of the time in which the published velocity
(``ros.output.velocity_slew``) differs from the estimate by more than 0.1 m/s.
"""

import argparse
import math
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.filter.layout import OUT_COLUMNS
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, SatelliteCount, stamp_of
from nav_pose_estimator.engine.solutions import NavBlock
from nav_pose_estimator.offline.flights.flight_window import flight_window
from nav_pose_estimator.offline.flights.recording import Recording, load
from nav_pose_estimator.ros.messages.steady_twist import follow

_GNSS = (GnssFix, GnssVelocity, SatelliteCount)
_PERIOD, _FIRST = 60.0, 30.0  # s: an outage lasts from _FIRST to the end of each period
_PAUSE = 1.0  # s


def fly(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (N,) [s] and solutions (N, OUT_COLUMNS) of a flight with its outages."""
    delay = float(recording.sidecar.get("gnss_latency_est_s") or 0.0)
    engine, now = PoseEstimator(update(Parameters(), {"gnss.delay": delay})), 0
    begin, _ = flight_window(recording)
    blocks = []
    for sample in recording.samples:
        now = stamp_of(sample) or now
        since = (now - recording.epoch_ns) * 1e-9 - begin
        if isinstance(sample, _GNSS) and since > 0.0 and since % _PERIOD >= _FIRST:
            continue
        blocks += [output for output in engine.feed(sample) if isinstance(output, NavBlock)]
    if not blocks:
        return np.empty(0), np.empty((0, OUT_COLUMNS))
    stamps = np.concatenate([block.stamps_ns for block in blocks])
    return (stamps - recording.epoch_ns) * 1e-9, np.concatenate([block.rows for block in blocks])


def steps(t: np.ndarray, rows: np.ndarray, slew: float) -> tuple[np.ndarray, np.ndarray]:
    """Step (N,) [m/s] of the published velocity at every sample, and its difference (N,) [m/s] from the estimate."""
    memory, taken, apart = np.zeros(6), np.zeros(len(t)), np.zeros(len(t))
    for i, row in enumerate(rows):
        dt = t[i] - t[i - 1] if i else math.inf
        if not 0.0 < dt < _PAUSE:
            follow(memory, row, 0.0, math.inf)
            continue
        whole = memory.copy()
        follow(whole, row, dt, 0.0)  # the offset with which there would be no step
        follow(memory, row, dt, slew * dt if slew > 0.0 else math.inf)
        taken[i], apart[i] = np.linalg.norm(whole[3:] - memory[3:]), np.linalg.norm(memory[3:])
    return taken, apart


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", type=Path, nargs="+")
    parser.add_argument("--slew", type=float, default=Parameters().ros.output.velocity_slew)
    options = parser.parse_args()
    print(f"{'flight':24} {'estimate: largest, 99.9 %':>26} {'published: largest, 99.9 %':>28} {'late':>7}   (m/s)")
    for bag in options.bags:
        t, rows = fly(load(bag))
        if not len(t):
            continue
        (plain, _), (blended, apart) = steps(t, rows, 0.0), steps(t, rows, options.slew)
        figures = [f(x) for x in (plain, blended) for f in (np.max, lambda x: np.quantile(x, 0.999))]
        late = f"{100.0 * np.mean(apart > 0.1):5.1f} %"
        numbers = " ".join(f"{value:{width}.2f}" for value, width in zip(figures, (16, 9, 18, 9), strict=True))
        print(f"{bag.name:24} {numbers} {late:>7}", flush=True)


if __name__ == "__main__":
    main()
