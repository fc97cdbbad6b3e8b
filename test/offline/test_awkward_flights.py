"""Gaps, damaged stamps, slow receivers: ``benchmark outage`` runs wherever ``replay`` does, and leaks nothing."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.benchmarks.outage.trials import FlightResult, run_outages
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples
from nav_pose_estimator.offline.flights import latency, methods
from nav_pose_estimator.offline.flights.outages import Outage
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.replay.replay import replay

EPOCH_NS, SECONDS = 10**18, 100.0
COASTING = methods.apply(Parameters(), "coast")


def seconds_of(sample: Sample) -> float:
    stamp = int(sample.stamps_ns[-1]) if isinstance(sample, ImuBlock) else sample.stamp_ns
    return (stamp - EPOCH_NS) * 1e-9


def recording_of(keep: Callable[[Sample], bool], rate: float = 5.0) -> Recording:
    return Recording(Path("plain_bag"), [s for s in samples(SECONDS, 50.0, rate) if keep(s)], EPOCH_NS, SECONDS)


def without(first: float, last: float, kind: type | tuple = object) -> Callable[[Sample], bool]:
    return lambda sample: not (isinstance(sample, kind) and first < seconds_of(sample) < last)


def damaged() -> Recording:
    """One fix at 30 s is stamped a thousand seconds ahead."""
    flight = recording_of(lambda sample: True)
    index = next(i for i, s in enumerate(flight.samples) if isinstance(s, GnssFix) and seconds_of(s) > 30.0)
    fix = flight.samples[index]
    flight.samples[index] = replace(fix, stamp_ns=fix.stamp_ns + 10**12)
    return flight


FLIGHTS = {
    "gap of the IMU": lambda: recording_of(without(40.0, 55.0, ImuBlock)),
    "gap of all, GNSS back first": lambda: recording_of(
        lambda s: without(40.0, 53.0)(s) and without(40.0, 55.0, ImuBlock)(s)
    ),
    "stamp ahead": damaged,
    "no GNSS velocity": lambda: recording_of(lambda s: not isinstance(s, GnssVelocity)),
    "2 Hz": lambda: recording_of(lambda s: True, 2.0),
    "2 Hz without velocity": lambda: recording_of(lambda s: not isinstance(s, GnssVelocity), 2.0),
}


@pytest.mark.parametrize("flight", FLIGHTS.values(), ids=FLIGHTS)
def test_the_benchmark_runs_wherever_replay_runs(flight):
    """Outages every 4 s, some of them beginning in the gap; each pass checks that nothing of GNSS came from inside."""
    recording = flight()
    assert len(replay(recording, COASTING, [Outage(60.0, 10.0)]).track)
    planned = {6.0: [Outage(start, 6.0) for start in np.arange(26.0, 90.0, 4.0).tolist()]}
    result = FlightResult("plain_bag", 0.0, (0.0, SECONDS))
    run_outages(recording, COASTING, planned, ("coast",), result)
    errors = result.errors["coast", 6.0]
    assert len(errors) == len(planned[6.0])
    assert [e.start_s for e in errors] == [o.start for o in planned[6.0]]
    assert sum(e.status == "ok" for e in errors) >= 5
    assert max(e.end_error_m for e in errors if e.status == "ok") < 100.0


@pytest.mark.parametrize("flight", FLIGHTS.values(), ids=FLIGHTS)
def test_a_latency_is_found_or_the_default_stands(flight, monkeypatch):
    """The search of the benchmark never ends a run; how fine it is does not matter here."""
    monkeypatch.setattr(latency, "COARSE", np.array([0.0, 0.3]))
    monkeypatch.setattr(latency, "RESOLUTION", 0.05)
    parameters, how = latency.choose(flight(), COASTING, None, None, 60.0, search=True)
    assert abs(parameters.gnss.delay) <= 0.7
    assert how.startswith("GNSS latency ")


def test_a_search_without_enough_data_keeps_the_default_unless_it_was_asked_for():
    flight = recording_of(lambda s: True)
    parameters, how = latency.choose(flight, COASTING, None, None, 5.0, search=True)
    assert parameters is COASTING
    assert "default: the latency cannot be estimated: less than 20 s" in how
    with pytest.raises(UserError, match="less than 20 s"):
        latency.choose(flight, COASTING, "auto", None, 5.0)


@pytest.mark.parametrize("search", [False, True])
def test_replay_and_benchmark_take_a_known_latency_from_the_same_place(tmp_path, search):
    flight = recording_of(lambda s: True)
    config, other = tmp_path / "c.yaml", update(COASTING, {"gnss.delay": 0.05})
    flight.sidecar = {"gnss_latency_est_s": 0.3}
    for parameters, option, file, delay in (
        (COASTING, None, None, 0.3),
        (COASTING, None, config, 0.3),  # a file that says nothing of it
        (other, None, config, 0.05),
        (other, "0.1", config, 0.1),
    ):
        assert latency.choose(flight, parameters, option, file, 60.0, search)[0].gnss.delay == delay
