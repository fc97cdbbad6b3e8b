"""Noise models in the navigator: the same numbers however the samples come, honest where the receiver is not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, update
from nav_pose_estimator.engine.samples import BodyVelocity, GnssFix, GnssVelocity, ImuBlock, Sample
from nav_pose_estimator.engine.solutions import Event, NavBlock, NavSolution
from nav_pose_estimator.sim.faults import Delay, NotANumber, Stop
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import find_scenario, generate
from pieces import one_by_one

LEARNING = ["innovation_adaptive", "variational"]
FLOORS = {
    "gnss.position_sd": 0.1,
    "gnss.vertical_sd": 0.1,
    "gnss.velocity_sd": 0.01,
    "gnss.velocity_vertical_sd": 0.01,
    "gnss.position_correlation": 0.0,
}


def parameters(noise: str) -> Parameters:
    return update(Parameters(), {"gnss.noise": noise, "imu.learn_noise": False, **FLOORS})


@cache
def flight(stated: float = 1.0, worse: tuple = ()) -> Recording:
    """A start in the air with white GNSS errors, of which the receiver states a share."""
    scenario = find_scenario("alignment_in_air")
    return generate(replace(scenario, gnss=replace(scenario.gnss, stated=stated, worse=worse)), 60.0, 3, imu_rate=50.0)


def flown(noise: str, samples: list[Sample]) -> tuple[SinsEngine, list]:
    engine = SinsEngine(parameters(noise))
    return engine, [output for sample in samples for output in engine.feed(sample)]


def rows_of(outputs: list) -> np.ndarray:
    blocks = [output.rows for output in outputs if isinstance(output, NavBlock)]
    singles = [output.values[None, :26] for output in outputs if isinstance(output, NavSolution)]
    return np.concatenate([*blocks, *singles])


@pytest.mark.parametrize("noise", LEARNING)
def test_blocks_and_single_samples_give_the_same_numbers(noise: str):
    """GIVEN a receiver that lies WHEN a node feeds samples and a replay blocks THEN nothing differs in a bit."""
    samples = list(flight(0.3).samples())
    blocks, single = flown(noise, samples), flown(noise, one_by_one(samples))
    np.testing.assert_array_equal(rows_of(blocks[1]), rows_of(single[1]))
    assert blocks[0].status().values["gnss.noise.position_factor"] > 3.0
    assert blocks[0].status().values == pytest.approx(single[0].status().values, rel=0, abs=0, nan_ok=True)


def until_57(delay: float = 0.0) -> list[Sample]:
    """The samples of a flight whose receiver falls silent at 57 s, so that every fix arrives, however late."""
    faults = [Stop(kind, 57.0, 10.0) for kind in (GnssFix, GnssVelocity)]
    faults += [Delay(kind, 0.0, 100.0, delay) for kind in (GnssFix, GnssVelocity)]
    return list(flight(0.5).with_faults(*faults).samples())


def same(one: SinsEngine, other: SinsEngine) -> bool:
    """Whether filters and memories are equal to the last bit."""
    pairs = [(one.run.gnss.position, other.run.gnss.position), (one.run.gnss.velocity, other.run.gnss.velocity)]
    filters = [(one.run.settled.nav, other.run.settled.nav), (one.run.settled.P, other.run.settled.P)]
    return all(repr(a.noise) == repr(b.noise) for a, b in pairs) and all(np.array_equal(a, b) for a, b in filters)


@pytest.mark.parametrize("noise", LEARNING)
def test_late_fixes_are_learned_from_once(noise: str):
    """GIVEN fixes 0.4 s late, for which the past is replayed THEN state and memory are those of punctual ones."""
    (punctual, _), (late, _) = flown(noise, until_57()), flown(noise, until_57(0.4))
    assert punctual.run.gnss.position.noise.factor > 2.0
    assert same(late, punctual)


def test_a_fix_that_acts_before_the_velocity_of_its_epoch_is_learned_from_again():
    """GIVEN a status asked after each sample, for which each observation acts at once THEN the noise is the same to two
    thousandths, and the state to 5 cm and 1 cm/s: the doubts about GNSS are not replayed."""
    quiet, _ = flown("innovation_adaptive", until_57())
    asked = SinsEngine(parameters("innovation_adaptive"))
    for sample in until_57():
        asked.feed(sample)
        asked.status()
    one, other = asked.run.gnss, quiet.run.gnss
    assert one.position.noise.factor == pytest.approx(other.position.noise.factor, rel=2e-3)
    assert one.velocity.noise.factor == pytest.approx(other.velocity.noise.factor, rel=2e-3)
    apart = abs(asked.run.settled.nav - quiet.run.settled.nav)
    assert apart[at.LAT] < 1e-8 > apart[at.LON]  # rad: 6 cm
    assert apart[at.ALT] < 0.05
    assert apart[at.VEL : at.VEL + 3].max() < 0.01


@pytest.mark.parametrize("noise", LEARNING)
def test_a_snapshot_takes_the_memory_along(noise: str):
    """GIVEN a snapshot in flight WHEN the engine flies on THEN the twin flies the same, and is not disturbed."""
    samples = list(flight(0.3).samples())
    half = len(samples) // 2
    engine, _ = flown(noise, samples[:half])
    twin = engine.snapshot()
    before = twin.run.gnss.position.noise.factor
    first = [output for sample in samples[half:] for output in engine.feed(sample)]
    assert twin.run.gnss.position.noise.factor == before != engine.run.gnss.position.noise.factor
    second = [output for sample in samples[half:] for output in twin.feed(sample)]
    np.testing.assert_array_equal(rows_of(first), rows_of(second))
    assert engine.run.gnss.position.noise.factor == twin.run.gnss.position.noise.factor


def test_an_optimistic_receiver_is_told_once_and_taken_back():
    """GIVEN errors five times too large from 20 to 40 s THEN one warning with the factor, and later one all-clear."""
    _, outputs = flown("innovation_adaptive", list(flight(1.0, ((20.0, 20.0, 5.0),)).samples()))
    events = [output for output in outputs if isinstance(output, Event) and output.name.startswith("gnss.noise")]
    for what in ("position", "velocity"):
        said = [event for event in events if what in event.text]
        assert [event.name for event in said] == ["gnss.noise.optimistic", "gnss.noise.agrees"]
        assert said[0].data["factor"] > 9.0
    engine, outputs = flown("fixed", list(flight(1.0, ((20.0, 20.0, 5.0),)).samples()))
    assert not any(isinstance(o, Event) and o.name.startswith("gnss.noise") for o in outputs)
    assert engine.status().values["gnss.noise.velocity_factor"] == 1.0


@pytest.mark.parametrize("noise", LEARNING)
def test_the_alignment_learns_and_the_flight_goes_on_with_it(noise: str):
    """GIVEN a receiver that states a fifth WHEN the filter starts from the bank THEN it starts with a factor."""
    engine = SinsEngine(parameters(noise))
    for sample in flight(0.2).samples():
        engine.feed(sample)
        if engine.run.timeline.running:
            break
    assert engine.run.timeline.running
    assert engine.run.gnss.position.noise.factor > 1.5


@pytest.mark.parametrize("noise", ["fixed", *LEARNING])
def test_fixes_that_are_no_numbers_teach_nothing(noise: str):
    faults = NotANumber(GnssFix, 20.0, 3.0), NotANumber(GnssVelocity, 30.0, 3.0)
    engine, outputs = flown(noise, list(flight().with_faults(*faults).samples()))
    assert np.isfinite(rows_of(outputs)).all()
    assert 1.0 <= engine.run.gnss.position.noise.factor < 4.0


def test_an_unknown_model_is_one_sentence():
    with pytest.raises(ParameterError, match="not one of fixed, innovation_adaptive, variational"):
        update(Parameters(), {"gnss.noise": "adaptive"})


def test_a_noisy_velocity_sensor_is_found_out():
    """GIVEN a velocity sensor eight times noisier than its floor THEN its factor shows it, and GNSS keeps its own."""
    recording, rng = flight(), np.random.default_rng(2)
    engine = SinsEngine(update(parameters("fixed"), {"aids.body_velocity_noise": "innovation_adaptive"}))
    truth, due = recording.truth, 0.0
    for sample in recording.samples():
        engine.feed(sample)
        if isinstance(sample, ImuBlock) and engine.run.timeline.running and engine.run.now >= due:
            row = round((engine.run.now - truth.t[0]) / truth.dt)
            noisy = quat_to_matrix(truth.q_nb[row]).T @ truth.v_n[row] + 0.8 * rng.standard_normal(3)
            engine.feed(BodyVelocity(int(sample.stamps_ns[-1]), tuple(noisy.tolist())))
            due = engine.run.now + 0.2
    values = engine.status().values
    assert values["body_velocity.noise.factor"] > 20.0
    assert values["gnss.noise.velocity_factor"] == 1.0
