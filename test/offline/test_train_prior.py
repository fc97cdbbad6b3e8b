"""``train prior``: how vehicles usually move, from flights of several airframes, each of which counts once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flown import Flight
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.regimes import Decisions
from nav_pose_estimator.engine.outage.methods.usual_file import load_usual_motion
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.simulated_bag import write_recording
from nav_pose_estimator.offline.training.prior import PriorFlight, fit
from nav_pose_estimator.sim.scenarios import generate


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> list[str]:
    """A multirotor that stops now and then, another one of other ways, and a wing."""
    folder = tmp_path_factory.mktemp("prior")
    flights = {"quad_1": ("multirotor_light", 3), "laps_1": ("laps", 4), "wing_1": ("fixed_wing", 3)}
    for name, (scenario, seed) in flights.items():
        write_recording(folder / f"{name}_bag", generate(scenario, 80.0, seed, imu_rate=50.0))
    return [str(folder / f"{name}_bag") for name in flights]


@pytest.mark.compiled
def test_recordings_become_a_readable_file_that_says_where_it_comes_from(bags, tmp_path, capsys) -> None:
    """GIVEN flights of three airframes WHEN trained with one left out THEN the file is one that learner.prior takes,
    and it names the others with their digests."""
    out = tmp_path / "usual.toml"
    assert main(["train", "prior", *bags, "--leave-out", "laps_1", "--gnss-delay", "0", "--out", str(out)]) == 0
    assert "2 flights of 2 airframes" in capsys.readouterr().out
    usual, text = load_usual_motion(str(out)), out.read_text()
    assert usual.multirotor.speed < 8.0 < usual.fixed_wing.speed
    assert 'name = "quad_1"' in text
    assert "laps_1" not in text
    assert text.count("sha256") == 2


def test_what_cannot_be_left_out_or_replaced_is_said(bags, tmp_path, capsys) -> None:
    out = tmp_path / "usual.toml"
    assert main(["train", "prior", *bags, "--leave-out", "laps_9", "--out", str(out)]) == 2
    assert "none of the recordings" in capsys.readouterr().err
    out.write_text("mine")
    assert main(["train", "prior", *bags, "--out", str(out)]) == 2
    assert out.read_text() == "mine"


def flight(name: str, group: str, speed: float, hover: float, missed: float = 0.0) -> PriorFlight:
    epochs = Flight(seconds=200.0, speed=speed, hover=hover).epochs()
    return PriorFlight(name, group, "", epochs, Decisions(100.0, missed))


def test_every_airframe_counts_once() -> None:
    """GIVEN a fast and a slow multirotor WHEN one of them has three recordings THEN the mean is the same."""
    slow, fast, wing = flight("a", "a", 3.0, 0.3, 10.0), flight("b", "b", 9.0, 0.3, 30.0), flight("w", "w", 30.0, 0.0)
    wing.epochs[:, me.VELOCITY] += 20.0
    once = fit([slow, fast, wing])
    thrice = fit([slow, fast, flight("b2", "b", 9.0, 0.3, 30.0), flight("b3", "b", 9.0, 0.3, 30.0), wing])
    assert thrice.multirotor.speed == pytest.approx(once.multirotor.speed)
    assert once.hover.missed == pytest.approx(0.2)
    alone = fit([slow, wing]).multirotor.speed, fit([fast, wing]).multirotor.speed
    assert once.multirotor.speed == pytest.approx(np.sqrt(np.mean(np.square(alone))))


def test_a_wing_that_waited_on_the_ground_can_be_named() -> None:
    """GIVEN a wing that stood about WHEN it is named as one THEN it does not count as a multirotor."""
    slow, wing, waiting = flight("a", "a", 3.0, 0.3), flight("w", "w", 30.0, 0.0), flight("v", "v", 20.0, 0.5)
    wing.epochs[:, me.VELOCITY] += 20.0
    assert fit([slow, wing, replace(waiting, is_wing=True)]).multirotor == fit([slow, wing]).multirotor
    assert fit([slow, wing, waiting]).multirotor != fit([slow, wing]).multirotor


def test_both_kinds_are_needed() -> None:
    with pytest.raises(UserError, match="at least one multirotor and one fixed wing"):
        fit([flight("a", "a", 3.0, 0.3)])


def test_only_recordings_make_a_prior(capsys, tmp_path) -> None:
    assert main(["train", "prior", "--out", str(Path(tmp_path) / "usual.toml")]) == 2
    assert "several of different airframes" in capsys.readouterr().err
