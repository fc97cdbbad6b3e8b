"""anfis_node: learns from the flight how the navigator errs without GNSS, and tells it so in an outage."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from nav_pose_estimator.engine.model_file import load_arrays, save_arrays
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import VelocityError
from nav_pose_estimator.engine.solutions import Event, Level, Status
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.ros import inputs, qos, spin, wording
from nav_pose_estimator.ros.convert import vector
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.outage_model import OutageModel
from nav_pose_estimator.ros.outputs import LearnerOutput
from nav_pose_estimator.ros.training import Outcome, Trainer

_TRAINING_PERIOD = 0.5  # s: how often the training process is looked after
_CURVE = 20  # so many trainings are shown


def make_learner(parameters: Parameters) -> Any:
    """The learner of the engine."""
    from nav_pose_estimator.engine.outage_learner import OutageLearner

    return OutageLearner(parameters)


class AnfisNode(EstimatorNode):
    """Learns while GNSS is good; needs a navigator's odometry, biases, origin and gnss/denied."""

    published = (VelocityError,)

    def __init__(self, learner: Callable[[Parameters], Any] = make_learner) -> None:
        super().__init__("anfis_node", partial(OutageModel, make_learner=learner))
        self._model = self.parameters.ros.model
        self._output, self._trainer = LearnerOutput(self, self.parameters), Trainer()
        self._history: list[dict[str, float]] = []  # scores after each training
        self._failure = ""  # of the last training
        self.listen_imu(inputs.imu_input(self.parameters.ros.input))
        self.listen_raw(inputs.navigator_input(), lambda data: True, needed=True)
        self._listen_to_facts()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._training_timer = self.create_timer(_TRAINING_PERIOD, self._on_training, clock=steady)
        for name, action in (("train", self._train), ("save_model", self._save), ("load_model", self._load)):
            self.create_service(Trigger, f"~/{name}", partial(self._serve, action))
        if self._model.file and Path(self._model.file).exists():
            self._attempt(self._load)
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

    def publish(self, error: VelocityError) -> None:
        """outage/velocity_error and outage/position_error."""
        self._output.publish(error, self.engine.position_error)

    def describe(self, status: Status) -> tuple[int, str, list[tuple[str, str]]]:
        """Scores, learning curve and why the model is not used. Only a navigator that is missing is a warning."""
        level = wording.WARN if self.engine.watch.waiting_for else wording.OK
        training = "running" if self._trainer.is_busy else self._failure or "-"
        facts = wording.learner_facts(status, training, self._history[-_CURVE:])
        return level, wording.sentence(status, wording.LEARNER_MEANINGS), facts

    def destroy_node(self) -> None:
        """Also end a training."""
        self._trainer.stop()
        super().destroy_node()

    # --- training --------------------------------------------------------------------------------------------------

    def _on_training(self) -> None:
        """Take what a training gave; start the next as soon as the learner has one."""
        try:
            outcome = self._trainer.poll()
            if outcome is not None:
                self._take_outcome(outcome)
            self._start_training()
        except Exception as error:
            self._note_failure("training", error)

    def _start_training(self) -> bool:
        job = None if self._trainer.is_busy else self.engine.learner.training_job()
        if job is not None:
            self._trainer.start(job)
        return job is not None

    def _take_outcome(self, outcome: Outcome) -> None:
        self._failure = outcome.failure
        if outcome.failure:
            self._say("outage.training_failed", Level.ERROR, f"the training failed: {outcome.failure}")
            return
        self.engine.learner.accept(outcome.result)
        self._history.append({name: float(value) for name, value in self.engine.learner.scores().items()})
        self._say("outage.trained", Level.INFO, f"trained: {self.engine.learner.reason or 'the model is used'}")
        if self._model.file and self._model.save_after_training:
            self._attempt(self._save)

    # --- services --------------------------------------------------------------------------------------------------

    def _serve(self, action: Callable[[], str], request: Trigger.Request, response: Trigger.Response) -> Any:
        response.success, response.message = self._attempt(action)
        return response

    def _attempt(self, action: Callable[[], str]) -> tuple[bool, str]:
        """Whether ``action`` succeeded, and the sentence about it."""
        try:
            return True, action()
        except UserError as error:
            text = str(error)
        except Exception as error:
            text = f"failed: {type(error).__name__}: {' '.join(str(error).split())}"
        self._say("outage.request_failed", Level.WARN, text)
        return False, text

    def _train(self) -> str:
        if self._trainer.is_busy:
            raise UserError("a training is running")
        if not self._start_training():
            raise UserError(f"there is nothing to train on yet ({self.engine.status().waiting_for or 'no new data'})")
        return "the training has begun; diagnostics tell how it ends"

    def _save(self) -> str:
        save_arrays(self._path(), self.engine.learner.state())
        self._say("outage.model.saved", Level.INFO, f"the model is in {self._path()}")
        return f"the model is in {self._path()}"

    def _load(self) -> str:
        self.engine.learner.load(load_arrays(self._path()))
        self._say("outage.model.loaded", Level.INFO, f"the model is that of {self._path()}")
        return f"the model is that of {self._path()}"

    def _path(self) -> str:
        if not self._model.file:
            raise UserError("there is no file for the model: set ros.model.file")
        return self._model.file

    def _say(self, name: str, level: Level, text: str) -> None:
        self.logbook.note(Event(self._guard.newest_ns, name, level, text))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return spin.run(AnfisNode, arguments)
