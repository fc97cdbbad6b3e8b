"""Switched on, or given its first fix, in a steady motion, which leaves the IMU as still as rest."""

from collections.abc import Iterator

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.samples import GnssVelocity, ImuBlock, Sample, stamp_of
from nav_pose_estimator.engine.solutions import Mode
from told import GNSS, Told, flight, tell

pytestmark = pytest.mark.compiled
BEGIN = 40.0  # s: in the laps


def later(*without: type) -> Iterator[Sample]:
    """The laps from ``BEGIN`` on, without samples of these kinds."""
    recording = flight("laps", 90.0, 1)
    for sample in recording.samples():
        stamp = stamp_of(sample)
        if stamp is not None and (stamp - recording.start_ns) * 1e-9 > BEGIN and not isinstance(sample, without):
            yield sample


def late_fixes() -> Iterator[Sample]:
    """All of the flight, with GNSS from ``BEGIN`` on."""
    recording = flight("laps", 90.0, 1)
    for sample in recording.samples():
        stamp = stamp_of(sample)
        if not isinstance(sample, GNSS) or (stamp is not None and (stamp - recording.start_ns) * 1e-9 > BEGIN):
            yield sample


def tilt_off(told: Told) -> float:
    """How far the last attitude's vertical is off [deg]; 0 without a solution."""
    if told.last is None or not len(told.t):
        return 0.0
    truth = told.recording.truth
    row = int(np.searchsorted(truth.t, told.t[-1]))
    up = quat_to_matrix(told.last.q_nb)[2] @ quat_to_matrix(truth.q_nb[min(row, len(truth) - 1)])[2]
    return float(np.degrees(np.arccos(min(up, 1.0))))


@pytest.mark.parametrize("samples", [lambda: later(GnssVelocity), late_fixes], ids=["no velocity", "late fixes"])
def test_a_steady_motion_is_not_taken_for_rest(samples) -> None:
    """GIVEN laps flown so smoothly that the IMU seems to rest WHEN the estimator starts there, by fixes alone or with
    the first fix in flight THEN it does not align at rest: no attitude, or a right one."""
    told = tell(flight("laps", 90.0, 1), samples=samples())
    assert not any("at rest" in event.text for event in told.events if event.name == "aligned")
    assert tilt_off(told) < 2.0


def test_fixes_without_velocity_still_align_at_rest() -> None:
    """GIVEN a vehicle at rest with a magnetometer WHEN its receiver tells no velocity THEN two seconds more suffice."""
    recording = flight("laps", 90.0, 1)
    samples = (sample for sample in recording.samples() if not isinstance(sample, GnssVelocity))
    first = []
    for sample in samples:
        first.append(sample)
        if isinstance(sample, ImuBlock) and (sample.stamps_ns[-1] - recording.start_ns) * 1e-9 > 8.0:
            break
    told = tell(recording, samples=iter(first))
    assert told.modes[-1] is Mode.AIDED
    assert told.t[0] < 6.0
