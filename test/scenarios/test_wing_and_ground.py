"""Two sensors that hold an outage: the airspeed of a wing, and a rangefinder over flat ground."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter.blocks import AIRSPEED, WIND
from nav_pose_estimator.core.filter.layout import DPOS, TIME
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import (
    Airspeed,
    DifferentialPressure,
    GnssFix,
    GnssVelocity,
    RangeToGround,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate

GNSS = (GnssFix, GnssVelocity, SatelliteCount)
LOST, BACK = 150.0, 210.0


@pytest.fixture(scope="module")
def wing() -> Recording:
    return generate("fixed_wing_airspeed", duration=212.0, seed=3, imu="mpu6000", imu_rate=50.0)


def fly(engine, recording: Recording, samples: Iterable[Sample] | None = None, lost: float = LOST, until: float = BACK):
    """The flight without GNSS from ``lost`` to ``until`` [s], where it ends: horizontal and vertical error [m]."""
    zero, truth = recording.start_ns, recording.truth
    last = zero
    for sample in recording.samples() if samples is None else samples:
        if hasattr(sample, "stamps_ns"):
            last = int(sample.stamps_ns[-1])
        t = (last - zero) * 1e-9
        if t > until:
            break
        if not (isinstance(sample, GNSS) and t >= lost):
            engine.feed(sample)
    sins = engine if isinstance(engine, SinsEngine) else engine.sins
    nav = sins.run.settled.nav
    row = int(np.searchsorted(truth.t, nav[TIME] + (sins.run.clock.zero_ns - zero) * 1e-9))
    east, north, up = lla_to_enu(nav[0], nav[1], nav[2], truth.lat[row], truth.lon[row], truth.alt[row])
    return float(np.hypot(east, north)), abs(float(up)), sins


@pytest.mark.compiled
def test_a_wing_with_a_pitot_tube_coasts_with_it(wing):
    """GIVEN a wing that learned wind and scale WHEN GNSS is away for 60 s THEN it drifts at most half as far as without
    the sensor, knows it within 3 sigma, and says that the drift is bounded."""
    with_it, _, sins = fly(PoseEstimator(), wing)
    without, _, _ = fly(PoseEstimator(update(Parameters(), {"aids.airspeed": False})), wing)
    assert sins.mode is Mode.COASTING
    assert with_it <= 0.5 * without
    assert with_it < 3.0 * sins.status().horizontal_sd


@pytest.mark.compiled
def test_scale_and_wind_are_learned_while_gnss_is_good(wing):
    """GIVEN a pitot tube that reads 8 % too much WHEN the wing has flown circles THEN scale and wind are known."""
    samples = (replace(s, speed=1.08 * s.speed) if isinstance(s, Airspeed) else s for s in wing.samples())
    _, _, sins = fly(SinsEngine(), wing, samples, lost=1e9, until=LOST)
    scale = sins.run.settled.nav[AIRSPEED.estimates][0]
    _, _, plain = fly(SinsEngine(), wing, lost=1e9, until=LOST)
    assert scale - plain.run.settled.nav[AIRSPEED.estimates][0] == pytest.approx(0.08, abs=0.02)
    truth = wing.truth.wind_n[wing.truth.t > LOST - 60.0].mean(axis=0)[:2]
    assert np.linalg.norm(sins.run.settled.nav[WIND.estimates] - truth) < 1.0


def test_a_differential_pressure_says_the_same_as_the_airspeed(wing):
    """GIVEN the same flight with the tube's pressure instead WHEN both are flown THEN the winds agree."""
    from nav_pose_estimator.core.earth.atmosphere import air_density, height_pressure

    density = air_density(height_pressure(float(wing.truth.alt.mean())))

    def as_pressure(sample: Sample) -> Sample:
        if not isinstance(sample, Airspeed) or sample.stamp_ns is None:
            return sample
        return DifferentialPressure(sample.stamp_ns, 0.5 * density * sample.speed**2)

    _, _, sins = fly(SinsEngine(), wing, map(as_pressure, wing.samples()), lost=1e9, until=80.0)
    _, _, plain = fly(SinsEngine(), wing, lost=1e9, until=80.0)
    assert plain.journal.counters["airspeed.used"] > 100
    assert sins.journal.counters["airspeed.used"] == pytest.approx(plain.journal.counters["airspeed.used"], rel=0.05)
    apart = sins.run.settled.nav[WIND.estimates] - plain.run.settled.nav[WIND.estimates]
    assert np.abs(apart).max() < 0.5


def test_without_the_sensor_the_filter_is_the_one_it_was(wing):
    """GIVEN a wing whose airspeeds say nothing (NaN, standing still, absurd) THEN no state was added."""
    for speed in (float("nan"), 0.0, 1e9):
        samples = (replace(s, speed=speed) if isinstance(s, Airspeed) else s for s in wing.samples())
        _, _, sins = fly(SinsEngine(), wing, samples, lost=1e9, until=30.0)
        assert not WIND.is_in(sins.run.timeline.filter.constants)
        assert sins.journal.counters["airspeed.used"] == 0


# --- range to ground -----------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def hover() -> Recording:
    return generate("hover_range", duration=152.0, seed=2, imu="mpu6000", imu_rate=50.0)


def over(recording: Recording, roof: float, start: float, end: float) -> Iterable[Sample]:
    """The ranges over a roof of so many metres from ``start`` to ``end`` [s]."""
    for sample in recording.samples():
        if isinstance(sample, RangeToGround) and start <= (sample.stamp_ns - recording.start_ns) * 1e-9 < end:
            sample = replace(sample, distance=max(sample.distance - roof, 0.1))
        yield sample


NO_BAROMETER = {"aids.barometer": False}


@pytest.mark.compiled
def test_a_rangefinder_holds_the_height(hover):
    """GIVEN flat ground and no barometer WHEN GNSS is away for 60 s THEN the height is held, and known to be."""
    _, with_it, sins = fly(SinsEngine(update(Parameters(), NO_BAROMETER)), hover, lost=90.0, until=150.0)
    none = update(Parameters(), {**NO_BAROMETER, "aids.range": False})
    _, _, free = fly(SinsEngine(none), hover, lost=90.0, until=150.0)
    assert sins.journal.counters["range.used"] > 200
    held_sd, free_sd = (np.sqrt(one.run.settled.P[DPOS + 2, DPOS + 2]) for one in (sins, free))
    assert with_it < min(1.0, 3.0 * held_sd)
    assert held_sd < 0.3 * free_sd
    assert 0.0 < sins.status().values["rangefinder.above_ground_m"] < 60.0


@pytest.mark.compiled
def test_a_roof_is_not_taken_for_a_descent(hover):
    """GIVEN an outage WHEN a roof of 5 m comes under the vehicle and stays THEN the height does not move with it."""
    engine = SinsEngine(update(Parameters(), NO_BAROMETER))
    _, error, sins = fly(engine, hover, over(hover, 5.0, 110.0, 1e9), lost=90.0, until=150.0)
    assert sins.journal.counters["range.rejected"] >= 5
    assert sins.journal.counters["range.new_ground"] >= 1
    assert error < 2.0


def test_a_range_is_never_an_altitude(hover):
    """GIVEN ranges that are 30 m off from the start WHEN GNSS is good THEN the height is that of GNSS."""
    _, error, _ = fly(SinsEngine(), hover, over(hover, -30.0, 0.0, 1e9), lost=1e9, until=60.0)
    assert error < 3.0
