"""A model survives everything but its own deletion."""

import hashlib
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from nav_pose_estimator.core.learning.anfis import Anfis
from nav_pose_estimator.engine.outage import model_file
from nav_pose_estimator.errors import UserError


@pytest.fixture(scope="module")
def data() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    x = random.normal(size=(120, 3))
    return x, np.stack([np.sin(x[:, 0]), x[:, 1] * x[:, 2]], axis=1)


@pytest.fixture(scope="module")
def model(data) -> Anfis:
    return Anfis(3, iterations=5, ridge=1e-4).fit(*data)


@pytest.fixture
def file(tmp_path, model):
    path = tmp_path / "model.anfis"
    model_file.save_model(path, model)
    return path


def test_loaded_model_predicts_the_same_bits(file, model, data):
    again = model_file.load_model(file)
    np.testing.assert_array_equal(again.predict(data[0]), model.predict(data[0]))
    np.testing.assert_array_equal(again.novelty(data[0]), model.novelty(data[0]))
    np.testing.assert_array_equal(again.predict_one(data[0][7]), model.predict_one(data[0][7]))
    assert again == model  # the options


def test_saving_twice_gives_the_same_file(file, model, tmp_path):
    model_file.save_model(tmp_path / "again", model)
    assert (tmp_path / "again").read_bytes() == file.read_bytes()


def test_the_arrays_that_are_read_are_those_that_were_written(file, model):
    assert set(model_file.load_arrays(file)) == set(model.state())


def test_nothing_is_left_beside_the_file(file):
    assert os.listdir(file.parent) == [file.name]


@pytest.mark.parametrize("position", [0, 30, 60, 100, 500, -1])
def test_any_flipped_bit_is_found(file, position):
    content = bytearray(file.read_bytes())
    content[position] ^= 1
    file.write_bytes(content)
    with pytest.raises(UserError, match=r"damaged|not a model|version"):
        model_file.load_model(file)


@pytest.mark.parametrize("length", [0, 10, 40, 110, 1000])
def test_truncated_file_is_refused(file, length):
    file.write_bytes(file.read_bytes()[:length])
    with pytest.raises(UserError, match=r"damaged|not a model"):
        model_file.load_model(file)


def test_newer_version_is_refused(file):
    content = file.read_bytes().replace(b"model 1\n", b"model 2\n", 1)
    file.write_bytes(content)
    with pytest.raises(UserError, match="model version 2"):
        model_file.load_model(file)


def test_foreign_file_is_refused(tmp_path):
    path = tmp_path / "other"
    path.write_bytes(b"\x89PNG\r\n" + bytes(100))
    with pytest.raises(UserError, match="not a model"):
        model_file.load_model(path)


def test_pickled_objects_are_refused(tmp_path):
    path = tmp_path / "evil"
    np.savez(path.with_suffix(".npz"), evil=np.array([{}], dtype=object))
    body = path.with_suffix(".npz").read_bytes()
    digest = hashlib.sha256(body).hexdigest().encode()
    path.write_bytes(b"nav_pose_estimator model 1\n" + digest + b"\n" + body)
    with pytest.raises(UserError, match="damaged"):
        model_file.load_model(path)


def test_other_arrays_are_no_model(tmp_path):
    path = tmp_path / "arrays"
    model_file.save_arrays(path, {"a": np.arange(3.0)})
    np.testing.assert_array_equal(model_file.load_arrays(path)["a"], np.arange(3.0))
    with pytest.raises(UserError, match="not the state of an Anfis"):
        model_file.load_model(path)


@pytest.mark.parametrize("change", ["shape", "nan", "width", "option"])
def test_state_that_does_not_fit_is_refused(model, change):
    state = dict(model.state())
    if change == "shape":
        state["consequents"] = state["consequents"][:-1]
    elif change == "nan":
        state["consequents"] = np.full_like(state["consequents"], np.nan)
    elif change == "width":
        state["premises.width"] = -state["premises.width"]
    else:
        state["option.rules"] = np.array(0)
    with pytest.raises(UserError, match="not the state of an Anfis"):
        Anfis.from_state(state)


def test_missing_file_and_missing_folder_are_user_errors(tmp_path, model):
    with pytest.raises(UserError, match="cannot read"):
        model_file.load_model(tmp_path / "nothing")
    with pytest.raises(UserError, match="cannot write"):
        model_file.save_model(tmp_path / "no" / "folder", model)


def test_failed_write_keeps_the_last_good_file(file, model, data, monkeypatch):
    good = file.read_bytes()

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UserError, match="No space left"):
        model_file.save_model(file, Anfis(2, iterations=1).fit(*data))
    assert file.read_bytes() == good
    assert os.listdir(file.parent) == [file.name]


KILLED_WHILE_SAVING = """
import os, signal, sys
from nav_pose_estimator.engine.outage import model_file
def die(*args):
    os.kill(os.getpid(), signal.SIGKILL)
setattr(os, sys.argv[2], die)
arrays = model_file.load_arrays(sys.argv[1])
arrays["consequents"] *= 0.0
model_file.save_arrays(sys.argv[1], arrays)
"""


@pytest.mark.parametrize("moment", ["fsync", "replace"])
def test_kill_while_saving_leaves_the_last_good_file(file, moment):
    good = file.read_bytes()
    command = [sys.executable, "-c", KILLED_WHILE_SAVING, str(file), moment]
    assert subprocess.run(command, timeout=60).returncode == -signal.SIGKILL
    assert file.read_bytes() == good
