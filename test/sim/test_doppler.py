"""The Doppler sensor measures what its model says, and its beams fail as planned."""

import math
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.rotation import quat_conjugate_many, quat_rotate_many
from nav_pose_estimator.engine.samples import BeamVelocitySample
from nav_pose_estimator.sim.beam_faults import (
    PLANS,
    BeamNoise,
    BeamOffset,
    BeamOutliers,
    BeamScale,
    BeamsLost,
    Stretch,
    plan,
)
from nav_pose_estimator.sim.doppler import Doppler, cone, doppler
from nav_pose_estimator.sim.noise import stream
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import AUV, DRONE, FAULTY_FROM, SCENARIOS, START_NS, generate
from nav_pose_estimator.sim.trajectories import Truth

IDEAL = Doppler(10.0, noise=0.0, bias_sd=0.0, scale_sd=0.0, sign=1.0)
WHERE = Stretch(40.0, 60.0, speed=1.5, noise=0.01, rate=2.0)


@pytest.fixture(scope="module")
def swim() -> Recording:
    """A hundred seconds with a turn in them."""
    survey = replace(AUV.vehicle.survey, lane=45.0)
    return generate(replace(AUV, vehicle=replace(AUV.vehicle, survey=survey)), 100.0, seed=3)


def measured(truth: Truth, model: Doppler, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Times of stamp (N,) and velocities (N, beams)."""
    samples = [timed.sample for timed in doppler(truth, model, stream(seed, "doppler"), START_NS)]
    return np.array([(s.stamp_ns - START_NS) * 1e-9 for s in samples]), np.array([s.velocities for s in samples])


def body_velocity(truth: Truth, t: np.ndarray) -> np.ndarray:
    at = truth.at(t)
    return quat_rotate_many(quat_conjugate_many(at.q_nb), at.v_n)


def beams_of(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of arrival (N,) and velocities (N, 4)."""
    found = [timed for timed in recording.others if isinstance(timed.sample, BeamVelocitySample)]
    return (
        np.array([(timed.arrival_ns - START_NS) * 1e-9 for timed in found]),
        np.array([timed.sample.velocities for timed in found]),
    )


def test_beams_lie_on_a_cone_and_look_down() -> None:
    crossed = np.array(cone(4, math.radians(30.0), math.radians(45.0)))
    np.testing.assert_allclose(np.linalg.norm(crossed, axis=1), 1.0)
    np.testing.assert_allclose(crossed[:, 2], -math.cos(math.radians(30.0)))
    np.testing.assert_allclose(crossed[0, :2], math.sin(math.radians(30.0)) / math.sqrt(2.0))
    assert len(cone(3, 0.4, 0.0)) == 3


def test_four_ideal_beams_are_the_velocity(swim: Recording) -> None:
    t, along = measured(swim.truth, IDEAL)
    velocity = np.linalg.lstsq(np.array(IDEAL.directions), along.T, rcond=None)[0].T
    np.testing.assert_allclose(velocity, body_velocity(swim.truth, t), atol=1e-9)
    receding = measured(swim.truth, replace(IDEAL, sign=-1.0))[1]
    np.testing.assert_array_equal(receding, -along)


def test_a_lever_arm_swings_and_a_latency_shifts(swim: Recording) -> None:
    arm = (2.0, 0.0, -0.5)
    t, along = measured(swim.truth, replace(IDEAL, lever=arm, latency=0.3))
    valid = t - 0.3
    expected = body_velocity(swim.truth, valid) + np.cross(swim.truth.at(valid).gyro, arm)
    np.testing.assert_allclose(along, expected @ np.array(IDEAL.directions).T, atol=1e-9)
    assert np.abs(np.cross(swim.truth.at(valid).gyro, arm)).max() > 0.2  # the turn is in it


def test_a_mounting_yaw_turns_the_measured_velocity(swim: Recording) -> None:
    """GIVEN a sensor turned by 5 deg to the left THEN it sees the velocity turned by 5 deg to the right."""
    for model in (replace(IDEAL, rpy=(0.0, 0.0, 0.1)), replace(IDEAL, misalignment=(0.0, 0.0, 0.1))):
        t, along = measured(swim.truth, model)
        seen = np.linalg.lstsq(np.array(IDEAL.directions), along.T, rcond=None)[0].T
        true = body_velocity(swim.truth, t)
        moving = np.hypot(true[:, 0], true[:, 1]) > 1.0
        turned = np.arctan2(seen[:, 1], seen[:, 0]) - np.arctan2(true[:, 1], true[:, 0])
        np.testing.assert_allclose(np.angle(np.exp(1j * turned[moving])), -0.1, atol=1e-6)


def test_noise_bias_and_scale_are_what_the_model_says(swim: Recording) -> None:
    clean = measured(swim.truth, IDEAL)[1]
    noise = measured(swim.truth, replace(IDEAL, noise=0.05))[1] - clean
    assert np.std(noise) == pytest.approx(0.05, rel=0.05)
    biases = [(measured(swim.truth, replace(IDEAL, bias_sd=0.02), seed)[1] - clean)[0] for seed in range(50)]
    assert np.std(biases) == pytest.approx(0.02, rel=0.2)
    scaled = measured(swim.truth, replace(IDEAL, scale_sd=0.01))[1]
    ratio = scaled[np.abs(clean) > 0.1] / clean[np.abs(clean) > 0.1]
    np.testing.assert_allclose(ratio, ratio[0])
    assert 0.0 < abs(ratio[0] - 1.0) < 0.05


def test_each_failure_changes_its_beams_in_its_time(swim: Recording) -> None:
    t, clean = beams_of(swim)
    inside = (t >= 40.0) & (t < 70.0)
    window = {"start": 40.0, "length": 30.0}
    cases = {
        BeamOffset(**window, beams=(1,), offset=0.3): lambda e, v: np.allclose(e, 0.3),
        BeamScale(**window, beams=(1,), scale=1.15): lambda e, v: np.allclose(e, 0.15 * v),
        BeamsLost(**window, beams=(1,)): lambda e, v: np.isnan(e).all(),
        BeamNoise(**window, beams=(1,), growth=0.01): lambda e, v: np.std(e[:20]) < 0.5 * np.std(e[-20:]),
    }
    for fault, holds in cases.items():
        spoiled = beams_of(swim.with_faults(fault))[1]
        error = spoiled - clean
        np.testing.assert_array_equal(spoiled[:, [0, 2, 3]], clean[:, [0, 2, 3]])
        np.testing.assert_array_equal(spoiled[~inside], clean[~inside])
        assert holds(error[inside, 1], clean[inside, 1]), fault


def test_outliers_hit_their_share_of_all_beams(swim: Recording) -> None:
    clean = beams_of(swim)[1]
    error = beams_of(swim.with_faults(BeamOutliers(seed=4, share=0.2, smallest=0.1, largest=0.4)))[1] - clean
    hit = error != 0.0
    assert hit.mean() == pytest.approx(0.2, abs=0.05)
    assert np.abs(error[hit]).min() >= 0.1
    assert np.abs(error[hit]).max() <= 0.4


@pytest.mark.parametrize("name", PLANS)
def test_plans_fail_inside_their_stretch_and_repeat(name: str, swim: Recording) -> None:
    faults = plan(name, WHERE, seed=7)
    assert faults == plan(name, WHERE, seed=7)
    assert all(f.start >= WHERE.start and f.start + f.length <= WHERE.start + WHERE.length + 1e-9 for f in faults)
    t, clean = beams_of(swim)
    spoiled = beams_of(swim.with_faults(*faults))[1]
    changed = (spoiled != clean).any(axis=1)
    assert changed.any() == (name != "none")
    assert not changed[t < WHERE.start].any()
    lost = np.isnan(spoiled).any(axis=0).sum()
    assert lost == {"two neighbours lost": 2, "two opposite lost": 2, "three lost": 3, "all lost": 4}.get(name, lost)


def test_failing_beams_of_another_seed_fail_elsewhere() -> None:
    assert len({repr(plan("bias", WHERE, seed)) for seed in range(10)}) > 5


def test_mixed_faults_last_two_thirds_of_the_time() -> None:
    faults = plan("mixed", replace(WHERE, length=6000.0), seed=1)
    assert sum(fault.length for fault in faults) / 6000.0 == pytest.approx(2.0 / 3.0, abs=0.05)
    assert {type(fault) for fault in faults} == {BeamOffset, BeamScale, BeamNoise, BeamsLost}


def test_there_is_a_scenario_for_every_plan() -> None:
    for prefix in ("auv", "drone"):
        for name in PLANS:
            if name != "none":
                faults = SCENARIOS[f"{prefix}_{name.replace(' ', '_')}"].faults
                assert faults
                assert min(fault.start for fault in faults) >= FAULTY_FROM


@pytest.mark.parametrize(("scenario", "slowest", "fastest"), [(AUV, 1.5, 1.5), (DRONE, 4.0, 8.0)])
def test_lanes_go_up_and_down(scenario, slowest: float, fastest: float) -> None:
    truth = generate(scenario, 260.0, seed=2, imu_rate=20.0).truth
    speed = np.hypot(*truth.v_n[:, :2].T)
    assert speed[truth.t < 20.0].max() < 1e-5  # the splines ring a little
    assert speed[truth.t > 35.0].min() > 0.99 * slowest
    assert speed.max() < 1.01 * fastest
    survey = scenario.vehicle.survey
    before, after = (truth.at(np.array([20.0 + survey.lane + offset])).v_n[0] for offset in (-1.0, survey.turn + 1.0))
    assert np.dot(before[:2], after[:2]) < -0.9 * np.hypot(*before[:2]) * np.hypot(*after[:2])


def test_a_drone_leans_so_that_its_thrust_carries_it() -> None:
    """GIVEN drag of 0.3 1/s THEN the accelerometer along x feels that drag and nothing else."""
    truth = generate(DRONE, 60.0, seed=2, imu_rate=50.0).truth
    ahead = body_velocity(truth, truth.t)[:, 0]
    flying = truth.t > 35.0
    np.testing.assert_allclose(truth.accel[flying, 0].mean(), -0.3 * ahead[flying].mean(), rtol=0.1)
