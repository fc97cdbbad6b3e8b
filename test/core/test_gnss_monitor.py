"""The GNSS gate: satellite count with hysteresis, status, age, accuracy."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav_pose_estimator.core.gnss.quality_gate import GateSettings, GnssGate
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import settings

DEFAULTS = settings(GateSettings, Parameters().gnss.gate)


def run(gate, counts, start=0.0, period=0.2):
    """Feed fixes every ``period``, each followed by its count ("-" for no message); return the verdicts."""
    verdicts = []
    for i, count in enumerate(counts):
        t = start + i * period
        verdicts.append(gate.assess_fix(t, 0, 1.0, 2.0))
        if count != "-":
            gate.update_count(t, count)
    return verdicts


def names(verdicts):
    return [notice.name for verdict in verdicts for notice in verdict.notices]


def opened(**changes):
    gate = GnssGate(replace(DEFAULTS, **changes))
    run(gate, [8] * 20)
    assert gate.state.open
    return gate


def test_opens_after_the_hold_time_and_not_before():
    """GIVEN a closed gate WHEN 6 satellites are counted THEN it opens after two seconds of them."""
    gate = GnssGate(DEFAULTS)
    verdicts = run(gate, [6] * 20)
    first = next(i for i, verdict in enumerate(verdicts) if verdict.usable)
    assert first * 0.2 == pytest.approx(2.0, abs=0.01)
    assert {v.reason for v in verdicts[1:first]} == {"gnss.waiting.hold"}
    assert names(verdicts) == ["gnss.gate.opened"]


def test_closes_at_once_below_the_leave_threshold_and_holds_again():
    gate = opened()
    verdicts = run(gate, [4, 8, 8, 8], start=4.0)
    assert [v.usable for v in verdicts] == [True, False, False, False]  # the count comes after its fix
    assert "gnss.gate.closed" in names(verdicts)
    assert any(v.usable for v in run(gate, [8] * 12, start=4.8))


def test_five_satellites_keep_an_open_gate_open_and_a_closed_one_closed():
    assert all(v.usable for v in run(opened(), [5] * 20, start=4.0))
    verdicts = run(GnssGate(DEFAULTS), [5] * 20)
    assert not any(v.usable for v in verdicts)
    assert verdicts[-1].reason == "gnss.rejected.satellites"


def test_flapping_count_opens_nothing():
    """GIVEN a closed gate WHEN the count flaps between 5 and 7 THEN it never opens."""
    assert not any(v.usable for v in run(GnssGate(DEFAULTS), [7, 7, 5] * 20))


def test_flapping_count_above_the_leave_threshold_closes_nothing():
    assert all(v.usable for v in run(opened(), [5, 7] * 20, start=4.0))


@pytest.mark.parametrize("count", [None, "-"], ids=["unknown", "stale"])
def test_an_unknown_or_stale_count_leaves_the_gate_as_it_is_and_says_so(count):
    """GIVEN an open and a closed gate WHEN the count is not known THEN neither changes before the timeout."""
    state = "unknown" if count is None else "stale"
    n = int(DEFAULTS.count_timeout / 0.2) - 1
    gate = opened()
    verdicts = run(gate, [count] * n, start=4.0)
    assert all(v.usable for v in verdicts)
    assert names(verdicts).count(f"gnss.count.{state}") == 1
    closed = GnssGate(DEFAULTS)
    run(closed, [4] * 20)
    verdicts = run(closed, [count] * n, start=4.0)
    assert not any(v.usable for v in verdicts)
    assert closed.state.count_state == state
    assert verdicts[-1].reason == f"gnss.waiting.count_{state}"


def test_a_count_that_never_comes_makes_the_gate_inactive_loudly_and_once():
    """GIVEN a receiver without count WHEN 5 s have passed THEN status and accuracy decide and an error says so."""
    gate = GnssGate(DEFAULTS)
    verdicts = run(gate, ["-"] * 60)
    assert verdicts[0].reason == "gnss.waiting.count_missing"
    first = next(i for i, v in enumerate(verdicts) if v.usable)
    assert first * 0.2 == pytest.approx(DEFAULTS.count_timeout, abs=0.21)
    assert gate.state.inactive
    loud = [n for v in verdicts for n in v.notices if n.name == "gnss.gate.inactive"]
    assert len(loud) == 1
    assert loud[0].severity == "error"
    assert not gate.assess_fix(20.0, -1).usable


def test_a_count_that_comes_back_is_used_again():
    gate = GnssGate(DEFAULTS)
    run(gate, ["-"] * 60)
    verdicts = run(gate, [4] * 5, start=12.0)
    assert verdicts[-1].reason == "gnss.rejected.satellites"
    assert not gate.state.inactive


def test_a_source_that_is_none_on_purpose_is_no_error():
    """GIVEN satellite_source: none WHEN fixes come THEN status and accuracy decide, and that is said once, calmly."""
    gate = GnssGate(replace(DEFAULTS, satellite_source="none"))
    verdict = gate.assess_fix(0.0, 0)
    assert verdict.usable
    assert [(n.name, n.severity) for n in verdict.notices] == [("gnss.gate.none", "info")]
    gate.update_count(0.1, 2)
    assert gate.assess_fix(0.2, 0).usable


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"status": -1}, "status"),
        ({"status": -2}, "status"),
        ({"status": 0, "age": 1.5}, "age"),
        ({"status": 0, "age": math.nan}, "age"),
        ({"status": 0, "horizontal_sd": 12.0}, "accuracy"),
        ({"status": 0, "vertical_sd": 25.0}, "accuracy"),
        ({"status": 0, "horizontal_sd": math.nan}, "accuracy"),
    ],
)
def test_a_bad_fix_is_rejected_by_name_whatever_the_count(arguments, reason):
    for gate in (opened(), GnssGate(replace(DEFAULTS, satellite_source="none"))):
        assert gate.assess_fix(4.0, **arguments).reason == f"gnss.rejected.{reason}"
        assert gate.state.usable_since is None


def test_an_old_count_out_of_order_is_ignored_and_named():
    gate = opened()
    gate.update_count(1.0, 2)
    verdict = gate.assess_fix(4.0, 0)
    assert verdict.usable
    assert "gnss.count.out_of_order" in [n.name for n in verdict.notices]


def test_a_copied_state_is_a_snapshot():
    gate = opened()
    kept = replace(gate.state)
    after = run(gate, [3] * 10, start=4.0)
    gate.state = kept
    assert run(gate, [3] * 10, start=4.0) == after


@given(st.lists(st.one_of(st.integers(0, 4), st.none(), st.just("-")), min_size=1, max_size=24))
def test_too_few_satellites_never_open_the_gate(counts):
    """Whatever mixture of few, unknown and missing counts: before the timeout the gate stays closed."""
    assert not any(v.usable for v in run(GnssGate(DEFAULTS), counts))


@given(st.lists(st.integers(5, 60), min_size=1, max_size=60))
def test_enough_satellites_never_close_the_gate(counts):
    assert all(v.usable for v in run(opened(), counts, start=4.0))


def test_a_receiver_that_was_silent_owes_no_count_for_that_time():
    """GIVEN an open gate WHEN the whole receiver is silent for a minute THEN its return is no error, and none later."""
    gate = opened()
    verdicts = run(gate, [9] * 40, start=70.0)
    assert all(v.usable for v in verdicts)
    assert names(verdicts) == []
    assert not gate.state.inactive


def test_a_count_that_does_not_come_back_with_its_receiver_is_told():
    """GIVEN an open gate WHEN the receiver returns from a silence without its count THEN stale, and then inactive."""
    verdicts = run(opened(), ["-"] * 40, start=70.0)
    assert names(verdicts) == ["gnss.count.stale", "gnss.gate.inactive"]
