"""Endurance: an hour of flight with a failure every minute; errors, recovery and memory of the estimator.

    tools/in_environment.sh python benchmarks/endurance.py --duration 3600 --seeds 1,2 --out out/endurance

Writes out/endurance/endurance.csv, one row for each failure, and prints the table of docs/endurance.md.
"""

import argparse
import csv
import resource
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.engine.solutions import AttitudeBlock, Mode, NavBlock
from nav_pose_estimator.sim.fault_plans import Planned, random_plan
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate

GOOD = 10.0  # m: horizontal error of a navigator that has recovered
_BLOCK = 200  # largest number of IMU samples that are fed at once


@dataclass(frozen=True)
class Outcome:
    """Effects of one failure until the next one."""

    sensor: str
    kind: str
    start_s: float
    length_s: float
    worst_error_m: float  # while there was a solution
    seconds_without_solution: float
    recovered: bool  # AIDED and within GOOD at the end


@dataclass(frozen=True)
class Endurance:
    """One run."""

    outcomes: list[Outcome]
    not_finite: int  # numbers in all outputs
    honest: float  # fraction of the time in which the error is within 3 sigma
    megabytes: list[float]  # resident memory, once a minute of flight
    cpu_s: float


def run(duration: float, seed: int, scenario: str = "multirotor_light", imu_rate: float = 100.0) -> Endurance:
    """Fly ``duration`` [s] with the failures of ``seed``; exceptions are not caught."""
    plan = random_plan(seed, duration)
    recording = generate(scenario, duration, seed, imu_rate=imu_rate).with_faults(*(item.fault for item in plan))
    estimator = PoseEstimator()
    estimator.warm_up()
    ledger = _Ledger(len(recording.imu))
    not_finite, megabytes, began, minute = 0, [], time.process_time(), 0
    for sample in _pieces(recording):
        for output in estimator.feed(sample):
            if isinstance(output, NavBlock):
                not_finite += int((~np.isfinite(output.rows)).sum())
                ledger.enter(output)
            elif isinstance(output, AttitudeBlock):
                not_finite += int((~np.isfinite(output.q_nb)).sum())
        now = (sample.stamps_ns[-1] if isinstance(sample, ImuBlock) else 0) - recording.start_ns
        if now > minute * 60_000_000_000:
            minute += 1
            estimator.status()
            megabytes.append(_resident())
    return _judged(recording, plan, ledger, not_finite, megabytes, time.process_time() - began)


class _Ledger:
    """Stamp, position, variance and mode of every solution, in memory that is allocated at the start."""

    def __init__(self, rows: int) -> None:
        self.stamps = np.full(rows, 1, np.int64)
        self.numbers = np.full((rows, 5), 1.0)
        self.used = 0

    def enter(self, block: NavBlock) -> None:
        """One block of solutions."""
        rows = slice(self.used, self.used + len(block.stamps_ns))
        self.stamps[rows] = block.stamps_ns
        self.numbers[rows, :3] = block.rows[:, at.OUT_POS : at.OUT_VEL]
        self.numbers[rows, 3] = block.rows[:, at.OUT_VAR + at.DPOS : at.OUT_VAR + at.DPOS + 2].sum(axis=1)
        self.numbers[rows, 4] = block.mode is Mode.AIDED
        self.used = rows.stop


def _pieces(recording: Recording) -> Iterator:
    for sample in recording.samples():
        if not isinstance(sample, ImuBlock):
            yield sample
            continue
        for i in range(0, len(sample), _BLOCK):
            yield sample.part(i, i + _BLOCK)


def _judged(
    recording: Recording, plan: list[Planned], ledger: _Ledger, not_finite: int, megabytes: list[float], cpu: float
) -> Endurance:
    stamps, numbers = ledger.stamps[: ledger.used], ledger.numbers[: ledger.used]
    places, var, aided = numbers[:, :3], numbers[:, 3], numbers[:, 4] == 1.0
    t, truth = (stamps - recording.start_ns) * 1e-9, recording.truth
    within = (t >= 0.0) & (t <= truth.t[-1])  # there is no truth for solutions under a wrong clock
    t, places, var, aided = t[within], places[within], var[within], aided[within]
    off = np.hypot(*recording.error_enu(t, places)[:, :2].T)
    outcomes, period = [], truth.dt
    ends = [item.fault.start for item in plan[1:]] + [float(truth.t[-1])]
    for item, end in zip(plan, ends, strict=True):
        rows = np.flatnonzero((t >= item.fault.start) & (t < end))
        last = rows[t[rows] >= end - 1.0]
        missing = max(end - item.fault.start - len(rows) * period, 0.0)
        worst = float(off[rows].max()) if len(rows) else float("nan")
        good = len(last) > 0 and bool(aided[last].all() and off[last].max() < GOOD)
        outcomes.append(Outcome(item.sensor, item.kind, item.fault.start, item.fault.length, worst, missing, good))
    honest = float(np.mean(off < 3.0 * np.sqrt(var)))
    return Endurance(outcomes, not_finite, honest, megabytes, cpu)


def _resident() -> float:
    """Memory of this process [MB]; its peak where the system does not give the present value."""
    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def table(runs: list[Endurance]) -> str:
    """Markdown: one row for each sensor and kind."""
    cells = defaultdict(list)
    for one in runs:
        for outcome in one.outcomes:
            cells[outcome.sensor, outcome.kind].append(outcome)
    lines = [
        "| sensor | failure | injected | recovered | worst error, m | longest without solution, s |",
        "|---" * 6 + "|",
    ]
    for (sensor, kind), outcomes in sorted(cells.items()):
        worst = max(o.worst_error_m for o in outcomes)
        missing = max(o.seconds_without_solution for o in outcomes)
        recovered = sum(o.recovered for o in outcomes)
        lines.append(f"| {sensor} | {kind} | {len(outcomes)} | {recovered} | {worst:.1f} | {missing:.1f} |")
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=3600.0, help="seconds of flight")
    parser.add_argument("--seeds", default="1", help="comma-separated")
    parser.add_argument("--scenario", default="multirotor_light")
    parser.add_argument("--out", type=Path, default=Path("out/endurance"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    runs = []
    with (options.out / "endurance.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        for seed in map(int, options.seeds.split(",")):
            one = run(options.duration, seed, options.scenario)
            runs.append(one)
            if seed == int(options.seeds.split(",")[0]):
                writer.writerow(["seed", *asdict(one.outcomes[0])])
            writer.writerows([seed, *asdict(outcome).values()] for outcome in one.outcomes)
            print(
                f"seed {seed}: {len(one.outcomes)} failures, {sum(o.recovered for o in one.outcomes)} recovered, "
                f"{one.not_finite} numbers not finite, {one.honest:.1%} within 3 sigma, "
                f"memory {one.megabytes[len(one.megabytes) // 6]:.0f} -> {one.megabytes[-1]:.0f} MB, "
                f"{one.cpu_s:.0f} s of CPU for {options.duration:.0f} s",
                flush=True,
            )
    print(table(runs))


if __name__ == "__main__":
    main()
