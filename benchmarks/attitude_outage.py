"""Attitude through 600 s without GNSS: navigator and attitude filter against simulated truth.

    python benchmarks/attitude_outage.py --length 600 --seeds 3

Magnetometer and barometer stay; nothing from GNSS reaches the estimators after its loss.
"""

import argparse
from collections.abc import Iterable, Iterator

import numpy as np

from nav_pose_estimator.core import layout as at
from nav_pose_estimator.core.rotation import euler_from_quat_many, wrap_angle_many
from nav_pose_estimator.engine.parameter_schema import update
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample, SatelliteCount
from nav_pose_estimator.engine.solutions import AttitudeBlock, NavBlock
from nav_pose_estimator.sim.scenarios import generate

SCENARIOS = ("road_vehicle", "multirotor_light", "fixed_wing")
_GNSS = (GnssFix, GnssVelocity, SatelliteCount)


def without_gnss(samples: Iterable[Sample], start_ns: int, end_ns: int) -> Iterator[Sample]:
    """``samples`` up to ``end_ns`` without anything from GNSS that arrives after ``start_ns``."""
    now = 0
    for sample in samples:
        now = int(sample.stamps_ns[-1]) if isinstance(sample, ImuBlock) else now
        if now > end_ns:
            return
        if not (isinstance(sample, _GNSS) and now >= start_ns):
            yield sample


def attitudes(samples: Iterable[Sample], start_ns: int, **changes: object) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Stamps (N,) and q_nb (N, 4) of navigator and attitude filter after ``start_ns``."""
    engine = PoseEstimator(update(Parameters(), {"learner.enabled": False, **changes}))
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"navigator": [], "attitude filter": []}
    for sample in samples:
        for output in engine.feed(sample):
            if isinstance(output, NavBlock):
                found["navigator"].append((output.stamps_ns, output.rows[:, at.OUT_QUAT : at.OUT_RATE]))
            elif isinstance(output, AttitudeBlock):
                found["attitude filter"].append((output.stamps_ns, output.q_nb))
    joined = {name: tuple(map(np.concatenate, zip(*parts, strict=True))) for name, parts in found.items()}
    return {name: (t[t >= start_ns], q[t >= start_ns]) for name, (t, q) in joined.items()}


def rmse_deg(q: np.ndarray, truth: np.ndarray) -> str:
    """Root mean square of roll, pitch and yaw errors [deg]."""
    error = np.degrees(wrap_angle_many(euler_from_quat_many(q) - euler_from_quat_many(truth)))
    return "  ".join(f"{value:6.2f}" for value in np.sqrt(np.mean(error**2, axis=0)))


def simulated(length: float, seeds: int) -> None:
    """Each scenario and seed: 280 s with GNSS, then ``length`` seconds without."""
    for scenario in SCENARIOS:
        for seed in range(1, seeds + 1):
            flight = generate(scenario, duration=280.0 + length, seed=seed, imu="icm42688_calibrated", imu_rate=100.0)
            begin, end = (flight.start_ns + int(s * 1e9) for s in (280.0, 280.0 + length))
            for name, (stamps, q) in attitudes(without_gnss(flight.samples(), begin, end), begin).items():
                truth = flight.truth.at((stamps - flight.start_ns) * 1e-9).q_nb
                print(f"{scenario:18s} seed {seed}  {name:16s} {rmse_deg(q, truth)}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--length", type=float, default=600.0, help="seconds without GNSS")
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    print(f"{'':18s}         {'deg, RMSE':16s}   roll   pitch     yaw")
    simulated(arguments.length, arguments.seeds)


if __name__ == "__main__":
    main()
