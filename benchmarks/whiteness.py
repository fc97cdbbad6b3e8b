# ruff: noqa: E402
"""Whiteness of the GNSS innovations and consistency of sigma, with and without states for correlated GNSS errors.

    python benchmarks/whiteness.py [BAG...] [--simulated 4] [--skip 30]

For each recorded flight: lag-one autocorrelation of the innovations of position and velocity (East, North, Up), their
RMS and the normalised innovation squared (NIS) per row, from ``--skip`` seconds after the start, and the CPU time.
Simulated flights are laps of a quadrotor with ``--simulated`` seeds, and position errors of the receiver of 1.5 m with
correlation times of 20, 60 and 180 s: RMS of the horizontal error, normalised estimation error squared (NEES) per axis
and fraction within 3 sigma, every five seconds.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import Sample
from nav_pose_estimator.engine.sensors.gnss.innovation_record import InnovationRecord
from nav_pose_estimator.engine.solutions import NavBlock, Output
from nav_pose_estimator.offline.flights import latency
from nav_pose_estimator.offline.flights.flight_window import flight_window
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import find_scenario, generate
from nav_pose_estimator.sim.sensors import Gnss

OPTION = "gnss.error_states"
TIMES = (20.0, 60.0, 180.0)  # s: correlation of the simulated errors
SECONDS = 300.0


class Watched(InnovationRecord):
    """A record that stores every innovation: (N, 3), with NaN without a height, and the NIS per row."""

    def __init__(self) -> None:
        super().__init__()
        self.all: list[list[float]] = []
        self.nis: list[float] = []

    def add(self, nis: float, z: Sequence[float] | np.ndarray, period: float, accepted: bool = True) -> None:
        """Add and store an innovation."""
        row = [float(one) for one in z]
        super().add(nis, row, period, accepted)
        self.all.append([*row, np.nan][:3])
        self.nis.append(nis / len(row))


def fly(samples: Iterable[Sample], parameters: Parameters) -> tuple[list[Output], list[Watched], float]:
    """Outputs, the records of position and velocity, and the processor time [s]."""
    estimator = PoseEstimator(parameters, attitude=False)
    gnss = estimator.sins.run.gnss
    gnss.position.record, gnss.velocity.record = records = [Watched(), Watched()]
    flight, begin = list(samples), time.process_time()
    outputs = estimator.feed_all(flight)
    return outputs, records, time.process_time() - begin


def in_words(record: Watched, skip: int) -> str:
    """Three table cells: autocorrelation, RMS on each axis, mean NIS per row."""
    z, nis = np.array(record.all[skip:]).reshape(-1, 3), np.array(record.nis[skip:])
    if len(z) < 2:
        return "- | - | -"
    pairs = z[1:] * z[:-1]
    lag = [np.nansum(pairs[:, axis]) / np.nansum(z[:, axis] ** 2) for axis in range(3)]
    size = np.sqrt(np.nanmean(z**2, axis=0))
    return f"{' '.join(f'{x:.2f}' for x in lag)} | {' '.join(f'{x:.2f}' for x in size)} | {np.mean(nis):.2f}"


def recorded(bag: Path, skip: float) -> None:
    recording = load(bag)
    option = None if "gnss_latency_est_s" in recording.sidecar else latency.AUTO
    parameters, _ = latency.choose(recording, Parameters(), option, None, flight_window(recording)[1])
    for on in (False, True):
        _, (position, velocity), seconds = fly(recording.samples, update(parameters, {OPTION: on}))
        few = round(skip * len(position.all) / recording.duration)
        name = f"{recording.name}, {'with' if on else 'without'}"
        print(f"| {name} | {in_words(position, few)} | {in_words(velocity, few)} | {seconds:.1f} |", flush=True)


def slow(tau: float, seed: int) -> Recording:
    """Laps with a receiver whose errors have the correlation time ``tau`` [s]."""
    gnss = Gnss(position_sd=(1.5, 1.5, 2.5), position_tau=tau, position_noise=(0.2, 0.2, 0.3))
    return generate(replace(find_scenario("laps"), gnss=gnss), SECONDS, seed, imu_rate=50.0)


def against_truth(recording: Recording, outputs: list[Output], skip: float) -> tuple[np.ndarray, np.ndarray]:
    """Squared horizontal error on each axis (N, 2) [m^2] and its variance, every five seconds."""
    blocks = [one for one in outputs if isinstance(one, NavBlock)]
    t = 1e-9 * (np.concatenate([one.stamps_ns for one in blocks]) - recording.start_ns)
    rows = np.concatenate([one.rows for one in blocks])
    at_time = np.searchsorted(t, np.arange(t[0] + skip, t[-1], 5.0))
    rows = rows[at_time]
    error = recording.error_enu(t[at_time], rows[:, at.OUT_POS : at.OUT_VEL])
    return error[:, :2] ** 2, rows[:, at.OUT_VAR + at.DPOS : at.OUT_VAR + at.DPOS + 2]


def simulated(tau: float, seeds: int, skip: float) -> None:
    for on in (False, True):
        squares, variances, lags = [], [], []
        for seed in range(seeds):
            recording = slow(tau, seed)
            outputs, (position, _), _ = fly(recording.samples(), update(Parameters(), {OPTION: on}))
            square, variance = against_truth(recording, outputs, skip)
            squares.append(square)
            variances.append(variance)
            lags.append(position.lag_one)
        square, variance = np.concatenate(squares), np.concatenate(variances)
        inside = np.mean(square.sum(axis=1) <= 9.0 * variance.sum(axis=1))
        rms, sigma = (np.sqrt(one.sum(axis=1).mean()) for one in (square, variance))
        print(
            f"| {tau:g} s, {'with' if on else 'without'} | {np.median(lags):.2f} | {rms:.2f} | {sigma:.2f} "
            f"| {np.mean(square / variance):.2f} | {inside:.0%} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", nargs="*", type=Path)
    parser.add_argument("--simulated", type=int, default=0, metavar="SEEDS", help="flights for each correlation time")
    parser.add_argument("--skip", type=float, default=30.0, help="seconds at the start that do not count")
    arguments = parser.parse_args()
    if arguments.bags:
        print("| flight, states | position: lag 1 | RMS m | NIS | velocity: lag 1 | RMS m/s | NIS | CPU s |")
        print("|---|---|---|---|---|---|---|---|")
    for bag in arguments.bags:
        recorded(bag, arguments.skip)
    if arguments.simulated:
        print("\n| error lasts, states | lag 1 | RMS m | sigma m | NEES | in 3 sigma |\n|---|---|---|---|---|---|")
        for tau in TIMES:
            simulated(tau, arguments.simulated, arguments.skip)


if __name__ == "__main__":
    main()
