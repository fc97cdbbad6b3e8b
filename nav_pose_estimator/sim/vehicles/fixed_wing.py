"""Motion of a fixed wing: runway, climb, then straight legs, coordinated turns, climbs and descents in wind.

Bank angle, airspeed and climb angle are smooth functions of time. The heading turns at g tan(bank) / airspeed, which
keeps the specific force in the plane of symmetry. The wind is added to the velocity, after smoothing of gusts that are
too short for the inertia of the aircraft.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from nav_pose_estimator.sim.trajectories import Kinematics, Motion
from nav_pose_estimator.sim.vehicles.motions import G, attitude_from_euler, minimum_jerk
from nav_pose_estimator.sim.wind import Wind

_TICK = 0.1
"""Step [s] of the plan."""


@dataclass(frozen=True)
class Flight:
    """A flight of a small fixed wing (wing span about 2 m)."""

    airspeed: tuple[float, float] = (15.0, 22.0)  # m/s
    bank: tuple[float, float] = (0.35, 0.8)  # rad
    leg: tuple[float, float] = (4.0, 18.0)  # s of straight flight
    turn: tuple[float, float] = (4.0, 14.0)  # s of turning
    climb: float = 0.15  # rad: steepest climb angle
    attack: float = 0.05  # rad: angle of attack
    rest: float = 15.0  # s on the runway
    roll_out: float = 8.0  # s to take-off speed


def fly(
    plan: Flight, wind: Wind, rng: np.random.Generator, wind_rng: np.random.Generator, duration: float
) -> tuple[Motion, CubicSpline]:
    """The motion over ``duration`` [s] from -1 s on, and the wind (East, North, Up) as a function of time."""
    ticks = np.arange(-2.0, duration + 3.0, _TICK)
    airspeed, bank, climb = (CubicSpline(ticks, values) for values in _plan(plan, rng, ticks))
    turn_rate = CubicSpline(ticks, -G * np.tan(bank(ticks)) / np.maximum(airspeed(ticks), 5.0))
    course = turn_rate.antiderivative()
    start = rng.uniform(-np.pi, np.pi)
    raw = wind.sample(wind_rng, len(ticks), _TICK)
    air = CubicSpline(ticks, gaussian_filter1d(raw, 0.6 / _TICK, axis=0, mode="nearest"))
    afloat = minimum_jerk((ticks - plan.rest - plan.roll_out) / 4.0)[0]
    carried = CubicSpline(ticks, air(ticks) * afloat[:, None])
    nose_up = CubicSpline(ticks, plan.attack * afloat)

    def motion(t: np.ndarray) -> Kinematics:
        u, a = airspeed(t), airspeed(t, 1)
        yaw, yaw_rate, path, path_rate = start + course(t), turn_rate(t), climb(t), climb(t, 1)
        cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(path), np.sin(path)
        ahead = np.column_stack([cy * cp, sy * cp, sp])
        left = np.column_stack([-sy * cp, cy * cp, np.zeros_like(t)])
        up = np.column_stack([-cy * sp, -sy * sp, cp])
        a_t = a[:, None] * ahead + (u * yaw_rate)[:, None] * left + (u * path_rate)[:, None] * up
        pitch, pitch_rate = -(path + nose_up(t)), -(path_rate + nose_up(t, 1))
        q, w = attitude_from_euler(bank(t), pitch, yaw, bank(t, 1), pitch_rate, yaw_rate)
        return Kinematics(u[:, None] * ahead + carried(t), a_t + carried(t, 1), q, w)

    return motion, air


def _plan(plan: Flight, rng: np.random.Generator, ticks: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Airspeed, bank and climb angle (N,) at ``ticks``, smooth."""
    cruise, bank, climb = np.empty_like(ticks), np.zeros_like(ticks), np.zeros_like(ticks)
    airborne = plan.rest + plan.roll_out
    cruise[:] = plan.airspeed[0]
    climb[(ticks > airborne) & (ticks < airborne + 20.0)] = plan.climb
    now, height = airborne + 22.0, 1.0
    while now < ticks[-1]:
        leg, turn = rng.uniform(*plan.leg), rng.uniform(*plan.turn)
        side, angle = rng.choice((-1.0, 1.0)), rng.uniform(*plan.bank)
        first, middle, last = np.searchsorted(ticks, (now, now + leg, now + leg + turn))
        cruise[first:last] = rng.uniform(*plan.airspeed)
        bank[middle:last] = side * angle
        # height above that after take-off, in seconds at the steepest climb angle; it is kept within about 20
        path = rng.uniform(-1.0, 1.0)
        path = -abs(path) if height > 20.0 else (abs(path) if height < 5.0 else path)
        climb[first:middle] = path * plan.climb
        height += path * leg
        now += leg + turn
    cruise = gaussian_filter1d(cruise, 2.0 / _TICK, mode="nearest")
    airspeed = cruise * minimum_jerk((ticks - plan.rest) / plan.roll_out)[0]
    return airspeed, gaussian_filter1d(bank, 0.5 / _TICK), gaussian_filter1d(climb, 0.8 / _TICK)
