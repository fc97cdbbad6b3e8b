"""Layout of the filter's arrays: the index of each quantity. Code uses these names, never numbers.

``nav`` is one float64 vector of the nominal state and the memory of the integrator: a compiled kernel takes one array,
and a snapshot is one copy. ``P`` is the (n, n) covariance of the error state, n = 15 plus optional blocks.
"""

# --- nominal state -------------------------------------------------------------------------------------------------
LAT, LON, ALT = 0, 1, 2  # rad, rad, m above the ellipsoid
VEL = 3  # 3: East, North, Up, m/s
QUAT = 6  # 4: q_nb, scalar first
GYRO_BIAS = 10  # 3: rad/s
ACCEL_BIAS = 13  # 3: m/s^2
# nominal values of the optional blocks (``filter.blocks``), zero where the filter does not have them
WIND = 16  # 2: air velocity over ground, East, North, m/s
GYRO_MATRIX = 18  # 9: row-major M in w_measured = (I + M) w + bias
DVL = 27  # 8: biases of four beams, m/s (4), their common scale error, and the mounting error as a rotation vector, rad
DEPTH = 35  # 1: bias of a height from water pressure, m
GRAVITY = 36  # 3: gravity disturbance in n (beyond normal gravity), m/s^2
AIRSPEED = 39  # 1: scale error of an airspeed sensor: measured = (1 + scale) airspeed
GNSS_ERROR = 40  # 6: time-correlated errors of GNSS positions, E, N, U, m, and of velocities, m/s
DVL_DELAY = 46  # 1: latency of beam velocities beyond the known one, s
# --- memory of the integrator --------------------------------------------------------------------------------------
TIME = 47  # s since the engine's epoch
PREV_RATE = 48  # 3: corrected angular rate of the last interval, rad/s (coning, sculling)
PREV_FORCE = 51  # 3: corrected specific force of the last interval, m/s^2
PREV_ACCEL = 54  # 3: dv/dt of the last interval in n, m/s^2 (mid-interval extrapolation)
# --- sums since the last covariance step ---------------------------------------------------------------------------
SUM_TIME = 57  # s
SUM_FORCE = 58  # 3: integral of C_nb f_b, m/s
SUM_RATE = 61  # 3: integral of the corrected angular rate in b, rad
SUM_GAP = 64  # s of data gap bridged since the last covariance step
# --- identified driving noise of the gyroscope bias (``bias_noise``) -----------------------------------------------
GYRO_WANDER = 65  # (rad/s)^2/s: driving noise of the gyroscope bias beyond that of the constants
WANDER_LEVEL = 66  # mean ratio of short windows
WANDER_SHORT_COUNT = 67  # short windows so far
WANDER_TIME = 68  # s: time of the last observation
WANDER_MARKS = 69  # 4 x 8: open windows
WANDER_FLOOR = 101  # (rad/s)^2/s: the constants' driving noise; 0 while the identification is off
WANDER_MEAN = 102  # mean ratio of long windows
WANDER_COUNT = 103  # long windows so far
# --- uncertain latency of GNSS -------------------------------------------------------------------------------------
GNSS_VEL = 104  # 3: velocity at the last GNSS observation, m/s: a latency displaces the position along it
NAV_SIZE = 107

# --- error state ---------------------------------------------------------------------------------------------------
PHI = 0  # 3: misalignment in n, rad
DVEL = 3  # 3: m/s
DPOS = 6  # 3: East, North, Up, m
D_GYRO_BIAS = 9  # 3: rad/s
D_ACCEL_BIAS = 12  # 3: m/s^2
BASE_STATES = 15
"""States of every filter. Optional blocks follow, see ``filter.blocks``."""
OPTIONAL_STATES = 31
"""Sum of the sizes of all blocks; their nominal values lie side by side from ``WIND`` on."""

# --- filter constants: one float64 vector handed to the kernels ----------------------------------------------------
GYRO_NOISE_PSD = 0  # (rad/s)^2/Hz
ACCEL_NOISE_PSD = 1  # (m/s^2)^2/Hz
GYRO_BIAS_PSD = 2  # (rad/s)^2/s, driving noise 2 sigma^2/tau
GYRO_BIAS_RATE = 3  # 1/tau, 1/s
ACCEL_BIAS_PSD = 4
ACCEL_BIAS_RATE = 5
COV_PERIOD = 6  # s between covariance steps
GAP_DT = 7  # s: a longer IMU interval counts as a gap
GAP_RATE_SD = 8  # rad/s: unknown angular rate during a gap
GAP_ACCEL_SD = 9  # m/s^2: unknown specific force during a gap
POINT_SAMPLED = 10
"""1: IMU values are instantaneous (trapezoidal rule), 0: means over the interval that ends at the stamp."""
I_WIND, I_GYRO_MATRIX, I_DVL, I_DEPTH, I_GRAVITY, I_AIRSPEED, I_GNSS_ERROR, I_DVL_DELAY = 11, 12, 13, 14, 15, 16, 17, 18
"""First state of each optional block in the error state; -1 where the filter does not have it."""
BLOCK_PSD = 19
"""OPTIONAL_STATES: density of the driving noise of every optional state, its unit squared per s, in the order of
``nav``."""
BLOCK_RATE = BLOCK_PSD + OPTIONAL_STATES
"""OPTIONAL_STATES: 1/tau, 1/s; 0 for a random walk."""
GNSS_DELAY_SD = BLOCK_RATE + OPTIONAL_STATES  # s: deviation of the latency of GNSS from ``gnss.delay``
CONSTANTS_SIZE = GNSS_DELAY_SD + 1

# --- IMU block and output rows -------------------------------------------------------------------------------------
IMU_T, IMU_GYRO, IMU_ACCEL, IMU_COLUMNS = 0, 1, 4, 7  # t [s since epoch], gyro [rad/s] (3), accel [m/s^2] (3)
OUT_T, OUT_POS, OUT_VEL, OUT_QUAT, OUT_RATE, OUT_FORCE, OUT_VAR, OUT_COLUMNS = 0, 1, 4, 7, 11, 14, 17, 26
"""Rows of the navigator's output: t, (lat, lon, alt), v_n (3), q_nb (4), bias-corrected rate (3) and force (3) in b,
variances of phi, dv, dp (9)."""
SOLUTION_BIASES = OUT_COLUMNS  # 6: gyroscope, accelerometer
SOLUTION_ENU = SOLUTION_BIASES + 6  # 3: position from the origin, m
SOLUTION_COV = SOLUTION_ENU + 3  # 225: covariance of the base states, row-major
SOLUTION_SIZE = SOLUTION_COV + BASE_STATES * BASE_STATES
"""Size of the solution at one sample: an output row, biases, position and covariance."""
