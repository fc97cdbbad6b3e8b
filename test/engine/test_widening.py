"""Doubts that return without end: the covariance of the motion stays finite."""

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.observation import Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.sensors.fusion import Fusion


class Doubting:
    """A sensor that uses nothing and always doubts the filter."""

    kind = Kind("doubting")
    noise = type("Noise", (), {"learns": False})

    def decide(self, _o: Observation, _f: FilterView) -> Decision:
        return Decision(Use.LEFT_OUT, widening=4.0)

    def settle(self, _o: Observation, _f: FilterView) -> None:
        pass


def test_the_covariance_stays_finite_and_its_correlations_stay() -> None:
    """GIVEN correlated velocity and position WHEN they are doubted a thousand times THEN both are wide, and no more."""
    P = np.eye(at.BASE_STATES)
    P[at.DVEL, at.DPOS] = P[at.DPOS, at.DVEL] = 0.5
    fusion, view = Fusion([Doubting()], []), FilterView(np.zeros(at.NAV_SIZE), P, np.zeros(1))  # type: ignore[list-item]
    for i in range(1000):
        fusion.apply(Observation(float(i), i, Doubting.kind, None), view)
    assert np.isfinite(P).all()
    assert 10.0**2 < P[at.DVEL, at.DVEL] <= 100.0**2
    assert 1e3**2 < P[at.DPOS, at.DPOS] <= 1e4**2
    assert P[at.DVEL, at.DPOS] / np.sqrt(P[at.DVEL, at.DVEL] * P[at.DPOS, at.DPOS]) > 0.49
