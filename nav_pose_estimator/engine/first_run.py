"""The first start on a machine: kernels are compiled in other processes before anything else happens.

The compiler takes three times the memory of what it makes, and keeps it.
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


def compile_kernels(tell: Callable[[str], None]) -> None:
    """Have the command ``warm_up`` compile what was never compiled here, and ``tell`` what it says.

    Whatever it leaves out is compiled when it is called first.
    """
    if not is_first_run() or not os.access(_FOLDER, os.W_OK):  # else machine code is kept elsewhere, if at all
        return
    tell("the first start compiles the numeric kernels, which takes a minute or two")
    with _alone(tell):
        if is_first_run():  # and no other process did it meanwhile
            _warm_up(tell)


def _warm_up(tell: Callable[[str], None]) -> None:
    command = [sys.executable, "-m", nav_pose_estimator.__name__, "warm_up"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                tell(line.strip())
        except BaseException:
            process.terminate()
            raise


@contextmanager
def _alone(tell: Callable[[str], None]) -> Iterator[None]:
    """Several nodes may start at once: one compiles, the others wait."""
    folder = os.open(_FOLDER, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                tell("another process is already compiling them: waiting for it")
                fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)
