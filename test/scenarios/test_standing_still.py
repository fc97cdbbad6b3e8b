"""The zero-velocity aid: it holds a vehicle that rests, and never one that flies."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuBlock, Sample
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.sim.faults import Stop
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import Scenario, generate
from nav_pose_estimator.sim.trajectories import Kinematics
from nav_pose_estimator.sim.vehicles.models import Prescribed
from nav_pose_estimator.sim.vehicles.motions import G, attitude_from_euler
from told import GNSS, flight, silence, tell

pytestmark = pytest.mark.compiled
USED = "zero_velocity.used"
SPEED, RADIUS, REST, RAMP = 15.0, 100.0, 20.0, 10.0  # of the circle: m/s, m, s, s


def circle(t: np.ndarray) -> Kinematics:
    """A rest, then a banked circle as smooth as no air is."""
    x = np.clip((t - REST) / RAMP, 0.0, 1.0)
    v, a = SPEED * x**2 * (3.0 - 2.0 * x), SPEED * 6.0 * x * (1.0 - x) / RAMP
    path = SPEED * (RAMP * (x**3 - 0.5 * x**4) + np.maximum(t - REST - RAMP, 0.0))
    yaw, rate, lean, level = path / RADIUS, v / RADIUS, v**2 / (RADIUS * G), np.zeros_like(t)
    c, s = np.cos(yaw), np.sin(yaw)
    velocity = np.column_stack([v * c, v * s, level])
    acceleration = np.column_stack([a * c - v * rate * s, a * s + v * rate * c, level])
    roll_rate = -2.0 * v * a / (RADIUS * G) / (1.0 + lean**2)
    return Kinematics(
        velocity, acceleration, *attitude_from_euler(-np.arctan(lean), level, yaw, roll_rate, level, rate)
    )


CIRCLE = Scenario("circle", "A rest, then a circle", Prescribed(circle), duration=140.0)


def seconds(sample: Sample, epoch_ns: int) -> float:
    """End of a sample, from ``epoch_ns`` on [s]; NaN where it has no stamp."""
    stamp = int(sample.stamps_ns[-1]) if isinstance(sample, ImuBlock) else getattr(sample, "stamp_ns", None)
    return float("nan") if stamp is None else (stamp - epoch_ns) * 1e-9


def rests(samples: list[Sample], epoch_ns: int, **overrides: object) -> tuple[SinsEngine, np.ndarray]:
    """When the aid was used, to the end of the block in which it was [s]."""
    values = {name.replace("__", "."): value for name, value in overrides.items()}
    engine, times = SinsEngine(update(Parameters(), values)), []
    for sample in samples:
        before = engine.journal.counters[USED]
        engine.feed(sample)
        times += [seconds(sample, epoch_ns)] * (engine.journal.counters[USED] - before)
    return engine, np.array(times)


def speed(recording: Recording, t: np.ndarray) -> np.ndarray:
    """The largest true speed [m/s] of the 2.5 s up to each of the times ``t`` less the length of a block."""
    truth = recording.truth
    norm = np.linalg.norm(truth.v_n, axis=1)
    return np.array([norm[(truth.t > end - 3.0) & (truth.t < end - 0.5)].max() for end in t])


@pytest.mark.parametrize("learner", [False, True])
def test_a_vehicle_at_rest_stays_where_it_is(learner: bool) -> None:
    """GIVEN a vehicle at rest WHEN GNSS is away for five minutes
    THEN the position stays within two metres, sigma covers it and says so, and the mode is COASTING."""
    told = tell(flight("at_rest", 360.0), *silence(40.0, 305.0), learner__enabled=learner)
    away = told.between(44.0, 340.0)
    assert told.modes_between(44.0, 340.0) == {Mode.COASTING}
    assert told.off[away].max() < 2.0
    assert np.all(told.off[away] < 3.0 * told.sigma[away])
    assert told.sigma[away].max() < 10.0
    assert told.count(USED) > 300
    assert told.modes[-1] is Mode.AIDED


def test_without_the_aid_it_drifts_away() -> None:
    """GIVEN the same rest WHEN the aid is switched off THEN nothing is held, and the drift is many times larger."""
    told = tell(flight("at_rest", 360.0), *silence(40.0, 305.0), learner__enabled=False, aids__zero_velocity=False)
    assert told.count("zero_velocity") == 0
    assert told.modes_between(44.0, 340.0) == {Mode.DEAD_RECKONING}
    assert told.off[told.between(330.0, 340.0)].max() > 20.0


@pytest.mark.parametrize("outage", [False, True])
@pytest.mark.parametrize("name", ["hover", "stop_and_go", "laps", "fixed_wing", "circle"])
def test_what_moves_never_rests(name: str, outage: bool) -> None:
    """GIVEN a flight that hovers, cruises or circles WHEN GNSS is there, or lost THEN only the stand before is rest."""
    recording = generate(CIRCLE, seed=3, imu_rate=100.0) if name == "circle" else flight(name, 240.0, seed=3)
    lost = recording.with_faults(*(Stop(kind, 100.0, 140.0) for kind in GNSS)) if outage else recording
    engine, times = rests(list(lost.samples()), recording.start_ns)
    assert len(times) > 3
    assert speed(recording, times).max() < 0.01
    assert times.max() < 40.0
    assert engine.mode is (Mode.DEAD_RECKONING if outage else Mode.AIDED)


def test_a_steady_turn_is_refused_and_counted() -> None:
    """GIVEN an IMU that feels nothing WHEN the vehicle circles THEN the aid is withheld: no bias explains the rate."""
    recording = generate(CIRCLE, seed=3, imu_rate=100.0)
    engine, _ = rests(list(recording.samples()), recording.start_ns)
    assert engine.journal.counters["zero_velocity.withheld.rate"] > 50


def test_a_stop_of_a_car_is_found() -> None:
    """GIVEN a car with stops WHEN it stands at a light THEN its velocity is held there, and hardly ever elsewhere."""
    recording = flight("road_vehicle", 300.0, seed=3)
    _, times = rests(list(recording.samples()), recording.start_ns)
    assert np.sum(times > 40.0) > 10
    assert speed(recording, times).max() < 0.1  # rolling to a stop


@pytest.mark.parametrize("name", ["x8_testlog2", "px4_flow", "px4_quad_0107"])
def test_no_recorded_flight_rests_in_the_air(shared_data: Path, name: str) -> None:
    """GIVEN a recorded flight WHEN it is replayed THEN no second in the air counts as rest."""
    recording = load(shared_data / "flights" / f"{name}_bag")
    start, end = (recording.seconds_of_log(t) for t in recording.sidecar["flight_window_s"])
    delay = recording.sidecar["gnss_latency_est_s"]
    engine, times = rests(recording.samples, recording.epoch_ns, gnss__delay=delay)
    assert np.sum((times > start) & (times < end)) == 0
    assert engine.mode is Mode.AIDED
    if name == "x8_testlog2":  # four minutes on the ground before
        assert np.sum(times < start) > 100


@pytest.mark.parametrize("magnetometer", [True, False])
def test_a_gap_on_a_circle_does_not_end_in_waiting_for_a_rest(magnetometer: bool) -> None:
    """GIVEN an aided aircraft on a smooth circle WHEN the IMU is silent for 3 s THEN it is aligned soon after, in
    motion, and where it is."""
    story = CIRCLE if magnetometer else replace(CIRCLE, magnetometer=None)
    recording = generate(story, seed=2, imu_rate=100.0)
    cut = (s for s in recording.samples() if not 80.0 < seconds(s, recording.start_ns) < 83.0)
    told = tell(recording, samples=cut)
    assert told.count("imu.gap") == 1
    assert 83.0 < min(told.when("aligned", after=80.0)) < 100.0
    assert told.off[told.between(130.0, 140.0)].max() < 3.0
