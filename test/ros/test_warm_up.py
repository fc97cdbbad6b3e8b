"""No compiler in flight: once a node says that it is ready, no sample meets a kernel for the first time."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.compiled

SCRIPT = """
import sys
from dataclasses import replace
import rclpy
from rclpy.serialization import serialize_message
from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.nodes.pose_estimator import PoseEstimatorNode
from nav_pose_estimator.ros.messages.sample_messages import TOPICS, to_message
from nav_pose_estimator.sim.scenarios import SCENARIOS, generate

def known():
    kernels = (k for n, m in list(sys.modules.items()) if n.startswith("nav_pose_estimator") for k in vars(m).values())
    return {(k.py_func.__qualname__, s) for k in kernels if hasattr(k, "nopython_signatures") for s in k.signatures}

story, arguments = SCENARIOS[sys.argv[1]], sys.argv[2:]
flight = generate(story, duration=70.0, seed=3, imu_rate=50.0)
before_simulation = known()
rclpy.init(args=["--ros-args", *arguments] if arguments else [])
node = PoseEstimatorNode()
ready = known() - (before_simulation - known())
callbacks = {s.topic_name: s.callback for s in node.subscriptions}
for i, sample in enumerate(flight.samples(blocks=False)):
    if i == 4500:
        node.engine.set_use_gnss(False)
    message = to_message(sample)
    data = serialize_message(message) if isinstance(sample, ImuSample) else message
    callbacks["/" + TOPICS[type(sample)][0]](data)
node._on_timer()
print(node.engine.mode.value)
node.engine.reset(sample.stamp_ns, "test")
print("NEW", sorted(name for name, _ in known() - ready))
"""


@pytest.mark.parametrize(
    ("story", "arguments"),
    [("multirotor_outage", []), ("start_in_air", []), ("no_magnetometer", ["-p", "attitude.filter:=two_stage"])],
    ids=["from_rest", "in_the_air", "without_magnetometer"],
)
def test_a_ready_node_has_compiled_everything(child_environment, story, arguments):
    call = [sys.executable, "-c", SCRIPT, story, *arguments]
    done = subprocess.run(call, env=child_environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    mode, new = done.stdout.strip().splitlines()[-2:]
    assert mode in ("DEAD_RECKONING", "COASTING"), done.stdout
    assert new == "NEW []"
