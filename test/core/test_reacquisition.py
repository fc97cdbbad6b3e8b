"""The return from an outage: stories of GNSS that comes back wrong before it comes back right."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from nav_pose_estimator.core.gnss.reacquisition import Reacquisition, ReacquisitionSettings
from nav_pose_estimator.core.gnss.return_evidence import unexplained as unexplained_by_drift
from nav_pose_estimator.engine.parameters import Parameters

PERIOD = 0.2
SETTINGS = ReacquisitionSettings(
    policy="blend",
    fixes=5,
    min_duration=0.8,
    loss_time=1.0,
    sigmas=4.0,
    max_speed=40.0,
    max_acceleration=40.0,
    velocity_tolerance=0.5,
    contradiction_time=10.0,
    implausible_time=20.0,
    track_timeout=2.0,
    probation=60.0,
)


def truth(t):
    """A vehicle on a circle: position and velocity, ENU."""
    w, r = 0.1, 80.0
    position = np.array([r * math.cos(w * t), r * math.sin(w * t), 30.0])
    return position, np.array([-r * w * math.sin(w * t), r * w * math.cos(w * t), 0.0])


@dataclass
class Filter:
    """A stand-in for the navigator: its error drifts without GNSS, and the fixes that it takes remove it.

    As in the navigator the velocity stays right, so that positions alone pull slowly.
    """

    machine: Reacquisition
    drift: np.ndarray = field(default_factory=lambda: np.array([0.3, -0.2, 0.02]))  # m/s^2 while coasting
    sd_growth: float = 0.4  # m/s^2
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(7))
    t: float = 0.0
    error: np.ndarray = field(default_factory=lambda: np.zeros(3))
    last_used: float = 0.0
    log: list = field(default_factory=list)

    @property
    def predicted_sd(self):
        return 0.8 + 0.5 * self.sd_growth * (self.t - self.last_used) ** 2

    def coast(self, seconds):
        """No fixes at all."""
        self.t += seconds
        self.error = self.error + 0.5 * self.drift * seconds**2

    def fly(self, seconds, offset=(0.0, 0.0, 0.0), offset_rate=(0.0, 0.0, 0.0), use_velocity=True):
        """Fixes with an ``offset`` from the truth that grows at ``offset_rate``; returns the decisions."""
        decisions = []
        for i in range(round(seconds / PERIOD)):
            self.t += PERIOD
            position, velocity = truth(self.t)
            wrong = np.array(offset) + np.array(offset_rate) * i * PERIOD
            fix = position + wrong + self.rng.normal(0.0, [0.3, 0.3, 0.5])
            predicted = position + self.error
            gap = self.t - self.last_used
            speed = velocity + self.rng.normal(0.0, 0.05, 3) if use_velocity else None
            decision = self.machine.offer(self.t, fix, speed, (1.5, 1.5, 2.5), predicted, self.predicted_sd, gap)
            if decision.action == "fuse":
                self.error = self.error + (0.1 if decision.gated else 0.99) * (fix - predicted)
            if decision.action == "reset":
                self.error = self.error + (fix - predicted)
            if decision.action in ("fuse", "reset"):
                self.last_used = self.t
            decisions.append(decision)
        self.log += decisions
        return decisions

    @property
    def off(self):
        return float(np.linalg.norm(self.error))


@pytest.fixture
def aided():
    vehicle = Filter(Reacquisition(SETTINGS))
    vehicle.fly(120.0)
    assert {d.reason for d in vehicle.log} == {"gnss.fuse"}
    return vehicle


def first(decisions, *actions):
    """Seconds until one of ``actions``."""
    return next((i * PERIOD for i, d in enumerate(decisions) if d.action in actions), math.inf)


def test_the_defaults_are_a_valid_setting():
    parameters = Parameters()
    given = {name: getattr(parameters.gnss.reacquisition, name, 1.0) for name in ReacquisitionSettings.__slots__}
    chosen = ReacquisitionSettings(**given)
    assert chosen.min_duration < chosen.contradiction_time < chosen.implausible_time
    assert chosen.fixes >= 3


def test_expected_return_is_fused_after_enough_consistent_fixes(aided):
    """GIVEN 30 s of coasting WHEN GNSS returns where the filter expects it THEN five fixes later it is fused."""
    aided.coast(30.0)
    decisions = aided.fly(5.0)
    assert first(decisions, "fuse") == pytest.approx(0.8)
    assert {d.reason for d in decisions[:4]} == {"gnss.waiting.consistency"}
    assert decisions[4].reason == "gnss.reacquired.expected"
    assert not decisions[4].gated
    assert decisions[4].notice is not None
    assert not [d for d in decisions if d.action == "reset"]
    assert aided.off < 3.0


def test_a_15_m_spike_is_refused_and_costs_one_fix(aided):
    """GIVEN an aided filter WHEN one fix is 15 m off THEN it alone is refused."""
    spike = aided.fly(PERIOD, offset=(15.0, 0.0, 0.0))
    assert [d.reason for d in spike] == ["gnss.rejected.innovation"]
    assert spike[0].sigmas > SETTINGS.sigmas
    assert {d.action for d in aided.fly(5.0)} == {"fuse"}


def test_a_permanent_50_m_step_while_aided_is_accepted_within_the_configured_time(aided):
    """GIVEN an aided filter WHEN all fixes step by 50 m for good THEN GNSS is not locked out, and the reset is loud."""
    decisions = aided.fly(40.0, offset=(50.0, 0.0, 0.0))
    taken = first(decisions, "reset")
    assert taken <= SETTINGS.implausible_time + 2 * PERIOD
    assert taken >= SETTINGS.contradiction_time
    notice = next(d.notice for d in decisions if d.action == "reset")
    assert notice.severity == "error"
    assert notice.name == "gnss.reset.implausible"
    assert decisions[0].reason == "gnss.rejected.innovation"
    assert {d.action for d in decisions[-50:]} == {"fuse"}


def test_a_return_300_m_off_is_not_taken_at_once_and_left_when_the_truth_comes(aided):
    """GIVEN 20 s of coasting WHEN GNSS returns 300 m off for 20 s THEN it is doubted, and the truth wins soon."""
    aided.drift, aided.sd_growth = np.array([0.1, 0.1, 0.01]), 0.15
    aided.coast(20.0)
    wrong = aided.fly(20.0, offset=(300.0, 0.0, 0.0))
    assert first(wrong, "fuse", "reset") >= SETTINGS.contradiction_time
    right = aided.fly(20.0)
    assert first(right, "fuse", "reset") <= 1.5
    assert aided.off < 3.0
    assert {d.action for d in right[-50:]} == {"fuse"}


def test_a_dense_outlier_cluster_at_the_end_of_a_blackout_does_not_capture_the_filter(aided):
    """GIVEN a black-out of 460 s WHEN a tight cluster 700 m off comes first, then the truth THEN the truth wins."""
    aided.drift = np.array([0.003, -0.002, 0.0])
    aided.sd_growth = 0.006
    aided.coast(460.0)
    wrong = aided.fly(8.0, offset=(500.0, -490.0, 0.0))
    assert first(wrong, "fuse", "reset") < math.inf  # nothing speaks against it: one sigma of the prediction is 600 m
    right = aided.fly(30.0)
    assert first(right, "reset") <= 8.0 + 3 * PERIOD  # it has to last as long as what it contradicts
    assert aided.off < 3.0
    notice = next(d.notice for d in right if d.action == "reset")
    assert notice.name == "gnss.reset.reopened"


def test_outliers_mixed_with_the_truth_do_not_win(aided):
    """GIVEN 60 s of coasting WHEN every third fix lies in a tight cluster 200 m off THEN the truth is taken."""
    aided.coast(30.0)
    for _ in range(30):
        aided.fly(2 * PERIOD)
        aided.fly(PERIOD, offset=(200.0, 0.0, 0.0))
    assert aided.off < 3.0
    assert [d.action for d in aided.log[-3:]] == ["fuse", "fuse", "reject"]


def test_a_spoofer_that_drags_the_position_against_its_own_velocity_is_exposed(aided):
    """GIVEN an outage WHEN fixes drift at 12 m/s away from what their velocities say THEN only time and noise win."""
    aided.coast(10.0)
    decisions = aided.fly(18.0, offset_rate=(12.0, 0.0, 0.0))
    assert not [d for d in decisions if d.action == "reset"]
    assert aided.off < 20.0
    later = aided.fly(10.0, offset=(216.0, 0.0, 0.0), offset_rate=(12.0, 0.0, 0.0))
    notice = next(d.notice for d in later if d.action == "reset")
    assert (notice.name, notice.severity) == ("gnss.reset.inconsistent", "error")


def test_a_receiver_with_a_frozen_velocity_is_not_locked_out(aided):
    aided.coast(10.0)
    decisions = []
    for i in range(150):
        t = aided.t + i * PERIOD
        position, _ = truth(t)
        decisions.append(
            aided.machine.offer(t, position, (0.0, 0.0, 0.0), 1.5, position + 2.0, 20.0, 10.0 + i * PERIOD)
        )
    assert first(decisions, "reset", "fuse") <= SETTINGS.implausible_time + 2 * PERIOD


def test_a_spoofed_drift_that_was_believed_is_left_when_the_truth_speaks(aided):
    """GIVEN a return that drifts at 0.4 m/s, too slow to tell WHEN it jumps back to the truth THEN that is accepted."""
    aided.coast(60.0)
    aided.fly(100.0, offset_rate=(0.4, 0.0, 0.0))
    assert aided.off > 20.0
    assert first(aided.fly(40.0), "reset") <= SETTINGS.implausible_time + 2 * PERIOD
    assert aided.off < 3.0


def test_an_impossible_distance_takes_long_and_is_loud(aided):
    """GIVEN a 3 s outage WHEN GNSS returns 2 km away for good THEN it takes the longest time and an error notice."""
    aided.coast(3.0)
    decisions = aided.fly(40.0, offset=(2000.0, 0.0, 0.0))
    assert first(decisions, "reset") == pytest.approx(SETTINGS.implausible_time, abs=2 * PERIOD)
    assert "gnss.waiting.implausible" in {d.reason for d in decisions}
    assert next(d.notice for d in decisions if d.action == "reset").severity == "error"


def test_without_velocity_the_return_works_as_well(aided):
    aided.coast(30.0)
    decisions = aided.fly(5.0, use_velocity=False)
    assert first(decisions, "fuse") == pytest.approx(0.8)


def test_an_overconfident_filter_is_overruled_in_time(aided):
    """GIVEN a filter 150 m off that claims 3 m WHEN GNSS returns THEN the reset comes after the contradiction time."""
    aided.drift = np.array([0.33, 0.0, 0.0])
    aided.sd_growth = 0.005
    aided.coast(30.0)
    decisions = aided.fly(20.0)
    assert first(decisions, "reset") == pytest.approx(SETTINGS.contradiction_time, abs=2 * PERIOD)
    assert aided.off < 3.0


def test_policy_reset_always_resets(aided):
    aided.machine.settings = replace(SETTINGS, policy="reset")
    aided.coast(30.0)
    decisions = aided.fly(5.0)
    assert first(decisions, "reset") == pytest.approx(0.8)


def test_policy_hold_waits_for_the_operator_unless_the_return_is_expected(aided):
    aided.machine.settings = replace(SETTINGS, policy="hold")
    aided.coast(30.0)
    assert first(aided.fly(5.0), "fuse") == pytest.approx(0.8)
    aided.sd_growth = 0.01
    aided.coast(10.0)
    held = aided.fly(60.0, offset=(300.0, 0.0, 0.0))
    assert {d.action for d in held} == {"wait"}
    assert held[-1].reason == "gnss.held"
    assert aided.machine.decide(accept=True)
    assert aided.fly(PERIOD, offset=(300.0, 0.0, 0.0))[0].action == "reset"


def test_a_fix_approved_here_but_refused_by_the_filter_shows_as_a_gap():
    """GIVEN fixes that pass this bound but not the filter's gate THEN after the loss time they are fused ungated."""
    machine = Reacquisition(SETTINGS)
    actions = []
    for i in range(40):
        t = 10.0 + i * PERIOD
        actions.append(machine.offer(t, (4.0, 0.0, 0.0), None, 1.5, (0.0, 0.0, 0.0), 1.0, gap_s=0.2 + i * PERIOD))
    assert actions[0].gated
    assert not actions[-1].gated


def test_the_vertical_counts_too(aided):
    decisions = aided.fly(40.0, offset=(0.0, 0.0, 60.0))
    assert decisions[0].reason == "gnss.rejected.innovation"
    assert first(decisions, "reset") <= SETTINGS.implausible_time + 2 * PERIOD


def test_a_copied_state_is_a_snapshot(aided):
    aided.coast(20.0)
    aided.fly(3 * PERIOD)
    machine = aided.machine
    kept = replace(machine.state)
    offers = [
        (aided.t + i * PERIOD, truth(aided.t + i * PERIOD)[0], None, 1.5, (0.0, 0.0, 30.0), 50.0, 20.0)
        for i in range(9)
    ]
    once = [machine.offer(*o) for o in offers]
    machine.state = kept
    assert [machine.offer(*o) for o in offers] == once


@pytest.mark.parametrize("seed", range(5))
def test_random_garbage_never_locks_gnss_out(seed):
    """GIVEN outages, jumps and scatter at random WHEN true fixes come for 25 s THEN the filter is back on them."""
    rng = np.random.default_rng(seed)
    vehicle = Filter(Reacquisition(SETTINGS))
    vehicle.fly(20.0)
    for _ in range(12):
        vehicle.coast(rng.uniform(0.0, 40.0))
        vehicle.fly(rng.uniform(0.2, 20.0), offset=rng.normal(0.0, 200.0, 3) * [1, 1, 0.1])
        for _ in range(10):
            vehicle.fly(PERIOD, offset=rng.normal(0.0, 300.0, 3))
    decisions = vehicle.fly(SETTINGS.implausible_time + 5.0)
    assert vehicle.off < 4.0
    assert decisions[-1].action == "fuse"


# --- position and velocity together ----------------------------------------------------------------------------------
def drifted(seconds, accel, sd=0.05):
    """Covariance (6, 6) of position and velocity, E N U, of a navigator with an unknown acceleration; its errors."""
    cause = np.array([0.5 * seconds**2, seconds])
    P = np.kron(sd**2 * np.outer(cause, cause), np.eye(3)) + 1e-2 * np.eye(6)
    return P, np.kron(cause, accel)


R = np.diag([2.0**2] * 3 + [0.5**2] * 3)


def test_a_drift_explains_itself_and_an_offset_with_a_true_velocity_does_not():
    """GIVEN 60 s of drift WHEN position and velocity err by the same cause THEN all is well; an offset alone is not."""
    P, error = drifted(60.0, (0.05, -0.03, 0.0))
    assert unexplained_by_drift(error, np.eye(6), P, R) < 2.0
    assert 200.0 / math.sqrt(P[0, 0]) < 3.0  # by position alone nobody would doubt it
    assert unexplained_by_drift(error + np.array([200.0, 0, 0, 0, 0, 0]), np.eye(6), P, R) > 10.0


def test_an_overconfident_filter_is_forgiven_as_far_as_its_velocity_shows_it():
    P, error = drifted(60.0, (0.4, 0.0, 0.0))
    assert math.sqrt(error[0] ** 2 / P[0, 0]) > 5.0
    assert unexplained_by_drift(error, np.eye(6), P, R) < 3.0


@pytest.mark.parametrize("worse", [math.nan, math.inf])
def test_numbers_that_are_none_speak_for_nothing(worse):
    P, error = drifted(60.0, (0.0, 0.0, 0.0))
    error[0] = worse
    assert unexplained_by_drift(error, np.eye(6), P, R) == math.inf


def returns(aided, offset, evidence, seconds=60.0):
    """Seconds until a return ``offset`` to the East is taken, the prediction's sigma being 180 m."""
    aided.coast(30.0)
    decisions = []
    for i in range(round(seconds / PERIOD)):
        position, velocity = truth(aided.t + i * PERIOD)
        gap = 30.0 + i * PERIOD
        fix = position + np.array([offset, 0.0, 0.0])
        decisions.append(aided.machine.offer(aided.t + i * PERIOD, fix, velocity, 1.5, position, 180.0, gap, evidence))
    return first(decisions, "fuse", "reset"), decisions


@pytest.mark.parametrize(
    ("offset", "unexplained", "at_least", "at_most"),
    [(300.0, 1.0, 0.8, 0.8), (300.0, 3.0, 8.0, 15.0), (300.0, 6.0, 20.0, 20.0), (20.0, 3.0, 0.8, 3.0)],
)
def test_the_larger_and_the_less_explained_a_jump_the_longer_it_must_last(
    aided, offset, unexplained, at_least, at_most
):
    """GIVEN a large sigma WHEN a return is less and less explained THEN it waits, as far as the jump is worth it."""
    waited, decisions = returns(aided, offset, unexplained)
    assert at_least - 1e-6 <= waited <= at_most + 2 * PERIOD
    reasons = {d.reason for d in decisions}
    assert ("gnss.waiting.unexplained" in reasons) == (unexplained > SETTINGS.sigmas)
    assert ("gnss.waiting.doubtful" in reasons) == (waited > 0.8 and unexplained < SETTINGS.sigmas)


def test_doubt_does_not_pass_by_waiting(aided):
    """GIVEN a return that was unexplained at first WHEN sigma has grown until it is THEN it still has to wait."""
    aided.coast(30.0)
    decisions = []
    for i in range(60):
        position, velocity = truth(aided.t + i * PERIOD)
        evidence = 6.0 if i < 3 else 1.0
        fix = position + np.array([200.0, 0.0, 0.0])
        gap = 30.0 + i * PERIOD
        decisions.append(aided.machine.offer(aided.t + i * PERIOD, fix, velocity, 1.5, position, 90.0, gap, evidence))
    assert {d.action for d in decisions} == {"wait"}


def test_a_truth_that_is_far_likelier_than_what_was_taken_before_wins_soon(aided):
    """GIVEN a return 2.6 sigma off that was taken WHEN fixes come from where the filter was THEN they win at once."""
    aided.sd_growth = 0.15
    aided.drift = np.array([0.0, 0.0, 0.0])
    aided.coast(40.0)
    wrong = aided.fly(10.0, offset=(0.0, 320.0, 0.0))
    assert first(wrong, "fuse", "reset") < 1.0
    right = aided.fly(10.0)
    assert first(right, "reset") <= 1.0
    assert aided.off < 3.0
