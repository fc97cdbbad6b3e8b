"""Attitude through minutes without GNSS: navigator and attitude filter against simulated truth or a logged attitude.

    python benchmarks/attitude_outage.py --length 600 --seeds 3
    python benchmarks/attitude_outage.py --bags FLIGHT_bag... --aided 160

The reference of a recorded flight is the attitude logged by its autopilot on /reference/odom, which is not the truth.

Magnetometer, barometer and wheels stay; nothing from GNSS reaches the estimators after its loss. Four of them run:

    navigator    SINS and Kalman filter
    helped       attitude filter in the navigator's process, which receives its velocity also while it coasts
    own process  attitude filter that receives the navigator's odometry until the loss of GNSS only
    alone        attitude filter without a navigator
"""

import argparse
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import euler_from_quat_many, wrap_angle_many
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.composed.exchange import navigator_velocity
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample, SatelliteCount
from nav_pose_estimator.engine.solutions import AttitudeBlock, NavBlock, Output
from nav_pose_estimator.offline.bags.reader import read_samples
from nav_pose_estimator.offline.sidecar import sidecar_path
from nav_pose_estimator.sim.scenarios import generate

SCENARIOS = ("road_vehicle_wheels", "road_vehicle", "multirotor_light", "fixed_wing")
_FIRST_SEED = 301  # seeds from here on were not used in the development of the filter
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
    """Stamps (N,) and q_nb (N, 4) of each estimator after ``start_ns``."""
    parameters = update(Parameters(), {"learner.enabled": False, **changes})
    whole, own, alone = PoseEstimator(parameters), AttitudeEngine(parameters), AttitudeEngine(parameters)
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = defaultdict(list)
    for sample in samples:
        outputs = whole.feed(sample)
        _note(found, "helped", outputs)
        _note(found, "own process", own.feed(sample))
        _note(found, "alone", alone.feed(sample))
        for output in outputs:
            if isinstance(output, NavBlock):
                found["navigator"].append((output.stamps_ns, output.rows[:, at.OUT_QUAT : at.OUT_RATE]))
                velocity = navigator_velocity([output], 0, int(output.stamps_ns[-1]))
                if velocity is not None and output.stamps_ns[-1] < start_ns:
                    own.feed(velocity)
    joined = {name: tuple(map(np.concatenate, zip(*parts, strict=True))) for name, parts in found.items()}
    return {name: (t[t >= start_ns], q[t >= start_ns]) for name, (t, q) in joined.items()}


def _note(found: dict[str, list[tuple[np.ndarray, np.ndarray]]], name: str, outputs: Iterable[Output]) -> None:
    found[name] += [(o.stamps_ns, o.q_nb) for o in outputs if isinstance(o, AttitudeBlock)]


def rmse_deg(q: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Root mean square (3,) of roll, pitch and yaw errors [deg]."""
    error = np.degrees(wrap_angle_many(euler_from_quat_many(q) - euler_from_quat_many(truth)))
    return np.sqrt(np.mean(error**2, axis=0))


def as_text(rpy: np.ndarray) -> str:
    """Roll, pitch and yaw as columns of text."""
    return "  ".join(f"{value:6.2f}" for value in rpy)


def simulated(length: float, seeds: int, first: int, **changes: object) -> None:
    """Run each scenario and seed for 280 s with GNSS and ``length`` [s] without; print errors, mean and largest."""
    figures: dict[tuple[str, str], list[np.ndarray]] = defaultdict(list)
    for scenario in SCENARIOS:
        for seed in range(first, first + seeds):
            flight = generate(scenario, duration=280.0 + length, seed=seed, imu="icm42688_calibrated", imu_rate=100.0)
            begin, end = (flight.start_ns + int(s * 1e9) for s in (280.0, 280.0 + length))
            for name, (stamps, q) in attitudes(without_gnss(flight.samples(), begin, end), begin, **changes).items():
                truth = flight.truth.at((stamps - flight.start_ns) * 1e-9).q_nb
                figures[scenario, name].append(rmse_deg(q, truth))
                print(f"{scenario:20s} seed {seed}  {name:12s} {as_text(figures[scenario, name][-1])}", flush=True)
    print(f"\n{'':34s}{'mean':>22s}{'largest':>26s}")
    for (scenario, name), rows in figures.items():
        print(f"{scenario:20s} {name:12s} {as_text(np.mean(rows, axis=0))}    {as_text(np.max(rows, axis=0))}")


def logged_attitude(bag: Path) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (N,) and q_nb (N, 4) of /reference/odom."""
    rows = []
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        topics = [c for c in reader.connections if c.topic == "/reference/odom"]
        for connection, _, raw in reader.messages(topics):
            message: Any = reader.deserialize(raw, connection.msgtype)
            q, stamp = message.pose.pose.orientation, message.header.stamp
            rows.append((stamp.sec * 1_000_000_000 + stamp.nanosec, (q.w, q.x, q.y, q.z)))
    return np.array([t for t, _ in rows]), np.array([q for _, q in rows])


def recorded(bags: list[Path], aided: float) -> None:
    """Run each flight for ``aided`` [s] with GNSS, and the rest without."""
    for bag in bags:
        about = sidecar_path(bag)
        known = json.loads(about.read_text()) if about.exists() else {}
        stamps, reference = logged_attitude(bag)
        offset = int(known.get("bag", {}).get("stamp_offset_s", 0)) * 1_000_000_000
        window = (
            [offset + int(s * 1e9) for s in known["flight_window_s"]] if known else [int(stamps[0]), int(stamps[-1])]
        )
        begin, end = window[0] + int(aided * 1e9), window[1]
        changes = {"gnss.delay": float(known.get("gnss_latency_est_s", 0.0))}
        for name, (times, q) in attitudes(without_gnss(read_samples(bag), begin, end), begin, **changes).items():
            nearest = np.clip(np.searchsorted(stamps, times), 0, len(stamps) - 1)
            seconds = (end - begin) * 1e-9
            print(f"{bag.name:18s} {seconds:5.0f} s  {name:12s} {as_text(rmse_deg(q, reference[nearest]))}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--length", type=float, default=600.0, help="simulated seconds without GNSS")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=_FIRST_SEED)
    parser.add_argument("--wander", type=float, help="attitude.wander of a simulated IMU that is known to be better")
    parser.add_argument("--bias-walk", type=float, help="attitude.bias_walk of such an IMU")
    parser.add_argument("--bags", type=Path, nargs="*", default=[], help="recorded flights instead of simulated ones")
    parser.add_argument("--aided", type=float, default=160.0, help="seconds of a recorded flight with GNSS")
    arguments = parser.parse_args()
    print(f"{'':20s}           {'deg, RMSE':12s}   roll   pitch     yaw")
    if arguments.bags:
        recorded(arguments.bags, arguments.aided)
    else:
        noise = {"attitude.wander": arguments.wander, "attitude.bias_walk": arguments.bias_walk}
        known = {name: value for name, value in noise.items() if value is not None}
        simulated(arguments.length, arguments.seeds, arguments.first_seed, **known)


if __name__ == "__main__":
    main()
