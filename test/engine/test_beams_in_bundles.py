"""Beams between IMU samples: a replay, which takes many samples at once, has the numbers of a node."""

from dataclasses import replace

import numpy as np
import pytest

from beam_flight import beam_flight
from beamed import with_beams
from nav_pose_estimator.core.filter.layout import OUT_COLUMNS
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BeamVelocitySample, Sample
from nav_pose_estimator.engine.solutions import Event, NavBlock, NavSolution, Output
from nav_pose_estimator.sim.recording import Recording
from pieces import one_by_one

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def flight() -> Recording:
    return beam_flight()


def told(outputs: list[Output], engine: SinsEngine) -> dict[str, object]:
    rows: list[list[float]] = []
    for output in outputs:
        if isinstance(output, NavBlock):
            rows += [[*row, *output.correction_enu.tolist()] for row in output.rows.tolist()]
        elif isinstance(output, NavSolution):
            rows.append([*output.values[:OUT_COLUMNS].tolist(), *output.correction_enu.tolist()])
    status, whole = engine.status(), engine.run.settled
    return {
        "rows": rows,
        "events": [(o.stamp_ns, o.name, o.text) for o in outputs if isinstance(o, Event)],
        "counters": sorted(status.counters.items()),
        "values": sorted((name, repr(value)) for name, value in status.values.items()),
        "filter": whole.nav.tolist() + whole.P.ravel().tolist(),
    }


def by_node(samples: list[Sample], parameters: Parameters) -> dict[str, object]:
    engine = SinsEngine(parameters)
    return told([output for sample in one_by_one(samples) for output in engine.feed(sample)], engine)


def by_replay(samples: list[Sample], parameters: Parameters) -> dict[str, object]:
    engine, rng, outputs, done = SinsEngine(parameters), np.random.default_rng(3), [], 0
    while done < len(samples):
        count = int(rng.integers(1, 300))
        outputs += engine.feed_all(samples[done : done + count])
        done += count
    return told(outputs, engine)


@pytest.mark.parametrize("story", ["of the IMU's stamps", "late", "late, and out of order"])
def test_a_replay_has_the_numbers_of_a_node(flight, story):
    """GIVEN beams that are punctual, late by up to 80 ms or overtaken by others, and a loss of GNSS
    WHEN a node hears the flight sample by sample and a replay many at a time
    THEN every solution, correction, event, counter and figure is the same, bit for bit."""
    rng, held = np.random.default_rng(8), list[Sample]()

    def aged(t: float, sample: BeamVelocitySample) -> BeamVelocitySample:
        age = 0 if story.startswith("of") else int(rng.integers(80_000_000))
        return replace(sample, stamp_ns=sample.stamp_ns - age)

    samples: list[Sample] = []
    for sample in with_beams(flight, aged):
        if story.endswith("order") and isinstance(sample, BeamVelocitySample) and rng.random() < 0.3:
            held.append(sample)
            continue
        samples.append(sample)
        if held and rng.random() < 0.2:
            samples.append(held.pop())
    parameters = update(Parameters(), {"aids.beams.delay_sd": 0.05})
    node, replay = by_node(samples, parameters), by_replay(samples, parameters)
    assert dict(node["counters"])["beam_velocity.used"] > 300  # type: ignore[call-overload]
    assert {name for name, value in node.items() if replay[name] != value} == set()
