"""Recorded flights are sound: nothing is refused as impossible, and no check delays the start."""

from pathlib import Path

import pytest

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.imu.physics import ImuPhysics
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.offline.flights.recording import Recording, load

pytestmark = pytest.mark.compiled
FLIGHTS = [
    "p4rtk_dot1",
    "px4_3dr1",
    "px4_3dr2",
    "px4_flow",
    "px4_quad_0107",
    "px4_quad_log376b",
    "px4_quad_tropic",
    "px4_search",
    "quad106",
    "quad122a",
    "quad_log171",
    "quadflow",
    "x8_testlog2",
]
ALARMS = (
    "imu.implausible",
    "imu.gyroscope",
    "gnss.pulled",
    "gnss.other_motion",
    "gnss.two_places",
    "gnss.drift",
    "gnss.velocity",
    "gnss.height",
    "gnss.position",
    "navigator.turned",
    "mag.heading.wrong_start",
    "gnss.rejected.stuck",
    "gnss.rejected.null_island",
    "baro.rejected.unit",
    "mag.unit",
)
SECONDS = 100.0
LATER = 0.5  # s by which checks may delay an alignment


def events(flight: Recording, seconds: float, until: str = "") -> list[Event]:
    """What the first ``seconds`` of IMU data lead to; up to the first event named ``until``."""
    delay = float(flight.sidecar.get("gnss_latency_est_s", 0.0))
    estimator = PoseEstimator(update(Parameters(), {"gnss.delay": delay, "learner.method": "coast"}))
    told: list[Event] = []
    for sample in flight.samples:
        if isinstance(sample, ImuBlock) and (sample.stamps_ns[0] - flight.epoch_ns) * 1e-9 > seconds:
            break
        told += [output for output in estimator.feed(sample) if isinstance(output, Event)]
        if until and any(event.name == until for event in told):
            break
    return told


def aligned(told: list[Event]) -> float:
    """When [s]; infinite if never."""
    return min((event.stamp_ns * 1e-9 for event in told if event.name == "aligned"), default=float("inf"))


@pytest.fixture(params=FLIGHTS)
def flight(request, shared_data: Path) -> Recording:
    path = shared_data / "flights" / f"{request.param}_bag"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return load(path)


def test_a_recorded_flight_raises_no_alarm_and_starts_in_time(flight: Recording, monkeypatch) -> None:
    """GIVEN a recorded flight THEN no check speaks, and without the IMU's checks it aligns at most 0.5 s earlier."""
    told = events(flight, SECONDS)
    assert [(event.name, event.text) for event in told if event.name.startswith(ALARMS)] == []
    monkeypatch.setattr(ImuPhysics, "look", lambda *_: None)
    assert aligned(told) < aligned(events(flight, SECONDS, until="aligned")) + LATER
