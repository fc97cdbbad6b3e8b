"""A start so slow and smooth that the second alignment takes motion for rest, and finds a wrong heading."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import euler_from_quat
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.solutions import Event, NavBlock
from nav_pose_estimator.sim import scenarios
from nav_pose_estimator.sim.recording import Recording
from wrong_compass import turned, with_compass

pytestmark = pytest.mark.compiled
WRONG_START = "mag.heading.wrong_start"
SEEDS = (2, 3, 4)


@cache
def slow(seed: int) -> Recording:
    """A drone that takes ten seconds to its speed and flies half a minute of its first lane and turn."""
    vehicle = scenarios.DRONE.vehicle
    gentle = replace(vehicle, survey=replace(vehicle.survey, start=10.0))
    return scenarios.generate(replace(scenarios.DRONE, vehicle=gentle), 55.0, seed)


def flown(recording: Recording) -> tuple[list[str], np.ndarray]:
    """Names of the events; (N, 3) time [s], error of the heading and its stated deviation [rad]."""
    engine, names, rows, truth = SinsEngine(), [], [], recording.truth
    true = np.unwrap([euler_from_quat(q)[2] for q in truth.q_nb])
    for sample in recording.samples():
        for output in engine.feed(sample):
            if isinstance(output, Event):
                names.append(output.name)
            elif isinstance(output, NavBlock):
                t = (output.stamps_ns[-1] - recording.start_ns) * 1e-9
                row = output.rows[-1]
                yaw = euler_from_quat(row[at.OUT_QUAT : at.OUT_RATE])[2]
                error = math.remainder(yaw - np.interp(t, truth.t, true), 2.0 * math.pi)
                rows.append((t, abs(error), math.sqrt(row[at.OUT_VAR + at.PHI + 2])))
    return names, np.array(rows)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_good_compass_is_not_convicted_in_slow_smooth_motion(seed):
    # GIVEN a good compass, WHEN the vehicle sets off so gently that the second alignment goes astray
    names, rows = flown(slow(seed))
    # THEN the navigator, which GNSS bears out, keeps its heading, and it is as good as it says
    assert WRONG_START not in names
    assert (rows[:, 1] < 3.0 * rows[:, 2]).all()
    assert rows[-1, 1] < math.radians(5.0)


@pytest.mark.parametrize("degrees", [90.0, 180.0, -135.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrong_compass_leaves_no_wrong_heading_behind_in_slow_smooth_motion(seed, degrees):
    # GIVEN a compass turned by a right angle or more, WHEN the vehicle sets off so gently
    _, rows = flown(with_compass(slow(seed), turned(degrees)))
    # THEN half a minute of motion puts the heading right, or the navigator says how uncertain it is
    assert rows[-1, 1] < 3.0 * rows[-1, 2]
