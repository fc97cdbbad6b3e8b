"""Figures of ``benchmark speed`` that need bags or separate processes."""

import json
import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np

import nav_pose_estimator
from nav_pose_estimator.engine.samples import Sample
from nav_pose_estimator.offline.bags.writer import MCAP, SQLITE3
from nav_pose_estimator.offline.benchmarks.speed.figures import (
    BLOCK,
    IMU_HZ,
    SECONDS,
    Figure,
    best_time,
    blocks_of,
    imu_only,
)
from nav_pose_estimator.offline.benchmarks.speed.flight_messages import write_samples

_LIMIT = 900.0  # s: time limit of a process
_TRIES = 3  # repetitions, of which the fastest counts
_LONG = 3600.0  # s: long flight
REPLAYED = {SECONDS: (_TRIES, (300.0, 400.0)), _LONG: (1, (600.0, 900.0))}
"""By duration of the flight [s]: number of replays, and goals of ``best`` and ``coast`` as multiples of real time."""
_PEAK = "next(int(x.split()[1])/1024 for x in open('/proc/self/status') if x.startswith('VmHWM'))"
"""Peak memory of a process [MB]; ru_maxrss is not used, because it includes the process that started it."""
_PLAIN_SECONDS = 20.0  # s of flight that the navigator is timed over without numba


def bags(scratch: Path, flight: list[Sample]) -> list[Figure]:
    """Reading the Imu messages of a bag."""
    imu = imu_only(flight)
    figures = []
    for name in (MCAP, SQLITE3):
        write_samples(scratch / name, blocks_of(imu, BLOCK), name)
        cost = best_time(partial(_read, scratch / name))
        figures.append(Figure(f"bag reading, {name}", 1e6 * cost / len(imu), "us/message", 4.5))
        peer = best_time(partial(_read_with_rosbags, scratch / name, 20000), repeat=1)
        figures.append(Figure(f"  peer rosbags AnyReader, {name}", 1e6 * peer / 20000, "us/message"))
    return figures


def _read(path: Path) -> None:
    from nav_pose_estimator.offline.bags.reader import read_samples

    for _ in read_samples(path):
        pass


def _read_with_rosbags(path: Path, count: int) -> None:
    from itertools import islice

    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        for connection, _, raw in islice(reader.messages(), count):
            reader.deserialize(raw, connection.msgtype)


def replays(scratch: Path, seconds: float) -> list[Figure]:
    """Replay in a separate process, as started by a user, of a flight with the full set of sensors.

    The kernels are compiled from the second run on. With two cores, trainings and rehearsals use the second one.
    """
    figures = []
    tries, goals = REPLAYED[seconds]
    for method, goal in zip(("best", "coast"), goals, strict=True):
        runs = [_replay(scratch, seconds, method) for _ in range(tries)]
        summary = json.loads((scratch / "out" / "summary.json").read_text(encoding="utf-8"))
        wall, used, memory = np.min(runs, axis=0).tolist()
        name, unit = f"replay of {seconds:.0f} s, {method}", "x real time"
        figures += [
            Figure(f"{name}, process start to report", seconds / wall, unit, goal, "higher"),
            Figure("  CPU time of all its processes", seconds / used, unit),
            Figure("  estimator alone", summary["times_real_time"], unit),
            Figure("  memory", memory, "MB", 250.0),
        ]
    return figures


def lengths(scratch: Path, longest: float) -> list[Figure]:
    """How time and memory of a replay grow with the length of the flight, from one minute to two hours."""
    used, memory = {}, {}
    for seconds in (60.0, SECONDS, _LONG, 2.0 * _LONG):
        if seconds <= longest:
            _, used[seconds], memory[seconds] = _replay(scratch, seconds, "coast")
    figures = [
        Figure(f"replay of {seconds:.0f} s, coast, memory", most, "MB", 250.0) for seconds, most in memory.items()
    ]
    if SECONDS in used:
        short = (used[SECONDS] - used[60.0]) / (SECONDS - 60.0)
        figures.append(Figure("replay, coast, a further hour: in ten minutes", 3600.0 * short, "s CPU"))
    if 2.0 * _LONG in used:
        long = (used[2.0 * _LONG] - used[_LONG]) / _LONG
        figures += [
            Figure("  after one hour", 3600.0 * long, "s CPU"),
            Figure("  ratio", long / short, "", 1.1),
        ]
    return figures


def _replay(scratch: Path, seconds: float, method: str) -> tuple[float, float, float]:
    """``_measured`` of one replay; its bag is created if it does not exist."""
    bag = _full_bag(scratch, seconds)
    start = min(300.0, 0.5 * seconds)
    options = ["--outage", f"{start:.0f}:{min(30.0, 0.25 * seconds):.0f}", "--method", method]
    return _measured(["replay", str(bag), *options, "--out", str(scratch / "out")])


def _full_bag(scratch: Path, seconds: float) -> Path:
    from nav_pose_estimator.offline.benchmarks.speed.plain_flight import full_set

    bag = scratch / f"flight_{seconds:.0f}"
    if not bag.exists():
        write_samples(bag, full_set(seconds, IMU_HZ))
    return bag


def outage_benchmark(scratch: Path) -> list[Figure]:
    """``benchmark outage`` on the flight of ``replays``: seven outages, two methods, the latency given."""
    options = ["benchmark", "outage", str(_full_bag(scratch, SECONDS)), "--first", "100", "--every", "60"]
    options += ["--lengths", "10,30,60", "--methods", "best,coast", "--gnss-delay", "0"]
    _, used, _ = _measured([*options, "--out", str(scratch / "outages")])
    return [Figure("benchmark outage, 7 outages, 2 methods, CPU", used, "s", 5.0)]


def _measured(options: list[str]) -> tuple[float, float, float]:
    """Wall time [s], CPU time of a command and its children [s], and the largest memory of one of them [MB]."""
    code = (
        "import os,sys;from nav_pose_estimator.offline.command_line import main\n"
        "from nav_pose_estimator.offline.process_clock import seconds_since_start\n"
        "code=main(sys.argv[1:]);a=os.times()\n"
        f"print(seconds_since_start(),sum(a[:4]),{_PEAK});sys.exit(code)"
    )
    wall, used, memory = map(float, _run([sys.executable, "-c", code, *options]).split()[-3:])
    return wall, used, memory


def without_numba() -> list[Figure]:
    """The navigator without numba, in blocks of 1 s."""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    code = "from nav_pose_estimator.offline.benchmarks.speed import processes as p; print(p.plain_python_cost())"
    cost = float(_run([sys.executable, "-c", code], environment).split()[-1])
    return [Figure("navigator without numba, blocks of 1 s", cost, "us/epoch", 60.0)]


def plain_python_cost() -> float:
    """CPU time [us] per IMU epoch in this process."""
    from nav_pose_estimator.offline.benchmarks.speed import figures as speed_figures
    from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples

    engine, rest = speed_figures.aligned(samples(30.0 + _PLAIN_SECONDS, IMU_HZ), 30.0)
    start, imu = engine.snapshot(), speed_figures.imu_only(rest)
    blocks = speed_figures.blocks_of(imu, speed_figures.BLOCK)

    def fly() -> None:
        for block in blocks:
            engine.feed(block)

    return 1e6 * best_time(fly, prepare=lambda: engine.restore(start)) / len(imu)


def start_up(scratch: Path) -> list[Figure]:
    """Time and memory of a process until it is ready: with compiled kernels and, in a copy of the package, without.

    Only where the system has /proc.
    """
    if not Path("/proc/self/status").exists():
        return []
    return [
        *_loaded("navigator", "nav_pose_estimator.engine.navigator.sins", "SinsEngine", (1.5, 170.0)),
        *_loaded("pose estimator", *_POSE_ESTIMATOR, (2.0, 300.0)),
        *_first_start(scratch),
    ]


_POSE_ESTIMATOR = "nav_pose_estimator.engine.composed.pose_estimator", "PoseEstimator"


def _loaded(what: str, module: str, name: str, goals: tuple[float, float]) -> list[Figure]:
    runs = [_ready(module, name) for _ in range(_TRIES)]
    seconds, memory = np.min(runs, axis=0).tolist()
    return [
        Figure(f"import and warm-up, {what}", seconds, "s", goals[0]),
        Figure(f"memory after that, {what}", memory, "MB", goals[1]),
    ]


def _first_start(scratch: Path) -> list[Figure]:
    package = Path(nav_pose_estimator.__file__).parent
    shutil.copytree(package, scratch / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    seconds, memory = _ready(*_POSE_ESTIMATOR, scratch)
    return [
        Figure("first start ever, pose estimator", seconds, "s", 20.0),
        Figure("  memory of the process, without the compiler's", memory, "MB", 300.0),
    ]


def _ready(module: str, name: str, folder: Path | None = None) -> tuple[float, float]:
    """Wall time [s] from the imports to a warm engine of the package in ``folder``, and memory of the process [MB]."""
    code = (
        "import time;a=time.perf_counter();from nav_pose_estimator.engine import first_run;"
        f"from {module} import {name};first_run.compile_kernels(lambda text:None);{name}().warm_up();"
        f"print(time.perf_counter()-a,{_PEAK})"
    )
    seconds, memory = map(float, _run([sys.executable, "-c", code], folder=folder).split())
    return seconds, memory


def _run(command: list[str], environment: dict[str, str] | None = None, folder: Path | None = None) -> str:
    """Output of ``command``; ``RuntimeError`` with its last line if it fails.

    As with most users, Python keeps the compiled sources; otherwise each start would compile them again.
    """
    given = {name: value for name, value in (environment or os.environ).items() if name != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT, env=given, cwd=folder)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command[:4])} said: {done.stderr.strip()[-300:]}")
    return done.stdout
