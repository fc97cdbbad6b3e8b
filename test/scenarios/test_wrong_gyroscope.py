"""A gyroscope of wrong scale, sign or axes: in doubt within one manoeuvre, and a scale is learned from GNSS."""

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.error_state import turn_between
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.engine.solutions import Event, NavBlock
from nav_pose_estimator.sim.recording import Recording
from told import flight

pytestmark = pytest.mark.compiled
SECONDS = 65.0
LEAST = np.radians([2.0, 2.0, 4.0])  # errors of tilt and heading that matter


class Flown:
    """A flight with a changed gyroscope: the doubt, and where the attitude is wrong beyond 3 sigma, once a second."""

    def __init__(self, gyro: np.ndarray, name: str = "multirotor_light") -> None:
        recording = flight(name, SECONDS)
        self._parameters = update(Parameters(), {"learner.enabled": False})
        self.estimator = PoseEstimator(self._parameters, attitude=False)
        self.events: dict[str, tuple[float, str]] = {}
        self.wrong_and_good: list[float] = []
        self.last: np.ndarray | None = None
        for sample in recording.samples():
            if isinstance(sample, ImuBlock):
                sample = ImuBlock(sample.stamps_ns, sample.gyro @ gyro.T, sample.accel)
            for output in self.estimator.feed(sample):
                if isinstance(output, Event) and output.text:
                    self.events.setdefault(output.name, (self._time(recording, output.stamp_ns), output.text))
                elif isinstance(output, NavBlock):
                    self._judge(recording, output)

    @staticmethod
    def _time(recording: Recording, stamp_ns: int) -> float:
        return (stamp_ns - recording.start_ns) * 1e-9

    def _judge(self, recording: Recording, block: NavBlock) -> None:
        self.last, t = block.rows[-1], self._time(recording, block.stamps_ns[-1])
        truth = recording.truth
        k = min(int(np.searchsorted(truth.t, t - 1e-3)), len(truth.t) - 1)
        off = np.abs(turn_between(truth.q_nb[k], self.last[at.OUT_QUAT : at.OUT_QUAT + 4]))
        sd = np.sqrt(self.last[at.OUT_VAR : at.OUT_VAR + 3])
        if ((off > 3.0 * sd) & (off > LEAST)).any() and not self.estimator.status().doubt:
            self.wrong_and_good.append(t)


@pytest.mark.parametrize("scale", [1.2, 0.8])
def test_a_wrong_scale_is_in_doubt_and_then_learned(scale: float) -> None:
    """GIVEN rates of wrong scale WHEN the vehicle manoeuvres THEN the status has a doubt soon after the first turn,
    the scale is named, and attitude and heading are within 3 sigma from the doubt on."""
    flown = Flown(scale * np.eye(3))
    doubted = flown.events["imu.gyroscope.doubted"][0]
    assert doubted < 40.0
    named, text = flown.events["imu.gyroscope.scale"]
    assert named > doubted
    factors = [float(part) for part in text.replace(",", "").replace(";", "").split() if part[:2] in ("0.", "1.")]
    assert len(factors) >= 2
    assert np.allclose(factors, scale, atol=0.06)
    assert [t for t in flown.wrong_and_good if t > doubted] == []
    assert len(flown.wrong_and_good) < 50  # blocks are of 0.1 s or more
    assert flown.estimator.status().doubt == ""


@pytest.mark.parametrize(
    "gyro",
    [np.diag([1.0, -1.0, 1.0]), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])],
    ids=["y inverted", "x and y exchanged"],
)
def test_another_sign_or_axis_is_in_doubt_until_it_is_named(gyro: np.ndarray) -> None:
    """GIVEN rates of wrong sign or axes WHEN the vehicle manoeuvres THEN the status does not call the pose good."""
    flown = Flown(gyro)
    assert flown.events["imu.gyroscope.doubted"][0] < 40.0
    status = flown.estimator.status()
    assert status.doubt or status.waiting_for


def test_an_inverted_yaw_axis_stays_in_doubt_at_rest() -> None:
    """GIVEN a z axis of wrong sign WHEN the vehicle turns, flies and then stands still for half a minute THEN the doubt
    that the first leg has raised is still there, although GNSS agrees at rest."""
    flown = Flown(np.diag([1.0, 1.0, -1.0]), "stop_and_go")
    doubted = flown.events["imu.gyroscope.doubted"][0]
    assert doubted < 50.0
    assert [t for t in flown.wrong_and_good if t > doubted] == []
    assert flown.estimator.status().doubt


@pytest.mark.parametrize("name", ["multirotor_light", "fixed_wing", "hover"])
def test_a_sound_gyroscope_is_left_in_peace(name: str) -> None:
    """GIVEN a sound gyroscope THEN it is never in doubt, and its prior stays."""
    flown = Flown(np.eye(3), name)
    assert not [event for event in flown.events if event.startswith("imu.gyroscope")]
    assert "gyro_matrix.released" not in flown.estimator.status().counters
    assert flown.wrong_and_good == []
