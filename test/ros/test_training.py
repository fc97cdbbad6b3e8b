"""Training in a process of its own: results come back, and nothing that goes wrong there reaches the node."""

import os
import subprocess
import sys

import pytest

from fake_learner import Job
from nav_pose_estimator.ros.training import Outcome, Trainer
from ros_processes import wait_until


@pytest.fixture
def trainer():
    trainer = Trainer()
    yield trainer
    trainer.stop()


def outcome_of(trainer: Trainer) -> Outcome:
    return wait_until(trainer.poll, what="the outcome of the training")


def test_a_result_comes_from_another_process(trainer):
    trainer.submit(Job(7))
    assert trainer.is_busy
    outcome = outcome_of(trainer)
    number, process = outcome.result
    assert (number, outcome.failure) == (7, "")
    assert process != os.getpid()
    assert not trainer.is_busy
    assert trainer.poll() is None


@pytest.mark.parametrize(
    ("how", "failure"),
    [("fails", "ZeroDivisionError: division by zero"), ("dies", "the training process ended without a result")],
)
def test_a_training_that_fails_or_dies_is_named_and_the_next_one_works(trainer, how, failure):
    trainer.submit(Job(1, how))
    assert outcome_of(trainer) == Outcome(failure=failure)
    trainer.submit(Job(2))
    assert outcome_of(trainer).result[0] == 2


def test_a_training_without_end_is_ended():
    trainer = Trainer(time_limit=0.5)
    trainer.submit(Job(1, "hangs"))
    process = trainer._process
    assert outcome_of(trainer).failure == "it took longer than 0.5 s"
    assert not process.is_alive()


def test_the_training_process_knows_nothing_of_ros():
    code = "import sys, nav_pose_estimator.ros.training; print([m for m in sys.modules if m.startswith('rclpy')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout.strip() == "[]"


def test_of_the_jobs_that_wait_only_the_newest_runs(trainer):
    for number in (1, 2, 3):
        trainer.submit(Job(number))
    assert [outcome_of(trainer).result[0] for _ in range(2)] == [1, 3]
    assert not trainer.is_busy
