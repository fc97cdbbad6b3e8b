"""Benchmark ``archive``: scaling of the costs with the number of recordings, and the loss by a killed process.

Simulated flights are processed by ``train`` or ``benchmark outage``: increasing numbers in one process, then all of
them with several workers, then with a worker killed in between, then with the command itself killed and restarted.

Costs are CPU times, so that they are valid on a busy machine. The efficiency of P workers is

    E = C / (P (M + W))                                                                                           (1)

with the CPU times C of all jobs in one process, M of the main process with P workers, which may have to wait for it,
and W of the busiest worker. Start-up and imbalance reduce the efficiency; contention for memory and caches does not.
The loss has three parts of P (M + W): workers wait for the main process, (P - 1) M; they wait for the busiest one; and
there is additional work, above all start-up.

An efficiency by elapsed time is also given, which is only meaningful on an otherwise idle machine.
"""

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.kept import KeptResults
from nav_pose_estimator.offline.benchmarks.archive import cluster
from nav_pose_estimator.offline.benchmarks.archive.watched import Cost, Kill
from nav_pose_estimator.offline.benchmarks.archive.watched import run as run_watched

TRAIN, OUTAGE = "train", "outage"
_SCENARIO, _IMU_HZ = "multirotor_light", 50.0
_COMMANDS = {
    TRAIN: ["train", "--class", "multirotor", "--one-aircraft", "--gnss-delay", "0", "--force"],
    OUTAGE: [
        *("benchmark", "outage", "--methods", "best", "--gnss-delay", "0"),
        *("--lengths", "10", "--first", "60", "--every", "1000"),
    ],
}
_RESULTS = {TRAIN: "a.airframe", OUTAGE: "a/outages.csv"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``benchmark archive``."""
    add = parser.add_argument
    add("--what", choices=(TRAIN, OUTAGE), default=TRAIN, help="command to run (default: train)")
    add("--flights", default="8,16,32", metavar="N,...", help="numbers of flights, increasing (default: 8,16,32)")
    add("--seconds", type=float, default=120.0, metavar="S", help="length of each flight (default: 120)")
    add("--workers", type=int, default=2, metavar="N", help="processes at a time (default: 2)")
    add("--dask", action="store_true", help="workers of a Dask scheduler on this machine in place of a pool")
    add("--out", type=Path, default=Path("archive_benchmark"), metavar="DIR", help="folder for archive.json")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print every line as it is known, write archive.json."""
    from nav_pose_estimator.offline.json_file import versions, write_json
    from nav_pose_estimator.offline.output_folder import OutputFolder

    counts = _counts(arguments)
    with (
        OutputFolder(arguments.out, "archive benchmark") as folder,
        TemporaryDirectory(prefix="nav_pose_estimator_") as scratch,
        ExitStack() as stack,
    ):
        flights = _Flights(Path(scratch), arguments.what, counts[-1], arguments.seconds)
        figures = {"growth": _growth(flights, counts)}
        pool = _Workers(arguments.workers, stack if arguments.dask else None)
        expected = flights.result
        figures |= _several(flights, pool, figures["growth"][-1], expected)
        figures |= _disturbed(flights, pool, expected)
        content = {"what": arguments.what, "seconds": arguments.seconds, **figures, "versions": versions()}
        folder.mkdir()
        write_json(folder / "archive.json", content)
    print(f"figures: {arguments.out / 'archive.json'}")
    return 0


class _Flights:
    """``count`` simulated flights in a scratch folder, each in a wind of its own, and the command over them."""

    def __init__(self, folder: Path, what: str, count: int, seconds: float) -> None:
        from nav_pose_estimator.offline.simulated_bag import write_recording
        from nav_pose_estimator.sim.scenarios import generate

        self._folder, self._what, self.count = folder, what, count
        self._out = folder / Path(_RESULTS[what]).parts[0]
        self.kept = KeptResults(self._out).folder
        for seed in range(count):
            write_recording(folder / f"flight_{seed}", generate(_SCENARIO, seconds, seed, imu_rate=_IMU_HZ))

    def fly(self, count: int, more: Sequence[str] = (), **how) -> Cost:
        """Run the command on the first ``count`` flights; return its cost."""
        names = self._folder / "flights.txt"
        names.write_text("".join(f"flight_{seed}\n" for seed in range(count)), encoding="utf-8")
        return run_watched([*_COMMANDS[self._what], str(names), "--out", str(self._out), *more], self.kept, **how)

    @property
    def result(self) -> bytes:
        """Content of the last command's result file."""
        return (self._folder / _RESULTS[self._what]).read_bytes()


class _Workers:
    """Options that make a command work with several workers: of a pool, or of a Dask scheduler in ``stack``."""

    def __init__(self, count: int, stack: ExitStack | None) -> None:
        self.count, self._stack = count, stack

    def how(self) -> dict:
        """Arguments of ``_Flights.fly``; with a new cluster, because workers may have been killed."""
        options = ["--jobs", str(self.count)]
        if self._stack is None:
            return {"more": options}
        self._stack.close()
        address, pids = self._stack.enter_context(cluster.on_this_machine(self.count))
        return {"more": [*options, "--scheduler", address], "workers": pids}


def _growth(flights: _Flights, counts: Sequence[int]) -> list[dict]:
    print(f"{'flights':>8} {'CPU s':>8} {'s each':>8} {'one more':>9} {'memory MB':>10}   in one process", flush=True)
    rows: list[dict] = []
    for count in counts:
        cost = flights.fly(count)
        more = (cost.total - rows[-1]["cpu_s"]) / (count - rows[-1]["flights"]) if rows else None
        row = {"flights": count, "cpu_s": cost.total, "one_more_s": more, "memory_mb": cost.memory}
        rows.append({**row, "elapsed_s": cost.elapsed})
        one_more = "" if more is None else f"{more:.2f}"
        print(f"{count:8} {cost.total:8.1f} {cost.total / count:8.2f} {one_more:>9} {cost.memory:10.0f}", flush=True)
    return rows


def _several(flights: _Flights, pool: _Workers, alone: dict, expected: bytes) -> dict:
    cost = flights.fly(flights.count, **pool.how())
    same = flights.result == expected
    of_all = pool.count * cost.longest
    efficiency, by_the_clock = alone["cpu_s"] / of_all, alone["elapsed_s"] / (pool.count * cost.elapsed)
    lost = _lost(cost, alone["cpu_s"], pool.count)
    workers = " and ".join(f"{seconds:.1f}" for seconds in cost.workers.values())
    print(
        f"{pool.count} workers: CPU {cost.main:.1f} s in the main process, {workers} s in them, at most "
        f"{cost.workers_memory:.0f} MB each; efficiency {100.0 * efficiency:.0f} %, what lacks: "
        + ", ".join(f"{100.0 * seconds / of_all:.0f} % {why}" for why, seconds in lost.items())
        + f"; {_verdict(same)}"
    )
    print(
        f"elapsed: {alone['elapsed_s']:.0f} s in one process, {cost.elapsed:.0f} s with {pool.count} workers: "
        f"{100.0 * by_the_clock:.0f} % if nothing else ran meanwhile",
        flush=True,
    )
    figures = {"main_s": cost.main, "workers_s": list(cost.workers.values()), "elapsed_s": cost.elapsed, "lost_s": lost}
    return {**figures, "same_with_workers": same, "efficiency": efficiency, "efficiency_by_the_clock": by_the_clock}


def _lost(cost: Cost, alone: float, count: int) -> dict[str, float]:
    """Loss of efficiency by (1), as CPU time [s] by cause."""
    busy = sum(cost.workers.values())
    return {
        "waiting for the main process": (count - 1) * cost.main,
        "waiting for the busiest worker": count * max(cost.workers.values(), default=0.0) - busy,
        "work that one process does not have": cost.main + busy - alone,
    }


def _disturbed(flights: _Flights, pool: _Workers, expected: bytes) -> dict:
    cost = flights.fly(flights.count, kill=Kill(flights.count // 4), **pool.how())
    same = flights.result == expected
    print(f"a worker killed: {_verdict(same)}, CPU {cost.total:.1f} s in all", flush=True)
    flights.fly(flights.count, kill=Kill(flights.count // 2, command=True), **pool.how())
    done = len(list(flights.kept.glob("*")))
    again = flights.fly(flights.count, **pool.how())
    same_again = flights.result == expected
    print(
        f"the command killed with {done} of {flights.count} flights done, and started again: {_verdict(same_again)}, "
        f"CPU {again.total:.1f} s for the rest"
    )
    return {"same_without_a_worker": same, "done_when_killed": done, "same_when_resumed": same_again}


def _verdict(same: bool) -> str:
    return "the same result, byte for byte" if same else "ANOTHER RESULT"


def _counts(arguments: argparse.Namespace) -> list[int]:
    try:
        counts = sorted({int(text) for text in arguments.flights.split(",")})
    except ValueError:
        raise UserError(f"--flights {arguments.flights!r}: write numbers separated by commas, as in 8,16,32") from None
    if counts[0] < 4 or arguments.workers < 2 or not 110.0 <= arguments.seconds <= 3600.0:
        raise UserError("--flights must be at least 4, --workers at least 2, --seconds between 110 and 3600")
    if not Path("/proc/self/stat").exists():
        raise UserError("benchmark archive needs /proc for the costs of processes, which this system does not have")
    return counts
