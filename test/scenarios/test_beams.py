"""A Doppler log whose beams are used one by one: outages, faults of single beams, wrong set-ups."""

import numpy as np
import pytest

from beamed import with_beams
from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter.layout import TIME
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.solutions import Event, Mode
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate
from told import silence

LOST, END = 60.0, 110.0


@pytest.fixture(scope="module")
def flight() -> Recording:
    recording = generate("multirotor_outage", END + 1.0, seed=5, imu_rate=50.0)
    return recording.with_faults(*silence(LOST, END - LOST))


def fly(recording: Recording, samples, until: float = END, **changes):
    """(horizontal error [m] at ``until`` [s], engine, events)."""
    engine, events = SinsEngine(update(Parameters(), {f"aids.beams.{k}": v for k, v in changes.items()})), []
    zero, truth = recording.start_ns, recording.truth
    for sample in samples:
        stamp = sample.stamps_ns[-1] if hasattr(sample, "stamps_ns") else None
        if stamp is not None and (stamp - zero) * 1e-9 > until:
            break
        events += [output for output in engine.feed(sample) if isinstance(output, Event)]
    nav = engine.run.settled.nav
    row = int(np.searchsorted(truth.t, nav[TIME] + (engine.run.clock.zero_ns - zero) * 1e-9))
    east, north, _ = lla_to_enu(nav[0], nav[1], nav[2], truth.lat[row], truth.lon[row], truth.alt[row])
    return float(np.hypot(east, north)), engine, events


@pytest.mark.compiled
def test_beams_hold_an_outage(flight):
    """GIVEN a drone with four beams WHEN GNSS is away for 50 s THEN it drifts a tenth as far as without them at most,
    knows it within 3 sigma, and says that the drift is bounded."""
    without, _, _ = fly(flight, flight.samples())
    error, engine, events = fly(flight, with_beams(flight))
    assert error < 0.1 * without
    assert error < 3.0 * engine.status().horizontal_sd
    assert engine.mode is Mode.COASTING
    (told,) = [event.text for event in events if event.name == "beam_velocity.geometry"]
    assert "4 beams, directions as published, positive for motion along the beam" in told
