"""Half-second means of the solution, and what they say of how a vehicle moves."""

import numpy as np
import pytest

from flown import Flight
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.regimes import Decisions, MotionRegimes, learn_regimes
from nav_pose_estimator.core.motion.usual import Drag, Hover, Travel, UsualMotion
from nav_pose_estimator.core.numerics.rotation import quat_from_euler, quat_to_matrix


def output_rows(count: int, seed: int = 1) -> np.ndarray:
    """Output rows of a vehicle that tumbles."""
    random = np.random.default_rng(seed)
    rows = random.normal(size=(count, at.OUT_COLUMNS))
    angles = random.uniform(-3.0, 3.0, (count, 3))
    rows[:, at.OUT_QUAT : at.OUT_RATE] = [quat_from_euler(*a) for a in angles]
    return rows


def test_an_epoch_holds_the_means_of_its_rows() -> None:
    rows = output_rows(40)
    one = me.epoch(12.5, rows)
    C = np.array([quat_to_matrix(q) for q in rows[:, at.OUT_QUAT : at.OUT_RATE]])
    velocity = rows[:, at.OUT_VEL : at.OUT_QUAT]
    assert one[me.TIME] == 12.5
    np.testing.assert_allclose(me.attitude(one[None])[0], C.mean(axis=0), atol=1e-14)
    np.testing.assert_allclose(one[me.VELOCITY : me.FORCE], velocity.mean(axis=0), atol=1e-14)
    np.testing.assert_allclose(one[me.FORCE : me.RATE], rows[:, at.OUT_FORCE : at.OUT_VAR].mean(axis=0), atol=1e-14)
    np.testing.assert_allclose(one[me.RATE : me.POSITION], rows[:, at.OUT_RATE : at.OUT_FORCE].mean(axis=0), atol=1e-14)
    np.testing.assert_allclose(one[me.POSITION :], rows[:, at.OUT_POS : at.OUT_VEL].mean(axis=0), atol=1e-14)
    in_body = np.einsum("nij,ni->nj", C, velocity).mean(axis=0)
    np.testing.assert_allclose(one[me.BODY_VELOCITY : me.VELOCITY], in_body, atol=1e-14)
    # a mean of products, not a product of means: an aircraft that tumbles shows the difference
    assert np.abs(in_body - C.mean(axis=0).T @ velocity.mean(axis=0)).max() > 0.05


def test_activity_is_the_force_sideways_in_a_banked_turn() -> None:
    """GIVEN a coordinated bank of 30 deg WHEN resolved in n THEN the force sideways is g tan 30 deg."""
    one = np.zeros(me.COLUMNS)
    one[me.ATTITUDE : me.BODY_VELOCITY] = quat_to_matrix(quat_from_euler(np.radians(30.0), 0.0, 0.0)).ravel()
    one[me.FORCE + 2] = 9.81 / np.cos(np.radians(30.0))
    np.testing.assert_allclose(np.exp(me.activity(one[None])), 9.81 * np.tan(np.radians(30.0)), rtol=1e-5)


def test_activity_looks_two_seconds_back_and_no_further() -> None:
    """GIVEN one jolt WHEN the activity is taken THEN it shows for four epochs, from then on as before."""
    epochs = np.zeros((12, me.COLUMNS))
    epochs[:, me.ATTITUDE : me.BODY_VELOCITY] = np.eye(3).ravel()
    epochs[5, me.FORCE] = 2.0
    active = me.activity(epochs)
    assert np.isfinite(active).all()
    np.testing.assert_allclose(active[5:9], np.log(1.0), atol=1e-3)  # RMS of (2, 0, 0, 0)
    assert (active[9:] < -4.0).all()
    np.testing.assert_allclose(active[:5], active[9])
    np.testing.assert_allclose(me.activity(epochs[4:6])[-1], np.log(2.0 / np.sqrt(2.0)), atol=1e-3)


# --- regimes ---------------------------------------------------------------------------------------------------------


USUAL = UsualMotion(
    multirotor=Travel(speed=2.0, velocity_time=8.0, loiter=6.0),
    fixed_wing=Travel(speed=11.0, velocity_time=8.0, loiter=6.0),
    hover=Hover(speed=0.3, activity=(-1.9, 0.6), travel_activity=(-0.1, 0.9), wander=1.0, time=12.0, missed=0.1),
    drag=Drag(rate=0.2, rate_spread=0.05, noise=2.0),
)


def moving(speeds: np.ndarray, jolts: np.ndarray, seed: int = 2) -> np.ndarray:
    """Level epochs of given speed [m/s] in changing directions, with accelerations of ``jolts`` [m/s^2]."""
    random = np.random.default_rng(seed)
    epochs = np.zeros((len(speeds), me.COLUMNS))
    epochs[:, me.TIME] = me.PERIOD * np.arange(1, len(speeds) + 1)
    epochs[:, me.ATTITUDE : me.BODY_VELOCITY] = np.eye(3).ravel()
    course = random.uniform(0.0, 2.0 * np.pi, len(speeds))
    epochs[:, me.VELOCITY : me.VELOCITY + 2] = speeds[:, None] * np.column_stack([np.cos(course), np.sin(course)])
    epochs[:, me.FORCE : me.FORCE + 2] = jolts[:, None] * random.standard_normal((len(speeds), 2))
    return epochs


def stop_and_go(minutes: int = 10) -> np.ndarray:
    """Half a minute at 8 m/s, half a minute of hovering, and so on."""
    travels = (np.arange(minutes * 120) // 60) % 2 == 0
    return moving(np.where(travels, 8.0, 0.2), np.where(travels, 2.0, 0.1))


def test_both_regimes_of_a_flight_are_found() -> None:
    """GIVEN ten minutes of dashes and hovers WHEN learned THEN each regime has its own spread and activity."""
    regimes = learn_regimes(stop_and_go(), USUAL)
    assert regimes.can_hover
    assert regimes.travel_var == pytest.approx(32.0, rel=0.1)  # 8 m/s in two components
    assert regimes.hover_var == pytest.approx(0.02, abs=0.01)
    assert regimes.travel_activity[0] == pytest.approx(np.log(2.0 * np.sqrt(2.0)), abs=0.3)
    assert regimes.hover_activity[0] < regimes.travel_activity[0] - 1.5


def test_the_last_five_seconds_say_which_regime_the_vehicle_is_in() -> None:
    """GIVEN that flight WHEN it is cut in a hover, in a dash, and between THEN the hover is sure, not, and half so."""
    epochs = stop_and_go()
    assert learn_regimes(epochs, USUAL).hover_probability == pytest.approx(0.98)
    assert learn_regimes(epochs[:-60], USUAL).hover_probability == pytest.approx(0.02)
    assert learn_regimes(epochs[:-55], USUAL).hover_probability == pytest.approx(0.5)


def test_a_fixed_wing_cannot_hover() -> None:
    """GIVEN a vehicle that is never slow WHEN learned THEN there is no hovering; its own speed is the spread."""
    regimes = learn_regimes(moving(np.full(600, 16.0), np.full(600, 3.0)), USUAL)
    assert not regimes.can_hover
    assert regimes.travel_var == pytest.approx(128.0, rel=0.1)
    assert regimes.hover_probability == pytest.approx(0.02)


def finite(regimes: MotionRegimes) -> bool:
    values = [regimes.travel_var, regimes.hover_var, *regimes.travel_activity, *regimes.hover_activity]
    return bool(np.isfinite(values).all()) and min(regimes.travel_var, regimes.hover_var) > 0.0


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_of_hardly_any_flight_the_usual_is_known(count: int) -> None:
    """GIVEN no epoch or a few WHEN learned THEN the statistics are the usual ones, finite, and either regime may be."""
    regimes = learn_regimes(stop_and_go()[:count], USUAL)
    assert finite(regimes)
    assert regimes.hover_var == pytest.approx(0.3**2)
    # at 8 m/s from the first epoch on it may well be a wing
    usual = USUAL.fixed_wing if count else USUAL.multirotor
    assert regimes.travel_var == pytest.approx(usual.speed**2, rel=0.1)
    if count == 0:
        assert regimes.can_hover
        assert regimes.hover_probability == 0.5


def test_a_vehicle_at_rest_keeps_sensible_statistics_of_travelling() -> None:
    regimes = learn_regimes(moving(np.zeros(1200), np.zeros(1200)), USUAL)
    assert finite(regimes)
    assert regimes.travel_var == pytest.approx(4.0)
    assert 0.0 < regimes.hover_var < 0.01


def test_a_flight_that_only_hovered_expects_the_motion_of_others() -> None:
    """GIVEN five minutes of hovering WHEN learned THEN the place is that of the usual flight, and the position of a
    hover spreads the more the longer ago GNSS was lost: it may have ended."""
    regimes = learn_regimes(moving(np.full(600, 0.2), np.full(600, 0.1)), USUAL)
    assert regimes.travel_var == pytest.approx(4.0)
    assert regimes.place_var == pytest.approx(36.0 * 4.0)  # where it hovers says nothing of where it travels to
    assert regimes.doubt_psd(regimes.until) == 0.0
    soon, late = (regimes.doubt_psd(regimes.until + after) for after in (10.0, 60.0))
    assert 0.0 < soon < late < 8.0 * 4.0 * 0.1
    assert late / soon == pytest.approx(-np.expm1(-60.0 / 162.0) / -np.expm1(-10.0 / 162.0), rel=0.02)


def test_how_far_a_hover_wanders_is_learned_from_hovers_alone() -> None:
    """GIVEN hovers that go to and fro between two places 4 m apart, and a dash WHEN learned THEN the variance comes
    from the usual one to that of the hovers, and the dash has no part in it."""
    slow, fast = np.full(480, 0.3), np.full(60, 8.0)
    epochs = moving(np.concatenate([slow, fast]), np.full(540, 0.1))
    north = np.where(np.arange(540) // 60 % 2 == 0, 0.0, 4.0)  # half a minute later it is always at the other one
    north[480:] += 1000.0
    epochs[:, me.POSITION] = 0.8 + north / 6.37e6
    of_hovers = 0.5 * 4.0**2
    seconds = (480 - 60) * me.PERIOD
    expected = (60.0 * 1.0 + seconds * of_hovers) / (60.0 + seconds)
    assert learn_regimes(epochs, USUAL).wander_var == pytest.approx(expected, rel=0.02)
    assert learn_regimes(epochs[:40], USUAL).wander_var == pytest.approx(1.0)


def test_rehearsals_that_saw_the_vehicle_travel_take_the_doubt_away() -> None:
    """GIVEN a flight WHEN rehearsals covered as much motion as the prior is worth THEN half of the doubt is left."""
    epochs = stop_and_go(2)
    before = learn_regimes(epochs, USUAL)
    seen = Decisions(travelled=30.0 * before.travel_var, missed=3.0)
    assert learn_regimes(epochs, USUAL, seen).unnoticed_psd == pytest.approx(0.5 * before.unnoticed_psd)


def test_a_flight_that_goes_far_is_expected_to_go_on() -> None:
    """GIVEN a flight straight ahead WHEN learned THEN its place varies as far as it went in half a minute."""
    epochs = moving(np.full(600, 8.0), np.full(600, 2.0))
    epochs[:, me.POSITION] = 0.8 + 8.0 * epochs[:, me.TIME] / 6.37e6
    regimes = learn_regimes(epochs, USUAL)
    assert 100.0 < np.sqrt(regimes.place_var) < 240.0 / np.sqrt(2.0)


def test_the_made_up_flight_is_one_that_can_hover() -> None:
    assert learn_regimes(Flight(hover=0.4).epochs(), USUAL).can_hover
