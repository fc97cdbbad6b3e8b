"""``benchmark outage --cross-validate``: no flight is measured with a prior of motion that was made of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flown import Flight
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.regimes import Decisions
from nav_pose_estimator.engine.outage.methods.usual_file import flights_of, load_usual_motion
from nav_pose_estimator.offline.benchmarks.outage import held_out_priors
from nav_pose_estimator.offline.benchmarks.outage.held_out_priors import Workers, with_held_out_priors
from nav_pose_estimator.offline.benchmarks.outage.trials import Task
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.simulated_bag import write_recording
from nav_pose_estimator.offline.training.flights import digest_of
from nav_pose_estimator.offline.training.prior import PriorFlight, fit, text_of
from nav_pose_estimator.sim.scenarios import generate


def motion(name: str, speed: float, hover: float = 0.3, faster: float = 0.0) -> PriorFlight:
    epochs = Flight(seconds=200.0, speed=speed, hover=hover).epochs()
    epochs[:, me.VELOCITY] += faster
    epochs[:, me.POSITION] = np.cumsum(epochs[:, me.VELOCITY + 1]) * me.PERIOD / 6.4e6
    epochs[:, me.POSITION + 1] = np.cumsum(epochs[:, me.VELOCITY]) * me.PERIOD / 6.4e6
    return PriorFlight(name, name, "", epochs, Decisions(100.0, 10.0))


@pytest.fixture
def archive(tmp_path, monkeypatch) -> dict[str, PriorFlight]:
    """Two multirotors and two wings, one of which stood about first, with their recordings and a prior of them all."""
    flights = [motion("slow", 3.0), motion("fast", 9.0), motion("wing", 30.0, 0.0, 20.0), motion("waiting", 20.0, 0.5)]
    found = {}
    for one in flights:
        path = tmp_path / f"{one.name}_bag"
        path.write_text(one.name)
        found[one.name] = replace(one, digest=digest_of(path), is_wing=one.name == "waiting")
    (tmp_path / "all.toml").write_text(text_of(fit(list(found.values())), list(found.values())))
    config = "/**:\n  ros__parameters:\n    learner.prior: all.toml\n"
    (tmp_path / "config.yaml").write_text(config)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(held_out_priors, "fly", lambda one: replace(found[one.path.stem[:-4]], is_wing=False))
    return found


def tasks_of(*names: str) -> tuple[list[Task], dict[str, str]]:
    tasks = [
        Task(Path(f"{name}_bag"), method, (), (10.0,), 20.0, config=Path("config.yaml"))
        for name in names
        for method in ("best", "coast")
    ]
    return tasks, {f"{name}_bag": name for name in names}


def held_out(*names: str) -> dict[str, Path | None]:
    tasks, groups = tasks_of(*names)
    found = with_held_out_priors(tasks, groups, Path("priors"), Workers(1, "local", Path("out")))
    assert [replace(task, prior=None) for task in found] == tasks
    return {groups[task.bag.name]: task.prior for task in found}


def test_every_flight_gets_the_prior_of_all_the_others(archive) -> None:
    """GIVEN a prior made of four flights WHEN each is held out THEN its prior is the fit of the other three."""
    for name, path in held_out(*archive).items():
        others = [flight for flight in archive.values() if flight.name != name]
        assert path is not None
        expected = fit(others)
        assert load_usual_motion(str(path)).multirotor.speed == pytest.approx(expected.multirotor.speed, abs=1e-3)
        assert load_usual_motion(str(path)).fixed_wing.speed == pytest.approx(expected.fixed_wing.speed, abs=1e-3)
        assert {one.airframe for one in flights_of(str(path))} == {flight.name for flight in others}


def kinds(path: Path | None) -> dict[str, str]:
    return {one.airframe: one.kind for one in flights_of(str(path))}


def test_a_wing_stays_one_though_its_flight_would_hide_it(archive) -> None:
    """GIVEN a wing that stood about, which the prior was told WHEN it helps to make another prior THEN as a wing."""
    found = kinds(held_out(*archive)["slow"])
    assert found == {"fast": "multirotor", "wing": "fixed_wing", "waiting": "fixed_wing"}


def test_a_flight_that_the_prior_has_never_seen_flies_with_it(archive, monkeypatch) -> None:
    """GIVEN a recording that the prior was not made of THEN nothing is flown for it, and its prior stays."""
    Path("new_bag").write_text("new")
    monkeypatch.setattr(held_out_priors, "fly", lambda *_: pytest.fail("flown for nothing"))
    assert held_out("new") == {"new": None}


def test_other_recordings_of_an_airframe_that_was_seen_count_as_seen(archive) -> None:
    """GIVEN another IMU's recording of a flight that the prior was made of THEN it does not fly with that prior."""
    Path("slow_bag").write_text("another IMU")
    assert held_out(*archive)["slow"] is not None


def test_too_few_others_are_said(archive, capsys) -> None:
    """GIVEN a single flight that the prior was made of THEN its figures are said to be no test."""
    assert held_out("slow") == {"slow": None}
    assert "no test of the prior" in capsys.readouterr().err


@pytest.mark.compiled
def test_the_benchmark_flies_and_leaves_the_priors_behind(tmp_path, capsys) -> None:
    """GIVEN three short flights and a prior of them WHEN cross-validated THEN the folder holds the prior that each was
    flown with, and it is that of ``train prior --leave-out``."""
    flights = {"quad": ("multirotor_light", 3), "laps": ("laps", 4), "wing": ("fixed_wing", 3)}
    bags = [str(tmp_path / f"{name}_bag") for name in flights]
    for bag, (scenario, seed) in zip(bags, flights.values(), strict=True):
        write_recording(Path(bag), generate(scenario, 80.0, seed, imu_rate=50.0))
    both, without = tmp_path / "all.toml", tmp_path / "without_laps.toml"
    common = ["--gnss-delay", "0"]
    assert main(["train", "prior", *bags, *common, "--out", str(both)]) == 0
    (tmp_path / "config.yaml").write_text(f"/**:\n  ros__parameters:\n    learner.prior: {both}\n")
    common += ["--config", str(tmp_path / "config.yaml")]
    assert main(["train", "prior", *bags, *common, "--leave-out", "laps", "--out", str(without)]) == 0
    options = ["--lengths", "5", "--every", "60", "--first", "30", "--methods", "best", "--cross-validate"]
    capsys.readouterr()
    assert main(["benchmark", "outage", *bags, *common, *options, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    (made,) = (tmp_path / "out" / "priors").glob("without_laps_*.toml")
    assert made.read_text() == without.read_text()
    assert f"laps: prior of motion from 2 other airframes, {made.name}" in said.out
    assert said.err.count("no test of the prior") == 1  # there is one wing only
