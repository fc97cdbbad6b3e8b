"""Attitude through minutes without GNSS: navigator and attitude filter against simulated truth or a logged attitude.

    python benchmarks/attitude_outage.py --length 600 --seeds 3
    python benchmarks/attitude_outage.py --bags FLIGHT_bag... --aided 160

A flight's reference is the attitude that its autopilot logged on /reference/odom: a second opinion, not truth.

Magnetometer and barometer stay; nothing from GNSS reaches the estimators after its loss.
"""

import argparse
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import euler_from_quat_many, wrap_angle_many
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample, SatelliteCount
from nav_pose_estimator.engine.solutions import AttitudeBlock, NavBlock
from nav_pose_estimator.offline.bags.reader import read_samples
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


def logged_attitude(bag: Path) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (N,) and q_nb (N, 4) of /reference/odom."""
    rows = []
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        topics = [c for c in reader.connections if c.topic == "/reference/odom"]
        for connection, _, raw in reader.messages(topics):
            message = reader.deserialize(raw, connection.msgtype)
            q, stamp = message.pose.pose.orientation, message.header.stamp
            rows.append((stamp.sec * 1_000_000_000 + stamp.nanosec, (q.w, q.x, q.y, q.z)))
    return np.array([t for t, _ in rows]), np.array([q for _, q in rows])


def recorded(bags: list[Path], aided: float) -> None:
    """Each flight: ``aided`` seconds with GNSS from its beginning, the rest without."""
    for bag in bags:
        about = bag.with_name(bag.name.removesuffix("_bag") + ".json")
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
            print(f"{bag.name:18s} {seconds:5.0f} s  {name:16s} {rmse_deg(q, reference[nearest])}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--length", type=float, default=600.0, help="simulated seconds without GNSS")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--bags", type=Path, nargs="*", default=[], help="recorded flights instead of simulated ones")
    parser.add_argument("--aided", type=float, default=160.0, help="seconds of a recorded flight with GNSS")
    arguments = parser.parse_args()
    print(f"{'':18s}          {'deg, RMSE':16s}   roll   pitch     yaw")
    if arguments.bags:
        recorded(arguments.bags, arguments.aided)
    else:
        simulated(arguments.length, arguments.seeds)


if __name__ == "__main__":
    main()
