# ruff: noqa: E402
"""Benefit of the identification of the noise in flight, with an IMU that is noisier than its parameters.

    python benchmarks/noisier_imu.py BAG... [--gyro 4e-3] [--accel 0.1] [--methods coast,anfis,best] [--every 20]

White noise of the given densities is added to a recorded flight, and the same outages are flown with and without
``imu.learn_noise``.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuBlock, Sample
from nav_pose_estimator.offline.benchmarks.outage.statistics import rms
from nav_pose_estimator.offline.benchmarks.outage.trials import FlightResult, run_outages
from nav_pose_estimator.offline.flights import latency, methods
from nav_pose_estimator.offline.flights.flight_window import flight_window, outage_starts
from nav_pose_estimator.offline.flights.recording import Recording, load

SEED = 7


def noisier(recording: Recording, gyro: float, accel: float) -> Iterator[Sample]:
    """The samples with white noise of densities ``gyro`` [rad/s/sqrt(Hz)] and ``accel`` [m/s^2/sqrt(Hz)] added."""
    rng = np.random.default_rng(SEED)
    per_sample = np.sqrt(recording.imu_count / recording.duration)
    for sample in recording.samples:
        if isinstance(sample, ImuBlock):
            shape = sample.gyro.shape
            rate = sample.gyro + gyro * per_sample * rng.normal(size=shape)
            force = sample.accel + accel * per_sample * rng.normal(size=shape)
            sample = replace(sample, gyro=rate, accel=force)
        yield sample


def errors(
    recording: Recording, method: str, lengths: list[float], every: float, learns: bool
) -> dict[float, np.ndarray]:
    """End errors and sigmas (N, 2) [m] by length of the outage."""
    parameters = update(methods.apply(Parameters(), method), {"imu.learn_noise": learns})
    window = flight_window(recording)
    planned = outage_starts(window, lengths, every, None)
    option = None if "gnss_latency_est_s" in recording.sidecar else latency.AUTO
    parameters, _ = latency.choose(recording, parameters, option, None, window[1])
    result = FlightResult(recording.name, parameters.gnss.delay, window)
    run_outages(recording, parameters, planned, (method,), result)
    found = {
        length: [(one.end_error_m, one.end_sigma_m) for one in judged if np.isfinite(one.end_error_m)]
        for (_, length), judged in result.errors.items()
    }
    return {length: np.array(pairs) for length, pairs in found.items() if pairs}


def cell(pairs: np.ndarray) -> str:
    """RMS, share within 3 sigma and median of error / sigma."""
    error, sigma = pairs.T
    return f"{rms(error):.1f} ({np.mean(error <= 3.0 * sigma):.0%}, {np.median(error / sigma):.2f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", nargs="+", type=Path)
    parser.add_argument("--gyro", type=float, default=4e-3, help="density that is added, rad/s/sqrt(Hz)")
    parser.add_argument("--accel", type=float, default=0.1, help="density that is added, m/s^2/sqrt(Hz)")
    parser.add_argument("--methods", default="coast,anfis,best")
    parser.add_argument("--lengths", default="10,30,60")
    parser.add_argument("--every", type=float, default=20.0, help="seconds between outages")
    arguments = parser.parse_args()
    lengths = [float(text) for text in arguments.lengths.split(",")]
    print("| flight, method | s | as set: RMS m (in 3 sigma, error / sigma) | identified |\n|---|---|---|---|")
    for bag in arguments.bags:
        recording = load(bag)
        recording = replace(recording, samples=list(noisier(recording, arguments.gyro, arguments.accel)))
        for method in arguments.methods.split(","):
            fixed, learned = (errors(recording, method, lengths, arguments.every, learns) for learns in (False, True))
            for length in fixed:
                print(
                    f"| {recording.name}, {method} | {length:g} | {cell(fixed[length])} | {cell(learned[length])} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
