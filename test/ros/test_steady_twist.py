"""The twist of odometry/filtered: corrections of the estimate enter it at a bounded rate, and the covariance tells."""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.rotation import quat_from_rotvec, quat_multiply, quat_to_matrix
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.solutions import Mode, NavSolution
from nav_pose_estimator.ros import qos
from nav_pose_estimator.ros.outputs import NavigationOutput
from pieces import one_by_one
from told import flight, silence

pytestmark = pytest.mark.compiled
START = 1_700_000_000_000_000_000
DT, G = 0.01, 9.80665
SLEW = 5.0
LOST, FOUND, END = 30.0, 60.0, 66.0  # s


class Twist(NamedTuple):
    """One message of odometry/filtered: velocity (3,) in b, its covariance (3, 3), the pose's position (3,)."""

    velocity: np.ndarray
    cov: np.ndarray
    position: np.ndarray


@pytest.fixture
def published(monkeypatch):
    """``published(solutions, slew)``: the messages of odometry/filtered that they lead to, one for each."""

    def observe(solutions: list[NavSolution], slew: float = SLEW) -> list[Twist]:
        heard: list[Twist] = []

        def keep(m) -> None:
            v, p = m.twist.twist.linear, m.pose.pose.position
            cov = np.array(m.twist.covariance).reshape(6, 6)[:3, :3]
            heard.append(Twist(np.array([v.x, v.y, v.z]), cov, np.array([p.x, p.y, p.z])))

        def advertise(node, kind, topic, profile=None):
            listener = keep if topic == "odometry/filtered" else lambda message: None
            return SimpleNamespace(publish=listener, get_subscription_count=lambda: 1)

        monkeypatch.setattr(qos, "advertise", advertise)
        changes = {"ros.output.odometry_rate": 0.0, "ros.output.velocity_slew": slew}
        output = NavigationOutput(None, update(Parameters(), changes))
        for solution in solutions:
            output.publish(solution)
        return heard

    return observe


def manoeuvre(seconds: float = 4.0) -> list[NavSolution]:
    """A hard one, as an IMU whose samples are means over their interval tells it, without any correction."""
    q, v, solutions = quat_from_rotvec(np.array([0.2, -0.1, 1.0])), np.array([12.0, -5.0, 1.0]), []
    for i in range(round(seconds / DT)):
        rate = np.array([1.5 * np.sin(i * DT), 0.8, -1.0])
        force = np.array([4.0, 3.0 * np.cos(3.0 * i * DT), 15.0])
        v = v + (quat_to_matrix(q) @ force - [0.0, 0.0, G]) * DT
        q = quat_multiply(q, quat_from_rotvec(rate * DT))
        solutions.append(_solution(i, v, q, rate, force))
    return solutions


def _solution(i: int, v: np.ndarray, q: np.ndarray, rate: np.ndarray, force: np.ndarray) -> NavSolution:
    parts = {"vel_n": v, "q_nb": q, "rate_b": rate, "force_b": force, "cov": 0.04 * np.eye(15)}
    return NavSolution.of(START + round(i * DT * 1e9), Mode.AIDED, correction_enu=np.zeros(3), **parts)


def stepped(solutions: list[NavSolution], at: int, velocity: np.ndarray, turn: np.ndarray) -> list[NavSolution]:
    """The same, from row ``at`` on corrected by ``velocity`` (3,) and the attitude by ``turn`` (3,) [rad]."""
    by = quat_from_rotvec(turn)
    changed = [
        _solution(i, s.vel_n + velocity, quat_multiply(by, s.q_nb), s.rate_b, s.force_b)
        for i, s in enumerate(solutions)
    ]
    return solutions[:at] + changed[at:]


def offsets(heard: list[Twist], plain: list[Twist]) -> np.ndarray:
    return np.array([a.velocity - b.velocity for a, b in zip(heard, plain, strict=True)])


def test_a_manoeuvre_without_corrections_is_not_held_back(published) -> None:
    """GIVEN turns of 2 rad/s at 15 m/s and 1.7 g WHEN nothing corrects the estimate THEN the twist is the estimate."""
    solutions = manoeuvre()
    off = offsets(published(solutions), published(solutions, 0.0))
    assert np.abs(off).max() < 0.05


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [0.0, 0.0, 0.15]], ids=["velocity", "and heading"])
def test_a_correction_enters_the_twist_at_a_bounded_rate_and_wholly(published, turn) -> None:
    """GIVEN a correction of 3 m/s, and of the heading by 9 deg, in mid-manoeuvre THEN what is published goes on where
    the motion led it, comes to the estimate by 5 m/s in a second and stays there; its covariance holds the rest."""
    smooth, at = manoeuvre(), 200
    solutions = stepped(smooth, at, np.array([2.0, -2.0, 1.0]), np.array(turn))
    heard, plain = published(solutions), published(solutions, 0.0)
    off = np.linalg.norm(offsets(heard, plain), axis=1)
    assert off[:at].max() < 0.05
    assert off[at] > 2.5
    falls = -np.diff(off)
    assert falls[at:].max() < SLEW * DT + 0.02
    assert off[at + round(off[at] / SLEW / DT) + 10 :].max() < 0.05
    for message, estimate, error in zip(heard, plain, offsets(heard, plain), strict=True):
        np.testing.assert_allclose(message.cov, estimate.cov + np.outer(error, error), atol=1e-9)
        np.testing.assert_array_equal(message.position, estimate.position)


def test_after_a_pause_it_begins_with_the_estimate(published) -> None:
    """GIVEN solutions that pause as in a new alignment WHEN they go on elsewhere THEN nothing is blended."""
    before, after = manoeuvre(1.0), [_solution(500 + i, np.ones(3), *s) for i, s in enumerate(_still(50))]
    off = offsets(published(before + after), published(before + after, 0.0))
    assert np.abs(off).max() < 0.05


def _still(count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    return [(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, G]))] * count


def test_an_outage_ends_without_a_step_and_the_covariance_holds_the_truth(published) -> None:
    """GIVEN thirty seconds without GNSS WHEN it returns THEN the estimate steps, and the twist by a few cm/s a
    message; its covariance holds the true velocity all the while."""
    recording = flight("multirotor_light", END)
    engine = PoseEstimator(update(Parameters(), {"learner.enabled": False}))
    solutions = [
        solution
        for sample in one_by_one(recording.with_faults(*silence(LOST, FOUND - LOST)).samples())
        for solution in engine.feed(sample)
        if isinstance(solution, NavSolution)
    ]
    heard, plain = published(solutions), published(solutions, 0.0)
    t = np.array([s.stamp_ns - recording.start_ns for s in solutions]) * 1e-9
    found = (t > FOUND - 1.0)[1:]
    step, blended = (
        np.linalg.norm(np.diff([m.velocity for m in messages], axis=0), axis=1)[found] for messages in (plain, heard)
    )
    most = SLEW * DT + 0.04  # by the correction, and by what the vehicle itself does
    assert step.max() > 3.0 * most
    assert blended.max() < most
    truth, wrong = recording.truth, []
    for when, message in zip(t, heard, strict=True):
        if when > FOUND:
            row = int(np.argmin(np.abs(truth.t - when)))
            error = message.velocity - quat_to_matrix(truth.q_nb[row]).T @ truth.v_n[row]
            wrong.append(error @ np.linalg.solve(message.cov, error))
    assert np.mean(np.array(wrong) < 16.3) > 0.97  # 99.9 % of a chi-square of three
