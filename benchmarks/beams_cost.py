# ruff: noqa: E402
"""Computing time of beam velocities: an IMU at 400 Hz, all sensors of the drone, with and without beams at 10 Hz.

    tools/in_environment.sh python benchmarks/beams_cost.py [--seconds 120] [--rounds 12]

CPU time with samples in memory, without rclpy and without the first half of the flight (alignment, verification of the
beams). Runs with and without beams alternate; the smallest time of each is printed, which other load affects least.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BeamVelocitySample, Sample
from nav_pose_estimator.sim.scenarios import DRONE, generate

IMU_RATE, BEAM_RATE = 400.0, 10.0
_PER_CALL = 2000  # samples that a replay feeds at once
Way = Callable[[PoseEstimator, list[Sample]], None]


def one_by_one(engine: PoseEstimator, samples: list[Sample]) -> None:
    """Feed the samples one by one, as a node does."""
    for sample in samples:
        engine.feed(sample)


def together(engine: PoseEstimator, samples: list[Sample]) -> None:
    """Feed many samples at once, as a replay does."""
    for first in range(0, len(samples), _PER_CALL):
        engine.feed_all(samples[first : first + _PER_CALL])


def seconds_of(way: Way, samples: list[Sample], parameters: Parameters) -> float:
    """CPU time of the second half of ``samples``."""
    engine, half = PoseEstimator(parameters), len(samples) // 2
    way(engine, samples[:half])
    begin = time.process_time()
    way(engine, samples[half:])
    spent = time.process_time() - begin
    used = engine.sins.journal.counters["beam_velocity.used"] > 0
    assert used == any(isinstance(sample, BeamVelocitySample) for sample in samples)
    return spent


def main() -> None:
    """Print milliseconds of CPU per second of flight, and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0, help="length of the flight (default: 120)")
    parser.add_argument("--rounds", type=int, default=12, help="runs of each (default: 12)")
    arguments = parser.parse_args()
    assert DRONE.doppler is not None
    doppler = replace(DRONE.doppler, rate=BEAM_RATE)
    scenario = replace(DRONE, doppler=doppler)
    recording = generate(scenario, arguments.seconds, seed=1, imu="icm42688_calibrated", imu_rate=IMU_RATE)
    values = {"aids.beam_velocity_source": "pointcloud2", "aids.beams.sd": doppler.noise}
    parameters = update(Parameters(), values)
    for name, way, blocks in (("sample by sample", one_by_one, False), ("replay", together, True)):
        beams = list(recording.samples(blocks=blocks))
        plain: list[Sample] = [sample for sample in beams if not isinstance(sample, BeamVelocitySample)]
        rounds = [
            (seconds_of(way, plain, parameters), seconds_of(way, beams, parameters))
            for _ in range(arguments.rounds + 1)
        ]
        without, with_beams = (2e3 * min(times) / arguments.seconds for times in zip(*rounds[1:], strict=True))
        print(f"{name}: {without:.2f} ms per second without beams, {with_beams:.2f} with: {with_beams / without:.3f}")


if __name__ == "__main__":
    main()
