"""The noise of IMU and GNSS is found in flight, and only in flight."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssVelocity, ImuBlock, Sample
from nav_pose_estimator.sim.recording import Recording
from told import Told, flight, silence, tell

RATE = 100.0  # Hz
NOISY_GYRO, NOISY_ACCEL = 4e-3, 0.1  # densities, eight and five times what is set
BAD_VELOCITY, ITS_MEMORY = 1.0, 0.9  # m/s; correlation from one velocity to the next


def noisier(recording: Recording, gyro: float = 0.0, accel: float = 0.0, velocity: float = 0.0) -> Iterator[Sample]:
    """The samples of a flight with white noise of densities ``gyro`` and ``accel``, slow noise of GNSS velocity."""
    rng, error = np.random.default_rng(3), np.zeros(3)
    per_sample = np.sqrt(RATE)
    for sample in recording.samples():
        if isinstance(sample, ImuBlock):
            shape = sample.gyro.shape
            rate = sample.gyro + gyro * per_sample * rng.normal(size=shape)
            yield ImuBlock(sample.stamps_ns, rate, sample.accel + accel * per_sample * rng.normal(size=shape))
        elif isinstance(sample, GnssVelocity):
            error = ITS_MEMORY * error + np.sqrt(1.0 - ITS_MEMORY**2) * velocity * rng.normal(size=3)
            yield dataclasses.replace(sample, vel_enu=tuple((np.array(sample.vel_enu) + error).tolist()))
        else:
            yield sample


def fly(name: str = "laps", seconds: float = 180.0, **noise: float) -> Told:
    recording = flight(name, seconds, rate=RATE)
    return tell(recording, samples=noisier(recording, **noise), learner__enabled=False)


def found(told: Told | PoseEstimator) -> tuple[float, float]:
    """Factors of the deviations of IMU and GNSS."""
    values = (told if isinstance(told, PoseEstimator) else told.estimator).status().values
    return values["noise.imu"], values["noise.gnss"]


def test_a_good_imu_stays_good():
    assert found(fly()) == (1.0, 1.0)


def test_a_noisy_imu_is_found():
    imu, gnss = found(fly(gyro=NOISY_GYRO, accel=NOISY_ACCEL))
    assert imu > 1.8
    assert gnss < 1.8


def test_a_noisy_receiver_is_found():
    """What it spoils of tilt and velocity cannot be told from a noisy IMU: both factors rise, and sigma with them."""
    imu, gnss = found(fly(velocity=BAD_VELOCITY))
    assert gnss > 2.5
    assert imu > 1.5


def test_sigma_of_an_outage_knows_of_the_noise():
    """GIVEN an IMU much noisier than set WHEN GNSS is lost after two minutes THEN the error lies within 3 sigma.

    Without identification it does not, on the same flight.
    """
    recording = flight("laps", 180.0, rate=RATE)
    samples = [s for s in noisier(recording, NOISY_GYRO, NOISY_ACCEL) if not _is_gnss_after(s, recording, 130.0)]
    ratios = {}
    for learns in (True, False):
        told = tell(recording, samples=samples, learner__enabled=False, imu__learn_noise=learns)
        ratios[learns] = told.off[-1] / told.sigma[-1]
    assert ratios[True] < 2.0
    assert ratios[False] > 1.5 * ratios[True]


def _is_gnss_after(sample: Sample, recording: Recording, seconds: float) -> bool:
    stamp = getattr(sample, "stamp_ns", None)
    late = stamp is not None and stamp > recording.start_ns + seconds * 1e9
    return late and type(sample).__name__ in ("GnssFix", "GnssVelocity", "SatelliteCount")


def test_an_outage_teaches_nothing():
    """GIVEN an outage WHEN the navigator drifts THEN what it knows of its sensors stays, and goes on afterwards."""
    recording = flight("laps", 180.0, rate=RATE)
    estimator = PoseEstimator(update(Parameters(), {"learner.enabled": False}), attitude=False)
    seen = {}
    for sample in recording.with_faults(*silence(100.0, 50.0)).samples():
        estimator.feed(sample)
        if isinstance(sample, ImuBlock):
            seen[(int(sample.stamps_ns[-1]) - recording.start_ns) * 1e-9] = estimator.status().values
    inside = [values for t, values in seen.items() if 103.0 < t < 149.0]
    assert len({(v["noise.imu"], v["noise.gnss"], v["noise.trials"]) for v in inside}) == 1
    assert inside[0]["noise.trials"] > 3.0
    assert max(v["noise.trials"] for v in seen.values()) > inside[0]["noise.trials"]


def test_a_vehicle_on_the_ground_teaches_nothing():
    told = tell(flight("at_rest", 120.0, rate=RATE), learner__enabled=False)
    assert told.estimator.status().values["noise.trials"] <= 1.0


def test_it_can_be_switched_off():
    recording = flight("laps", 60.0, rate=RATE)
    told = tell(recording, samples=noisier(recording, NOISY_GYRO), learner__enabled=False, imu__learn_noise=False)
    assert found(told) == (1.0, 1.0)


@pytest.mark.parametrize("size", [1, 7])
def test_blocks_of_any_size_find_the_same(size):
    recording = flight("laps", 60.0, rate=RATE)
    parameters = update(Parameters(), {"learner.enabled": False})
    whole, cut = (PoseEstimator(parameters, attitude=False) for _ in range(2))
    for sample in noisier(recording, NOISY_GYRO):
        whole.feed(sample)
        parts = [sample]
        if isinstance(sample, ImuBlock):
            parts = [sample.part(i, min(i + size, len(sample))) for i in range(0, len(sample), size)]
        for part in parts:
            cut.feed(part)
    assert found(whole) == found(cut)
    assert found(whole)[0] > 1.0
    assert np.array_equal(whole.sins.run.settled.nav, cut.sins.run.settled.nav)


def test_a_snapshot_goes_on_as_the_original():
    recording = flight("laps", 90.0, rate=RATE)
    samples = list(noisier(recording, NOISY_GYRO))
    engine = PoseEstimator(update(Parameters(), {"learner.enabled": False}), attitude=False)
    half = len(samples) // 2
    for sample in samples[:half]:
        engine.feed(sample)
    before = engine.snapshot()
    for sample in samples[half:]:
        engine.feed(sample)
    other = PoseEstimator(engine.parameters, attitude=False)
    other.restore(before)
    assert found(other) != found(engine)
    for sample in samples[half:]:
        other.feed(sample)
    assert found(other) == found(engine)
    assert np.array_equal(other.sins.run.settled.nav, engine.sins.run.settled.nav)
