"""Missions of a multirotor: smooth references for its position control."""

from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.numerics.rotation import wrap_angle_many
from nav_pose_estimator.sim.noise import gauss_markov
from nav_pose_estimator.sim.vehicles.motions import minimum_jerk

POS, VEL, ACC, YAW, COLUMNS = 0, 3, 6, 9, 10
"""Columns of a reference: position [m], velocity, acceleration (East, North, Up), yaw [rad]."""

YAW_TIME = 3.0
"""Duration [s] of a turn about the vertical."""


@dataclass(frozen=True)
class Mission:
    """A mission after take-off; distances are relative to the place of take-off."""

    style: str = "waypoints"  # waypoints, laps, hover, stop_and_go
    speed: float = 8.0  # m/s: peak speed on a leg or a lap
    acceleration: float = 3.0  # m/s^2: peak acceleration on a leg
    leg: tuple[float, float] = (15.0, 60.0)  # m, shortest and longest
    dwell: tuple[float, float] = (0.0, 4.0)  # s between legs
    radius: float = 120.0  # m: legs end within it; semi-major axis of laps
    height: tuple[float, float] = (20.0, 40.0)  # m above the place of take-off
    rest: float = 12.0  # s on the ground before take-off; 0: start in hover at the lower height
    nose: str = "turning"  # yaw: turning (a random one for each leg), forward, fixed
    wander_sd: float = 0.1  # m per axis: position error of the autopilot


@dataclass(frozen=True)
class _Move:
    """A rest-to-rest move of the position, or of the yaw, from ``a`` to ``b``."""

    start: float  # s
    length: float  # s
    a: np.ndarray
    b: np.ndarray


def reference(mission: Mission, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """References (N, COLUMNS) at the equidistant times ``t`` (N,) [s], relative to the place of take-off."""
    yaw = rng.uniform(-np.pi, np.pi)
    place = np.array([0.0, 0.0, 0.0 if mission.rest > 0.0 else mission.height[0]])
    legs = [_leg(mission.rest, place, np.array([0.0, 0.0, mission.height[0]]), 3.0, 1.5)]
    turns = [_Move(mission.rest, YAW_TIME, np.array([yaw]), np.array([yaw]))]
    now = mission.rest + legs[0].length + 2.0
    refs = np.zeros((len(t), COLUMNS))
    if mission.style != "laps":
        _plan(mission, rng, now, t[-1], legs, turns)
    position, refs[:, VEL : VEL + 3], refs[:, ACC : ACC + 3] = _follow(legs, t)
    refs[:, YAW] = _follow(turns, t)[0][:, 0]
    wander = gauss_markov(rng, len(t), t[1] - t[0], mission.wander_sd, 5.0)
    refs[:, POS : POS + 3] = position + np.where(t > mission.rest, 1.0, 0.0)[:, None] * wander
    if mission.style == "laps":
        _add_laps(refs, t, now, mission)
    return refs


def _plan(
    mission: Mission, rng: np.random.Generator, now: float, end: float, legs: list[_Move], turns: list[_Move]
) -> None:
    """Append legs between random places to ``legs``, and turns to ``turns``, from ``now`` to ``end`` [s]."""
    while now < end:
        place, yaw = legs[-1].b, turns[-1].b
        target = _next_place(mission, rng, place)
        turns.append(_Move(now, YAW_TIME, yaw, _next_yaw(mission, rng, yaw, target - place)))
        if mission.nose == "forward":
            now += YAW_TIME
        legs.append(_leg(now, place, target, mission.speed, mission.acceleration))
        now += legs[-1].length + rng.uniform(*mission.dwell)


def _leg(start: float, a: np.ndarray, b: np.ndarray, speed: float, acceleration: float) -> _Move:
    """Move from ``a`` to ``b`` (3,) [m] with the given peak speed and acceleration."""
    distance = float(np.linalg.norm(b - a))
    # peak speed and acceleration of a minimum-jerk move over a distance d in a time T: 15/8 d/T and 5.7735 d/T^2
    return _Move(start, max(1.875 * distance / speed, np.sqrt(5.7735 * distance / acceleration), 0.1), a, b)


def _follow(moves: list[_Move], t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value and first two derivatives (N, k) along consecutive moves; constant before, between and after them."""
    row = np.maximum(np.searchsorted([move.start for move in moves], t, side="right") - 1, 0)
    length = np.array([move.length for move in moves])[row]
    start = np.array([move.start for move in moves])[row]
    a, b = np.array([move.a for move in moves])[row], np.array([move.b for move in moves])[row]
    step, rate, curvature = minimum_jerk((t - start) / length)
    return a + step[:, None] * (b - a), (rate / length)[:, None] * (b - a), (curvature / length**2)[:, None] * (b - a)


def _next_place(mission: Mission, rng: np.random.Generator, place: np.ndarray) -> np.ndarray:
    """A random next place (3,) [m]; a leg that would leave the area points back to its centre."""
    length, course = rng.uniform(*mission.leg), rng.uniform(-np.pi, np.pi)
    target = place + length * np.array([np.cos(course), np.sin(course), 0.0])
    if np.hypot(target[0], target[1]) > mission.radius:
        home = np.arctan2(-place[1], -place[0]) + rng.uniform(-0.5, 0.5)
        target = place + length * np.array([np.cos(home), np.sin(home), 0.0])
    target[2] = np.clip(place[2] + rng.uniform(-0.15, 0.15) * length, *mission.height)
    return target


def _next_yaw(mission: Mission, rng: np.random.Generator, yaw: np.ndarray, leg: np.ndarray) -> np.ndarray:
    """Yaw (1,) [rad] for the next leg, continuous and by the shorter turn."""
    choice = rng.uniform(-np.pi, np.pi)
    if mission.nose == "fixed":
        return yaw
    if mission.nose == "forward":
        choice = np.arctan2(leg[1], leg[0])
    return yaw + wrap_angle_many(choice - yaw)


def _add_laps(refs: np.ndarray, t: np.ndarray, now: float, mission: Mission) -> None:
    """Add laps on an ellipse, twice as long as wide, from ``now`` [s] on, with a smooth start."""
    ramp = 8.0
    x = (t - now) / ramp
    step, rate, _ = minimum_jerk(x)
    # the mean radius of the ellipse is 0.77 of its semi-major axis; the step integrates to half of the ramp
    turn_rate = mission.speed / (0.77 * mission.radius)
    angle = turn_rate * ramp * np.where(x < 1.0, _step_integral(np.clip(x, 0.0, 1.0)), x - 0.5)
    spin, spin_rate = turn_rate * step, turn_rate * rate / ramp
    sin, cos = np.sin(angle), np.cos(angle)
    east, north = mission.radius, 0.5 * mission.radius
    refs[:, POS : POS + 2] += np.column_stack([east * sin, north * (1.0 - cos)])
    refs[:, VEL : VEL + 2] += np.column_stack([east * cos * spin, north * sin * spin])
    refs[:, ACC] += east * (cos * spin_rate - sin * spin**2)
    refs[:, ACC + 1] += north * (sin * spin_rate + cos * spin**2)
    if mission.nose != "fixed":
        course = np.unwrap(np.arctan2(0.5 * sin, cos))
        refs[:, YAW] += minimum_jerk((t - now) / YAW_TIME)[0] * (course - refs[:, YAW])


def _step_integral(x: np.ndarray) -> np.ndarray:
    """Integral of the minimum-jerk step from 0 to ``x``; 1/2 at 1."""
    return x**4 * (2.5 - 3.0 * x + x**2)
