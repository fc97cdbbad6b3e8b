"""Motion of a multirotor under position control in wind, by integration of its equations of motion.

Thrust is along the z axis of b, so that the accelerometer's x and y axes measure only the drag

    f_xy = -(k + c |u|) u_xy,  u = C_bn (v_n - wind_n)

with rotor drag k and frame drag c per mass (Faessler, Franchi, Scaramuzza, "Differential flatness of quadrotor dynamics
subject to rotor drag ...", RA-L 2018). Attitude, velocity and position follow the strapdown equations on the rotating
ellipsoid (Groves, 2nd ed., section 5.4). They are integrated by the classic Runge-Kutta method together with angular
rate and specific force, whose means over the sample interval are the samples of the IMU.
"""

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import OMEGA, gravity, radii
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.rotation import quat_from_euler
from nav_pose_estimator.core.numerics.vectors import (
    add,
    add_scaled,
    cross,
    dot,
    load3,
    load4,
    q_columns,
    q_multiply,
    q_rotate,
    q_rotate_back,
    scale,
    store3,
    store4,
)
from nav_pose_estimator.sim.trajectories import Origin, Truth
from nav_pose_estimator.sim.vehicles.missions import ACC, POS, YAW, Mission, reference
from nav_pose_estimator.sim.vehicles.missions import VEL as REF_VEL
from nav_pose_estimator.sim.wind import Wind


@dataclass(frozen=True)
class Airframe:
    """Drag, actuators and controller of a quadrotor of 1 to 2 kg."""

    drag_x: float = 0.30  # 1/s, rotor drag along body x
    drag_y: float = 0.25  # 1/s
    drag_z: float = 0.10  # 1/s
    frame_drag: float = 0.01  # 1/m, quadratic
    thrust_lag: float = 0.05  # s
    rate_lag: float = 0.04  # s: time constant of the inner rate loop
    position_gain: float = 1.0  # 1/s^2
    velocity_gain: float = 1.8  # 1/s
    integral_gain: float = 0.15  # 1/s^3
    tilt_gain: float = 7.0  # 1/s
    yaw_gain: float = 2.5  # 1/s
    max_tilt: float = math.radians(45.0)  # rad
    max_rate: float = 6.0  # rad/s about x and y
    max_yaw_rate: float = 2.0  # rad/s


# layout of the state: position, velocity, attitude, rate, thrust, and the integrals of the IMU over a sample interval
LAT, VEL, QUAT, RATE, THRUST, TURN, PUSH, SIZE = 0, 3, 6, 10, 13, 14, 17, 20
# layout of the constants for the kernels: the fields of Airframe in their order, then origin, take-off and time step
_DRAG, _FRAME_DRAG, _THRUST_LAG, _RATE_LAG = 0, 3, 4, 5
_KP, _KV, _KI, _K_TILT, _K_YAW, _MAX_TILT, _MAX_RATE, _MAX_YAW_RATE = 6, 7, 8, 9, 10, 11, 12, 13
_PLACE, _TAKE_OFF, _DT, _SUBSTEPS = 14, 17, 18, 19

MAX_STEP = 0.005
"""Longest integration step [s]; with a lag of the rate loop of 0.04 s the error is below 1e-9 rad per second."""


def fly(
    mission: Mission,
    wind: Wind,
    times: np.ndarray,
    origin: Origin,
    rng: np.random.Generator,
    wind_rng: np.random.Generator,
    airframe: Airframe | None = None,
) -> Truth:
    """Fly ``mission`` from ``origin``. The interval of row 0 begins at the first of the equidistant ``times`` [s].

    ``rng`` determines the mission and ``wind_rng`` the wind, so that the same mission can be flown in another wind.
    """
    airframe = airframe or Airframe()
    dt = float(times[1] - times[0])
    refs = reference(mission, rng, times)
    wind_n = wind.sample(wind_rng, len(times), dt)
    take_off = float(np.searchsorted(times, mission.rest)) if mission.rest > 0.0 else 0.0
    substeps = math.ceil(dt / MAX_STEP - 1e-9)
    constants = np.array([*vars(airframe).values(), *origin, take_off, dt, substeps], dtype=float)

    x = np.zeros(SIZE)
    x[LAT : LAT + 3] = origin
    x[LAT + 2] += refs[0, POS + 2]
    x[QUAT : QUAT + 4] = quat_from_euler(0.0, 0.0, refs[0, YAW])
    x[THRUST] = gravity(origin.lat, origin.alt)
    rows = np.empty((len(times), SIZE))
    _simulate(x, refs, wind_n, constants, rows)
    rows = rows[1:]
    return Truth(
        t=times[1:],
        lat=rows[:, LAT],
        lon=rows[:, LAT + 1],
        alt=rows[:, LAT + 2],
        v_n=rows[:, VEL : VEL + 3],
        q_nb=rows[:, QUAT : QUAT + 4],
        wind_n=wind_n[1:],
        gyro=rows[:, TURN : TURN + 3] / dt,
        accel=rows[:, PUSH : PUSH + 3] / dt,
    )


@kernel
def _simulate(x, refs, wind, constants, rows):
    """Fill ``rows`` (N, SIZE): the state at each time, and the integrals since the previous one.

    The ``wind`` (N, 3) [m/s] is linear in between.
    """
    dt = constants[_DT] / constants[_SUBSTEPS]
    substeps = int(constants[_SUBSTEPS])
    integral = np.zeros(3)
    command = np.zeros(4)
    slopes = np.empty((4, SIZE))
    trial = np.empty(SIZE)
    for i in range(SIZE):
        rows[0, i] = x[i]
    for k in range(1, rows.shape[0]):
        airborne = k > constants[_TAKE_OFF]
        _control(x, refs[k - 1], integral, constants, command)
        for i in range(TURN, SIZE):
            x[i] = 0.0
        before = load3(wind[k - 1], 0)
        change = add_scaled(load3(wind[k], 0), -1.0, before)
        for j in range(substeps):
            _runge_kutta(
                x, before, change, j / substeps, 1.0 / substeps, command, airborne, constants, dt, slopes, trial
            )
        for i in range(SIZE):
            rows[k, i] = x[i]


@kernel
def _runge_kutta(x, wind, change, start, length, command, airborne, constants, dt, slopes, trial):
    """One step of the classic fourth-order method.

    The wind goes from ``wind + start * change`` to ``wind + (start + length) * change``.
    """
    for stage in range(4):
        share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        for i in range(SIZE):
            trial[i] = x[i] + (share * dt * slopes[stage - 1, i] if stage > 0 else 0.0)
        air = add_scaled(wind, start + share * length, change)
        _slope(trial, air, command, airborne, constants, slopes[stage])
    norm = 0.0
    for i in range(SIZE):
        x[i] += dt / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
    for i in range(QUAT, QUAT + 4):
        norm += x[i] * x[i]
    for i in range(QUAT, QUAT + 4):
        x[i] /= math.sqrt(norm)


@kernel
def _slope(x, wind, command, airborne, constants, d):
    """Time derivative ``d`` of the state ``x``."""
    v = load3(x, VEL)
    q = load4(x, QUAT)
    w_nb = load3(x, RATE)
    s, c = math.sin(x[LAT]), math.cos(x[LAT])
    R_M, R_N = radii(x[LAT])
    R_M += x[LAT + 2]
    R_N += x[LAT + 2]
    w_ie = (0.0, OMEGA * c, OMEGA * s)
    w_en = (-v[1] / R_M, v[0] / R_N, v[0] * s / (c * R_N))
    g = gravity(x[LAT], x[LAT + 2])
    if airborne:
        u = q_rotate_back(q, add_scaled(v, -1.0, wind))
        frame = constants[_FRAME_DRAG] * math.sqrt(dot(u, u))
        f = (
            -(constants[_DRAG] + frame) * u[0],
            -(constants[_DRAG + 1] + frame) * u[1],
            x[THRUST] - (constants[_DRAG + 2] + frame) * u[2],
        )
        for i in range(3):
            d[RATE + i] = (command[i] - w_nb[i]) / constants[_RATE_LAG]
        d[THRUST] = (command[3] - x[THRUST]) / constants[_THRUST_LAG]
    else:
        f = q_rotate_back(q, (0.0, 0.0, g))  # reaction of the ground
        store3(d, RATE, (0.0, 0.0, 0.0))
        d[THRUST] = 0.0
    d[LAT] = v[1] / R_M
    d[LAT + 1] = v[0] / (R_N * c)
    d[LAT + 2] = v[2]
    coriolis = cross(add_scaled(w_en, 2.0, w_ie), v)
    store3(d, VEL, add_scaled(add(q_rotate(q, f), (0.0, 0.0, -g)), -1.0, coriolis))
    store4(d, QUAT, q_multiply(q, (0.0, 0.5 * w_nb[0], 0.5 * w_nb[1], 0.5 * w_nb[2])))
    store3(d, TURN, add(w_nb, q_rotate_back(q, add(w_ie, w_en))))
    store3(d, PUSH, f)


@kernel
def _control(x, ref, integral, constants, command):
    """Cascaded position control as in autopilots: writes angular rate (3) and specific thrust into ``command``."""
    R_M, R_N = radii(constants[_PLACE])
    east = (x[LAT + 1] - constants[_PLACE + 1]) * (R_N + constants[_PLACE + 2]) * math.cos(constants[_PLACE])
    north = (x[LAT] - constants[_PLACE]) * (R_M + constants[_PLACE + 2])
    error = add_scaled(load3(ref, POS), -1.0, (east, north, x[LAT + 2] - constants[_PLACE + 2]))
    slip = add_scaled(load3(ref, REF_VEL), -1.0, load3(x, VEL))
    push = add_scaled(add_scaled(load3(ref, ACC), constants[_KP], error), constants[_KV], slip)
    for i in range(3):
        # limit of 4 m/s^2 against wind-up of the integrator in too strong wind
        step = constants[_KI] * error[i] * constants[_DT]
        integral[i] = min(max(integral[i] + step, -4.0), 4.0)
    push = add(push, (integral[0], integral[1], integral[2] + gravity(x[LAT], x[LAT + 2])))
    up = max(push[2], 3.0)
    level = math.sqrt(push[0] * push[0] + push[1] * push[1])
    limit = min(1.0, up * math.tan(constants[_MAX_TILT]) / max(level, 1e-9))
    push = (push[0] * limit, push[1] * limit, up)

    q = load4(x, QUAT)
    body_x, _, body_z = q_columns(q)
    lean = q_rotate_back(q, cross(body_z, scale(1.0 / math.sqrt(dot(push, push)), push)))
    turn = ref[YAW] - math.atan2(body_x[1], body_x[0])
    turn -= 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi))
    max_rate, max_yaw_rate = constants[_MAX_RATE], constants[_MAX_YAW_RATE]
    for i in range(2):
        command[i] = min(max(constants[_K_TILT] * lean[i], -max_rate), max_rate)
    command[2] = min(max(constants[_K_YAW] * turn, -max_yaw_rate), max_yaw_rate)
    command[3] = max(dot(push, body_z), 0.0)
