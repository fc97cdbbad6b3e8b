"""Noise of GNSS positions from fix to fix: measured, told, and no motion is taken for it."""

import math

import numpy as np
import pytest

from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla
from nav_pose_estimator.core.filter.layout import DVEL
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator.go_back import go_back
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.samples import GnssVelocity
from nav_pose_estimator.engine.sensors.gnss.reception import FixTrack
from nav_pose_estimator.engine.sensors.gnss.stated_accuracy import Scatter, VelocityScatter
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import full_set

STATED = 1.5  # m


def after(sd: float, drift: float = 0.0, period: float = 0.2, seed: int = 1) -> tuple[Scatter, Journal]:
    """Twenty seconds of fixes with noise [m] that drift [m/s] from the integral of their velocities."""
    rng, journal = np.random.default_rng(seed), Journal()
    scatter = Scatter(journal)
    for k in range(round(20.0 / period)):
        east, north, up = rng.normal(0.0, sd, 3) if sd else np.zeros(3)
        scatter.fix(k * period, complex(east + drift * k * period, north), up, STATED, k)
    return scatter, journal


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("sd", [5.0, 15.0])
def test_the_noise_is_measured_and_told_once(sd: float, seed: int) -> None:
    """GIVEN noise beyond the stated deviation THEN it is measured to a factor of two, on all axes."""
    scatter, journal = after(sd, seed=seed)
    assert all(0.5 * sd < measured < 2.0 * sd for measured in scatter.sd)
    assert journal.counters["gnss.scatters"] == 1
    assert f"{scatter.sd[0]:.1f} m" in scatter.reason


@pytest.mark.parametrize(("sd", "drift"), [(0.0, 30.0), (0.8, 0.0), (0.8, 5.0)])
def test_neither_drift_nor_usual_noise_is_scatter(sd: float, drift: float) -> None:
    """GIVEN positions that drift, or noise within the stated deviation THEN nothing is said."""
    scatter, _ = after(sd, drift)
    assert not scatter.is_on
    assert scatter.least_sd == (0.0, 0.0)


def test_slow_fixes_take_the_horizontal_noise_for_the_height() -> None:
    """GIVEN a fix a second WHEN they scatter THEN climbs are not taken for noise of the height."""
    scatter, _ = after(6.0, period=1.0)
    assert scatter.sd[1] == scatter.sd[0]


def test_it_ends() -> None:
    """GIVEN scatter WHEN the fixes are quiet again, or a height is missing THEN it ends."""
    scatter, journal = after(8.0)
    for k in range(20):
        scatter.fix(20.0 + 0.2 * k, 0j, math.nan, STATED, k)
    assert not scatter.is_on
    assert journal.counters["gnss.scatters.ended"] == 1


@pytest.mark.parametrize(("lat", "lon"), [(-33.9, 151.2), (67.0, 180.0), (-16.5, -180.0), (40.0, -90.0), (51.0, 0.0)])
def test_the_place_of_a_fix_is_in_metres_anywhere(lat: float, lon: float) -> None:
    """GIVEN a vehicle anywhere WHEN it flies North, then East THEN its place moves just that far."""
    track = FixTrack()
    flown = [complex(0.0, 10.0 * k) for k in range(31)] + [complex(10.0 * k, 300.0) for k in range(1, 31)]
    for place in flown:
        geodetic = enu_to_lla([place.real, place.imag, 0.0], math.radians(lat), math.radians(lon), 0.0)
        track.add(float(geodetic[0]), math.remainder(float(geodetic[1]), math.tau))
        assert abs(track.position - place) < 0.1


@pytest.mark.parametrize("seed", range(20))
def test_a_noisy_receiver_that_says_so_does_not_scatter(seed: int) -> None:
    """GIVEN white noise just as stated THEN nothing is said of it, neither at once nor by chance later."""
    _, journal = after(STATED, seed=seed)
    assert journal.counters["gnss.scatters"] == 0


def test_centimetres_of_an_rtk_receiver_are_not_the_limit() -> None:
    """GIVEN a stated deviation of 1 cm WHEN the differences of positions and velocities are 0.2 m THEN it is no
    scatter, and a metre is."""
    rng, journal = np.random.default_rng(4), Journal()
    scatter = Scatter(journal)
    for k in range(200):
        sd = 0.2 if k < 100 else 1.0
        scatter.fix(0.2 * k, complex(*rng.normal(0.0, sd, 2)), 0.0, 0.01, k)
        if k < 100:
            assert not scatter.is_on
    assert scatter.is_on


def velocities(sd: float, stated: float = 0.5, seed: int = 1) -> tuple[VelocityScatter, Journal]:
    """Twenty seconds of changes of velocities with noise [m/s]."""
    rng, journal = np.random.default_rng(seed), Journal()
    scatter, noise = VelocityScatter(journal), rng.normal(0.0, sd, (101, 2))
    for k, (east, north) in enumerate(np.diff(noise, axis=0).tolist()):
        scatter.change(0.2, east, north, stated)
        if k % 5 == 4:
            scatter.second(k)
    return scatter, journal


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("sd", [2.0, 6.0])
def test_noise_of_velocities_is_measured_and_told_once(sd: float, seed: int) -> None:
    """GIVEN noise beyond the stated deviation THEN it is measured to a factor of two."""
    scatter, journal = velocities(sd, seed=seed)
    assert 0.5 * sd < scatter.sd < 2.0 * sd
    assert journal.counters["gnss.velocity.scatters"] == 1


def test_noise_of_velocities_within_the_stated_one_is_no_scatter() -> None:
    """GIVEN noise as stated THEN nothing is said."""
    scatter, journal = velocities(0.5)
    assert not scatter.is_on
    assert not journal.counters


def test_scatter_of_velocities_ends() -> None:
    """GIVEN scatter WHEN the velocities are quiet for as long as it was measured THEN it ends."""
    scatter, journal = velocities(3.0)
    for k in range(30):
        scatter.change(0.2, 0.0, 0.0, 0.5)
        scatter.second(k)
    assert not scatter.is_on
    assert journal.counters["gnss.velocity.scatters.ended"] == 1


def test_a_pause_of_velocities_is_no_scatter() -> None:
    """GIVEN velocities with pauses THEN the change over a pause counts for nothing."""
    scatter = VelocityScatter(Journal())
    for k in range(60):
        scatter.change(2.0, 9.0 * (-1.0) ** k, 0.0, 0.5)
        scatter.second(k)
    assert not scatter.is_on


def test_scatter_of_velocities_is_known_after_a_restart() -> None:
    """GIVEN velocities that scatter WHEN the navigator starts again THEN it aligns with their noise, and says so."""
    engine = SinsEngine()
    engine.run.gnss.reception.velocity_scatter.sd = 3.0
    engine.reset(1, "test")
    noise = engine.run.gnss.reception.velocity_noise(GnssVelocity(2, (0.0, 0.0, 0.0)))
    assert (np.diag(noise) > 3.0**2).all()
    assert engine.status().doubt == "GNSS velocities scatter by 3.0 m/s, more than stated"


@pytest.mark.compiled
def test_scatter_of_velocities_is_known_where_the_past_is_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """GIVEN velocities that scatter WHEN the last seconds are computed again THEN it is with that noise, which stays
    known."""
    monkeypatch.setattr(VelocityScatter, "second", lambda *_: None)  # these would be found to be quiet
    engine = SinsEngine()
    engine.feed_all(full_set(30.0, 100.0))
    run, scatter = engine.run, engine.run.gnss.reception.velocity_scatter
    scatter.sd = 3.0
    again = go_back(run, 1)
    assert again is not run
    assert again.gnss.reception.velocity_scatter is scatter
    assert again.settled.P[DVEL, DVEL] > 2.0 * run.settled.P[DVEL, DVEL]
