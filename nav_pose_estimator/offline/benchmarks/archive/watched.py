"""Run of a command of this package in a separate process, with its costs and those of its workers from /proc."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from nav_pose_estimator.offline.process_clock import stat_fields

_POLL = 0.05  # s between two readings of /proc
_TICK = 1.0 / os.sysconf("SC_CLK_TCK")  # s
_WORKER = b"spawn_main"  # in the command line of a process of a pool


@dataclass(frozen=True)
class Kill:
    """SIGKILL to one worker, or to the ``command`` itself, once the number ``results`` of results is stored."""

    results: int
    command: bool = False


@dataclass
class Cost:
    """CPU time [s] of the main process and of each worker by id, peak memory of a process [MB], elapsed time [s]."""

    main: float = 0.0
    workers: dict[int, float] = field(default_factory=dict)
    memory: float = 0.0
    workers_memory: float = 0.0
    elapsed: float = 0.0

    @property
    def total(self) -> float:
        """CPU time of all [s]."""
        return self.main + sum(self.workers.values())

    @property
    def longest(self) -> float:
        """CPU time [s] of the critical path: that of the main process plus that of the busiest worker."""
        return self.main + max(self.workers.values(), default=0.0)


def run(options: Sequence[str], kept: Path, kill: Kill | None = None, workers: Sequence[int] = ()) -> Cost:
    """Run a command whose results are stored in the folder ``kept`` meanwhile.

    ``workers``: processes outside of the command's own pool that work for it. Raises ``RuntimeError``, with the last
    line of its output, if it fails without having been killed.
    """
    command = [sys.executable, "-m", "nav_pose_estimator", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    before = {pid: _cpu(pid) for pid in workers}
    cost, waits, began = Cost(), kill is not None, time.monotonic()
    while process.poll() is None:
        pool = [*workers, *_pool_of(process.pid)]
        _watch(cost, process.pid, pool, before)
        if kill is not None and waits and pool and len(list(kept.glob("*"))) >= kill.results:
            waits = False
            os.kill(process.pid if kill.command else pool[0], signal.SIGKILL)
        time.sleep(_POLL)
    cost.elapsed = time.monotonic() - began
    output = process.communicate()[0]
    if process.returncode != 0 and not (kill is not None and kill.command):
        raise RuntimeError(f"{' '.join(command[1:5])} said: {output.strip()[-300:]}")
    if waits:
        raise RuntimeError(f"{' '.join(command[1:5])} was ready before it could be disturbed: give it more flights")
    return cost


def _watch(cost: Cost, pid: int, pool: Sequence[int], before: dict[int, float]) -> None:
    with suppress(OSError):
        cost.main, cost.memory = _cpu(pid), max(cost.memory, _memory(pid))
    for worker in pool:
        with suppress(OSError):
            cost.workers[worker] = _cpu(worker) - before.get(worker, 0.0)
            cost.workers_memory = max(cost.workers_memory, _memory(worker))


def _pool_of(pid: int) -> list[int]:
    """Workers of a pool that process ``pid`` has started, the oldest first."""
    with suppress(OSError):
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
        return [int(child) for child in children if _WORKER in Path(f"/proc/{child}/cmdline").read_bytes()]
    return []


def _cpu(pid: int) -> float:
    fields = stat_fields(pid)
    return _TICK * (int(fields[11]) + int(fields[12]))


def _memory(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return next((int(line.split()[1]) / 1024.0 for line in status.splitlines() if line.startswith("VmHWM")), 0.0)
