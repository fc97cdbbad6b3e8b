"""``train``: an archive of flights as one file, resumable, honest about what it is worth, and never of two classes."""

import csv
import os
import signal
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.airframe import FORMS
from nav_pose_estimator.core.motion.vehicle_class import MULTIROTOR
from nav_pose_estimator.engine.outage.airframe_file import load_airframe
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.kept import KeptResults
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.simulated_bag import write_recording
from nav_pose_estimator.offline.training import flights, work
from nav_pose_estimator.offline.training.flights import FlightData, Reading, Recorded, digest_of, fly
from nav_pose_estimator.sim.scenarios import generate

SECONDS = {"quad_1": 130.0, "quad_2": 110.0, "wing": 110.0}
HAS_JAX = find_spec("jax") is not None


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[str, Path]:
    """Two flights of a multirotor and one of a wing."""
    folder = tmp_path_factory.mktemp("archive") / "bags"
    scenarios = {"quad_1": ("multirotor_light", 3), "quad_2": ("laps", 4), "wing": ("fixed_wing", 3)}
    for name, (scenario, seed) in scenarios.items():
        write_recording(folder / name, generate(scenario, SECONDS[name], seed, imu_rate=50.0))
    return {name: folder / name for name in scenarios}


@pytest.fixture(scope="module")
def flown(bags) -> dict[str, FlightData]:
    """What the three of them give by key, so that no test flies them again."""
    return {one.key: fly(one) for one in work.identify(list(bags.values()), READING)}


READING = Reading(gnss_delay="0")
QUADS = ("--class", MULTIROTOR)
HOVERS = np.where((np.arange(me.COLUMNS) >= me.BODY_VELOCITY) & (np.arange(me.COLUMNS) < me.FORCE), 0.1, 1.0)
"""Factors that leave a tenth of the velocities in an epoch."""


def train(flown: dict[str, FlightData], out: Path, *arguments: object) -> int:
    """The command, with what all flights give in place."""
    kept = KeptResults(out)
    for key, data in flown.items():
        kept.keep(key, data)
    return main(["train", *map(str, arguments), "--out", str(out), "--gnss-delay", "0"])


def left_beside(out: Path) -> list[Path]:
    """Files of a run that has not ended."""
    return list(out.parent.glob(f".{out.name}*/*"))


@pytest.mark.compiled
def test_an_archive_becomes_a_file_and_a_table(bags, flown, tmp_path, capsys) -> None:
    """GIVEN two flights WHEN trained THEN the file knows class, flights and digests, and the table leaves each flight
    out and shows it beside its own law."""
    out = tmp_path / "quad.airframe"
    assert train(flown, out, bags["quad_1"], bags["quad_2"], "--one-aircraft", *QUADS) == 0
    airframe = load_airframe(out)
    assert (airframe.vehicle_class, airframe.is_one_aircraft, airframe.network) == (MULTIROTOR, True, None)
    assert [(one.name, one.digest) for one in airframe.flights] == [
        (name, digest_of(bags[name])) for name in ("quad_1", "quad_2")
    ]
    assert all(60.0 < one.seconds <= SECONDS[one.name] for one in airframe.flights)
    assert airframe.archive.seconds == pytest.approx(sum(one.seconds for one in airframe.flights), abs=0.2)
    said, noted = capsys.readouterr()
    assert "--one-aircraft" not in noted
    assert "own flight" in said
    assert "own + archive" in said
    assert [line.split()[0] for line in said.splitlines()[2:5]] == ["quad_1", "quad_2", "all"]
    assert not left_beside(out)


@pytest.mark.compiled
def test_what_was_flown_is_not_flown_again(bags, flown, tmp_path, monkeypatch) -> None:
    """GIVEN a run that was killed when one of two flights was done WHEN run again THEN only the other is flown, and one
    whose result is damaged."""
    out = tmp_path / "a.airframe"
    one, two = work.identify([bags["quad_1"], bags["quad_2"]], READING)
    again = []
    monkeypatch.setattr(flights, "fly", lambda recorded: again.append(recorded.path) or flown[recorded.key])
    assert train({one.key: flown[one.key]}, out, bags["quad_1"], bags["quad_2"], *QUADS) == 0
    assert again == [bags["quad_2"]]

    KeptResults(out).keep(two.key, flown[two.key])
    (file,) = left_beside(out)
    file.write_bytes(file.read_bytes()[:1000])
    assert train({one.key: flown[one.key]}, out, bags["quad_1"], bags["quad_2"], "--force", *QUADS) == 0
    assert again == [bags["quad_2"]] * 2
    changed = Reading(gnss_delay="0.1")
    assert work.identify([bags["quad_1"]], changed)[0].key != one.key, "read otherwise, it is flown anew"


@pytest.mark.compiled
def test_a_worker_that_is_killed_loses_nothing(bags, flown, tmp_path, monkeypatch, capsys) -> None:
    """GIVEN two processes WHEN one is killed in the middle of a flight THEN the flight is flown again, and the file is
    the one of a quiet run."""
    quiet, disturbed = tmp_path / "quiet.airframe", tmp_path / "disturbed.airframe"
    assert train(flown, quiet, bags["quad_1"], bags["quad_2"], *QUADS) == 0
    monkeypatch.setenv(VICTIM, str(tmp_path / "was_killed"))
    monkeypatch.setattr(flights, "fly", fly_and_die_once)
    assert train({}, disturbed, bags["quad_1"], bags["quad_2"], *QUADS, "--jobs", 2) == 0
    assert (tmp_path / "was_killed").exists()
    assert "left out" not in capsys.readouterr().err
    assert disturbed.read_bytes() == quiet.read_bytes()


VICTIM = "TEST_TRAIN_VICTIM"


def fly_and_die_once(recorded: Recorded) -> FlightData:
    """The first process that gets here is killed."""
    with suppress(FileExistsError):
        Path(os.environ[VICTIM]).touch(exist_ok=False)
        os.kill(os.getpid(), signal.SIGKILL)
    return fly(recorded)


@pytest.mark.compiled
def test_what_cannot_be_read_is_named_and_left_out(bags, flown, tmp_path, capsys) -> None:
    """GIVEN a list with a flight and a file that is no log WHEN trained THEN the flight alone is in the file."""
    out = tmp_path / "quad.airframe"
    (tmp_path / "words.ulg").write_text("no log")
    (tmp_path / "flights.txt").write_text(f"{bags['quad_1']}\nwords.ulg\n")
    assert train(flown, out, tmp_path / "flights.txt", *QUADS) == 0
    said = capsys.readouterr()
    assert "words.ulg is left out: " in said.err
    assert "with one flight nothing shows what the file is worth to another one" in said.err
    assert "multirotor, 1 flight, " in said.out
    assert [one.name for one in load_airframe(out).flights] == ["quad_1"]


@pytest.mark.compiled
def test_classes_are_not_mixed(bags, flown, tmp_path, capsys) -> None:
    """GIVEN a multirotor and a wing WHEN trained together THEN the command names both and writes nothing."""
    out = tmp_path / "both.airframe"
    assert train(flown, out, bags["quad_1"], bags["wing"]) == 2
    said = capsys.readouterr().err
    assert "multirotor (quad_1)" in said
    assert "fixed_wing (wing)" in said
    assert not out.exists()
    hovers = {key: replace(data, epochs=data.epochs * HOVERS) for key, data in flown.items()}
    assert train(hovers, out, bags["quad_1"]) == 2
    assert "quad_1 does not show by its motion what flew: say it with --class" in capsys.readouterr().err
    assert train(flown, out, bags["wing"], "--class", MULTIROTOR) == 0
    assert "note: wing moves like a fixed_wing" in capsys.readouterr().err


@pytest.mark.compiled
def test_merging_files_is_training_on_all_flights(bags, flown, tmp_path, capsys) -> None:
    """GIVEN the files of two flights WHEN merged THEN the sums are those of both together; nothing counts twice."""
    together, one, two, merged = (tmp_path / f"{name}.airframe" for name in ("together", "one", "two", "merged"))
    assert train(flown, together, bags["quad_1"], bags["quad_2"], *QUADS) == 0
    assert train(flown, one, bags["quad_1"]) == 0
    assert "give --one-aircraft" in capsys.readouterr().err
    assert train(flown, two, bags["quad_2"], *QUADS) == 0
    assert train(flown, merged, one, two) == 0
    for name in ("gram", "moment", "seconds"):
        expected = getattr(load_airframe(together).archive, name)
        np.testing.assert_allclose(getattr(load_airframe(merged).archive, name), expected, rtol=1e-9, atol=1e-12)
    capsys.readouterr()
    assert train(flown, tmp_path / "twice.airframe", one, merged) == 2
    assert "would count twice" in capsys.readouterr().err
    assert train(flown, tmp_path / "same.airframe", one, bags["quad_1"], bags["quad_1"]) == 0
    assert load_airframe(tmp_path / "same.airframe").archive.seconds == load_airframe(one).archive.seconds


@pytest.mark.compiled
def test_the_benchmark_flies_with_a_file_and_says_what_it_was_made_of(bags, flown, tmp_path, capsys) -> None:
    """GIVEN a file of one flight WHEN outages begin 20 s after take-off THEN ``best`` with it is not ``best`` without
    it, and a flight that went into the file is named."""
    out = tmp_path / "quad.airframe"
    assert train(flown, out, bags["quad_1"], "--one-aircraft") == 0
    options = ["--lengths", "30", "--every", "100", "--first", "20", "--methods", "best", "--gnss-delay", "0"]
    errors = {}
    for name, more in (("with", ["--airframe", str(out)]), ("without", [])):
        both = [str(bags["quad_2"]), str(bags["quad_1"])] if more else [str(bags["quad_2"])]
        assert main(["benchmark", "outage", *both, *options, *more, "--out", str(tmp_path / name)]) == 0
        with (tmp_path / name / "outages.csv").open() as file:
            errors[name] = [float(row["end_error_m"]) for row in csv.DictReader(file) if row["bag"] == "quad_2"]
    said = capsys.readouterr().err
    assert f"was made of {bags['quad_1']}" in said
    assert f"was made of {bags['quad_2']}" not in said
    assert np.isfinite(errors["with"]).all()
    assert errors["with"] != errors["without"]


def test_bad_use_is_one_sentence(tmp_path, capsys) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "folder.airframe").mkdir()
    (tmp_path / "there.airframe").touch()
    (tmp_path / "words.ulg").write_text("no log")
    wrong = {
        "must end in .airframe": ["x.ulg", "--out", tmp_path / "a.npz"],
        "exists already": ["x.ulg", "--out", tmp_path / "there.airframe"],
        "is a folder": ["x.ulg", "--force", "--out", tmp_path / "folder.airframe"],
        "is no folder": ["x.ulg", "--out", tmp_path / "no" / "a.airframe"],
        "nothing.ulg": [tmp_path / "nothing.ulg", "--out", tmp_path / "a.airframe"],
        "holds no recording": [tmp_path / "empty", "--out", tmp_path / "a.airframe"],
        "there.airframe is not an airframe": [tmp_path / "there.airframe", "--out", tmp_path / "a.airframe"],
        "there.airframe is one of the files to learn from": [
            tmp_path / "there.airframe",
            "--force",
            "--out",
            tmp_path / "there.airframe",
        ],
        "none of the recordings can be used": [tmp_path / "words.ulg", "--out", tmp_path / "a.airframe"],
        "--folds at least 2": ["x.ulg", "--folds", 1, "--out", tmp_path / "a.airframe"],
    }
    for sentence, arguments in wrong.items():
        assert main(["train", *map(str, arguments)]) == 2
        assert sentence in capsys.readouterr().err
    assert not left_beside(tmp_path / "a.airframe")


@pytest.mark.compiled
def test_recordings_are_found_in_folders_and_by_patterns(bags, tmp_path) -> None:
    folder = next(iter(bags.values())).parent
    assert work.find_recordings([str(folder)]) == (sorted(bags.values()), [])
    assert work.find_recordings([str(folder / "quad_*")]) == ([bags["quad_1"], bags["quad_2"]], [])
    assert work.find_recordings([str(bags["wing"]), str(folder)])[0][0] == bags["wing"]
    (tmp_path / "words.ulg").write_text("no log")
    (tmp_path / "old.airframe").touch()
    found = work.find_recordings([str(tmp_path), str(bags["wing"])])
    assert found == ([tmp_path / "words.ulg", bags["wing"]], [tmp_path / "old.airframe"])
    with pytest.raises(UserError, match=r"missing\.ulg"):
        work.find_recordings([str(tmp_path / "missing.ulg")])


@pytest.mark.skipif(HAS_JAX, reason="JAX is installed here")
def test_without_jax_it_is_said_how_to_get_it(tmp_path, capsys) -> None:
    assert main(["train", "x.ulg", "--network", "--out", str(tmp_path / "a.airframe")]) == 2
    assert "run 'make train-setup'" in capsys.readouterr().err


@pytest.mark.compiled
@pytest.mark.skipif(not HAS_JAX, reason="JAX is not installed here (make train-setup)")
@pytest.mark.parametrize("form", FORMS)
def test_a_network_is_trained_beside_its_control(bags, flown, tmp_path, capsys, form) -> None:
    """GIVEN two flights and few steps WHEN trained THEN the file flies, and the table has network and control."""
    out = tmp_path / "quad.airframe"
    options = ["--network", "--form", form, "--steps", 40, "--folds", 2, *QUADS]
    assert train(flown, out, bags["quad_1"], bags["quad_2"], *options) == 0
    said = capsys.readouterr().out
    assert "+ network" in said
    assert "+ untrained" in said
    network = load_airframe(out).network
    assert network.form == form
    window = next(iter(flown.values())).windows[50].astype(float)
    assert not np.allclose(network.velocity(window), network.untrained.velocity(window))
