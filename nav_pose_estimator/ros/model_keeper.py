"""Training of a node's learner in another process, its model on disk, and the services for both."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import Trigger

from nav_pose_estimator.engine.outage.model_file import load_arrays, save_arrays
from nav_pose_estimator.engine.parameters.ros import ModelParameters
from nav_pose_estimator.engine.parameters.schema import ParameterError
from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.errors import UserError, described
from nav_pose_estimator.ros.training import Outcome, Trainer

_PERIOD = 0.5  # s between two polls of the training process
_CURVE = 20  # number of trainings that the learning curve contains


class ModelKeeper:
    """Services ~/train, ~/save_model and ~/load_model of ``node``.

    ``outage_aid`` has a ``learner`` (``engine.outage.learner``) and receives results in ``accept``; ``trainer`` runs
    its jobs. ``say`` takes the name, level and sentence of an event. Every failure is reported and leaves the model
    unchanged.
    """

    def __init__(
        self,
        node: Node,
        outage_aid: Any,
        trainer: Trainer,
        parameters: ModelParameters,
        say: Callable[[str, Level, str], None],
    ) -> None:
        self.history: list[dict[str, float]] = []  # scores after each training
        self._outage_aid, self._trainer, self._parameters, self._say = outage_aid, trainer, parameters, say
        self._failure, self._trainings = "", 0
        _check_folder(parameters.file)
        outage_aid.learner.warm_up()
        self._timer = node.create_timer(_PERIOD, self.look_after, clock=Clock(clock_type=ClockType.STEADY_TIME))
        for name, action in (("train", self.train), ("save_model", self.save), ("load_model", self.load)):
            node.create_service(Trigger, f"~/{name}", partial(self._serve, action))
        if parameters.file and Path(parameters.file).exists():
            self.attempt(self.load)

    @property
    def training(self) -> str:
        """State of the training in a few words."""
        return "running" if self._trainer.is_busy else self._failure or "-"

    def stop(self) -> None:
        """End a running training."""
        self._trainer.stop()

    def look_after(self) -> None:
        """Receive the outcome of a training, and extend the learning curve; called by the timer."""
        try:
            outcome = self._trainer.poll()
            if outcome is not None:
                self._take(outcome)
            self._note_scores()
        except Exception as error:
            self._say("outage.training_failed", Level.ERROR, f"training: {described(error)}")

    def attempt(self, action: Callable[[], str]) -> tuple[bool, str]:
        """Run ``action``: whether it succeeded, and a sentence for the user."""
        try:
            return True, action()
        except UserError as error:
            text = str(error)
        except Exception as error:
            text = f"failed: {described(error)}"
        self._say("outage.request_failed", Level.WARN, text)
        return False, text

    def train(self) -> str:
        """Start a training; ``UserError`` where it is not possible now."""
        if self._trainer.is_busy:
            raise UserError("a training is running")
        learner = self._outage_aid.learner
        job = learner.job()
        if job is None:
            raise UserError(f"there is nothing to train on yet: {learner.state.reason}")
        self._trainer.submit(job)
        return "the training has begun; /diagnostics will show how it ends"

    def save(self) -> str:
        """Save the model; ``UserError`` where it is not possible."""
        save_arrays(self._path(), self._outage_aid.learner.arrays())
        self._say("outage.model.saved", Level.INFO, f"the model was saved to {self._path()}")
        return f"the model was saved to {self._path()}"

    def load(self) -> str:
        """Load the model; ``UserError`` where it is not possible."""
        self._outage_aid.learner.load(load_arrays(self._path()))
        self._say("outage.model.loaded", Level.INFO, f"the model was loaded from {self._path()}")
        return f"the model was loaded from {self._path()}"

    def _serve(self, action: Callable[[], str], request: Trigger.Request, response: Trigger.Response) -> Any:
        response.success, response.message = self.attempt(action)
        return response

    def _take(self, outcome: Outcome) -> None:
        self._failure = outcome.failure
        if outcome.failure:
            self._say("outage.training_failed", Level.ERROR, f"the training failed: {outcome.failure}")
            return
        self._outage_aid.accept(outcome.result)
        self._say("outage.trained", Level.INFO, "a training has ended")
        if self._parameters.file and self._parameters.save_after_training:
            self.attempt(self.save)

    def _note_scores(self) -> None:
        """Append a point to the learning curve once the learner has adopted a result, which may be some time later."""
        before, self._trainings = self._trainings, self._outage_aid.learner.state.trainings
        if self._trainings > before:
            scores = {name: float(value) for name, value in self._outage_aid.learner.scores().items()}
            self.history = [*self.history, scores][-_CURVE:]

    def _path(self) -> str:
        if not self._parameters.file:
            raise UserError("no file is set for the model: set ros.model.file")
        return self._parameters.file


def _check_folder(file: str) -> None:
    """Check before the flight that the folder of ``file`` exists; ``ParameterError`` otherwise."""
    folder = Path(file).absolute().parent
    if file and not folder.is_dir():
        raise ParameterError(f"ros.model.file: the folder {folder} does not exist")
