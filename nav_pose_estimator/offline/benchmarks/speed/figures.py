"""Figures of ``benchmark speed`` that are measured in this process."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, ImuSample, Sample, joined
from nav_pose_estimator.offline.benchmarks.speed.flight_messages import imu_bytes

SECONDS, IMU_HZ = 600.0, 200.0  # duration of the flight, and its IMU rate
BLOCK = 200  # IMU samples per block
SINGLES = 4000  # IMU samples that are fed one by one
REPEAT = 5  # repetitions, of which the fastest counts


@dataclass(frozen=True)
class Figure:
    """A measured value with its ``goal``, None without one. ``better``: lower or higher."""

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


def flight() -> list[Sample]:
    """The samples of a plain flight, GNSS once a second."""
    from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples

    return samples(SECONDS, IMU_HZ)


def full_flight() -> list[Sample]:
    """The samples of the flight with the full set of sensors, at stamps of the IMU."""
    from nav_pose_estimator.offline.benchmarks.speed.plain_flight import full_set

    return full_set(SECONDS, IMU_HZ)


def best_time(
    action: Callable[[], object], repeat: int = REPEAT, prepare: Callable[[], object] = lambda: None
) -> float:
    """Smallest CPU time [s] of ``repeat`` runs of ``action``, each after a ``prepare`` that does not count."""
    times = []
    for _ in range(repeat):
        prepare()
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return min(times)


def singles(flight: list[Sample], count: int) -> list[ImuSample]:
    """The first ``count`` IMU samples of a flight, one by one."""
    out: list[ImuSample] = []
    for block in flight:
        if isinstance(block, ImuBlock):
            rows = zip(block.stamps_ns.tolist(), block.gyro.tolist(), block.accel.tolist(), strict=True)
            out += [ImuSample(t, tuple(w), tuple(f)) for t, w, f in rows]
            if len(out) >= count:
                break
    return out[:count]


def blocks_of(imu: ImuBlock, size: int) -> list[ImuBlock]:
    """``imu`` divided into blocks of ``size`` samples."""
    starts = range(0, len(imu), size)
    return [imu.part(i, i + size) for i in starts]


def imu_only(flight: list[Sample]) -> ImuBlock:
    """All IMU samples as one block."""
    return joined([sample for sample in flight if isinstance(sample, ImuBlock)])


def aligned(flight: list[Sample], seconds: float):
    """A navigator after ``seconds`` of the flight, and the remaining samples."""
    from nav_pose_estimator.engine.navigator.sins import SinsEngine

    engine = SinsEngine(Parameters())
    engine.warm_up()
    first = next(s for s in flight if isinstance(s, ImuBlock)).stamps_ns[0]
    limit = first + round(seconds * 1e9)
    for i, sample in enumerate(flight):
        if (sample.stamps_ns[0] if isinstance(sample, ImuBlock) else sample.stamp_ns) >= limit:
            return engine, flight[i:]
        engine.feed(sample)
    return engine, []


def navigator(flight: list[Sample], full: list[Sample]) -> list[Figure]:
    """The strapdown navigator with its filter, on the plain flight and with the full set of sensors."""
    from nav_pose_estimator.ros.messages import from_bytes

    engine, rest = aligned(flight, 60.0)
    start = engine.snapshot()
    imu = imu_only(rest)
    one_by_one = singles(rest, SINGLES)
    messages = [imu_bytes(sample) for sample in one_by_one]
    with_gnss = _joined([s for s in rest if isinstance(s, (ImuBlock, GnssFix, GnssVelocity))])

    def cost(samples: list, count: int) -> float:
        return 1e6 * best_time(lambda: _feed(engine, samples), prepare=lambda: engine.restore(start)) / count

    def call_back() -> None:
        """Processing of serialized Imu messages as in a node, except rclpy itself."""
        for message in messages:
            for sample in from_bytes.imu(message):
                engine.feed(sample)

    callback = 1e6 * best_time(call_back, prepare=lambda: engine.restore(start)) / SINGLES
    return [
        Figure("navigator, IMU alone, blocks of 1 s", cost(blocks_of(imu, BLOCK), len(imu)), "us/epoch", 0.4),
        Figure("navigator, IMU and 1 Hz GNSS", cost(with_gnss, len(imu)), "us/epoch"),
        *_full_set(full),
        Figure("navigator, sample by sample", cost(one_by_one, SINGLES), "us/epoch", 2.5),
        Figure("IMU callback of sins_node without rclpy", callback, "us", 8.0),
    ]


def _full_set(full: list[Sample]) -> list[Figure]:
    """The navigator with all sensors, with samples as from a replay, and one by one."""
    engine, rest = aligned(full, 60.0)
    start, count = engine.snapshot(), len(imu_only(rest))

    def cost(action: Callable[[], object]) -> float:
        return 1e6 * best_time(action, repeat=3, prepare=lambda: engine.restore(start)) / count

    return [
        Figure("navigator, full set of sensors", cost(lambda: engine.feed_all(rest)), "us/epoch", 0.4),
        Figure("navigator, full set, a message a call", cost(lambda: _feed(engine, rest)), "us/epoch"),
    ]


def _feed(engine, samples: list) -> None:
    for sample in samples:
        engine.feed(sample)


def _joined(samples: list[Sample]) -> list[Sample]:
    """The samples with neighbouring IMU blocks joined."""
    out: list[Sample] = []
    for sample in samples:
        if isinstance(sample, ImuBlock) and out and isinstance(out[-1], ImuBlock):
            out[-1] = joined([out[-1], sample])
        else:
            out.append(sample)
    return out


def whole_estimator(flight: list[Sample], full: list[Sample]) -> list[Figure]:
    """Attitude filter, navigator and learner together, as in a replay on one core, with few sensors and with all."""
    from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
    from nav_pose_estimator.engine.outage.rehearsals import at_its_end

    figures = []
    for sensors, samples in (("plain flight", flight), ("full set", full)):
        for method, goal in (("coast", None), ("best", 9.0)):
            parameters = update(Parameters(), {"learner.method": method})
            PoseEstimator(parameters).warm_up()
            cost = best_time(partial(_fly, partial(PoseEstimator, rehearse=at_its_end), parameters, samples), repeat=2)
            what = f"pose estimator, {sensors}, {method}"
            figures.append(
                Figure(what, 1e6 * cost / len(imu_only(samples)), "us/epoch", goal if samples is full else None)
            )
    return figures


def _fly(make_engine: Callable, parameters: Parameters, samples: list[Sample]) -> None:
    make_engine(parameters).feed_all(samples)


def attitude(flight: list[Sample]) -> list[Figure]:
    """The attitude filter, in a batch and with single updates, compared with peers."""
    from nav_pose_estimator import estimate_attitude
    from nav_pose_estimator.core.attitude import complementary
    from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
    from nav_pose_estimator.engine.attitude.filters import complementary_state

    imu = imu_only(flight)
    t = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
    one_by_one = singles(flight, SINGLES)
    state = complementary_state(Parameters())
    engine = AttitudeEngine(Parameters())
    engine.warm_up()

    def update_each() -> None:
        for sample in one_by_one:
            complementary.step(state, 1.0 / IMU_HZ, *sample.gyro, *sample.accel)

    update_each()
    batch = 1e6 * best_time(lambda: estimate_attitude(t, imu.gyro, imu.accel)) / len(imu)
    each = 1e6 * best_time(update_each) / SINGLES
    fed = best_time(lambda: _feed(engine, one_by_one), prepare=lambda: engine.reset(0, "again"))
    return [
        Figure("attitude, batch", batch, "us/update", 0.1),
        Figure("attitude, one update a call", each, "us/update", 1.2),
        Figure("attitude engine, sample by sample", 1e6 * fed / SINGLES, "us/update"),
        *_attitude_peers(imu, batch, each),
    ]


def _attitude_peers(imu: ImuBlock, own_batch: float, own_each: float) -> list[Figure]:
    figures = []
    gyro, accel = np.ascontiguousarray(imu.gyro), np.ascontiguousarray(imu.accel)
    if find_spec("vqf") is not None:
        from vqf import VQF

        def update_each() -> None:
            peer = VQF(1.0 / IMU_HZ)
            for i in range(SINGLES):
                peer.update(gyro[i], accel[i])

        batch = 1e6 * best_time(lambda: VQF(1.0 / IMU_HZ).updateBatch(gyro, accel)) / len(imu)
        each = 1e6 * best_time(update_each) / SINGLES
        figures += [
            Figure("  peer VQF (C++), batch", batch, "us/update"),
            Figure("  peer VQF (C++), one update a call", each, "us/update"),
            Figure("  attitude over VQF, batch", own_batch / batch, "", 1.0),
            Figure("  attitude over VQF, one update a call", own_each / each, "", 1.0),
        ]
    if find_spec("imufusion") is not None:
        import imufusion

        degrees, force = np.degrees(gyro), accel / 9.81

        def fuse() -> None:
            peer = imufusion.Ahrs()
            for i in range(SINGLES):
                peer.update_no_magnetometer(degrees[i], force[i])

        with suppress(AttributeError, TypeError):  # its interface differs between versions: no comparison then
            figures.append(
                Figure("  peer imufusion (C), one update a call", 1e6 * best_time(fuse) / SINGLES, "us/update")
            )
    return figures


def learner() -> list[Figure]:
    """The neuro-fuzzy network: training and one prediction."""
    from nav_pose_estimator import Anfis

    rng = np.random.default_rng(1)
    X = rng.normal(size=(3000, 10))
    Y = np.column_stack([np.sin(X[:, 0]) + 0.1 * X[:, 1], np.tanh(X[:, 2] - X[:, 3])])
    model = Anfis(rules=16)
    model.fit(X[:300], Y[:300])
    fitting = best_time(lambda: model.fit(X, Y), repeat=1)
    predict = best_time(lambda: [model.predict(X[i : i + 1]) for i in range(2000)]) / 2000
    return [
        Figure("ANFIS, 16 rules, 3000 samples, training", fitting, "s", 1.2),
        Figure("ANFIS, one prediction", 1e6 * predict, "us", 10.0),
    ]


def pretrained() -> list[Figure]:
    """The network of ``cnn_lstm``, once per half second of flight: its window and its prediction."""
    from nav_pose_estimator.core.filter.layout import OUT_COLUMNS, OUT_QUAT, OUT_T
    from nav_pose_estimator.core.learning.conv_lstm import untrained
    from nav_pose_estimator.core.motion.airframe import VELOCITY, air_velocity
    from nav_pose_estimator.core.motion.windows import CHANNELS, window

    rows = np.random.default_rng(2).normal(size=(round(IMU_HZ), OUT_COLUMNS))
    rows[:, OUT_T] = np.arange(len(rows)) / IMU_HZ
    rows[:, OUT_QUAT : OUT_QUAT + 4] = (1.0, 0.0, 0.0, 0.0)
    scales = {"input_mean": np.zeros(CHANNELS), "input_scale": np.ones(CHANNELS)}
    weights = untrained(scales | {"output_mean": np.zeros(6), "output_scale": np.ones(6)}, 0)
    seen = window(rows)
    asked = best_time(lambda: [air_velocity(weights, VELOCITY, seen) for _ in range(500)]) / 500
    made = best_time(lambda: [window(rows) for _ in range(500)]) / 500
    return [
        Figure("network of cnn_lstm, one prediction", 1e3 * asked, "ms", 0.2),
        Figure("  its window of a second at 200 Hz", 1e3 * made, "ms"),
    ]
