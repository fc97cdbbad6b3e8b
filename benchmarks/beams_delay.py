# ruff: noqa: E402
"""Beam velocities with a delay that is unknown to the estimator, with and without a state for the delay.

    tools/in_environment.sh python benchmarks/beams_delay.py [--case drone] [--delays 0,0.05,0.15] [--seeds 10] \
        [--first-seed 7000] [--aided 120] [--length 60]

Results over the seeds of a simulation: error of the delay at the loss of GNSS in ms (mean and RMS), its standard
deviation by the filter (median) and the squared error over the variance (mean; 1 is consistent); horizontal error at
the end of the time without GNSS in % of the distance (median, RMS), and the NEES of horizontal velocity and position
then, per degree of freedom (mean).
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import DVL_DELAY
from nav_pose_estimator.core.filter.error_state import error_between
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import Sample, stamp_of
from nav_pose_estimator.offline.benchmarks.alignment.trial import true_nav
from nav_pose_estimator.offline.benchmarks.beams.cases import CASES, Case
from nav_pose_estimator.offline.benchmarks.beams.trial import fly_with_gnss, without_gnss
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate

_DEVIATIONS = (0.0, 0.1)  # s: aids.beams.delay_sd
_JUDGED = [at.DVEL, at.DVEL + 1, at.DPOS, at.DPOS + 1]


class Outcome(NamedTuple):
    """One flight: error and sigma of the delay [s], NaN if it is not a state; error in % of the distance; NEES."""

    error: float
    sd: float
    percent: float
    nees: float


def flown(case: Case, recording: Recording, delay: float, sd: float, aided: float) -> Outcome:
    """Run ``aided`` [s] with GNSS and the rest without, with beams that are ``delay`` [s] late."""
    begin_ns = recording.start_ns + round(aided * 1e9)
    samples = list(without_gnss(recording, begin_ns).samples())
    values = {"aids.beams.delay": 0.0, "aids.beams.delay_sd": sd}
    engine = SinsEngine(update(case.parameters(), values))
    with_gnss = _count_before(samples, begin_ns)
    if case.scenario.magnetometer is None:  # the observability of the heading is not tested here
        fly_with_gnss(engine, case, recording, begin_ns)
    else:
        engine.feed_all(samples[:with_gnss])
    error, stated = math.nan, math.nan
    whole = engine.run.settled
    if DVL_DELAY.is_in(whole.constants):
        state = DVL_DELAY.states(whole.constants).start
        error, stated = whole.nav[at.DVL_DELAY] - delay, math.sqrt(whole.P[state, state])
    engine.feed_all(samples[with_gnss:])
    whole, truth = engine.run.settled, recording.truth
    row = min(round((whole.time - truth.t[0]) / truth.dt), len(truth.t) - 1)
    left = error_between(true_nav(truth, row), whole.nav, whole.constants)
    judged = left[_JUDGED]
    nees = float(judged @ np.linalg.solve(whole.P[np.ix_(_JUDGED, _JUDGED)], judged)) / len(judged)
    travelled = float(np.hypot(*truth.v_n[truth.t > aided, :2].T).sum() * truth.dt)
    return Outcome(error, stated, 100.0 * float(np.hypot(*left[at.DPOS : at.DPOS + 2])) / travelled, nees)


def _count_before(samples: list[Sample], end_ns: int) -> int:
    for count, sample in enumerate(samples):
        stamp = stamp_of(sample)
        if stamp is not None and stamp >= end_ns:
            return count
    return len(samples)


def main() -> None:
    """Print a line for every delay and method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", choices=tuple(CASES), default="drone", help="vehicle (default: drone)")
    parser.add_argument("--delays", default="0,0.05,0.15", help="of the stamps, s (default: 0,0.05,0.15)")
    parser.add_argument("--seeds", type=int, default=10, help="flights of each (default: 10)")
    parser.add_argument("--first-seed", type=int, default=7000, help="(default: 7000)")
    parser.add_argument("--aided", type=float, default=120.0, help="seconds with GNSS (default: 120)")
    parser.add_argument("--length", type=float, default=60.0, help="seconds without (default: 60)")
    arguments = parser.parse_args()
    case = CASES[arguments.case]
    for delay in map(float, arguments.delays.split(",")):
        model = replace(case.doppler, latency=delay)
        scenario = replace(case.scenario, duration=arguments.aided + arguments.length, doppler=model)
        outcomes: dict[float, list[Outcome]] = {sd: [] for sd in _DEVIATIONS}
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
            recording = generate(scenario, seed=seed, imu=case.grade)
            for sd, list_ in outcomes.items():
                list_.append(flown(case, recording, delay, sd, arguments.aided))
        for sd, list_ in outcomes.items():
            error, stated, percent, nees = np.array(list_).T
            print(
                f"delay {delay:.2f} s, delay_sd {sd:.1f}: known to {1e3 * error.mean():.1f} (mean) "
                f"{1e3 * math.sqrt(np.square(error).mean()):.1f} (RMS) {1e3 * np.median(stated):.1f} (stated) ms, "
                f"ratio {np.square(error / stated).mean():.2f}; at the end {np.median(percent):.3f} / "
                f"{math.sqrt(np.square(percent).mean()):.3f} %, NEES {nees.mean():.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
