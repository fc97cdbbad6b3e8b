"""Linearised observation models: each returns ``(z, H)`` with ``z = estimate - measurement``.

``H`` maps the error state (``filter.error_state``) to ``z``; it has as many columns as the filter has states. The
caller supplies the measurement noise. Frames: n is ENU, b is FLU. All functions are kernels.

Sources: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., eq. 14.103-14.115
(position and velocity with lever arm, there with the opposite sign of the attitude error); CN113777645A step 3.
"""

import math

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.core.filter.layout import (
    AIRSPEED,
    ALT,
    D_GYRO_BIAS,
    DEPTH,
    DPOS,
    DVEL,
    DVL,
    DVL_DELAY,
    GNSS_ERROR,
    I_GNSS_ERROR,
    LAT,
    LON,
    PHI,
    PREV_RATE,
    QUAT,
    VEL,
    WIND,
)
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix, wrap_angle
from nav_pose_estimator.core.numerics.vectors import (
    add,
    add_scaled,
    cross,
    dot,
    load3,
    load4,
    q_exp,
    q_rotate,
    q_rotate_back,
    scale,
    store3,
)

BEAMS = 4
"""Number of beams with a bias state."""
POSITION, VELOCITY = 0, 3
"""First state of the errors of GNSS positions and of velocities in block ``gnss_error``."""


@kernel
def gnss_position(nav, states, lat, lon, alt, lever):
    """Position of the GNSS antenna: ``lat``, ``lon`` [rad], ``alt`` [m]; ``lever`` (3,) arm in b [m]; z in m, ENU."""
    z = np.zeros(3)
    H = np.zeros((3, states))
    C = quat_to_matrix(nav[QUAT : QUAT + 4])
    r_m, r_n = radii(nav[LAT])
    arm = np.zeros(3)
    for i in range(3):
        arm[i] = C[i, 0] * lever[0] + C[i, 1] * lever[1] + C[i, 2] * lever[2]
        H[i, DPOS + i] = 1.0
    d_lon = wrap_angle(nav[LON] - lon)
    z[0] = d_lon * (r_n + nav[ALT]) * math.cos(nav[LAT]) + arm[0]
    z[1] = (nav[LAT] - lat) * (r_m + nav[ALT]) + arm[1]
    z[2] = nav[ALT] - alt + arm[2]
    _add_skew(H, PHI, arm)
    return z, H


@kernel
def gnss_velocity(nav, states, velocity, lever):
    """Velocity of the GNSS antenna over ground, (3,) in n [m/s]; ``lever`` (3,) arm from IMU to antenna in b [m]."""
    z = np.zeros(3)
    H = np.zeros((3, states))
    C = quat_to_matrix(nav[QUAT : QUAT + 4])
    w = nav[PREV_RATE : PREV_RATE + 3]
    swing = np.zeros(3)  # C (w x l)
    wx = w[1] * lever[2] - w[2] * lever[1]
    wy = w[2] * lever[0] - w[0] * lever[2]
    wz = w[0] * lever[1] - w[1] * lever[0]
    for i in range(3):
        swing[i] = C[i, 0] * wx + C[i, 1] * wy + C[i, 2] * wz
        z[i] = nav[VEL + i] + swing[i] - velocity[i]
        H[i, DVEL + i] = 1.0
        # -C [l x]: a gyroscope bias acts through the lever arm
        H[i, D_GYRO_BIAS] = -(C[i, 1] * lever[2] - C[i, 2] * lever[1])
        H[i, D_GYRO_BIAS + 1] = -(C[i, 2] * lever[0] - C[i, 0] * lever[2])
        H[i, D_GYRO_BIAS + 2] = -(C[i, 0] * lever[1] - C[i, 1] * lever[0])
    _add_skew(H, PHI, swing)
    return z, H


@kernel
def see_gnss_error(z, H, nav, constants, part):
    """Add the time-correlated GNSS errors to a GNSS observation (3 rows) of a filter that has them as states.

    ``part``: ``POSITION`` or ``VELOCITY``. The receiver measures the truth plus its correlated error.
    """
    first = int(constants[I_GNSS_ERROR])
    if first >= 0:
        for i in range(3):
            z[i] += nav[GNSS_ERROR + part + i]
            H[i, first + part + i] = -1.0  # the state is truth minus estimate


@kernel
def horizontal_velocity(nav, states, v_east, v_north):
    """Horizontal velocity over ground [m/s], ENU: a velocity prior or a horizontal zero-velocity update."""
    z = np.zeros(2)
    H = np.zeros((2, states))
    z[0] = nav[VEL] - v_east
    z[1] = nav[VEL + 1] - v_north
    H[0, DVEL] = 1.0
    H[1, DVEL + 1] = 1.0
    return z, H


@kernel
def zero_velocity(nav, states):
    """Zero-velocity update: z [m/s] is the estimated velocity of the IMU, ENU (Groves, section 15.3)."""
    z = nav[VEL : VEL + 3].copy()
    H = np.zeros((3, states))
    for i in range(3):
        H[i, DVEL + i] = 1.0
    return z, H


@kernel
def height(nav, states, alt):
    """Height above the ellipsoid [m]."""
    z = np.array([nav[ALT] - alt])
    H = np.zeros((1, states))
    H[0, DPOS + 2] = 1.0
    return z, H


@kernel
def height_in_water(nav, states, bias, alt):
    """Height ``alt`` [m] from water pressure, with the bias ``nav[DEPTH]``: z = height - bias - alt.

    The water surface is higher by the bias than assumed in ``alt``. ``bias`` is the index of the state of block
    ``depth``.
    """
    z = np.array([nav[ALT] - nav[DEPTH] - alt])
    H = np.zeros((1, states))
    H[0, DPOS + 2] = 1.0
    H[0, bias] = 1.0  # the state is truth minus estimate
    return z, H


@kernel
def magnetic_heading(nav, states, mag_x, mag_y, mag_z, declination):
    """Magnetic heading: z [rad] is the heading error phi_z, from the field levelled with the estimated tilt.

    With ``C_hat = (I - [phi x]) C`` the levelled field of direction (sin D, cos D) appears turned clockwise by phi_z.
    """
    C = quat_to_matrix(nav[QUAT : QUAT + 4])
    east = C[0, 0] * mag_x + C[0, 1] * mag_y + C[0, 2] * mag_z
    north = C[1, 0] * mag_x + C[1, 1] * mag_y + C[1, 2] * mag_z
    z = np.array([wrap_angle(math.atan2(east, north) - declination)])
    H = np.zeros((1, states))
    H[0, PHI + 2] = 1.0
    return z, H


@kernel
def body_velocity(nav, states, velocity, lever):
    """Velocity over ground in b (3,) [m/s] of the point at ``lever`` (3,) arm in b [m] (DVL, optical flow, wheel)."""
    z = np.zeros(3)
    H = np.zeros((3, states))
    C = quat_to_matrix(nav[QUAT : QUAT + 4])
    v = nav[VEL : VEL + 3]
    w = nav[PREV_RATE : PREV_RATE + 3]
    swing = np.zeros(3)
    swing[0] = w[1] * lever[2] - w[2] * lever[1]
    swing[1] = w[2] * lever[0] - w[0] * lever[2]
    swing[2] = w[0] * lever[1] - w[1] * lever[0]
    for i in range(3):
        z[i] = C[0, i] * v[0] + C[1, i] * v[1] + C[2, i] * v[2] + swing[i] - velocity[i]
        _velocity_in_body_row(H, i, C, v, i)
    # -[l x] on the gyroscope bias
    H[0, D_GYRO_BIAS + 1] = lever[2]
    H[0, D_GYRO_BIAS + 2] = -lever[1]
    H[1, D_GYRO_BIAS] = -lever[2]
    H[1, D_GYRO_BIAS + 2] = lever[0]
    H[2, D_GYRO_BIAS] = lever[1]
    H[2, D_GYRO_BIAS + 1] = -lever[0]
    return z, H


@kernel
def beam_velocities(nav, states, blocks, directions, measured, lever, change, has_biases):
    """Velocities along beams over ground: ``directions`` (n, 3) unit vectors in b, ``measured`` (n,) [m/s].

    ``lever`` (3,) arm from the IMU in b [m]; ``change`` (3,) recent rate of change of the sensor's velocity in b
    [m/s^2]. ``blocks``: first states of ``dvl`` and of ``dvl_delay`` (-1 without). With u = Exp(m) b_i the row is
    z = (1 + k) u . (C^T v + w x l - delay change) + bias_i - measured. Points of a cloud have no biases
    (``has_biases`` False).
    """
    n = len(measured)
    z = np.empty(n)
    H = np.zeros((n, states))
    q = load4(nav, QUAT)
    v = load3(nav, VEL)
    arm = load3(lever, 0)
    changing, (first, delay) = load3(change, 0), blocks
    at_sensor = add(q_rotate_back(q, v), cross(load3(nav, PREV_RATE), arm))
    at_sensor = add_scaled(at_sensor, -nav[DVL_DELAY], changing)
    gain = 1.0 + nav[DVL + BEAMS]
    mounting = load3(nav, DVL + BEAMS + 1)
    turn = q_exp(mounting)
    for i in range(n):
        u = q_rotate(turn, load3(directions[i], 0))
        along = dot(u, at_sensor)
        z[i] = gain * along - measured[i]
        in_n = scale(gain, q_rotate(q, u))
        store3(H[i], PHI, cross(v, in_n))
        store3(H[i], DVEL, in_n)
        store3(H[i], D_GYRO_BIAS, scale(gain, cross(arm, u)))
        # states of bias, scale and mounting are truth minus estimate
        if has_biases:
            z[i] += nav[DVL + i]
            H[i, first + i] = -1.0
        H[i, first + BEAMS] = -along
        if delay >= 0:
            H[i, delay] = gain * dot(u, changing)
        # -gain (u x v) for a small rotation; for m times J(m)', the left Jacobian of SO(3) to second order
        slope = scale(-gain, cross(u, at_sensor))
        bent = cross(slope, mounting)
        slope = add_scaled(slope, 0.5, bent)
        store3(H[i], first + BEAMS + 1, add_scaled(slope, 1.0 / 6.0, cross(bent, mounting)))
    return z, H


@kernel
def mean_air_velocity(nav, states, wind, attitude, velocity, body_velocity, air):
    """Air velocity in b (3,) [m/s] as a mean over an interval that ends at the time of ``nav``.

    ``attitude`` (3, 3) is the mean C_nb of the estimate over it, ``velocity`` (3,) and ``body_velocity`` (3,) its mean
    v and mean C^T v; ``air`` (3,) is the predicted air velocity. The states of the wind begin at ``wind``. z = C^T (v -
    wind) - air.
    """
    z = np.zeros(3)
    H = np.zeros((3, states))
    through_air = np.array([velocity[0] - nav[WIND], velocity[1] - nav[WIND + 1], velocity[2]])
    for i in range(3):
        z[i] = body_velocity[i] - attitude[0, i] * nav[WIND] - attitude[1, i] * nav[WIND + 1] - air[i]
        _velocity_in_body_row(H, i, attitude, through_air, i)
        for k in range(2):
            # the states of the wind are truth minus estimate
            H[i, wind + k] = attitude[k, i]
    return z, H


@kernel
def airspeed(nav, states, wind, scale, measured):
    """True airspeed [m/s] of a pitot tube, and zero sideslip: two rows, for a fixed-wing vehicle.

    ``wind`` and ``scale`` are the first states of the wind and of the sensor's scale. A pitot tube is insensitive to
    flow angles up to about 15 deg, so the first row is the norm of the air velocity: z = (1 + k) |v - wind| - measured.
    The second row is its component along body y, which is zero in coordinated flight.
    """
    z = np.zeros(2)
    H = np.zeros((2, states))
    C = quat_to_matrix(nav[QUAT : QUAT + 4])
    air = np.array([nav[VEL] - nav[WIND], nav[VEL + 1] - nav[WIND + 1], nav[VEL + 2]])
    speed = math.sqrt(air[0] ** 2 + air[1] ** 2 + air[2] ** 2)
    gain = 1.0 + nav[AIRSPEED]
    z[0] = gain * speed - measured
    for i in range(3):
        H[0, DVEL + i] = gain * air[i] / max(speed, 1.0)
        z[1] += C[i, 1] * air[i]
    H[0, scale] = -speed  # states of wind and scale are truth minus estimate
    _velocity_in_body_row(H, 1, C, air, 1)
    for k in range(2):
        H[0, wind + k] = H[0, DVEL + k]
        H[1, wind + k] = C[k, 1]
    return z, H


@kernel
def _velocity_in_body_row(H, row, C, v, i):
    """Component i of d(C_hat^T v_hat) into ``H`` [row]: -C^T [v x] on phi (C_hat^T = C^T (I + [phi x])), C^T on dv."""
    H[row, PHI] = C[2, i] * v[1] - C[1, i] * v[2]
    H[row, PHI + 1] = C[0, i] * v[2] - C[2, i] * v[0]
    H[row, PHI + 2] = C[1, i] * v[0] - C[0, i] * v[1]
    for k in range(3):
        H[row, DVEL + k] = C[k, i]


@kernel
def _add_skew(H, column, a):
    """Write [a x] into three rows of H."""
    H[0, column + 1] = -a[2]
    H[0, column + 2] = a[1]
    H[1, column] = a[2]
    H[1, column + 2] = -a[0]
    H[2, column] = -a[1]
    H[2, column + 1] = a[0]
