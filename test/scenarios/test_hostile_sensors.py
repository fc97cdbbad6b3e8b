"""Sensors that fail in a way that looks sound: what is wrong is not said to be good."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, PressureSample, Sample
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.faults import Freeze, Shift
from nav_pose_estimator.sim.recording import Recording
from told import flight, silence, tell

pytestmark = pytest.mark.compiled


def with_imu_within(recording: Recording, bound: float) -> Iterator[Sample]:
    """The flight with a gyroscope that ends at ``bound`` [rad/s]."""
    for sample in recording.samples():
        yield replace(sample, gyro=np.clip(sample.gyro, -bound, bound)) if isinstance(sample, ImuBlock) else sample


def test_a_gyroscope_that_clips_below_usual_ranges_widens_sigma() -> None:
    """GIVEN a range of 60 deg/s in a vehicle that turns faster WHEN GNSS is lost
    THEN the status names it, and the error stays within 3 sigma."""
    recording = flight("stop_and_go", 75.0, seed=2)
    spoilt = with_imu_within(recording.with_faults(*silence(50.0, 25.0)), math.radians(60.0))
    told = tell(recording, samples=spoilt, learner__method="coast")
    assert "gyroscope clips at 1.05 rad/s" in told.event("imu.clips").text
    assert (told.off < 3.0 * told.sigma + 3.0)[told.between(50.0, 75.0)].all()


def test_a_barometer_that_freezes_in_an_outage_holds_no_height() -> None:
    """GIVEN a fixed wing that climbs in an outage WHEN its barometer repeats one value THEN it is told and left."""
    recording = flight("fixed_wing", 80.0)
    told = tell(recording, *silence(45.0, 35.0), Freeze(PressureSample, 46.0), learner__method="coast")
    assert told.when("baro.frozen")[0] < 56.0
    up, up_sd = np.abs(told.error[:, 2]), np.sqrt(told.variances[:, 2])
    assert (up < 3.0 * up_sd + 3.0)[told.between(45.0, 80.0)].all()


@pytest.mark.parametrize("step", [-60.0, 250.0])
def test_a_barometer_that_steps_in_an_outage_leaves_the_height_uncertain(step: float) -> None:
    """GIVEN an outage WHEN the pressure steps by 60 or 250 Pa, 5 or 21 m, THEN sigma covers the height, and neither
    is the horizontal sigma affected nor the height any longer in doubt once GNSS is back."""
    faults = (*silence(40.0, 15.0), Shift(PressureSample, 43.0, 27.0, (step,)))
    told, sound = tell(flight(duration=62.0), *faults), tell(flight(duration=62.0), *silence(40.0, 15.0))
    later = told.between(43.5, 55.0)
    up, sd = np.abs(told.error[:, 2]), np.sqrt(told.variances[:, 2])
    assert up[later].max() > 3.0
    assert (up[later] < 3.0 * sd[later]).all()
    assert np.allclose(told.sigma[later], sound.sigma[later], rtol=0.05)
    assert sd[-1] < 2.0


@pytest.mark.parametrize("rate", [-9.0, 9.0])
def test_a_barometer_that_drifts_on_takes_the_height_with_it_and_sigma_too(rate: float) -> None:
    """GIVEN an outage WHEN the pressure drifts by 9 Pa/s, 0.75 m/s, THEN sigma grows with the distance by which the
    barometer has moved the height, and is as usual once GNSS is back."""
    recording = flight("laps", 85.0)

    def drifting() -> Iterator[Sample]:
        for sample in recording.with_faults(*silence(45.0, 30.0)).samples():
            if isinstance(sample, PressureSample):
                since = max(1e-9 * (sample.stamp_ns - recording.start_ns) - 47.0, 0.0)
                sample = replace(sample, pressure=sample.pressure + rate * min(since, 28.0))
            yield sample

    told = tell(recording, samples=drifting(), learner__method="coast")
    up, sd = np.abs(told.error[:, 2]), np.sqrt(told.variances[:, 2])
    lost = told.between(45.0, 75.0)
    assert up[lost].max() > 15.0
    assert (up[lost] < 3.0 * sd[lost]).all()
    assert sd[-1] < 3.0


@pytest.mark.parametrize("decimals", [3, 4])
def test_positions_with_lost_digits_are_as_vague_as_they_are(decimals: int) -> None:
    """GIVEN a driver that prints few decimals THEN the status says so, and sigma covers half a step."""
    recording = flight("multirotor_light", 40.0)

    def rounded() -> Iterator[Sample]:
        for sample in recording.samples():
            if isinstance(sample, GnssFix):
                lat, lon = (math.radians(round(math.degrees(angle), decimals)) for angle in (sample.lat, sample.lon))
                yield replace(sample, lat=lat, lon=lon)
            else:
                yield sample

    told = tell(recording, samples=rounded(), learner__method="coast")
    assert "the driver has lost digits" in told.estimator.status().doubt
    assert (told.off < 3.0 * told.sigma)[told.between(5.0, 40.0)].all()


def test_a_gyroscope_that_steps_in_an_outage_is_doubted() -> None:
    """GIVEN a bias that steps by 2 deg/s while GNSS is away THEN soon sigma covers the error, and the status says why;
    WHEN GNSS is back elsewhere THEN the status says so until it is believed."""
    recording = flight("multirotor_light", 75.0)

    def stepped() -> Iterator[Sample]:
        for sample in recording.with_faults(*silence(45.0, 20.0)).samples():
            if isinstance(sample, ImuBlock):
                late = (sample.stamps_ns > recording.start_ns + 46_000_000_000)[:, None]
                sample = replace(sample, gyro=sample.gyro + np.where(late, [math.radians(2.0), 0.0, 0.0], 0.0))
            yield sample

    told = tell(recording, samples=stepped(), learner__method="coast")
    assert told.count("imu_doubt.used") >= 1
    assert told.off.max() > 50.0
    assert (told.off < 3.0 * told.sigma)[told.between(60.0, 65.0)].all()


def test_noise_that_the_receiver_does_not_state_is_used_as_noise() -> None:
    """GIVEN fixes that scatter by 8 m and state 1 m THEN that is told within three seconds, and sigma holds."""
    recording, rng = flight(duration=40.0), np.random.default_rng(2)

    def noisy() -> Iterator[Sample]:
        for sample in recording.samples():
            if isinstance(sample, GnssFix):
                east, north, up = rng.normal(0.0, 8.0, 3)
                place = {"lat": sample.lat + north / 6.37e6, "lon": sample.lon + east / 6.37e6 / math.cos(sample.lat)}
                sample = replace(sample, **place, alt=sample.alt + up)
            yield sample

    told = tell(recording, samples=noisy(), learner__enabled=False)
    assert told.when("gnss.scatters")[0] < 8.0
    later = told.t > told.when("gnss.scatters")[0] + 1.0
    assert (told.off[later] < 3.0 * told.sigma[later] + 1.0).all()
    assert set(told.modes_between(10.0, 40.0)) == {Mode.AIDED}


@pytest.mark.parametrize("sd", [2.0, 4.0])
def test_velocities_that_a_driver_derives_from_positions_are_used_as_noisy(sd: float) -> None:
    """GIVEN velocities that scatter by metres per second and state less WHEN GNSS is lost THEN the noise has been told,
    is taken for nothing else, and the outage is flown within three sigma, not much farther off than without it."""
    recording, rng = flight("fixed_wing", 90.0).with_faults(*silence(65.0, 25.0)), np.random.default_rng(3)

    def noisy() -> Iterator[Sample]:
        for sample in recording.samples():
            if isinstance(sample, GnssVelocity) and sample.stamp_ns > recording.start_ns + 30_000_000_000:
                sample = replace(sample, vel_enu=tuple((sample.vel_enu + rng.normal(0.0, sd, 3)).tolist()))
            yield sample

    told = tell(recording, samples=noisy(), learner__enabled=False)
    assert 30.0 < told.when("gnss.velocity.scatters")[0] < 40.0
    for wrong in ("gnss.pulled", "gnss.drift", "gnss.other_motion", "gnss.delayed", "gnss.velocity.axes"):
        assert told.when(wrong) == [], wrong
    inside = told.between(65.0, 89.0)
    assert (told.off[inside] < 3.0 * told.sigma[inside]).all()
    assert told.off[inside].max() < 40.0


def test_motion_to_the_north_is_no_noise_to_the_east() -> None:
    """GIVEN a fast flight far from the Greenwich meridian THEN its fixes do not scatter."""
    recording = flight("fixed_wing", 50.0)

    def far_west() -> Iterator[Sample]:
        for sample in recording.samples():
            yield replace(sample, lon=sample.lon - 2.5) if isinstance(sample, GnssFix) else sample

    told = tell(recording, samples=far_west(), learner__enabled=False)
    assert told.when("gnss.scatters") == []


def test_a_static_hold_that_does_not_end_at_the_take_off_is_a_stuck_receiver() -> None:
    """GIVEN a receiver that repeats its position and a velocity of zero WHEN the vehicle climbs with the barometer
    THEN its fixes are not used, and the height is right."""
    recording, held = flight(duration=45.0), None

    def hold() -> Iterator[Sample]:
        nonlocal held
        for sample in recording.samples():
            if isinstance(sample, GnssVelocity):
                sample = replace(sample, vel_enu=(0.0, 0.0, 0.0))
            if isinstance(sample, GnssFix):
                held = held or sample
                sample = replace(held, stamp_ns=sample.stamp_ns)
            yield sample

    told = tell(recording, samples=hold(), learner__enabled=False)
    climbed = recording.truth.alt - recording.truth.alt[0]
    off = float(recording.truth.t[np.argmax(climbed > 6.0)])
    assert told.when("gnss.rejected.stuck")[0] < off
    high = told.between(off + 2.0, off + 10.0)
    assert (np.abs(told.error[high, 2]) < np.maximum(3.0 * np.sqrt(told.variances[high, 2]), 3.0)).all()
