"""A model file with a right checksum and absurd numbers is refused, and the model in use stays."""

import hashlib
import io
import random
import zipfile
from pathlib import Path

import numpy as np
import pytest

from flown import Flight
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, learn_air_velocity
from nav_pose_estimator.engine.outage.learner import OutageLearner
from nav_pose_estimator.engine.outage.model_file import load_arrays, save_arrays
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.errors import UserError


@pytest.fixture(scope="module")
def model() -> AirVelocityModel:
    return learn_air_velocity(Flight(seconds=120.0).epochs(), (2,))


ABSURD = {
    "wind_spread": 1e300,
    "wind_mean": 400.0,
    "wind": -1e6,
    "wind_cov": np.diag([1e5, 1e5]),
    "noise": 1e-12,
    "hover_noise": 1e9,
    "parameter_cov": -np.eye(10),
    "target_square": 1e12,
    "errors": np.array([[2.0, 1e99]]),
    "network.consequents": 1e5,
    "network.scaling.out_mean": 1e4,
    "network.scaling.out_scale": 1e7,
    "network.option.rules": 10**9,
    "network.option.iterations": 10**12,
}


@pytest.mark.parametrize("name", ABSURD)
def test_what_no_vehicle_can_do_is_refused(model, tmp_path, name):
    """GIVEN a learner with a model WHEN it is told to load absurd numbers THEN it refuses and keeps its own."""
    arrays = dict(model.state())
    arrays[name] = np.broadcast_to(ABSURD[name], np.shape(arrays[name])).astype(arrays[name].dtype)
    save_arrays(tmp_path / "model", arrays)
    learner = OutageLearner(LearnerParameters())
    learner.load(model.state())
    before = learner.state.model
    with pytest.raises(UserError, match=r"model.*(beyond|not a covariance|predicts).*is not used"):
        learner.load(load_arrays(tmp_path / "model"))
    assert learner.state.model is before


def test_a_true_model_is_within_the_bounds(model, tmp_path):
    save_arrays(tmp_path / "model", model.state())
    again = AirVelocityModel.from_state(load_arrays(tmp_path / "model"))
    np.testing.assert_array_equal(again.noise, model.noise)


def write(path: Path, body: bytes) -> None:
    path.write_bytes(b"nav_pose_estimator model 1\n" + hashlib.sha256(body).hexdigest().encode() + b"\n" + body)


def test_a_bomb_is_not_unpacked(tmp_path):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(1 << 28))
    write(tmp_path / "model", buffer.getvalue())
    with pytest.raises(UserError, match="too large"):
        load_arrays(tmp_path / "model")


def test_mutated_models_are_refused_or_sound(model, tmp_path):
    """200 seeded mutations with a right checksum: one sentence, or a model whose predictions are a vehicle's."""
    generator, epochs = random.Random(5), Flight(seconds=30.0, seed=2).epochs()
    save_arrays(tmp_path / "model", model.state())
    body = (tmp_path / "model").read_bytes().split(b"\n", 2)[2]
    refused = 0
    for _ in range(200):
        data = bytearray(body)
        for _ in range(generator.choice((1, 3, 20))):
            place = generator.randrange(len(data))
            data[place : place + 8] = generator.randbytes(8)
        write(tmp_path / "model", bytes(data[: generator.choice((len(data), generator.randrange(len(data))))]))
        try:
            loaded = AirVelocityModel.from_state(load_arrays(tmp_path / "model"))
        except (UserError, KeyError):
            refused += 1
            continue
        speeds = np.linalg.norm([loaded.predict(one)[0] for one in epochs[::10]], axis=1)
        assert speeds.max() < 1000.0
    assert refused > 100
