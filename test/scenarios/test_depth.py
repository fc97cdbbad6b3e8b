"""The pressure of the water tells the height."""

from dataclasses import replace

import numpy as np
import pytest

from beamed import in_water, with_beams
from nav_pose_estimator.core.filter.blocks import DEPTH
from nav_pose_estimator.core.filter.layout import ALT, DPOS, DVEL, TIME, VEL
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import PressureSample
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.sim.scenarios import generate
from told import silence

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def recording():
    return generate("multirotor_outage", 111.0, seed=5, imu_rate=50.0).with_faults(*silence(60.0, 51.0))


def swim(recording, samples, **aids):
    """Vertical error [m] at the end, the engine and its events."""
    engine, events = SinsEngine(update(Parameters(), {f"aids.{key}": value for key, value in aids.items()})), []
    for sample in samples:
        events += [output for output in engine.feed(sample) if isinstance(output, Event)]
    nav, truth = engine.run.settled.nav, recording.truth
    t = nav[TIME] + (engine.run.clock.zero_ns - recording.start_ns) * 1e-9
    return abs(nav[ALT] - truth.alt[min(round(t / truth.dt), len(truth) - 1)]), engine, events


def test_pressure_of_the_water_holds_the_height(recording):
    """GIVEN a vehicle that learned at which height the surface is WHEN GNSS is away THEN the pressure holds its height,
    as well as it is said to."""
    without, _, _ = swim(recording, recording.samples(), barometer=False)
    error, engine, _ = swim(recording, in_water(recording), water_density=1000.0)
    assert error < 0.5 * without
    assert error < 3.0 * engine.run.settled.P[DPOS + 2, DPOS + 2] ** 0.5
    assert engine.journal.counters["depth.used"] > 200
    assert engine.journal.counters["height.used"] == 0
    assert DEPTH.is_in(engine.run.timeline.filter.constants)


def test_pressure_goes_on_telling_the_vertical_velocity(recording):
    """GIVEN a surface that GNSS has shown to half a fix at best WHEN GNSS is away THEN the height is not said to be
    better, and the vertical velocity, which needs no surface, is known ten times as well as without the pressure."""
    _, without, _ = swim(recording, recording.samples(), barometer=False)
    _, engine, _ = swim(recording, in_water(recording), water_density=1000.0)
    P, nav, truth = engine.run.settled.P, engine.run.settled.nav, recording.truth
    assert P[DPOS + 2, DPOS + 2] ** 0.5 >= 0.5 * Parameters().gnss.vertical_sd
    assert np.linalg.eigvalsh(P).min() > 0.0
    sd = P[DVEL + 2, DVEL + 2] ** 0.5
    assert sd < 0.1 * without.run.settled.P[DVEL + 2, DVEL + 2] ** 0.5
    row = min(round((nav[TIME] + (engine.run.clock.zero_ns - recording.start_ns) * 1e-9) / truth.dt), len(truth) - 1)
    assert abs(nav[VEL + 2] - truth.v_n[row, 2]) < 3.0 * sd


def test_a_pressure_that_is_none_costs_one_sentence(recording):
    """GIVEN pressures in bar, and none at all THEN they are counted and said once, and the flight goes on."""
    for pressure in (1.0, 0.0, float("nan"), 1e12):
        samples = (replace(s, pressure=pressure) if isinstance(s, PressureSample) else s for s in recording.samples())
        _, engine, events = swim(recording, samples, water_density=1000.0)
        told = [event.text for event in events if event.name == "depth.rejected.value"]
        assert len(told) == 1
        assert "not an absolute pressure in pascal" in told[0]
        assert engine.journal.counters["depth.used"] == 0
        assert engine.journal.counters["depth.rejected.value"] > 200


def test_beams_and_pressure_go_together(recording):
    samples = list(in_water(recording))
    pressures = iter([sample for sample in samples if isinstance(sample, PressureSample)])
    both = (next(pressures) if isinstance(s, PressureSample) else s for s in with_beams(recording))
    error, engine, _ = swim(recording, both, water_density=1000.0)
    assert error < 2.0
    assert engine.journal.counters["beam_velocity.used"] > 200
