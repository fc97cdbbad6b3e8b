"""``benchmark beams``: what isolating beams is worth, the command, its goals and its refusals."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import BeamVelocitySample, GnssFix, GnssVelocity, SatelliteCount, stamp_of
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.benchmarks.beams.cases import CASES, GOALS, MOUNTING_GOALS
from nav_pose_estimator.offline.benchmarks.beams.methods import METHODS, RECOMMENDED, TABLE
from nav_pose_estimator.offline.benchmarks.beams.report import text_tables
from nav_pose_estimator.offline.benchmarks.beams.summary import judged, summarise
from nav_pose_estimator.offline.benchmarks.beams.trial import Trial, run_seed, without_gnss
from nav_pose_estimator.offline.benchmarks.simulated import run_all
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.sim.beam_faults import PLANS
from nav_pose_estimator.sim.scenarios import START_NS, generate

SHORT = replace(CASES["auv"], aided=240.0)
FLOWN = {
    (RECOMMENDED,): ("none", "bias", "all lost", "outliers"),
    ("fixed", "anfis_frcg"): ("bias",),
    ("text", "always"): ("none",),
}
"""Methods -> the faults that they are judged by here."""


def trial(seed: int, percent: float, method: str = RECOMMENDED, fault: str = "bias", faulty: float = 1.0) -> Trial:
    return Trial("auv", fault, method, seed, percent * 9.0, 900.0, percent, 0.01, 0.1, 0.05, 1.0, 0.001, faulty)


@pytest.fixture(scope="module")
def short() -> dict[tuple[str, str], Trial]:
    """Two minutes without GNSS after four with it, by fault and method."""
    trials = [t for methods, faults in FLOWN.items() for t in run_seed(SHORT, 60, faults, methods, 120.0)]
    return {(t.fault, t.method): t for t in trials}


def test_a_small_table_by_hand():
    (row,) = summarise([trial(0, 0.03), trial(1, 0.04), trial(2, 0.12, faulty=math.nan)])
    assert row.percent_median == pytest.approx(0.04)
    assert row.percent_rms == pytest.approx(math.sqrt((0.03**2 + 0.04**2 + 0.12**2) / 3.0))
    assert row.refused_faulty == 1.0
    assert row.trials == 3
    assert "0.040 / 0.075" in text_tables([row], [])


def test_goals_can_be_missed():
    good = {row[2]: row[-1] for row in judged(summarise([trial(0, 0.06), trial(1, 0.06)]))}
    assert good == {"median, %": "met", "RMS, %": "met", "NEES": "met", "faulty refused": "met"}
    bad = {row[2]: row[-1] for row in judged(summarise([trial(0, 0.06, faulty=0.5), trial(1, 0.30, faulty=0.5)]))}
    assert bad == {"median, %": "missed", "RMS, %": "missed", "NEES": "met", "faulty refused": "missed"}
    assert judged(summarise([trial(0, 0.06, "fixed")])) == []
    assert judged(summarise([trial(0, 0.06)]), 700.0) == []


def test_goals_of_a_long_dive_and_of_a_turned_sensor():
    """GIVEN 0.08 % of the distance THEN it is too much for a long dive, and allowed with a mounting of which nobody
    told, which is known to 0.05 deg."""
    rows = summarise([trial(0, 0.08)])
    assert {row[2]: row[-1] for row in judged(rows, 3000.0)}["median, %"] == "missed"
    turned = {row[2]: row[-1] for row in judged(rows, is_turned=True)}
    assert (turned["median, %"], turned["mounting, deg"]) == ("met", "met")
    mixed = {row[2]: row[-1] for row in judged(summarise([trial(0, 0.08, fault="mixed")]))}
    assert mixed["velocity, m/s"] == "met"


def test_goals_are_for_cases_and_faults_that_exist():
    assert {case for goals in GOALS.values() for case, _ in goals} <= set(CASES) == set(MOUNTING_GOALS)
    assert {fault for goals in GOALS.values() for _, fault in goals} <= set(PLANS)
    assert set(TABLE) <= set(METHODS)


def test_nothing_of_gnss_is_left_after_its_loss():
    recording = generate(SHORT.scenario_for(30.0, 0.0), 20.0, seed=1)
    lost_ns = START_NS + 10_000_000_000
    kinds = (GnssFix, GnssVelocity, SatelliteCount)
    late = [timed for timed in without_gnss(recording, lost_ns).others if timed.arrival_ns > lost_ns + 10_000_000]
    assert not [timed for timed in late if isinstance(timed.sample, kinds)]
    assert [timed for timed in late if isinstance(timed.sample, BeamVelocitySample)]
    early = [timed for timed in recording.others if (stamp_of(timed.sample) or timed.arrival_ns) < lost_ns]
    assert early == without_gnss(recording, lost_ns).others[: len(early)]


def test_a_faulty_beam_costs_nothing_where_it_is_refused(short: dict[tuple[str, str], Trial]):
    """GIVEN a fault of 0.3 m/s THEN the judge refuses it and the drift stays; a filter that believes it drifts away."""
    sound, wrong = short["none", RECOMMENDED], short["bias", RECOMMENDED]
    assert wrong.refused_faulty > 0.97
    assert sound.refused_healthy < 0.02
    assert math.isnan(sound.refused_faulty)
    assert wrong.end_error_m < sound.end_error_m + 0.5
    assert short["bias", "fixed"].end_error_m > 5.0 * wrong.end_error_m
    assert short["bias", "fixed"].nees > 20.0


def test_single_wrong_values_are_refused_and_no_others(short: dict[tuple[str, str], Trial]):
    assert short["outliers", RECOMMENDED].refused_faulty > 0.97
    assert short["outliers", RECOMMENDED].refused_healthy < 0.02


def test_the_network_on_beams_that_are_flagged_without_it_does_no_harm(short: dict[tuple[str, str], Trial]):
    assert short["bias", "anfis_frcg"].end_error_m < short["bias", RECOMMENDED].end_error_m + 0.5


def test_the_network_at_every_message_removes_the_sensor(short: dict[tuple[str, str], Trial]):
    """GIVEN no fault at all THEN compensating every beam drifts more than using it, and than the rule of the text."""
    assert short["none", "always"].end_error_m > short["none", "text"].end_error_m
    assert short["none", "always"].end_error_m > 2.0 * short["none", RECOMMENDED].end_error_m


def test_velocity_is_judged_outside_total_loss(short: dict[tuple[str, str], Trial]):
    assert short["all lost", RECOMMENDED].velocity_rms < 0.03


def test_same_seed_same_trials():
    again, first = (run_seed(SHORT, 61, ("outliers",), (RECOMMENDED,), 60.0) for _ in range(2))
    assert repr(again) == repr(first)


def test_command_writes_tables_and_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arguments = ["--cases", "drone", "--faults", "none", "--methods", "fixed", "--seeds", "1", "--length", "60"]
    assert main(["benchmark", "beams", *arguments, "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["case"], row["fault"], row["method"], row["seed"]) for row in rows] == [
        ("drone", "none", "fixed", "0")
    ]
    assert np.isfinite(float(rows[0]["percent"]))
    content = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert content["goals"] == []  # they hold for ten minutes
    assert content["summaries"][0]["trials"] == 1
    assert "<table" in (tmp_path / "out" / "report.html").read_text()
    assert "| none |" in capsys.readouterr().out


def twice(task: int) -> list[int]:
    if task < 0:
        raise ValueError("a task below zero")
    return [task, 10 * task]


def test_a_simulation_that_fails_costs_itself_and_is_named(capsys: pytest.CaptureFixture[str]):
    """GIVEN tasks of which one fails THEN the others keep their order; where all fail, that is said."""
    assert run_all(twice, [3, -1, 2], 1) == [3, 30, 2, 20]
    assert "note: a simulation is left out: ValueError: a task below zero" in capsys.readouterr().err
    with pytest.raises(UserError, match="nothing could be simulated: ValueError: a task below zero"):
        run_all(twice, [-1], 1)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--cases", "boat"], "--cases 'boat': there are auv, drone, or all"),
        (["--faults", "rust"], "--faults 'rust': there are none, bias"),
        (["--methods", "magic"], "--methods 'magic': there are fixed"),
        (["--seeds", "0"], "--seeds and --jobs must be 1 or more"),
        (["--length", "5"], "--length must lie between 60 and 7200 s"),
        (["--mounting", "nan"], "--mounting between -10 and 10 deg"),
    ],
)
def test_wrong_use_is_one_sentence(arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]):
    assert main(["benchmark", "beams", *arguments]) == 2
    said = capsys.readouterr().err
    assert text in said
    assert said.count("\n") == 1
