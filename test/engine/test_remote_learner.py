"""The learner behind topics, fed by hand: it sees and says what the learner beside the navigator does."""

import numpy as np
import pytest

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.outage.remote import OdometrySample, RemoteLearner
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.engine.solutions import Event, Mode, NavSolution, PredictedDrift
from nav_pose_estimator.sim.scenarios import generate

LOST, END = 60.0, 80.0  # s
PARAMETERS = update(Parameters(), {"learner.method": "anfis", "learner.rules": 1})


def odometry(solution: NavSolution) -> OdometrySample:
    """What a navigator publishes of its solution."""
    C, P = quat_to_matrix(solution.q_nb), solution.cov
    pose = np.block([[P[6:9, 6:9], -P[6:9, :3]], [-P[:3, 6:9], P[:3, :3]]])
    twist = np.zeros((6, 6))
    twist[:3, :3], twist[3:, 3:] = C.T @ P[3:6, 3:6] @ C, P[9:12, 9:12]
    parts = (solution.position_enu, solution.q_nb, C.T @ solution.vel_n, solution.rate_b)
    return OdometrySample(solution.stamp_ns, *(tuple(part.tolist()) for part in parts), pose, twist)


@pytest.mark.compiled
def test_behind_topics_the_same_is_learned_and_said_as_beside_the_navigator() -> None:
    """GIVEN one flight WHEN GNSS is lost THEN the drift that is predicted over topics is, half second by half second,
    the one that the composed estimator predicts, but for what the odometry rounds off."""
    beside, behind = PoseEstimator(PARAMETERS, attitude=False), RemoteLearner(PARAMETERS)
    said: dict[str, list[PredictedDrift]] = {"beside": [], "behind": []}
    flight = generate("laps", duration=END, seed=2, imu_rate=50.0)
    for sample in flight.samples(blocks=False):
        if isinstance(sample, ImuSample):
            beside.set_use_gnss(sample.stamp_ns - flight.start_ns < LOST * 1e9)
            assert not any(isinstance(output, Event) and output.text for output in behind.feed(sample))
        for output in beside.feed(sample):
            if isinstance(output, PredictedDrift):
                said["beside"].append(output)
            elif isinstance(output, NavSolution):
                watch = behind.watch
                watch.origin, watch.denied = beside.origin, output.mode in DENIED
                watch.gyro_bias, watch.accel_bias = output.gyro_bias.copy(), output.accel_bias.copy()
                said["behind"] += [one for one in behind.feed(odometry(output)) if isinstance(one, PredictedDrift)]
    assert behind.mode is Mode.AIDED
    memories = [learner.state.memory.last(600.0) for learner in (beside.outage_aid.learner, behind.learner)]
    np.testing.assert_array_equal(memories[0][:, me.TIME], memories[1][:, me.TIME])
    assert beside.outage_aid.learner.state.trainings == behind.learner.state.trainings >= 1
    assert len(said["beside"]) == len(said["behind"]) > 30
    for one, other in zip(said["beside"], said["behind"], strict=True):
        assert one.stamp_ns == other.stamp_ns
        np.testing.assert_allclose(one.dv_n, other.dv_n, atol=0.02)
        np.testing.assert_allclose(one.dp_n, other.dp_n, atol=0.05)
        np.testing.assert_allclose(one.cov, other.cov, rtol=0.05, atol=1e-3)


def test_without_a_model_an_outage_is_an_event_and_no_guess() -> None:
    """GIVEN a learner that has never seen GNSS WHEN the navigator flies without it THEN it says so, and no more."""
    learner = RemoteLearner(PARAMETERS)
    watch = learner.watch
    watch.origin, watch.gyro_bias, watch.accel_bias, watch.denied = (0.8, 0.1, 500.0), np.zeros(3), np.zeros(3), True
    said: list = []
    for step in range(1, 101):
        stamp = 10**18 + step * 20_000_000
        said += learner.feed(
            ImuSample(stamp, (1e-4 * (step % 7), 0.0, 1e-4 * (step % 3)), (0.1, 1e-3 * (step % 5), 9.8))
        )
        level = OdometrySample(
            stamp, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), np.eye(6), np.eye(6)
        )
        said += learner.feed(level)
    assert {one.name for one in said} == {"outage.no_model"}
    assert len(said) == 4, "one for each half second"
