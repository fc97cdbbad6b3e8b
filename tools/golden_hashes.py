"""Hashes of the estimators' results, to verify that a refactoring does not change them by a single bit.

    tools/in_environment.sh python tools/golden_hashes.py > before.txt      # then change something, and
    tools/in_environment.sh python tools/golden_hashes.py | diff before.txt -

The flights are the shipped bags, a simulated one with late fixes and a velocity sensor, and a recorded one if the
folder ``shared`` is beside the repository. For each flight there are hashes of the rows of the solution, the full
states, the attitudes, network outputs, events and counters. They are valid for one machine and one set of library
versions, and do not depend on the division of the rows into blocks.
"""

import hashlib
import itertools
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.filter.layout import OUT_COLUMNS
from nav_pose_estimator.core.numerics.rotation import quat_rotate_many
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import BodyVelocity, ImuBlock, ImuSample, Sample
from nav_pose_estimator.engine.solutions import (
    AttitudeBlock,
    AttitudeSolution,
    Event,
    Mode,
    NavBlock,
    NavSolution,
    Output,
    PredictedDrift,
)
from nav_pose_estimator.offline.bags.reader import BagReader
from nav_pose_estimator.offline.flights.outages import GnssRemoval, Outage
from nav_pose_estimator.sim.scenarios import generate

REPOSITORY = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("NAV_POSE_SHARED", REPOSITORY.parent / "shared"))


class Fingerprint:
    """One hash for each kind of output."""

    KINDS = ("stamps", "rows", "modes", "states", "attitudes", "network", "events", "counters")

    def __init__(self) -> None:
        self._hashes = {kind: hashlib.sha256() for kind in self.KINDS}

    def take(self, outputs: Iterable[Output]) -> None:
        """Add the outputs of one call."""
        for output in outputs:
            if isinstance(output, NavBlock):
                self._add_rows(output.stamps_ns, output.rows, output.correction_enu, output.mode)
            elif isinstance(output, NavSolution):
                row = output.values[None, :OUT_COLUMNS]
                self._add_rows(np.array([output.stamp_ns]), row, output.correction_enu, output.mode)
                self._add("states", output.values)
            elif isinstance(output, AttitudeBlock):
                self._add("attitudes", output.rows)
            elif isinstance(output, AttitudeSolution):
                self._add("attitudes", output.values)
            elif isinstance(output, PredictedDrift):
                self._add("network", output.dv_n, output.dp_n, output.cov)
            elif isinstance(output, Event):
                self._add("events", output.stamp_ns, output.name, output.text, sorted(output.data.items()))

    def finish(self, engine: PoseEstimator) -> str:
        """Counters, then the first digits of every hash."""
        self._add("counters", sorted(engine.status().counters.items()))
        return "  ".join(f"{kind} {digest.hexdigest()[:12]}" for kind, digest in self._hashes.items())

    def _add_rows(self, stamps_ns: np.ndarray, rows: np.ndarray, correction: np.ndarray, mode: Mode) -> None:
        self._add("stamps", stamps_ns)
        self._add("rows", np.hstack([rows, np.broadcast_to(correction, (len(rows), 3))]))
        self._add("modes", *[mode.value] * len(rows))

    def _add(self, kind: str, *values: object) -> None:
        for value in values:
            self._hashes[kind].update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())


def fly(samples: Iterable[Sample], outages: list[Outage]) -> str:
    """Run samples through the estimator without GNSS in ``outages``; return the fingerprint as text."""
    samples = list(samples)
    engine, fingerprint = PoseEstimator(Parameters()), Fingerprint()
    epoch_ns = min(int(s.stamps_ns[0]) for s in samples if isinstance(s, ImuBlock))
    removal = GnssRemoval(outages, epoch_ns, 0.0)
    waiting: list[Sample] = []
    count = itertools.count()
    for sample in removal.filter(samples):
        waiting += _last_alone(sample) if isinstance(sample, ImuBlock) and next(count) % 20 == 0 else [sample]
        if isinstance(sample, ImuBlock):
            fingerprint.take(engine.feed_all(waiting))
            waiting = []
    fingerprint.take(engine.feed_all(waiting))
    return fingerprint.finish(engine)


def _last_alone(block: ImuBlock) -> list[Sample]:
    """The block with its last sample separate, because single samples yield full states with biases and covariance."""
    last = ImuSample(int(block.stamps_ns[-1]), tuple(block.gyro[-1].tolist()), tuple(block.accel[-1].tolist()))
    return [block.part(0, len(block) - 1), last] if len(block) > 1 else [last]


def recorded(bag: Path, last: float = np.inf) -> list[Sample]:
    """The samples of a bag up to ``last`` [s] after the first IMU sample."""
    kept: list[Sample] = []
    end_ns = None
    with BagReader(bag) as reader:
        for sample in reader.samples():
            if isinstance(sample, ImuBlock):
                end_ns = int(sample.stamps_ns[0]) + last * 1e9 if end_ns is None else end_ns
                if sample.stamps_ns[0] > end_ns:
                    break
            kept.append(sample)
    return kept


def simulated() -> Iterator[Sample]:
    """A simulated flight with late fixes, and a velocity sensor in its first half."""
    recording = generate("late_gnss", 120.0, seed=7)
    truth, stamps = recording.truth, recording.imu_data.block.stamps_ns
    velocity_b = quat_rotate_many(truth.q_nb * np.array([1.0, -1.0, -1.0, -1.0]), truth.v_n)
    due = iter(range(0, len(stamps) // 2, round(0.2 / truth.dt)))
    at = next(due, None)
    for sample in recording.samples():
        yield sample
        while at is not None and isinstance(sample, ImuBlock) and stamps[at] <= sample.stamps_ns[-1]:
            yield BodyVelocity(int(stamps[at]), tuple(velocity_b[at].tolist()))
            at = next(due, None)


def main() -> int:
    """Print a line for each flight."""
    bags = REPOSITORY / "bags"
    print("multirotor_outage ", fly(recorded(bags / "multirotor_outage"), [Outage(90.0, 30.0), Outage(180.0, 60.0)]))
    print("fixed_wing        ", fly(recorded(bags / "fixed_wing"), [Outage(80.0, 30.0)]))
    print("road_vehicle      ", fly(recorded(bags / "road_vehicle"), [Outage(80.0, 30.0)]))
    print("hover_sqlite3     ", fly(recorded(bags / "hover_sqlite3"), []))
    print("simulated         ", fly(simulated(), [Outage(70.0, 30.0)]))
    flight = SHARED / "data" / "flights" / "quad106_bag"
    if flight.is_dir():
        print("quad106, 300 s    ", fly(recorded(flight, 300.0), [Outage(200.0, 60.0)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
