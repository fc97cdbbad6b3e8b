"""The life of a node: start, spin, stop. The only spin loop of the package.

Ends with exit code 0 on SIGINT and SIGTERM. ``spin_once`` with a time-out works in every release of rclpy, also where
``spin`` misses signals; the events executor, where there is one, halves the cost of a callback.
"""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

try:
    from rclpy.impl.implementation_singleton import rclpy_implementation

    RCLError: type[Exception] = rclpy_implementation.RCLError
except (ImportError, AttributeError):  # no such internals: nothing to tell apart
    RCLError = RuntimeError

try:  # here, not when it is needed: a signal in the middle of an import leaves a traceback behind
    from rclpy.experimental import EventsExecutor as _Executor
except ImportError:
    _Executor = SingleThreadedExecutor

from nav_pose_estimator.errors import UserError

_TIMEOUT = 0.25  # s: how soon a signal is seen at the latest


def make_executor(context: Any = None) -> Any:
    """The events executor where rclpy has it (7.1.4 and later), else the single-threaded one."""
    return _Executor(context=context)


def run(
    make_node: Callable[[], Node],
    arguments: Sequence[str] | None = None,
    is_over: Callable[[Any], bool] = lambda node: False,
) -> int:
    """Create the node, spin until a signal, a shutdown or ``is_over(node)``, clean up; returns the exit code.

    Raises ``UserError`` for arguments and parameters that make no sense.
    """
    node = None
    try:
        _init(arguments)
        node = make_node()
        _spin(node, is_over)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except UserError:
        raise
    except Exception:
        if rclpy.ok():
            raise  # anything else is the shutdown that came in between
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _init(arguments: Sequence[str] | None) -> None:
    try:
        rclpy.init(args=None if arguments is None else list(arguments))
    except RCLError as error:
        reason = " ".join(str(error).split(", at ")[0].split())
        raise UserError(f"ROS does not accept the arguments: {reason}") from None


def _spin(node: Node, is_over: Callable[[Any], bool]) -> None:
    executor = make_executor()
    executor.add_node(node)
    try:
        with _signals() as asked:
            while rclpy.ok() and not asked() and not is_over(node):
                executor.spin_once(timeout_sec=_TIMEOUT)
    finally:
        executor.remove_node(node)
        executor.shutdown()


@contextmanager
def _signals() -> Iterator[Callable[[], bool]]:
    """SIGINT and SIGTERM as a question that the loop asks: whether one has come. A second one interrupts.

    rclpy's own handlers would end the context, or raise KeyboardInterrupt, in the middle of a callback, and the
    executor prints a traceback for that.
    """
    count = 0

    def note(*_: Any) -> None:
        nonlocal count
        count += 1
        if count > 1:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # signals are none of its business
        yield lambda: False
        return
    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: count > 0
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
