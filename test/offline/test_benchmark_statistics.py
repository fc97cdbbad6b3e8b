"""From outages to a table, with numbers small enough to check by hand."""

import math

import numpy as np
import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.benchmarks.outage.statistics import Row, bootstrap, clusters, comparable, rms, summarise
from nav_pose_estimator.offline.flights import methods


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
    rng = np.random.default_rng(4)
    hits = 0
    for _ in range(60):
        level = rng.normal(0.0, 1.0, 20)
        values = (level[:, None] + rng.normal(0.0, 0.3, (20, 5))).ravel()
        low, high = bootstrap(values, np.repeat(np.arange(20), 5), np.median, seed=1)
        assert (low, high) == bootstrap(values, np.repeat(np.arange(20), 5), np.median, seed=1)
        hits += low <= 0.0 <= high
    assert hits >= 50


def test_one_cluster_gives_no_interval():
    assert all(math.isnan(v) for v in bootstrap(np.ones(5), np.zeros(5), np.median, 1))
    assert math.isnan(rms([]))


def test_methods_are_checked_and_listed():
    assert methods.check(["coast", "hold", "coast"]) == ["coast", "hold"]
    with pytest.raises(UserError, match=r"does not exist; there is .*coast"):
        methods.check(["coats"])
    with pytest.raises(UserError, match="hold"):
        methods.apply(Parameters(), "hold")
