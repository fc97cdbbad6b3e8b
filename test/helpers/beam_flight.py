"""A flight with beam velocities and a long GNSS outage in the navigator."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter.layout import TIME
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BeamVelocitySample, ImuBlock, ImuSample, Sample, stamp_of
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate
from told import silence

LOST, END = 60.0, 110.0  # s


def beam_flight() -> Recording:
    """Flight of a drone with a GNSS outage from ``LOST`` to ``END``."""
    recording = generate("multirotor_outage", END + 1.0, seed=5, imu_rate=50.0)
    return recording.with_faults(*silence(LOST, END - LOST))


class Flown:
    """The engine after ``samples`` up to ``until`` [s], its events, and its horizontal error [m]."""

    def __init__(self, recording: Recording, samples: Iterable[Sample], until: float = END, **beams) -> None:
        self.engine = SinsEngine(update(Parameters(), {f"aids.beams.{key}": value for key, value in beams.items()}))
        self.events: list[Event] = []
        for sample in samples:
            if isinstance(sample, ImuSample | ImuBlock) and stamp_of(sample) > recording.start_ns + until * 1e9:
                break
            self.events += [output for output in self.engine.feed(sample) if isinstance(output, Event)]
        self.nav, truth = self.engine.run.settled.nav, recording.truth
        t = self.nav[TIME] + (self.engine.run.clock.zero_ns - recording.start_ns) * 1e-9
        row = int(np.searchsorted(truth.t, t))
        place = lla_to_enu(*self.nav[:3], truth.lat[row], truth.lon[row], truth.alt[row])
        self.error = float(np.hypot(*place[:2]))
        self.counters, self.status = self.engine.journal.counters, self.engine.status()

    def said(self, name: str) -> list[str]:
        return [event.text for event in self.events if event.name == f"beam_velocity.{name}"]

    def refused(self, beam: int) -> int:
        return sum(n for name, n in self.counters.items() if name.startswith(f"beam_velocity.{beam}.rejected"))


def on_velocities(change: Callable[[float, np.ndarray], None]):
    """A change of messages that edits their velocities (4,) in place."""

    def changed(t: float, sample: BeamVelocitySample) -> BeamVelocitySample:
        velocities = sample.velocities.copy()
        change(t, velocities)
        return replace(sample, velocities=velocities)

    return changed
