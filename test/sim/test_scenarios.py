"""Every story can be told, twice the same way, and its parts do not disturb each other."""

from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, ImuBlock, ImuSample, MagSample, PressureSample, SatelliteCount
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.sim.noise import stream
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import SCENARIOS, START_NS, find_scenario, generate
from nav_pose_estimator.sim.wind import CALM, DRIFTING, LIGHT, MODERATE, Wind
from pieces import one_by_one


def values(recording: Recording) -> list:
    """Everything that an estimator sees, in a form that compares (NaN equal to itself)."""
    return [
        repr(sample) if not isinstance(sample, ImuBlock) else (sample.gyro.tobytes(), sample.stamps_ns.tobytes())
        for sample in recording.samples()
    ]


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_gives_finite_samples_in_order(name: str) -> None:
    recording = generate(name, 20.0, seed=1, imu_rate=50.0)
    truth = recording.truth
    assert len(truth) == len(recording.imu) == 1001
    assert truth.t[0] == 0.0
    assert truth.t[-1] == 20.0
    for array in (truth.lat, truth.v_n, truth.q_nb, truth.wind_n, recording.imu.gyro, recording.imu.accel):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(np.linalg.norm(truth.q_nb, axis=1), 1.0, atol=1e-12)
    arrivals = [timed.arrival_ns for timed in recording.arrivals()]
    assert arrivals == sorted(arrivals)
    assert SCENARIOS[name].description


@pytest.mark.parametrize("name", ["multirotor_light", "fixed_wing", "road_vehicle"])
def test_same_seed_same_recording_other_seed_another(name: str) -> None:
    first, again, other = (generate(name, 30.0, seed=seed, imu_rate=50.0) for seed in (5, 5, 6))
    assert values(first) == values(again)
    np.testing.assert_array_equal(first.truth.q_nb, again.truth.q_nb)
    assert np.abs(first.truth.q_nb - other.truth.q_nb).max() > 1e-3
    assert not np.array_equal(first.imu.gyro, other.imu.gyro)


def test_a_sensor_less_changes_nothing_for_the_others() -> None:
    scenario = find_scenario("multirotor_light")
    everything = generate(scenario, 20.0, seed=2, imu_rate=50.0)
    without = generate(replace(scenario, magnetometer=None), 20.0, seed=2, imu_rate=50.0)
    np.testing.assert_array_equal(everything.imu.accel, without.imu.accel)
    rest = [timed for timed in everything.others if not isinstance(timed.sample, MagSample)]
    assert repr(rest) == repr(without.others)


def test_two_imus_fly_the_same_flight() -> None:
    first, second = (
        generate("multirotor_light", 20.0, seed=2, imu=imu, imu_rate=50.0) for imu in ("bmi088", "mpu6000")
    )
    np.testing.assert_array_equal(first.truth.accel, second.truth.accel)
    assert repr(first.others) == repr(second.others)
    # The noise is the same draw, scaled: what differs between two grades is the grade.
    assert not np.array_equal(first.imu.accel, second.imu.accel)


def test_blocks_and_single_samples_are_the_same_stream() -> None:
    recording = generate("at_rest", 5.0, seed=1)
    single = list(recording.samples(blocks=False))
    assert repr(single) == repr(one_by_one(recording.samples()))
    assert sum(isinstance(sample, ImuSample) for sample in single) == 1001
    assert {type(sample) for sample in single} >= {GnssFix, SatelliteCount, MagSample, PressureSample}
    assert repr([timed.sample for timed in recording.arrivals()]) == repr(single)


def test_streams_are_independent() -> None:
    draws = np.array([stream(1, name).standard_normal(20_000) for name in ("imu", "gnss", "barometer")])
    assert np.abs(np.corrcoef(draws) - np.eye(3)).max() < 0.03
    assert not np.array_equal(draws[0], stream(2, "imu").standard_normal(20_000))


def test_winds_of_the_benchmark() -> None:
    assert (CALM.mean, CALM.gust_sd) == (0.5, 0.05)
    assert (LIGHT.mean, LIGHT.gust_sd) == (2.0, 0.2)
    assert (MODERATE.mean, MODERATE.gust_sd) == (5.0, 0.6)
    assert (DRIFTING.mean, DRIFTING.gust_sd, DRIFTING.walk) == (2.0, 0.2, 0.05)
    assert {wind.gust_tau for wind in (CALM, LIGHT, MODERATE, DRIFTING)} == {10.0}


def test_wind_statistics() -> None:
    wind = MODERATE.sample(stream(1, "wind"), 100_000, 0.1)
    assert np.hypot(*wind[:, :2].mean(axis=0)) == pytest.approx(5.0, abs=0.2)
    np.testing.assert_allclose(wind.std(axis=0), (0.6, 0.6, 0.3), rtol=0.1)
    ends = [Wind(walk=0.05).sample(stream(i, "wind"), 101, 1.0)[-1, :2] for i in range(500)]
    assert np.std(ends) == pytest.approx(0.5, rel=0.1)
    shifted = Wind(mean=2.0, direction=0.0, shift=3.0, shift_at=50.0).sample(stream(1, "wind"), 101, 1.0)
    np.testing.assert_allclose(shifted[0], (2.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(shifted[-1], (2.0, 3.0, 0.0), atol=1e-12)


def test_story_of_the_wrong_return() -> None:
    parked = replace(find_scenario("return_offset_300m"), vehicle=find_scenario("at_rest").vehicle)
    recording = generate(parked, 210.0, seed=1, imu_rate=20.0)
    truth = recording.truth

    def miss(sample: GnssFix) -> float:
        at = truth.at(np.array([(sample.stamp_ns - START_NS) * 1e-9]))
        offset = (sample.lat - at.lat[0]) * 6.37e6, (sample.lon - at.lon[0]) * 6.38e6 * np.cos(at.lat[0])
        return float(np.hypot(*offset))

    fixes = [timed.sample for timed in recording.others if isinstance(timed.sample, GnssFix)]
    seconds = np.array([(fix.stamp_ns - START_NS) * 1e-9 for fix in fixes])
    status = np.array([fix.status for fix in fixes])
    assert (status[(seconds > 120.1) & (seconds < 179.9)] == -1).all()
    back = [miss(fix) for fix, t in zip(fixes, seconds, strict=True) if 180.1 < t < 199.9]
    assert 290.0 < min(back) < max(back) < 310.0
    assert max(miss(fix) for fix, t in zip(fixes, seconds, strict=True) if t > 200.1) < 10.0


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"scenario": "multirotor_outtage"}, "did you mean 'multirotor_outage'"),
        ({"scenario": "zzz"}, "there are multirotor_outage"),
        ({"scenario": "hover", "duration": -5.0}, "duration of -5 s is out of range"),
        ({"scenario": "hover", "duration": float("nan")}, "duration of nan"),
        ({"scenario": "hover", "duration": 1e7}, "is out of range"),
        ({"scenario": "hover", "seed": -1}, "seed -1 is negative"),
        ({"scenario": "hover", "imu": "bmi88"}, "did you mean 'bmi088'"),
        ({"scenario": "hover", "imu_rate": 0.0}, "IMU rate of 0 Hz"),
    ],
)
def test_nonsense_is_refused_in_one_sentence(arguments: dict, text: str) -> None:
    with pytest.raises(UserError, match=text) as caught:
        generate(**arguments)
    assert "\n" not in str(caught.value)
