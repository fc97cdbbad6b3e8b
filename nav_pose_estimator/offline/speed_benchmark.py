"""``benchmark speed``: what everything costs on this machine, beside the peers that are installed.

Times are CPU time of one thread, the best of several repetitions: what the work costs, not what else the machine did.
"""

import argparse
import json
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, ImuSample, Sample
from nav_pose_estimator.offline.flight_messages import imu_bytes, message_of

SECONDS, IMU_HZ = 600.0, 200.0
REPEAT = 3


@dataclass(frozen=True)
class Figure:
    """One measured value; ``goal`` None where there is none. ``better``: lower or higher."""

    what: str
    value: float
    unit: str
    goal: float | None = None
    better: str = "lower"

    @property
    def verdict(self) -> str:
        """Whether the goal is met; empty without one."""
        if self.goal is None:
            return ""
        met = self.value <= self.goal if self.better == "lower" else self.value >= self.goal
        return "met" if met else "missed"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``benchmark speed``."""
    parser.add_argument(
        "--out", type=Path, default=Path("speed_benchmark"), metavar="DIR", help="folder for speed.json"
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure, print a table, and write speed.json."""
    from nav_pose_estimator.offline.benchmark_command import make_folder
    from nav_pose_estimator.offline.plain_flight import samples
    from nav_pose_estimator.offline.replay_files import plain, versions

    folder = make_folder(arguments.out)
    flight = samples(SECONDS, IMU_HZ)
    figures = [*_navigator(flight), *_attitude(flight), *_learner()]
    with TemporaryDirectory(prefix="nav_pose_estimator_") as scratch:
        figures += [*_bags(Path(scratch), flight), *_replay(Path(scratch))]
    figures += _imports()
    width = max(len(figure.what) for figure in figures)
    for f in figures:
        goal = "" if f.goal is None else f"{'at most' if f.better == 'lower' else 'at least'} {f.goal:g} {f.unit}"
        print(f"{f.what:{width}}  {f.value:10.3g} {f.unit:12}  {goal:24} {f.verdict}")
    machine = {"processor": platform.processor() or platform.machine(), "system": platform.platform()}
    content = {"figures": [asdict(f) for f in figures], "machine": machine, "versions": versions()}
    (folder / "speed.json").write_text(json.dumps(plain(content), indent=1) + "\n", encoding="utf-8")
    print(f"figures: {folder / 'speed.json'}")
    return 0


def best_time(action: Callable[[], object], repeat: int = REPEAT) -> float:
    """Least CPU time [s] of ``repeat`` runs."""
    times = []
    for _ in range(repeat):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return min(times)


def _singles(flight: list[Sample], count: int) -> list[ImuSample]:
    out: list[ImuSample] = []
    for block in flight:
        if isinstance(block, ImuBlock):
            rows = zip(block.stamps_ns.tolist(), block.gyro.tolist(), block.accel.tolist(), strict=True)
            out += [ImuSample(t, tuple(w), tuple(f)) for t, w, f in rows]
            if len(out) >= count:
                break
    return out[:count]


def _imu_only(flight: list[Sample]) -> ImuBlock:
    blocks = [s for s in flight if isinstance(s, ImuBlock)]
    parts = (np.concatenate([getattr(b, name) for b in blocks]) for name in ("stamps_ns", "gyro", "accel"))
    return ImuBlock(*parts)


def _aligned(flight: list[Sample], seconds: float):
    """A navigator that has flown ``seconds``, and what follows."""
    from nav_pose_estimator.engine.sins import SinsEngine

    engine = SinsEngine(Parameters())
    engine.warm_up()
    first = next(s for s in flight if isinstance(s, ImuBlock)).stamps_ns[0]
    limit = first + round(seconds * 1e9)
    for i, sample in enumerate(flight):
        if (sample.stamps_ns[0] if isinstance(sample, ImuBlock) else sample.stamp_ns) >= limit:
            return engine, flight[i:]
        engine.feed(sample)
    return engine, []


def _navigator(flight: list[Sample]) -> list[Figure]:
    engine, rest = _aligned(flight, 60.0)
    start = engine.snapshot()
    imu = _imu_only(rest)
    pieces = [
        ImuBlock(imu.stamps_ns[i : i + 200], imu.gyro[i : i + 200], imu.accel[i : i + 200])
        for i in range(0, len(imu), 200)
    ]
    singles = _singles(rest, 4000)
    gnss = [s for s in rest if isinstance(s, (ImuBlock, GnssFix, GnssVelocity))]

    def feed(samples: list) -> Callable[[], None]:
        def action() -> None:
            engine.restore(start)
            for sample in samples:
                engine.feed(sample)

        return action

    joined = _joined(gnss)
    return [
        Figure("navigator, IMU alone, blocks of 1 s", 1e6 * best_time(feed(pieces)) / len(imu), "us/epoch", 0.4),
        Figure("navigator, IMU and 1 Hz GNSS", 1e6 * best_time(feed(joined)) / len(imu), "us/epoch"),
        Figure("navigator, sample by sample", 1e6 * best_time(feed(singles)) / len(singles), "us/epoch"),
        Figure("IMU callback without rclpy", 1e6 * best_time(_callback(engine, start, singles)) / 4000, "us", 10.0),
    ]


def _joined(samples: list[Sample]) -> list[Sample]:
    """The samples with neighbouring IMU blocks made one."""
    out: list[Sample] = []
    for sample in samples:
        if isinstance(sample, ImuBlock) and out and isinstance(out[-1], ImuBlock):
            pair = out[-1], sample
            out[-1] = ImuBlock(*(np.concatenate([getattr(b, n) for b in pair]) for n in ("stamps_ns", "gyro", "accel")))
        else:
            out.append(sample)
    return out


def _callback(engine, start, singles: list[ImuSample]) -> Callable[[], None]:
    """What a node does with one serialized Imu message, but for rclpy itself."""
    from nav_pose_estimator.ros.imu_cdr import decode_imu

    messages = [imu_bytes(sample) for sample in singles]

    def action() -> None:
        engine.restore(start)
        for message in messages:
            for sample in decode_imu(message):
                engine.feed(sample)

    return action


def _attitude(flight: list[Sample]) -> list[Figure]:
    from nav_pose_estimator import estimate_attitude
    from nav_pose_estimator.engine.attitude import AttitudeEngine

    imu = _imu_only(flight)
    t = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
    estimate_attitude(t[:100], imu.gyro[:100], imu.accel[:100])
    singles = _singles(flight, 4000)

    def one_by_one() -> None:
        engine = AttitudeEngine(Parameters())
        for sample in singles:
            engine.feed(sample)

    one_by_one()
    batch = best_time(lambda: estimate_attitude(t, imu.gyro, imu.accel))
    return [
        Figure("attitude, batch", 1e6 * batch / len(imu), "us/update", 0.1),
        Figure("attitude engine, sample by sample", 1e6 * best_time(one_by_one) / len(singles), "us/update"),
        *_attitude_peers(imu),
    ]


def _attitude_peers(imu: ImuBlock) -> list[Figure]:
    figures = []
    gyro, accel = np.ascontiguousarray(imu.gyro), np.ascontiguousarray(imu.accel)
    if find_spec("vqf") is not None:
        from vqf import VQF

        def update() -> None:
            peer = VQF(1.0 / IMU_HZ)
            for i in range(4000):
                peer.update(gyro[i], accel[i])

        batch = best_time(lambda: VQF(1.0 / IMU_HZ).updateBatch(gyro, accel))
        figures += [
            Figure("  peer VQF (C++), batch", 1e6 * batch / len(imu), "us/update"),
            Figure("  peer VQF (C++), one call each", 1e6 * best_time(update) / 4000, "us/update"),
        ]
    if find_spec("imufusion") is not None:
        import imufusion

        degrees, force = np.degrees(gyro), accel / 9.81

        def fuse() -> None:
            peer = imufusion.Ahrs()
            for i in range(4000):
                peer.update_no_magnetometer(degrees[i], force[i])

        with suppress(AttributeError, TypeError):  # its interface differs between versions: no comparison then
            figures.append(Figure("  peer imufusion (C), one call each", 1e6 * best_time(fuse) / 4000, "us/update"))
    return figures


def _learner() -> list[Figure]:
    if find_spec("nav_pose_estimator.core.anfis") is None:
        return []
    from nav_pose_estimator import Anfis

    rng = np.random.default_rng(1)
    X = rng.normal(size=(3000, 10))
    Y = np.column_stack([np.sin(X[:, 0]) + 0.1 * X[:, 1], np.tanh(X[:, 2] - X[:, 3])])
    model = Anfis(rules=16)
    fitting = best_time(lambda: model.fit(X, Y), repeat=1)
    fitting = min(fitting, best_time(lambda: model.fit(X, Y), repeat=1))
    predict = best_time(lambda: [model.predict(X[i : i + 1]) for i in range(2000)]) / 2000
    return [
        Figure("ANFIS, 16 rules, 3000 samples, training", fitting, "s", 2.0),
        Figure("ANFIS, one prediction", 1e6 * predict, "us", 10.0),
    ]


def _bags(scratch: Path, flight: list[Sample]) -> list[Figure]:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    from nav_pose_estimator.offline.bag_reader import read_samples

    store = get_typestore(Stores.ROS2_JAZZY)
    singles = _singles(flight, int(SECONDS * IMU_HZ))
    figures = []
    for name, plugin in (("mcap", StoragePlugin.MCAP), ("sqlite3", StoragePlugin.SQLITE3)):
        with Writer(scratch / name, version=9, storage_plugin=plugin) as writer:
            connection = writer.add_connection("/imu/data_raw", "sensor_msgs/msg/Imu", typestore=store)
            for sample in singles:
                writer.write(connection, sample.stamp_ns, imu_bytes(sample))
        cost = best_time(lambda name=name: sum(len(s) for s in read_samples(scratch / name)))
        figures.append(Figure(f"bag reading, {name}", 1e6 * cost / len(singles), "us/message", 4.5))
        peer = best_time(lambda name=name: _read_with_rosbags(scratch / name, 20000), repeat=1)
        figures.append(Figure(f"  peer rosbags AnyReader, {name}", 1e6 * peer / 20000, "us/message"))
    return figures


def _read_with_rosbags(path: Path, count: int) -> None:
    from itertools import islice

    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        for connection, _, raw in islice(reader.messages(), count):
            reader.deserialize(raw, connection.msgtype)


def _replay(scratch: Path) -> list[Figure]:
    """Replay in a process of its own, as a user starts it; the second run finds the kernels compiled."""
    write_flight_bag(scratch / "flight", SECONDS)
    command = [sys.executable, "-m", "nav_pose_estimator", "replay", str(scratch / "flight")]
    command += ["--outage", "300:30", "--method", "coast", "--out", str(scratch / "out")]
    walls, summary = [], {}
    for _ in range(REPEAT):
        done = subprocess.run(command, capture_output=True, text=True, timeout=600)
        if done.returncode != 0:
            raise RuntimeError(f"replay in a process of its own said: {done.stderr.strip()[-300:]}")
        summary = json.loads((scratch / "out" / "summary.json").read_text(encoding="utf-8"))
        walls.append(summary["wall_seconds"])
    return [
        Figure("replay, process start to report", SECONDS / min(walls), "x real time", 240.0, "higher"),
        Figure("replay, estimator alone", summary["times_real_time"], "x real time"),
    ]


def write_flight_bag(path: Path, seconds: float, imu_hz: float = IMU_HZ, gnss_hz: float = 5.0) -> None:
    """``plain_flight`` as a rosbag2 (mcap)."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    from nav_pose_estimator.offline.plain_flight import samples

    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for sample in samples(seconds, imu_hz, gnss_hz):
            parts = _singles([sample], len(sample)) if isinstance(sample, ImuBlock) else [sample]
            for part in parts:
                topic, kind, raw = message_of(part, store)
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(connections[topic], part.stamp_ns, raw)


def _imports() -> list[Figure]:
    """Time and memory of a process that loads the navigator and warms it up; only where the system has /proc."""
    if not Path("/proc/self/status").exists():
        return []
    code = (
        "import time;a=time.perf_counter();from nav_pose_estimator.engine.pose_estimator import PoseEstimator;"
        "PoseEstimator().warm_up();b=time.perf_counter();"
        # not ru_maxrss: that remembers the process it was started from
        "print(b-a,next(int(x.split()[1])/1024 for x in open('/proc/self/status') if x.startswith('VmHWM')))"
    )
    runs = []
    for _ in range(REPEAT):
        done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=600)
        runs.append([float(text) for text in done.stdout.split()])
    seconds, memory = np.min(runs, axis=0).tolist()
    return [
        Figure("import and warm-up", seconds, "s", 1.5),
        Figure("memory after import", memory, "MB", 170.0),
    ]
