# ruff: noqa: E402
"""GNSS outages in simulated flight and on a simulated road: drift of each method compared with coasting.

    python benchmarks/outage_simulation.py --flights 12 --first-seed 501 --out out/outage_simulation

Multirotors fly between waypoints at up to 8 m/s, stop and yaw, with three IMU grades, four winds and three outages per
flight. Cars have outages of 30 s. The seeds are the outer loop, so that a run that ends early (--minutes) has the same
number of flights in every cell or one more; the next run with the same --out continues it. The tables of
docs/outage_simulation.md are the output of this program.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
import csv
import multiprocessing
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.offline.benchmarks.outage.output import rows_of
from nav_pose_estimator.offline.benchmarks.outage.statistics import Row, bootstrap, comparable, rms
from nav_pose_estimator.offline.benchmarks.outage.trials import FlightResult, run_outages
from nav_pose_estimator.offline.benchmarks.tables import markdown
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.outages import periodic
from nav_pose_estimator.offline.flights.simulated_flight import in_memory
from nav_pose_estimator.sim.scenarios import generate

GRADES = ("icm42688", "bmi088", "mpu6000")
WINDS = {
    "calm": "multirotor_calm",
    "light": "multirotor_light",
    "moderate": "multirotor_moderate",
    "walk": "multirotor_wind_walk",
}
ROAD, ROAD_GRADE = "road_vehicle", "icm42688"
BASE = "coast15"
WAYS: dict[str, tuple[str, dict[str, Any]]] = {
    BASE: (methods.COAST, {"navigator.gyro_matrix_states": False}),
    "coast": (methods.COAST, {}),
    "best": (methods.BEST, {}),
    "anfis": ("anfis", {}),
    "drag": ("drag", {}),
}
"""Method of ``benchmark outage`` and further parameters, by name in the tables."""
LENGTHS = (30.0, 60.0)  # s
FIRST, EVERY, OUTAGES = 300.0, 65.0, 3  # s: the network learns from up to 300 s of flight
DURATION = FIRST + (OUTAGES - 1) * EVERY + max(LENGTHS) + 2.0  # s
GOALS = {
    ("calm", 60.0): 0.20,
    ("light", 60.0): 0.26,
    ("moderate", 60.0): 0.70,
    ("walk", 60.0): 0.70,
    **{(wind, 30.0): 1.05 for wind in WINDS},
}
"""Largest ratio of the RMS end error to that of coasting with 15 states."""
ROAD_GOAL = 2.30  # m, median over the outages of the horizontal RMSE in 30 s: CN113777645A's road test
CSV = "outages.csv"


@dataclass(frozen=True)
class Flight:
    """One vehicle, IMU and seed; ``wind`` is a key of WINDS or ROAD."""

    grade: str
    wind: str
    seed: int

    @property
    def name(self) -> str:
        return f"{self.grade}-{self.wind}-{self.seed}"


def fly(flight: Flight) -> list[Row]:
    """Run all methods through the outages of one flight."""
    made = in_memory(generate(WINDS.get(flight.wind, flight.wind), DURATION, flight.seed, flight.grade))
    planned = {length: periodic(EVERY, length, FIRST, FIRST + (OUTAGES - 1) * EVERY + length) for length in LENGTHS}
    result = FlightResult(flight.name, 0.0, (0.0, DURATION))
    for way, (method, overrides) in WAYS.items():
        run_outages(made, update(methods.apply(Parameters(), method), overrides), planned, (way,), result)
    return rows_of([result])


def plan(arguments: argparse.Namespace) -> list[Flight]:
    """All flights, the seeds as the outer loop."""
    return [
        flight
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.flights)
        for flight in [
            *(Flight(grade, wind, seed) for wind in arguments.winds for grade in arguments.grades),
            *[Flight(ROAD_GRADE, ROAD, seed)] * arguments.road,
        ]
    ]


def run(waiting: list[Flight], jobs: int, minutes: float) -> Iterator[list[Row]]:
    """Yield the rows of each flight as it completes; no flight begins after ``minutes`` of elapsed time."""
    until = time.monotonic() + 60.0 * minutes
    todo = iter(waiting)
    if jobs == 1:
        for flight in todo:
            if time.monotonic() > until:
                return
            yield fly(flight)
        return
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        running: set[Future] = {pool.submit(fly, flight) for flight in [*_next(todo, jobs)]}
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
            if time.monotonic() < until:
                running |= {pool.submit(fly, flight) for flight in _next(todo, len(done))}


def _next(todo: Iterator[Flight], count: int) -> list[Flight]:
    return [flight for _, flight in zip(range(count), todo, strict=False)]


def read(path: Path) -> list[Row]:
    """Rows of an earlier run; none without one."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [Row(**{name: _value(name, text) for name, text in line.items()}) for line in csv.DictReader(file)]


def _value(column: str, text: str) -> Any:
    return text if column in ("bag", "method", "status", "why") else float(text)


def append(path: Path, rows: list[Row]) -> None:
    """Append rows to the file, with a header if it is new."""
    is_new = not path.is_file()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow([item.name for item in fields(Row)])
        for row in rows:
            values = (getattr(row, item.name) for item in fields(Row))
            writer.writerow([f"{value:.4f}" if isinstance(value, float) else value for value in values])


# --- tables --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Cell:
    """The same outages with all methods: end error, sigma, RMSE [m] (outages, methods), and seeds (outages,)."""

    errors: np.ndarray
    sigma: np.ndarray
    rmse: np.ndarray
    seed: np.ndarray

    @property
    def flights(self) -> int:
        return len(np.unique(self.seed))

    @classmethod
    def of(cls, rows: list[Row], grade: str, wind: str, length: float) -> "Cell":
        chosen = [row for row in rows if row.bag.startswith(f"{grade}-{wind}-") and row.length_s == length]
        keys = sorted({(int(row.bag.rsplit("-", 1)[1]), row.start_s) for row in chosen})
        found = {(int(row.bag.rsplit("-", 1)[1]), row.start_s, row.method): row for row in chosen}

        def values(column: str) -> np.ndarray:
            rows_by_way = [[getattr(found[*key, way], column) for way in WAYS] for key in keys]
            return np.array(rows_by_way).reshape(-1, len(WAYS))

        seeds = np.array([key[0] for key in keys], int)
        return cls(values("end_error_m"), values("end_sigma_m"), values("rms_error_m"), seeds)


def ratio(errors: np.ndarray) -> float:
    """RMS of column 0 over RMS of column 1."""
    return rms(errors[:, 0]) / rms(errors[:, 1])


def mean_ratio(errors: np.ndarray) -> float:
    """Geometric mean of the ratios of columns (method, base, method, base, ...)."""
    return float(np.exp(np.mean([np.log(ratio(errors[:, i : i + 2])) for i in range(0, errors.shape[1], 2)])))


def table(header: Sequence[str], lines: list[list[str]]) -> str:
    """Markdown; nothing without lines."""
    return markdown(header, lines) if lines else ""


def cell_table(rows: list[Row], length: float, grades: Sequence[str], winds: Sequence[str]) -> str:
    """RMS, ratio to coasting with 15 states, and calibration of every method in every cell."""
    lines = []
    for wind in winds:
        for grade in grades:
            cell = Cell.of(rows, grade, wind, length)
            if not len(cell.seed):
                continue
            lines.append([f"{grade}, {wind}", str(cell.flights), *(_method(cell, i) for i in range(len(WAYS)))])
    return table(["IMU, wind", "flights", *WAYS], lines)


def _method(cell: Cell, i: int) -> str:
    errors, sigma = cell.errors[:, i], cell.sigma[:, i]
    within = f"{100.0 * np.mean(errors <= 3.0 * sigma):.0f} %, {np.median(errors / sigma):.2f}"
    if i == 0:
        return f"{rms(errors):.1f} ({within})"
    return f"{rms(errors):.1f} = {_with_interval(cell.errors[:, [i, 0]], cell.seed, ratio)} ({within})"


def _with_interval(errors: np.ndarray, seed: np.ndarray, statistic) -> str:
    """The statistic with its confidence interval, which needs more than one flight."""
    low, high = bootstrap(errors, seed, statistic, seed=1)
    return f"{statistic(errors):.2f}" + (f" [{low:.2f}, {high:.2f}]" if np.isfinite(low) else "")


def wind_table(rows: list[Row], length: float, grades: Sequence[str], winds: Sequence[str]) -> str:
    """The goals: geometric mean of the grades' ratios, flights of one seed drawn together, and the worst grade."""
    lines = []
    for wind in winds:
        cells = [Cell.of(rows, grade, wind, length) for grade in grades]
        seeds = set.intersection(*(set(cell.seed) for cell in cells))
        if not seeds:
            continue
        kept = [np.isin(cell.seed, list(seeds)) for cell in cells]
        if len({int(keep.sum()) for keep in kept}) > 1:
            continue  # a method has no result for an outage, so that only the cells can be compared
        seed = cells[0].seed[kept[0]]
        goal = GOALS[wind, length]
        for i, way in list(enumerate(WAYS))[1:]:
            pairs = np.hstack([cell.errors[keep][:, [i, 0]] for cell, keep in zip(cells, kept, strict=True)])
            each = [ratio(pairs[:, j : j + 2]) for j in range(0, pairs.shape[1], 2)]
            verdict = "met" if max(each) <= goal else f"{sum(r <= goal for r in each)} of {len(each)}"
            mean = _with_interval(pairs, seed, mean_ratio)
            lines.append([wind, way, mean, f"{max(each):.2f}", f"{goal:.2f}", verdict if way == methods.BEST else ""])
    return table(["wind", "method", "mean ratio", "worst IMU", "goal", "IMUs that meet it"], lines)


def road_table(rows: list[Row]) -> str:
    """The figure of the patent's road test, and the end error."""
    lines = []
    for length in LENGTHS:
        cell = Cell.of(rows, ROAD_GRADE, ROAD, length)
        if not len(cell.seed):
            continue
        for i, way in enumerate(WAYS):
            within = f"{100.0 * np.mean(cell.errors[:, i] <= 3.0 * cell.sigma[:, i]):.0f} %"
            size = _with_interval(cell.rmse[:, i], cell.seed, np.median)
            ends = f"{np.median(cell.errors[:, i]):.2f}", f"{rms(cell.errors[:, i]):.2f}"
            lines.append([f"{length:g} s", str(len(cell.seed)), way, size, *ends, within])
    return table(
        ["outage", "outages", "method", "median RMSE, m", "median end, m", "RMS end, m", "within 3 sigma"], lines
    )


def report(rows: list[Row], grades: Sequence[str], winds: Sequence[str]) -> str:
    """All tables with data."""
    lost = len({(row.bag, row.start_s, row.length_s) for row in rows if row.status != "ok"})
    rows = comparable(rows)
    parts = [f"{lost} outages were left out for all methods because one had no estimate."] if lost else []
    for length in LENGTHS:
        title = f"Multirotor, {length:g} s: RMS end error [m] = ratio to {BASE} [95 % interval]"
        parts += _part(f"{title} (within 3 sigma, median of error / sigma)", cell_table(rows, length, grades, winds))
        title = f"Multirotor, {length:g} s: ratio to {BASE}, geometric mean over the IMUs"
        parts += _part(title, wind_table(rows, length, grades, winds))
    title = f"Road vehicle, {ROAD_GRADE}; goal: median RMSE below {ROAD_GOAL:.2f} m in 30 s, the source text's figure"
    return "\n\n".join(parts + _part(title, road_table(rows)))


def _part(title: str, content: str) -> list[str]:
    return [title, content] if content else []


def names(text: str, known: Sequence[str], option: str) -> list[str]:
    """``text`` split at commas; ends the program with a sentence for an unknown name."""
    chosen = [name for name in text.split(",") if name]
    for name in chosen:
        if name not in known:
            sys.exit(f"{option}: there is no {name!r}; choose from {', '.join(known)}")
    return chosen


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--flights", type=int, default=12, help="flights a cell (default: 12)")
    add("--first-seed", type=int, default=501, help="their seeds are this one and the following (default: 501)")
    add("--grades", default=",".join(GRADES), help="IMUs of the multirotor")
    add("--winds", default=",".join(WINDS), help="winds of the multirotor; empty for the road alone")
    add("--no-road", dest="road", action="store_false", help="without the road vehicle")
    add("--jobs", type=int, default=1, help="processes")
    add("--minutes", type=float, default=600.0, help="begin no flight after so many minutes")
    add("--out", type=Path, default=Path("out/outage_simulation"), help=f"folder for {CSV} and tables.md")
    arguments = parser.parse_args()
    arguments.grades = names(arguments.grades, GRADES, "--grades")
    arguments.winds = names(arguments.winds, list(WINDS), "--winds")
    return arguments


def main() -> int:
    """Run the missing flights, then print and write the tables of all flights in the folder."""
    arguments = options()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / CSV
    rows = read(path)
    planned = plan(arguments)
    waiting = [flight for flight in planned if flight.name not in {row.bag for row in rows}]
    for done, flown in enumerate(run(waiting, arguments.jobs, arguments.minutes), 1):
        append(path, flown)
        rows += flown
        used = f"{time.process_time():.0f} s of CPU" if arguments.jobs == 1 else ""
        print(f"{done} of {len(waiting)} flights {used}", file=sys.stderr, flush=True)
    wanted = {flight.name for flight in planned}
    text = report([row for row in rows if row.bag in wanted], arguments.grades, arguments.winds)
    (arguments.out / "tables.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
