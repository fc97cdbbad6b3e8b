"""Time until a true return of GNSS is used after an outage, and whether one with an error of 300 m is used within 20 s.

tools/in_environment.sh python benchmarks/returns.py --length 60 --offset 300 flights/*_bag
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock
from nav_pose_estimator.offline.benchmarks.outage.aided_pass import Start, aided_pass
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.flights.flight_window import flight_window
from nav_pose_estimator.offline.flights.outages import Outage
from nav_pose_estimator.offline.flights.recording import Recording, load

_EARTH = 6.37e6  # m
_PATIENCE = {True: 20.0, False: 40.0}  # s for which a wrong and a true return are evaluated


def waited(engine: PoseEstimator, recording: Recording, start: Start, offset: float) -> float | None:
    """Time [s] from the end of the outage to the first used fix, with an error ``offset`` [m] North; None without."""
    engine.restore(start.snapshots[0])
    delay_ns = round(engine.parameters.gnss.delay * 1e9)
    begin = recording.epoch_ns + round(start.outage.start * 1e9)
    end, row = begin + round(start.outage.length * 1e9), start.row
    run = engine.sins.run
    back = run.clock.seconds(end)
    for sample in recording.held[start.index :]:
        if isinstance(sample, ImuBlock):
            sample, row = sample.part(row, None), 0
            if len(sample) and sample.stamps_ns[0] > end + _PATIENCE[offset > 0.0] * 1e9:
                return None
        elif isinstance(sample, (GnssFix, GnssVelocity)) and begin <= sample.stamp_ns - delay_ns < end:
            continue
        elif isinstance(sample, GnssFix) and sample.stamp_ns - delay_ns >= end:
            sample = replace(sample, lat=sample.lat + offset / _EARTH)
        if not isinstance(sample, ImuBlock) or len(sample):
            engine.feed(sample)
        if run.aiding.fix_used > back - 0.01:
            return run.aiding.fix_used - back
    return None


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", type=Path, nargs="+")
    parser.add_argument("--length", type=float, default=60.0, help="of the outages, s")
    parser.add_argument("--offset", type=float, default=300.0, help="of the wrong return, m")
    parser.add_argument("--method", default="best")
    options = parser.parse_args()
    for bag in options.bags:
        recording = load(bag)
        delay = float(recording.sidecar.get("gnss_latency_est_s", 0.2))
        parameters = update(methods.apply(load_parameters(None), options.method), {"gnss.delay": delay})
        begin, end = flight_window(recording)
        first = begin + (60.0 if end - begin < 400.0 else 160.0)
        starts = np.arange(first, end - options.length - 45.0, max(20.0, (end - first) / 12))
        engine, outages = PoseEstimator(parameters, attitude=False), [Outage(float(s), options.length) for s in starts]
        true, wrong = [], []
        for start in aided_pass(recording, [parameters], outages):
            true.append(waited(engine, recording, start, 0.0))
            wrong.append(waited(engine, recording, start, options.offset))
        taken = sum(value is not None for value in wrong)
        late = [np.inf if value is None else value for value in true]
        text = f"true: median {np.median(late):.1f}, worst {max(late):.1f} s" if late else "no outage fits"
        print(f"{bag.name}: {len(true)} outages, {text}; {options.offset:.0f} m off: {taken} taken", flush=True)


if __name__ == "__main__":
    main()
