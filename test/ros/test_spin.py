"""The spin loop and signals: whatever a callback is at, it finishes, and nothing is printed."""

import os
import signal

import pytest
from rclpy.node import Node
from std_msgs.msg import Bool

from nav_pose_estimator.ros import spin


class Interrupted(Node):
    """Is hit by signals in the middle of its only callback."""

    def __init__(self, signals: list[signal.Signals]) -> None:
        super().__init__("interrupted")
        self._signals = signals
        self._publisher = self.create_publisher(Bool, "told", 1)
        self._timer = self.create_timer(0.001, self._on_timer)
        self.finished = 0

    def _on_timer(self) -> None:
        for number in self._signals:
            os.kill(os.getpid(), number)
        self._publisher.publish(Bool())
        self.finished += 1


@pytest.mark.parametrize(
    "how",
    [[signal.SIGINT], [signal.SIGTERM], [signal.SIGINT, signal.SIGINT], [signal.SIGINT, signal.SIGTERM]],
    ids=["INT", "TERM", "INT from terminal and launch", "INT and TERM"],
)
def test_a_signal_in_a_callback_lets_it_finish(ros_domain, capfd, how):
    """GIVEN a node that publishes WHEN a signal hits its callback THEN that one ends as if nothing was, and the node
    stops with exit code 0 and without a word."""
    nodes: list[Interrupted] = []
    before = [signal.getsignal(number) for number in how]

    def make() -> Interrupted:
        nodes.append(Interrupted(how))
        return nodes[0]

    assert spin.run(make, []) == 0
    assert nodes[0].finished == 1
    assert [signal.getsignal(number) for number in how] == before
    said = capfd.readouterr()
    assert "Exception" not in said.err + said.out
