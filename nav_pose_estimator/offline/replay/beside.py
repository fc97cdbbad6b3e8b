"""A piece of work on another core, in a copy of this process, while this one goes on."""

import gc
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def has_second_core() -> bool:
    """Whether a copy of this process can be made and has a core to run on."""
    return sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1


def fork() -> int:
    """``os.fork``. Python warns where there are threads, but the copy does not use those of the libraries."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


@contextmanager
def beside(work: Callable[[], None]) -> Iterator[None]:
    """Do ``work`` on another core while the body runs, and wait for it; with one core, do it after the body.

    ``work`` writes files and has no other effect. Where the copy fails, for whatever reason, ``work`` is done again
    after the body, and raises what there is to raise. Where the body fails, its files may be incomplete.
    """
    if not has_second_core():
        yield
        work()
        return
    copy = fork()
    if copy == 0:
        _do(work)
    try:
        yield
    except BaseException:
        with suppress(ProcessLookupError):
            os.kill(copy, signal.SIGKILL)
        os.waitpid(copy, 0)
        raise
    if os.waitpid(copy, 0)[1] != 0:
        work()


def _do(work: Callable[[], None]) -> NoReturn:
    """Work and end, without the clean-up that belongs to the original process."""
    code = 1
    gc.freeze()  # a search for garbage among what was there before would copy its pages
    try:
        for kind in ENDING_SIGNALS:
            signal.signal(kind, signal.SIG_DFL)
        work()
        code = 0
    finally:
        os._exit(code)
