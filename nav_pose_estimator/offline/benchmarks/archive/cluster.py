"""A Dask scheduler and workers on this machine, started as ``dask scheduler`` and ``dask worker``."""

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from nav_pose_estimator.errors import UserError

_PATIENCE = 60  # s: time-out of the start


@contextmanager
def on_this_machine(workers: int) -> Iterator[tuple[str, list[int]]]:
    """(address, process numbers of the ``workers``) of a cluster that ends with the block."""
    if find_spec("distributed") is None:
        raise UserError("--dask needs Dask: pip install -r requirements-cluster.txt")
    from distributed import Client

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    address = f"tcp://127.0.0.1:{port}"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard", "--dashboard-address", ":0"]
    worker = ["worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    processes = [_start(scheduler), *(_start(worker) for _ in range(workers))]
    try:
        with Client(address, timeout=_PATIENCE) as client:
            client.wait_for_workers(workers, timeout=_PATIENCE)
        yield address, [process.pid for process in processes[1:]]
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()


def _start(options: list[str]) -> subprocess.Popen:
    command = [sys.executable, "-m", "dask", *options]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
