"""Signals that end a command, also while machine code is loaded.

numba reads its cache in callbacks from C. Python ignores every exception in such a callback, so that Ctrl-C would print
a traceback and change nothing. A signal that arrives there is sent again a moment later.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

Handler = Callable[[int, FrameType | None], None]

_CALLBACKS = "_raw_object_cache"  # beginning of the names of llvmlite's callbacks
_PAUSE = 0.02  # s until the signal is sent again


def outside_callbacks(handler: Handler) -> Handler:
    """Return ``handler`` as one that runs only when no such callback does."""

    def handle(number: int, frame: FrameType | None) -> None:
        if not _is_in_callback(frame):
            handler(number, frame)
            return
        again = threading.Timer(_PAUSE, os.kill, (os.getpid(), number))
        again.daemon = True
        again.start()

    return handle


@contextmanager
def interruptible() -> Iterator[None]:
    """Context in which SIGINT raises ``KeyboardInterrupt``, but not in a callback."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, outside_callbacks(signal.default_int_handler))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _is_in_callback(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_name.startswith(_CALLBACKS):
            return True
        frame = frame.f_back
    return False
