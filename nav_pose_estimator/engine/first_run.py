"""First start on a machine: the kernels are compiled in a separate process before anything else.

The compiler needs three times the memory of its result and does not release it; a separate process does.
"""

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import nav_pose_estimator
from nav_pose_estimator.core.numerics.jit import is_first_run

_FOLDER = Path(nav_pose_estimator.__file__).parent


def compile_kernels(show: Callable[[str], None]) -> None:
    """Run the command ``warm_up`` where no kernel has been compiled yet, and pass its output to ``show``.

    Kernels that it does not reach are compiled at their first call.
    """
    if not is_first_run() or not os.access(_FOLDER, os.W_OK):  # a read-only folder cannot hold the machine code
        return
    show("the first start compiles the numeric kernels, which takes a minute or two")
    with _alone(show):
        if is_first_run():  # no other process has done it in the meantime
            _warm_up(show)


def _warm_up(show: Callable[[str], None]) -> None:
    command = [sys.executable, "-m", nav_pose_estimator.__name__, "warm_up"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                show(line.strip())
        except BaseException:
            process.terminate()
            raise


@contextmanager
def _alone(show: Callable[[str], None]) -> Iterator[None]:
    """Lock: of several nodes that start at once, one compiles and the others wait."""
    folder = os.open(_FOLDER, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                show("another process is already compiling them: waiting for it")
                fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)
