"""Nodes in processes of their own, an observer of them in this process, and waiting for a condition."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

try:
    import rclpy

    from nav_pose_estimator.ros.spin import make_executor
except ImportError:  # no ROS 2 here: whoever needs it is not collected
    pass

PATIENCE = 180.0  # s that a condition may take; where the machine is busy, compiling the kernels alone takes 120
REPEAT = 20.0  # s without an answer after which a service is called again
GRACE = 10.0  # s in which a node that is asked to end has ended, even on a busy machine


def _end_with_the_test() -> None:
    """In the child: a worker that the watchdog ends (``hang_guard``) stops nobody itself."""
    pr_set_pdeathsig = 1
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)


class Child:
    """A node in a process of its own; its log is a file."""

    def __init__(self, command: str, arguments: list[str], environment: dict[str, str], folder: Path) -> None:
        self.log = folder / f"{command}_{len(list(folder.iterdir()))}.log"
        call = [sys.executable, "-m", "nav_pose_estimator", command]
        if arguments:
            call += ["--ros-args", *arguments]
        with self.log.open("w") as out:
            self.process = subprocess.Popen(
                call, env=environment, stdout=out, stderr=subprocess.STDOUT, preexec_fn=_end_with_the_test
            )

    def text(self) -> str:
        """Everything it has said so far."""
        return self.log.read_text()

    def wait_for(self, words: str) -> None:
        """Until it has said ``words``."""
        wait_until(lambda: words in self.text() or self.process.poll() is not None, what=f"{words!r}")
        assert words in self.text(), self.text()

    def stop(self, how: signal.Signals = signal.SIGINT) -> int:
        """Ask it to end; its exit code."""
        self.process.send_signal(how)
        return self.process.wait(timeout=PATIENCE)


@contextmanager
def children(environment: dict[str, str], folder: Path) -> Iterator[Callable[..., Child]]:
    """``start(command, *ros arguments)``; whatever still runs at the end is stopped."""
    running: list[Child] = []

    def start(command: str, *arguments: str) -> Child:
        running.append(Child(command, list(arguments), environment, folder))
        return running[-1]

    try:
        yield start
    finally:
        left = [child.process for child in running if child.process.poll() is None]
        for process in left:
            process.terminate()  # not killed in the middle of what others wait for (ros.middleware.shared_memory)
        for process in left:
            try:
                process.wait(timeout=GRACE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(timeout=GRACE)


class Observer:
    """A node in this process that listens, publishes and calls services."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        self.context.init(args=[], domain_id=domain)
        self.node = rclpy.create_node("observer", context=self.context)
        self.executor = make_executor(self.context)
        self.executor.add_node(self.node)
        self.heard: dict[str, list[Any]] = {}

    def listen(self, kind: Any, topic: str, qos: Any = 50) -> list[Any]:
        """Every message on ``topic`` from now on."""
        messages = self.heard.setdefault(topic, [])
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def until(self, condition: Callable[[], Any], what: str = "", patience: float = PATIENCE) -> Any:
        """Spin until ``condition`` holds."""
        return wait_until(condition, lambda: self.executor.spin_once(timeout_sec=0.02), what, patience)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """The answer of a service.

        A server that has not yet discovered the reader of its answers drops an answer: then the call is repeated.
        """
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f"service {name}")
        calls: list[Any] = []
        repeat_at = 0.0

        def answered() -> Any:
            nonlocal repeat_at
            if time.monotonic() >= repeat_at:
                calls.append(client.call_async(request))
                repeat_at = time.monotonic() + REPEAT
            return next((call for call in calls if call.done()), None)

        return self.until(answered, f"answer of {name}").result()

    def close(self) -> None:
        """Take everything down."""
        self.executor.remove_node(self.node)
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


def wait_until(
    condition: Callable[[], Any],
    meanwhile: Callable[[], Any] = lambda: time.sleep(0.02),
    what: str = "",
    patience: float = PATIENCE,
) -> Any:
    """The value of ``condition`` as soon as it is true; fails after ``patience`` seconds."""
    give_up = time.monotonic() + patience * float(os.environ.get("NAV_POSE_PATIENCE", "1"))
    while not (value := condition()):
        assert time.monotonic() < give_up, f"{what or condition} did not come true in {patience:.0f} s"
        meanwhile()
    return value
