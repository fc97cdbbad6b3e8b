"""Beams on their own: what is flagged, left out and adapted, and how directions and signs are found."""

import numpy as np
import pytest

from beamed import beam_directions
from filter_start import plain_constants
from nav_pose_estimator.core.beams.geometry import ENOUGH, GeometryCheck, Reading, readings, with_swapped_angle
from nav_pose_estimator.core.beams.judge import GATE, GATED, LOST, OUT, PARITY, USED, BeamJudge
from nav_pose_estimator.core.filter.blocks import DVL, state_count
from nav_pose_estimator.core.filter.layout import DVEL, NAV_SIZE, QUAT, VEL
from nav_pose_estimator.core.filter.measurements import BEAMS, beam_velocities

SD = 0.01
CONSTANTS = plain_constants([DVL])
N, FIRST = state_count(CONSTANTS), DVL.states(CONSTANTS).start


def rows(error: np.ndarray | None = None, velocity_sd: float = 0.002):
    """Innovations of exact beams less ``error`` (4,) [m/s], their rows, and a covariance with ``velocity_sd`` [m/s]."""
    nav, P = np.zeros(NAV_SIZE), np.zeros((N, N))
    nav[QUAT], nav[VEL] = 1.0, 1.5
    P[range(DVEL, DVEL + 3), range(DVEL, DVEL + 3)] = velocity_sd**2
    measured = beam_directions() @ nav[VEL : VEL + 3] + (0.0 if error is None else error)
    still = np.zeros(3)
    z, H = beam_velocities(nav, N, (FIRST, -1), beam_directions(), measured, still, still, True)
    return z, H, P


def of_beam(i: int, value: float) -> np.ndarray:
    error = np.zeros(BEAMS)
    error[i] = value
    return error


def judged(judge: BeamJudge, error=None, velocity_sd=0.002, nominal=SD**2, are_beams=True):
    return judge.judge(*rows(error, velocity_sd), np.full(BEAMS, nominal), are_beams)


def test_sound_beams_are_used():
    """GIVEN beams with the noise that is stated THEN one in a thousand is refused, and the noise stays as stated."""
    judge, rng = BeamJudge(), np.random.default_rng(1)
    verdicts = np.array([judged(judge, SD * rng.standard_normal(BEAMS)).verdict for _ in range(3000)])
    assert (verdicts != USED).mean() < 3e-3
    assert judge.factors == pytest.approx(1.0, abs=0.6)


def test_a_large_error_costs_its_own_beam_only():
    verdict = judged(BeamJudge(), of_beam(2, 0.3)).verdict
    assert verdict.tolist() == [USED, USED, GATED, USED]


def test_lost_beams_are_no_error():
    z, H, P = rows()
    z[[0, 3]] = np.nan
    judge = BeamJudge()
    for _ in range(50):
        assert judge.judge(z, H, P, np.full(BEAMS, SD**2), True).verdict.tolist() == [LOST, USED, USED, LOST]
    assert not judge.out.any()


def test_parity_sees_a_beam_that_the_navigator_does_not_know_well_enough_to_judge():
    """GIVEN a navigator that does not know its velocity along one axis WHEN a beam is off by seven deviations THEN the
    gate passes it, and parity with what is known finds it."""
    z, H, P = rows(of_beam(1, 7.0 * SD))
    P[DVEL, DVEL] = 1.0
    result = BeamJudge().judge(z, H, P, np.full(BEAMS, SD**2), True)
    assert (result.nis < GATE).all()
    assert result.verdict.tolist() == [USED, PARITY, USED, USED]


def test_parity_alone_isolates_nothing():
    """GIVEN a navigator that knows no axis WHEN one beam is wrong THEN none is blamed: each could be the one."""
    assert (judged(BeamJudge(), of_beam(1, 0.3), velocity_sd=10.0).verdict == USED).all()


def test_a_small_lasting_error_ends_the_trust_in_its_beam():
    """GIVEN a beam off by 3.3 deviations, half of whose messages pass the gate THEN it is left out for good soon, and
    used again some time after the error is gone."""
    judge, rng = BeamJudge(), np.random.default_rng(3)
    faulty = np.array(
        [judged(judge, SD * rng.standard_normal(BEAMS) + of_beam(0, 3.3 * SD)).verdict for _ in range(200)]
    )
    assert (faulty[60:, 0] != USED).all()
    assert (faulty[:, 0] == OUT).sum() > 20
    assert (faulty[:, 1:] == USED).mean() > 0.98
    sound = np.array([judged(judge, SD * rng.standard_normal(BEAMS)).verdict for _ in range(200)])
    assert (sound[:5, 0] != USED).all()
    assert (sound[80:, 0] == USED).mean() > 0.98


def test_a_bias_that_no_single_message_shows_is_seen_in_the_mean():
    """GIVEN a beam off by 2.2 deviations, which the gate passes six times in seven THEN it is left out within twenty
    messages, alone; it stays out, and is used again some time after the error is gone."""
    judge, rng = BeamJudge(), np.random.default_rng(9)

    def verdicts(count: int, error: float) -> np.ndarray:
        noise = SD * rng.standard_normal((count, BEAMS))
        return np.array([judged(judge, one + of_beam(3, error)).verdict for one in noise])

    verdicts(50, 0.0)
    faulty = verdicts(300, 2.2 * SD)
    assert (faulty[20:, 3] != USED).all()
    assert (faulty[:, :3] == USED).mean() > 0.995
    sound = verdicts(200, 0.0)
    assert (sound[80:, 3] == USED).mean() > 0.98


def test_single_outliers_are_not_taken_for_a_bias():
    """GIVEN wrong values on 8 % of all, far off or near the gate THEN at most one sound value in fifty is refused."""
    for size in (20.0, 3.0):
        judge, rng = BeamJudge(), np.random.default_rng(11)
        hit = rng.random((2000, BEAMS)) < 0.08
        noise = SD * (rng.standard_normal((2000, BEAMS)) + hit * rng.choice((-size, size), (2000, BEAMS)))
        verdicts = np.array([judged(judge, one).verdict for one in noise])
        assert (verdicts[~hit] != USED).mean() < 0.02


def test_noise_that_grows_is_found_and_forgotten():
    judge, rng = BeamJudge(), np.random.default_rng(5)
    for _ in range(150):
        judged(judge, SD * np.array([1.0, 1.0, 1.0, 2.0]) * rng.standard_normal(BEAMS))
    assert 1.8 < judge.factors[3] < 5.0  # outliers of the gate do not count
    assert judge.factors[:3].max() < 1.8
    for _ in range(150):
        judged(judge, SD * rng.standard_normal(BEAMS))
    assert judge.factors[3] < 1.8


def test_what_the_gate_refuses_does_not_open_the_noise():
    judge = BeamJudge()
    before = judge.factors.copy()
    judged(judge, of_beam(1, 2.0))
    assert judge.factors[1] == before[1]


def test_points_have_no_history():
    judge = BeamJudge()
    for _ in range(30):
        result = judged(judge, of_beam(0, 1.0), are_beams=False)
    assert result.verdict.tolist() == [GATED, USED, USED, USED]
    assert not judge.out.any()
    np.testing.assert_array_equal(result.variance, SD**2)


def test_a_broken_covariance_judges_every_beam_lost():
    z, H, P = rows()
    P[DVEL, DVEL] = np.nan
    assert (BeamJudge().judge(z, H, P, np.full(BEAMS, SD**2), True).verdict == LOST).all()


# --- geometry ------------------------------------------------------------------------------------------------------
def moving(rng) -> np.ndarray:
    return rng.uniform(-2.0, 2.0, 3)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("sign", [1, -1])
def test_every_reading_is_found(swapped, sign):
    check, rng = GeometryCheck(readings(0, False)), np.random.default_rng(2)
    published = with_swapped_angle(beam_directions()) if swapped else beam_directions()
    for _ in range(ENOUGH):
        assert check.decide() is None
        velocity = moving(rng)
        check.add(published, sign * beam_directions() @ velocity + SD * rng.standard_normal(4), velocity, SD)
    assert check.decide() == Reading(swapped, sign)
    assert check.fit == pytest.approx(1.0, abs=0.3)


def test_swapping_twice_changes_nothing():
    directions = np.vstack([beam_directions(), [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(with_swapped_angle(with_swapped_angle(directions)), directions, atol=1e-12)


def test_a_geometry_that_fits_nothing_is_refused():
    check, rng = GeometryCheck(readings(0, False)), np.random.default_rng(2)
    for _ in range(ENOUGH):
        velocity = moving(rng)
        check.add(beam_directions()[:, [1, 2, 0]], beam_directions() @ velocity, velocity, SD)
    assert check.decide() is None
    assert check.refusals == 1
    assert check.fit > 3.0


def test_a_vehicle_at_rest_shows_nothing():
    check = GeometryCheck(readings(0, False))
    for _ in range(100):
        check.add(beam_directions(), np.full(4, SD), np.full(3, SD), SD)
    assert check.messages == 0
    assert check.decide() is None


def test_what_is_given_is_not_guessed():
    assert readings(-1, True) == (Reading(False, -1),)
    assert {reading.swapped for reading in readings(0, True)} == {False}
