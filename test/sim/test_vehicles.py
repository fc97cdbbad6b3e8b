"""Physics of the simulated vehicles."""

from dataclasses import replace

import numpy as np
import pytest

from closed_loop import navigate
from nav_pose_estimator.core.numerics.rotation import euler_from_quat_many, quat_conjugate_many, quat_rotate_many
from nav_pose_estimator.sim.noise import stream
from nav_pose_estimator.sim.scenarios import HOME, find_scenario
from nav_pose_estimator.sim.trajectories import Truth, sample_times
from nav_pose_estimator.sim.vehicles.fixed_wing import Flight
from nav_pose_estimator.sim.vehicles.missions import ACC, POS, VEL, YAW, Mission, reference
from nav_pose_estimator.sim.vehicles.models import FixedWing, Multirotor, RoadVehicle
from nav_pose_estimator.sim.vehicles.multirotor import Airframe
from nav_pose_estimator.sim.vehicles.road_vehicle import Drive
from nav_pose_estimator.sim.wind import LIGHT, MODERATE, Wind

TIMES = sample_times(60.0, 100.0)


@pytest.fixture(scope="module")
def flight() -> Truth:
    """A quadrotor between waypoints in moderate wind."""
    return Multirotor().move(TIMES, HOME, MODERATE, seed=3)


def in_body(truth: Truth, vectors: np.ndarray) -> np.ndarray:
    return quat_rotate_many(quat_conjugate_many(truth.q_nb), vectors)


def test_accelerometer_of_a_multirotor_feels_nothing_but_drag_in_its_plane(flight: Truth) -> None:
    frame = Airframe()
    air = in_body(flight, flight.v_n - flight.wind_n)
    speed = np.linalg.norm(air, axis=1)
    drag = -(np.array([frame.drag_x, frame.drag_y]) + frame.frame_drag * speed[:, None]) * air[:, :2]
    mean = 0.5 * (drag[1:] + drag[:-1])  # the IMU row is the mean between two rows
    airborne = flight.t[1:] > 14.0
    np.testing.assert_allclose(flight.accel[1:][airborne, :2], mean[airborne], atol=0.005)
    assert np.abs(mean[airborne]).max() > 1.0  # there was something to feel


def test_multirotor_solves_the_navigation_equations(flight: Truth) -> None:
    errors = navigate(flight)
    assert errors.position[-1] < 0.01
    assert errors.attitude[-1] < 1e-6


def test_multirotor_rests_until_take_off_and_flies_afterwards(flight: Truth) -> None:
    ground = flight.t < 11.9
    assert np.abs(flight.v_n[ground]).max() == 0.0
    np.testing.assert_allclose(np.linalg.norm(flight.accel[ground], axis=1), 9.806, atol=0.01)
    assert flight.position_enu(HOME)[-1, 2] > 15.0


def test_multirotor_keeps_to_its_reference(flight: Truth) -> None:
    refs = reference(Mission(), stream(3, "mission"), TIMES)[1:]
    error = flight.position_enu(HOME) - refs[:, POS : POS + 3]
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 2.0
    yaw = euler_from_quat_many(flight.q_nb)[:, 2]
    settled = flight.t > 20.0
    assert np.median(np.abs(np.angle(np.exp(1j * (yaw - refs[:, YAW]))))[settled]) < 0.1


def test_same_flight_in_another_wind() -> None:
    calm = reference(Mission(), stream(3, "mission"), TIMES)
    again = reference(Mission(), stream(3, "mission"), TIMES)
    np.testing.assert_array_equal(calm, again)
    short = sample_times(20.0, 100.0)
    first, second = (Multirotor().move(short, HOME, wind, seed=3) for wind in (LIGHT, MODERATE))
    distance = np.linalg.norm(first.position_enu(HOME) - second.position_enu(HOME), axis=1)
    assert 0.1 < distance.max() < 5.0


@pytest.mark.parametrize("style", ["waypoints", "laps", "hover", "stop_and_go"])
def test_references_are_consistent(style: str) -> None:
    mission = Mission(style, wander_sd=0.0)
    t = sample_times(120.0, 200.0)
    refs = reference(mission, stream(1, "mission"), t)
    dt = t[1] - t[0]
    speed = (refs[2:, POS : POS + 3] - refs[:-2, POS : POS + 3]) / (2.0 * dt)
    np.testing.assert_allclose(refs[1:-1, VEL : VEL + 3], speed, atol=5e-3)
    acceleration = (refs[2:, VEL : VEL + 3] - refs[:-2, VEL : VEL + 3]) / (2.0 * dt)
    np.testing.assert_allclose(refs[1:-1, ACC : ACC + 3], acceleration, atol=0.06)
    assert np.abs(np.diff(refs[:, YAW])).max() < 0.02  # no jumps


@pytest.mark.compiled
def test_speeds_of_the_missions() -> None:
    def speeds(name: str) -> np.ndarray:
        truth = find_scenario(name).vehicle.move(sample_times(100.0, 100.0), HOME, LIGHT, seed=2)
        return np.linalg.norm(truth.v_n[truth.t > 35.0, :2], axis=1)

    dash = speeds("stop_and_go")
    assert dash.max() > 10.0
    assert np.percentile(dash, 10) < 1.0
    assert np.percentile(speeds("hover"), 95) < 1.0
    assert 6.0 < np.mean(speeds("laps")) < 10.0


def test_car_neither_slips_nor_lifts_off() -> None:
    truth = RoadVehicle().move(sample_times(300.0, 50.0), HOME, Wind(), seed=4)
    velocity = in_body(truth, truth.v_n)
    assert np.abs(velocity[:, 1:]).max() < 1e-9
    speed = np.linalg.norm(truth.v_n, axis=1)
    assert 8.0 < speed.max() < 25.5
    assert np.mean(speed < 1e-3) > 0.05  # it stops, and stands still
    assert np.abs(truth.accel[:, 1]).max() < 4.0
    assert speed[truth.t < 14.0].max() < 1e-6
    assert np.ptp(truth.alt) > 5.0
    assert navigate(truth).position[-1] < 0.01


def test_fixed_wing_flies_coordinated_turns_in_moving_air() -> None:
    truth = FixedWing(Flight()).move(sample_times(240.0, 50.0), HOME, LIGHT, seed=5)
    flying = truth.t > 40.0
    airspeed = np.linalg.norm((truth.v_n - truth.wind_n)[flying], axis=1)
    assert airspeed.min() > 14.0
    assert airspeed.max() < 23.0
    roll = euler_from_quat_many(truth.q_nb)[:, 0]
    assert np.abs(roll).max() > 0.4
    assert np.abs(truth.accel[flying, 1]).max() < 0.1 * np.abs(9.81 * np.sin(roll)).max() + 0.7
    assert np.linalg.norm(truth.accel[flying], axis=1).max() > 1.1 * 9.81
    assert np.abs(truth.v_n[truth.t < 14.0]).max() < 1e-6
    assert navigate(truth).position[-1] < 0.05


def test_drag_is_what_the_airframe_says() -> None:
    slick = Multirotor(airframe=replace(Airframe(), drag_x=0.0, drag_y=0.0, frame_drag=0.0))
    truth = slick.move(sample_times(30.0, 100.0), HOME, LIGHT, seed=3)
    assert np.abs(truth.accel[truth.t > 13.0, :2]).max() < 1e-9


def test_stops_of_a_drive_are_drawn_from_the_plan() -> None:
    never = RoadVehicle(Drive(stop_every=1e5)).move(sample_times(200.0, 20.0), HOME, Wind(), seed=4)
    often = RoadVehicle(Drive(stop_every=200.0)).move(sample_times(200.0, 20.0), HOME, Wind(), seed=4)

    def stops(truth: Truth) -> int:
        still = np.linalg.norm(truth.v_n, axis=1) < 1e-3
        return int(np.sum(np.diff(still.astype(int)) == 1))

    assert stops(never) == 0
    assert stops(often) >= 2
