"""Life cycle of a node: start, spin, stop. This is the only spin loop of the package.

It ends with exit code 0 on SIGINT and SIGTERM. ``spin_once`` with a time-out works in every release of rclpy, also in
those where ``spin`` misses signals. The events executor, where available, halves the cost of a callback.
"""

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

try:
    from rclpy.impl.implementation_singleton import rclpy_implementation

    RCLError: type[Exception] = rclpy_implementation.RCLError
except (ImportError, AttributeError):  # this rclpy has no such class
    RCLError = RuntimeError

try:  # at the top, because a signal during an import at run time would print a traceback
    from rclpy.experimental import EventsExecutor as _Executor
except ImportError:
    _Executor = SingleThreadedExecutor

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.ros.middleware import shared_memory
from nav_pose_estimator.ros.parameters import unaddressed

_TIMEOUT = 0.25  # s: longest delay until a signal is noticed
_IMPATIENCE = 1.0  # s after the first signal from which another one interrupts; launch repeats the first one at once


def make_executor(context: Any = None) -> Any:
    """Create the events executor where rclpy has it (7.1.4 and later), otherwise the single-threaded one."""
    return _Executor(context=context)


def run(
    make_node: Callable[[], Node],
    arguments: Sequence[str] | None = None,
    is_over: Callable[[Any], bool] = lambda node: False,
) -> int:
    """Create the node, spin until a signal, a shutdown or ``is_over(node)``, clean up; returns the exit code.

    Raises ``UserError`` for invalid arguments and parameters.
    """
    node = None
    with _signals() as stop:
        try:
            _init(arguments)
            node = make_node()
            for text in unaddressed(sys.argv if arguments is None else arguments, node.get_fully_qualified_name()):
                node.get_logger().warning(text)
            stop.is_heeded = True
            _spin(node, lambda: stop.is_asked or is_over(node))
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        except UserError:
            raise
        except Exception:
            if rclpy.ok():
                raise  # otherwise it is a consequence of the shutdown
        finally:
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()
    return 0


def _init(arguments: Sequence[str] | None) -> None:
    shared_memory.choose_transport()
    shared_memory.remove_unfinished()
    try:
        given = None if arguments is None else list(arguments)
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    except RCLError as error:
        reason = " ".join(str(error).split(", at ")[0].split())
        raise UserError(f"ROS does not accept the arguments: {reason}") from None


def _spin(node: Node, is_over: Callable[[], bool]) -> None:
    executor = make_executor()
    executor.add_node(node)
    try:
        while rclpy.ok() and not is_over():
            executor.spin_once(timeout_sec=_TIMEOUT)
    finally:
        executor.remove_node(node)
        executor.shutdown()


class _Stop:
    """Handler of SIGINT and SIGTERM. While ``is_heeded`` the spin loop polls it; otherwise a signal interrupts.

    The handlers of rclpy would end the context or raise KeyboardInterrupt in the middle of a callback, for which the
    executor prints a traceback, and they would also interrupt the destruction of the node.
    """

    def __init__(self) -> None:
        self.is_heeded = False
        self._first: float | None = None

    @property
    def is_asked(self) -> bool:
        """Whether a signal was received."""
        return self._first is not None

    def note(self, *_: Any) -> None:
        """Handle a signal."""
        now = time.monotonic()
        if self._first is None:
            self._first = now
        if not self.is_heeded or now - self._first > _IMPATIENCE:
            raise KeyboardInterrupt


@contextmanager
def _signals() -> Iterator[_Stop]:
    """Direct the signals to the yielded handler, and restore the previous handlers at the end."""
    stop = _Stop()
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set handlers
        yield stop
        return
    before = {number: signal.signal(number, stop.note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
