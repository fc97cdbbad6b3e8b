"""Observations that are expected act in compiled code, many at once or one by one: never another number."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.core.filter.layout import OUT_COLUMNS
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.core.routine import flight as routine_flight
from nav_pose_estimator.engine.navigator import filter_run, stretch
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    MagSample,
    PressureSample,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.engine.sensors.routine.routine import Routine
from nav_pose_estimator.engine.solutions import Event, NavBlock, NavSolution, Output
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import ORIGIN, full_set
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples as samples_of
from nav_pose_estimator.sim.scenarios import generate
from pieces import one_by_one

pytestmark = pytest.mark.skipif(not COMPILED, reason="without a compiler there is no routine")

SECONDS, IMU_HZ = 60.0, 100.0
_ASTRAY = 45.1  # s
_EARTH = 6.378e6 * np.cos(ORIGIN[0])  # m per radian of longitude


def quiet(rng: np.random.Generator) -> list[Sample]:
    """All sensors, their stamps those of the IMU, nothing wrong."""
    return full_set(SECONDS, IMU_HZ, seed=int(rng.integers(1000)))


def slow(rng: np.random.Generator) -> list[Sample]:
    """GNSS once a second, the other sensors a moment behind the IMU."""
    return samples_of(SECONDS, IMU_HZ, seed=int(rng.integers(1000)))


def troubled(rng: np.random.Generator) -> list[Sample]:
    """The same; every now and then something is wrong, early or missing."""
    out: list[Sample] = []
    for sample in quiet(rng):
        t = _seconds(sample)
        if 42.0 < t < 45.0 and isinstance(sample, (GnssFix, GnssVelocity)):
            continue  # GNSS is lost for a moment
        out += _changed(sample, rng) if t > 35.0 and rng.random() < 0.1 else [sample]
    return out


def _changed(sample: Sample, rng: np.random.Generator) -> list[Sample]:
    kind = int(rng.integers(5))
    if isinstance(sample, GnssFix):
        return [
            replace(sample, lat=sample.lat + 1.5e-6 * rng.normal()),  # some 10 m
            replace(sample, alt=sample.alt + 25.0),
            replace(sample, alt=float("nan")),
            replace(sample, status=-1),
            replace(sample, cov_enu=np.diag([4.0, 4.0, 9.0])),
        ][kind : kind + 1]
    if isinstance(sample, GnssVelocity):
        east, north, up = sample.vel_enu
        other = (east + 3.0, north, up), (east, north, float("nan")), (east + 1.0, north, up), (east, 2e3, up)
        return [] if kind == 4 else [replace(sample, vel_enu=other[kind])]
    if isinstance(sample, MagSample):
        ahead = replace(sample, stamp_ns=sample.stamp_ns + 10_000_000 * kind)
        return [SatelliteCount(sample.stamp_ns, 9), ahead]
    if isinstance(sample, PressureSample):
        late = replace(sample, stamp_ns=sample.stamp_ns - 13_000_000)
        return [late, replace(sample, stamp_ns=sample.stamp_ns + 7_000_000, pressure=sample.pressure + 50.0 * kind)]
    return [sample]


def late(rng: np.random.Generator) -> list[Sample]:
    """Fixes that arrive late, a simulated multirotor."""
    return list(generate("late_gnss", SECONDS, seed=int(rng.integers(1000))).samples())


def hopeless(rng: np.random.Generator) -> list[Sample]:
    """A moment after the whole second, positions and velocities go another way, together, and stay there."""
    out: list[Sample] = []
    for sample in quiet(rng):
        east = 20.0 * (_seconds(sample) - _ASTRAY)
        if east > 0.0 and isinstance(sample, GnssFix):
            sample = replace(sample, lon=sample.lon + (40.0 + east) / _EARTH)
        elif east > 0.0 and isinstance(sample, GnssVelocity):
            sample = replace(sample, vel_enu=(sample.vel_enu[0] + 20.0, *sample.vel_enu[1:]))
        out.append(sample)
    return out


def _seconds(sample: Sample) -> float:
    stamp = int(sample.stamps_ns[0]) if isinstance(sample, ImuBlock) else sample.stamp_ns
    return 1e-9 * (stamp - 10**18)


def in_pieces(engine: SinsEngine, samples: list[Sample]) -> list[Output]:
    """By ``feed``."""
    return [output for sample in samples for output in engine.feed(sample)]


def in_bundles(engine: SinsEngine, samples: list[Sample]) -> list[Output]:
    """By ``feed_all``, so many at a time as it comes."""
    rng, outputs, done = np.random.default_rng(3), [], 0
    while done < len(samples):
        count = int(rng.integers(1, 40))
        outputs += engine.feed_all(samples[done : done + count])
        done += count
    return outputs


WAYS: dict[str, Callable[[SinsEngine, list[Sample]], list[Output]]] = {
    "in pieces": in_pieces,
    "in bundles": in_bundles,
    "at once": lambda engine, samples: engine.feed_all(samples),
    "one by one": lambda engine, samples: in_pieces(engine, one_by_one(samples)),
}


def all_that_is_told(engine: SinsEngine, outputs: list[Output]) -> dict[str, object]:
    """Everything but how the rows are packed."""
    rows: list[list[float]] = []
    words: list[tuple] = []
    for output in outputs:
        if isinstance(output, NavBlock):
            rows += [[*row, *output.correction_enu.tolist()] for row in output.rows.tolist()]
            words += [(int(stamp), output.mode, output.reset_count) for stamp in output.stamps_ns]
        elif isinstance(output, NavSolution):
            rows.append([*output.values[:OUT_COLUMNS].tolist(), *output.correction_enu.tolist()])
            words.append((output.stamp_ns, output.mode, output.reset_count))
    status, whole = engine.status(), engine.run.settled
    return {
        "rows": rows,
        "words": words,
        "events": [(o.stamp_ns, o.name, o.text, o.data) for o in outputs if isinstance(o, Event)],
        "counters": sorted(status.counters.items()),
        "values": sorted((name, repr(value)) for name, value in status.values.items()),
        "status": repr(replace(status, counters={}, values={})),
        "filter": whole.nav.tolist() + whole.P.ravel().tolist(),
        "learned": repr([engine.run.aids[kind].offset for kind in (MagSample, PressureSample)]),  # type: ignore[attr-defined]
    }


def flown(parameters: Parameters, samples: list[Sample], way: str) -> dict[str, object]:
    engine = SinsEngine(parameters)
    return all_that_is_told(engine, WAYS[way](engine, samples))


@pytest.mark.parametrize(
    ("story", "noise", "delay"),
    [
        (quiet, "fixed", 0.0),
        (quiet, "innovation_adaptive", 0.0),
        (quiet, "fixed", 0.13),
        (slow, "fixed", 0.0),
        (troubled, "fixed", 0.0),
        (troubled, "innovation_adaptive", 0.0),
        (troubled, "fixed", 0.13),
        (late, "fixed", 0.0),
        (troubled, "error states", 0.13),
        (late, "error states", 0.0),
    ],
)
def test_the_routine_changes_no_number(story, noise: str, delay: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """GIVEN flights quiet and troubled WHEN they are flown with and without routine, in pieces of all sizes
    THEN every solution, correction, mode, event, counter and figure is the same, bit for bit."""
    chosen = {"gnss.error_states": True} if noise == "error states" else {"gnss.noise": noise}
    parameters = update(Parameters(), {**chosen, "gnss.delay": delay})
    samples = story(np.random.default_rng(11))
    with monkeypatch.context() as patch:
        patch.setattr(filter_run, "COMPILED", False)
        expected = flown(parameters, samples, "in pieces")
    assert len(expected["rows"]) > 0.5 * SECONDS * IMU_HZ
    for way in ("in pieces", "in bundles", "at once") if noise != "innovation_adaptive" else ("in bundles",):
        given = flown(parameters, samples, way)
        for name, value in expected.items():
            assert given[name] == value, (way, name)


def test_what_arrives_after_the_filter_has_given_up_is_heard_by_the_next_one() -> None:
    """GIVEN a filter that gives up half a second after it agreed with GNSS
    WHEN a replay takes the flight at once and a node piece by piece
    THEN what came in that second behind its end is not lost, and the next filter is the same."""
    soon = {"fixes": 2, "min_duration": 0.0, "contradiction_time": 0.5, "implausible_time": 1.0}
    parameters = update(Parameters(), {f"gnss.reacquisition.{name}": value for name, value in soon.items()})
    samples = hopeless(np.random.default_rng(7))
    pieces, all_ = (flown(parameters, samples, way) for way in ("in pieces", "at once"))
    given_up = [stamp for stamp, name, *_ in pieces["events"] if name == "reset"]  # type: ignore[attr-defined]
    assert len(given_up) == 1
    assert 0.1 < 1e-9 * given_up[0] % 1.0 < 0.9
    assert {name for name, value in pieces.items() if all_[name] != value} == set()


def test_sample_by_sample_it_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """GIVEN a troubled flight WHEN a node takes it one by one and a replay at once THEN they say the same."""
    samples = troubled(np.random.default_rng(5))
    one, all_ = (flown(Parameters(), samples, way) for way in ("one by one", "at once"))
    assert {name for name, value in one.items() if all_[name] != value} == set()


def test_most_of_a_quiet_flight_is_routine(monkeypatch: pytest.MonkeyPatch) -> None:
    """GIVEN a quiet flight WHEN it is fed at once THEN nearly every row is flown in long stretches, and nearly every
    observation acts by routine."""
    counts = {"rows": 0, "flights": 0, "acted": 0}
    fly, report = routine_flight.fly, Routine.report

    def counted(*arguments: object) -> tuple[int, int, int]:
        done, acted, where = fly(*arguments)
        counts["rows"] += done
        counts["flights"] += 1
        return done, acted, where

    def counted_report(self: Routine, *arguments: object) -> None:
        counts["acted"] += 1
        report(self, *arguments)

    monkeypatch.setattr(routine_flight, "fly", counted)
    monkeypatch.setattr(Routine, "report", counted_report)
    engine, samples = SinsEngine(Parameters()), quiet(np.random.default_rng(1))
    engine.feed_all(samples)
    aided = sum(value for name, value in engine.journal.counters.items() if name.startswith("gnss.used"))
    assert counts["rows"] > 0.9 * (SECONDS - 30.0) * IMU_HZ
    assert counts["flights"] < 3.0 * SECONDS
    assert counts["acted"] > 0.95 * aided


def test_what_waits_is_flown_ahead_of_everything_else() -> None:
    """GIVEN rows that wait WHEN a late fix comes THEN they are flown before it is judged."""
    engine, samples = SinsEngine(Parameters()), quiet(np.random.default_rng(1))
    engine.feed_all(samples[: len(samples) // 2])
    backlog, rest = stretch.Backlog(engine.run), samples[len(samples) // 2 :]
    block = next(s for s in rest if isinstance(s, ImuBlock))
    assert backlog.look_back_before(block)
    assert backlog.is_open()
    assert backlog.add(block) is None
    before = engine.run.timeline.filter.time
    assert engine.run.now > before
    fix = next(s for s in samples if isinstance(s, GnssFix))
    late_fix = engine.run.gnss.position.observe(fix, before - 0.05)
    engine.run.observe(late_fix)
    assert engine.run.timeline.filter.time == engine.run.now
    assert late_fix in engine.run.timeline.queue.waiting() or late_fix.decision is None
    blocks, stamps, _ = backlog.flown()
    assert sum(len(one.rows) for one in blocks) == len(stamps) == len(block)
