"""``gnss.drift`` and its end: one pair for a drift, however much single fixes scatter."""

import numpy as np

from nav_pose_estimator.core.gnss.spoof_drift import WalkOff
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Kind, Observation
from nav_pose_estimator.engine.sensors.gnss.digits import Rounding
from nav_pose_estimator.engine.sensors.gnss.position_monitors import PositionMonitors
from nav_pose_estimator.engine.sensors.gnss.stated_accuracy import Scatter

PERIOD, SCATTER = 0.2, 8.0  # s, m


def told(sd: float, drift: float, quiet: float = 20.0) -> list[str]:
    """Events of a receiver at rest whose fixes scatter by ``sd`` [m] and drift [m/s] for 50 s, and then are exact."""
    journal, rng = Journal(), np.random.default_rng(3)
    monitors = PositionMonitors(journal, Rounding(journal), Scatter(journal))
    for i in range(round((60.0 + quiet) / PERIOD)):
        t = i * PERIOD
        is_bad = 5.0 < t < 55.0
        east, north = rng.normal(0.0, sd, 2) if is_bad else (0.0, 0.0)
        if is_bad:
            east += drift * (t - 5.0)
        fix = Observation(t, i + 1, Kind("gnss_position"), None)
        monitors.used(fix, (east, north, 0.0), (0.0, 0.0, 0.0), SCATTER)
    return [event.name for event in journal.drain() if event.name in ("gnss.drift", "gnss.drift.ended")]


def test_a_receiver_that_is_noisier_than_it_states_does_not_flap() -> None:
    """GIVEN fixes that scatter so widely that single ones look like a drift THEN it begins once, and ends once they are
    quiet for seconds."""
    assert told(sd=12.0, drift=0.0) == ["gnss.drift", "gnss.drift.ended"]
    assert told(sd=12.0, drift=0.0, quiet=0.0) == ["gnss.drift"]


def test_a_drift_is_told_once() -> None:
    assert told(sd=0.3, drift=1.5)[:1] == ["gnss.drift"]
    assert told(sd=0.3, drift=0.0) == []


def test_single_fixes_that_are_far_off_are_no_drift() -> None:
    """GIVEN a receiver of which every tenth fix is ten times as far off as it states THEN that is not a drift."""
    walk_off, rng = WalkOff(), np.random.default_rng(8)
    for i in range(500):
        east, north = rng.normal(0.0, 15.0 if rng.random() < 0.1 else 1.5, 2)
        walk_off.update(i * PERIOD, (east, north, 0.0), (0.0, 0.0, 0.0), SCATTER)
        assert not walk_off.is_on
