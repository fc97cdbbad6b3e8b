"""anfis_node: learns from the flight how the navigator errs without GNSS, and sends it that in an outage."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Bool

from nav_pose_estimator.engine.outage.remote import RemoteLearner
from nav_pose_estimator.engine.solutions import PredictedDrift, Status
from nav_pose_estimator.ros import inputs, qos, spin, wording
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.messages.cdr import peek_stamp_ns
from nav_pose_estimator.ros.messages.convert import vector
from nav_pose_estimator.ros.model_keeper import ModelKeeper
from nav_pose_estimator.ros.outputs import LearnerOutput
from nav_pose_estimator.ros.pace import Pace
from nav_pose_estimator.ros.training import Trainer

_ODOMETRY_RATE = 50.0  # Hz: it learns from means of half a second; to read every odometry would cost half a core


class AnfisNode(EstimatorNode):
    """Learns while GNSS is good; needs a navigator's odometry, biases, origin and gnss/denied."""

    published = (PredictedDrift,)

    def __init__(self) -> None:
        trainer = Trainer()
        super().__init__("anfis_node", partial(RemoteLearner, train=trainer.submit))
        self._output = LearnerOutput(self, self.parameters)
        self.listen(inputs.imu(self.parameters), needed=True)
        pace = Pace(_ODOMETRY_RATE)
        self.listen(inputs.NAVIGATOR, needed=True, choose=lambda data: pace.is_due(peek_stamp_ns(data)))
        self._listen_to_facts()
        self.model_keeper = ModelKeeper(self, self.engine, trainer, self.parameters.ros.model, self.say)
        self.get_logger().info("ready")

    def _listen_to_facts(self) -> None:
        """What the navigator says once, or slowly. The names are those of sins_node; remap them for another."""
        watch = self.engine.watch

        def origin(message: NavSatFix) -> None:
            lat, lon = np.radians([message.latitude, message.longitude]).tolist()
            watch.origin = lat, lon, message.altitude

        def gyro_bias(message: Vector3Stamped) -> None:
            watch.gyro_bias = np.array(vector(message.vector))

        def accel_bias(message: Vector3Stamped) -> None:
            watch.accel_bias = np.array(vector(message.vector))

        def denied(message: Bool) -> None:
            watch.denied = message.data

        qos.subscribe(self, NavSatFix, "sins_node/origin", origin, qos.latched())
        qos.subscribe(self, Vector3Stamped, "sins_node/bias/gyro", gyro_bias, qos.sensor(1))
        qos.subscribe(self, Vector3Stamped, "sins_node/bias/accel", accel_bias, qos.sensor(1))
        qos.subscribe(self, Bool, "gnss/denied", denied, qos.latched())

    def publish(self, drift: PredictedDrift) -> None:
        """outage/velocity_error and outage/position_error."""
        self._output.publish(drift)

    def describe(self, status: Status) -> wording.Description:
        """Scores, learning curve and why the model is not used. Only a navigator that is missing is a warning."""
        level = wording.WARN if self.engine.watch.waiting_for else wording.OK
        facts = wording.learner_facts(status, self.model_keeper.training, self.model_keeper.history)
        return level, wording.sentence(status, wording.LEARNER_MEANINGS), facts

    def destroy_node(self) -> None:
        """Also end a training."""
        self.model_keeper.stop()
        super().destroy_node()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return spin.run(AnfisNode, arguments)
