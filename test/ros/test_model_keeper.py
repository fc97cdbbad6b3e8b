"""Around a learner: training beside the node, models on disk, services that answer in a sentence."""

from types import SimpleNamespace

import numpy as np
import pytest
from std_srvs.srv import Trigger

from fake_learner import Job, Pupil
from nav_pose_estimator.engine.outage.model_file import load_arrays, save_arrays
from nav_pose_estimator.engine.parameters.ros import ModelParameters
from nav_pose_estimator.engine.parameters.schema import ParameterError
from nav_pose_estimator.ros.model_keeper import ModelKeeper
from nav_pose_estimator.ros.training import Trainer
from ros_processes import wait_until


class Desk:
    """A keeper without ROS around it; ``said`` are the names of its events."""

    def __init__(self, file: str = "", save: bool = False) -> None:
        self.pupil, self.trainer, self.said, self.services = Pupil(), Trainer(), [], {}
        node = SimpleNamespace(
            create_timer=lambda period, callback, clock: None,
            create_service=lambda kind, name, callback: self.services.__setitem__(name, callback),
        )
        parameters = ModelParameters(file=str(file), save_after_training=save)
        self.keeper = ModelKeeper(node, self.pupil, self.trainer, parameters, lambda name, *_: self.said.append(name))

    def call(self, name: str) -> tuple[bool, str]:
        answer = self.services[f"~/{name}"](Trigger.Request(), Trigger.Response())
        return answer.success, answer.message

    def wait_for(self, event: str) -> None:
        before = self.said.count(event)
        wait_until(lambda: self.keeper.look_after() or self.said.count(event) > before, what=event)


@pytest.mark.parametrize("make_folder", [False, True], ids=["missing", "a file stands there"])
def test_a_model_file_that_can_never_be_written_stops_the_node(tmp_path, make_folder):
    """GIVEN ros.model.file in a folder that is none WHEN the node starts THEN one sentence, and it does not fly."""
    folder = tmp_path / "models"
    if make_folder:
        folder.write_text("")
    with pytest.raises(ParameterError, match=f"ros.model.file: the folder {folder} does not exist"):
        Desk(folder / "drone.model")


@pytest.fixture
def make():
    desks = []

    def build(*arguments, **options) -> Desk:
        desks.append(Desk(*arguments, **options))
        return desks[-1]

    yield build
    for desk in desks:
        desk.keeper.stop()


def test_scores_after_each_training_make_a_curve(make):
    desk = make()
    for number in (3, 4):
        desk.trainer.submit(Job(number))
        desk.wait_for("outage.trained")
    assert [number for number, _ in desk.pupil.results] == [3, 4]
    assert [scores["validation error"] for scores in desk.keeper.history] == [0.25, 0.2]


def test_a_failed_training_is_told_and_changes_nothing(make):
    desk = make()
    desk.trainer.submit(Job(1, "fails"))
    assert desk.keeper.training == "running"
    desk.wait_for("outage.training_failed")
    assert desk.keeper.training == "ZeroDivisionError: division by zero"
    assert desk.pupil.results == []


def test_a_training_can_be_asked_for_once_at_a_time(make):
    desk = make()
    assert desk.call("train") == (False, "there is nothing to train on yet: nothing has been learned yet")
    desk.pupil.learner.next_job = Job(1, "hangs")
    assert desk.call("train")[0]
    assert desk.call("train") == (False, "a training is running")
    assert desk.said == ["outage.request_failed"] * 2


def test_without_a_file_the_services_say_so(make):
    desk = make()
    for name in ("save_model", "load_model"):
        assert desk.call(name) == (False, "no file is set for the model: set ros.model.file")


def test_a_model_outlives_the_node(make, tmp_path):
    """GIVEN a node that saves after each training WHEN another starts with its file THEN it begins with that model."""
    file = tmp_path / "drone.model"
    first = make(file, save=True)
    first.trainer.submit(Job(6))
    first.wait_for("outage.model.saved")
    assert float(load_arrays(file)["weight"]) == 6.0
    second = make(file)
    assert second.pupil.learner.weight == 6.0
    second.pupil.learner.weight = 8.0
    assert second.call("save_model") == (True, f"the model was saved to {file}")
    second.pupil.learner.weight = 1.0
    assert second.call("load_model")[0]
    assert second.pupil.learner.weight == 8.0


@pytest.mark.parametrize("content", ["garbage", "foreign"])
def test_a_bad_model_file_does_not_keep_the_node_on_the_ground(make, tmp_path, content):
    file = tmp_path / "drone.model"
    if content == "garbage":
        file.write_bytes(b"\x00" * 100)
    else:
        save_arrays(file, {"other": np.zeros(3)})
    desk = make(file)
    assert desk.said == ["outage.request_failed"]
    assert desk.pupil.learner.weight == 0.0


def test_a_folder_that_is_not_there_is_a_sentence(make, tmp_path):
    (tmp_path / "models").mkdir()
    desk = make(tmp_path / "models" / "drone.model")
    (tmp_path / "models").rmdir()
    success, text = desk.call("save_model")
    assert not success
    assert "cannot write the model" in text
