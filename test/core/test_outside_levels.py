"""The tilt of an attitude filter helps the aligner to level a start in motion."""

import math

import numpy as np
import pytest
from test_alignment import WEAVE, Story, assert_honest, facing, settings

from nav_pose_estimator.core.alignment import aligner as alignment
from nav_pose_estimator.core.alignment.aligner import Aligner
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import quat_from_rotvec, quat_multiply, quat_to_matrix


def start_in_the_air(tilt_sd, offset=0.0, late=0.0):
    """(story, result) of a flight that starts in the air, with attitudes of an outside filter where ``tilt_sd``."""
    story = Story(facing(WEAVE, 1.0), 12.0, rate=50.0, seed=3)
    aligner = Aligner(settings(hypotheses=6, heading_sd=0.3))
    if tilt_sd is not None:
        turn = quat_from_rotvec(np.array([offset, 0.0, 0.7]))  # tilted by offset, and its own heading
        for t, q in zip(story.truth.t, story.truth.q_nb, strict=True):
            if t < 2.0:
                aligner.outside.add(t + late, quat_multiply(turn, q), tilt_sd)
    return story, story.tell(aligner)[0]


def tilt_at_start(monkeypatch, *outside):
    """(tilt error, stated deviation) [rad] with which the bank of hypotheses begins."""
    begun = []

    class Spy(alignment.HeadingHypotheses):
        def __init__(self, nav, P, *rest):
            begun.append((nav.copy(), P.copy()))
            super().__init__(nav, P, *rest)

    monkeypatch.setattr(alignment, "HeadingHypotheses", Spy)
    story, result = start_in_the_air(*outside)
    assert_honest(story, result)
    nav, P = begun[0]
    truth = story.truth.at(np.array([nav[at.TIME]])).q_nb[0]
    up, believed = (quat_to_matrix(q)[2] for q in (truth, nav[at.QUAT : at.QUAT + 4]))
    return math.acos(min(float(up @ believed), 1.0)), math.sqrt(P[at.PHI, at.PHI])


def test_the_tilt_of_an_attitude_filter_levels_a_start_in_motion(monkeypatch):
    """GIVEN attitudes 1 deg off in tilt, of any heading WHEN it starts in motion THEN with that tilt."""
    error, sd = tilt_at_start(monkeypatch, math.radians(2.0), math.radians(1.0))
    assert error == pytest.approx(math.radians(1.0), rel=0.2)
    assert sd == pytest.approx(math.radians(2.0), rel=0.01)


def test_an_attitude_of_another_time_or_of_no_use_is_not_taken(monkeypatch):
    """GIVEN attitudes from elsewhere in time, or worse than one's own level THEN the mean force levels as without."""
    own = tilt_at_start(monkeypatch, None)
    assert tilt_at_start(monkeypatch, math.radians(2.0), 0.3, -100.0) == own
    assert tilt_at_start(monkeypatch, 1.0, 0.3) == own
