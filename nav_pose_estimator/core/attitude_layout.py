"""Where each quantity lives in the state vector of an attitude filter. Code uses these names, never numbers.

One float64 vector holds estimate, memory and tuning constants of a filter: a compiled step takes one array, an output
is one copy of the head, and a snapshot is one copy of the whole. Both filters share this layout; each appends its own
covariance from ``OWN`` on.
"""

# --- head: all that an attitude solution reports -------------------------------------------------------------------
QUAT = 0  # 4: q_nb, scalar first
COV = 4  # 9: covariance of the misalignment about n axes, row-major, rad^2
RATE = 13  # 3: corrected angular rate in b, rad/s
FORCE = 16  # 3: specific force in b, m/s^2
BIAS = 19  # 3: gyro bias in b, rad/s
HEAD_SIZE = 22
# --- estimate ------------------------------------------------------------------------------------------------------
AGE = 22  # s since the first sample, negative before it
MATRIX = 23  # 9: row-major M in w_measured = (I + M) w + bias
SWAY = 32  # 3: velocity in n that specific force less gravity builds up; only tilt or motion can make it grow, m/s
SWAY_VAR = 35  # smoothed mean square of the horizontal sway, per axis, (m/s)^2
# --- sums since the last feedback ----------------------------------------------------------------------------------
SUM_TIME = 36  # s
SUM_RATE = 37  # 3: raw rate, rad
SUM_FORCE = 40  # 3: raw force in b, m/s
SUM_RATE_SQUARE = 43  # rad^2/s
SUM_FORCE_SQUARE = 44  # m^2/s^3
SUM_TURN = 45  # 3: corrected rate, rad
SUM_FORCE_N = 48  # 3: force in n, m/s
SUM_FIELD = 51  # 3: magnetic field in n
FIELD_COUNT = 54  # samples in SUM_FIELD
COLUMNS = 55  # 9: columns of C_nb at the last feedback
# --- rest and rejection --------------------------------------------------------------------------------------------
MEAN_RATE = 64  # 3: smoothed raw rate, rad/s
MEAN_FORCE = 67  # 3: smoothed raw force, m/s^2
STILL_TIME = 70  # s without motion
LOW_FORCE = 71  # 3: low-passed force in n, m/s^2
TRUST = 74  # p(a), 0 ... 1
MOTION = 75  # smoothed norm of the rate, rad/s
# --- the navigator's acceleration ----------------------------------------------------------------------------------
NAV_ACCEL = 76  # 3: m/s^2, n
NAV_HOLD = 79  # s for which it is still believed
NAV_SPEED = 80  # m/s, negative when unknown
# --- magnetic field ------------------------------------------------------------------------------------------------
FIELD_H = 81  # learned horizontal part, 0 before the first sample
FIELD_V = 82  # learned downward part
FIELD_SUPPORT = 83  # s of field that speak for them
FIELD_ANOMALY = 84  # smoothed squared distance from them, relative to FIELD_H
FIELD_TRUST = 85  # 0 disturbed ... 1 undisturbed
FIELD_TIME = 86  # AGE at the last field observation
NEW_H = 87  # the field of the last seconds, a candidate for FIELD_H ...
NEW_V = 88  # ... and FIELD_V
NEW_ANOMALY = 89  # smoothed squared distance from the candidate
NEW_SUPPORT = 90  # s of field that speak for the candidate
FIELD_CHANGES = 91  # how often a candidate replaced the reference
# --- what the engine tells about the sensors -----------------------------------------------------------------------
EXTRA_PSD = 92  # rad^2/s: additional walk of the attitude while a sensor is saturated or stuck
FROZEN = 93  # 1 while a sensor is stuck: stillness proves nothing
# --- constants -----------------------------------------------------------------------------------------------------
PERIOD = 94  # s between feedbacks
GRAVITY = 95  # m/s^2
POINT = 96  # 1: IMU values are instantaneous, 0: means over the interval that ends at the stamp
GAP_DT = 97  # s: a longer interval counts as a gap
GAP_RATE_SD = 98  # rad/s: unknown rate in a gap
WANDER_PSD = 99  # rad^2/s: walk of the attitude
BIAS_PSD = 100  # (rad/s)^2/s
MATRIX_PSD = 101  # 1/s
SWAY_PSD = 102  # (m/s^2)^2/Hz: noise of the specific force
MOTION_FLOOR = 103  # (m/s)^2 s: density of the vehicle's own sway in slow motion
MOTION_TAU = 104  # s: ... and how long a sway lasts
MOTION_RISE = 105  # s: smoothing of SWAY_VAR upwards
MOTION_FALL = 106  # s: ... and downwards
STILL_PSD = 107  # (m/s)^2 s: density of the sway at rest
STILL_RATE = 108  # rad/s
STILL_FORCE = 109  # m/s^2
STILL_NORM = 110  # m/s^2
LEVEL_AFTER = 111  # s at rest before STILL_PSD holds
LEARN_AFTER = 112  # s at rest before the mean rate is the gyro bias
LEARN_PSD = 113  # (rad/s)^2/Hz: noise of the rate at rest
BIAS_LIMIT = 114  # rad/s
REJECT_FROM = 115  # m/s^2
REJECT_TO = 116  # m/s^2
TIMING_SD = 117  # s: unknown delay of the sensor, for the covariance only
DECLINATION = 118  # rad, east positive
HEADING_PSD = 119  # rad^2 s: density of a magnetic heading's error
ANOMALY_GAIN = 120  # by how much an anomaly of 1 multiplies it
ANOMALY_TAU = 121  # s
FIELD_TAU = 122  # s: memory of the learned field
NEW_TAU = 123  # s: smoothing of the candidate
NEW_LIMIT = 124  # anomaly at which reference and candidate differ, relative square
NEW_AFTER = 125  # s of support that a candidate needs at most
NEW_HEADING_VAR = 126  # rad^2 after the reference was replaced
OWN = 127
"""Where a filter's own quantities begin."""
