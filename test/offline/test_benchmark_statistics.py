"""From outages to a table, with numbers small enough to check by hand."""

import math

import numpy as np
import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.benchmarks.outage.cross_validation import against_classical, choose
from nav_pose_estimator.offline.benchmarks.outage.scores import HONEST_RATIO, energy_score, log_score, probability
from nav_pose_estimator.offline.benchmarks.outage.statistics import Row, bootstrap, clusters, comparable, rms, summarise
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.groups import groups_of


def row(bag: str, method: str, start: float, error: float, sigma: float = math.nan, status: str = "ok") -> Row:
    return Row(bag, method, 30.0, start, error, error, error, 0.0, sigma, 100.0, status)


def test_a_small_table_by_hand():
    rows = [row("a", "coast", s, e, 10.0) for s, e in ((0, 10.0), (40, 20.0), (80, 40.0))]
    rows += [row("a", "hold", s, e) for s, e in ((0, 5.0), (40, 10.0), (80, 15.0))]
    rows += [row("a", "best", s, e, 2.0) for s, e in ((0, 4.0), (40, 10.0), (80, 9.0))]
    table = {s.method: s for s in summarise(rows)}
    best, coast = table["best"], table["coast"]
    assert best.outages == 3
    assert best.median_m == 9.0
    assert best.rms_m == pytest.approx(math.sqrt((16 + 100 + 81) / 3))
    assert best.max_m == 10.0
    assert best.p90_m == pytest.approx(9.8)
    assert best.best_classical == "hold"
    assert best.rms_ratio == pytest.approx(math.sqrt(197 / 350))
    assert best.win_rate == pytest.approx((1 + 0.5 + 1) / 3)
    assert best.within_3_sigma == pytest.approx(1 / 3)
    assert best.error_over_sigma == pytest.approx(4.5)
    assert coast.within_3_sigma == pytest.approx(2 / 3)
    assert math.isnan(table["hold"].within_3_sigma)


def test_an_outage_that_one_method_did_not_survive_counts_for_none():
    rows = [row("a", "coast", 0, 1.0), row("a", "best", 0, math.nan, status="not_aided"), row("a", "coast", 40, 2.0)]
    rows.append(row("a", "best", 40, 3.0))
    assert [(r.method, r.start_s) for r in comparable(rows)] == [("coast", 40), ("best", 40)]
    assert all(s.outages == 1 for s in summarise(rows))


def test_several_flights_are_pooled_and_clustered_by_flight():
    rows = [row(bag, "coast", s, e) for bag, e in (("a", 1.0), ("b", 3.0), ("c", 5.0)) for s in range(0, 200, 5)]
    pooled = next(s for s in summarise(rows) if s.bag == "all")
    assert pooled.outages == 120
    assert pooled.median_low_m == 1.0  # three flights, not 120 independent outages: the interval spans them
    assert pooled.median_high_m == 5.0


def test_within_a_flight_overlapping_outages_share_a_cluster():
    rows = [row("a", "coast", s, 1.0) for s in range(160, 280, 5)]
    assert clusters(rows).tolist() == [i // 6 for i in range(24)]


def test_the_interval_covers_and_is_repeatable():
    rng, cluster, hits = np.random.default_rng(4), np.repeat(np.arange(20), 5), 0
    for _ in range(40):
        level = rng.normal(0.0, 1.0, 20)
        values = (level[:, None] + rng.normal(0.0, 0.3, (20, 5))).ravel()
        low, high = bootstrap(values, cluster, np.median, seed=1)
        hits += low <= 0.0 <= high
    assert hits >= 34
    assert (low, high) == bootstrap(values, cluster, np.median, seed=1)


def test_one_cluster_gives_no_interval():
    assert all(math.isnan(v) for v in bootstrap(np.ones(5), np.zeros(5), np.median, 1))
    assert math.isnan(rms([]))


def test_methods_are_checked_and_listed():
    assert methods.check(["coast", "hold", "coast"]) == ["coast", "hold"]
    with pytest.raises(UserError, match=r"does not exist; choose from .*coast"):
        methods.check(["coats"])
    with pytest.raises(UserError, match="hold"):
        methods.apply(Parameters(), "hold")


def test_scores_are_those_of_the_stated_distribution():
    rng = np.random.default_rng(2)
    deviation = 3.0 / math.sqrt(2.0)
    stated, again = rng.normal(0.0, deviation, (2, 400_000, 2))
    error, sigma = np.array([4.0]), np.array([3.0])
    density = math.exp(-0.5 * (4.0 / deviation) ** 2) / (2.0 * math.pi * deviation**2)
    assert log_score(error, sigma)[0] == pytest.approx(-math.log(density))
    sampled = np.hypot(stated[:, 0] - 4.0, stated[:, 1]).mean() - 0.5 * np.hypot(*(stated - again).T).mean()
    assert energy_score(error, sigma)[0] == pytest.approx(sampled, rel=0.01)
    assert np.median(probability(np.hypot(*stated.T), np.full(len(stated), 3.0))) == pytest.approx(0.5, abs=0.01)
    assert np.median(np.hypot(*stated.T)) / 3.0 == pytest.approx(HONEST_RATIO, abs=0.01)


@pytest.mark.parametrize("score", [log_score, energy_score])
def test_only_the_honest_sigma_scores_best(score):
    error = np.hypot(*np.random.default_rng(3).normal(0.0, 5.0 / math.sqrt(2.0), (2, 20_000)))
    means = [score(error, np.full(len(error), sigma)).mean() for sigma in (2.5, 5.0, 10.0)]
    assert min(means) == means[1]


def test_a_summary_states_shares_and_scores():
    rows = [row("a", "coast", s, e, 10.0) for s, e in ((0, 5.0), (40, 15.0), (80, 25.0), (120, 35.0))]
    (one,) = summarise(rows)
    assert (one.within_1_sigma, one.within_2_sigma, one.within_3_sigma) == (0.25, 0.5, 0.75)
    assert one.log_score == pytest.approx(math.log(math.pi * 100.0) + (0.25 + 2.25 + 6.25 + 12.25) / 4.0)


def test_intervals_are_clustered_by_group():
    rows = [row(bag, "coast", s, e) for bag, e in (("a", 1.0), ("b", 3.0), ("c", 5.0)) for s in range(0, 200, 5)]
    assert clusters(rows, {"a": "one", "b": "one"}).tolist() == [1] * 80 + [0] * 40
    assert len(set(clusters(rows).tolist())) == 3


def test_recordings_of_one_airframe_are_one_group(tmp_path):
    (tmp_path / "d.json").write_text('{"group": "the old one"}')
    bags = [tmp_path / f"{name}_bag" for name in ("a1", "a2", "b", "d")]
    groups = groups_of(bags, ["a*", "d"])
    assert groups == {"a1_bag": "a*", "a2_bag": "a*", "b_bag": "b", "d_bag": "the old one"}


def test_what_is_chosen_for_a_group_is_chosen_on_the_others():
    """GIVEN a candidate that is good on one flight only WHEN that flight is held out THEN it is not chosen for it."""
    groups = {"a": "a", "b": "b", "c": "c"}
    plain = [row(bag, "best", 0, 10.0, 10.0) for bag in "abc"]
    tuned = [row(bag, "best", 0, error, 10.0) for bag, error in (("a", 0.1), ("b", 12.0), ("c", 12.0))]
    assert choose([plain, tuned], groups, "best")["a"] == 0
    assert choose([tuned, plain], groups, "best")["a"] == 1
    assert choose([plain, tuned], groups, "best")["b"] == 1


def test_flights_count_alike_against_the_classical_methods():
    rows = [row(bag, "hold", s, 10.0) for bag in "ab" for s in range(0, 800, 100)]
    rows += [row(bag, "best", s, e, 9.0) for bag, e in (("a", 5.0), ("b", 20.0)) for s in range(0, 800, 100)]
    rows += [row("short", m, 0, 10.0, 9.0) for m in ("hold", "best")]
    mean, worst, count = against_classical(summarise(rows), "best", 30.0)
    assert (mean, worst, count) == (pytest.approx(1.0), pytest.approx(2.0), 2)
