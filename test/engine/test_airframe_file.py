"""NAME.airframe: data that people share, so nothing in it is believed before it was looked at."""

import hashlib
import io
import json
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airframes import FIXED_WING, FORMS, MULTIROTOR, WHEELS, airframe
from nav_pose_estimator.core.motion.airframe import Airframe, PastFlight
from nav_pose_estimator.engine import array_file
from nav_pose_estimator.engine.outage.airframe_file import KIND, load_airframe, save_airframe
from nav_pose_estimator.engine.outage.learner import OutageLearner
from nav_pose_estimator.engine.outage.model_file import load_arrays
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.errors import UserError

VELOCITY_FORM = FORMS[0]


@pytest.fixture(scope="module")
def known() -> Airframe:
    return airframe(form=VELOCITY_FORM)


@pytest.fixture
def arrays(known, tmp_path) -> dict[str, np.ndarray]:
    """What the file of a sound airframe holds."""
    save_airframe(tmp_path / "sound.airframe", known)
    return array_file.load(tmp_path / "sound.airframe", KIND)


@pytest.mark.parametrize("form", [None, *FORMS])
@pytest.mark.parametrize("vehicle_class", [MULTIROTOR, FIXED_WING, WHEELS])
def test_an_airframe_is_the_same_after_a_trip_through_a_file(tmp_path, vehicle_class, form) -> None:
    before = airframe(vehicle_class, form=form)
    save_airframe(tmp_path / "a.airframe", before)
    after = load_airframe(tmp_path / "a.airframe")
    assert (after.vehicle_class, after.is_one_aircraft, after.flights) == (vehicle_class, True, before.flights)
    for name in ("gram", "moment", "noise", "wind_spread", "seconds"):
        np.testing.assert_array_equal(getattr(after.archive, name), getattr(before.archive, name))
    assert (after.network is None) == (form is None)
    if after.network is not None:
        window = np.random.default_rng(1).normal(size=(50, 9))
        np.testing.assert_array_equal(after.network.velocity(window), before.network.velocity(window))
        np.testing.assert_array_equal(
            after.network.untrained.velocity(window), before.network.untrained.velocity(window)
        )


def changed(about: np.ndarray, **values) -> np.ndarray:
    content = json.loads(about.tobytes()) | values
    return np.frombuffer(json.dumps(content).encode(), np.uint8)


ABSURD = {
    "a class that does not exist": lambda a: {"about": changed(a["about"], **{"class": "dragon"})},
    "a form that does not exist": lambda a: {"about": changed(a["about"], form="verse")},
    "the other form": lambda a: {"about": changed(a["about"], form=FORMS[1])},
    "no list of flights": lambda a: {"about": changed(a["about"], flights="all")},
    "a flight without digest": lambda a: {"about": changed(a["about"], flights=[["a", "", 1.0]])},
    "a flight of text": lambda a: {"about": changed(a["about"], flights=[["a", "0" * 64, "long"]])},
    "a name with control characters": lambda a: {"about": changed(a["about"], flights=[["\x1b[2J", "0" * 64, 1.0]])},
    "a number for what made it": lambda a: {"about": changed(a["about"], made_with=1)},
    "no JSON": lambda a: {"about": np.frombuffer(b"{", np.uint8)},
    "NaN": lambda a: {"archive.moment": np.full_like(a["archive.moment"], np.nan)},
    "a law faster than any vehicle": lambda a: {"archive.moment": 1e3 * a["archive.moment"]},
    "a gram of another size": lambda a: {"archive.gram": np.eye(9)},
    "a gram that is not one": lambda a: {"archive.gram": -a["archive.gram"]},
    "a gram that is not symmetric": lambda a: {"archive.gram": a["archive.gram"] + np.triu(np.ones((10, 10)), 1)},
    "no noise": lambda a: {"archive.noise": np.zeros(3)},
    "a hurricane": lambda a: {"archive.wind_spread": np.array(1e5)},
    "no flight at all": lambda a: {"archive.seconds": np.array(0.0)},
    "stacked equations that are absurd": lambda a: {"stacked.moment": 1e4 + a["stacked.moment"]},
    "weights beyond reason": lambda a: {"network.head_weight": 1e9 * a["network.head_weight"]},
    "text for numbers": lambda a: {"archive.gram": np.full((10, 10), "1")},
}


def test_a_file_that_does_not_say_what_made_it_is_flown(arrays, tmp_path) -> None:
    """GIVEN a file of a version that did not write it WHEN loaded THEN only that is missing."""
    about = json.loads(arrays["about"].tobytes())
    del about["made_with"]
    array_file.save(
        tmp_path / "old.airframe", KIND, arrays | {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)}
    )
    assert load_airframe(tmp_path / "old.airframe").made_with == ""


@pytest.mark.parametrize("what", ABSURD)
def test_what_no_flights_yield_is_refused(arrays, tmp_path, what) -> None:
    """GIVEN a file with a right checksum WHEN it says what cannot be THEN it is refused in one sentence."""
    path = tmp_path / "absurd.airframe"
    array_file.save(path, KIND, arrays | ABSURD[what](arrays))
    with pytest.raises(UserError, match=r"absurd\.airframe: .*; the file is not used$"):
        load_airframe(path)


@pytest.mark.parametrize("name", ["about", "archive.gram", "stacked.noise", "control.seconds"])
def test_a_part_that_is_missing_is_named(arrays, tmp_path, name) -> None:
    array_file.save(tmp_path / "part.airframe", KIND, {key: value for key, value in arrays.items() if key != name})
    with pytest.raises(UserError, match=r"part\.airframe is not a whole airframe file|missing"):
        load_airframe(tmp_path / "part.airframe")


def write(path: Path, body: bytes, version: int = 1) -> None:
    header = f"nav_pose_estimator airframe {version}\n{hashlib.sha256(body).hexdigest()}\n"
    path.write_bytes(header.encode() + body)


def test_damaged_newer_and_foreign_files_are_told_apart(known, tmp_path) -> None:
    path = tmp_path / "a.airframe"
    save_airframe(path, known)
    content = path.read_bytes()
    path.write_bytes(content[:-7])
    with pytest.raises(UserError, match="damaged: its checksum"):
        load_airframe(path)
    write(path, b"", version=2)
    with pytest.raises(UserError, match=r"version 2, this program reads up to 1: update it"):
        load_airframe(path)
    path.write_bytes(b"PK\x03\x04")
    with pytest.raises(UserError, match="not an airframe"):
        load_airframe(path)
    with pytest.raises(UserError, match="cannot read the airframe"):
        load_airframe(tmp_path / "nowhere.airframe")
    path.write_bytes(content)
    with pytest.raises(UserError, match="not a model"):
        load_arrays(path)


def test_a_pickled_object_is_never_loaded(tmp_path) -> None:
    """GIVEN a file whose array is a pickle that would act when loaded WHEN read THEN it is refused and nothing acts."""

    class Bad:
        def __reduce__(self):
            return (tmp_path / "acted").touch, ()

    buffer = io.BytesIO()
    np.savez(buffer, about=np.array([Bad()], dtype=object))
    write(tmp_path / "a.airframe", buffer.getvalue())
    with pytest.raises(UserError, match="damaged"):
        load_airframe(tmp_path / "a.airframe")
    assert not (tmp_path / "acted").exists()


def test_mutated_files_are_refused_or_sound(known, tmp_path) -> None:
    """150 seeded mutations with a right checksum: one sentence, or an airframe whose law is a vehicle's."""
    generator = random.Random(7)
    save_airframe(tmp_path / "a.airframe", known)
    body = (tmp_path / "a.airframe").read_bytes().split(b"\n", 2)[2]
    for _ in range(150):
        mutated = bytearray(body)
        for _ in range(generator.choice((1, 1, 4))):
            mutated[generator.randrange(len(body))] = generator.randrange(256)
        write(tmp_path / "b.airframe", bytes(mutated))
        try:
            found = load_airframe(tmp_path / "b.airframe")
        except UserError:
            continue
        assert np.isfinite(found.archive.gram).all()
        assert np.abs(found.network.velocity(np.ones((50, 9)))).max() <= 100.0


def test_what_would_be_refused_is_not_written(known, tmp_path) -> None:
    with pytest.raises(UserError, match="is not written: its list of flights"):
        save_airframe(tmp_path / "a.airframe", replace(known, flights=(PastFlight("n" * 10**5, "0" * 64, 1.0),)))
    assert not (tmp_path / "a.airframe").exists()


# --- parameters ------------------------------------------------------------------------------------------------------


def test_the_class_of_file_and_parameter_must_agree(known, tmp_path) -> None:
    path = tmp_path / "a.airframe"
    save_airframe(path, known)
    OutageLearner(LearnerParameters(airframe=str(path), vehicle_class=MULTIROTOR))
    with pytest.raises(UserError, match=r"vehicle_class is fixed_wing, but .* is of a multirotor"):
        OutageLearner(LearnerParameters(airframe=str(path), vehicle_class=FIXED_WING))


def test_the_file_is_read_once(known, tmp_path) -> None:
    """GIVEN a learner in flight WHEN the file vanishes THEN copies do without it."""
    path = tmp_path / "a.airframe"
    save_airframe(path, known)
    learner = OutageLearner(LearnerParameters(airframe=str(path)))
    path.unlink()
    assert learner.copy().method.beforehand is learner.method.beforehand


def test_a_network_is_asked_for_where_the_method_flies_one(known, tmp_path) -> None:
    with pytest.raises(UserError, match=r"name a file of train --network in learner\.airframe"):
        OutageLearner(LearnerParameters(method="cnn_lstm"))
    save_airframe(tmp_path / "a.airframe", replace(known, network=None))
    with pytest.raises(UserError, match=r"name a file of train --network in learner\.airframe"):
        OutageLearner(LearnerParameters(method="cnn_lstm", airframe=str(tmp_path / "a.airframe")))
