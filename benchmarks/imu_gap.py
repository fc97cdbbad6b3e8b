"""A gap of the IMU in an outage: time until the navigator's next solution, its errors, and the consistency of sigma.

tools/in_environment.sh python benchmarks/imu_gap.py --lengths 1,3,10,30 flights/*_bag

GNSS is lost at 40 % of each flight, the gap of the IMU begins 8 s later, and the 20 s after it are evaluated. Errors
are horizontal, relative to the withheld GNSS; "ratio" is the largest error divided by its sigma.
"""

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample, SatelliteCount, stamp_of
from nav_pose_estimator.engine.solutions import NavBlock
from nav_pose_estimator.offline.flights.flight_window import flight_window
from nav_pose_estimator.offline.flights.recording import Recording, load

_SHARE, _BEFORE, _AFTER = 0.4, 8.0, 20.0  # fraction of the flight at the loss; s from there to the gap; s evaluated
_GNSS = (GnssFix, GnssVelocity, SatelliteCount)


def spoiled(recording: Recording, lost: float, gap: float, length: float) -> Iterator[Sample]:
    """The flight without GNSS from ``lost`` on, and without IMU for ``length`` from ``gap`` on, until 20 s after it."""
    now = 0.0
    for sample in recording.samples:
        now = ((stamp_of(sample) or recording.epoch_ns) - recording.epoch_ns) * 1e-9
        if now > gap + length + _AFTER:
            return
        if isinstance(sample, ImuBlock):
            t = (sample.stamps_ns - recording.epoch_ns) * 1e-9
            kept = np.flatnonzero(~((gap < t) & (t < gap + length)))
            for piece in np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1):
                if len(piece):
                    yield sample.part(int(piece[0]), int(piece[-1]) + 1)
        elif not (isinstance(sample, _GNSS) and now >= lost):
            yield sample


def judge(recording: Recording, delay: float, blocks: list[NavBlock], back: float) -> str:
    """Silence, first and last error with sigma, largest ratio of what came after ``back`` [s]."""
    stamps, rows = (np.concatenate(parts) for parts in zip(*((b.stamps_ns, b.rows) for b in blocks), strict=True))
    t, reference = (stamps - recording.epoch_ns) * 1e-9, recording.reference(delay)
    again = t[t >= back]
    if not len(again):
        return "silent until GNSS is back"
    errors, sigmas = [], []
    for when, place in zip(reference.t, reference.position, strict=True):
        if again[0] < when < again[-1]:
            row = rows[np.searchsorted(t, when)]
            errors.append(math.hypot(*lla_to_enu(*row[at.OUT_POS : at.OUT_VEL], *place)[:2]))
            sigmas.append(math.sqrt(row[at.OUT_VAR + at.DPOS] + row[at.OUT_VAR + at.DPOS + 1]))
    ratio = float(np.max(np.divide(errors, sigmas)))
    ends = "   ".join(f"{errors[i]:5.0f} m ({sigmas[i]:5.0f})" for i in (0, -1))
    return f"{again[0] - back:6.1f} s   {ends}   {ratio:5.2f}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", type=Path, nargs="+")
    parser.add_argument("--lengths", default="1,3,10,30", help="of the gap, s")
    parser.add_argument("--learner", action="store_true", help="with what the flight has shown of its motion")
    options = parser.parse_args()
    print(f"{'flight':20} {'gap':>5}   silent   first error (sigma)  after 20 s (sigma)   ratio")
    for bag in options.bags:
        recording = load(bag)
        delay = float(recording.sidecar.get("gnss_latency_est_s") or 0.0)
        parameters = update(Parameters(), {"gnss.delay": delay, "learner.enabled": options.learner})
        begin, end = flight_window(recording)
        lost = begin + _SHARE * (end - begin)
        for length in map(float, options.lengths.split(",")):
            engine, gap = PoseEstimator(parameters), lost + _BEFORE
            outputs = (output for sample in spoiled(recording, lost, gap, length) for output in engine.feed(sample))
            blocks = [output for output in outputs if isinstance(output, NavBlock)]
            print(f"{bag.name:20} {length:3.0f} s   {judge(recording, delay, blocks, gap + length)}", flush=True)


if __name__ == "__main__":
    main()
